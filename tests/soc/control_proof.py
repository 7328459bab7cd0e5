"""The proof by induction that the control of the gateway core follows the core's table; it needs Yosys."""

from typing import Any

from amaranth import Const, Elaboratable, Module, Signal
from amaranth.hdl import Assert

from sfglab.soc.gateway import TABLE, Register, State, Table
from sfglab.soc.rtl.core import Control, code
from sfglab.soc.rtl.synthesis import run_yosys


def control_follows(table: Table = TABLE) -> bool:
    """Return whether the control generated from a table does what `TABLE` says, for all sequences of inputs.

    Raises:
        SfglabError: Yosys is missing or failed.
    """
    compared = _ComparedControl(table)
    wires = [compared.control.given, compared.control.value]
    script = [
        "prep -flatten -top top",
        "async2sync",
        "chformal -lower",
        "opt -full",
        "tee -q -o out sat -prove-asserts -set-init-zero -set rst 0 -tempinduct -maxsteps 2",
    ]
    return "Induction step proven" in run_yosys(compared, wires, script)


class _ComparedControl(Elaboratable):
    """A control with assertions: its outputs, and how its registers differ from those a cycle before."""

    def __init__(self, table: Table) -> None:
        self.control = Control(table)
        self._started = Signal()
        self._before: dict[str, Signal] = {}

    def elaborate(self, _platform: object) -> Any:
        """Return the logic."""
        m = Module()
        control = self.control
        m.submodules.control = control
        m.d.sync += self._started.eq(1)
        for name in ("state", "given", "value", "output", "held"):
            self._before[name] = Signal.like(getattr(control, name), name=f"before_{name}")
            m.d.sync += self._before[name].eq(getattr(control, name))
        m.d.comb += Assert(control.state < len(State))
        for state, row in TABLE.items():
            action_bits = 1 << code(row.action)
            m.d.comb += Assert((control.state != code(state)) | (control.action == action_bits))
            none_before: Any = Const(1)  # No earlier input of the row was present.
            for given, transition in row.transitions.items():
                present = self._before["given"][code(given)]
                self._assert_effect(
                    m, state, none_before & present, transition.target, transition.loads
                )
                none_before = none_before & ~present
            self._assert_effect(m, state, none_before, state, None)
        return m

    def _assert_effect(
        self, m: Any, state: State, condition: Any, target: State, loads: Register | None
    ) -> None:
        """Assert target and registers, if a cycle ago the control was in a state and a condition held."""
        before = self._before
        output = before["value"] if loads is Register.OUTPUT else before["output"]
        held = before["value"] if loads is Register.HELD else before["held"]
        applies = self._started & (before["state"] == code(state)) & condition
        m.d.comb += [
            Assert(~applies | (self.control.state == code(target))),
            Assert(~applies | (self.control.output == output)),
            Assert(~applies | (self.control.held == held)),
        ]
