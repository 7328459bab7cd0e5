"""Doors that bytes of strangers come through: what is read there, what refuses it, and with what to begin.

A door answers or raises its one class of error, within a second of processor time and in little memory. Each
module here has some: its `DOORS` by name, and `ATTACKS`, inputs with which one of them once did not. It is
imported in a process of its own, which so has only what its doors need.
"""

import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

from sfglab.errors import SfglabError

ROOT = Path(__file__).parents[3]
_OWN = tempfile.TemporaryDirectory(prefix="fuzz-", dir="/dev/shm")  # gone with its process
FOLDER = Path(_OWN.name)
RULE = "=" * 80


class Door(NamedTuple):
    """A place where strangers' bytes are read."""

    read: Callable[[bytes], object]
    refuses: type[SfglabError] | tuple[type[SfglabError], ...]
    begins: tuple[bytes, ...]  # what is sent by friends


def text(read):
    return lambda data: read(data.decode("utf-8", "surrogateescape"))
