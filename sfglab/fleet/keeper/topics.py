"""Where the replay of a stream is, how it is offered, and what the flags of its packets mean.

Refuses to know codecs: a keeper passes packets on and need not load what decodes them.
"""

from __future__ import annotations

from dataclasses import replace

from sfglab.names import FqnError, Resource, Suffixed, parse
from sfglab.qos import Durability, QoSProfile

FFMPEG_PACKET = "ffmpeg_image_transport_msgs/msg/FFMPEGPacket"
"""The type of streams that can be replayed, and of their replays."""

FLAG_KEY = 1
"""In the flags of a packet where a decoder may start (libavcodec, packet.h: AV_PKT_FLAG_KEY)."""

FLAG_DISCARD = 4
"""In the flags of a packet that the next ones need and whose own picture nobody wants (AV_PKT_FLAG_DISCARD)."""

REPLAY_DEPTH = 256
"""The longest group of pictures that can be replayed, in packets: as deep as a router's reader."""

REPLAY_QOS = QoSProfile(durability=Durability.TRANSIENT_LOCAL, depth=REPLAY_DEPTH)
"""Reliable, because one lost packet spoils a group; latched, so that a router on the way that is not yet
connected on its other side loses nothing."""


def replay_topic(stream_topic: str) -> str | None:
    """Return the topic that replays a stream: its companion ``<...>/ffmpeg_replay``.

    Args:
        stream_topic: The compressed stream's topic.

    Returns:
        The companion's name; None for a stream that has none: only those with the resource ``ffmpeg`` do, whose
        packets are numbered.
    """
    try:
        fqn = parse(stream_topic)
    except FqnError:
        return None
    if fqn.resource is Resource.FFMPEG:
        return str(replace(fqn, resource=Resource.FFMPEG_REPLAY))
    if isinstance(fqn.resource, Suffixed) and fqn.resource.base is Resource.FFMPEG:
        return str(replace(fqn, resource=Resource.FFMPEG_REPLAY.suffixed(fqn.resource.suffix)))
    return None
