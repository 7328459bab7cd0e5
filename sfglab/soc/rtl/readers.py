# mypy: allow-subclassing-any, disable-error-code="import-not-found,import-untyped"
"""Hardware nodes on a software-mapped topic: the arbiter of their memory interface, and their cycles together.

Known of ReconROS' arbiter: it serves the nodes that request in turn, a request each, and none overlaps another.
Ours is how: the search for the next master takes no cycle of its own (the turn is granted in one of the four
that a request takes anyway), it begins behind the master served last, and a request ends by a wire. Each cycle
of a slower search would add 1.5 % to a read of the default latency. Readers share the interface chunk by chunk,
so n take n times what one takes: what the gateway is measured against. Delegates would add the same to all.

Cycles of each path across the memory interface (paper C, section 4) are simulated, or come from the cycle model
through two small messages where a size is beyond simulation. Hardware and memory model share control cycles and
latencies: agreement says that the model adds them up rightly, not that another implementation takes as many.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import Enum
from typing import TYPE_CHECKING, Any

from amaranth import Cat, Elaboratable, Module, Mux, Signal
from amaranth.lib.memory import Memory

from sfglab.errors import InvalidValueError
from sfglab.fields import bounds, check_bounds
from sfglab.soc.memory import MemoryInterface
from sfglab.soc.rtl.cycles import (
    CHUNK_BYTES,
    WORD_BYTES,
    WORD_FACTOR,
    CycleModel,
    Delays,
    SlowMemory,
    Transfer,
    check_words,
    compare_words,
    run_bench,
    simulate_transfer,
)
from sfglab.soc.rtl.data_path import ADDRESS_BITS, CHUNK_WORDS, COUNT_BITS, MemoryMaster, MemoryPort

if TYPE_CHECKING:
    from collections.abc import Sequence


class Arbiter(Elaboratable):
    """Joins masters, at least one by their ports, to one memory.

    While any master waits, a free interface is granted: no cycle is lost. From a master's request on, each
    other master is served at most once before it: none starves.
    """

    def __init__(self, masters: Sequence[MemoryPort]) -> None:
        self.masters = masters  #: The same.
        self.memory = MemoryPort()  #: To the memory.
        #: Out: one bit per master: whose turn it is, or was last.
        self.turn = Signal(len(masters), init=1 << (len(masters) - 1))
        self.busy = Signal()  #: Out: its request is under way.

    @property
    def wires(self) -> list[Any]:
        """The ports of the exported module."""
        return [wire for port in (*self.masters, self.memory) for wire in vars(port).values()]

    def elaborate(self, _platform: object) -> Any:
        """Return the logic."""
        m, memory = Module(), self.memory
        chosen = self._choose(m)
        granted = Signal()
        m.d.comb += granted.eq(~self.busy & memory.grant & chosen.any())
        m.d.comb += memory.request.eq(~self.busy & chosen.any())
        with m.If(granted):
            m.d.sync += [self.turn.eq(chosen), self.busy.eq(1)]
        with m.Elif(memory.complete):
            m.d.sync += self.busy.eq(0)
        for place, master in enumerate(self.masters):
            m.d.comb += [
                master.grant.eq(granted & chosen[place]),
                master.read_data.eq(memory.read_data),
            ]
        with m.Switch(self.turn):
            for place, master in enumerate(self.masters):
                with m.Case(1 << place):
                    self._join(m, master)
        return m

    def _choose(self, m: Any) -> Any:
        """Return the bit of the master to serve: the next behind the last turn that waits, else the first."""
        count = len(self.masters)
        waiting, behind, chosen = (
            Signal(count, name=name) for name in ("waiting", "behind", "chosen")
        )
        first = Signal(count)
        m.d.comb += [
            waiting.eq(Cat(master.request for master in self.masters)),
            behind.eq(waiting & ~(self.turn | (self.turn - 1))),
            first.eq(Mux(behind.any(), behind, waiting)),
            chosen.eq(first & -first),
        ]
        return chosen

    def _join(self, m: Any, master: MemoryPort) -> None:
        """Let the master whose turn it is drive the memory, and only it be told that words pass."""
        memory = self.memory
        with m.If(self.busy):
            m.d.comb += [
                memory.command.eq(master.command),
                memory.address_valid.eq(master.address_valid),
                memory.write_valid.eq(master.write_valid),
                memory.complete.eq(master.complete),
                master.read_valid.eq(memory.read_valid),
                master.write_ready.eq(memory.write_ready),
                master.response.eq(memory.response),
            ]
        m.d.comb += [
            memory.write.eq(master.write),
            memory.words.eq(master.words),
            memory.address.eq(master.address),
            memory.write_data.eq(master.write_data),
        ]


class ChunkNode(Elaboratable):
    """Writes or reads so many words from address 0 without a pause; what words do is its subclass's."""

    def __init__(self, words: int, *, write: bool) -> None:
        self.master = MemoryMaster()  #: Its master of the memory interface.
        self.go = Signal()  #: In: may request; stays set.
        self.done = Signal()  #: Out: the message is through; set for one cycle.
        self.position = Signal(COUNT_BITS)  #: Out: the word that is concerned.
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
            m.d.sync += [
                self._base.eq(self._base + CHUNK_WORDS),
                self._left.eq(self._left - master.words),
            ]
        self._words(m)
        return m

    def _words(self, m: Any) -> None:
        raise NotImplementedError


