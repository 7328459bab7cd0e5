"""From the log to figures: success rates by method and rate, how runs failed, and the claim.

Everything here is computed from the log alone.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from sfglab.arp.hallway import End
from sfglab.arp.robots import METHODS
from sfglab.lab.claims import How, Measured
from sfglab.lab.stats import Estimate, bootstrap
from sfglab.record import LogReader

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    import pandas as pd
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]


AS_IS = "Fast DDS, 1 % loss"
_Z = 1.959963984540054  # of 95 %


@dataclass(frozen=True, slots=True, kw_only=True)
class Results:
    """The tables of one run."""

    courses: pd.DataFrame  #: One line a run, with ``success``.
    contrasts: pd.DataFrame | None  #: The same of the contrasts; None without any.
    tracks: pd.DataFrame | None  #: Where robots were, in the runs that are drawn; None without any.
    examples: dict[str, Any]  #: The drawn runs' lines by name.
    config: dict[str, Any]  #: The run's configuration.
    live: dict[str, Any]  #: What is to be said of the live drive.


def load_results(log: Path) -> Results:
    """Read a run's tables.

    Args:
        log: The log.
    """
    with LogReader(log) as reader:

        def table(name: str) -> pd.DataFrame | None:
            return reader.table(name).drop(columns="log_time_ns") if name in reader.tables else None

        courses, contrasts = table("course"), table("contrast")
        assert courses is not None, "a run has courses"
        return Results(
            courses=_judged(courses),
            contrasts=None if contrasts is None else _judged(contrasts),
            tracks=table("track"),
            examples=reader.metadata("examples"),
            config=reader.metadata("config"),
            live=reader.metadata("live"),
        )


def _judged(rows: pd.DataFrame) -> pd.DataFrame:
    return rows.assign(success=rows["end"] == End.SUCCESS.value)


def lines_of(table: pd.DataFrame) -> list[Any]:
    """Return a table's lines, each with its columns as attributes."""
    return list(table.itertuples())


def wilson(successes: int, runs: int) -> tuple[float, float]:
    """Return the 95 % interval of a share, which stays sensible at 0 and 1 (E. B. Wilson, JASA 22, 1927).

    Args:
        successes: How often it came off.
        runs: Of how many, 1 at least.
    """
    share, z2 = successes / runs, _Z**2
    middle = (share + z2 / (2 * runs)) / (1 + z2 / runs)
    half = _Z / (1 + z2 / runs) * math.sqrt(share * (1 - share) / runs + z2 / (4 * runs**2))
    # At 0 and 1 an end is the share itself, but for the last bit.
    return max(0.0, min(share, middle - half)), min(1.0, max(share, middle + half))


def rates(courses: pd.DataFrame, *keys: str) -> pd.DataFrame:
    """Return the success rate of each group of runs with its interval, methods in the paper's order.

    Args:
        courses: A line a run.
        keys: Columns that make a group.
    """
    order = {name: number for number, name in enumerate(METHODS)}
    grouped = courses.groupby(list(keys), sort=True)["success"].agg(["sum", "count"])
    table = grouped.rename(columns={"sum": "successes", "count": "runs"}).reset_index()
    if "method" in table:
        table = table.sort_values("method", key=lambda names: names.map(order), kind="stable")
    bounds = [wilson(int(s), int(n)) for s, n in zip(table["successes"], table["runs"], strict=True)]
    return table.assign(
        rate=table["successes"] / table["runs"],
        low=[low for low, _ in bounds],
        high=[high for _, high in bounds],
    ).reset_index(drop=True)


def failures(courses: pd.DataFrame) -> pd.DataFrame:
    """Return how often each method's runs ended how, and by whom: a line a method, a column an end."""
    failed = courses[~courses["success"]]
    who = failed["end"] + failed["robot"].map(lambda robot: f", {robot}" if robot else "")
    counts = failed.assign(how=who).pivot_table(
        index="method", columns="how", values="seed", aggfunc="count", fill_value=0
    )
    counts.insert(0, End.SUCCESS.value, courses.groupby("method")["success"].sum())
    named = counts.reindex([name for name in METHODS if name in set(courses["method"])], fill_value=0)
    named[End.SUCCESS.value] = courses.groupby("method")["success"].sum()
    return named.astype(int)


