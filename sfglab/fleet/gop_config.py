"""Configuration of a GOP cache, and its agreement with decoders: topic, QoS and flags of a GOP replay.

The module imports neither nodes nor messages, so that it loads fast.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from sfglab.bus.address import BusAddress
from sfglab.errors import InvalidValueError
from sfglab.names import FqnError, Resource, Suffixed, parse
from sfglab.qos import Durability, QoSProfile

FFMPEG_PACKET = "ffmpeg_image_transport_msgs/msg/FFMPEGPacket"  #: Type of streams and replays.

#: Flag of a packet at which a decoder may start (libavcodec, packet.h: AV_PKT_FLAG_KEY).
FLAG_KEY = 1

FLAG_DISCARD = 4  #: Flag of a packet whose frame is decoded and not shown (AV_PKT_FLAG_DISCARD).

#: Maximum length of a group of pictures, packets: the depth of a router's reader.
REPLAY_DEPTH = 256

REPLAY_QOS = QoSProfile(durability=Durability.TRANSIENT_LOCAL, depth=REPLAY_DEPTH)
"""QoS of a replay: reliable, because one lost packet spoils a group; transient local, so that a router
that connects late loses no packet."""


def replay_topic(stream_topic: str) -> str | None:
    """Return the companion ``<...>/ffmpeg_replay`` of a stream; None without the resource ``ffmpeg``."""
    try:
        fqn = parse(stream_topic)
    except FqnError:
        return None
    if fqn.resource is Resource.FFMPEG:
        return str(replace(fqn, resource=Resource.FFMPEG_REPLAY))
    if isinstance(fqn.resource, Suffixed) and fqn.resource.base is Resource.FFMPEG:
        return str(replace(fqn, resource=Resource.FFMPEG_REPLAY.suffixed(fqn.resource.suffix)))
    return None


@dataclass(frozen=True, slots=True, kw_only=True)
class GopCacheConfig:
    """Configuration of a GOP cache's process.

    Raises:
        InvalidValueError: A stream is no topic of the schema that ends in ``ffmpeg``.
    """

    address: BusAddress  #: The agent's domain.
    streams: tuple[str, ...] = ()  #: Topics of the compressed streams.

    def __post_init__(self) -> None:
        for topic in self.streams:
            if replay_topic(topic) is None:
                allowed = "topics of the schema that end in 'ffmpeg'"
                raise InvalidValueError("stream", topic, allowed)
