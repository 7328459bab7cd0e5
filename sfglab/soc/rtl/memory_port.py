# mypy: allow-subclassing-any, disable-error-code="import-not-found,import-untyped"
"""The module `memory_port` has the memory interface (MEMIF) in hardware: wires, a master for chunks, and an arbiter.

All hardware nodes and the gateway cores share one interface to main memory (paper C, section 3). A request moves
one chunk of at most 32 words, and requests do not overlap. A request takes four control cycles, in the order of
ReconROS' memory controller: grant, command, address, and completion after the words.

ReconROS' arbiter serves waiting masters in turn, one request per master. Our arbiter grants the interface within one
of the four control cycles, so our arbiter takes no cycle of its own. Each further control cycle would add 1.5 % to
the time of a read.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from amaranth import Cat, Elaboratable, Module, Mux, Signal

if TYPE_CHECKING:
    from collections.abc import Sequence

#: Width of addresses and words at OSIF, MEMIF and streams (ReconROS, 64-bit template).
WORD_BITS = 64
WORD_BYTES = WORD_BITS // 8
CHUNK_WORDS = 32  #: Number of words of the longest request.
CHUNK_BYTES = CHUNK_WORDS * WORD_BYTES
COUNT_BITS = 32  #: Width of counters of words and cycles.


class MemoryPort:
    """A `MemoryPort` has the wires of a master and the memory; the master drives (m), the memory drives (s)."""

    def __init__(self) -> None:
        self.request = Signal()  #: (m) The master waits for a grant.
        self.grant = Signal()  #: (s) The memory grants the interface to the master.
        self.command = Signal()  #: (m) `write` and `words` are valid.
        self.write = Signal()  #: (m) Whether the request writes.
        # The wire has another name than the gateway's own `words` in the exported Verilog module.
        self.words = Signal(range(CHUNK_WORDS + 1), name="request_words")  #: (m) Number of words.
        self.address_valid = Signal()  #: (m) `address` is valid.
        self.address = Signal(WORD_BITS)  #: (m) Address of the first byte.
        #: (s) `read_data` is valid; the master takes the word in any case.
        self.read_valid = Signal()
        self.read_data = Signal(WORD_BITS)  #: (s) Word that the memory has read.
        self.write_valid = Signal()  #: (m) `write_data` is valid.
        self.write_ready = Signal()  #: (s) The memory takes `write_data` in this cycle.
        self.write_data = Signal(WORD_BITS)  #: (m) Word that the master writes.
        self.response = Signal()  #: (s) All words of a write have arrived.
        self.complete = Signal()  #: (m) The request ends; the interface is free in the next cycle.


class MemoryMaster(Elaboratable):
    """A `MemoryMaster` moves one chunk between the memory and a buffer of the master's owner."""

    def __init__(self) -> None:
        self.port = MemoryPort()  #: Wires to the memory.
        self.start = Signal()  #: In: the owner wants a request; the signal stays set until `done`.
        #: In: whether the chunk moves from the buffer to memory; otherwise from memory to the buffer.
        self.write = Signal()
        self.words = Signal(range(CHUNK_WORDS + 1))  #: In: number of words.
        self.address = Signal(WORD_BITS)  #: In: address of the first byte.
        self.index = Signal(range(CHUNK_WORDS))  #: Out: index of the present word in the buffer.
        self.word_valid = Signal()  #: Out: the buffer must store `word` at `index`.
        self.word = Signal(WORD_BITS)  #: Out: word that the master has read.
        self.buffered = Signal(WORD_BITS)  #: In: word of the buffer at `index`.
        self.done = Signal()  #: Out: the request ends; the signal is set for one cycle.

    def elaborate(self, _platform: object) -> Any:
        """Return the logic of the port; the states GRANT, COMMAND, ADDRESS and COMPLETE take one cycle each."""
        m = Module()
        port = self.port
        m.d.comb += [
            port.write.eq(self.write),
            port.words.eq(self.words),
            port.address.eq(self.address),
            port.write_data.eq(self.buffered),
            self.word.eq(port.read_data),
        ]
        with m.FSM():
            with m.State("GRANT"):
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
                with m.If(port.read_valid):
                    self._count_word(m, "COMPLETE")
            with m.State("WRITE"):
                m.d.comb += port.write_valid.eq(1)
                with m.If(port.write_ready):
                    self._count_word(m, "RESPONSE")
            with m.State("RESPONSE"), m.If(port.response):
                m.next = "COMPLETE"
            with m.State("COMPLETE"):
                m.d.comb += [port.complete.eq(1), self.done.eq(1)]
                m.next = "GRANT"
        return m

    def _count_word(self, m: Any, next_state: str) -> None:
        """Count a word that passes, and change the state after the last word."""
        m.d.sync += self.index.eq(self.index + 1)
        with m.If(self.index + 1 == self.words):
            m.next = next_state


