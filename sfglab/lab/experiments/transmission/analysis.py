"""Latency and loss by cell, the paper's order of methods against ours, and the claims, computed from a run."""

from __future__ import annotations

from functools import partial
from typing import Any, Literal

import pandas as pd

from sfglab.arp.hello import BEST, OPT_DEPTH, SMALL_DEPTH, TIE, rate_and_depth, scenario_of
from sfglab.arp.robots import DEPTHS, METHODS, RATES_HZ
from sfglab.lab.claims import Finding, How
from sfglab.lab.experiments.transmission.experiment import (
    Config,
    exp,
    grid,
)
from sfglab.lab.runs import Run, derived, lines_of
from sfglab.lab.stats import exactly
from sfglab.qos import Durability, History, Liveliness, Reliability
from sfglab.units import NS_PER_S


@derived
def agreement(run: Run[Config]) -> dict[str, str]:
    """Return how many live cells agree with the model, of those that kept to their schedules."""
    fair = run["live"][run["live"]["kept_up"].astype(bool)]
    counts = {
        "loss within 3 points": fair["loss_agrees"],
        "median latency within 30 %": fair["latency_agrees"],
    }
    return {what: f"{int(agrees.sum())} of {len(agrees)}" for what, agrees in counts.items()}


@derived
def cells(run: Run[Config], column: str, table: str = "cell") -> pd.DataFrame:
    """Return median, lowest and highest over seeds of a column or of ``loss``, a line a cell.

    The table ``lossless`` has one seed, over an air that loses nothing.
    """
    rows = run[table].assign(loss=1 - run[table]["arrived"] / run[table]["published"])
    grouped = rows.groupby(["rate_max_hz", "depth", "method"], sort=False)[column]
    return grouped.agg(["median", "min", "max"]).reset_index()


@derived
def order(run: Run[Config], column: str, *, tie: float = 0.0, table: str = "cell") -> pd.DataFrame:
    """Compare the paper's order of methods with ours, a line an Rmax, as `order_of` does, by `cells`."""
    by_rate = cells(run, column, table).groupby("rate_max_hz")
    return pd.DataFrame(
        [{"rate_max_hz": rate, **order_of(part, tie=tie)} for rate, part in by_rate]
    )


def order_of(table: pd.DataFrame, *, tie: float = 0.0) -> dict[str, Any]:
    """Compare the paper's order of methods with ours at one Rmax.

    The paper's winner at the depth that Eq. 6 gives is compared with the methods that lack its optimisation, at
    every depth of Table 2, and with those that lack its local cache, at its own depth. Of each cell there are
    ``depth``, ``method`` and ``median``; within the share `tie` another counts as equal.

    Returns:
        ``best`` (the winner's value), ``lowest`` (the lowest of the others), ``wins``; and ``highest_method``,
        ``highest_depth``, ``highest`` (the cell with the highest value) and ``small_is_worst``.
    """
    optimised = table["method"].map(lambda name: METHODS[name].optimised)
    cached = table["method"].map(lambda name: METHODS[name].local_cache)
    at_optimum = table["depth"] == OPT_DEPTH
    best = float(table[(table["method"] == BEST) & at_optimum]["median"].iloc[0])
    others = table[(~optimised & ~at_optimum) | (optimised & ~cached & at_optimum)]["median"].min()
    worst = table.iloc[int(table["median"].argmax())]
    small = worst["depth"] != OPT_DEPTH and int(worst["depth"]) <= SMALL_DEPTH
    return {
        "best": best,
        "lowest": others,
        "wins": best <= others * (1 + tie),
        "highest_method": worst["method"],
        "highest_depth": worst["depth"],
        "highest": worst["median"],
        "small_is_worst": small and not METHODS[worst["method"]].optimised,
    }


@derived
def compare_ways(
    run: Run[Config], column: str, of: Literal["mean", "min", "max"] = "mean"
) -> pd.DataFrame:
    """Return means, or ``min``, of a column of `BeyondRow` over seeds, a line an Rmax and a column a way."""
    return run["beyond"].pivot_table(
        index="rate_max_hz", columns="way", values=column, sort=False, aggfunc=of
    )


_T_AVG = (8 + 5 + 5) / 3  # topics of section 3.1's robots: their sensors, and two of "Hello"


