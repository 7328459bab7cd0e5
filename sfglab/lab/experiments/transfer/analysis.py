"""From the log to tables: bars by panel, live times with intervals, residuals of the simulated hardware.

Everything here is computed from the log alone.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from sfglab.lab.stats import bootstrap
from sfglab.record import LogReader
from sfglab.soc.memory import Panel

if TYPE_CHECKING:
    from pathlib import Path

    from sfglab.lab.stats import Estimate


MAIN = "stored"
"""The constants by which claims are judged; the other set is told beside."""

SIDES = {"hardware": "hardware_ns", "software": "software_ns"}
_MS_PER_NS = 1e-6
_TABLES = {
    "bars": "bar",
    "stated": "stated",
    "tendencies": "tendency",
    "constants": "constant",
    "refits": "refit",
    "variants": "variant",
    "laws": "law",
    "cycles": "cycles",
    "areas": "area",
    "live": "crossing",
    "break_even": "break_even",
    "sized": "sized_mapping",
    "placed": "placed",
}
_OPTIONAL = {"laws": "law", "cycles": "cycles", "areas": "area", "live": "crossing"}


@dataclass(frozen=True, slots=True, kw_only=True)
class Results:
    """The tables of one run; those of parts that were left out are empty."""

    bars: pd.DataFrame  #: As `TransferBarRow`, with ``ratio``.
    stated: pd.DataFrame  #: As `StatedRow`, with ``residual``.
    tendencies: pd.DataFrame  #: As `TendencyRow`.
    constants: pd.DataFrame  #: As `ConstantRow`.
    refits: pd.DataFrame  #: As `RefitRow`.
    variants: pd.DataFrame  #: As `VariantRow`.
    laws: pd.DataFrame  #: As `CycleLawRow`.
    cycles: pd.DataFrame  #: As `CycleCheckRow`.
    areas: pd.DataFrame  #: As `AreaRow`.
    live: pd.DataFrame  #: As `CrossingRow`.
    break_even: pd.DataFrame  #: As `BreakEvenRow`.
    sized: pd.DataFrame  #: As `SizedMappingRow`.
    placed: pd.DataFrame  #: As `PlacedRow`.
    config: dict[str, Any]  #: The run's configuration.
    machine: dict[str, Any]  #: Its machine.
    missing: dict[str, Any]  #: Which parts were left out, and why.


def load_results(log: Path) -> Results:
    """Read a run's tables.

    Args:
        log: The log.
    """
    with LogReader(log) as reader:
        found: dict[str, pd.DataFrame] = {
            name: reader.table(table).drop(columns="log_time_ns")
            if table in reader.tables or name not in _OPTIONAL
            else pd.DataFrame()
            for name, table in _TABLES.items()
        }
        config, machine = reader.metadata("config"), reader.metadata("run")["machine"]
        missing = reader.metadata("missing")
    found["bars"] = found["bars"].assign(ratio=lambda t: t["smt_s"] / t["gateway_s"])
    found["stated"] = found["stated"].assign(residual=lambda t: t["found"] / t["stated"] - 1)
    return Results(**found, config=config, machine=machine, missing=missing)


def bars_of(
    results: Results, panel: Panel, *, model: str = MAIN, subscribers: int | None = None
) -> pd.DataFrame:
    """Return a panel's bars, by subscribers and size; empty where that model has none.

    Args:
        results: The run.
        panel: From whom to whom.
        model: Which set of constants, or ``rtl``.
        subscribers: Only those of this number of hardware nodes.
    """
    table = results.bars
    chosen = table[(table["model"] == model) & (table["panel"] == panel.value)]
    if subscribers is not None:
        chosen = chosen[chosen["subscribers"] == subscribers]
    return chosen.sort_values(["subscribers", "message_bytes"])


def live_speed_up(results: Results, panel: Panel, subscribers: int, message_bytes: int) -> Estimate | None:
    """Return the ratio of the medians of both transports across processes; None: it was not measured.

    Repetitions, in which both were measured right after each other, are resampled as pairs.

    Args:
        results: The run.
        panel: From whom to whom.
        subscribers: Processes on the hardware's side.
        message_bytes: Size of the message.
    """
    pairs = _pairs(results, panel, subscribers, message_bytes)
    if pairs.empty:
        return None

    def ratio(groups: Any) -> float:
        smt, gateway = np.median(groups[0], axis=0)
        return float(smt / gateway)

    return bootstrap([pairs[["smt", "gateway"]].to_numpy(dtype=np.float64)], ratio, unit="times as fast")


def _pairs(results: Results, panel: Panel, subscribers: int, message_bytes: int) -> pd.DataFrame:
    """Return ns over both transports, a line a repetition."""
    publisher, receiver = panel.value.split(" to ")
    table = results.live
    if table.empty:
        return pd.DataFrame({"smt": [], "gateway": []})
    chosen = table[
        (table["publisher"] == publisher)
        & (table["subscribers"] == subscribers)
        & (table["message_bytes"] == message_bytes)
    ]
    return chosen.pivot_table(index="repeat", columns="transport", values=SIDES[receiver]).reindex(
        columns=["smt", "gateway"]
    )


def live_table(results: Results) -> pd.DataFrame:
    """Return every live cell: both medians in ms, speed-up with interval, the model's, repetitions."""
    lines = []
    for panel in Panel:
        for count, size in _cells(results):
            cell = _pairs(results, panel, count, size)
            medians = cell[["smt", "gateway"]].median() * _MS_PER_NS
            speed_up = live_speed_up(results, panel, count, size)
            bar = bars_of(results, panel, subscribers=count).set_index("message_bytes")["ratio"]
            assert speed_up, "the cell was measured"
            lines.append(
                {
                    "panel": panel.value,
                    "subscribers": count,
                    "message_bytes": size,
                    "smt_ms": float(medians["smt"]),
                    "gateway_ms": float(medians["gateway"]),
                    "speed_up": speed_up.value,
                    "low": speed_up.low,
                    "high": speed_up.high,
                    "model": float(bar.get(size, np.nan)),
                    "repeats": len(cell),
                }
            )
    return pd.DataFrame(lines)


