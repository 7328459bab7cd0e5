"""Cycles of each path across the memory interface (paper C, section 4), in hardware and by the memory model.

The hardware's cycles are simulated, or come from the cycle model through two small messages where a size is
beyond simulation. Hardware and memory model have the same control cycles and latencies: agreement says that the
memory model adds them up rightly (turns lose no time, a stored chunk costs both sides), not that another
implementation takes as many. Refuses to know test benches.
"""

from __future__ import annotations

from enum import Enum

from sfglab.soc.memory import MemoryInterface
from sfglab.soc.rtl.cycles import CycleModel, Delays, Transfer, fitted_cycle_model, simulate_transfer
from sfglab.soc.rtl.readers import Reading, simulate_readers


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


_GATEWAY = (MemoryPath.GATEWAY_OUT, MemoryPath.GATEWAY_IN)


def simulated_cycles(path: MemoryPath, nodes: int, message_bytes: int, delays: Delays | None = None) -> int:
    """Simulate a message of a multiple of 8 bytes; 100 kB take some seconds, 1 MB minutes.

    So many hardware nodes receive it: their reads take a time that grows with their square. Delays are the
    memory's.

    Raises:
        SfglabError: A word is wrong, or the message did not arrive.
    """
    delays = delays or Delays()
    if path in _GATEWAY:
        out = path is MemoryPath.GATEWAY_OUT
        return simulate_transfer(
            Transfer(message_bytes=message_bytes, subscribers=nodes, from_software=out, delays=delays)
        )
    written = path is MemoryPath.WRITE
    readers = 1 if written else nodes
    found = simulate_readers(
        Reading(message_bytes=message_bytes, readers=readers, written=written, delays=delays)
    )
    return found.write_cycles if written else found.read_cycles


def cycle_model(path: MemoryPath, nodes: int, delays: Delays | None = None) -> CycleModel:
    """Return the cycle model of a path through two simulated messages; arguments as of `simulated_cycles`."""
    return fitted_cycle_model(lambda message_bytes: simulated_cycles(path, nodes, message_bytes, delays))


def memory_model_cycles(
    path: MemoryPath, nodes: int, message_bytes: int, delays: Delays | None = None
) -> float:
    """Return a message's cycles by the memory model of these delays; arguments as of `simulated_cycles`."""
    delays = delays or Delays()
    memory = MemoryInterface(read_latency_cycles=delays.read, write_latency_cycles=delays.write)
    seconds = {
        MemoryPath.GATEWAY_OUT: memory.memory_to_stream_s(message_bytes),
        MemoryPath.GATEWAY_IN: memory.stream_to_memory_s(message_bytes),
        MemoryPath.SHARED_READS: nodes * memory.read_s(message_bytes),
        MemoryPath.WRITE: memory.write_s(message_bytes),
    }
    return seconds[path] * memory.clock_hz
