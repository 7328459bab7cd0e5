# mypy: allow-subclassing-any, disable-error-code="import-not-found,import-untyped"
"""The module `bench` has test benches of the memory paths; a test bench is hardware, so no Python code runs per cycle.

The class `GatewayBench` surrounds a gateway with memory, delegate, publisher and subscribers. The nodes of the class
`SharedMemoryBench` read or write one message each over the arbiter, as hardware nodes do without a gateway.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from amaranth import Cat, Const, Elaboratable, Module, Mux, Signal
from amaranth.lib.memory import Memory

from sfglab.soc.gateway import Action
from sfglab.soc.rtl.core import Answer, Gateway
from sfglab.soc.rtl.memory_port import (
    CHUNK_WORDS,
    COUNT_BITS,
    WORD_BITS,
    WORD_BYTES,
    Arbiter,
    MemoryMaster,
    MemoryPort,
)

if TYPE_CHECKING:
    from collections.abc import Sequence

    from sfglab.soc.rtl.topic import Stream

WORD_FACTOR = 0x9E37_79B9_7F4A_7C15
"""Word i of a message is i times `WORD_FACTOR`, so that all words differ in all their bytes."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Delays:
    """`Delays` has the latencies of the memory, in cycles."""

    read: int = 30  #: Cycles between the address and the first word.
    write: int = 9  #: Cycles from the last word to the response, at least 1.


def message_words(first: int, count: int) -> list[int]:
    """Return consecutive words of a message; the first returned word has the index `first`."""
    return [WORD_FACTOR * index % (1 << WORD_BITS) for index in range(first, first + count)]


def new_memory(words: int, content: Sequence[int] = ()) -> Any:
    """Return a memory with room for words; the depth of the memory is a power of two."""
    return Memory(shape=WORD_BITS, depth=1 << (words - 1).bit_length(), init=content)


