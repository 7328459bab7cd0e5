"""Writing rosbag2 folders, copying logs into each other, and where a log ends up only when it is whole.

Knows what `rosbags` writes. Refuses to know where messages come from.
"""

from __future__ import annotations

import heapq
import math
import os
import secrets
import shutil
from contextlib import AbstractContextManager, ExitStack, contextmanager, suppress
from typing import TYPE_CHECKING, Any, Literal, get_args

from sfglab.errors import InvalidValueError
from sfglab.messages import MessageError, definition
from sfglab.messages.store import parse_definition
from sfglab.qos import QoSProfile
from sfglab.record.metadata import LogError, rosbags_qos
from sfglab.record.reader import LogMessage, LogReader
from sfglab.record.writer import LogWriter

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence
    from pathlib import Path

    from rosbags.interfaces import Connection


Storage = Literal["mcap", "sqlite3"]
Compression = Literal["none", "file", "message", "storage"]
NO_HASH = "RIHS01_" + 64 * "0"


class BagWriter(AbstractContextManager["BagWriter"]):
    """A rosbag2 folder being written, with the methods of a `LogWriter` that bags have something for.

    Its index is written at its end: without `close` it is no bag. Not for several threads. Raises LogError
    where there is something of this name, or it cannot be written so.
    """

    def __init__(
        self, path: Path, *, storage: Storage = "mcap", compression: Compression = "none"
    ) -> None:
        from rosbags.rosbag2 import (
            CompressionFormat,
            CompressionMode,
            StoragePlugin,
            Writer,
            WriterError,
        )

        self.path = path
        self._definitions: dict[str, str] = {}
        self._connections: dict[tuple[str, str], Connection] = {}
        try:
            self._bag = Writer(path, version=9, storage_plugin=StoragePlugin[storage.upper()])
            self._bag.set_compression(CompressionMode[compression.upper()], CompressionFormat.ZSTD)
            self._bag.open()
        except WriterError as error:
            raise LogError(f"log {path}: {error}") from error

    def define(self, type_name: str, definition: str) -> None:
        """Write this definition for a type, and not the process's own."""
        self._definitions[type_name] = definition

    def write_raw(  # noqa: PLR0913 - as a `LogWriter` has it
        self,
        topic: str,
        type_name: str,
        cdr: Any,
        *,
        log_time_ns: int,
        publish_time_ns: int | None = None,
        qos: QoSProfile | None = None,
    ) -> None:
        """Append a message; see `LogWriter.write_raw`. Bags have no time of publication."""
        del publish_time_ns
        connection = self._connections.get((topic, type_name))
        if connection is None:
            text = self._definitions.get(type_name) or definition(type_name)
            connection = self._connections[topic, type_name] = self._bag.add_connection(
                topic,
                type_name,
                msgdef=text,
                rihs01=_hash(type_name, text),
                offered_qos_profiles=[rosbags_qos(qos or QoSProfile())],
            )
        self._bag.write(connection, log_time_ns, cdr)

    def close(self) -> None:
        """Write the index; a second time does nothing."""
        if self._bag.storage is not None:
            self._bag.close()

    def __exit__(self, *_: object) -> None:
        self.close()


def _hash(type_name: str, text: str) -> str:
    """Return the hash of a type by its definition; zeros where that cannot be read."""
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.EMPTY)
    try:
        store.register(parse_definition(type_name, text))
        return store.hash_rihs01(type_name)
    except (MessageError, KeyError):
        return NO_HASH


AnyWriter = BagWriter | LogWriter


