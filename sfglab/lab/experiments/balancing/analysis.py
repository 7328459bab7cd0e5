"""From the log to figures: what the caches save, how long a value is stale, and the claims."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from sfglab.lab.claims import How, Measured
from sfglab.lab.stats import Estimate
from sfglab.record import LogReader

if TYPE_CHECKING:
    from pathlib import Path

    import pandas as pd


TABLES = ("table_one", "cache", "check", "stale", "shown", "balance", "front")


@dataclass(frozen=True, slots=True, kw_only=True)
class Results:
    """The tables of one run, as `rows` describes them."""

    table_one: pd.DataFrame  #: Table 1 beside what is sent.
    cache: pd.DataFrame  #: What the caches did with readings.
    check: pd.DataFrame  #: Properties, how often checked and how often held.
    stale: pd.DataFrame  #: Runs over links with losses.
    shown: pd.DataFrame  #: Courses of examples.
    balance: pd.DataFrame  #: Eq. 6 solved twice.
    front: pd.DataFrame  #: Points of the Pareto front of our own problem.
    config: dict[str, Any]  #: The run's configuration.


def load_results(log: Path) -> Results:
    """Read a run's tables.

    Args:
        log: The log.
    """
    with LogReader(log) as reader:
        tables = {name: reader.table(name).drop(columns="log_time_ns") for name in TABLES}
        return Results(**tables, config=reader.metadata("config"))


def saved(results: Results, *, silence_s: float = 0.0) -> pd.DataFrame:
    """Return the share of readings that were held back, a line a sensor and a column a rate.

    Args:
        results: The run.
        silence_s: Longest silence of the local cache; 0: none.
    """
    cache = results.cache[results.cache["silence_s"] == silence_s]
    cache = cache.assign(held=1 - cache["sent"] / cache["offered"])
    return cache.pivot_table(index="sensor", columns="rate_hz", values="held", sort=False)


def staleness(results: Results) -> pd.DataFrame:
    """Return means over seeds of staleness and load, a line for each QoS and longest silence."""
    columns = ["messages_hz", "stale_share", "longest_s"]
    return results.stale.groupby(["qos", "silence_s"])[columns].mean().reset_index()


def measure_claims(log: Path) -> dict[str, Measured]:
    """Return our figures for the claims that this experiment answers, by claim id."""
    results = load_results(log)
    return {
        "B-LC": _checked(results, "LC", _cache_details(results, "sent", "messages sent")),
        "B-CC": _checked(results, "CC", _cache_details(results, "planned", "messages planned with")),
        "B-OPT": _checked(results, "OPT", _balance_details(results)),
        "B-TAB1": _table_one(results),
    }


def _checked(results: Results, prefix: str, details: dict[str, str]) -> Measured:
    checks = results.check[results.check["check"].str.startswith(prefix + ":")]
    counts = {"checks": str(int(checks["checked"].sum())), "properties": str(len(checks))}
    share = float(checks["held"].sum() / checks["checked"].sum())
    estimate = Estimate(value=share, low=share, high=share, unit="share of checks that hold")
    return Measured(estimate=estimate, how=How.EXACT, details={**counts, **details})


def _cache_details(results: Results, column: str, what: str) -> dict[str, str]:
    cache = results.cache[results.cache["silence_s"] == 0.0]
    by_rate = cache.groupby("rate_hz")[["offered", column]].sum()
    shares = 1 - by_rate[column] / by_rate["offered"]
    text = ", ".join(f"{share:.0%} at {rate} Hz" for rate, share in shares.items())
    return {f"fewer {what}": text, "readings": str(int(cache["offered"].sum()))}


def _balance_details(results: Results) -> dict[str, str]:
    balance = results.balance
    found = balance[balance["solvable"]]
    worst = ((found["depth"] - found["depth_closed"]).abs() / found["depth_closed"]).max()
    return {
        "problems": str(len(balance)),
        "without a solution": str(int((~balance["solvable"]).sum())),
        "largest relative difference of D": f"{worst:.1e}",
    }


def _table_one(results: Results) -> Measured:
    table = results.table_one
    share = float((table["table_bytes"] == table["object_bytes"]).mean())
    estimate = Estimate(value=share, low=share, high=share, unit="share of messages that match")
    sizes = ", ".join(f"{row.sensor} {row.table_bytes}/{row.cdr_bytes}" for row in table.itertuples())
    details = {
        "paper's bytes / CDR on the wire": sizes,
        "what the paper's bytes are": "the size of the value as a Python object",
    }
    return Measured(estimate=estimate, how=How.EXACT, details=details)
