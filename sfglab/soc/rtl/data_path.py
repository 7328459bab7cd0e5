# mypy: allow-subclassing-any, disable-error-code="import-not-found,import-untyped"
"""The data path of a gateway: memory interface's master, hardware-mapped topic, and the mover between both.

The master moves one chunk at a time, nothing overlaps; its four control cycles are in the order of ReconROS'
memory controller: one's turn, command, address, words, completion. One message at a time holds the topic; a
beat is through when every port has taken it, and after a message's last beat nothing of it stands anywhere. On
the stream a message is its publisher's id and then its words; in memory its words, whose number its type fixes;
the mover stores a chunk before it passes it on.
"""

from __future__ import annotations

from typing import Any

from amaranth import Cat, Elaboratable, Module, Mux, Signal
from amaranth.lib.memory import Memory

#: Of addresses and of the words of OSIF, MEMIF and streams (ReconROS, 64-bit template).
ADDRESS_BITS = 64

CHUNK_WORDS = 32  #: Words of the longest request: 256 bytes of 64 bits.


class MemoryPort:
    """The wires between a master and the memory; (m) the master drives, (s) the memory."""

    def __init__(self) -> None:
        self.request = Signal()  #: (m) The master waits for its turn.
        self.grant = Signal()  #: (s) The interface is this master's turn.
        self.command = Signal()  #: (m) A command stands here: `write` and `words` count.
        self.write = Signal()  #: (m) The request writes.
        # Named apart from the gateway's own `words`, beside which it stands in the exported module.
        #: (m) How many words, 1 to `CHUNK_WORDS`.
        self.words = Signal(range(CHUNK_WORDS + 1), name="request_words")
        self.address_valid = Signal()  #: (m) The address stands here.
        self.address = Signal(ADDRESS_BITS)  #: (m) Of the first byte.
        #: (s) A word that was read stands here; the master always takes it.
        self.read_valid = Signal()
        self.read_data = Signal(ADDRESS_BITS)  #: (s) The word.
        self.write_valid = Signal()  #: (m) A word to write stands here.
        self.write_ready = Signal()  #: (s) The memory takes it.
        self.write_data = Signal(ADDRESS_BITS)  #: (m) The word.
        self.response = Signal()  #: (s) All words of a write have arrived.
        #: (m) The request is through, the interface free from the next cycle on.
        self.complete = Signal()


class MemoryMaster(Elaboratable):
    """Moves one chunk between the memory and a buffer."""

    def __init__(self) -> None:
        self.port = MemoryPort()  #: To the memory.
        #: In: a request is wanted; stays set, with its parameters, until `done`.
        self.start = Signal()
        self.write = Signal()  #: In: from the buffer to memory, else from memory to the buffer.
        self.words = Signal(range(CHUNK_WORDS + 1))  #: In: how many.
        self.address = Signal(ADDRESS_BITS)  #: In: of the first byte.
        self.index = Signal(range(CHUNK_WORDS))  #: Out: the word of the buffer that is concerned.
        self.word_valid = Signal()  #: Out: `word` belongs into the buffer at `index`.
        self.word = Signal(ADDRESS_BITS)  #: Out: a word that was read.
        self.buffered = Signal(ADDRESS_BITS)  #: In: the buffer's word at `index`.
        self.done = Signal()  #: Out: the request is through; set for one cycle.

    def elaborate(self, _platform: object) -> Any:
        """Return the logic: the four control cycles are TURN, COMMAND, ADDRESS and COMPLETE."""
        m, port = Module(), self.port
        m.d.comb += [
            port.write.eq(self.write),
            port.words.eq(self.words),
            port.address.eq(self.address),
            port.write_data.eq(self.buffered),
            self.word.eq(port.read_data),
        ]
        with m.FSM():
            with m.State("TURN"):
                m.d.comb += port.request.eq(self.start)
                m.d.sync += self.index.eq(0)
                with m.If(self.start & port.grant):
                    m.next = "COMMAND"
            with m.State("COMMAND"):
                m.d.comb += port.command.eq(1)
                m.next = "ADDRESS"
            with m.State("ADDRESS"):
                m.d.comb += port.address_valid.eq(1)
                with m.If(self.write):
                    m.next = "WRITE"
                with m.Else():
                    m.next = "READ"
            with m.State("READ"):
                m.d.comb += self.word_valid.eq(port.read_valid)
                self._count(m, port.read_valid, "COMPLETE")
            with m.State("WRITE"):
                m.d.comb += port.write_valid.eq(1)
                self._count(m, port.write_ready, "RESPONSE")
            with m.State("RESPONSE"), m.If(port.response):
                m.next = "COMPLETE"
            with m.State("COMPLETE"):
                m.d.comb += [port.complete.eq(1), self.done.eq(1)]
                m.next = "TURN"
        return m

    def _count(self, m: Any, passes: Any, after: str) -> None:
        """Count a word that passes and go on after the last one."""
        with m.If(passes):
            m.d.sync += self.index.eq(self.index + 1)
            with m.If(self.index + 1 == self.words):
                m.next = after


