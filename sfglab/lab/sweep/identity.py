"""Which sweep this is: the task, the points, and the version of the code, as digests.

Two sweeps of one identity give the same rows, so the results of one may stand for the other's. Seeds are not
part of it: a sweep may be given more of them later.
"""

from __future__ import annotations

import hashlib
import inspect
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING

import sfglab
from sfglab.lab.sweep.errors import SweepError

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence


# They have a part in the last bit of a float.
_NUMERIC = ("llvmlite", "numba", "numpy", "scipy")


def identity_of(task: Callable[..., object], points: Sequence[object]) -> dict[str, str]:
    """Return what a journal is checked against: ``task``, ``points`` and ``code``.

    Args:
        task: A function of a module.
        points: What it is given.

    Raises:
        SweepError: Points have no lasting text.
    """
    return {"task": name_of(task), "points": _points_digest(points), "code": code_digest(_source_of(task))}


def name_of(task: Callable[..., object]) -> str:
    """Return a function's full name.

    Args:
        task: A function of a module.

    Raises:
        SweepError: It is a lambda or inside another function, so that no other process finds it.
    """
    name = getattr(task, "__qualname__", "")
    if not name or "<" in name:
        raise SweepError(f"task: given {task!r}, needed is a function at the top of a module")
    return f"{task.__module__}.{name}"


def _points_digest(points: Sequence[object]) -> str:
    texts = [repr(point) for point in points]
    for text in texts:
        if " at 0x" in text:
            raise SweepError(
                f"points: given {text}, needed are values whose repr says all (frozen dataclasses)"
            )
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
    """Return the digest of sfglab's source files and of the numeric libraries' versions.

    Args:
        source: A file beside them.
    """
    root = Path(sfglab.__file__).parent
    whole = hashlib.sha256()
    for path in sorted(root.rglob("*.py"), key=lambda p: p.relative_to(root).as_posix()):
        whole.update(f"{path.relative_to(root).as_posix()}\n{_digest(path.read_bytes())}\n".encode())
    if source and Path(source).is_file():
        whole.update(Path(source).read_bytes())
    for library in _NUMERIC:
        whole.update(f"{library} {version(library)}\n".encode())
    return whole.hexdigest()[:16]


def _digest(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()[:16]
