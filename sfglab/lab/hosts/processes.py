"""Which processes live in a network namespace, and their orderly end.

A namespace of ours holds only what was started inside, grandchildren and daemons too, so membership is the
whole bookkeeping. Signals go through pidfds (pidfd_open(2)), whose membership is checked after opening:
a pid that another process took over meanwhile is never hit.
"""

from __future__ import annotations

import contextlib
import os
import select
import signal
import time
from pathlib import Path
from typing import TYPE_CHECKING

from sfglab.lab.hosts.errors import HostsError

if TYPE_CHECKING:
    from collections.abc import Collection, Iterator


# A killed process is gone within milliseconds, unless it is stuck in a device driver.
_KILL_TIMEOUT_S = 5.0


def _inode(pid: int) -> int:
    """Return the inode of a process's network namespace, 0 when it ended or is not ours to see."""
    try:
        return os.stat(f"/proc/{pid}/ns/net").st_ino  # noqa: PTH116 - called for every process
    except OSError:
        return 0


def members(inodes: Collection[int]) -> list[int]:
    """Return the pids of all processes in some network namespaces, except the calling one.

    Args:
        inodes: The namespaces, by the inodes of their files below ``/proc/PID/ns``.
    """
    pids = (int(entry.name) for entry in Path("/proc").iterdir() if entry.name.isdigit())
    return [pid for pid in pids if pid != os.getpid() and _inode(pid) in inodes]


@contextlib.contextmanager
def _handles(inodes: Collection[int], spare: Collection[int]) -> Iterator[dict[int, int]]:
    """Open a pidfd for each member, with the pid as its value."""
    handles: dict[int, int] = {}
    try:
        for pid in members(inodes):
            if pid in spare:
                continue
            with contextlib.suppress(ProcessLookupError):
                fd = os.pidfd_open(pid)
                handles[fd] = pid
                if _inode(pid) not in inodes:
                    os.close(fd)
                    del handles[fd]
        yield handles
    finally:
        for fd in handles:
            os.close(fd)


def _wait(handles: Collection[int], deadline_s: float) -> None:
    """Wait until all processes ended, or for the deadline."""
    poll = select.poll()
    for fd in handles:
        poll.register(fd, select.POLLIN)
    left = len(handles)
    while left and (rest_s := deadline_s - time.monotonic()) > 0:
        for fd, _ in poll.poll(rest_s * 1000):
            poll.unregister(fd)
            left -= 1


def _signal_all(inodes: Collection[int], spare: Collection[int], number: int, deadline_s: float) -> list[int]:
    """Signal all members, wait for their end, and return those that were there."""
    with _handles(inodes, spare) as handles:
        for fd in handles:
            with contextlib.suppress(ProcessLookupError):
                signal.pidfd_send_signal(fd, number)
        _wait(handles, deadline_s)
        return list(handles.values())


def end_members(inodes: Collection[int], *, grace_s: float, spare: Collection[int] = ()) -> None:
    """End all processes in some network namespaces: TERM, a grace, then KILL, until none is left.

    Args:
        inodes: The namespaces.
        grace_s: How long a process may take to end by itself, in seconds; 0 kills at once.
        spare: Pids to leave alone.

    Raises:
        HostsError: A killed process did not end.
    """
    if grace_s > 0:
        _signal_all(inodes, spare, signal.SIGTERM, time.monotonic() + grace_s)
    deadline_s = time.monotonic() + _KILL_TIMEOUT_S
    while stubborn := _signal_all(inodes, spare, signal.SIGKILL, deadline_s):
        if time.monotonic() > deadline_s:
            raise HostsError(f"processes {stubborn} inside test hosts were killed but did not end")