def staleness(courses: pd.DataFrame) -> pd.DataFrame:
    """Return, by method and Rmax, how runs' messages did: medians over runs, and the success rate."""
    columns = ["rate_hz", "depth_used", "airtime", "beams_lost", "beam_p50_ms", "command_p50_ms", "stale_s"]
    table = courses.groupby(["method", "rate_max_hz", "depth"], sort=True)[[*columns, "success"]]
    return table.agg({**dict.fromkeys(columns, "median"), "success": "mean"}).reset_index()


def contrasts(results: Results) -> pd.DataFrame | None:
    """Return success rates by method, as they are and in each contrast, at the rates contrasted.

    Args:
        results: The run.

    Returns:
        A line a method, or None where nothing was contrasted.
    """
    import pandas as pd

    if results.contrasts is None:
        return None
    more = results.contrasts
    fast, courses = more["vendor"] == "fast_dds", results.courses
    for column in ("method", "rate_max_hz"):
        courses = courses[courses[column].isin(set(more[column]))]
    kinds = {
        AS_IS: courses,
        "no loss": more[fast & (more["loss"] == 0.0)],
        "Cyclone DDS": more[~fast],
        "rate of Eq. 6, depth 10": more[fast & (more["loss"] > 0.0)],
    }
    parts = [rates(rows, "method").assign(kind=kind) for kind, rows in kinds.items()]
    return pd.concat(parts).pivot_table(index="method", columns="kind", values="rate", sort=False)


def difference(courses: pd.DataFrame, better: str = "OPT+LC", worse: str = "none") -> Estimate:
    """Return by how much a method's success rate exceeds another's, averaged over Rmax.

    Args:
        courses: A line a run.
        better: The method.
        worse: The other one; its depths count alike.
    """
    groups = [
        runs["success"].to_numpy(dtype=np.float64)
        for method in (better, worse)
        for _, runs in courses[courses["method"] == method].groupby("rate_max_hz")
    ]
    half = len(groups) // 2

    def exceeds(drawn: Sequence[Floats]) -> float:
        means = [float(group.mean()) for group in drawn]
        return float(np.mean(means[:half]) - np.mean(means[half:]))

    return bootstrap(groups, exceeds, unit="success rate difference")


def measure_claims(log: Path) -> dict[str, Measured]:
    """Return our figure for the claim that this experiment answers, by claim id."""
    results = load_results(log)
    courses = results.courses
    estimate = difference(courses)
    return {
        "B-COOP": Measured(
            estimate=estimate, how=How.SIMULATED, details=_details(results), reason=_reason(results)
        )
    }


def _details(results: Results) -> dict[str, str]:
    courses = results.courses
    by_method = rates(courses, "method")
    details = {
        f"success, {row.method}": f"{row.rate:.2f} [{row.low:.2f}, {row.high:.2f}] of {row.runs} runs"
        for row in lines_of(by_method)
    }
    compared = courses[courses["method"].isin(("none", "OPT+LC"))]
    for row in lines_of(rates(compared, "method", "rate_max_hz")):
        details[f"success, {row.method}, Rmax {row.rate_max_hz} Hz"] = f"{row.successes} of {row.runs}"
    for method, counts in failures(courses).iterrows():
        said = [f"{how} {count}" for how, count in counts.items() if count and how != End.SUCCESS.value]
        if said:
            details[f"failures, {method}"] = "; ".join(said)
    table = contrasts(results)
    if table is not None:
        for method, shares in table.iterrows():
            said = [f"{kind} {share:.2f}" for kind, share in shares.dropna().items()]
            details[f"contrasts, {method}"] = "; ".join(said)
    details |= {f"live, {key}": str(value) for key, value in results.live.items()}
    return details


def _reason(results: Results) -> str:
    """Say why OPT+LC is not always successful, from the runs that were not, and when it would be."""
    courses = results.courses
    failed = courses[(courses["method"] == "OPT+LC") & ~courses["success"]]
    if failed.empty:
        return ""
    return (
        f"in the runs that OPT+LC lost, something was out of date for up to {failed['stale_s'].median():.1f} s "
        f"(median): at a depth of {int(failed['depth_used'].median())} the history is seldom full, so a lost "
        "message is missed only with the next heartbeat, every 3 s, and RELIABLE holds back all that follow it"
        + _were_it_else(results)
    )


def _were_it_else(results: Results) -> str:
    table = contrasts(results)
    if table is None or "OPT+LC" not in table.index:
        return ""
    others = table.loc["OPT+LC"].drop(AS_IS).dropna()
    return "; success of OPT+LC else: " + ", ".join(f"{kind} {share:.2f}" for kind, share in others.items())