def as_in_table_2(cell: Any, duration_s: float) -> bool:
    """Return whether a row of the grid has the rate and depth of Table 2, and published so.

    ``opt`` is written from Eq. 3 to 6 and section 3.1, apart from the code that ran: R is Rmax / Tavg - Rmin,
    D is 5000 R / Rmax - Dmin, Rmin and Dmin 1. R is the rate of methods with OPT, D the depth ``opt``.
    """
    optimum_hz = cell.rate_max_hz / _T_AVG - 1
    rate_hz = optimum_hz if "OPT" in cell.method else cell.rate_max_hz
    depth = (
        int(5000 * optimum_hz / cell.rate_max_hz - 1)
        if cell.depth == OPT_DEPTH
        else int(cell.depth)
    )
    right = (abs(cell.rate_hz - rate_hz) < 1e-6 * rate_hz, cell.history_depth == depth)
    return all(right) and abs(cell.published - rate_hz * duration_s) <= 1


def _policies(config: Config) -> dict[str, bool]:
    """Return whether every flow of every cell offers Table 2's policies: the grid once more, not run."""
    flows = [
        (flow.qos, rate_and_depth(p)[0]) for p in grid(config) for flow in scenario_of(p).flows
    ]
    return {
        "RELIABLE": all(qos.reliability is Reliability.RELIABLE for qos, _ in flows),
        "KEEP_LAST": all(qos.history is History.KEEP_LAST for qos, _ in flows),
        "VOLATILE": all(qos.durability is Durability.VOLATILE for qos, _ in flows),
        "AUTOMATIC": all(qos.liveliness is Liveliness.AUTOMATIC for qos, _ in flows),
        "DEADLINE is the rate": all(
            qos.deadline_ns == round(NS_PER_S / rate_hz) for qos, rate_hz in flows
        ),
    }


@exp.claim("B-TAB2", how=How.SIMULATED)
def share_of_grid(run: Run[Config]) -> Finding:
    """Return how much of the paper's grid was run as Table 2 has it; none of it with other policies."""
    depths = (*map(str, DEPTHS), OPT_DEPTH)
    asked = {(rate, depth, method) for rate in RATES_HZ for depth in depths for method in METHODS}
    wrong = {
        (row.rate_max_hz, row.depth, row.method)
        for row in run["cell"].itertuples()
        if not as_in_table_2(row, run.config.duration_s)
    }
    done = set(run["cell"][["rate_max_hz", "depth", "method"]].itertuples(index=False, name=None))
    policies = _policies(run.config)
    details = {
        "cells": str(len(done)),
        "with another rate, depth or number of messages than Table 2's": str(len(wrong)),
        "policies of every flow": ", ".join(policies),
        "seeds": str(run["cell"]["seed"].nunique()),
        "simulated seconds a cell": str(run.config.duration_s),
    }
    share = len(asked & done - wrong) / len(asked) if all(policies.values()) else 0.0
    reasons = [f"not as in Table 2: {cell}" for cell in sorted(wrong)[:3]]
    reasons += [f"policy: not {name}" for name, held in policies.items() if not held]
    estimate = exactly(share, "share of the grid that was run as printed")
    return Finding(estimate=estimate, details=details, reason="; ".join(reasons))


def _order_finding(run: Run[Config], *, column: str, tie: float = 0.0) -> Finding:
    """Return the share of rates at which latencies, or losses, have the paper's order."""
    table, lossless = (order(run, column, tie=tie, table=name) for name in ("cell", "lossless"))
    wins, small = int(table["wins"].sum()), int(table["small_is_worst"].sum())
    highest = [
        f"{r.rate_max_hz} Hz: {r.highest_method}, depth {r.highest_depth}" for r in lines_of(table)
    ]
    worst = "; ".join(highest)
    details = {
        f"{BEST} is lowest": f"at {wins} of {len(table)} rates",
        "full rate with a small depth is highest": f"at {small} of {len(table)} rates",
        "highest": worst,
        "were the air without losses": f"{BEST} lowest at {int(lossless['wins'].sum())}, a small depth highest "
        f"at {int(lossless['small_is_worst'].sum())} of {len(lossless)} rates",
    }
    reasons = []
    if wins < len(table):
        reasons.append(
            f"{BEST} is lowest at {wins} of {len(table)} rates: histories as deep as Eq. 6 wants them never "
            "fill, so that repairs wait for heartbeats, 3 s apart"
        )
    if small < len(table):
        reasons.append(
            f"a small depth is not what is highest ({worst}): on a saturated link a deep history keeps old "
            "samples in front of new ones"
        )
    share = float((table["wins"] & table["small_is_worst"]).mean())
    estimate = exactly(share, "share of rates with this order")
    return Finding(estimate=estimate, details=details, reason="; ".join(reasons))


exp.claim("B-LAT", how=How.SIMULATED)(partial(_order_finding, column="latency_p50_ms", tie=TIE))
exp.claim("B-LOSS", how=How.SIMULATED)(partial(_order_finding, column="loss"))
