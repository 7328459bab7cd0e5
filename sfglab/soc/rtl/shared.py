# mypy: disable-error-code="import-not-found,import-untyped"
"""How many cycles hardware readers of a software-mapped topic take together: simulated, and a law.

They share one memory interface, chunk by chunk in turn, so n readers take n times what one takes. What the
gateway is measured against. Knows cycles; refuses to know delegates and software.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from sfglab.soc.memory import MemoryInterface, shared_s
from sfglab.soc.rtl.bench import WORD_FACTOR, Delays
from sfglab.soc.rtl.control import ADDRESS_BITS
from sfglab.soc.rtl.law import (
    CHUNK_BYTES,
    LAW_CHUNKS,
    PERIOD_S,
    STEP_CYCLES,
    WORD_BYTES,
    CycleLaw,
    HardwareError,
    compare_words,
    law_through,
)
from sfglab.soc.rtl.readers import ReadersBench

if TYPE_CHECKING:
    from collections.abc import Sequence


_CYCLES_PER_WORD = 8
"""More than any delay below makes a word take; above it, `Delays` counts."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Reading:
    """What is simulated: hardware nodes that each read one message from the same memory."""

    message_bytes: int  #: A multiple of 8.
    readers: int  #: How many nodes read.
    #: For each reader, the cycle from which on it wants the message; empty: all at once.
    releases: tuple[int, ...] = ()
    #: A publisher in hardware first writes the message over the same interface; `releases` then count from when
    #: it has.
    written: bool = False
    delays: Delays = field(default_factory=Delays)  #: Of the memory.

    def __post_init__(self) -> None:
        """Refuse what cannot be read."""
        if self.message_bytes <= 0 or self.message_bytes % WORD_BYTES:
            raise HardwareError(f"reading {self.message_bytes} B: must be a multiple of {WORD_BYTES} above 0")
        if self.readers < 1 or len(self.releases) not in (0, self.readers) or min(self.starts) < 0:
            raise HardwareError(f"{self}: needs 1 or more readers, and no releases or one from 0 on for each")
        if self.delays.read < 0 or self.delays.write < 1:
            raise HardwareError(f"{self}: needs a read delay from 0 and a write delay from 1 on")

    @property
    def starts(self) -> tuple[int, ...]:
        """The release of every reader."""
        return self.releases or (0,) * self.readers


@dataclass(frozen=True, slots=True, kw_only=True)
class ReadingCycles:
    """A simulated reading."""

    message_bytes: int  #: Size of the message.
    readers: int  #: How many nodes read it.
    write_cycles: int  #: Of the publisher; 0 if the message was there.
    read_cycles: int  #: From when the message is there until the last reader has it.
    ends: tuple[int, ...]  #: For each reader, until it has it.


def simulate_readers(reading: Reading) -> ReadingCycles:
    """Simulate readers of one message and compare every word that each of them got.

    Some 10 000 cycles a second with two readers, fewer with more; a reader takes 26 000 for 100 kB.

    Args:
        reading: What to simulate.

    Raises:
        HardwareError: A word is wrong, or a reader did not get the message.
    """
    from amaranth.sim import Simulator

    words = reading.message_bytes // WORD_BYTES
    bench = ReadersBench(words, reading.starts, written=reading.written, delays=reading.delays)
    simulator = Simulator(bench)
    simulator.add_clock(PERIOD_S)
    found: list[ReadingCycles] = []

    async def watch(ctx: Any) -> None:
        for _ in range(_limit(reading) // STEP_CYCLES):
            await ctx.delay(STEP_CYCLES * PERIOD_S)
            ends = tuple(int(ctx.get(end)) for end in bench.ends)
            if all(ends):
                _check(ctx, bench, words)
                found.append(_counted(reading, int(ctx.get(bench.write_cycles)), ends))
                return

    simulator.add_testbench(watch)
    simulator.run()
    if not found:
        raise HardwareError(f"{reading}: not through after {_limit(reading)} cycles")
    return found[0]


def measured_readers_law(readers: int, delays: Delays | None = None) -> CycleLaw:
    """Simulate two sizes and return the law of `ReadingCycles.read_cycles`, all released at once.

    Args:
        readers: How many nodes read.
        delays: Of the memory.
    """
    return law_through(
        [
            simulate_readers(
                Reading(message_bytes=chunks * CHUNK_BYTES, readers=readers, delays=delays or Delays())
            ).read_cycles
            for chunks in LAW_CHUNKS
        ]
    )


def measured_writer_law(delays: Delays | None = None) -> CycleLaw:
    """Simulate two sizes and return the law of `ReadingCycles.write_cycles`.

    Args:
        delays: Of the memory.
    """
    return law_through(
        [
            simulate_readers(
                Reading(message_bytes=chunks * CHUNK_BYTES, readers=1, written=True, delays=delays or Delays())
            ).write_cycles
            for chunks in LAW_CHUNKS
        ]
    )


def model_reading_cycles(
    message_bytes: int, releases: Sequence[int], memory: MemoryInterface | None = None
) -> float:
    """Return after how many cycles the last reader has the message, as the model of the interface says.

    Args:
        message_bytes: Of the message.
        releases: For each reader, the cycle from which on it wants the message.
        memory: The model.
    """
    model = memory or MemoryInterface()
    work_s = model.read_s(message_bytes)
    return shared_s([release / model.clock_hz for release in releases], work_s) * model.clock_hz


def _limit(reading: Reading) -> int:
    """Return more cycles than it can take."""
    nodes = reading.readers + reading.written
    chunks = reading.message_bytes // CHUNK_BYTES + 1
    delay = reading.delays.read + reading.delays.write
    words = chunks * CHUNK_BYTES // WORD_BYTES
    return STEP_CYCLES + max(reading.starts) + nodes * (chunks * delay + _CYCLES_PER_WORD * words)


def _counted(reading: Reading, write_cycles: int, ends: tuple[int, ...]) -> ReadingCycles:
    return ReadingCycles(
        message_bytes=reading.message_bytes,
        readers=reading.readers,
        write_cycles=write_cycles,
        read_cycles=max(ends),
        ends=ends,
    )


def _check(ctx: Any, bench: ReadersBench, words: int) -> None:
    wanted = [WORD_FACTOR * word % (1 << ADDRESS_BITS) for word in range(words)]
    for place, reader in enumerate(bench.readers):
        compare_words([ctx.get(reader.received.data[i]) for i in range(words)], wanted, f"reader {place}")
