"""The journal of a sweep: what is finished, on disk, with the identity of its task, points and code.

An append-only file of JSON lines that survives the death of its writer. The first line says which sweep it is,
every other one is a finished point and seed with its result. It is not MCAP, which ends with a summary and an
index: here a torn last line is cut away and the next is appended. Every result passes through its text, in
which a float is the shortest that gives it again. Two sweeps of one identity give the same rows; seeds are not
part of it.
"""

from __future__ import annotations

import fcntl
import hashlib
import inspect
import json
import logging
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass, fields, is_dataclass
from functools import cache
from importlib import import_module
from importlib.metadata import version
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

import sfglab
from sfglab.errors import SfglabError


class SweepError(SfglabError, RuntimeError):
    """A sweep that cannot be run, or whose task failed."""

    def __init__(self, message: str, *, point: object = None, seed: int | None = None) -> None:
        self.point = point  #: Of the failed task; None when it was not a task that failed.
        self.seed = seed  #: Of the failed task; None as above.
        super().__init__(message)


class JournalError(SfglabError, OSError):
    """A file that cannot serve as a sweep's journal."""


_PLAIN = (bool, int, float, str, type(None))


def text_from_result(result: object) -> str:
    """Return a result, a row, a mapping by column, or a tuple of them, as JSON, or raise a `SweepError`."""
    if isinstance(result, tuple):
        return json.dumps([_packed(row) for row in result])
    return json.dumps(_packed(result))


def result_from_text(text: str) -> Any:
    """Return what `text_from_result` was given, or raise a `JournalError`."""
    try:
        packed = json.loads(text)
        return tuple(map(_unpacked, packed)) if isinstance(packed, list) else _unpacked(packed)
    except (
        ValueError,
        LookupError,
        TypeError,
        AttributeError,
        ImportError,
        RecursionError,
    ) as error:
        raise JournalError(
            f"no result of a sweep ({error!r}); remove the journal to run it again"
        ) from error


def _packed(row: object) -> dict[str, object]:
    if isinstance(row, Mapping):
        return {
            "columns": {str(name): _plain(dict, str(name), value) for name, value in row.items()}
        }
    if isinstance(row, type) or not is_dataclass(row):
        raise SweepError(f"result: given {row!r}, needed is a row (a dataclass) or a tuple of rows")
    kind = type(row)
    values = [_plain(kind, field.name, getattr(row, field.name)) for field in fields(row)]
    return {"row": f"{kind.__module__}:{kind.__qualname__}", "values": values}


def _plain(kind: type, name: str, value: object) -> object:
    if isinstance(value, np.generic):
        value = value.item()
    if type(value) not in _PLAIN:
        given, allowed = type(value).__name__, "bool, int, float, str and None"
        raise SweepError(f"row {kind.__qualname__}: {name}: given a {given}, allowed are {allowed}")
    return value


def _unpacked(packed: dict[str, Any]) -> Any:
    if "columns" in packed:
        return packed["columns"]
    module, _, name = packed["row"].partition(":")
    # A file must not choose what is imported; a task's own module is there.
    kind: Any = import_module(module) if module.startswith("sfglab.") else sys.modules[module]
    for part in name.split("."):
        kind = getattr(kind, part)
    names = [field.name for field in fields(kind)]  # a TypeError for what is no dataclass
    return kind(**dict(zip(names, packed["values"], strict=True)))


# They have a part in the last bit of a float.
_NUMERIC = ("llvmlite", "numba", "numpy", "scipy")


def identity_of(task: Callable[..., object], points: Sequence[object]) -> dict[str, str]:
    """Return a journal's ``task``, ``points`` and ``code``; `SweepError` if points have no lasting text."""
    return {
        "task": name_of(task),
        "points": _points_digest(points),
        "code": code_digest(_source_of(task)),
    }


def name_of(task: Callable[..., object]) -> str:
    """Return the full name of a module's function; raises `SweepError` if no other process finds it."""
    name = getattr(task, "__qualname__", "")
    if not name or "<" in name:
        raise SweepError(f"task: given {task!r}, needed is a function at the top of a module")
    return f"{task.__module__}.{name}"


def _points_digest(points: Sequence[object]) -> str:
    texts = [repr(point) for point in points]
    for text in texts:
        if " at 0x" in text:
            needed = "values whose repr says all (frozen dataclasses)"
            raise SweepError(f"points: given {text}, needed are {needed}")
    return _digest("\n".join(texts).encode())


def _source_of(task: Callable[..., object]) -> str:
    """Return the source file of a task outside of sfglab, whose own files are looked at anyway."""
    if task.__module__.partition(".")[0] == "sfglab":
        return ""
    try:
        return inspect.getsourcefile(task) or ""
    except TypeError:
        return ""


