"""Which QoS the router's own readers and writers have, from those of the endpoints that it serves.

Pure functions of profiles. The aim is that nobody can tell the router from a direct connection: what a source
offers is offered across the border, and nothing stronger is requested than a direct connection would have.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from sfglab.qos import DEFAULT, Durability, History, QoSProfile, Reliability

if TYPE_CHECKING:
    from collections.abc import Iterable


READER_DEPTH = 256
"""A router that is late must not lose what its reader's cache cannot hold, so the cache is deep."""

_SERVICE_PREFIXES = ("rq/", "rr/")


def requested_qos(dds_topic: str, source: QoSProfile, sinks: Iterable[QoSProfile]) -> QoSProfile:
    """Return what the router's reader of a source requests.

    RELIABLE only where the source offers it and somebody wants it, so that a best-effort subscription
    costs no retransmission on the source's side. A source's latched samples are always asked for: whoever joins
    late across the border gets them from the router's writer, which must have them by then.

    Args:
        dds_topic: The topic on the wire.
        source: What the source offers.
        sinks: What the target side's subscriptions request.
    """
    latched = source.durability is Durability.TRANSIENT_LOCAL
    repaired = latched or any(sink.reliability is Reliability.RELIABLE for sink in sinks)
    everything = source.history is History.KEEP_ALL or dds_topic.startswith(_SERVICE_PREFIXES)
    return QoSProfile(
        reliability=source.reliability if repaired else Reliability.BEST_EFFORT,
        durability=source.durability,
        history=History.KEEP_ALL if everything else History.KEEP_LAST,
        depth=max(READER_DEPTH, source.depth if latched and not everything else 1),
    )


def announced_qos(dds_topic: str, sinks: Iterable[QoSProfile]) -> QoSProfile:
    """Return what the router's reader requests while no source is known: the strongest of the subscriptions.

    Args:
        dds_topic: The topic on the wire.
        sinks: What the target side's subscriptions request.
    """
    requests = tuple(sinks)
    reliable = any(sink.reliability is Reliability.RELIABLE for sink in requests)
    latched = any(sink.durability is Durability.TRANSIENT_LOCAL for sink in requests)
    strongest = QoSProfile(
        reliability=Reliability.RELIABLE if reliable else Reliability.BEST_EFFORT,
        durability=Durability.TRANSIENT_LOCAL if latched else Durability.VOLATILE,
    )
    return requested_qos(dds_topic, strongest, requests)


def offered_qos(source: QoSProfile) -> QoSProfile:
    """Return what the router's writer offers for a source: the same.

    The depth of a volatile history is only the sender's own buffer, which no peer sees and vendors do not
    announce: it is at least ROS 2's default, or two samples of such a source at once would be one too many.

    Args:
        source: What the source offers.
    """
    if source.durability is Durability.VOLATILE and source.history is History.KEEP_LAST:
        return replace(source, depth=max(source.depth, DEFAULT.depth))
    return source
