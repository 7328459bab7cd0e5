# mypy: allow-subclassing-any, disable-error-code="import-not-found,import-untyped"
"""The master of the memory interface: one chunk at a time, four control cycles, nothing overlaps.

The order is that of ReconROS' memory controller: wait for one's turn, command, address, words, completion.
Knows one request and its cycles; refuses to know messages, and what the words are for.
"""

from __future__ import annotations

from typing import Any

from amaranth import Elaboratable, Module, Signal

from sfglab.soc.rtl.control import ADDRESS_BITS

CHUNK_WORDS = 32
"""Words of the longest request: 256 bytes of 64 bits."""


class MemoryPort:
    """The wires between a master and the memory; (m) the master drives, (s) the memory.

    Attributes:
        request: (m) The master waits for its turn.
        grant: (s) The interface is this master's turn.
        command: (m) A command stands here: `write` and `words` count.
        write: (m) The request writes.
        words: (m) How many words, 1 to `CHUNK_WORDS`.
        address_valid: (m) The address stands here.
        address: (m) Of the first byte.
        read_valid: (s) A word that was read stands here; the master always takes it.
        read_data: (s) The word.
        write_valid: (m) A word to write stands here.
        write_ready: (s) The memory takes it.
        write_data: (m) The word.
        response: (s) All words of a write have arrived.
        complete: (m) The request is through, the interface free from the next cycle on.
    """

    def __init__(self) -> None:
        self.request = Signal()
        self.grant = Signal()
        self.command = Signal()
        self.write = Signal()
        # Named apart from the gateway's own `words`, beside which it stands in the exported module.
        self.words = Signal(range(CHUNK_WORDS + 1), name="request_words")
        self.address_valid = Signal()
        self.address = Signal(ADDRESS_BITS)
        self.read_valid = Signal()
        self.read_data = Signal(ADDRESS_BITS)
        self.write_valid = Signal()
        self.write_ready = Signal()
        self.write_data = Signal(ADDRESS_BITS)
        self.response = Signal()
        self.complete = Signal()


class MemoryMaster(Elaboratable):
    """Moves one chunk between the memory and a buffer.

    Attributes:
        port: To the memory.
        start: In: a request is wanted; stays set, with its parameters, until `done`.
        write: In: from the buffer to memory, else from memory to the buffer.
        words: In: how many.
        address: In: of the first byte.
        index: Out: the word of the buffer that is concerned.
        word_valid: Out: `word` belongs into the buffer at `index`.
        word: Out: a word that was read.
        buffered: In: the buffer's word at `index`.
        done: Out: the request is through; set for one cycle.
    """

    def __init__(self) -> None:
        self.port = MemoryPort()
        self.start = Signal()
        self.write = Signal()
        self.words = Signal(range(CHUNK_WORDS + 1))
        self.address = Signal(ADDRESS_BITS)
        self.index = Signal(range(CHUNK_WORDS))
        self.word_valid = Signal()
        self.word = Signal(ADDRESS_BITS)
        self.buffered = Signal(ADDRESS_BITS)
        self.done = Signal()

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
