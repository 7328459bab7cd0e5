"""Writers and readers of topics over Zenoh: CDR in, CDR out, with the attachments of rmw_zenoh_cpp."""

from __future__ import annotations

import struct
import threading
import time
from collections import deque
from functools import partial
from itertools import count
from operator import itemgetter
from queue import Full, Queue
from typing import TYPE_CHECKING, Any

from sfglab.bus.api import EndpointAdded, EndpointKind, entries
from sfglab.bus.errors import WriterBlockedError
from sfglab.bus.loop import nothing
from sfglab.bus.zenoh.layout import (
    ATTACHMENT,
    GID_BYTES,
    HASH_KEY,
    NO_HASH,
    PUBLISHER,
    SUBSCRIPTION,
)
from sfglab.bus.zenoh.participant import Announcement
from sfglab.messages import serialize
from sfglab.qos import Durability, History, QoSProfile, Reliability, incompatibilities

if TYPE_CHECKING:
    from collections.abc import Callable

    from sfglab.bus.api import EndpointEvent, EndpointInfo, RawEndpoint
    from sfglab.bus.endpoints import Inbox, Sample
    from sfglab.bus.zenoh.participant import ZenohParticipant

# Period in which a latched publisher sends its latest sequence number, s, as in rmw_publisher_data.cpp.
_HEARTBEAT_S = 0.5
# Most samples of a KEEP_ALL writer: those that wait for its thread, and those that a latched one keeps.
_UNSENT, _ALL_KEPT = 256, 4096
# Most publishers whose latest sequence number a reader remembers, also after they have left.
_PUBLISHERS = 4096
# Longest wait of a caller beside the loop for room among the unsent samples, s.
_BLOCKED_S = 0.1
# Longest wait for the caches of latched publishers, s.
_QUERY_S = 5.0
# A full queue of images delays and drops only images.
_PRIORITIES = {
    "tf2_msgs/msg/TFMessage": "DATA_HIGH",
    "sensor_msgs/msg/Image": "DATA_LOW",
    "sensor_msgs/msg/CompressedImage": "DATA_LOW",
    "sensor_msgs/msg/PointCloud2": "DATA_LOW",
    "ffmpeg_image_transport_msgs/msg/FFMPEGPacket": "DATA_LOW",
    "foxglove_msgs/msg/CompressedVideo": "DATA_LOW",
}


def locality(endpoint: RawEndpoint) -> Any:
    """Return where an endpoint's peers may be; forwarding endpoints have none in their own session."""
    from zenoh import Locality

    return Locality.REMOTE if endpoint.forwards else Locality.ANY


def direct(callback: Callable[[Any], None], end: Callable[[], None] = nothing) -> Any:
    """Return a handler that calls a function in the receiving thread, which it must not delay."""
    from zenoh.handlers import Callback

    return Callback(callback, end, indirect=False)


class ZenohEnd:
    """Endpoint of the node with its peers, which match by the rules of DDS; Zenoh itself has no such rules."""

    def __init__(
        self,
        participant: ZenohParticipant,
        endpoint: RawEndpoint,
        notify: Callable[[], None],
        inbox: Inbox | None,
    ) -> None:
        self.peers: dict[bytes, EndpointInfo] = {}  #: Matching endpoints by GID.
        self.inbox = inbox  #: Inbox of a reader; None for a writer.
        self._participant = participant
        self._endpoint = endpoint
        self._notify = notify
        self._refused: set[bytes] = set()
        other = EndpointKind.PUBLISHER if inbox else EndpointKind.SUBSCRIPTION
        self._unwatch = participant.graph.watch(endpoint.dds_topic, other, self._hear)

    @property
    def matched(self) -> int:
        """Number of matching endpoints of the other kind."""
        return len(self.peers)

    @property
    def matched_prefixes(self) -> frozenset[bytes]:
        """GID prefixes of matching endpoints."""
        return frozenset(gid[:12] for gid in self.peers)

    def close(self) -> None:
        """Stop following the graph."""
        self._unwatch()

    def _hear(self, event: EndpointEvent) -> None:
        peer = event.endpoint
        is_there = isinstance(event, EndpointAdded)
        self._refused.discard(peer.gid)
        if is_there and self._matches(peer):
            self.peers[peer.gid] = peer
            self._on_peer(peer, is_there=True)
        elif self.peers.pop(peer.gid, None) is not None:
            self._on_peer(peer, is_there=False)
        elif is_there:
            self._refused.add(peer.gid)

    def _on_peer(self, peer: EndpointInfo, *, is_there: bool) -> None:
        """Report a peer that has come or gone."""
        if self.inbox is not None:
            self.inbox.on_life(peer.gid, is_there)
        self._notify()

    def _matches(self, peer: EndpointInfo) -> bool:
        own = self._endpoint
        if (peer.transport, peer.type) != (own.transport, own.type) or (
            own.forwards and peer.participant == self._participant.guid
        ):
            return False
        offered, requested = (peer, own) if self.inbox else (own, peer)
        has_our_definition = HASH_KEY not in entries(peer.user_data)
        return has_our_definition and not incompatibilities(
            offered=offered.qos, requested=requested.qos
        )


