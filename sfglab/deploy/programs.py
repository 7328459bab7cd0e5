"""Programs of other projects: where they are, and their output while they run."""

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
_LAST_WORDS = 20


def run_heard(command: Sequence[str], hear: Callable[[str], None], what: str = "") -> None:
    """Run a program to its end, and hand on each line; `DeployError` if it fails. Its children end with it."""
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
        raise DeployError(f"{command[0]}: given a program that does not start: {error}") from error
    assert process.stdout is not None
    last: deque[str] = deque(maxlen=_LAST_WORDS)
    try:
        for line in process.stdout:
            last.append(line.rstrip("\n"))
            hear(last[-1])
        status = process.wait()
    except BaseException:
        _end(process)
        raise
    finally:
        process.stdout.close()
    if status != 0:
        words = "\n".join(last)
        raise DeployError(
            f"{what or command[0]}: ended with status {status}; its last words:\n{words}"
        )


def _end(process: subprocess.Popen[str]) -> None:
    """End a program and all of its session: first asked, then made to."""
    for how, limit_s in ((signal.SIGTERM, _GRACE_S), (signal.SIGKILL, None)):
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, how)
        with contextlib.suppress(subprocess.TimeoutExpired):
            process.wait(limit_s)
            break
    # The leader has ended; what it started may have not.
    with contextlib.suppress(ProcessLookupError):
        os.killpg(process.pid, signal.SIGKILL)


def find_program(name: str, install: str = EXTRA) -> str:
    """Return the path of a program beside this Python or on ``PATH``, or raise a `MissingProgramError`."""
    beside = shutil.which(name, path=str(Path(sys.executable).parent))
    found = beside or shutil.which(name)
    if found is None:
        raise MissingProgramError(name, install)
    return found
