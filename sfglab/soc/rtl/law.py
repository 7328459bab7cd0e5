# mypy: allow-subclassing-any, disable-error-code="import-not-found,import-untyped"
"""How many cycles a message takes between memory and stream: simulated, and the law for larger messages.

A message is an id, then chunks that are stored and passed on. All whole chunks take the same number of cycles,
so two sizes give the law and a third shows that it holds. Knows cycles; refuses to know delegates and software.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from sfglab.errors import SfglabError
from sfglab.soc.memory import MemoryInterface
from sfglab.soc.rtl.bench import OUTPUT_WORD, Bench, Delays
from sfglab.soc.rtl.control import ADDRESS_BITS
from sfglab.soc.rtl.memif import CHUNK_WORDS

if TYPE_CHECKING:
    from collections.abc import Sequence


LAW_CHUNKS = (2, 8)
"""Sizes from which a law is made."""
WORD_BYTES = ADDRESS_BITS // 8
"""Of a word."""
CHUNK_BYTES = CHUNK_WORDS * WORD_BYTES
"""Of the longest request."""
STEP_CYCLES = 64
"""How often a simulation looks whether it is through."""
PERIOD_S = 10e-9
"""Of the simulated clock."""


class HardwareError(SfglabError, RuntimeError):
    """A simulated gateway did not do what it must."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Transfer:
    """What is simulated."""

    message_bytes: int  #: A multiple of 8.
    subscribers: int  #: Hardware subscribers.
    from_software: bool  #: From memory to the stream, else from the stream to memory.
    delays: Delays = field(default_factory=Delays)  #: Of the memory.
    stalled: int = 0  #: Of eight cycles, how many each subscriber does not listen, 0 to 7.

    def __post_init__(self) -> None:
        """Refuse what the gateway cannot carry."""
        if self.message_bytes <= 0 or self.message_bytes % WORD_BYTES:
            raise HardwareError(
                f"transfer of {self.message_bytes} B: must be a multiple of {WORD_BYTES} above 0"
            )
        if self.subscribers < 0 or not 0 <= self.stalled < 8 or self.delays.read < 0 or self.delays.write < 1:
            raise HardwareError(
                f"{self}: needs 0 or more subscribers, 0 to 7 stalls, and a write delay from 1 on"
            )


@dataclass(frozen=True, slots=True, kw_only=True)
class TransferCycles:
    """A simulated transfer."""

    transfer: Transfer  #: What was simulated.
    cycles: int  #: From the start of the core's transfer to its last beat, inclusive.


@dataclass(frozen=True, slots=True, kw_only=True)
class CycleLaw:
    """Cycles of messages of whole chunks."""

    fixed_cycles: float  #: Of a message.
    chunk_cycles: float  #: Of each chunk.

    def cycles(self, message_bytes: int) -> float:
        """Return the cycles of a message; a last chunk that is not full counts as if it were."""
        return self.fixed_cycles + self.chunk_cycles * -(-message_bytes // CHUNK_BYTES)

    def seconds(self, message_bytes: int, clock_hz: float = 100e6) -> float:
        """Return the seconds of a message."""
        return self.cycles(message_bytes) / clock_hz


def simulate_transfer(transfer: Transfer) -> TransferCycles:
    """Simulate one message through a gateway and compare every word that arrived.

    Some 10 000 cycles a second: for messages of up to about 100 kB.

    Args:
        transfer: What to simulate.

    Raises:
        HardwareError: A word is wrong, or the message did not arrive.
    """
    from amaranth.sim import Simulator

    words = transfer.message_bytes // WORD_BYTES
    bench = Bench(
        transfer.subscribers,
        words,
        from_software=transfer.from_software,
        delays=transfer.delays,
        stalled=transfer.stalled,
    )
    simulator = Simulator(bench)
    simulator.add_clock(PERIOD_S)
    found: list[int] = []
    slack = 8 * (words + CHUNK_WORDS) * (2 + transfer.stalled + transfer.subscribers)
    limit = slack + (words // CHUNK_WORDS + 2) * (transfer.delays.read + transfer.delays.write)

    async def watch(ctx: Any) -> None:
        for _ in range(limit // STEP_CYCLES):
            await ctx.delay(STEP_CYCLES * PERIOD_S)
            if ctx.get(bench.through):
                found.append(_checked(ctx, bench, transfer))
                return

    simulator.add_testbench(watch)
    simulator.run()
    if not found:
        raise HardwareError(f"{transfer}: not through after {limit} cycles")
    return TransferCycles(transfer=transfer, cycles=found[0])


def measured_law(subscribers: int, *, from_software: bool, delays: Delays | None = None) -> CycleLaw:
    """Simulate two sizes and return the law through them.

    Args:
        subscribers: Hardware subscribers.
        from_software: From memory to the stream, else from the stream to memory.
        delays: Of the memory.
    """
    return law_through(
        [
            simulate_transfer(
                Transfer(
                    message_bytes=chunks * CHUNK_BYTES,
                    subscribers=subscribers,
                    from_software=from_software,
                    delays=delays or Delays(),
                )
            ).cycles
            for chunks in LAW_CHUNKS
        ]
    )


def law_through(cycles: Sequence[int]) -> CycleLaw:
    """Return the law through the cycles of messages of `LAW_CHUNKS` chunks."""
    few, many = cycles
    chunk_cycles = (many - few) / (LAW_CHUNKS[1] - LAW_CHUNKS[0])
    return CycleLaw(fixed_cycles=few - LAW_CHUNKS[0] * chunk_cycles, chunk_cycles=chunk_cycles)


def model_cycles(message_bytes: int, *, from_software: bool, memory: MemoryInterface | None = None) -> float:
    """Return what the model of the memory interface says of the same transfer, in cycles.

    Args:
        message_bytes: Of the message.
        from_software: From memory to the stream, else from the stream to memory.
        memory: The model.
    """
    model = memory or MemoryInterface()
    path = model.memory_to_stream_s if from_software else model.stream_to_memory_s
    return path(message_bytes) * model.clock_hz


def _checked(ctx: Any, bench: Bench, transfer: Transfer) -> int:
    """Return the cycles of a transfer whose words all arrived."""
    words = transfer.message_bytes // WORD_BYTES
    memory = bench.memory.content.data
    if transfer.from_software:
        wanted = [ctx.get(memory[words + i]) for i in range(words)]
    else:
        wanted = [0x1001 + i for i in range(words)]
        compare_words([ctx.get(memory[OUTPUT_WORD + i]) for i in range(words)], wanted, "output message")
    for place, received in enumerate(bench.received):
        compare_words([ctx.get(received.data[i]) for i in range(words)], wanted, f"subscriber {place}")
    return int(ctx.get(bench.cycles))


def compare_words(given: Sequence[int], wanted: Sequence[int], place: str) -> None:
    """Compare words that arrived.

    Args:
        given: The words.
        wanted: What they must be.
        place: Where they arrived.

    Raises:
        HardwareError: One is wrong.
    """
    if given != wanted:
        wrong = next(i for i, pair in enumerate(zip(given, wanted, strict=True)) if pair[0] != pair[1])
        raise HardwareError(f"{place}, word {wrong}: {given[wrong]:#x}, must be {wanted[wrong]:#x}")
