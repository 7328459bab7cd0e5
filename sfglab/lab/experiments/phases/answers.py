"""Answers to what the criteria of B-LAT, B-LOSS and B-COOP (``data/claims.yaml``) ask, in one condition each.

Where the criteria leave a choice, this is their literal reading. The median is over all "Hello"s of all seeds,
what never arrives being infinite; where OPT+LC's is infinite the condition does not agree. Intervals reach from
the lowest seed's median to the highest: of six seeds, that has the median with 97 %.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from itertools import product
from typing import Any

import numpy as np
import pandas as pd

from sfglab.arp.hallway import End
from sfglab.arp.hello import BEST, OPT_DEPTH, SMALL_DEPTH, TIE
from sfglab.arp.robots import RATES_HZ
from sfglab.lab.claims import Criterion, load_claims
from sfglab.lab.paths import find_project
from sfglab.lab.stats import share_of

DEEP = 100  #: A depth from this on is deep, as the criteria have it.
LOSS_POINT = 0.01  #: By how much OPT+LC may lose more than the lowest and still agree: a point.


@dataclass(frozen=True, slots=True, kw_only=True)
class Place:
    """Where on the map something is."""

    preset: str  #: A mode of publication: a name in `sfglab.rtps.PRESETS`.
    #: Share of frames lost on each crossing; there are two, as an access point is between.
    loss: float
    frame_us: float  #: Cost of a frame on air on each crossing beside its bits, microseconds.
    queue_rule: str = "block"  #: What a full queue of a host does.
    stall_ms: float = 0.0  #: For how long nothing is sent once in `STALL_EVERY_S`.
    rate_max_hz: int  #: Rmax.


PLACE = [f.name for f in fields(Place)]


def criterion() -> Criterion:
    """Return by what B-LAT is judged; its modes and its region are those of B-LOSS and B-COOP, too."""
    [claim] = (claim for claim in load_claims(find_project().claims) if claim.id == "B-LAT")
    assert claim.criterion is not None, "it has one"
    return claim.criterion


def plausible() -> list[tuple[Any, ...]]:
    """Return the places of the criteria in the order of `PLACE`, 27 for each mode and Rmax of Table 2."""
    asked = criterion()
    axes = [
        (low, round(middle(low, high), 6), high)
        for low, high in (asked.region[name] for name in ("loss", "frame_us", "stall_ms"))
    ]
    return [
        (preset, loss, frame_us, "block", stall_ms, rate_hz)
        for preset, loss, frame_us, stall_ms, rate_hz in product(asked.modes, *axes, RATES_HZ)
    ]


def middle(low: float, high: float) -> float:
    """Return the geometric mean, or half of the most where the least is 0."""
    return math.sqrt(low * high) if low else high / 2


ANSWERS = {
    "lc_lowest": "OPT+LC lowest",
    "small_worst": "a small depth worst",
    "completed": "hallway, OPT+LC",
    "completed_none": "hallway, none",
}
"""What is asked of each condition, and what the maps call it."""
_BOTH = {"lc_lowest": "lowest", "small_worst": "small"}


def summary(cells: pd.DataFrame) -> pd.DataFrame:
    """Return the median and its range over seeds, a line a condition, method and depth.

    Columns are ``p50_ms`` (of all seeds together), ``age_ms`` (median over seeds) and ``lost`` (of all seeds,
    with Wilson's interval), each with ``_low`` and ``_high``.
    """
    grouped = cells.groupby([*PLACE, "method", "depth"], sort=False)
    table = grouped[["p50_ms", "age_ms"]].agg(["median", "min", "max"])
    endings = {"median": "", "min": "_low", "max": "_high"}
    table.columns = pd.Index(
        [f"{column[0]}{endings[column[1]]}" for column in table.columns.to_list()]
    )
    table["p50_ms"] = grouped["pooled_ms"].first()
    counts = grouped[["published", "arrived"]].sum()
    lost = [share_of(n - k, n, unit="1") for n, k in counts.to_numpy().tolist()]
    table[["lost", "lost_low", "lost_high"]] = [(one.value, one.low, one.high) for one in lost]
    return table.reset_index()


def answers(cells: pd.DataFrame, courses: pd.DataFrame) -> pd.DataFrame:
    """Return what holds in each condition at each Rmax, a line each, from the two tables of a run.

    Columns are those of `PLACE`; what the criteria of B-LAT and B-LOSS ask: ``latency_lowest``,
    ``loss_lowest``, ``latency_small``, ``loss_small``; ``no_median``: without a method no deep history's median
    is finite, so that no small one's is higher; ages, ``age_ms`` of OPT+LC and ``age_lowest_ms`` of the
    rest; and `ANSWERS`: shares from 0 to 1.
    """
    found = _compared(summary(cells))
    done = courses.assign(done=courses["end"] == End.SUCCESS.value)
    shares = done.assign(best=done["method"] == BEST).pivot_table(
        index=PLACE, columns="best", values="done"
    )
    shares = shares.rename(columns={True: "completed", False: "completed_none"}).reset_index()
    return found.merge(shares, on=PLACE)


def _compared(table: pd.DataFrame) -> pd.DataFrame:
    """Return what the criteria ask of each condition at each Rmax, from a `summary`."""
    is_best, none = (
        (table["method"] == BEST) & (table["depth"] == OPT_DEPTH),
        table["method"] == "none",
    )
    depth = pd.to_numeric(table["depth"], errors="coerce")
    best = table[is_best].set_index(PLACE)
    lowest = table[~is_best].groupby(PLACE, sort=False)[["p50_ms", "lost", "age_ms"]].min()
    small = table[none & (depth <= SMALL_DEPTH)].groupby(PLACE)[["p50_ms_low", "lost_low"]].max()
    deep = (
        table[none & (depth >= DEEP)].groupby(PLACE)[["p50_ms", "p50_ms_high", "lost_high"]].min()
    )
    found = pd.DataFrame(index=best.index)
    found["latency_lowest"] = np.isfinite(best["p50_ms"]) & (
        best["p50_ms"] <= lowest["p50_ms"] * (1 + TIE)
    )
    found["loss_lowest"] = best["lost"] <= lowest["lost"] + LOSS_POINT
    found["latency_small"] = small["p50_ms_low"] > deep["p50_ms_high"]
    found["loss_small"] = small["lost_low"] > deep["lost_high"]
    found["no_median"] = np.isinf(deep["p50_ms"])
    for what, of in _BOTH.items():
        found[what] = (found[f"latency_{of}"].astype(int) + found[f"loss_{of}"]) / 2
    return found.assign(age_ms=best["age_ms"], age_lowest_ms=lowest["age_ms"]).reset_index()
