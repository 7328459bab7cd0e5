"""Reading rosbag2 folders and their SQLite files.

In a folder, the files are read that its metadata.yaml names. If metadata.yaml is missing or
damaged, all MCAP and SQLite files of the folder are read.
"""

from __future__ import annotations

import json
import os
import shutil
import sqlite3
import tempfile
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from pathlib import Path, PurePath
from typing import TYPE_CHECKING, Any
from urllib.parse import quote

from zstandard import ZstdError

from sfglab.record.mcap_file import McapFile
from sfglab.record.parts import Channel, LogError, StoredMessage
from sfglab.record.zstd import decompress_file

if TYPE_CHECKING:
    from collections.abc import Collection, Iterator

    from sfglab.record.parts import LogFile

_SUFFIXES = (".mcap", ".db3")
_COMPRESSED = ".zstd"
# Errors of metadata.yaml whose values are missing or of another kind.
_WRONG_METADATA = (
    OSError,
    ValueError,
    LookupError,
    TypeError,
    AttributeError,
    RecursionError,
)
# The bounds of an integer in SQLite.
_LEAST = -(2**63)
_MOST = 2**63 - 1
_MESSAGES = """
SELECT topic_id, timestamp, data FROM messages
WHERE typeof(timestamp) = 'integer' AND typeof(data) = 'blob'
AND topic_id IN (SELECT value FROM json_each(?)) AND timestamp >= ? AND timestamp <= ?
ORDER BY timestamp, id
"""
_COUNT = """
SELECT topic_id, COUNT(*), MIN(timestamp), MAX(timestamp) FROM messages
WHERE typeof(timestamp) = 'integer' AND typeof(data) = 'blob' GROUP BY topic_id
"""


def is_log(path: Path) -> bool:
    """Return whether a path looks like what `LogReader` opens: an MCAP file or a bag."""
    return path.is_dir() or path.suffix in _SUFFIXES


@dataclass(slots=True)
class OpenedLog:
    """The files of a log that could be opened."""

    paths: list[Path] = field(default_factory=list)  #: The files.
    files: list[LogFile] = field(default_factory=list)  #: The opened files, in the same order.
    warnings: list[str] = field(default_factory=list)  #: Differences from metadata.yaml.
    compressed_messages: bool = False  #: Whether each message is compressed by itself.


def open_log(path: Path, stack: ExitStack) -> OpenedLog:
    """Open an MCAP file, a .db3 file, or each file of a rosbag2 folder; `stack` closes them.

    Raises:
        LogError: There is no such file, or nothing in the folder can be read.
    """
    opened = OpenedLog()
    # Path.exists raises an error for a name that is too long.
    if not os.path.exists(path):  # noqa: PTH110
        raise LogError(f"log {path}: no such file")
    if not path.is_dir():
        _add(opened, path, stack)
        return opened
    files, count = _named_files(path, opened)
    failures = []
    for file in files:
        try:
            _add(opened, file, stack)
        except LogError as error:
            failures.append(str(error))
    if not opened.files:
        nothing = f"log {path}: given a folder without .mcap or .db3 files"
        raise LogError(failures[0] if failures else nothing)
    opened.warnings += failures
    held = sum(channel.count for file in opened.files for channel in file.channels)
    if count not in {None, held}:
        said = f"metadata.yaml names {count} messages, the files hold {held}"
        opened.warnings.append(f"log {path}: {said}")
    return opened


def _add(opened: OpenedLog, path: Path, stack: ExitStack) -> None:
    if not path.is_file():
        raise LogError(f"log {path}: no such file")
    plain = path
    if path.suffix == _COMPRESSED:
        plain = Path(stack.enter_context(tempfile.TemporaryDirectory())) / path.stem
        try:
            decompress_file(path, plain)
        except (OSError, ZstdError) as error:
            raise LogError(f"log {path}: damaged: {error}") from error
    if plain.suffix == ".bag":
        said = "a bag of ROS 1: convert it by rosbags-convert --src FILE.bag --dst FOLDER"
        raise LogError(f"log {path}: {said}")
    file = SqliteFile(plain, path) if plain.suffix == ".db3" else McapFile(plain, path)
    stack.callback(file.close)
    opened.paths.append(path)
    opened.files.append(file)


def _named_files(path: Path, opened: OpenedLog) -> tuple[list[Path], int | None]:
    """Return the files of a folder, and the number of messages that metadata.yaml gives."""
    import yaml

    metadata = path / "metadata.yaml"
    if metadata.is_file():
        try:
            given = yaml.safe_load(metadata.read_text("utf-8"))["rosbag2_bagfile_information"]
            # Some recorders write the folder's name before the file's.
            files = [path / PurePath(name).name for name in given["relative_file_paths"]]
            count = given["message_count"]
            mode = given.get("compression_mode")
            opened.compressed_messages = isinstance(mode, str) and mode.lower() == "message"
        except (yaml.YAMLError, *_WRONG_METADATA) as error:
            said = f"metadata.yaml cannot be read, all files of the folder are: {error}"
            opened.warnings.append(f"log {path}: {said}")
        else:
            return list(dict.fromkeys(files)), count if isinstance(count, int) else None
    return sorted(file for file in path.iterdir() if _is_part(file)), None