class ZenohWriter(ZenohEnd):
    """Writer of CDR. With KEEP_LAST a full link drops samples, which readers count as lost.

    With KEEP_ALL a thread sends, which waits for slow readers.
    """

    def __init__(
        self, participant: ZenohParticipant, endpoint: RawEndpoint, notify: Callable[[], None]
    ) -> None:
        qos = endpoint.qos
        self._is_reliable = qos.reliability is Reliability.RELIABLE
        self._is_latched = qos.durability is Durability.TRANSIENT_LOCAL
        #: Whether the writer refuses samples while many wait for slow readers.
        self.may_block = self._is_reliable and qos.history is History.KEEP_ALL
        self._announcement = Announcement(participant, endpoint, PUBLISHER, self._declare)
        self.gid = self._announcement.gid  #: 16-byte GID.
        self._numbers = count(1)
        self._publisher: Any = None
        self._is_started = False
        self._starting = threading.Lock()
        self._early: deque[tuple[bytes, bytes]] = deque(maxlen=kept(qos))
        self._unsent: Queue[tuple[bytes, int]] = Queue(_UNSENT)
        self._loop_thread = threading.get_ident()
        super().__init__(participant, endpoint, notify, None)
        self._announcement.open()
        self._announcement.show(self._start)

    def write(self, cdr: Any, source_timestamp_ns: int | None = None) -> None:
        """Send serialized bytes, which are not checked; see `Publisher.publish_raw`.

        Raises:
            WriterBlockedError: Many samples of a KEEP_ALL writer wait for slow readers.
        """
        stamp_ns = time.time_ns() if source_timestamp_ns is None else source_timestamp_ns
        sample = bytes(cdr), stamp_ns
        if not self.may_block:
            self._send(*sample)
            return
        is_on_loop = threading.get_ident() == self._loop_thread
        try:
            self._unsent.put(sample, not is_on_loop, _BLOCKED_S)
        except Full as error:
            reason = f"{_UNSENT} samples of a KEEP_ALL writer wait for slow readers"
            raise WriterBlockedError(self._endpoint.name, code=-1, reason=reason) from error
        self._participant.session.sender.order(self._send_next)

    def write_message(self, message: Any) -> None:
        """Serialize and send a message; see `write`."""
        self.write(serialize(message))

    def acknowledged(self) -> bool:
        """Return whether Zenoh has all samples; it does not report their arrival."""
        return not self._early and not self._unsent.unfinished_tasks

    def close(self) -> None:
        """Undeclare the writer, after the samples that wait."""
        super().close()
        if self.may_block:
            self._participant.session.sender.order(self._announcement.close)
        else:
            self._announcement.close()

    def _send_next(self) -> None:
        try:
            self._send(*self._unsent.get())
        finally:
            self._unsent.task_done()

    def _send(self, data: bytes, stamp_ns: int) -> None:
        attachment = ATTACHMENT.pack(next(self._numbers), stamp_ns, GID_BYTES, self.gid)
        if not self._is_started:
            with self._starting:
                if not self._is_started:
                    if self._is_latched or self.peers:
                        self._early.append((data, attachment))
                    return
        self._publisher.put(data, attachment=attachment)

    def _declare(self, session: Any) -> Any:
        import zenoh
        from zenoh import ext

        congestion, reliability = zenoh.CongestionControl, zenoh.Reliability
        options = {
            "congestion_control": congestion.BLOCK if self.may_block else congestion.DROP,
            "priority": getattr(zenoh.Priority, _PRIORITIES.get(self._endpoint.type, "DATA")),
            "reliability": reliability.RELIABLE if self._is_reliable else reliability.BEST_EFFORT,
            "allowed_destination": locality(self._endpoint),
        }
        declare = session.declare_publisher
        if self._is_latched:  # as in rmw_publisher_data.cpp
            declare = partial(ext.declare_advanced_publisher, session, publisher_detection=True)
            options["cache"] = ext.CacheConfig(kept(self._endpoint.qos))
            if self._is_reliable:
                misses = ext.MissDetectionConfig(heartbeat=None, sporadic_heartbeat=_HEARTBEAT_S)
                options["sample_miss_detection"] = misses
        self._publisher = declare(self._announcement.key, **options)
        return self._publisher

    def _start(self) -> None:
        """Send the samples from before the declaration; later ones pass at once."""
        with self._starting:
            for data, attachment in self._early:
                self._publisher.put(data, attachment=attachment)
            self._early.clear()
            self._is_started = True


