"""Locks among programs of one user on one host: files in a folder of the user, freed when the holder ends.

Abstract socket names are no alternative because any user could take a name first.
"""

from __future__ import annotations

import fcntl
import os
from contextlib import contextmanager
from typing import TYPE_CHECKING

from sfglab.bus.api import host_id
from sfglab.bus.errors import BusError
from sfglab.files import own_folder

if TYPE_CHECKING:
    from collections.abc import Iterator


class LockedError(BusError, RuntimeError):
    """A lock is held already; `pid` is the process that holds it, None if it cannot be read."""

    def __init__(self, name: str, pid: int | None) -> None:
        self.pid = pid
        super().__init__(
            f"lock {name}: process {pid or 'unknown'} holds it; end that process first"
        )


@contextmanager
def user_lock(name: str) -> Iterator[None]:
    """Hold a lock of this user on this host; `host_id` identifies the host.

    Raises:
        LockedError: The lock is held already.
        InvalidValueError: There is no home folder, and other users have access to the folder that replaces it.
    """
    path = own_folder() / f"{name}-{host_id()}.lock"
    while True:
        with path.open("a+") as lock:
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError as error:
                lock.seek(0)
                pid = lock.read(20)
                raise LockedError(name, int(pid) if pid.isdecimal() else None) from error
            if not os.fstat(lock.fileno()).st_nlink:
                continue  # the former holder has removed the file meanwhile
            lock.truncate(0)
            lock.write(f"{os.getpid()}")
            lock.flush()
            try:
                yield
            finally:
                path.unlink(missing_ok=True)
            return
