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
#: Key of the QoS profiles: metadata of an MCAP channel, column of SQLite's topics.
QOS_KEY = "offered_qos_profiles"
# Wrong checksums and texts raise ValueError, lz4 raises RuntimeError. The library mcap does not check lengths
# and offsets within a record, which leads to the other errors.
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
    """A log cannot be written or read, or does not contain the requested topic, table or record."""


@contextmanager
def damage_named(path: Path) -> Iterator[None]:
    """Turn the libraries' errors for a damaged file into a LogError that names the file.

    Raises:
        LogError: The block raised one of `DAMAGE`.
    """
    try:
        yield
    except DAMAGE as error:
        raise LogError(
            f"log {path}: damaged or not readable ({error}); use another copy or record it again"
        ) from error


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Channel:
    """One channel of a file, or one topic of a log: messages of one type."""

    topic: str  #: Name of the topic.
    type_name: str  #: ROS type of the messages; empty where the file does not name it.
    encoding: str  #: Encoding of the messages, such as ``cdr``.
    definition: str  #: Definition of the type as `.msg`; empty where the file has none.
    definition_encoding: str  #: Encoding of the definition, such as `ros2msg`.
    offered_qos: str  #: QoS profiles of the publishers, as rosbag2's YAML.
    count: int  #: Number of messages.


class LogMessage(NamedTuple):
    """One recorded message, still serialised, with its times."""

    channel: Channel  #: Channel of the message in its file.
    log_time_ns: int  #: Time of reception, ns, on the clock of the run.
    publish_time_ns: int  #: Time of publication, ns, on the same clock.
    cdr: bytes  #: Serialised message.

    @property
    def topic(self) -> str:
        """Name of the topic."""
        return self.channel.topic

    @property
    def type_name(self) -> str:
        """ROS type of the message, such as ``std_msgs/msg/String``."""
        return self.channel.type_name


def most_bytes(compressed: int) -> int:
    """Return the largest accepted decompressed size of data, bytes, given the compressed size, bytes.

    The factor is 1024, because a black image is compressed to a thousandth of its size.
    """
    return 2**26 + 1024 * compressed


def decompress(data: bytes, most: int) -> bytes:
    """Return the content of one Zstandard frame; `most` is the largest accepted size of the content, bytes.

    Raises:
        ZstdError: The frame is damaged, or its content is larger.
    """
    if frame_content_size(data) > most:
        raise ZstdError(f"{len(data)} compressed bytes hold more than {most}")
    return ZstdDecompressor().decompress(data, max_output_size=most)
