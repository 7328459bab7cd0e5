"""Writing a run into one MCAP file.

The file has the layout that ROS tools expect: profile `ros2`, CDR messages, `ros2msg` schemas. All times are
arguments; the module reads no clock.
"""

from __future__ import annotations

import threading
from contextlib import AbstractContextManager, contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

from sfglab import __version__
from sfglab.errors import SfglabError
from sfglab.messages import definition, row_message, row_type, serialize, type_name
from sfglab.record.metadata import offered_qos_profiles, strings_from_values
from sfglab.record.parts import MSG, QOS_KEY, LogError
from sfglab.units import NS_PER_S

if TYPE_CHECKING:
    import os
    from collections.abc import Iterator, Mapping

    from typing_extensions import Buffer

    from sfglab.qos import QoSProfile

TABLE_PREFIX = "/table/"
TIME_COLUMN = "log_time_ns"
_CHUNK_BYTES = 768 * 1024
_CHUNK_NS = NS_PER_S  # of log time
_TIMES = range(2**64)


class LogWriter(AbstractContextManager["LogWriter"]):
    """An MCAP file being written, as a context manager.

    Messages are collected in chunks. A chunk ends at 768 kB; the current chunk also ends when 1 s of
    log time has passed since the last such end. A finished chunk is handed to the operating system: it survives
    `kill -9`, and `LogReader` reads a file that ends there. The current chunk is lost.

    Every method may be called from any thread: a lock serialises them. A call that finishes a chunk compresses
    and writes it before it returns, which takes 1 to 20 ms. An event loop that cannot wait so long calls the
    methods with `asyncio.to_thread` from one task, which keeps the order.
    """

    def __init__(self, path: str | os.PathLike[str], *, overwrite: bool = False) -> None:
        """Create the file and its directory.

        Raises:
            LogError: The file exists, and `overwrite` is False.
        """
        from mcap.writer import Writer

        self.path = Path(path)
        self._lock = threading.RLock()
        self._channels: dict[str, tuple[str, int]] = {}  # types and numbers by topic
        self._schemas: dict[str, int] = {}
        self._chunk_start_ns: int | None = None
        self._closed_because = "it is closed"
        self.path.parent.mkdir(parents=True, exist_ok=True)
        try:
            self._stream = self.path.open("wb" if overwrite else "xb")
        except FileExistsError as exc:
            said = "there is a file already; choose another path or pass overwrite=True"
            raise LogError(f"log {self.path}: {said}") from exc
        self._mcap = Writer(self._stream, _CHUNK_BYTES, enable_data_crcs=True)
        with self._writing():
            self._mcap.start(profile="ros2", library=f"sfglab {__version__}")

    @contextmanager
    def _writing(self) -> Iterator[None]:
        """Hold the lock during a change, and hand the data to the operating system.

        A failed change may leave half a record and closes the file. A refused change does not close it.
        """
        with self._lock:
            if self._stream.closed:
                raise LogError(f"log {self.path}: {self._closed_because}")
            try:
                yield
                self._stream.flush()
            except SfglabError:
                raise
            except BaseException:
                self._closed_because = "an earlier write failed, so nothing more can follow it"
                with suppress(OSError):
                    self._stream.close()
                raise

    def write_raw(  # noqa: PLR0913  # each of them is a column of the record
        self,
        topic: str,
        type_name: str,
        cdr: Buffer,
        *,
        log_time_ns: int,
        publish_time_ns: int | None = None,
        qos: QoSProfile | None = None,
    ) -> None:
        """Append a serialised message; its bytes are not checked.

        Args:
            topic: Topic of the message.
            type_name: ROS type, one per topic.
            cdr: CDR with its 4-byte header. The bytes are copied.
            log_time_ns: Time of reception on the clock of the run, ns; not negative.
            publish_time_ns: Time of publication on the same clock, ns; None for the time of reception.
            qos: QoS that the publisher offers. The profile of a topic's first message is recorded, for
                `ros2 bag play`.

        Raises:
            UnknownTypeError: No definition of the type is known.
            LogError: A time is out of range, or the topic has another type, or the log is closed.
        """
        data = memoryview(cdr).cast("B")
        publish_time_ns = log_time_ns if publish_time_ns is None else publish_time_ns
        for stamp_ns in (log_time_ns, publish_time_ns):
            if stamp_ns not in _TIMES:
                raise LogError(
                    f"log, topic {topic}: given the time {stamp_ns} ns, allowed: 0 to 2^64 - 1"
                )
        with self._writing():
            channel = self._channel(topic, type_name, qos)
            # The library copies any buffer.
            self._mcap.add_message(channel, int(log_time_ns), data, int(publish_time_ns))  # type: ignore[arg-type]
            self._end_old_chunk(int(log_time_ns))

    def write(self, topic: str, message: Any, *, log_time_ns: int) -> None:
        """Append a message of a registered type, at a time of the run's clock, ns.

        Raises:
            CdrError: The message cannot be serialised.
            LogError: As for `write_raw`, or the log is closed.
        """
        self.write_raw(topic, type_name(type(message)), serialize(message), log_time_ns=log_time_ns)

    def write_row(self, table: str, row: Any, *, log_time_ns: int) -> None:
        """Append one row to a table: a message on the topic `/table/<name>`.

        Args:
            table: Name of the table.
            row: A dataclass as in `sfglab.messages.row_type`; all rows of a table have one class. No field may have
                the name `log_time_ns`, which is a column of the table itself.
            log_time_ns: Time of the measurement on the clock of the run, ns; not negative.

        Raises:
            MessageError: The row has a field that no message can hold.
            LogError: A field is called `log_time_ns`, the table has rows of another class, the time is out of
                range, or the log is closed.
        """
        if hasattr(row, TIME_COLUMN):
            raise LogError(
                f"table {table}: {type(row).__name__} has a field {TIME_COLUMN}; rename it"
            )
        message = row_message(row)
        name = type_name(row_type(type(row)))
        self.write_raw(f"{TABLE_PREFIX}{table}", name, serialize(message), log_time_ns=log_time_ns)

    def write_metadata(self, name: str, values: Mapping[str, Any]) -> None:
        """Write a named mapping, such as the configuration or `run_context()`, at once.

        Text is stored unchanged; numbers, lists, mappings, enums and dataclasses are stored as JSON.

        Raises:
            LogError: A value cannot be written as JSON, or the log is closed.
        """
        strings = strings_from_values(name, values)
        with self._writing():
            self._mcap.add_metadata(name, strings)

    def attach(self, name: str, data: Buffer, media_type: str) -> None:
        """Attach a file with its media type, such as ``text/plain``, and write it at once.

        Raises:
            LogError: The log is closed.
        """
        content = bytes(data)
        with self._writing():
            self._mcap.add_attachment(0, 0, name, media_type, content)

    def close(self) -> None:
        """Write the index and close the file; further calls have no effect. After a failed write there is no index."""
        with self._lock:
            if not self._stream.closed:
                with self._writing():
                    self._mcap.finish()  # type: ignore[no-untyped-call]  # the library's gap
                self._stream.close()

    def __exit__(self, *_: object) -> None:
        self.close()

    def _channel(self, topic: str, type_name: str, qos: QoSProfile | None) -> int:
        """Return the number of a topic's channel; its first use writes the channel."""
        if topic not in self._channels:
            if type_name not in self._schemas:
                text = definition(type_name).encode()
                self._schemas[type_name] = self._mcap.register_schema(type_name, MSG, text)
            metadata = {} if qos is None else {QOS_KEY: offered_qos_profiles(qos)}
            schema = self._schemas[type_name]
            number = self._mcap.register_channel(topic, "cdr", schema, metadata)
            self._channels[topic] = (type_name, number)
        known, number = self._channels[topic]
        if known != type_name:
            raise LogError(
                f"log, topic {topic}: given {type_name}, allowed: {known}, as in its earlier messages"
            )
        return number

    def _end_old_chunk(self, log_time_ns: int) -> None:
        if self._chunk_start_ns is None:
            self._chunk_start_ns = log_time_ns
        if log_time_ns - self._chunk_start_ns >= _CHUNK_NS:
            self._mcap.flush()  # type: ignore[no-untyped-call]  # the library's gap
            self._chunk_start_ns = None
