"""Other people's programs: heard while they work, or asked about texts, with a limit and without settings."""

from __future__ import annotations

import contextlib
import os
import shutil
import signal
import subprocess
import sys
import tempfile
from collections import deque
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING

from sfglab.deploy.errors import EXTRA, DeployError, MissingProgramError

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

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


_TIMEOUT_S = 60.0


def find_program(name: str, install: str = EXTRA) -> str:
    """Return the path of a program beside this Python or on ``PATH``, or raise a `MissingProgramError`."""
    beside = shutil.which(name, path=str(Path(sys.executable).parent))
    found = beside or shutil.which(name)
    if found is None:
        raise MissingProgramError(name, install)
    return found


def run_program(
    command: Sequence[str], texts: Mapping[str, str], *, timeout_s: float = _TIMEOUT_S
) -> tuple[int, str]:
    """Return a program's exit status and output, run in a folder with some files and nothing else.

    The command names files as `texts` does, which has contents by path relative to the folder. The program is
    killed and the folder removed when `timeout_s` seconds are up and when the caller is interrupted.

    Raises:
        DeployError: It did not start, did not end in time, or said nothing but why it could not work.
    """
    with tempfile.TemporaryDirectory(prefix="sfglab-check-") as folder:
        for name, text in texts.items():
            path = Path(folder, name)
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(text, encoding="utf-8")
        environment = {
            "PATH": os.environ.get("PATH", os.defpath),
            "HOME": folder,
            "LC_ALL": "C.UTF-8",
        }
        try:
            done = subprocess.run(
                list(command),
                cwd=folder,
                env=environment,
                stdin=subprocess.DEVNULL,
                capture_output=True,
                timeout=timeout_s,
                check=False,
            )
        except subprocess.TimeoutExpired as error:
            raise DeployError(
                f"{command[0]}: no answer within {timeout_s:g} s, and it was killed"
            ) from error
        except OSError as error:
            raise DeployError(f"{command[0]}: it did not start: {error}") from error
    output = done.stdout.decode(errors="replace")
    if done.returncode and not output.strip():
        words = done.stderr.decode(errors="replace").strip().splitlines() or ["it said nothing"]
        raise DeployError(f"{command[0]}: status {done.returncode}: {words[0]}")
    return done.returncode, output


@lru_cache(maxsize=64)
def answer_of(command: tuple[str, ...], texts: tuple[tuple[str, str], ...]) -> str:
    """Return a linter's output about texts, pairs of name and content, by `run_program`, once for the same."""
    return run_program(command, dict(texts))[1]