@cache
def code_digest(source: str = "") -> str:
    """Return the digest of the package's files, one beside them, and the numeric libraries' versions."""
    root = Path(sfglab.__file__).parent
    whole = hashlib.sha256()
    for name, path in sorted((path.relative_to(root).as_posix(), path) for path in root.rglob("*")):
        if path.is_file() and "__pycache__" not in path.parts:
            whole.update(f"{name}\n{_digest(path.read_bytes())}\n".encode())
    if source and Path(source).is_file():
        whole.update(Path(source).read_bytes())
    for library in _NUMERIC:
        whole.update(f"{library} {version(library)}\n".encode())
    return whole.hexdigest()[:16]


def _digest(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()[:16]


_log = logging.getLogger(__name__)

_MAGIC = "sfglab_sweep"
_VERSION = 1


@dataclass(frozen=True, slots=True)
class Finished:
    """A line of the journal."""

    point: int  #: Index of the point.
    seed: int  #: The seed.
    text: str  #: The result, see `rows`.


def journal_of(log: Path, name: str, part: str) -> Path:
    """Return the journal of a part of a run: beside its log, and named for the run."""
    return log.with_name(f"{name}-{part}.journal")


@contextmanager
def journals(log: Path, name: str) -> Iterator[Callable[[str], Path]]:
    """Give each sweep of a run its journal, by a part's name, and remove them when the log is written.

    Started again after an interruption, the run finds them.
    """
    used: list[Path] = []

    def journal(part: str) -> Path:
        used.append(journal_of(log, name, part))
        return used[-1]

    yield journal
    for path in used:
        path.unlink(missing_ok=True)


class Journal(AbstractContextManager["Journal"]):
    """A sweep's journal, for one process at a time, another sweep's renamed; `JournalError` if it is none."""

    def __init__(self, path: Path, identity: Mapping[str, str]) -> None:
        #: Result by point's index and seed: those found in it, and those added.
        self.finished: dict[tuple[int, int], str] = {}
        self.name = path.stem  #: Of the file, without its ending.
        path.parent.mkdir(parents=True, exist_ok=True)
        self._file = _locked(path)
        try:
            if (differs := self._read(path, identity)) is not None:
                self._file = _set_aside(path, self._file, differs)
            if self._file.tell() == 0:
                self._line({_MAGIC: _VERSION, **identity})
        except BaseException:
            self._file.close()
            raise

    def __exit__(self, *_: object) -> None:
        self._file.close()

    def add(self, done: Finished) -> None:
        """Append a finished point and seed."""
        self.finished[done.point, done.seed] = done.text
        self._line({"point": done.point, "seed": done.seed, "result": json.loads(done.text)})

    def _line(self, values: Mapping[str, object]) -> None:
        self._file.write(json.dumps(values).encode() + b"\n")
        self._file.flush()

    def _read(self, path: Path, identity: Mapping[str, str]) -> str | None:
        """Take over what is there and stand behind it; return what differs when it is another sweep's."""
        content = self._file.read()
        whole = content[: content.rfind(b"\n") + 1].splitlines(keepends=True)
        known = _entry(whole[0]).get(_MAGIC) == _VERSION if whole else _begins_one(content)
        if not known:
            raise JournalError(f"{path} is no journal of a sweep; name another file")
        end = 0
        for number, line in enumerate(whole):
            entry = _entry(line)
            if number == 0:
                differs = [key for key, value in identity.items() if entry.get(key) != value]
                if differs:
                    return ", ".join(differs)
            elif (
                set(entry) == {"point", "seed", "result"}
                and type(entry["point"]) is type(entry["seed"]) is int
            ):
                self.finished[entry["point"], entry["seed"]] = json.dumps(entry["result"])
            else:
                break  # torn by a crash of the machine: this and what follows is run again
            end += len(line)
        self._file.truncate(end)
        self._file.seek(end)
        return None


def _begins_one(content: bytes) -> bool:
    """Return whether this may be what is left of a first line."""
    start = f'{{"{_MAGIC}"'.encode()
    return content.startswith(start) or start.startswith(content)


def _entry(line: bytes) -> dict[str, Any]:
    try:
        entry = json.loads(line)
    except (ValueError, RecursionError):
        return {}
    return entry if isinstance(entry, dict) else {}


def _locked(path: Path) -> BinaryIO:
    file = path.open("a+b")
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        file.close()
        said = "another sweep is writing this journal; wait for it, or name another"
        raise JournalError(f"{path}: {said}") from None
    file.seek(0)
    return file


def _set_aside(path: Path, file: BinaryIO, differs: str) -> BinaryIO:
    number = 1
    while (aside := path.with_name(f"{path.name}.{number}")).exists():
        number += 1
    path.rename(aside)
    file.close()
    _log.warning(
        "%s is of another sweep (it differs in: %s); renamed to %s", path, differs, aside.name
    )
    return _locked(path)