def _is_part(file: Path) -> bool:
    plain = file.with_suffix("") if file.suffix == _COMPRESSED else file
    # A recorder that was killed while it compressed leaves both files.
    return plain.suffix in _SUFFIXES and (plain == file or not plain.exists())


class SqliteFile:
    """One SQLite file of a rosbag2; see `sfglab.record.parts.LogFile`.

    If the recorder was killed, SQLite needs its write-ahead log or its journal to find the last
    committed messages. The file is then read from a copy, because SQLite would change files beside
    the original.
    """

    truncated = False

    def __init__(self, path: Path, name: Path) -> None:
        """Open a file, which errors call `name`, and count its messages.

        Raises:
            LogError: It is no SQLite file of a rosbag2.
        """
        self._path = name
        self._stack = ExitStack()
        try:
            with self._damage():
                self._open(path.resolve())
        except BaseException:
            self._stack.close()
            raise

    def _open(self, place: Path) -> None:
        beside = [place.with_name(f"{place.name}-{kind}") for kind in ("wal", "journal")]
        beside = [file for file in beside if file.is_file() and file.stat().st_size]
        how = "immutable=1"
        if beside:
            folder = Path(self._stack.enter_context(tempfile.TemporaryDirectory()))
            for file in (place, *beside):
                shutil.copyfile(file, folder / file.name)
            place = folder / place.name
            how = "mode=rw"
        # The reader of a log may be opened and read in different threads, one after the other.
        self._database = sqlite3.connect(
            f"file://{quote(os.fsencode(place))}?{how}", uri=True, check_same_thread=False
        )
        self._stack.callback(self._database.close)
        self._database.text_factory = lambda data: data.decode(errors="replace")
        counts = {number: row for number, *row in self._database.execute(_COUNT)}
        definitions = self._definitions()
        self._channels = {}
        for topic in self._records("SELECT * FROM topics"):
            key = topic["type"], topic.get("type_description_hash")
            encoding, text = definitions.get(key) or definitions.get(key[0], ("", ""))
            self._channels[topic["id"]] = Channel(
                topic=str(topic["name"]),
                type_name=str(topic["type"]),
                encoding=str(topic["serialization_format"]),
                definition=str(text or "").encode(),
                definition_encoding=str(encoding),
                offered_qos=str(topic.get("offered_qos_profiles", "")),
                count=counts.get(topic["id"], (0,))[0],
            )
        self.channels = tuple(self._channels.values())
        times = [counts[number][1:] for number in self._channels if number in counts]
        self.span_ns = None
        if times:
            self.span_ns = min(first for first, _ in times), max(last for _, last in times)

    def _records(self, query: str) -> list[dict[str, Any]]:
        cursor = self._database.execute(query)
        names = [column[0] for column in cursor.description]
        return [dict(zip(names, row, strict=True)) for row in cursor]

    def _definitions(self) -> dict[Any, tuple[str, str]]:
        """Return encoding and text by type, and by type and hash; Humble wrote none."""
        tables = [name for (name,) in self._database.execute("SELECT name FROM sqlite_master")]
        if "message_definitions" not in tables:
            return {}
        found = {}
        for record in self._records("SELECT * FROM message_definitions"):
            given = record["encoding"], record["encoded_message_definition"]
            found[record["topic_type"]] = given
            found[record["topic_type"], record.get("type_description_hash")] = given
        return found

    def messages(
        self, channels: Collection[Channel], start_ns: int | None, end_ns: int | None
    ) -> Iterator[StoredMessage]:
        """Yield messages in the order of log time."""
        wanted = [number for number, channel in self._channels.items() if channel in channels]
        # SQLite takes NumPy's integers for bytes, and no integer beyond its own.
        earliest = _LEAST if start_ns is None else max(_LEAST, min(int(start_ns), _MOST))
        latest = _MOST if end_ns is None else max(_LEAST, min(int(end_ns) - 1, _MOST))
        with self._damage():
            found = self._database.execute(_MESSAGES, (json.dumps(wanted), earliest, latest))
            for number, time_ns, data in found:
                yield StoredMessage(self._channels[number], time_ns, time_ns, data)

    @contextmanager
    def _damage(self) -> Iterator[None]:
        try:
            yield
        except (sqlite3.Error, OSError, KeyError, TypeError, AttributeError, ValueError) as error:
            said = f"no SQLite file of a rosbag2, or damaged: {error}"
            raise LogError(f"log {self._path}: {said}") from error

    def close(self) -> None:
        """Close the file; a second time does nothing."""
        self._stack.close()
