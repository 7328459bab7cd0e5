"""Reading rosbag2 folders and their SQLite files.

In a folder, the module reads the files that metadata.yaml names. If metadata.yaml is missing or
damaged, it reads all MCAP and SQLite files of the folder.
"""

from __future__ import annotations

import json
import logging
import os
import shutil
import sqlite3
import tempfile
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path, PurePath
from typing import TYPE_CHECKING

from zstandard import ZstdDecompressor, ZstdError

from sfglab.documents import Document
from sfglab.errors import InvalidValueError
from sfglab.record.mcap_file import McapFile
from sfglab.record.parts import (
    MSG,
    QOS_KEY,
    Channel,
    LogError,
    LogMessage,
    damage_named,
    most_bytes,
)
from sfglab.validation import Source, read

if TYPE_CHECKING:
    from collections.abc import Collection, Iterator
    from contextlib import ExitStack

_LOG = logging.getLogger(__name__)
_SUFFIXES = (".mcap", ".db3")
_COMPRESSED = ".zstd"
_DEFINITIONS = """
SELECT topic_type, CAST(IFNULL(encoding, '') AS TEXT),
    CAST(IFNULL(encoded_message_definition, '') AS TEXT)
FROM message_definitions
"""
# In a damaged file, any column may hold a value of any kind.
_TOPICS = """
SELECT id, CAST(IFNULL(name, '') AS TEXT), CAST(IFNULL(type, '') AS TEXT),
    CAST(IFNULL(serialization_format, '') AS TEXT), CAST(IFNULL(offered_qos_profiles, '') AS TEXT),
    IFNULL(count, 0), first, last
FROM topics LEFT JOIN (
    SELECT topic_id, COUNT(*) AS count, MIN(timestamp) AS first, MAX(timestamp) AS last
    FROM messages WHERE typeof(timestamp) = 'integer' AND typeof(data) = 'blob' GROUP BY topic_id
) ON topic_id = id
"""
_COLUMNS = "SELECT name FROM pragma_table_info('topics')"
# Bounds come as text, and a bound beyond SQLite's greatest integer becomes that integer.
_MESSAGES = """
SELECT topic_id, timestamp, data FROM messages
WHERE typeof(timestamp) = 'integer' AND typeof(data) = 'blob'
AND topic_id IN (SELECT value FROM json_each(?))
AND timestamp >= CAST(? AS INTEGER) AND timestamp < CAST(? AS INTEGER)
ORDER BY timestamp, id
"""


def is_log(path: Path) -> bool:
    """Return whether a path looks like an MCAP file or a bag: it is a folder, or its suffix is that of such a file."""
    return path.is_dir() or path.suffix in _SUFFIXES


@dataclass(frozen=True)
class _Bag:
    """The part of metadata.yaml that reading needs."""

    relative_file_paths: list[str]
    message_count: int | None  # None: not known
    compression_mode: str = ""


@dataclass(frozen=True)
class _Metadata:
    """The document metadata.yaml of rosbag2."""

    rosbag2_bagfile_information: _Bag


def open_log(path: Path, stack: ExitStack) -> tuple[list[McapFile | SqliteFile], bool]:
    """Open an MCAP file, a .db3 file, or each file of a rosbag2 folder; `stack` closes them.

    Returns the files, and whether each message is compressed by itself. Differences from metadata.yaml
    and files that cannot be read are logged as warnings.

    Raises:
        LogError: There is no such file, or nothing in the folder can be read.
    """
    if not os.path.isdir(path):  # noqa: PTH112  # Path.is_dir raises an error for long names
        return [_opened(path, stack)], False
    bag = _bag_of(path)
    files = _opened_parts(path, bag, stack)
    counts = [channel.count for file in files for channel in file.channels.values()]
    if bag.message_count not in {None, sum(counts)}:
        said = f"metadata.yaml names {bag.message_count} messages, the files hold {sum(counts)}"
        _LOG.warning("log %s: %s", path, said)
    return files, bag.compression_mode.lower() == "message"


def _opened_parts(path: Path, bag: _Bag, stack: ExitStack) -> list[McapFile | SqliteFile]:
    """Open the files of a folder that can be read."""
    files = []
    problems = [LogError(f"log {path}: the folder has no .mcap or .db3 file; give a bag's folder")]
    # Some recorders write the folder's name before the file's.
    names = [PurePath(name).name for name in bag.relative_file_paths]
    for name in dict.fromkeys(names):
        try:
            files.append(_opened(path / name, stack))
        except LogError as error:
            problems.append(error)
    if not files:
        raise problems[-1]
    for problem in problems[1:]:
        _LOG.warning("%s", problem)
    return files