def live_agreement(table: pd.DataFrame) -> tuple[int, int, int]:
    """Return how many bars there are, how many of them say which is faster, and how many as the model does.

    A transport is faster where the whole interval lies on one side of 1.

    Args:
        table: As from `live_table`.
    """
    decided = table[(table["low"] > 1) | (table["high"] < 1)]
    same = (decided["speed_up"] > 1) == (decided["model"] > 1)
    return len(table), len(decided), int(same.sum())


def _cells(results: Results) -> list[tuple[int, int]]:
    """Return subscribers and sizes that were measured."""
    known = (
        results.live[["subscribers", "message_bytes"]]
        .drop_duplicates()
        .sort_values(["subscribers", "message_bytes"])
    )
    return [(int(count), int(size)) for count, size in known.to_numpy()]


def live_note(results: Results) -> str:
    """Return under which conditions the live part ran."""
    if results.live.empty:
        return "nothing ran live"
    cores, most = results.machine["usable_cores"], results.live["subscribers"].max()
    load, times = results.live["load"].median(), results.live["repeat"].nunique()
    waits = f"; up to {most + 3} processes share them, so they wait for each other" if most + 3 > cores else ""
    return f"{cores} cores of {results.machine['cpu']}{waits}; {times} repetitions, load {load:.1f}"


def memory_speed_ups(results: Results) -> pd.DataFrame:
    """Return the speed-up of the memory part alone, for long messages, from the hardware's cycles of a chunk.

    Towards hardware: all readers' turns against one read and a broadcast; from hardware, with the write before.
    """
    lines = []
    for count, group in results.laws.groupby("subscribers"):
        chunk = group.set_index("path")["chunk_cycles"]
        reads, write = chunk["shared reads"], chunk["write"]
        lines.append(
            {
                "subscribers": count,
                "hardware to hardware": (write + reads) / chunk["gateway, stream to memory"],
                "software to hardware": reads / chunk["gateway, memory to stream"],
            }
        )
    return pd.DataFrame(lines)


def rtl_residual(results: Results) -> float | None:
    """Return the largest |model / hardware - 1| where the hardware was simulated; None: nowhere."""
    if results.cycles.empty:
        return None
    ran = results.cycles[results.cycles["simulated"]]
    return float((ran["model_cycles"] / ran["rtl_cycles"] - 1).abs().max())
