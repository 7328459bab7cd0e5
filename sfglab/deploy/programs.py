"""Programs of other projects: search for a program, and its output while it runs."""

from __future__ import annotations

import contextlib
import os
import shutil
import signal
import subprocess
import sys
from collections import deque
from pathlib import Path
from typing import TYPE_CHECKING

from sfglab.deploy.errors import EXTRA, DeployError, MissingProgramError

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

_GRACE_S = 10.0
_LAST_LINES = 20


def run_streamed(command: Sequence[str], on_line: Callable[[str], None], name: str = "") -> None:
    """Run a program to its end; its child processes end with it.

    Args:
        command: Program and arguments.
        on_line: Called with each line of the output.
        name: Name of the program in errors; by default that of the command.

    Raises:
        DeployError: The program does not start, or fails; the error has the last lines of the output.
    """
    try:
        process = subprocess.Popen(
            command,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            errors="replace",
            start_new_session=True,
        )
    except OSError as error:
        raise DeployError(
            f"{command[0]} cannot be started ({error.strerror}); check its installation"
        ) from error
    assert process.stdout is not None
    last: deque[str] = deque(maxlen=_LAST_LINES)
    try:
        for line in process.stdout:
            last.append(line.rstrip("\n"))
            on_line(last[-1])
        status = process.wait()
    except BaseException:
        _end(process)
        raise
    finally:
        process.stdout.close()
    if status != 0:
        lines = "\n".join(last)
        raise DeployError(
            f"{name or command[0]}: ended with status {status}; its last lines:\n{lines}"
        )


def _end(process: subprocess.Popen[str]) -> None:
    """End a program and the processes of its session: with SIGTERM, then with SIGKILL."""
    with contextlib.suppress(ProcessLookupError):
        os.killpg(process.pid, signal.SIGTERM)
    with contextlib.suppress(subprocess.TimeoutExpired):
        process.wait(_GRACE_S)
    with contextlib.suppress(ProcessLookupError):  # raised if no process of the session is left
        os.killpg(process.pid, signal.SIGKILL)
    process.wait()


def find_program(name: str, install: str = EXTRA) -> str:
    """Return the path of a program, in the folder of this Python or on ``PATH``.

    Args:
        name: Name of the program.
        install: Command that installs the program, for errors.

    Raises:
        MissingProgramError: The program is not installed.
    """
    beside = shutil.which(name, path=str(Path(sys.executable).parent))
    found = beside or shutil.which(name)
    if found is None:
        raise MissingProgramError(name, install)
    return found
