# mypy: allow-subclassing-any, disable-error-code="import-not-found,import-untyped"
"""Hardware nodes on a software-mapped topic: each reads the whole message over the one memory interface.

A bench in hardware: readers, on request a publisher that first writes the message, the arbiter, and a memory
with latencies. Knows nodes that only read or write; refuses to know delegates (they would add the same to every
reader) and what is measured.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from amaranth import Elaboratable, Module, Mux, Signal
from amaranth.lib.memory import Memory

from sfglab.soc.rtl.arbiter import Arbiter
from sfglab.soc.rtl.bench import WORD_FACTOR, Delays, SlowMemory
from sfglab.soc.rtl.control import ADDRESS_BITS
from sfglab.soc.rtl.memif import CHUNK_WORDS, MemoryMaster
from sfglab.soc.rtl.mover import COUNT_BITS

if TYPE_CHECKING:
    from collections.abc import Sequence


class ChunkNode(Elaboratable):
    """Moves one message, chunk after chunk without a pause of its own; what words do is its subclass's.

    Args:
        words: Of the message, which begins at address 0.
        write: Writes it, else reads it.

    Attributes:
        master: Its master of the memory interface.
        go: In: may request; stays set.
        done: Out: the message is through; set for one cycle.
        position: Out: the word that is concerned.
    """

    def __init__(self, words: int, *, write: bool) -> None:
        self.master = MemoryMaster()
        self.go = Signal()
        self.done = Signal()
        self.position = Signal(COUNT_BITS)
        self._write = write
        self._base = Signal(COUNT_BITS)
        self._left = Signal(COUNT_BITS, init=words)

    def elaborate(self, _platform: object) -> Any:
        """Return the logic."""
        m, master = Module(), self.master
        m.submodules.master = master
        few = self._left < CHUNK_WORDS
        m.d.comb += [
            self.position.eq(self._base + master.index),
            master.start.eq(self.go & (self._left != 0)),
            master.write.eq(self._write),
            master.words.eq(Mux(few, self._left, CHUNK_WORDS)),
            master.address.eq(self._base << 3),
            self.done.eq(master.done & (self._left == master.words)),
        ]
        with m.If(master.done):
            m.d.sync += [self._base.eq(self._base + CHUNK_WORDS), self._left.eq(self._left - master.words)]
        self._words(m)
        return m

    def _words(self, m: Any) -> None:
        raise NotImplementedError


class ChunkReader(ChunkNode):
    """Reads a message and keeps it.

    Args:
        words: Of the message.

    Attributes:
        received: What was read.
    """

    def __init__(self, words: int) -> None:
        super().__init__(words, write=False)
        self.received = Memory(shape=ADDRESS_BITS, depth=1 << (words - 1).bit_length(), init=[])

    def _words(self, m: Any) -> None:
        m.submodules.received = self.received
        write = self.received.write_port()
        m.d.comb += [
            write.addr.eq(self.position),
            write.data.eq(self.master.word),
            write.en.eq(self.master.word_valid),
        ]


class ChunkWriter(ChunkNode):
    """Makes a message up and writes it.

    Args:
        words: Of the message.
    """

    def __init__(self, words: int) -> None:
        super().__init__(words, write=True)

    def _words(self, m: Any) -> None:
        m.d.comb += self.master.buffered.eq(self.position * WORD_FACTOR)


class ReadersBench(Elaboratable):
    """Readers of one message behind an arbiter.

    Args:
        words: Of the message.
        releases: For each reader, the cycle from which on it wants the message, counted from when it is there.
        written: A publisher in hardware first writes the message, else it is there from the start.
        delays: Of the memory.

    Attributes:
        readers: The readers.
        arbiter: The arbiter; a publisher is its last master.
        memory: The memory.
        write_cycles: Of the publisher.
        ends: For each reader, after how many cycles it has the message, counted like `releases`; 0: not yet.
    """

    def __init__(self, words: int, releases: Sequence[int], *, written: bool, delays: Delays) -> None:
        self.readers = [ChunkReader(words) for _ in releases]
        self._writer = ChunkWriter(words) if written else None
        nodes: list[ChunkNode] = [*self.readers, *([self._writer] if self._writer else [])]
        self.arbiter = Arbiter([node.master.port for node in nodes])
        size = 1 << (words - 1).bit_length()
        content = [0 if written else WORD_FACTOR * word % (1 << ADDRESS_BITS) for word in range(size)]
        self.memory = SlowMemory(self.arbiter.memory, content, delays)
        self.write_cycles = Signal(COUNT_BITS)
        self.ends = [Signal(COUNT_BITS, name=f"end{place}") for place in range(len(releases))]
        self._releases = releases

    def elaborate(self, _platform: object) -> Any:
        """Return the logic."""
        m = Module()
        m.submodules.arbiter = self.arbiter
        m.submodules.memory = self.memory
        there, now = Signal(init=self._writer is None), Signal(COUNT_BITS)
        if self._writer is not None:
            self._publish(m, self._writer, there)
        with m.If(there):
            m.d.sync += now.eq(now + 1)
        for place, reader in enumerate(self.readers):
            m.submodules[f"reader{place}"] = reader
            release = self._releases[place]  # Of 0: not compared, which each cycle would cost time to simulate.
            m.d.comb += reader.go.eq(there & (now >= release) if release else there)
            with m.If(reader.done):
                m.d.sync += self.ends[place].eq(now + 1)
        return m

    def _publish(self, m: Any, writer: ChunkWriter, there: Any) -> None:
        """Write the message, then say that it is there."""
        m.submodules.writer = writer
        m.d.comb += writer.go.eq(~there)
        with m.If(~there):
            m.d.sync += self.write_cycles.eq(self.write_cycles + 1)
        with m.If(writer.done):
            m.d.sync += there.eq(1)
