"""The creator's side of the hub: starts it, asks it, ends it.

The hub is a process of its own because only a process that has entered a namespace can work in it, and because
cleaning up must outlive the creator.
"""

from __future__ import annotations

import contextlib
import json
import os
import socket
import subprocess
import sys
import tempfile
import threading
from pathlib import Path
from typing import IO, Any

from sfglab.lab.hosts.errors import HostsError, HostsUnavailableError

ENTER = (sys.executable, "-I", "-S", str(Path(__file__).with_name("enter.py")))
"""Command line of the script that makes or joins namespaces; without site it starts in about 15 ms."""

_ANSWER_TIMEOUT_S = 20.0
_END_TIMEOUT_S = 10.0
_MAX_ANSWER_BYTES = 65536


def _hub_environment() -> dict[str, str]:
    """Let the hub find the same modules as this process, wherever it found them."""
    return os.environ | {"PYTHONPATH": os.pathsep.join(path or str(Path.cwd()) for path in sys.path)}


def _start(control: socket.socket, *, how: str, log: IO[bytes]) -> subprocess.Popen[bytes]:
    creator = os.pidfd_open(os.getpid())
    try:
        numbers = (control.fileno(), creator)
        hub = (sys.executable, "-P", "-m", "sfglab.lab.hosts.hub", *map(str, numbers))
        return subprocess.Popen(
            [*ENTER, "new", how, *hub],
            env=_hub_environment(),
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=log,
            pass_fds=numbers,
            # Ctrl-C in a terminal must reach the creator first, which then ends things in order.
            start_new_session=True,
        )
    finally:
        os.close(creator)


class Channel:
    """A running hub; safe to use from several threads.

    Args:
        how: ``auto``, ``root`` or ``rootless``.

    Attributes:
        how: How it obtained its namespaces, ``root`` or ``rootless``.

    Raises:
        HostsUnavailableError: The hub could not make its namespace.
    """

    def __init__(self, how: str) -> None:
        self._lock = threading.Lock()
        self._control, other = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self._log = tempfile.TemporaryFile()  # noqa: SIM115 - closed by `close`
        self._control.settimeout(_ANSWER_TIMEOUT_S)
        self._process: subprocess.Popen[bytes] | None = None
        try:
            with other:
                self._process = _start(other, how=how, log=self._log)
            self.how = str(self._receive()["how"])
        except HostsError as error:
            self.close()
            raise HostsUnavailableError(str(error)) from error
        except BaseException:
            self.close()
            raise

    def _said(self) -> str:
        """Return the last line that the hub wrote before it ended."""
        if self._process is not None:
            # It closes its socket a moment before it has said why.
            with contextlib.suppress(subprocess.TimeoutExpired):
                self._process.wait(1.0)
        # The offset is shared with the hub, so the file is read without moving it.
        size = os.fstat(self._log.fileno()).st_size
        lines = os.pread(self._log.fileno(), size, 0).decode(errors="replace").strip().splitlines()
        return lines[-1] if lines else "it ended without a word"

    def _receive(self) -> dict[str, Any]:
        try:
            data = self._control.recv(_MAX_ANSWER_BYTES)
        except TimeoutError:
            raise HostsError(
                f"the hub of the test hosts gave no answer for {_ANSWER_TIMEOUT_S:.0f} s"
            ) from None
        except OSError:
            data = b""
        if not data:
            raise HostsError(f"the hub of the test hosts has ended: {self._said()}")
        answer: dict[str, Any] = json.loads(data)
        if "failed" in answer:
            raise HostsError(f"the hub of the test hosts failed:\n{answer['failed']}")
        if "refused" in answer:
            raise PermissionError(answer["refused"])
        result: dict[str, Any] = answer["ok"]
        return result

    def request(self, operation: str, /, **arguments: Any) -> dict[str, Any]:
        """Ask the hub and wait for its answer.

        Args:
            operation: One of the hub's operations.
            arguments: What the operation takes.

        Returns:
            What the operation returns.

        Raises:
            HostsError: The hub is gone, late, or failed.
            PermissionError: The kernel refused.
        """
        with self._lock:
            with contextlib.suppress(OSError):  # a lost hub is reported by the answer
                self._control.send(json.dumps({"op": operation, **arguments}).encode())
            return self._receive()

    def close(self) -> None:
        """End the hub, which kills whatever is left inside the hosts; harmless when repeated."""
        # Unlike closing, this also reaches the hub when a forked child still has a copy of the socket.
        with contextlib.suppress(OSError):
            self._control.shutdown(socket.SHUT_RDWR)
        if self._process is not None:
            try:
                self._process.wait(_END_TIMEOUT_S)
            finally:
                self._process.kill()
                self._process.wait()
        self._control.close()
        self._log.close()