class Stream:
    """The wires of a stream, whose names begin with a prefix; (f) who sends drives, (t) who receives."""

    def __init__(self, name: str) -> None:
        #: (f) A beat stands here, and stays until it is taken.
        self.valid = Signal(name=f"{name}_valid")
        #: (t) The beat is taken in this cycle if it is there.
        self.ready = Signal(name=f"{name}_ready")
        self.data = Signal(ADDRESS_BITS, name=f"{name}_data")  #: (f) The word.
        self.last = Signal(name=f"{name}_last")  #: (f) It is a message's last.

    @property
    def passes(self) -> Any:
        """A beat changes hands in this cycle."""
        return self.valid & self.ready

    @property
    def wires(self) -> list[Any]:
        """All four."""
        return [self.valid, self.ready, self.data, self.last]


class Broadcast(Elaboratable):
    """Sends each beat of a source to every port; a port that took it does not see it again."""

    def __init__(self, source: Stream, ports: list[Stream]) -> None:
        self.source = source
        self.ports = ports

    def elaborate(self, _platform: object) -> Any:
        """Return the logic: no register stage, so that done means done everywhere."""
        m, source = Module(), self.source
        taken = Signal(len(self.ports))
        now = Cat(taken[i] | port.ready for i, port in enumerate(self.ports))
        for i, port in enumerate(self.ports):
            m.d.comb += [
                port.valid.eq(source.valid & ~taken[i]),
                port.data.eq(source.data),
                port.last.eq(source.last),
            ]
        m.d.comb += source.ready.eq(now.all())
        with m.If(source.valid):
            m.d.sync += taken.eq(Mux(now.all(), 0, now))
        return m


class Turns(Elaboratable):
    """Decides whose message holds the topic, whose source it feeds: the core's or a hardware node's.

    The node's goes first, but a core that had to wait is owed the next turn: else a busy node could keep it
    waiting for ever. That cannot lock up, because a core that holds a message always comes back to its claim.
    """

    def __init__(self, core: Stream, node: Stream, topic: Stream) -> None:
        self.core, self.node, self.topic = core, node, topic
        self.claim = Signal()  #: In: the core wants the topic.
        #: Out: the topic is the core's from the next cycle to its message's last beat.
        self.grant = Signal()

    def elaborate(self, _platform: object) -> Any:
        """Return the logic."""
        m, topic = Module(), self.topic
        owed = Signal()
        with m.FSM():
            with m.State("FREE"):
                with m.If(self.node.valid & ~owed):
                    m.next = "NODE"
                with m.Elif(self.claim):
                    m.d.comb += self.grant.eq(1)
                    m.d.sync += owed.eq(0)
                    m.next = "CORE"
            for name, sender in (("NODE", self.node), ("CORE", self.core)):
                with m.State(name):
                    m.d.comb += [
                        topic.valid.eq(sender.valid),
                        topic.data.eq(sender.data),
                        topic.last.eq(sender.last),
                        sender.ready.eq(topic.ready),
                    ]
                    with m.If(topic.passes & topic.last):
                        m.next = "FREE"
        with m.If(self.claim & ~self.grant):
            m.d.sync += owed.eq(1)
        return m


COUNT_BITS = 32  #: Of a message's number of words.
_CHUNK_BYTES = CHUNK_WORDS * ADDRESS_BITS // 8