class ChunkReader(ChunkNode):
    """Reads a message of so many words and keeps it."""

    def __init__(self, words: int) -> None:
        super().__init__(words, write=False)
        #: What was read.
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
    """Makes a message of so many words up and writes it."""

    def __init__(self, words: int) -> None:
        super().__init__(words, write=True)

    def _words(self, m: Any) -> None:
        m.d.comb += self.master.buffered.eq(self.position * WORD_FACTOR)


@dataclass(frozen=True, slots=True, kw_only=True)
class Reading:
    """Hardware nodes that each read one message from the same memory, as they are simulated."""

    message_bytes: int  #: A multiple of 8.
    readers: int = field(metadata=bounds(1))  #: How many nodes read.
    #: For each reader, the cycle from which on it wants the message, counted from when the message is there;
    #: empty: all at once.
    releases: tuple[int, ...] = ()
    #: A publisher in hardware first writes the message over the same interface.
    written: bool = False
    delays: Delays = field(default_factory=Delays)  #: Of the memory.

    def __post_init__(self) -> None:
        check_words(self.message_bytes)
        check_bounds(self)
        if len(self.releases) not in (0, self.readers) or min(self.starts) < 0:
            raise InvalidValueError(
                "releases", self.releases, f"none, or {self.readers} cycles from 0"
            )

    @property
    def words(self) -> int:
        """Words of the message."""
        return self.message_bytes // WORD_BYTES

    @property
    def starts(self) -> tuple[int, ...]:
        """The release of every reader."""
        return self.releases or (0,) * self.readers


class ReadersBench(Elaboratable):
    """Readers of one message behind an arbiter, whose last master is the publisher if there is one."""

    def __init__(self, reading: Reading) -> None:
        words, written = reading.words, reading.written
        self.readers = [ChunkReader(words) for _ in reading.starts]
        self._writer = ChunkWriter(words) if written else None
        nodes: list[ChunkNode] = [*self.readers, *([self._writer] if self._writer else [])]
        self.arbiter = Arbiter([node.master.port for node in nodes])
        size = 1 << (words - 1).bit_length()
        content = [
            0 if written else WORD_FACTOR * word % (1 << ADDRESS_BITS) for word in range(size)
        ]
        self.memory = SlowMemory(self.arbiter.memory, content, reading.delays)
        self.write_cycles = Signal(COUNT_BITS)  #: Of the publisher.
        #: For each reader, after how many cycles it has the message, counted like `releases`; 0: not yet.
        self.ends = [Signal(COUNT_BITS, name=f"end{place}") for place in range(reading.readers)]
        self._releases = reading.starts

    def elaborate(self, _platform: object) -> Any:
        """Return the logic."""
        m = Module()
        m.submodules.arbiter = self.arbiter
        m.submodules.memory = self.memory
        there, now = Signal(init=self._writer is None), Signal(COUNT_BITS)
        if self._writer is not None:
            # Write the message, then say that it is there.
            m.submodules.writer = self._writer
            m.d.comb += self._writer.go.eq(~there)
            with m.If(~there):
                m.d.sync += self.write_cycles.eq(self.write_cycles + 1)
            with m.If(self._writer.done):
                m.d.sync += there.eq(1)
        with m.If(there):
            m.d.sync += now.eq(now + 1)
        for place, reader in enumerate(self.readers):
            m.submodules[f"reader{place}"] = reader
            release = self._releases[
                place
            ]  # Of 0: not compared, which each cycle would cost time to simulate.
            m.d.comb += reader.go.eq(there & (now >= release) if release else there)
            with m.If(reader.done):
                m.d.sync += self.ends[place].eq(now + 1)
        return m


