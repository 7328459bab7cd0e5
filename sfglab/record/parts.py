"""Parts of a log that its files share: a channel and a stored message."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

from sfglab.errors import SfglabError

QOS_KEY = "offered_qos_profiles"  #: Key of QoS profiles in a channel of MCAP and a topic of SQLite.


class LogError(SfglabError, ValueError):
    """A log cannot be written or read, or does not hold what was asked for."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Channel:
    """One channel of a file: a topic whose messages have one type by one definition."""

    topic: str  #: Name of the topic.
    type_name: str  #: ROS type of the messages; empty where the file does not name it.
    encoding: str  #: Encoding of the messages.
    definition: str  #: Definition of the type; empty where the file has none.
    definition_encoding: str  #: Encoding of the definition, such as `ros2msg`.
    offered_qos: str  #: QoS profiles of the publishers, as rosbag2's YAML.
    count: int  #: Number of messages.


class LogMessage(NamedTuple):
    """One message as it was recorded."""

    topic: str  #: Name of the topic.
    type_name: str  #: ROS type.
    log_time_ns: int  #: Time of reception, on the clock of the run.
    publish_time_ns: int  #: Time of publication, on the same clock.
    cdr: bytes  #: Serialised message.


StoredMessage = tuple[Channel, LogMessage]
"""One message of a file with its channel."""
