"""Every check of a run, errors of looks and offsets, and the claim A-VICON: the share of checks that hold.

A live check is one thing that section 4.5 of paper A says of the direct receiver or of the bridge.
"""

from __future__ import annotations

from dataclasses import asdict
from typing import TYPE_CHECKING

import pandas as pd

from sfglab.lab.checks import CheckRow, check_row, share_of_checks
from sfglab.lab.checks.trees import AGENT, RULE, WAYS, WORLD
from sfglab.lab.claims import Finding, How
from sfglab.lab.experiments.mocap.experiment import Config, exp
from sfglab.lab.runs import Run, derived
from sfglab.lab.stats import median_of
from sfglab.spatial.frames.buffer import Edge
from sfglab.spatial.frames.lint import FrameFinding, lint_frames

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

RIGHT_MM = 20.0
"""A tenth of how far the markers are from the base: whoever takes one frame for the other is further off."""


def tree_of(run: Run[Config], where: str, way: str) -> tuple[Edge, ...]:
    """Return the edges of one tree: of ``figure 6`` or of a live round, joined by one of `WAYS`."""
    edges = run["edge"]
    chosen = edges[(edges["where"] == where) & (edges["way"] == way)].drop(columns=["where", "way"])
    return tuple(Edge(**{str(key): value for key, value in row.items()}) for row in chosen.to_dict("records"))


def findings_of(run: Run[Config], where: str, way: str) -> tuple[FrameFinding, ...]:
    """Return what the lint finds wrong with one tree; names and root are demanded."""
    return lint_frames(tree_of(run, where, way), rule=RULE, root=WORLD)


@derived
def checks(run: Run[Config]) -> pd.DataFrame:
    """Return every check: ``how`` (exact, faults or live), ``check``, ``checked``, ``held`` and ``example``."""
    exact = run["check"].assign(
        how=["faults" if c.startswith("faults") else "exact" for c in run["check"]["check"]]
    )
    live = pd.DataFrame([asdict(row) for name in run.config.rounds for row in _live_checks(run, name)])
    columns = ["how", "check", "checked", "held", "example"]
    return pd.concat([exact, live.assign(how="live")], ignore_index=True)[columns]


def _live_checks(run: Run[Config], name: str) -> Iterator[CheckRow]:
    """Yield the checks of one round."""
    found = {way: findings_of(run, name, way) for way in WAYS}
    own = {
        way: {(e.child, e.parent, e.static) for e in tree_of(run, name, way) if e.parent != WORLD}
        for way in WAYS
    }
    looks = run["look"][run["look"]["round"] == name]
    near = looks["error_mm"] < RIGHT_MM
    cases: dict[str, Iterable[tuple[object, object]]] = {
        "proxy: the tree as heard is whole": [(found["proxy"], own["proxy"] and not found["proxy"])],
        "proxy: the robot's own edges are as without": [(own["proxy"], own["proxy"] == own["direct"])],
        "proxy: every look is answered": _numbered(looks["wait_ms"].notna()),
        f"proxy: the camera is within {RIGHT_MM:g} mm of the truth": _numbered(near),
        "direct: the tree as heard has two roots": [("", _has(found["direct"], "second-root"))],
        "direct: what is published is no frame of the robot": [("", _has(found["direct"], "name"))],
        "renamed: the markers have two parents": [("", _has(found["renamed"], "two-parents"))],
    }
    for check, tried in cases.items():
        yield check_row(f"live, {name}, {check}", [(str(text), bool(held)) for text, held in tried])
    for way in ("direct", "renamed"):
        tries = run["try"][(run["try"]["round"] == name) & (run["try"]["way"] == way)]
        yield CheckRow(
            check=f"live, {name}, {way}: no look from the world to the camera is answered",
            checked=max(1, int(tries["count"].sum())),
            held=int(tries[tries["outcome"] != "found"]["count"].sum()),
            example=", ".join(tries["outcome"]),
        )


def _has(findings: tuple[FrameFinding, ...], code: str) -> bool:
    return any(finding.code == code and AGENT in str(finding) for finding in findings)


def _numbered(held: pd.Series[bool]) -> list[tuple[object, object]]:
    return [(f"look {number}", holds) for number, holds in enumerate(held)]


@derived
def errors(run: Run[Config]) -> pd.DataFrame:
    """Return medians by live round: what is wrong with a look at its own time, and with the newest used as now.

    The ideal round has what the bridge and the tree add (continued odometry, interpolation), the faulty one
    the cameras' noise besides; the newest pose used as now adds the latency of all.
    """
    columns = ["error_mm", "error_mrad", "latest_mm", "latest_mrad", "age_ms", "wait_ms"]
    return run["look"].groupby("round", sort=False)[columns].median()


@derived
def offsets(run: Run[Config]) -> pd.DataFrame:
    """Return medians by case and length, with the share of numbers that the 95 % intervals hold."""
    table = run["offset"]
    by = ["drifts", "modelled", "length_s"]
    medians = table.groupby(by)[["error_mm", "error_mrad", "sigma_mm", "before_mm", "after_mm"]].median()
    return medians.assign(covered=table.groupby(by)["covered"].mean() / 6).reset_index()


@exp.claim("A-VICON", how=lambda run: How.LIVE if len(run["look"]) else How.EXACT)
def share_that_holds(run: Run[Config]) -> Finding:
    """Return the share of checks that hold.

    Of live, fault and exact checks, whichever share is lowest: there are so many exact ones that they would
    hide the others.
    """
    share = share_of_checks(checks(run), "how")
    details = {
        "hosts": str(run.metadata("hosts")["description"]),
        **{f"{group} checks": held for group, held in share.groups.items()},
        **_live_details(run),
        **_fault_details(run),
        **_offset_details(run),
    }
    return Finding(estimate=share.estimate, details=details, reason=share.reason)


def _live_details(run: Run[Config]) -> dict[str, str]:
    details: dict[str, str] = {}
    for name in run.config.rounds:
        looks = run["look"][run["look"]["round"] == name].dropna()
        heard = run["heard"][run["heard"]["round"] == name]
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


def _fault_details(run: Run[Config]) -> dict[str, str]:
    table = run["confusion"]
    flipped = table[table["truth"] == "flipped"]
    believed = int(flipped[flipped["verdict"].isin(["sound", "confirmed"])]["count"].sum())
    seen = table[table["truth"] == "seen"]
    refused = int(seen[~seen["verdict"].isin(["sound", "confirmed"])]["count"].sum())
    return {
        "flipped sights that were published": f"{believed} of {int(flipped['count'].sum())}",
        "true sights that were not": f"{refused} of {int(seen['count'].sum())}: after such a flip",
    }


def _offset_details(run: Run[Config]) -> dict[str, str]:
    table = offsets(run)
    details = {}
    for (drifts, modelled), rows in table.groupby(["drifts", "modelled"]):
        how = f"odometry {'drifts' if drifts else 'is steady'}, {'' if modelled else 'not '}allowed for"
        best = rows.nsmallest(1, "error_mm").iloc[0]
        details[f"offset, {how}"] = (
            f"{best['error_mm']:.2g} mm after {best['length_s']:g} s; intervals hold "
            f"{rows['covered'].min():.0%} to {rows['covered'].max():.0%} (stated: 95 %)"
        )
    return details
