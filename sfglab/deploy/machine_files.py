"""Files of a machine below a folder that stands for its ``/``.

Files are read without leaving the folder or opening a device. A path that is missing, unreadable,
looped or no plain file reads as absent, so that detection does not fail on it.
"""

from __future__ import annotations

import os
import re
import stat
from collections import deque
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

from sfglab.deploy.errors import DeployError

_MOST_BYTES = 65536
_MOST_LINKS = 40  # Linux gives up after as many: path_resolution(7)
_LONGEST = 160


@dataclass(frozen=True, slots=True)
class MachineFiles:
    """A machine's files."""

    root: Path  #: Folder that stands for ``/``.

    def __post_init__(self) -> None:
        if not os.access(f"{self.root}/.", os.F_OK):
            raise DeployError(
                f"{self.root}: given as a machine's root, allowed: a folder that exists"
            )

    def resolve(self, path: str) -> Path | None:
        """Return where a path leads, None for a loop; absolute links start at the root, as in chroot(2)."""
        rest, here, links = deque(_parts(path)), list[str](), 0
        while rest:
            part = rest.popleft()
            if part == "..":
                here = here[:-1]
                continue
            try:
                target = self.root.joinpath(*here, part).readlink()
            except OSError:  # not a link, or nothing at all: what comes after tells
                here.append(part)
                continue
            links += 1
            if links > _MOST_LINKS:
                return None
            if target.is_absolute():
                here = []
            rest.extendleft(reversed(_parts(str(target))))
        return self.root.joinpath(*here)

    def has(self, path: str) -> bool:
        """Return whether there is anything at a path, and if it is a link, where it leads."""
        place = self.resolve(path)
        return place is not None and os.access(place, os.F_OK)

    def head(self, path: str) -> bytes | None:
        """Return the first bytes of a plain file; None for all else, devices above all."""
        place = self.resolve(path)
        try:
            if place is None or not stat.S_ISREG(place.stat().st_mode):
                return None
            with place.open("rb") as file:
                return file.read(_MOST_BYTES)
        except OSError:
            return None

    def text(self, path: str) -> str | None:
        """Return the text at the beginning of a plain file, with marks for what is no text; None if none."""
        head = self.head(path)
        return None if head is None else head.decode(errors="replace")

    def names(self, folder: str, pattern: str) -> list[str]:
        """Return the names in a folder that match a regular expression as a whole, short ones first."""
        place = self.resolve(folder)
        try:
            found = [child.name for child in place.iterdir()] if place is not None else []
        except OSError:
            return []
        return sorted(
            (name for name in found if re.fullmatch(pattern, name)),
            key=lambda name: (len(name), name),
        )

    def paths(self, folder: str, pattern: str) -> list[str]:
        """Return absolute paths of what matches in a folder and leads somewhere."""
        paths = [f"{folder}/{name}" for name in self.names(folder, pattern)]
        return [path for path in paths if self.has(path)]


def plain(text: str) -> str:
    """Return text fit for one line of a terminal: no control characters, no marks of bad bytes, not long."""
    shown = "".join(char if char.isprintable() and char != "\ufffd" else " " for char in text)
    line = " ".join(shown.split())
    return line if len(line) <= _LONGEST else f"{line[: _LONGEST - 1]}…"


def _parts(path: str) -> list[str]:
    return [part for part in PurePosixPath(path).parts if part.strip("/")]
