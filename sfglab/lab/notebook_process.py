"""Process that runs a notebook with papermill: ``python -m sfglab.lab.notebook_process NICE ARGUMENTS``.

The arguments are those of `run_notebook`, as JSON. The process reports ``{"is": "done", "error": ...}``.
It ends with its standard input, also in the middle of the notebook.
"""

from __future__ import annotations

import io
import json
import os
import signal
import sys
import tempfile
import threading
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

import psutil
from jupyter_client.manager import AsyncKernelManager
from traitlets.config import Config

from sfglab.component import claim_standard_output
from sfglab.lab.iri_grammars import without_iri_grammars
from sfglab.lab.notebooks import COPY_VARIABLE
from sfglab.lab.progress import is_line

with without_iri_grammars():
    import papermill

if TYPE_CHECKING:
    from collections.abc import Mapping

    from nbformat import NotebookNode


def main() -> None:
    """Run a notebook, or end with standard input."""
    report = claim_standard_output()
    nice, given = sys.argv[1:]
    os.nice(int(nice))
    signal.signal(signal.SIGTERM, lambda *_: sys.exit())
    threading.Thread(target=_end_with_input, daemon=True).start()
    report({"is": "done", "error": run_notebook(**json.loads(given))})


def _end_with_input() -> None:
    os.read(0, 1)
    os.kill(os.getpid(), signal.SIGTERM)


def run_notebook(path: str, copy: str, parameters: Mapping[str, Any]) -> str:
    """Run a notebook; return why it failed, or an empty text.

    Args:
        path: Path of the notebook. Its kernel works in its folder.
        copy: Path of the executed copy, which is kept also after a failure.
        parameters: Values for its parameters cell.
    """
    Path(copy).parent.mkdir(parents=True, exist_ok=True)
    os.environ[COPY_VARIABLE] = copy  # kernels inherit it
    skipper = _Skipper()
    try:
        with tempfile.TemporaryDirectory() as folder:
            # Only this user can reach a kernel, and not over TCP. All its files end with the folder.
            sockets = {
                "transport": "ipc",
                "ip": f"{folder}/kernel",
                "connection_file": f"{folder}/kernel.json",
            }
            papermill.execute_notebook(
                path,
                copy,
                parameters,
                kernel_name="python3",
                language="python",
                cwd=str(Path(path).parent),
                progress_bar=False,
                stdout_file=_Steps(),
                stderr_file=sys.stderr,
                config=Config({"KernelManager": sockets}),
                allow_errors=True,
                on_notebook_start=_lower_kernel,
                kernel_manager_class=_Kernel,
                on_cell_start=skipper.skip,
                on_cell_execute=_Kernel.begin,
                on_cell_executed=_Kernel.end,
                on_cell_error=skipper.note,
            )
    except papermill.PapermillExecutionError as error:
        return f"cell {error.exec_count}: {error.ename}: {error.evalue}"
    except RuntimeError as error:  # the kernel died
        return str(error)
    return ""


class _Kernel(AsyncKernelManager):
    """Kernel whose shutdown interrupts a running cell only.

    An idle kernel ignores the signal, but a kernel that has just sent a reply may still print an
    error about it.
    """

    _is_busy = False  # whether a cell runs

    @classmethod
    def begin(cls, **_: Any) -> None:
        """Record that a cell runs."""
        cls._is_busy = True

    @classmethod
    def end(cls, **_: Any) -> None:
        """Record that no cell runs."""
        cls._is_busy = False

    async def _async_interrupt_kernel(self) -> None:
        if self._is_busy:
            await super()._async_interrupt_kernel()


class _Steps(io.TextIOBase):
    """Stream that writes a notebook's lines of progress to standard error."""

    def write(self, text: str) -> int:
        sys.stderr.writelines(line for line in text.splitlines(keepends=True) if is_line(line))
        return len(text)


class _Skipper:
    """Filter that skips the cells between a failed cell and the next experiment."""

    def __init__(self) -> None:
        self._has_failed = False

    def note(self, **_: Any) -> None:
        """Record that a cell failed."""
        self._has_failed = True

    def skip(self, cell: NotebookNode, **_: Any) -> None:
        """Skip a cell, unless it runs an experiment."""
        if "notebook.run(" in cell.source:
            self._has_failed = False
        if self._has_failed and cell.cell_type == "code":
            cell.metadata.tags = [*cell.metadata.get("tags", ()), "skip-execution"]


def _lower_kernel(**_: Any) -> None:
    """Give the kernel's session the priority of this process.

    Where Linux schedules by session, the priority of a session counts, and not that of its
    processes.
    """
    nice = os.nice(0)
    for child in psutil.Process().children():
        with suppress(OSError):
            Path(f"/proc/{child.pid}/autogroup").write_text(f"{nice}", encoding="ascii")


if __name__ == "__main__":
    main()
