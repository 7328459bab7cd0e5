"""The journal of a sweep: a file with the finished results and the identity of the sweep.

A journal is an append-only file of JSON lines, so that it survives a crash of its writer. The first
line identifies the sweep. Each other line holds the index of a point, a seed and their result.
Seeds are no part of the identity. Every result passes through its JSON text, which keeps all bits
of a float.
"""

from __future__ import annotations

import fcntl
import hashlib
import json
import logging
import shutil
import sys
from contextlib import contextmanager
from dataclasses import dataclass, field, fields, is_dataclass
from functools import cache
from importlib.metadata import version
from itertools import takewhile
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

import sfglab
from sfglab.errors import SfglabError

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping, Sequence
    from io import FileIO


class SweepError(SfglabError, RuntimeError):
    """A sweep that cannot run, or whose task failed."""


_log = logging.getLogger(__name__)

_NUMERIC = ("llvmlite", "numba", "numpy", "scipy")  # Each can change the last bit of a float.


def text_from_result(result: object) -> str:
    """Return a task's result as JSON: a row, which is a dataclass or a dict by column, or a tuple of rows.

    Raises:
        SweepError: A value has no form in JSON.
    """
    return json.dumps(result, default=_plain)


def _plain(value: object) -> object:
    """Return a value that JSON does not know as one that it knows."""
    if isinstance(value, np.generic):
        return value.item()
    if is_dataclass(value):
        return {field.name: getattr(value, field.name) for field in fields(value)}
    raise SweepError(f"result: given {value!r} in a row, allowed: bool, int, float, str and None")


def identity_of(task: Callable[..., object], points: Sequence[object]) -> dict[str, str]:
    """Return the identity of a sweep: its task, and digests of its points and of the code."""
    # The module of a task may be outside of sfglab. A module of a notebook has no file.
    file = getattr(sys.modules.get(task.__module__), "__file__", None)
    source = Path(file).read_bytes() if file else b""
    return {
        "task": f"{task.__module__}.{task.__qualname__}",
        "points": _digest("\n".join(map(repr, points)).encode()),
        "code": _digest(code_digest().encode() + source),
    }


@cache
def code_digest() -> str:
    """Return a digest of all files of sfglab and of the versions of the numeric libraries."""
    root = Path(sfglab.__file__).parent
    files = [path for path in root.rglob("*") if path.is_file() and "__pycache__" not in path.parts]
    lines = [f"{path.relative_to(root)} {_digest(path.read_bytes())}" for path in sorted(files)]
    lines += [f"{library} {version(library)}" for library in _NUMERIC]
    return _digest("\n".join(lines).encode())


def _digest(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()[:16]


@contextmanager
def journals(log: Path, name: str) -> Iterator[Callable[[str], Path]]:
    """Yield a function that returns the journal of a part, beside a log; remove these journals at the end.

    After an error the journals remain, so that the next run continues with them.
    """
    used: list[Path] = []

    def journal(part: str) -> Path:
        used.append(log.with_name(f"{name}-{part}.journal"))
        return used[-1]

    yield journal
    for path in used:
        path.unlink(missing_ok=True)


@dataclass(frozen=True, slots=True)
class Journal:
    """An open journal of a sweep: a file of JSON lines with one finished result each."""

    path: Path  #: Path of the file.
    file: FileIO  #: The file.
    #: Results by index of the point and seed. A dataclass comes back as a dict.
    finished: dict[tuple[int, int], Any] = field(default_factory=dict)

    def add(self, point: int, seed: int, text: str) -> None:
        """Append a result of `text_from_result`, with the index of its point and its seed."""
        line = f'{{"point": {point}, "seed": {seed}, "result": {text}}}\n'.encode()
        self.file.write(line)
        self._take(line)

    def resume(self, identity: Mapping[str, str]) -> None:
        """Read the results of the file. The journal of another sweep is copied, and begun again."""
        first, *lines = self.file.readall().splitlines(keepends=True) or [b""]
        found = _entry(first)
        header = {"sfglab_sweep": 1, **identity}
        differs = [key for key in header if found.get(key) != header[key]]
        if differs:
            if first:
                _set_aside(self.path, differs)
            self.file.truncate(0)
            self.file.write(json.dumps(header).encode() + b"\n")
        else:
            # A crash may have damaged a line. It and the following lines are run again.
            kept = [first, *takewhile(self._take, lines)]
            self.file.truncate(sum(map(len, kept)))

    def _take(self, line: bytes) -> bool:
        """Take the result of a line; return whether the line is complete."""
        match _entry(line):
            case {"point": int(point), "seed": int(seed), "result": result}:
                rows = tuple(result) if isinstance(result, list) else result
                self.finished[point, seed] = rows
                return True
        return False


@contextmanager
def open_journal(path: Path, identity: Mapping[str, str]) -> Iterator[Journal]:
    """Open the journal of a sweep for this process alone.

    Raises:
        SweepError: Another process writes it.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("a+b", buffering=0) as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise SweepError(
                f"{path}: another sweep is writing this journal; wait for it, or name another file"
            ) from None
        file.seek(0)
        journal = Journal(path, file)
        journal.resume(identity)
        yield journal


def _entry(line: bytes) -> dict[str, Any]:
    """Return the object of a line; an empty one for a damaged or incomplete line."""
    try:
        entry = json.loads(line)
    except (ValueError, RecursionError):
        return {}
    return entry if isinstance(entry, dict) and line.endswith(b"\n") else {}


def _set_aside(path: Path, differs: Sequence[str]) -> None:
    number = 1
    while (aside := path.with_name(f"{path.name}.{number}")).exists():
        number += 1
    shutil.copyfile(path, aside)
    message = "%s is the journal of another sweep (it differs in: %s); copied to %s"
    _log.warning(message, path, ", ".join(differs), aside.name)
