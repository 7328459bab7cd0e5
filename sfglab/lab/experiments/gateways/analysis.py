"""From the log to tables and claims; computed from the log alone."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from sfglab.lab.claims import How, Measured
from sfglab.lab.stats import Estimate
from sfglab.record import LogReader

if TYPE_CHECKING:
    from pathlib import Path

    import pandas as pd


@dataclass(frozen=True, slots=True, kw_only=True)
class Results:
    """The tables of one run."""

    explorations: pd.DataFrame  #: One line a bound.
    #: The same of a core that does not claim the hardware's topic; none in logs of before.
    unclaimed: pd.DataFrame
    checks: pd.DataFrame  #: Coverage, and bent arrows.
    stages: pd.DataFrame  #: The stages of Fig. 8.
    config: dict[str, Any]  #: The run's configuration.


def load_results(log: Path) -> Results:
    """Read a run's tables.

    Args:
        log: The log.
    """
    with LogReader(log) as reader:
        tables = {name: reader.table(name).drop(columns="log_time_ns") for name in reader.tables}
        return Results(
            explorations=tables["exploration"],
            unclaimed=tables.get("unclaimed", tables["exploration"].iloc[:0]),
            checks=tables["check"],
            stages=tables["stage"],
            config=reader.metadata("config"),
        )


def measure_claims(log: Path) -> dict[str, Measured]:
    """Return our figures for the claims that this experiment answers, by claim id."""
    results = load_results(log)
    return {"C-FSM": _core_claim(results), "C-MAP": _mapping_claim(results)}


def _core_claim(results: Results) -> Measured:
    explorations, coverage = results.explorations, results.checks.iloc[0]
    held = (explorations["violation"] == "").sum() + coverage["held"]
    share = float(held / (len(explorations) + coverage["checked"]))
    details = {
        "bounds explored": str(len(explorations)),
        "worlds": str(int(explorations["worlds"].sum())),
        "states that occur": f"{coverage['held']} of {coverage['checked']}",
    }
    if len(results.unclaimed):
        details["beyond the text"] = _why_it_claims(results.unclaimed)
    if len(results.checks) > 1:
        bent = results.checks.iloc[1]
        details["bent tables that are caught"] = f"{bent['held']} of {bent['checked']}"
    estimate = Estimate(value=share, low=share, high=share, unit="share of checks that hold")
    return Measured(estimate=estimate, how=How.EXACT, details=details)


def _why_it_claims(unclaimed: pd.DataFrame) -> str:
    found = unclaimed["violation"][unclaimed["violation"] != ""]
    what = f" ({'; '.join(sorted(set(found)))})" if len(found) else ""
    share = f"{len(found)} of {len(unclaimed)} bounds are violated{what}"
    return f"the core claims the hardware's topic before it sends; without that {share}"


def _mapping_claim(results: Results) -> Measured:
    stages = results.stages
    edges = stages["publications"] + stages["subscriptions"]
    details = {
        "edges, by stage": " -> ".join(map(str, edges)),
        "carriages of one message a topic": " -> ".join(f"{carried:g}" for carried in stages["carriages"]),
        "left": str(stages["left"].iloc[-1]),
        "which nodes the edges join": "is in the text only where it says so; the rest is our reading",
    }
    value = float(edges.iloc[-1])
    estimate = Estimate(value=value, low=value, high=value, unit="edges across the boundary")
    return Measured(estimate=estimate, how=How.EXACT, details=details)
