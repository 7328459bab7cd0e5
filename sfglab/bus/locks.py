"""Locks among one user's programs on one host: files in a folder of the user's, freed with their holder.

Names among abstract sockets would be whose who takes them first.
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
    """Another one holds a lock; `pid` is its process, None when it cannot be seen from here."""

    def __init__(self, name: str, pid: int | None) -> None:
        self.pid = pid
        super().__init__(f"lock {name}: process {pid} has it, allowed is one")


@contextmanager
def user_lock(name: str) -> Iterator[None]:
    """Hold a lock of this user on this host, a host being what `host_id` calls so.

    Raises:
        LockedError: Another one holds it.
        InvalidValueError: There is no home, and somebody else can write to the folder in its place.
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
                continue  # whoever had it has taken the file away meanwhile
            lock.truncate(0)
            lock.write(f"{os.getpid()}")
            lock.flush()
            try:
                yield
            finally:
                path.unlink(missing_ok=True)
            return
