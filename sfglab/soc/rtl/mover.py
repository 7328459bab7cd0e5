# mypy: allow-subclassing-any, disable-error-code="import-not-found,import-untyped"
"""The module `mover` has the data path of a gateway core, which copies a message between memory and the HMT.

A message in memory consists of words; the message type fixes the number of words. On the hardware-mapped topic (HMT)
the publisher's ID precedes the words. The mover stores a chunk in its buffer before the mover passes the chunk on, so
that reading and sending do not overlap.
"""

from __future__ import annotations

from typing import Any

from amaranth import Elaboratable, Module, Mux, Signal
from amaranth.lib.memory import Memory

from sfglab.soc.rtl.memory_port import (
    CHUNK_BYTES,
    CHUNK_WORDS,
    COUNT_BITS,
    WORD_BITS,
    MemoryMaster,
)
from sfglab.soc.rtl.topic import Stream


class Mover(Elaboratable):
    """A `Mover` sends, stores or drops one message; the command stays set until the mover sets `done`."""

    def __init__(self) -> None:
        self.master = MemoryMaster()  #: Master of the memory interface.
        self.sent = Stream("sent")  #: Stream to the topic.
        self.port = Stream("port")  #: Stream from the topic.
        #: In: copy a message from memory to the topic, and discard the message's echo at the port.
        self.send = Signal()
        self.store = Signal()  #: In: copy a message from the port to memory.
        self.drop = Signal()  #: In: discard the message at the port.
        self.source = Signal(WORD_BITS)  #: In: address of the message that the mover sends.
        self.target = Signal(WORD_BITS)  #: In: address to which the mover stores a message.
        self.words = Signal(COUNT_BITS)  #: In: number of words of a message without ID, at least 1.
        self.own_id = Signal(WORD_BITS)  #: In: publisher ID of messages that the mover sends.
        self.done = Signal()  #: Out: the last word has passed; the signal is set for one cycle.
        # The signal counts the words that have not passed the stream.
        self._left = Signal(COUNT_BITS)
        self._address = Signal(WORD_BITS)  # The signal has the address of the present chunk.
        # The signal has the index in the buffer for the stream.
        self._index = Signal(range(CHUNK_WORDS + 1))
        self._buffer = Memory(shape=WORD_BITS, depth=CHUNK_WORDS, init=[])

    def elaborate(self, _platform: object) -> Any:
        """Return the logic of the mover as a module of Amaranth."""
        m = Module()
        m.submodules.master = self.master
        m.submodules.buffer = self._buffer
        self._connect_buffer(m)
        with m.FSM():
            self._begin(m)
            self._memory_to_stream(m)
            self._stream_to_memory(m)
        with m.If(self.send):
            m.d.comb += self.port.ready.eq(1)
        return m

    def _connect_buffer(self, m: Any) -> None:
        """Connect the buffer to the stream and to the memory."""
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

    def _begin(self, m: Any) -> None:
        """Add the state that sends or takes the publisher ID, or drops a whole message."""
        with m.State("BEGIN"):
            m.d.sync += [self._left.eq(self.words), self._index.eq(0)]
            with m.If(self.send):
                m.d.comb += [self.sent.valid.eq(1), self.sent.data.eq(self.own_id)]
                m.d.sync += self._address.eq(self.source)
                with m.If(self.sent.ready):
                    m.next = "READ_CHUNK"
            with m.Elif(self.store):
                m.d.comb += self.port.ready.eq(1)
                m.d.sync += self._address.eq(self.target)
                with m.If(self.port.valid):
                    m.next = "TAKE_CHUNK"
            with m.Elif(self.drop):
                m.d.comb += [self.port.ready.eq(1), self.done.eq(self.port.valid & self.port.last)]

    def _memory_to_stream(self, m: Any) -> None:
        """Add the states that read a chunk from memory and send the chunk to the stream."""
        with m.State("READ_CHUNK"):
            is_last = self._left < CHUNK_WORDS
            m.d.comb += self.master.start.eq(1)
            m.d.comb += self.master.words.eq(Mux(is_last, self._left, CHUNK_WORDS))
            with m.If(self.master.done):
                m.next = "SEND_CHUNK"
        with m.State("SEND_CHUNK"):
            m.d.comb += [self.sent.valid.eq(1), self.sent.last.eq(self._left == 1)]
            with m.If(self.sent.ready):
                self._count_word(m)
                with m.If(self.sent.last):
                    self._end(m)
                with m.Elif(self._index == CHUNK_WORDS - 1):
                    self._next_chunk(m, "READ_CHUNK")

    def _stream_to_memory(self, m: Any) -> None:
        """Add the states that take a chunk from the port and write the chunk to memory."""
        with m.State("TAKE_CHUNK"):
            m.d.comb += self.port.ready.eq(1)
            with m.If(self.port.valid):
                self._count_word(m)
                with m.If((self._left == 1) | (self._index == CHUNK_WORDS - 1)):
                    m.next = "WRITE_CHUNK"
        with m.State("WRITE_CHUNK"):
            m.d.comb += [self.master.start.eq(1), self.master.write.eq(1)]
            m.d.comb += self.master.words.eq(self._index)
            with m.If(self.master.done):
                with m.If(self._left == 0):
                    self._end(m)
                with m.Else():
                    self._next_chunk(m, "TAKE_CHUNK")

    def _count_word(self, m: Any) -> None:
        m.d.sync += [self._left.eq(self._left - 1), self._index.eq(self._index + 1)]

    def _end(self, m: Any) -> None:
        m.d.comb += self.done.eq(1)
        m.next = "BEGIN"

    def _next_chunk(self, m: Any, state: str) -> None:
        m.d.sync += [self._address.eq(self._address + CHUNK_BYTES), self._index.eq(0)]
        m.next = state
