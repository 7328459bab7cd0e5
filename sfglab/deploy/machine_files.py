"""Files of a machine below a folder that stands for its ``/``.

Reading never leaves the folder, and never opens a device. A path that is missing, unreadable,
a loop of links, or no plain file counts as absent, so that detection does not fail.
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
    """Access to a machine's files, of which the folder `root` holds all, as with chroot(2).

    Raises:
        DeployError: The folder does not exist.
    """

    root: Path  #: Folder that stands for ``/``.

    def __post_init__(self) -> None:
        if not os.access(f"{self.root}/.", os.F_OK):
            raise DeployError(f"root: given {str(self.root)!r}, allowed: an existing folder")

    def resolve(self, path: str) -> Path | None:
        """Return the path to which links lead; None for a loop. Absolute links start at the root, as in chroot(2)."""
        rest, here, links = deque(_parts(path)), list[str](), 0
        while rest:
            part = rest.popleft()
            if part == "..":
                here = here[:-1]
                continue
            try:
                target = self.root.joinpath(*here, part).readlink()
            except OSError:  # the path is no link, or does not exist; later calls detect the latter
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
        """Return whether a path exists; a link exists if its target does."""
        place = self.resolve(path)
        return place is not None and os.access(place, os.F_OK)

    def head(self, path: str) -> bytes | None:
        """Return the first bytes of a plain file; None for anything else, such as a device."""
        place = self.resolve(path)
        try:
            if place is None or not stat.S_ISREG(place.stat().st_mode):
                return None
            with place.open("rb") as file:
                return file.read(_MOST_BYTES)
        except OSError:
            return None

    def text(self, path: str) -> str | None:
        """Return the text at the beginning of a plain file, with marks for other bytes; None without such a file."""
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
        """Return the absolute paths of existing names in a folder that match a regular expression as a whole."""
        paths = [f"{folder}/{name}" for name in self.names(folder, pattern)]
        return [path for path in paths if self.has(path)]


def plain(text: str) -> str:
    """Return a text for one line of a terminal: shortened, without control characters and marks of wrong bytes."""
    shown = "".join(char if char.isprintable() and char != "\ufffd" else " " for char in text)
    line = " ".join(shown.split())
    return line if len(line) <= _LONGEST else f"{line[: _LONGEST - 1]}…"


def _parts(path: str) -> list[str]:
    return [part for part in PurePosixPath(path).parts if part.strip("/")]
