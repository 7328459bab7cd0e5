"""From the log to checks, errors and the claim A-VICON.

Everything here is computed from the log alone. A check is one thing that section 4.5 of paper A says of the
direct receiver or of the bridge, and one case of it; the claim is the share of checks that hold.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, Any

import pandas as pd

from sfglab.lab.checks import CheckRow, share_of_checks
from sfglab.lab.claims import How, Measured
from sfglab.lab.experiments.mocap.config import WAYS
from sfglab.lab.experiments.mocap.robot import AGENT, WORLD
from sfglab.lab.experiments.mocap.rows import (
    ConfusionRow,
    MocapEdgeRow,
    MocapHeardRow,
    MocapLookRow,
    OffsetRow,
    SpellRow,
    TryRow,
)
from sfglab.lab.experiments.mocap.trees import RULE
from sfglab.lab.stats import median_of
from sfglab.record import LogReader
from sfglab.spatial.frames import Edge, FrameFinding, lint_frames

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path


RIGHT_MM = 20.0
"""A tenth of how far the markers are from the base: whoever takes one frame for the other is further off."""
_TABLES = {
    "edge": MocapEdgeRow,
    "look": MocapLookRow,
    "try": TryRow,
    "heard": MocapHeardRow,
    "spell": SpellRow,
    "confusion": ConfusionRow,
    "check": CheckRow,
    "offset": OffsetRow,
}


@dataclass(frozen=True, slots=True, kw_only=True)
class Results:
    """The tables of one run."""

    edges: pd.DataFrame  #: All edges of all trees, by ``where`` (figure 6, or a live round) and ``way``.
    looks: pd.DataFrame  #: One line a live look through the bridge's tree.
    tries: pd.DataFrame  #: How live looks ended, by round and way.
    heard: pd.DataFrame  #: Times of the bridge's transforms.
    spells: pd.DataFrame  #: When the cameras of a live round were wrong.
    confusion: pd.DataFrame  #: What was really there, and the bridge's verdict.
    checks: pd.DataFrame  #: The checks without network: trees, and faults.
    offsets: pd.DataFrame  #: One line an estimate of the offset.
    config: dict[str, Any]  #: The run's configuration.
    hosts: dict[str, Any]  #: What the hosts were.


def load_results(log: Path) -> Results:
    """Read a run's tables.

    Args:
        log: The log.
    """
    with LogReader(log) as reader:
        edges, looks, tries, heard, spells, confusion, held, offset = (_table(reader, name) for name in _TABLES)
        return Results(
            edges=edges,
            looks=looks,
            tries=tries,
            heard=heard,
            spells=spells,
            confusion=confusion,
            checks=held,
            offsets=offset,
            config=reader.metadata("config"),
            hosts=reader.metadata("hosts"),
        )


def _table(reader: LogReader, name: str) -> pd.DataFrame:
    """Return a table; one without rows is not in the log."""
    if name in reader.tables:
        return reader.table(name).drop(columns="log_time_ns")
    return pd.DataFrame(columns=[field.name for field in fields(_TABLES[name])])


def tree_of(results: Results, where: str, way: str) -> tuple[Edge, ...]:
    """Return the edges of one tree.

    Args:
        results: The run.
        where: ``figure 6``, or a live round.
        way: ``direct``, ``renamed`` or ``proxy``.
    """
    edges = results.edges
    chosen = edges[(edges["where"] == where) & (edges["way"] == way)].drop(columns=["where", "way"])
    return tuple(Edge(**{str(key): value for key, value in row.items()}) for row in chosen.to_dict("records"))


def findings_of(results: Results, where: str, way: str) -> tuple[FrameFinding, ...]:
    """Return what the lint finds wrong with one tree; names and root are demanded."""
    return lint_frames(tree_of(results, where, way), rule=RULE, root=WORLD)


def checks(results: Results) -> pd.DataFrame:
    """Return every check: ``how`` (exact, faults or live), ``check``, ``checked``, ``held`` and ``example``."""
    exact = results.checks.copy()
    exact.insert(0, "how", ["faults" if c.startswith("faults") else "exact" for c in exact["check"]])
    live = pd.DataFrame([row for name in results.config["rounds"] for row in _live_checks(results, str(name))])
    return pd.concat([exact, live], ignore_index=True)


def _live_checks(results: Results, name: str) -> Iterator[dict[str, Any]]:
    found = {way: findings_of(results, name, way) for way in WAYS}
    own = {
        way: {(e.child, e.parent, e.static) for e in tree_of(results, name, way) if e.parent != WORLD}
        for way in WAYS
    }
    tries = {
        way: results.tries[(results.tries["round"] == name) & (results.tries["way"] == way)] for way in WAYS
    }
    looks = results.looks[results.looks["round"] == name]
    yield _one(name, "proxy: the tree as heard is whole", own["proxy"] and not found["proxy"], found["proxy"])
    yield _one(name, "proxy: the robot's own edges are as without", own["proxy"] == own["direct"], own["proxy"])
    yield _many(name, "proxy: every look is answered", looks["wait_ms"].notna())
    yield _many(name, f"proxy: the camera is within {RIGHT_MM:g} mm of the truth", looks["error_mm"] < RIGHT_MM)
    yield _one(name, "direct: the tree as heard has two roots", _has(found["direct"], "second-root"), "")
    yield _one(name, "direct: what is published is no frame of the robot", _has(found["direct"], "name"), "")
    yield _one(name, "renamed: the markers have two parents", _has(found["renamed"], "two-parents"), "")
    for way in ("direct", "renamed"):
        failed = tries[way][tries[way]["outcome"] != "found"]["count"].sum()
        yield {
            "how": "live",
            "check": f"live, {name}, {way}: no look from the world to the camera is answered",
            "checked": max(1, int(tries[way]["count"].sum())),
            "held": int(failed),
            "example": ", ".join(tries[way]["outcome"]),
        }


def _has(findings: tuple[FrameFinding, ...], code: str) -> bool:
    return any(finding.code == code and AGENT in str(finding) for finding in findings)


def _one(name: str, check: str, holds: object, example: object) -> dict[str, Any]:
    return {
        "how": "live",
        "check": f"live, {name}, {check}",
        "checked": 1,
        "held": int(bool(holds)),
        "example": str(example),
    }


def _many(name: str, check: str, holds: pd.Series[bool]) -> dict[str, Any]:
    # Without anything to look at a check has not held.
    return {
        "how": "live",
        "check": f"live, {name}, {check}",
        "checked": max(1, len(holds)),
        "held": int(holds.sum()),
        "example": f"look {int(holds.argmin())}" if len(holds) else "nothing to check",
    }


def errors(results: Results) -> pd.DataFrame:
    """Return medians by live round: what is wrong with a look at its own time, and with the newest used as now.

    The ideal round has what the bridge and the tree add (continued odometry, interpolation), the faulty one
    the cameras' noise besides; the newest pose used as now adds the latency of all.
    """
    columns = ["error_mm", "error_mrad", "latest_mm", "latest_mrad", "age_ms", "wait_ms"]
    return results.looks.groupby("round", sort=False)[columns].median()


def offsets(results: Results) -> pd.DataFrame:
    """Return medians by case and length, with the share of numbers that the 95 % intervals hold."""
    table = results.offsets
    by = ["drifts", "modelled", "length_s"]
    medians = table.groupby(by)[["error_mm", "error_mrad", "sigma_mm", "before_mm", "after_mm"]].median()
    return medians.assign(covered=table.groupby(by)["covered"].mean() / 6).reset_index()


def measure_claims(log: Path) -> dict[str, Measured]:
    """Return our figure for A-VICON: the share of checks that hold.

    Of live, fault and exact checks, whichever share is lowest: there are so many exact ones that they would
    hide the others.
    """
    results = load_results(log)
    table = checks(results)
    share = share_of_checks(table, "how")
    details = {
        "hosts": str(results.hosts["description"]),
        **{f"{group} checks": held for group, held in share.groups.items()},
        **_live_details(results),
        **_fault_details(results),
        **_offset_details(results),
    }
    how = How.LIVE if len(results.looks) else How.EXACT
    return {"A-VICON": Measured(estimate=share.estimate, how=how, details=details, reason=share.reason)}


def _live_details(results: Results) -> dict[str, str]:
    details: dict[str, str] = {}
    for name in results.config["rounds"]:
        looks = results.looks[results.looks["round"] == name].dropna()
        heard = results.heard[results.heard["round"] == name]
        if looks.empty or heard.empty:
            continue
        of = {
            "error at the time asked for": median_of(looks["error_mm"].to_numpy(), unit="mm"),
            "turn at the time asked for": median_of(looks["error_mrad"].to_numpy(), unit="mrad"),
            "error of the newest taken for now": median_of(looks["latest_mm"].to_numpy(), unit="mm"),
            "until a time is known": median_of(looks["wait_ms"].to_numpy(), unit="ms"),
            "capture to listener": median_of(heard["heard_ms"].to_numpy(), unit="ms"),
        }
        details |= {f"{name}, {what}": str(estimate) for what, estimate in of.items()}
    return details


def _fault_details(results: Results) -> dict[str, str]:
    table = results.confusion
    flipped = table[table["truth"] == "flipped"]
    believed = int(flipped[flipped["verdict"].isin(["sound", "confirmed"])]["count"].sum())
    seen = table[table["truth"] == "seen"]
    refused = int(seen[~seen["verdict"].isin(["sound", "confirmed"])]["count"].sum())
    return {
        "flipped sights that were published": f"{believed} of {int(flipped['count'].sum())}",
        "true sights that were not": f"{refused} of {int(seen['count'].sum())}: after such a flip",
    }


def _offset_details(results: Results) -> dict[str, str]:
    table = offsets(results)
    details = {}
    for (drifts, modelled), rows in table.groupby(["drifts", "modelled"]):
        how = f"odometry {'drifts' if drifts else 'is steady'}, {'' if modelled else 'not '}allowed for"
        best = rows.nsmallest(1, "error_mm").iloc[0]
        details[f"offset, {how}"] = (
            f"{best['error_mm']:.2g} mm after {best['length_s']:g} s; intervals hold "
            f"{rows['covered'].min():.0%} to {rows['covered'].max():.0%} (stated: 95 %)"
        )
    return details
