"""Running a program whose lines are heard while it works; interrupted, it ends with all that it started."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
from collections import deque
from typing import TYPE_CHECKING

from sfglab.deploy.errors import DeployError

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence


_GRACE_S = 10.0
_LAST_WORDS = 20


def run_heard(command: Sequence[str], hear: Callable[[str], None], what: str = "") -> None:
    """Run a program to a good end, and hand on each line that it says.

    Args:
        command: Program and arguments.
        hear: Told each line.
        what: What it does, for the error; its name when not given.

    Raises:
        DeployError: It failed, with its last words, or is not installed.
    """
    last: deque[str] = deque(maxlen=_LAST_WORDS)

    def keep(line: str) -> None:
        last.append(line)
        hear(line)

    status = run_streaming(command, keep)
    if status != 0:
        words = "\n".join(last)
        raise DeployError(f"{what or command[0]}: ended with status {status}; its last words:\n{words}")


def run_streaming(command: Sequence[str], hear: Callable[[str], None]) -> int:
    """Run a program, hear its lines, and return its status; interrupted, it ends with its children.

    Raises:
        DeployError: There is no such program.
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
        raise DeployError(f"{command[0]}: given a program that does not start: {error}") from error
    assert process.stdout is not None
    try:
        for line in process.stdout:
            hear(line.rstrip("\n"))
        return process.wait()
    except BaseException:
        _end(process)
        raise
    finally:
        process.stdout.close()


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
