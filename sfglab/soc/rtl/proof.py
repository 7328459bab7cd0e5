# mypy: allow-subclassing-any, disable-error-code="import-not-found,import-untyped"
"""The control in hardware held against the core's table, for every sequence of inputs, by induction with Yosys.

The hardware is generated from the table, so what is proved is the generator: that each state asks for its one
drive, the row's first input that is there moves the state and latches what it says, and nothing else changes.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from amaranth import Const, Elaboratable, Module, Signal
from amaranth.hdl import Assert

from sfglab.soc.gateway import TABLE, Latch, State, Table
from sfglab.soc.rtl.core import Control, code
from sfglab.soc.rtl.synthesis import run_yosys

if TYPE_CHECKING:
    from collections.abc import Sequence


class _Compared(Elaboratable):
    """The control beside what it was and had a cycle ago, and what the table says of the two."""

    def __init__(self, table: Table) -> None:
        self.control = Control(table)

    def elaborate(self, _platform: object) -> Any:
        """Return the logic."""
        m = Module()
        m.submodules.control = now = self.control
        names, begun = ("state", "given", "value", "output", "held"), Signal()
        was = {name: Signal.like(getattr(now, name), name=f"was_{name}") for name in names}
        m.d.sync += [begun.eq(1), *(was[name].eq(getattr(now, name)) for name in names)]
        m.d.comb += Assert(now.state < len(State))
        for state, row in TABLE.items():
            m.d.comb += Assert((now.state != code(state)) | (now.drive == 1 << code(row.drive)))
            free: Any = Const(1)
            for given, move in row.moves.items():
                there = was["given"][code(given)]
                self._claim(m, (begun & (was["state"] == code(state)) & free & there, was), move.to, move.latch)
                free = free & ~there
            self._claim(m, (begun & (was["state"] == code(state)) & free, was), state, None)
        return m

    def _claim(self, m: Any, case: tuple[Any, Any], to: State, latch: Latch | None) -> None:
        """Assert where a case leads and what it latches."""
        (here, was), now = case, self.control
        output = was["value"] if latch is Latch.OUTPUT else was["output"]
        held = was["value"] if latch is Latch.HELD else was["held"]
        m.d.comb += Assert(~here | ((now.state == code(to)) & (now.output == output) & (now.held == held)))


def control_follows(table: Table = TABLE) -> bool:
    """Return whether the hardware that is generated from a table does what the core's table says, always.

    Raises:
        SfglabError: Yosys is missing or failed.
    """
    compared = _Compared(table)
    return is_proved(compared, [compared.control.given, compared.control.value], 2)


def is_proved(design: Any, wires: Sequence[Any], depth: int) -> bool:
    """Return whether a design's assertions hold for ever, by induction over so many cycles at most.

    Raises:
        SfglabError: Yosys is missing or failed.
    """
    script = ["prep -flatten -top top", "async2sync", "chformal -lower", "opt -full"]
    prove = f"sat -prove-asserts -set-assumes -set-init-zero -set rst 0 -tempinduct -maxsteps {depth}"
    return "Induction step proven" in run_yosys(design, wires, [*script, f"tee -q -o out {prove}"])