def new_log(
    path: Path,
    *,
    storage: Storage | None = None,
    compression: Compression = "none",
    flush_after_s: float = 1.0,
) -> AnyWriter:
    """Return a new log: one MCAP file where the name ends in ``.mcap``, else a rosbag2 folder.

    A file's chunks end after so many seconds of log time, see `LogWriter`.

    Raises:
        InvalidValueError: There is something of this name; a file has a storage or a compression of its own.
        LogError: It cannot be written so.
    """
    if os.path.lexists(path):
        raise InvalidValueError("--output", str(path), "a path where nothing is yet")
    if not path.absolute().parent.is_dir():
        raise InvalidValueError("--output", str(path), "a path in a folder that exists")
    kinds = get_args(Compression)[: None if storage != "sqlite3" else -1]
    if storage not in (None, *get_args(Storage)):
        raise InvalidValueError("--storage", storage, ", ".join(get_args(Storage)))
    if compression not in kinds:
        raise InvalidValueError("--compression-mode", compression, ", ".join(kinds))
    try:
        if path.suffix != ".mcap":
            return BagWriter(path, storage=storage or "mcap", compression=compression)
        if storage == "sqlite3" or compression != "none":
            said = f"{path.name}, {storage or 'mcap'}, {compression}"
            raise InvalidValueError(
                "--output", said, "without .mcap at its end: such a file is MCAP with zstd"
            )
        return LogWriter(path, flush_after_s=flush_after_s)
    except OSError as error:
        allowed = f"a path that can be written ({error.strerror})"
        raise InvalidValueError("--output", str(path), allowed) from error


@contextmanager
def whole_log(path: Path, **options: Any) -> Iterator[AnyWriter]:
    """Yield a new log that takes its name when the block ends, and vanishes when it breaks off."""
    # What stands in a bag is called as the bag, so it is written under its name in a folder beside.
    if os.path.lexists(path):
        raise InvalidValueError("--output", str(path), "a path where nothing is yet")
    place = path.absolute().parent / f".{path.name[:100]}.{secrets.token_hex(4)}.part"
    try:
        place.mkdir()
    except OSError as error:
        allowed = f"a path that can be written ({error.strerror})"
        raise InvalidValueError("--output", str(path), allowed) from error
    try:
        # Nothing reads it before it is whole, so rows that came seldom share a chunk.
        with _said(path), new_log(place / path.name, flush_after_s=math.inf, **options) as writer:
            yield writer
        os.rename(place / path.name, path)  # noqa: PTH104 - never over what came meanwhile, as far as it is told
    finally:
        with suppress(OSError):
            shutil.rmtree(place)


@contextmanager
def _said(path: Path) -> Iterator[None]:
    """Turn a disk's refusal, also SQLite's, into a sentence."""
    import sqlite3

    try:
        yield
    except (OSError, sqlite3.Error) as error:
        raise InvalidValueError(
            "--output", str(path), f"a path that can be written ({error})"
        ) from error


def copy_logs(
    paths: Sequence[Path],
    path: Path,
    *,
    keep: Callable[[LogMessage], bool] = lambda _: True,
    **options: Any,
) -> dict[str, int]:
    """Write what is to be kept of logs into a new one, in the order of log times; return counts by topic.

    Metadata and attachments go along into an MCAP file; a folder has no place for them. Options are those of
    `new_log`.

    Raises:
        InvalidValueError: The new one cannot be written.
        LogError: One of the others cannot be read, or has a topic with another type than one before.
    """
    counts: dict[str, int] = {}
    with ExitStack() as stack:
        readers = [stack.enter_context(LogReader(one)) for one in paths]
        writer = stack.enter_context(whole_log(path, **options))
        qos: dict[str, QoSProfile] = {}
        for reader in readers:
            for topic, info in reader.topics.items():
                qos[topic] = reader.offered_qos(topic)
                if text := reader.definition(topic):
                    writer.define(info.type_name, text)
            if isinstance(writer, LogWriter):
                _copy_rest(reader, writer)
        for message in heapq.merge(
            *(reader.messages() for reader in readers), key=lambda m: m.log_time_ns
        ):
            if keep(message):
                times = {
                    "log_time_ns": message.log_time_ns,
                    "publish_time_ns": message.publish_time_ns,
                }
                writer.write_raw(
                    message.topic, message.type_name, message.cdr, qos=qos[message.topic], **times
                )
                counts[message.topic] = counts.get(message.topic, 0) + 1
    return counts


def _copy_rest(reader: LogReader, writer: LogWriter) -> None:
    for name in reader.metadata_names:
        with suppress(LogError):  # of several logs the first one's
            writer.write_metadata(name, reader.metadata(name))
    for name, media_type in reader.media_types.items():
        with suppress(LogError):
            writer.attach(name, reader.attachment(name), media_type)