class Mover(Elaboratable):
    """Copies or drops one message; a command stays set until `done`."""

    def __init__(self) -> None:
        self.master = MemoryMaster()  #: Its master of the memory interface.
        self.sent = Stream("sent")  #: To the topic.
        self.port = Stream("port")  #: From the topic.
        self.send = Signal()  #: In: copy from memory to the topic, and ignore what the port echoes.
        self.store = Signal()  #: In: copy from the port to memory.
        self.drop = Signal()  #: In: take the message at the port and forget it.
        self.source = Signal(ADDRESS_BITS)  #: In: address of the message to send.
        self.target = Signal(ADDRESS_BITS)  #: In: address to which a message is stored.
        self.words = Signal(COUNT_BITS)  #: In: of a message, without its id; at least 1.
        self.own_id = Signal(ADDRESS_BITS)  #: In: the first word of what is sent.
        self.done = Signal()  #: Out: the last beat is through; set for one cycle.
        self._left = Signal(COUNT_BITS)
        self._address = Signal(ADDRESS_BITS)
        self._index = Signal(range(CHUNK_WORDS + 1))
        self._buffer = Memory(shape=ADDRESS_BITS, depth=CHUNK_WORDS, init=[])

    def elaborate(self, _platform: object) -> Any:
        """Return the logic."""
        m = Module()
        m.submodules.master = self.master
        m.submodules.buffer = self._buffer
        self._wire_buffer(m)
        with m.FSM():
            self._head(m)
            self._memory_to_stream(m)
            self._stream_to_memory(m)
        with m.If(self.send):
            m.d.comb += self.port.ready.eq(1)
        return m

    def _wire_buffer(self, m: Any) -> None:
        """Give the buffer to the master while it works, else to the streams."""
        master = self.master
        read = self._buffer.read_port(domain="comb")
        write = self._buffer.write_port()
        m.d.comb += [
            read.addr.eq(Mux(self.store, master.index, self._index)),
            master.buffered.eq(read.data),
            self.sent.data.eq(read.data),
            write.addr.eq(Mux(self.store, self._index, master.index)),
            write.data.eq(Mux(self.store, self.port.data, master.word)),
            write.en.eq(Mux(self.store, self.port.passes, master.word_valid)),
            master.address.eq(self._address),
        ]

    def _head(self, m: Any) -> None:
        """Send or take the id, or take a message that goes nowhere."""
        with m.State("HEAD"):
            m.d.sync += [self._left.eq(self.words), self._index.eq(0)]
            with m.If(self.send):
                m.d.comb += [self.sent.valid.eq(1), self.sent.data.eq(self.own_id)]
                m.d.sync += self._address.eq(self.source)
                with m.If(self.sent.ready):
                    m.next = "FETCH"
            with m.Elif(self.store):
                m.d.comb += self.port.ready.eq(1)
                m.d.sync += self._address.eq(self.target)
                with m.If(self.port.valid):
                    m.next = "FILL"
            with m.Elif(self.drop):
                m.d.comb += [self.port.ready.eq(1), self.done.eq(self.port.valid & self.port.last)]

    def _memory_to_stream(self, m: Any) -> None:
        """Fetch a chunk, then send it."""
        with m.State("FETCH"):
            few = self._left < CHUNK_WORDS
            m.d.comb += [
                self.master.start.eq(1),
                self.master.words.eq(Mux(few, self._left, CHUNK_WORDS)),
            ]
            with m.If(self.master.done):
                m.next = "DRAIN"
        with m.State("DRAIN"):
            m.d.comb += [self.sent.valid.eq(1), self.sent.last.eq(self._left == 1)]
            with m.If(self.sent.ready):
                m.d.sync += [self._left.eq(self._left - 1), self._index.eq(self._index + 1)]
                with m.If(self.sent.last):
                    m.d.comb += self.done.eq(1)
                    m.next = "HEAD"
                with m.Elif(self._index == CHUNK_WORDS - 1):
                    self._next_chunk(m, "FETCH")

    def _stream_to_memory(self, m: Any) -> None:
        """Fill the buffer from the stream, then write it."""
        with m.State("FILL"):
            m.d.comb += self.port.ready.eq(1)
            with m.If(self.port.valid):
                m.d.sync += [self._left.eq(self._left - 1), self._index.eq(self._index + 1)]
                with m.If((self._left == 1) | (self._index == CHUNK_WORDS - 1)):
                    m.next = "STORE"
        with m.State("STORE"):
            m.d.comb += [
                self.master.start.eq(1),
                self.master.write.eq(1),
                self.master.words.eq(self._index),
            ]
            with m.If(self.master.done):
                with m.If(self._left == 0):
                    m.d.comb += self.done.eq(1)
                    m.next = "HEAD"
                with m.Else():
                    self._next_chunk(m, "FILL")

    def _next_chunk(self, m: Any, state: str) -> None:
        m.d.sync += [self._address.eq(self._address + _CHUNK_BYTES), self._index.eq(0)]
        m.next = state
