"""Requests to the hub over a socket pair, one JSON datagram for each request and answer."""

from __future__ import annotations

import contextlib
import json
import os
import socket
import subprocess
import sys
import tempfile
import threading
import traceback
from pathlib import Path
from typing import Any

from pyroute2.netlink.exceptions import NetlinkError

from sfglab.lab.hosts.host import ENTER, HostsError

MAX_BYTES = 65536  #: Size of the largest request and answer.
_NAME = "the hub of the test hosts"
_HUB = (sys.executable, "-P", "-m", "sfglab.lab.hosts.hub")
_LIMIT_S = 20.0  #: Time for an answer, and for its end when the channel is closed, s.


class Channel:
    """A running hub that answers requests; it can be used from several threads."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._control, other = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self._control.settimeout(_LIMIT_S)
        self._log = tempfile.TemporaryFile()  # noqa: SIM115 - closed by `close`
        # The hub must find the same modules.
        modules = os.pathsep.join(path or str(Path.cwd()) for path in sys.path)
        creator = os.pidfd_open(os.getpid())
        numbers = (other.fileno(), creator)
        with other, contextlib.ExitStack() as failed:
            failed.callback(self._log.close)
            failed.callback(self._control.close)
            try:
                self._process = subprocess.Popen(
                    [*ENTER, "new", *_HUB, *map(str, numbers)],
                    env=os.environ | {"PYTHONPATH": modules},
                    stdin=subprocess.DEVNULL,
                    stdout=subprocess.DEVNULL,
                    stderr=self._log,
                    pass_fds=numbers,
                    # Ctrl-C in a terminal must reach the creator first, which then ends the processes in
                    # order.
                    start_new_session=True,
                )
            finally:
                os.close(creator)
            failed.pop_all()

    def request(self, operation: str, /, **arguments: Any) -> Any:
        """Request one of the hub's operations, and return what it returns; raises as `receive`."""
        with self._lock:
            with contextlib.suppress(OSError):  # the missing answer reports a lost process
                self._control.send(json.dumps({"op": operation, **arguments}).encode())
            return self.receive()

    def receive(self) -> Any:
        """Return the next answer. A hub that has started answers with the way that it got its namespace.

        Raises:
            HostsError: The hub has ended, is late, or failed.
            PermissionError: The kernel refused.
        """
        try:
            data = self._control.recv(MAX_BYTES)
        except TimeoutError:
            raise HostsError(f"{_NAME} did not respond for {_LIMIT_S:.0f} s") from None
        except OSError:
            data = b""
        if not data:
            raise HostsError(f"{_NAME} has ended: {self._last_line()}")
        answer: dict[str, Any] = json.loads(data)
        if "failed" in answer:
            raise HostsError(f"{_NAME} failed:\n{answer['failed']}")
        if "refused" in answer:
            raise PermissionError(answer["refused"])
        return answer["ok"]

    def _last_line(self) -> str:
        """Return the last line that the process wrote to standard error before it ended."""
        # The process closes its socket a moment before it has written the reason.
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._process.wait(1.0)
        # The process shares the file's offset, so the file is read without moving it.
        size = os.fstat(self._log.fileno()).st_size
        lines = os.pread(self._log.fileno(), size, 0).decode(errors="replace").strip().splitlines()
        return lines[-1] if lines else "it wrote no reason"

    def close(self) -> None:
        """End the process; idempotent."""
        # Unlike closing, this also reaches the process if a forked child has a copy of the socket.
        with contextlib.suppress(OSError):
            self._control.shutdown(socket.SHUT_RDWR)
        try:
            self._process.wait(_LIMIT_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        self._control.close()
        self._log.close()


def answer(control: socket.socket, operations: object) -> bool:
    """Receive one request, execute its operation, and send the answer; False if the channel is closed.

    Args:
        control: This process's end of the socket pair.
        operations: Object whose methods can be requested by their names.
    """
    data = control.recv(MAX_BYTES)
    if not data:
        return False
    request = json.loads(data)
    try:
        result = {"ok": getattr(operations, request.pop("op"))(**request)}
    except NetlinkError as error:
        result = {"refused": f"{error.args[1]} (errno {error.code})"}
    except PermissionError as error:
        result = {"refused": str(error)}
    except Exception:  # noqa: BLE001 - the creator raises the error; this process must continue, to clean up
        result = {"failed": traceback.format_exc()}
    control.send(json.dumps(result).encode())
    return True
