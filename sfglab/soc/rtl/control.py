# mypy: allow-subclassing-any, disable-error-code="import-not-found,import-untyped"
"""The gateway core's control as hardware, generated from its table: one code per state, one bit per input.

Knows the table (`sfglab.soc.gateway.TABLE`) and registers; refuses to know where inputs come from. So it cannot
differ from the table in structure, and co-simulation shows that it does not differ in behaviour.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from amaranth import Elaboratable, Module, Signal

from sfglab.soc.gateway import TABLE, Drive, Input, Latch, State

if TYPE_CHECKING:
    from sfglab.soc.gateway.core import Table


ADDRESS_BITS = 64
"""Of addresses and of the words of OSIF, MEMIF and streams (ReconROS, 64-bit template)."""

_STATES, _INPUTS, _DRIVES = tuple(State), tuple(Input), tuple(Drive)


def state_code(state: State) -> int:
    """Return the number by which the register names a state."""
    return _STATES.index(state)


def input_code(given: Input) -> int:
    """Return the bit of `Control.given` that says an input."""
    return _INPUTS.index(given)


def drive_code(drive: Drive) -> int:
    """Return the bit of `Control.drive` that says a drive."""
    return _DRIVES.index(drive)


class Control(Elaboratable):
    """The state register and its moves; an input that the state does not wait for changes nothing.

    Args:
        table: The behaviour.

    Attributes:
        given: In: one bit per input that is there in this cycle. Of several, the row's first counts.
        value: In: the address beside the input.
        state: Out: code of the state.
        drive: Out: one bit per drive, exactly one of them set.
        output: Out: address of the output message.
        held: Out: address of the last message that the delegate gave.
    """

    def __init__(self, table: Table = TABLE) -> None:
        self.given = Signal(len(_INPUTS))
        self.value = Signal(ADDRESS_BITS)
        self.state = Signal(range(len(_STATES)), init=state_code(State.START))
        self.drive = Signal(len(_DRIVES))
        self.output = Signal(ADDRESS_BITS)
        self.held = Signal(ADDRESS_BITS)
        self._table = table

    def does(self, drive: Drive) -> Any:
        """Return the bit that says a drive."""
        return self.drive[drive_code(drive)]

    def elaborate(self, _platform: object) -> Any:
        """Return the logic."""
        m = Module()
        registers = {Latch.OUTPUT: self.output, Latch.HELD: self.held}
        with m.Switch(self.state):
            for state, row in self._table.items():
                with m.Case(state_code(state)):
                    m.d.comb += self.does(row.drive).eq(1)
                    for place, (given, move) in enumerate(row.moves.items()):
                        there = self.given[input_code(given)]
                        with m.Elif(there) if place else m.If(there):
                            m.d.sync += self.state.eq(state_code(move.to))
                            if move.latch is not None:
                                m.d.sync += registers[move.latch].eq(self.value)
        return m
