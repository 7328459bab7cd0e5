# mypy: allow-subclassing-any, disable-error-code="import-not-found,import-untyped"
"""The data path of the gateway core: whole messages between memory and stream, a stored chunk at a time.

A message on the stream is its publisher's id and then its words; in memory it is its words. Its type fixes
their number. Knows chunks; refuses to know why a message moves.
"""

from __future__ import annotations

from typing import Any

from amaranth import Elaboratable, Module, Mux, Signal
from amaranth.lib.memory import Memory

from sfglab.soc.rtl.control import ADDRESS_BITS
from sfglab.soc.rtl.memif import CHUNK_WORDS, MemoryMaster
from sfglab.soc.rtl.topic import Stream

COUNT_BITS = 32
"""Of a message's number of words."""
_CHUNK_BYTES = CHUNK_WORDS * ADDRESS_BITS // 8


class Mover(Elaboratable):
    """Copies or drops one message; a command stays set until `done`.

    Attributes:
        master: Its master of the memory interface.
        sent: To the topic.
        port: From the topic.
        send: In: copy from memory to the topic, and ignore what the port echoes.
        store: In: copy from the port to memory.
        drop: In: take the message at the port and forget it.
        source: In: address of the message to send.
        target: In: address to which a message is stored.
        words: In: of a message, without its id; at least 1.
        own_id: In: the first word of what is sent.
        done: Out: the last beat is through; set for one cycle.
    """

    def __init__(self) -> None:
        self.master = MemoryMaster()
        self.sent = Stream("sent")
        self.port = Stream("port")
        self.send = Signal()
        self.store = Signal()
        self.drop = Signal()
        self.source = Signal(ADDRESS_BITS)
        self.target = Signal(ADDRESS_BITS)
        self.words = Signal(COUNT_BITS)
        self.own_id = Signal(ADDRESS_BITS)
        self.done = Signal()
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
            m.d.comb += [self.master.start.eq(1), self.master.words.eq(Mux(few, self._left, CHUNK_WORDS))]
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