class SlowMemory(Elaboratable):
    """A `SlowMemory` serves one request after the other at its port, with latencies."""

    def __init__(self, port: MemoryPort, content: Any, delays: Delays) -> None:
        self.port = port
        self.content = content  #: The `Memory` that holds the words.
        self._delays = delays

    def elaborate(self, _platform: object) -> Any:
        """Return the logic of the slow memory as a module of Amaranth."""
        m = Module()
        port = self.port
        m.submodules.content = self.content
        read = self.content.read_port(domain="comb")
        write = self.content.write_port()
        place = Signal(COUNT_BITS)
        left = Signal(range(CHUNK_WORDS + 1))
        wait = Signal(16)
        m.d.comb += [
            port.grant.eq(1),
            read.addr.eq(place),
            port.read_data.eq(read.data),
            write.addr.eq(place),
            write.data.eq(port.write_data),
            write.en.eq(port.write_valid & port.write_ready),
        ]
        passes = (port.write_valid & port.write_ready) | port.read_valid
        with m.If(passes):
            m.d.sync += [place.eq(place + 1), left.eq(left - 1)]
        with m.FSM():
            with m.State("IDLE"):
                m.d.sync += [place.eq(port.address // WORD_BYTES), left.eq(port.words)]
                with m.If(port.address_valid & port.write):
                    m.d.sync += wait.eq(self._delays.write - 1)
                    m.next = "WRITE"
                with m.Elif(port.address_valid):
                    m.d.sync += wait.eq(self._delays.read)
                    m.next = "READ"
            with m.State("READ"):
                m.d.comb += port.read_valid.eq(wait == 0)
                with m.If(wait != 0):
                    m.d.sync += wait.eq(wait - 1)
                with m.Elif(left == 1):
                    m.next = "IDLE"
            with m.State("WRITE"):
                m.d.comb += port.write_ready.eq(1)
                with m.If(port.write_valid & (left == 1)):
                    m.next = "RESPONSE"
            with m.State("RESPONSE"):
                m.d.sync += wait.eq(wait - 1)
                with m.If(wait == 0):
                    m.d.comb += port.response.eq(1)
                    m.next = "IDLE"
        return m


class GatewayBench(Elaboratable):
    """A `GatewayBench` has a gateway that transfers one message.

    The output message begins at the memory's first word; the message that the core sends follows the output message.

    Args:
        words: Number of words of the message.
        subscribers: Number of hardware subscribers.
        from_memory: Whether the delegate answers with the message; otherwise a hardware publisher sends the message.
        delays: Latencies of the memory.
    """

    def __init__(self, words: int, subscribers: int, *, from_memory: bool, delays: Delays) -> None:
        self.gateway = Gateway(subscribers)
        self.content = new_memory(2 * words, message_words(0, 2 * words))  #: Words in memory.
        #: Words that each subscriber has received; the publisher ID is left out.
        self.received = [new_memory(words) for _ in range(subscribers)]
        self.cycles = Signal(COUNT_BITS)  #: Number of cycles of the transfer.
        self.done = Signal()  #: The transfer is complete.
        self._words = words
        self._from_memory = from_memory
        self._delays = delays

    def elaborate(self, _platform: object) -> Any:
        """Return the logic of the gateway bench as a module of Amaranth."""
        m = Module()
        gateway = self.gateway
        m.submodules.gateway = gateway
        port = gateway.mover.master.port
        m.submodules.memory = SlowMemory(port, self.content, self._delays)
        # All other publishers of the bench have the ID 0, so the filters forward the messages of these publishers.
        m.d.comb += [gateway.own_smt.eq(1), gateway.own_hmt.eq(1)]
        m.d.comb += gateway.words.eq(self._words)
        self._add_delegate(m)
        if not self._from_memory:
            self._add_publisher(m)
        for stream, received in zip(gateway.ports, self.received, strict=True):
            m.submodules += received
            self._add_subscriber(m, stream, received)
        does = gateway.control.does
        with m.If(does(Action.MEMORY_TO_HMT) | does(Action.HMT_TO_MEMORY)):
            m.d.sync += self.cycles.eq(self.cycles + 1)
        with m.If(gateway.mover.done):
            m.d.sync += self.done.eq(1)
        return m

    def _add_delegate(self, m: Any) -> None:
        """Add a delegate that locates the output message, then answers one request with the message in memory."""
        gateway = self.gateway
        # The signal counts the answers that the core has taken from the delegate.
        answers = Signal(2)
        is_first = answers == 0
        m.d.comb += [
            gateway.call_ready.eq(1),
            gateway.answer_valid.eq(is_first | ((answers == 1) & self._from_memory)),
            gateway.answer.eq(Mux(is_first, Answer.LOCATED, Answer.ANSWERED)),
            gateway.answer_address.eq(Mux(is_first, 0, self._words * WORD_BYTES)),
        ]
        with m.If(gateway.answer_valid & gateway.answer_ready):
            m.d.sync += answers.eq(answers + 1)

    def _add_publisher(self, m: Any) -> None:
        """Add a publisher that sends word 0 as its publisher ID, then the following words as the message."""
        node = self.gateway.node
        place = Signal(COUNT_BITS)
        m.d.comb += [
            node.valid.eq(place <= self._words),
            node.data.eq(place * WORD_FACTOR),
            node.last.eq(place == self._words),
        ]
        with m.If(node.passes):
            m.d.sync += place.eq(place + 1)

    def _add_subscriber(self, m: Any, stream: Stream, received: Any) -> None:
        """Add a subscriber that stores the words after the publisher ID."""
        write = received.write_port()
        place = Signal(COUNT_BITS)
        m.d.comb += [
            stream.ready.eq(1),
            write.addr.eq(place - 1),
            write.data.eq(stream.data),
            write.en.eq(stream.valid & (place != 0)),
        ]
        with m.If(stream.valid):
            m.d.sync += place.eq(place + 1)


class ChunkNode(Elaboratable):
    """A `ChunkNode` is a hardware node that reads or writes one message at address 0, chunk by chunk.

    Args:
        words: Number of words of the message.
        writes: Whether the node writes; otherwise the node reads.
        start_cycle: Cycle of the node's first request.
    """

    def __init__(self, words: int, *, writes: bool = False, start_cycle: int = 0) -> None:
        self.master = MemoryMaster()  #: Master of the memory interface.
        self.received = new_memory(words)  #: Words that a reader has read.
        self.go = Signal()  #: In: the node may request; the signal stays set.
        self.done = Signal()  #: Out: the message is complete; the signal is set for one cycle.
        self.start_cycle = start_cycle
        self.writes = writes
        self._base = Signal(COUNT_BITS)
        self._left = Signal(COUNT_BITS, init=words)

    def elaborate(self, _platform: object) -> Any:
        """Return the logic of the chunk node as a module of Amaranth."""
        m = Module()
        master = self.master
        m.submodules.master = master
        m.submodules.received = self.received
        write = self.received.write_port()
        place = self._base + master.index
        m.d.comb += [
            master.start.eq(self.go & (self._left != 0)),
            master.write.eq(self.writes),
            master.words.eq(Mux(self._left < CHUNK_WORDS, self._left, CHUNK_WORDS)),
            master.address.eq(self._base * WORD_BYTES),
            master.buffered.eq(place * WORD_FACTOR),
            write.addr.eq(place),
            write.data.eq(master.word),
            write.en.eq(master.word_valid),
            self.done.eq(master.done & (self._left == master.words)),
        ]
        with m.If(master.done):
            m.d.sync += self._base.eq(self._base + CHUNK_WORDS)
            m.d.sync += self._left.eq(self._left - master.words)
        return m


class SharedMemoryBench(Elaboratable):
    """A `SharedMemoryBench` has nodes that share one memory through the arbiter."""

    def __init__(self, nodes: Sequence[ChunkNode], content: Any, delays: Delays) -> None:
        self.nodes = nodes
        self.arbiter = Arbiter([node.master.port for node in nodes])
        self.memory = SlowMemory(self.arbiter.memory, content, delays)
        #: Number of cycles after which each node has completed its message; 0 while the message is incomplete.
        self.ends = [Signal(COUNT_BITS) for _ in nodes]
        self.done = Signal()  #: All nodes have completed their messages.

    def elaborate(self, _platform: object) -> Any:
        """Return the logic of the shared memory bench as a module of Amaranth."""
        m = Module()
        m.submodules.arbiter = self.arbiter
        m.submodules.memory = self.memory
        now = Signal(COUNT_BITS)
        m.d.sync += now.eq(now + 1)
        m.d.comb += self.done.eq(Cat(end.any() for end in self.ends).all())
        for node, end in zip(self.nodes, self.ends, strict=True):
            m.submodules += node
            # A node that starts at cycle 0 needs no comparison, which makes the simulation faster.
            started = now >= node.start_cycle if node.start_cycle else Const(1)
            m.d.comb += node.go.eq(started)
            with m.If(node.done):
                m.d.sync += end.eq(now + 1)
        return m
