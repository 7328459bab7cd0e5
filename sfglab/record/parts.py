"""Parts of a log that its files share: a channel, a stored message, and the error of a damaged file."""

from __future__ import annotations

import sqlite3
import struct
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

from mcap.exceptions import McapError
from zstandard import ZstdDecompressor, ZstdError, frame_content_size

from sfglab.errors import SfglabError

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

MSG = "ros2msg"  #: Encoding of a definition as `.msg`.
QOS_KEY = "offered_qos_profiles"  #: Key of QoS profiles in a channel of MCAP and a topic of SQLite.
# Checksums and text that are wrong are ValueErrors, lz4's error is a RuntimeError, and mcap
# believes the lengths and offsets within a record.
DAMAGE = (
    McapError,
    ZstdError,
    sqlite3.Error,
    struct.error,
    ValueError,
    OSError,
    OverflowError,
    MemoryError,
    RuntimeError,
    EOFError,
)
"""Errors of the libraries for a file that is damaged or of another kind."""


class LogError(SfglabError, ValueError):
    """A log cannot be written or read, or does not hold what was asked for."""


@contextmanager
def damage_named(path: Path) -> Iterator[None]:
    """Turn the libraries' errors for a damaged file into a LogError that names the file."""
    try:
        yield
    except DAMAGE as error:
        raise LogError(f"log {path}: damaged or not readable: {error}") from error


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Channel:
    """One channel of a file, or one topic of a log: messages of one type."""

    topic: str  #: Name of the topic.
    type_name: str  #: ROS type of the messages; empty where the file does not name it.
    encoding: str  #: Encoding of the messages.
    definition: str  #: Definition of the type as `.msg`; empty where the file has none.
    definition_encoding: str  #: Encoding of the definition, such as `ros2msg`.
    offered_qos: str  #: QoS profiles of the publishers, as rosbag2's YAML.
    count: int  #: Number of messages.


class LogMessage(NamedTuple):
    """One message as it was recorded."""

    channel: Channel  #: Channel of its file.
    log_time_ns: int  #: Time of reception, on the clock of the run.
    publish_time_ns: int  #: Time of publication, on the same clock.
    cdr: bytes  #: Serialised message.

    @property
    def topic(self) -> str:
        """Name of the topic."""
        return self.channel.topic

    @property
    def type_name(self) -> str:
        """ROS type."""
        return self.channel.type_name


def most_bytes(compressed: int) -> int:
    """Return a bound on the size of what is compressed to a number of bytes.

    A black picture takes a thousandth of its size.
    """
    return 2**26 + 1024 * compressed


def decompress(data: bytes, most: int) -> bytes:
    """Return the content of one frame of Zstandard, at most so many bytes.

    Raises:
        ZstdError: The frame is damaged, or holds more.
    """
    if frame_content_size(data) > most:
        raise ZstdError(f"{len(data)} compressed bytes hold more than {most}")
    return ZstdDecompressor().decompress(data, max_output_size=most)