def _bag_of(path: Path) -> _Bag:
    """Return the contents of a folder's metadata.yaml, or all files of the folder if it is missing or damaged."""
    file = path / "metadata.yaml"
    if file.exists():
        try:
            metadata: _Metadata = read(_Metadata, Document.of_file(file).value, source=Source.LOG)
        except InvalidValueError as error:
            said = "metadata.yaml cannot be read, all files of the folder are"
            _LOG.warning("log %s: %s: %s", path, said, error)
        else:
            return metadata.rosbag2_bagfile_information
    parts = sorted(part.name for part in path.iterdir() if _is_part(part))
    return _Bag(parts, None)


def _is_part(file: Path) -> bool:
    plain = file.with_suffix("") if file.suffix == _COMPRESSED else file
    # A recorder that was killed while it compressed leaves both files.
    return plain.suffix in _SUFFIXES and (plain == file or not plain.exists())


def _opened(path: Path, stack: ExitStack) -> McapFile | SqliteFile:
    if not os.path.isfile(path):  # noqa: PTH113  # Path.is_file raises an error for long names
        raise LogError(
            f"log {path}: no such file; give an MCAP file, a bag's folder or its .db3 file"
        )
    plain = path
    if path.suffix == _COMPRESSED:
        plain = Path(stack.enter_context(tempfile.TemporaryDirectory())) / path.stem
        _decompress_file(path, plain)
    if plain.suffix == ".bag":
        said = "this is a bag of ROS 1; convert it with rosbags-convert --src FILE.bag --dst FOLDER"
        raise LogError(f"log {path}: {said}")
    if plain.suffix == ".db3":
        return SqliteFile(plain, path, stack)
    return McapFile(plain, path, stack)


def _decompress_file(source: Path, target: Path) -> None:
    most = most_bytes(source.stat().st_size)
    with damage_named(source), source.open("rb") as compressed, target.open("wb") as plain:
        content = ZstdDecompressor().stream_reader(compressed, read_across_frames=True)
        while part := content.read(2**20):
            if plain.tell() > most:
                raise ZstdError("it holds far more than its size allows")
            plain.write(part)


class SqliteFile:
    """One SQLite file of a rosbag2.

    If the recorder was killed, SQLite needs its write-ahead log or its journal to find the last
    committed messages. The file is then read from a copy, because SQLite would change files beside
    the original.
    """

    truncated = False

    def __init__(self, path: Path, name: Path, stack: ExitStack) -> None:
        """Open a file, which errors call `name`, and count its messages; `stack` closes it.

        Raises:
            LogError: It is no SQLite file of a rosbag2.
        """
        self.path = name
        self.channels: dict[int, Channel] = {}  #: The channels by their numbers.
        #: Log times, ns; those of the first and the last message are among them.
        self.times_ns: list[int] = []
        with damage_named(name):
            self._database = _database(path.resolve(), stack)
            self._read_index()

    def _read_index(self) -> None:
        definitions = {}
        with suppress(sqlite3.OperationalError):  # Humble has no such table
            for name, encoding, text in self._database.execute(_DEFINITIONS):
                definitions[name] = (encoding, text)
        columns = [name for (name,) in self._database.execute(_COLUMNS)]
        topics = _TOPICS
        if QOS_KEY not in columns:  # before Foxy
            topics = _TOPICS.replace(QOS_KEY, "NULL")
        for number, topic, kind, encoding, qos, count, *times_ns in self._database.execute(topics):
            definition_encoding, definition = definitions.get(kind, ("", ""))
            self.channels[number] = Channel(
                topic=topic,
                type_name=kind,
                encoding=encoding,
                definition=definition if definition_encoding == MSG else "",
                definition_encoding=definition_encoding,
                offered_qos=qos,
                count=count,
            )
            if count:
                self.times_ns += times_ns

    def messages(
        self, channels: Collection[Channel], start_ns: int, end_ns: int
    ) -> Iterator[LogMessage]:
        """Yield the messages of channels in a range of log time, ns, in the order of log time.

        Raises:
            LogError: The file is damaged.
        """
        wanted = [number for number, channel in self.channels.items() if channel in channels]
        bounds = json.dumps(wanted), str(start_ns), str(end_ns)
        with damage_named(self.path):
            for number, time_ns, cdr in self._database.execute(_MESSAGES, bounds):
                yield LogMessage(self.channels[number], time_ns, time_ns, cdr)


def _database(file: Path, stack: ExitStack) -> sqlite3.Connection:
    beside = [file.with_name(f"{file.name}-{kind}") for kind in ("wal", "journal")]
    beside = [other for other in beside if other.is_file()]
    uri = f"{file.as_uri()}?immutable=1"
    if beside:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        for other in (file, *beside):
            shutil.copyfile(other, folder / other.name)
        uri = (folder / file.name).as_uri()
    # The reader of a log may be opened and read in different threads, one after the other.
    database = sqlite3.connect(uri, uri=True, check_same_thread=False)
    stack.callback(database.close)
    database.text_factory = lambda data: data.decode(errors="replace")
    return database