class Arbiter(Elaboratable):
    """An `Arbiter` joins the ports of one or more masters to one memory in turn (round robin).

    The arbiter loses no cycle, because a waiting master gets the free interface at once. No master starves, because
    the arbiter serves each other master at most once while a master waits.
    """

    def __init__(self, masters: Sequence[MemoryPort]) -> None:
        self.masters = masters
        self.memory = MemoryPort()  #: Wires to the memory.
        #: Out: one bit per master; the bit of the master that the arbiter serves or has served last is set.
        self.turn = Signal(len(masters), init=1 << (len(masters) - 1))
        self.busy = Signal()  #: Out: a request is in progress.

    @property
    def wires(self) -> list[Any]:
        """Return the ports of the exported Verilog module."""
        return [wire for port in (*self.masters, self.memory) for wire in vars(port).values()]

    def elaborate(self, _platform: object) -> Any:
        """Return the logic of the arbiter as a module of Amaranth."""
        m = Module()
        memory = self.memory
        chosen = self._choose(m)
        granted = Signal()
        m.d.comb += granted.eq(~self.busy & memory.grant & chosen.any())
        m.d.comb += memory.request.eq(~self.busy & chosen.any())
        with m.If(granted):
            m.d.sync += [self.turn.eq(chosen), self.busy.eq(1)]
        with m.Elif(memory.complete):
            m.d.sync += self.busy.eq(0)
        for place, master in enumerate(self.masters):
            m.d.comb += master.grant.eq(granted & chosen[place])
            m.d.comb += master.read_data.eq(memory.read_data)
        with m.Switch(self.turn):
            for place, master in enumerate(self.masters):
                with m.Case(1 << place):
                    self._connect(m, master)
        return m

    def _choose(self, m: Any) -> Any:
        """Return one bit per master; the bit of the waiting master that is next after the last turn is set."""
        count = len(self.masters)
        waiting = Signal(count)
        behind = Signal(count)
        first = Signal(count)
        chosen = Signal(count)
        m.d.comb += [
            waiting.eq(Cat(master.request for master in self.masters)),
            behind.eq(waiting & ~(self.turn | (self.turn - 1))),
            first.eq(Mux(behind.any(), behind, waiting)),
            chosen.eq(first & -first),
        ]
        return chosen

    def _connect(self, m: Any, master: MemoryPort) -> None:
        """Connect the served master to the memory."""
        memory = self.memory
        m.d.comb += [
            memory.write.eq(master.write),
            memory.words.eq(master.words),
            memory.address.eq(master.address),
            memory.write_data.eq(master.write_data),
        ]
        with m.If(self.busy):
            for name in ("command", "address_valid", "write_valid", "complete"):
                m.d.comb += getattr(memory, name).eq(getattr(master, name))
            for name in ("read_valid", "write_ready", "response"):
                m.d.comb += getattr(master, name).eq(getattr(memory, name))
