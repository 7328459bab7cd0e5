"""Parts of a log: a channel, a stored message, and the protocol of the files that `LogReader` reads."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple, Protocol

from sfglab.errors import SfglabError

if TYPE_CHECKING:
    from collections.abc import Collection, Iterator


class LogError(SfglabError, ValueError):
    """A log cannot be written or read, or does not hold what was asked for."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Channel:
    """One channel of a file: a topic whose messages have one type by one definition."""

    topic: str  #: Name of the topic.
    type_name: str  #: ROS type of the messages; empty where the file does not name it.
    encoding: str = "cdr"  #: Encoding of the messages.
    definition: bytes = b""  #: Definition of the type; empty where the file has none.
    definition_encoding: str = ""  #: Encoding of the definition, such as `ros2msg`.
    offered_qos: str = ""  #: QoS profiles of the publishers, as rosbag2's YAML.
    count: int = 0  #: Number of messages.


class StoredMessage(NamedTuple):
    """One message as a file holds it."""

    channel: Channel
    log_time_ns: int
    publish_time_ns: int
    data: bytes


class LogFile(Protocol):
    """One file of a log. Its methods raise LogError if the file is damaged."""

    channels: tuple[Channel, ...]
    span_ns: tuple[int, int] | None  #: Log times of the first and the last message.
    truncated: bool  #: Whether the file ends before its data does.

    def messages(
        self, channels: Collection[Channel], start_ns: int | None, end_ns: int | None
    ) -> Iterator[StoredMessage]:
        """Yield the messages of some channels in the order of log time, up to before `end_ns`."""

    def close(self) -> None:
        """Close the file."""
