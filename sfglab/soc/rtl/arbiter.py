# mypy: allow-subclassing-any, disable-error-code="import-not-found,import-untyped"
"""Who has the memory interface: one of several masters, for one request, in turn.

Known of ReconROS' arbiter: it serves the nodes that request in turn, a request each, and no request overlaps
another. Ours is how that is done: the search for the next master takes no cycle of its own (the turn is granted
in the cycle in which a master waits for it, one of the four that a request takes anyway), it begins behind the
master served last, and a request ends by a wire, not by counting words. Each cycle of a slower search would add
1.5 % to a read of the default latency. Knows turns; refuses to know what a request is for, and messages.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from amaranth import Cat, Elaboratable, Module, Mux, Signal

from sfglab.soc.rtl.memif import MemoryPort

if TYPE_CHECKING:
    from collections.abc import Sequence


class Arbiter(Elaboratable):
    """Joins masters to one memory.

    While any master waits, a free interface is granted: no cycle is lost. From a master's request on, each
    other master is served at most once before it: none starves.

    Args:
        masters: Their ports; at least one.

    Attributes:
        masters: The same.
        memory: To the memory.
        turn: Out: one bit per master: whose turn it is, or was last.
        busy: Out: its request is under way.
    """

    def __init__(self, masters: Sequence[MemoryPort]) -> None:
        self.masters = masters
        self.memory = MemoryPort()
        self.turn = Signal(len(masters), init=1 << (len(masters) - 1))
        self.busy = Signal()

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
            m.d.comb += [master.grant.eq(granted & chosen[place]), master.read_data.eq(memory.read_data)]
        with m.Switch(self.turn):
            for place, master in enumerate(self.masters):
                with m.Case(1 << place):
                    self._join(m, master)
        return m

    def _choose(self, m: Any) -> Any:
        """Return the bit of the master to serve: the next behind the last turn that waits, else the first."""
        count = len(self.masters)
        waiting, behind, chosen = (Signal(count, name=name) for name in ("waiting", "behind", "chosen"))
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
