"""Success rates by method and rate, how runs failed, and the claim, computed from a run."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from sfglab.arp.hallway import End
from sfglab.arp.robots import METHODS
from sfglab.lab.claims import Finding, How
from sfglab.lab.experiments.cooperation.experiment import Config, exp
from sfglab.lab.runs import Run, derived
from sfglab.lab.stats import Estimate, Floats, bootstrap, wilson

if TYPE_CHECKING:
    from collections.abc import Sequence

AS_IS = "Fast DDS, 1 % loss"


@derived
def courses(run: Run[Config], table: str = "course") -> pd.DataFrame:
    """Return one line a run, of the table ``course`` or ``contrast``, with ``success``."""
    return run[table].assign(success=run[table]["end"] == End.SUCCESS.value)


def rates(courses: pd.DataFrame, *keys: str) -> pd.DataFrame:
    """Return success rates with intervals by columns, ``method`` among them, methods in the paper's order."""
    grouped = (
        courses.groupby(list(keys), sort=True)["success"]
        .agg(successes="sum", runs="count")
        .reset_index()
    )
    table = grouped.sort_values(
        "method", key=lambda names: names.map(list(METHODS).index), kind="stable"
    )
    bounds = [
        wilson(int(s), int(n)) for s, n in zip(table["successes"], table["runs"], strict=True)
    ]
    return table.assign(
        rate=table["successes"] / table["runs"],
        low=[low for low, _ in bounds],
        high=[high for _, high in bounds],
    ).reset_index(drop=True)


def failures(courses: pd.DataFrame) -> pd.DataFrame:
    """Return how often each method's runs ended how, and by whom: a line a method, a column an end."""
    failed = courses[~courses["success"]]
    who = failed["end"] + failed["robot"].map(lambda robot: f", {robot}" if robot else "")
    counts = pd.crosstab(failed["method"], who.rename("how"))
    named = counts.reindex(
        [name for name in METHODS if name in set(courses["method"])], fill_value=0
    )
    named.insert(0, End.SUCCESS.value, courses.groupby("method")["success"].sum())
    return named.astype(int)


def staleness(courses: pd.DataFrame) -> pd.DataFrame:
    """Return, by method and Rmax, how runs' messages did: medians over runs, and the success rate."""
    columns = [
        "rate_hz",
        "depth_used",
        "airtime",
        "beams_lost",
        "beam_p50_ms",
        "command_p50_ms",
        "stale_s",
    ]
    table = courses.groupby(["method", "rate_max_hz", "depth"], sort=True)[[*columns, "success"]]
    return table.agg({**dict.fromkeys(columns, "median"), "success": "mean"}).reset_index()


@derived
def contrasts(run: Run[Config], values: str = "rate") -> pd.DataFrame:
    """Return `rates`, a line a method: as they are and in each contrast, at the rates contrasted."""
    more, rows = courses(run, "contrast"), courses(run)
    if more.empty:
        return pd.DataFrame()
    fast = more["vendor"] == "fast_dds"
    for column in ("method", "rate_max_hz"):
        rows = rows[rows[column].isin(set(more[column]))]
    kinds = {
        AS_IS: rows,
        "no loss": more[fast & (more["loss"] == 0.0)],
        "Cyclone DDS": more[~fast],
        "rate of Eq. 6, depth 10": more[fast & (more["loss"] > 0.0)],
    }
    parts = [rates(rows, "method").assign(kind=kind) for kind, rows in kinds.items()]
    return pd.concat(parts).pivot_table(index="method", columns="kind", values=values, sort=False)


def difference(courses: pd.DataFrame) -> Estimate:
    """Return by how much OPT+LC succeeds more often than none, averaged over Rmax; depths count alike."""
    groups = [
        runs["success"].to_numpy(dtype=np.float64)
        for method in ("OPT+LC", "none")
        for _, runs in courses[courses["method"] == method].groupby("rate_max_hz")
    ]
    half = len(groups) // 2

    def exceeds(drawn: Sequence[Floats]) -> float:
        means = [float(group.mean()) for group in drawn]
        return float(np.mean(means[:half]) - np.mean(means[half:]))

    return bootstrap(groups, exceeds, unit="success rate difference")


@exp.claim("B-COOP", how=How.SIMULATED)
def success_difference(run: Run[Config]) -> Finding:
    """Return by how much the paper's winner succeeds more often than no method at all."""
    return Finding(estimate=difference(courses(run)), details=_details(run), reason=_reason(run))


def _details(run: Run[Config]) -> dict[str, str]:
    rows = courses(run)
    details = {
        f"success, {row.method}": f"{row.rate:.2f} [{row.low:.2f}, {row.high:.2f}] of {row.runs} runs"
        for row in rates(rows, "method").itertuples()
    }
    for row in rates(
        rows[rows["method"].isin(("none", "OPT+LC"))], "method", "rate_max_hz"
    ).itertuples():
        details[f"success, {row.method}, Rmax {row.rate_max_hz} Hz"] = (
            f"{row.successes} of {row.runs}"
        )
    for method, counts in failures(rows).iterrows():
        said = [
            f"{how} {count}" for how, count in counts.items() if count and how != End.SUCCESS.value
        ]
        if said:
            details[f"failures, {method}"] = "; ".join(said)
    for method, shares in contrasts(run).iterrows():
        details[f"contrasts, {method}"] = "; ".join(_shares(shares))
    return details | {f"live, {key}": str(value) for key, value in run.metadata("live").items()}


def _shares(shares: Any) -> list[str]:
    return [f"{kind} {share:.2f}" for kind, share in shares.dropna().items()]


def _reason(run: Run[Config]) -> str:
    """Say why OPT+LC is not always successful, from the runs that were not, and when it would be."""
    rows, table = courses(run), contrasts(run)
    failed = rows[(rows["method"] == "OPT+LC") & ~rows["success"]]
    if failed.empty:
        return ""
    reason = (
        f"in the runs that OPT+LC lost, something was out of date for up to {failed['stale_s'].median():.1f} s "
        f"(median): at a depth of {int(failed['depth_used'].median())} the history is seldom full, so a lost "
        "message is missed only with the next heartbeat, every 3 s, and RELIABLE holds back all that follow it"
    )
    if "OPT+LC" not in table.index:
        return reason
    return (
        f"{reason}; success of OPT+LC else: {', '.join(_shares(table.loc['OPT+LC'].drop(AS_IS)))}"
    )
