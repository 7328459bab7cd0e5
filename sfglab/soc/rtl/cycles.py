# mypy: allow-subclassing-any, disable-error-code="import-not-found,import-untyped"
"""The module `cycles` simulates the cycles of a message on each path across the memory interface (paper C, section 4).

A simulation also compares every received word with the sent word. All whole chunks of a message take the same number
of cycles. Therefore a cycle model through two small simulated messages also holds for messages that are too large to
simulate.

The simulated hardware and the memory model (`sfglab.soc.memory`) have the same control cycles and latencies. The
agreement of hardware and model shows that the model adds up the cycles correctly. The agreement is no evidence that
another implementation takes the same number of cycles.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from typing import TYPE_CHECKING, Any, TypeVar

from sfglab.errors import SfglabError
from sfglab.soc.rtl.bench import (
    ChunkNode,
    Delays,
    GatewayBench,
    SharedMemoryBench,
    message_words,
    new_memory,
)
from sfglab.soc.rtl.memory_port import CHUNK_BYTES, CHUNK_WORDS, WORD_BYTES

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

T = TypeVar("T")

_PERIOD_S = 10e-9  #: Clock period of a simulation.
#: Upper bound of the cycles that a word takes, in addition to the memory's latencies.
_CYCLES_PER_WORD = 8
_FITTED_CHUNKS = (2, 8)  #: Sizes of the two messages of a cycle model.


class MemoryPath(Enum):
    """A `MemoryPath` is a path of a message across the memory interface."""

    #: The core reads the message once, and broadcasts the message to all nodes.
    GATEWAY_OUT = "gateway, memory to stream"
    #: A node broadcasts the message, and the core writes the message once.
    GATEWAY_IN = "gateway, stream to memory"
    #: Every node reads the message; the nodes take turns, chunk by chunk.
    SHARED_READS = "shared reads"
    #: One node writes the message. The cycles do not depend on the number of nodes.
    WRITE = "write"


@dataclass(frozen=True, slots=True, kw_only=True)
class CycleModel:
    """A `CycleModel` gives the cycles of messages of whole chunks."""

    fixed_cycles: float  #: Number of cycles per message.
    chunk_cycles: float  #: Number of cycles per chunk.

    def cycles(self, message_bytes: int) -> float:
        """Return the cycles of a message; an incomplete last chunk counts as a whole chunk."""
        chunks = -(-message_bytes // CHUNK_BYTES)
        return self.fixed_cycles + self.chunk_cycles * chunks


def simulated_cycles(
    path: MemoryPath, nodes: int, message_bytes: int, delays: Delays | None = None
) -> int:
    """Simulate a message on a path, and return the message's number of cycles.

    The time of a simulation grows with the message size; use `cycle_model` for large messages.

    Args:
        path: Path of the message.
        nodes: Number of hardware nodes that receive the message. The time of a simulation of shared reads grows with
            the square of this number.
        message_bytes: Size in bytes, a multiple of 8.
        delays: Latencies of the memory; None: the default latencies.

    Raises:
        SfglabError: A word is wrong, or the message has not arrived.
    """
    delays = delays or Delays()
    words = message_bytes // WORD_BYTES
    if path is MemoryPath.GATEWAY_OUT:
        return simulate_gateway(words, nodes, from_memory=True, delays=delays)
    if path is MemoryPath.GATEWAY_IN:
        return simulate_gateway(words, nodes, from_memory=False, delays=delays)
    if path is MemoryPath.WRITE:
        return max(simulate_nodes([ChunkNode(words, writes=True)], words, delays))
    readers = [ChunkNode(words) for _ in range(nodes)]
    return max(simulate_nodes(readers, words, delays))


def simulate_gateway(words: int, subscribers: int, *, from_memory: bool, delays: Delays) -> int:
    """Return the cycles of a gateway's transfer; the function has the arguments of `GatewayBench`.

    Raises:
        SfglabError: A word is wrong, or the message has not arrived.
    """
    bench = GatewayBench(words, subscribers, from_memory=from_memory, delays=delays)
    # The message in memory follows the output message. A publisher's message begins after its ID, which is word 0.
    expected = message_words(words if from_memory else 1, words)

    def result(ctx: Any) -> int:
        if not from_memory:
            compare_words(ctx, bench.content, expected, "output message")
        for place, received in enumerate(bench.received):
            compare_words(ctx, received, expected, f"subscriber {place}")
        return int(ctx.get(bench.cycles))

    return run_bench(bench, cycle_limit(words, 2, delays), result)


def simulate_nodes(nodes: Sequence[ChunkNode], words: int, delays: Delays) -> list[int]:
    """Return the number of cycles after which each of several nodes has read or written the same message.

    Raises:
        SfglabError: A received word is wrong, or a node has not completed its message.
    """
    expected = message_words(0, words)
    any_writes = any(node.writes for node in nodes)
    content = new_memory(words, [] if any_writes else expected)
    bench = SharedMemoryBench(nodes, content, delays)

    def result(ctx: Any) -> list[int]:
        compare_words(ctx, content, expected, "memory")
        for place, node in enumerate(nodes):
            if not node.writes:
                compare_words(ctx, node.received, expected, f"reader {place}")
        return [int(ctx.get(end)) for end in bench.ends]

    latest = max(node.start_cycle for node in nodes)
    return run_bench(bench, latest + cycle_limit(words, len(nodes), delays), result)


def cycle_limit(words: int, nodes: int, delays: Delays) -> int:
    """Return an upper bound of the cycles that a message with a number of words takes for all nodes."""
    chunks = words // CHUNK_WORDS + 1
    chunk_cycles = delays.read + delays.write + _CYCLES_PER_WORD * CHUNK_WORDS
    return nodes * chunks * chunk_cycles


def compare_words(ctx: Any, memory: Any, expected: Sequence[int], place: str) -> None:
    """Compare the first words of a simulated memory with the expected words.

    Args:
        ctx: Context of Amaranth's simulator.
        memory: Memory of the simulated hardware.
        expected: Expected words.
        place: Name of the memory in the error.

    Raises:
        SfglabError: A word differs.
    """
    for index, word in enumerate(expected):
        found = ctx.get(memory.data[index])
        if found != word:
            raise SfglabError(f"{place}, word {index}: {found:#x}, must be {word:#x}")


def run_bench(bench: Any, limit: int, result: Callable[[Any], T]) -> T:
    """Simulate a test bench until the bench is done, and return the bench's result.

    Args:
        bench: Hardware with a signal `done`.
        limit: Largest number of cycles.
        result: Function that returns the result, given the simulator's context.

    Raises:
        SfglabError: The bench is not done within the limit.
    """
    from amaranth.sim import Simulator

    simulator = Simulator(bench)
    simulator.add_clock(_PERIOD_S)
    found: list[T] = []

    async def watch(ctx: Any) -> None:
        await ctx.posedge(bench.done).delay(limit * _PERIOD_S)
        if ctx.get(bench.done):
            found.append(result(ctx))

    simulator.add_testbench(watch)
    simulator.run()
    if not found:
        raise SfglabError(
            f"{type(bench).__name__}: no result after {limit} cycles; raise the limit"
        )
    return found[0]


def cycle_model(path: MemoryPath, nodes: int, delays: Delays | None = None) -> CycleModel:
    """Return the cycle model through two simulated messages; see `simulated_cycles` for the arguments."""
    few, many = _FITTED_CHUNKS
    few_cycles = simulated_cycles(path, nodes, few * CHUNK_BYTES, delays)
    many_cycles = simulated_cycles(path, nodes, many * CHUNK_BYTES, delays)
    chunk_cycles = (many_cycles - few_cycles) / (many - few)
    fixed_cycles = few_cycles - few * chunk_cycles
    return CycleModel(fixed_cycles=fixed_cycles, chunk_cycles=chunk_cycles)
