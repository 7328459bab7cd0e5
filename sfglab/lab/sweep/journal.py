"""What of a sweep is finished: an append-only file of JSON lines that survives the death of its writer.

The first line says which sweep (`identity`), every other one is a finished point and seed with its result. It
is not MCAP: an MCAP file ends with a summary and an index, so one that was cut off must be written again to be
continued, while here a torn last line is cut away and the next is appended. The experiment writes its MCAP log
from the ordered results. Lines are handed to the operating system as they are made: they survive the process,
killed or not; they may not survive the machine, and what is missing then is run again.
"""

from __future__ import annotations

import fcntl
import json
import logging
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, BinaryIO

from sfglab.lab.sweep.errors import JournalError

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping
    from pathlib import Path
    from types import TracebackType
    from typing import Self


_log = logging.getLogger(__name__)

_MAGIC = "sfglab_sweep"
_VERSION = 1


@dataclass(frozen=True, slots=True)
class Finished:
    """A line of the journal."""

    point: int  #: Index of the point.
    seed: int  #: The seed.
    text: str  #: The result, see `rows`.


@contextmanager
def journals(log: Path, name: str) -> Iterator[Callable[[str], Path]]:
    """Give each sweep of a run its journal, and remove them when the run has written its log.

    They stand beside the log and are named for the run, not for the log, whose name may hold when it began: so
    the same run, started again after an interruption, finds them.

    Args:
        log: The run's log.
        name: Of the run: the experiment and its profile.

    Yields:
        The journal of a part of the run, by the part's name.
    """
    used: list[Path] = []

    def journal(part: str) -> Path:
        used.append(log.with_name(f"{name}-{part}.journal"))
        return used[-1]

    yield journal
    for path in used:
        path.unlink(missing_ok=True)


class Journal:
    """The journal of one sweep, open for one process at a time.

    A journal of another sweep is renamed, not lost.

    Args:
        path: The file; it and its folder are made when missing.
        identity: From `identity_of`.

    Attributes:
        finished: Result by point's index and seed: those found in it, and those added.
        name: Of the file, without its ending.

    Raises:
        JournalError: The file is no journal, or another process has it open.
    """

    def __init__(self, path: Path, identity: Mapping[str, str]) -> None:
        self.finished: dict[tuple[int, int], str] = {}
        self.name = path.stem
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

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._file.close()

    def add(self, done: Finished) -> None:
        """Append a finished point and seed.

        Args:
            done: What is finished.
        """
        self.finished[done.point, done.seed] = done.text
        self._line({"point": done.point, "seed": done.seed, "result": json.loads(done.text)})

    def _line(self, values: Mapping[str, object]) -> None:
        self._file.write(json.dumps(values).encode() + b"\n")
        self._file.flush()

    def _read(self, path: Path, identity: Mapping[str, str]) -> str | None:
        """Take over what is there and stand behind it; return what differs when it is another sweep's."""
        content = self._file.read()
        whole = content[: content.rfind(b"\n") + 1].splitlines(keepends=True)
        if not whole and not _begins_one(content):
            raise JournalError(f"{path} is no journal of a sweep; name another file")
        end = 0
        for number, line in enumerate(whole):
            entry = _entry(line)
            if number == 0:
                if entry.get(_MAGIC) != _VERSION:
                    raise JournalError(f"{path} is no journal of a sweep; name another file")
                differs = [key for key, value in identity.items() if entry.get(key) != value]
                if differs:
                    return ", ".join(differs)
            elif set(entry) == {"point", "seed", "result"}:
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
    except ValueError:
        return {}
    return entry if isinstance(entry, dict) else {}


def _locked(path: Path) -> BinaryIO:
    file = path.open("a+b")
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        file.close()
        raise JournalError(
            f"{path}: another sweep is writing this journal; wait for it, or name another"
        ) from None
    file.seek(0)
    return file


def _set_aside(path: Path, file: BinaryIO, differs: str) -> BinaryIO:
    number = 1
    while (aside := path.with_name(f"{path.name}.{number}")).exists():
        number += 1
    path.rename(aside)
    file.close()
    _log.warning("%s is of another sweep (it differs in: %s); renamed to %s", path, differs, aside.name)
    return _locked(path)
