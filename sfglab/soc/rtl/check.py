"""Laws of the hardware beside the model of the memory interface, as rows: each path, number of nodes and size.

The paths of paper C, section 4, that cross the memory interface. Where a law says more than a simulation can
reach, `check_law` simulates a feasible size and says how far law and model are off. Hardware and model have the
same control cycles and latencies: agreement says that the model adds them up rightly (turns lose no time, a
stored chunk costs both sides), not that another implementation takes as many. Knows paths and laws; refuses to
know what a bench is.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from typing import TYPE_CHECKING

from sfglab.soc.memory import MemoryInterface
from sfglab.soc.rtl.cycles import CycleLaw, Delays, Transfer, measured_law, model_cycles, simulate_transfer
from sfglab.soc.rtl.readers import (
    Reading,
    measured_readers_law,
    measured_writer_law,
    model_reading_cycles,
    simulate_readers,
)

if TYPE_CHECKING:
    from collections.abc import Sequence


class MemoryPath(Enum):
    """What a message does at the memory interface."""

    GATEWAY_OUT = "gateway, memory to stream"
    """Read once by the core, and broadcast to all nodes."""
    GATEWAY_IN = "gateway, stream to memory"
    """Broadcast by a node, and written once by the core."""
    SHARED_READS = "shared reads"
    """Read by every node, chunk by chunk in turn."""
    WRITE = "write"
    """Written once by a node; the number of nodes does not matter."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PathCycles:
    """Cycles of a message by law and model."""

    path: MemoryPath  #: What the message does.
    nodes: int  #: Hardware nodes that receive it.
    message_bytes: int  #: Its size.
    law_cycles: float  #: By the law of the simulated hardware.
    model_cycles: float  #: By the model.
    residual: float  #: Model over law, less 1.


@dataclass(frozen=True, slots=True, kw_only=True)
class LawCheck:
    """Cycles of a message in simulation, by law and by model."""

    path: MemoryPath  #: What the message does.
    nodes: int  #: Hardware nodes that receive it.
    message_bytes: int  #: Its size.
    simulated_cycles: int  #: Of the hardware.
    law_cycles: float  #: By the law that smaller messages gave.
    model_cycles: float  #: By the model.
    law_residual: float  #: Law over simulation, less 1.
    model_residual: float  #: Model over simulation, less 1.


def path_law(path: MemoryPath, nodes: int, delays: Delays | None = None) -> CycleLaw:
    """Simulate two small messages and return the law through them.

    Args:
        path: What the message does.
        nodes: Hardware nodes that receive it.
        delays: Of the memory.
    """
    if path is MemoryPath.SHARED_READS:
        return measured_readers_law(nodes, delays)
    if path is MemoryPath.WRITE:
        return measured_writer_law(delays)
    return measured_law(nodes, from_software=path is MemoryPath.GATEWAY_OUT, delays=delays)


def path_cycles(
    path: MemoryPath, nodes: int, sizes_bytes: Sequence[int], delays: Delays | None = None
) -> list[PathCycles]:
    """Return the cycles of messages of any size, by law and by the model with the same delays.

    Args:
        path: What the message does.
        nodes: Hardware nodes that receive it.
        sizes_bytes: Of the messages.
        delays: Of the memory.
    """
    law = path_law(path, nodes, delays)
    rows = []
    for size in sizes_bytes:
        given, modelled = law.cycles(size), _modelled(path, nodes, size, delays)
        rows.append(
            PathCycles(
                path=path,
                nodes=nodes,
                message_bytes=size,
                law_cycles=given,
                model_cycles=modelled,
                residual=modelled / given - 1,
            )
        )
    return rows


def check_law(
    path: MemoryPath, nodes: int, message_bytes: int = 100_000, delays: Delays | None = None
) -> LawCheck:
    """Simulate a message far larger than those of the law; 100 kB take some seconds, 1 MB minutes.

    Args:
        path: What the message does.
        nodes: Hardware nodes that receive it; their reads take a time that grows with their square.
        message_bytes: A multiple of 8.
        delays: Of the memory.

    Raises:
        HardwareError: A word is wrong, or the message did not arrive.
    """
    simulated = _simulated(path, nodes, message_bytes, delays or Delays())
    row = path_cycles(path, nodes, [message_bytes], delays)[0]
    return LawCheck(
        path=path,
        nodes=nodes,
        message_bytes=message_bytes,
        simulated_cycles=simulated,
        law_cycles=row.law_cycles,
        model_cycles=row.model_cycles,
        law_residual=row.law_cycles / simulated - 1,
        model_residual=row.model_cycles / simulated - 1,
    )


def _simulated(path: MemoryPath, nodes: int, message_bytes: int, delays: Delays) -> int:
    if path in (MemoryPath.GATEWAY_OUT, MemoryPath.GATEWAY_IN):
        out = path is MemoryPath.GATEWAY_OUT
        transfer = Transfer(message_bytes=message_bytes, subscribers=nodes, from_software=out, delays=delays)
        return simulate_transfer(transfer).cycles
    written = path is MemoryPath.WRITE
    reading = Reading(
        message_bytes=message_bytes, readers=1 if written else nodes, written=written, delays=delays
    )
    found = simulate_readers(reading)
    return found.write_cycles if written else found.read_cycles


def _modelled(path: MemoryPath, nodes: int, message_bytes: int, delays: Delays | None) -> float:
    given = delays or Delays()
    memory = MemoryInterface(read_latency_cycles=given.read, write_latency_cycles=given.write)
    if path is MemoryPath.SHARED_READS:
        return model_reading_cycles(message_bytes, [0] * nodes, memory)
    if path is MemoryPath.WRITE:
        return memory.write_s(message_bytes) * memory.clock_hz
    return model_cycles(message_bytes, from_software=path is MemoryPath.GATEWAY_OUT, memory=memory)