class ZenohReader(ZenohEnd):
    """Reader of CDR; a gap in a publisher's sequence numbers counts as lost samples."""

    def __init__(
        self,
        participant: ZenohParticipant,
        endpoint: RawEndpoint,
        notify: Callable[[], None],
        inbox: Inbox,
    ) -> None:
        #: Number of samples that are missing between those that arrived, or have no attachment of ROS 2.
        self.lost = 0
        self._announcement = Announcement(participant, endpoint, SUBSCRIPTION, self._declare)
        self.gid = self._announcement.gid  #: 16-byte GID.
        # A router reads types without a definition here with any hash.
        self._key = self._announcement.key.replace(NO_HASH, "*")
        self._push = inbox.push
        self._push_from_thread = inbox.push_from_thread
        self._latest: dict[bytes, int] = {}
        super().__init__(participant, endpoint, notify, inbox)
        self._announcement.open()
        self._show()

    def close(self) -> None:
        """Undeclare the reader."""
        super().close()
        self._announcement.close()

    def _show(self) -> None:
        self._announcement.show()

    def _declare(self, session: Any) -> Any:
        origin = locality(self._endpoint)
        return session.declare_subscriber(self._key, direct(self._take), allowed_origin=origin)

    def _take(self, sample: Any) -> None:
        """Take a sample in a thread of Zenoh, which must not wait: all subscriptions of the session would."""
        received_ns = time.time_ns()
        try:
            number, stamp_ns, _, gid = ATTACHMENT.unpack(sample.attachment.to_bytes())
        except (AttributeError, struct.error):
            self.lost += 1
            return
        if gid not in self._refused:
            self._accept(number, (sample.payload.to_bytes(), stamp_ns, received_ns, gid))

    def _accept(self, number: int, sample: Sample) -> None:
        """Queue a sample of a publisher, given with its sequence number."""
        gid = sample[3]
        self.lost += max(0, number - self._latest.get(gid, number) - 1)
        self._latest[gid] = number
        if len(self._latest) > _PUBLISHERS:
            del self._latest[next(iter(self._latest))]
        bridge = self._participant.bridge
        if self._endpoint.threaded:
            bridge.post(partial(self._push, sample))
        else:
            self._push_from_thread((sample,))
        bridge.flush()


class LatchedReader(ZenohReader):
    """Reader that queries the caches of latched publishers before it is announced, and of each one that matches.

    While a query runs, samples wait, so that they follow the history. Zenoh's `AdvancedSubscriber`, which
    rmw_zenoh_cpp uses, drops a history that is overtaken by a new sample.
    """

    def __init__(self, *options: Any) -> None:
        self._queries = 0
        self._held: list[tuple[int, Sample]] = []
        self._lock = threading.RLock()
        super().__init__(*options)

    def _show(self) -> None:
        """Leave the announcement to the end of the first query."""

    def _declare(self, session: Any) -> Any:
        subscriber = super()._declare(session)
        self._query("*", self._announcement.show, session)
        return subscriber

    def _on_peer(self, peer: EndpointInfo, *, is_there: bool) -> None:
        if is_there:
            publisher = peer.participant.hex().lstrip("0")
            self._participant.session.order(partial(self._query, publisher, nothing))
        super()._on_peer(peer, is_there=is_there)

    def _query(self, publisher: str, then: Callable[[], None], session: Any) -> None:
        from zenoh import ConsolidationMode, QueryTarget, ReplyKeyExpr

        with self._lock:
            self._queries += 1
        session.get(
            f"{self._key}/@adv/pub/{publisher}/**?_max={kept(self._endpoint.qos)}",
            direct(self._on_reply, partial(self._on_end, then)),
            target=QueryTarget.ALL,
            consolidation=ConsolidationMode.NONE,
            accept_replies=ReplyKeyExpr.ANY,
            allowed_destination=locality(self._endpoint),
            timeout=_QUERY_S,
        )

    def _on_reply(self, reply: Any) -> None:
        if reply.ok is not None:
            self._take(reply.ok)

    def _on_end(self, then: Callable[[], None]) -> None:
        with self._lock:
            self._queries -= 1
            if not self._queries:
                held, self._held = sorted(self._held, key=itemgetter(0)), []
                for number, sample in held:
                    self._accept(number, sample)
        then()

    def _accept(self, number: int, sample: Sample) -> None:
        with self._lock:
            if self._queries:
                self._held.append((number, sample))
            elif number > self._latest.get(sample[3], -1):  # not known from an earlier query
                super()._accept(number, sample)


def kept(qos: QoSProfile) -> int:
    """Return the number of samples that are kept for late joiners, or queried by them."""
    return qos.depth if qos.history is History.KEEP_LAST else _ALL_KEPT