_CYCLES_PER_WORD = 8  #: More than any delay below makes a word take; above it, `Delays` counts.


@dataclass(frozen=True, slots=True, kw_only=True)
class ReadingCycles:
    """Cycles of a simulated reading."""

    write_cycles: int  #: Of the publisher; 0 if the message was there.
    ends: tuple[int, ...]  #: For each reader, from when the message is there until it has it.

    @property
    def read_cycles(self) -> int:
        """Cycles from when the message is there until the last reader has it."""
        return max(self.ends)


def simulate_readers(reading: Reading) -> ReadingCycles:
    """Simulate readers of one message and compare every word that each of them got.

    The more readers, the fewer cycles a second; one reader takes 26 000 cycles for 100 kB.

    Raises:
        SfglabError: A word is wrong, or a reader did not get the message.
    """
    bench = ReadersBench(reading)
    wanted = [WORD_FACTOR * word % (1 << ADDRESS_BITS) for word in range(reading.words)]

    def ended(ctx: Any) -> ReadingCycles | None:
        ends = tuple(int(ctx.get(end)) for end in bench.ends)
        if not all(ends):
            return None
        for place, reader in enumerate(bench.readers):
            got = [ctx.get(reader.received.data[i]) for i in range(reading.words)]
            compare_words(got, wanted, f"reader {place}")
        return ReadingCycles(write_cycles=int(ctx.get(bench.write_cycles)), ends=ends)

    return run_bench(bench, _limit(reading), ended, reading)


def _limit(reading: Reading) -> int:
    """Return more cycles than it can take."""
    nodes = reading.readers + reading.written
    chunks = reading.message_bytes // CHUNK_BYTES + 1
    delay = reading.delays.read + reading.delays.write
    words = chunks * CHUNK_BYTES // WORD_BYTES
    return max(reading.starts) + nodes * (chunks * delay + _CYCLES_PER_WORD * words)


class MemoryPath(Enum):
    """What a message does at the memory interface."""

    GATEWAY_OUT = "gateway, memory to stream"  #: Read once by the core, and broadcast to all nodes.
    GATEWAY_IN = "gateway, stream to memory"  #: Broadcast by a node, and written once by the core.
    SHARED_READS = "shared reads"  #: Read by every node, chunk by chunk in turn.
    WRITE = "write"  #: Written once by a node; the number of nodes does not matter.


_GATEWAY = (MemoryPath.GATEWAY_OUT, MemoryPath.GATEWAY_IN)
_FITTED_CHUNKS = (2, 8)  #: Sizes of the messages through whose cycles a cycle model goes.


def simulated_cycles(
    path: MemoryPath, nodes: int, message_bytes: int, delays: Delays | None = None
) -> int:
    """Simulate a message of a multiple of 8 bytes; 100 kB take some seconds, 1 MB minutes.

    So many hardware nodes receive it: the time of their reads grows with their square. Delays are the memory's.

    Raises:
        SfglabError: A word is wrong, or the message did not arrive.
    """
    delays = delays or Delays()
    if path in _GATEWAY:
        out = path is MemoryPath.GATEWAY_OUT
        sent = Transfer(
            message_bytes=message_bytes, subscribers=nodes, from_software=out, delays=delays
        )
        return simulate_transfer(sent)
    written = path is MemoryPath.WRITE
    readers = 1 if written else nodes
    reading = Reading(message_bytes=message_bytes, readers=readers, written=written, delays=delays)
    found = simulate_readers(reading)
    return found.write_cycles if written else found.read_cycles


def cycle_model(path: MemoryPath, nodes: int, delays: Delays | None = None) -> CycleModel:
    """Return the cycle model of a path through two simulated messages; arguments as of `simulated_cycles`."""
    few, many = _FITTED_CHUNKS
    cycles = simulated_cycles(path, nodes, few * CHUNK_BYTES, delays)
    chunk_cycles = (simulated_cycles(path, nodes, many * CHUNK_BYTES, delays) - cycles) / (
        many - few
    )
    return CycleModel(fixed_cycles=cycles - few * chunk_cycles, chunk_cycles=chunk_cycles)


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
