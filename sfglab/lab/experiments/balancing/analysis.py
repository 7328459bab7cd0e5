"""Savings of the caches, staleness of values, and the claims, computed from a run."""

from __future__ import annotations

from typing import TYPE_CHECKING

from sfglab.lab.claims import Finding, How
from sfglab.lab.experiments.balancing.experiment import Config, exp
from sfglab.lab.runs import Run, derived
from sfglab.lab.stats import exactly

if TYPE_CHECKING:
    import pandas as pd


@derived
def saved(run: Run[Config], *, silence_s: float = 0.0) -> pd.DataFrame:
    """Return the share of readings that were held back, a line a sensor and a column a rate.

    Args:
        run: The run.
        silence_s: Longest silence of the local cache; 0: none.
    """
    cache = run["cache"][run["cache"]["silence_s"] == silence_s]
    cache = cache.assign(held=1 - cache["sent"] / cache["offered"])
    return cache.pivot_table(index="sensor", columns="rate_hz", values="held", sort=False)


@derived
def staleness(run: Run[Config]) -> pd.DataFrame:
    """Return means over seeds of staleness and load, a line for each QoS and longest silence."""
    columns = ["messages_hz", "stale_share", "longest_s"]
    return run["stale"].groupby(["qos", "silence_s"])[columns].mean().reset_index()


@exp.claim("B-LC", how=How.EXACT)
def local_cache(run: Run[Config]) -> Finding:
    """Return the share of checks of the local cache that hold."""
    return _checked(run, "LC", _cache_details(run, "sent", "messages sent"))


@exp.claim("B-CC", how=How.EXACT)
def cache_control(run: Run[Config]) -> Finding:
    """Return the share of checks of cache control that hold."""
    return _checked(run, "CC", _cache_details(run, "planned", "messages planned with"))


@exp.claim("B-OPT", how=How.EXACT)
def optimum(run: Run[Config]) -> Finding:
    """Return the share of checks of Eq. 1 to 6 that hold."""
    balance = run["balance"]
    found = balance[balance["solvable"]]
    worst = ((found["depth"] - found["depth_closed"]).abs() / found["depth_closed"]).max()
    details = {
        "problems": str(len(balance)),
        "without a solution": str(int((~balance["solvable"]).sum())),
        "largest relative difference of D": f"{worst:.1e}",
    }
    return _checked(run, "OPT", details)


@exp.claim("B-TAB1", how=How.EXACT)
def table_one(run: Run[Config]) -> Finding:
    """Return the share of sizes that are Table 1's."""
    table = run["table_one"]
    sizes = ", ".join(f"{row.sensor} {row.table_bytes}/{row.cdr_bytes}" for row in table.itertuples())
    details = {
        "paper's bytes / CDR on the wire": sizes,
        "what the paper's bytes are": "the size of the value as a Python object",
    }
    share = float((table["table_bytes"] == table["object_bytes"]).mean())
    return Finding(estimate=exactly(share, "share of messages that match"), details=details)


def _checked(run: Run[Config], prefix: str, details: dict[str, str]) -> Finding:
    checks = run["check"][run["check"]["check"].str.startswith(prefix + ":")]
    counts = {"checks": str(int(checks["checked"].sum())), "properties": str(len(checks))}
    share = float(checks["held"].sum() / checks["checked"].sum())
    return Finding(estimate=exactly(share, "share of checks that hold"), details={**counts, **details})


def _cache_details(run: Run[Config], column: str, what: str) -> dict[str, str]:
    cache = run["cache"][run["cache"]["silence_s"] == 0.0]
    by_rate = cache.groupby("rate_hz")[["offered", column]].sum()
    shares = 1 - by_rate[column] / by_rate["offered"]
    text = ", ".join(f"{share:.0%} at {rate} Hz" for rate, share in shares.items())
    return {f"fewer {what}": text, "readings": str(int(cache["offered"].sum()))}
