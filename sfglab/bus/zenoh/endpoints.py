"""Writers and readers of topics over Zenoh: CDR in, CDR out, with the attachments of rmw_zenoh_cpp."""

from __future__ import annotations

import struct
import time
from collections import deque
from functools import partial
from itertools import count
from typing import TYPE_CHECKING, Any

from sfglab.bus.api import EndpointAdded, EndpointKind
from sfglab.bus.endpoints import Inbox
from sfglab.bus.errors import WriterBlockedError
from sfglab.bus.loop import nothing
from sfglab.bus.zenoh.layout import ATTACHMENT, GID_BYTES, NO_HASH, end_gid, gid_of
from sfglab.bus.zenoh.session import direct
from sfglab.messages import serialize
from sfglab.qos import Durability, History, QoSProfile, Reliability, incompatibilities

if TYPE_CHECKING:
    from collections.abc import Callable

    from sfglab.bus.api import EndpointEvent, EndpointInfo, RawEndpoint
    from sfglab.bus.zenoh.participant import ZenohParticipant

# Time after which a latched publisher sends its latest sequence number, s, as in rmw_publisher_data.cpp.
_HEARTBEAT_S = 0.5
# Most samples of a KEEP_ALL writer: those that wait for the thread, and those that a latched one keeps.
_UNSENT, _ALL_KEPT = 256, 4096
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


class ZenohEnd:
    """Endpoint of the node with its peers, which match by the rules of DDS; Zenoh itself has no such rules."""

    def __init__(
        self,
        backend: ZenohParticipant,
        endpoint: RawEndpoint,
        notify: Callable[[], None],
        inbox: Any = None,
    ) -> None:
        kinds = EndpointKind.PUBLISHER, EndpointKind.SUBSCRIPTION
        other, own = kinds if inbox else kinds[::-1]
        self.key = backend.key(endpoint)
        self.token = backend.token(endpoint, own)
        self.gid = end_gid(gid_of(self.token), endpoint.dds_topic)  #: 16-byte GID.
        #: Publisher, subscription, server or client that the endpoint belongs to.
        self.owner = self.key, endpoint.user_data, endpoint.forwards
        self.peers: dict[bytes, EndpointInfo] = {}  #: Matching endpoints by GID.
        #: Number of samples that are missing between those that arrived, or have no attachment of ROS 2.
        self.lost = 0
        self._backend = backend
        self._endpoint = endpoint
        self._notify = notify
        self._inbox = inbox
        self._is_latched = endpoint.qos.durability is Durability.TRANSIENT_LOCAL
        self._refused: set[bytes] = set()
        self._numbers = count(1)  # of sent samples and requests
        self._latest: dict[bytes, int] = {}  # number of the latest received sample by GID
        self._is_open = True
        self._declared: list[Any] = []
        self._unwatch = backend.graph.watch(endpoint.dds_topic, other, self._hear)
        backend.session.order(self._declare)

    @property
    def matched(self) -> int:
        """Number of matching endpoints of the other kind."""
        return len(self.peers)

    @property
    def matched_prefixes(self) -> frozenset[bytes]:
        """Prefixes of the GIDs of matching endpoints."""
        return frozenset(map(self._backend.participant_of, self.peers))

    def close(self) -> None:
        """Undeclare the endpoint, after the samples that wait."""
        self._unwatch()
        self._backend.session.order(self._undeclare)

    def _declare(self, session: Any) -> None:
        """Declare what sends or receives, then the token, because peers may send at once."""
        raise NotImplementedError

    def _announce(self, session: Any) -> None:
        if self._is_open:
            self._declared.append(session.liveliness().declare_token(self.token))
            self._backend.graph.receive(self.token, alive=True)

    def _undeclare(self, _: Any) -> None:
        """Undeclare what sends or receives, then the token, because late joiners query who is announced."""
        self._is_open = False
        for entity in self._declared:
            entity.undeclare()
        self._backend.graph.receive(self.token, alive=False)

    def _hear(self, event: EndpointEvent) -> None:
        peer = event.endpoint
        is_there = isinstance(event, EndpointAdded)
        matches = is_there and self._matches(peer)
        if matches:
            self.peers[peer.gid] = peer
        elif is_there:
            self._refused.add(peer.gid)
        else:
            self._refused.discard(peer.gid)
            self.peers.pop(peer.gid, None)
        if self._inbox:
            self._inbox.on_life(peer.gid, matches)
        self._notify()

    def _matches(self, peer: EndpointInfo) -> bool:
        own = self._endpoint
        if peer.type != own.type or (own.forwards and peer.participant == self._backend.guid):
            return False
        offered, requested = (peer, own) if self._inbox else (own, peer)
        return not incompatibilities(offered=offered.qos, requested=requested.qos)

    def _origin(self, attachment: Any) -> tuple[int, int, bytes] | None:
        """Return number, source time (ns) and GID; None for a sample of others than ROS 2 and matching peers."""
        try:
            number, stamp_ns, _, gid = ATTACHMENT.unpack(attachment.to_bytes())
        except (AttributeError, struct.error):
            self.lost += 1
            return None
        return None if gid in self._refused else (number, stamp_ns, gid)

    def _push(self, cdr: bytes, stamp_ns: int, gid: bytes) -> None:
        """Queue a sample in a thread of Zenoh; the loop also calls callbacks that may be called in a thread."""
        Inbox.push_from_thread(self._inbox, ((cdr, stamp_ns, time.time_ns(), gid),))
        self._backend.bridge.flush()


class ZenohWriter(ZenohEnd):
    """Writer of CDR. With KEEP_LAST a full link drops samples, which readers count as lost.

    With KEEP_ALL the session's thread sends, which waits for slow readers.
    """

    def __init__(
        self, backend: ZenohParticipant, endpoint: RawEndpoint, notify: Callable[[], None]
    ) -> None:
        qos = endpoint.qos
        self._is_reliable = qos.reliability is Reliability.RELIABLE
        #: Whether the writer refuses samples while many wait for slow readers.
        self.may_block = self._is_reliable and qos.history is History.KEEP_ALL
        self._unsent: deque[tuple[bytes, int]] = deque(
            maxlen=_UNSENT if self.may_block else qos.depth
        )
        self._publisher: Any = None
        self._is_started = False
        self._is_closing = False
        self._sent = 0  # number of the latest sample
        self._is_beating = False
        super().__init__(backend, endpoint, notify)

    def write(self, cdr: Any, source_timestamp_ns: int | None = None) -> None:
        """Send serialized bytes, which are not checked; see `Publisher.publish_raw`.

        Raises:
            WriterBlockedError: Many samples of a KEEP_ALL writer wait for slow readers.
        """
        stamp_ns = time.time_ns() if source_timestamp_ns is None else source_timestamp_ns
        if self._is_started and not self.may_block:
            self._send(bytes(cdr), stamp_ns)
        elif self._is_started or self._is_latched or self.peers:
            self._keep(bytes(cdr), stamp_ns)
        if self._is_latched and not self._is_beating:
            self._is_beating = True
            self._backend.bridge.loop.call_later(_HEARTBEAT_S, self._beat)

    def write_message(self, message: Any) -> None:
        """Serialize and send a message; see `write`."""
        self.write(serialize(message))

    def acknowledged(self) -> bool:
        """Return whether Zenoh has all samples; it does not report their arrival."""
        return not self._unsent

    def close(self) -> None:
        """Undeclare the publisher, after the samples that wait."""
        self._is_closing = True
        super().close()

    def _undeclare(self, session: Any) -> None:
        while self._unsent:  # closed before the loop knew of the declaration
            self._send_next()
        super()._undeclare(session)

    def _keep(self, *sample: Any) -> None:
        """Keep a sample until the publisher is declared, or with KEEP_ALL until the thread has sent it."""
        if self.may_block and len(self._unsent) == _UNSENT:
            reason = f"{_UNSENT} samples of a KEEP_ALL writer wait for slow readers"
            raise WriterBlockedError(self._endpoint.name, code=-1, reason=reason)
        self._unsent.append(sample)
        if self.may_block:
            self._backend.session.order(self._send_next)

    def _send_next(self, _: Any = None) -> None:
        try:
            self._send(*self._unsent[0])
        finally:
            self._unsent.popleft()

    def _send(self, cdr: bytes, stamp_ns: int) -> None:
        self._sent = next(self._numbers)
        attachment = ATTACHMENT.pack(self._sent, stamp_ns, GID_BYTES, self.gid)
        self._publisher.put(cdr, attachment=attachment)

    def _beat(self) -> None:
        self._is_beating = False
        self._backend.session.order(self._send_heartbeat)

    def _send_heartbeat(self, session: Any) -> None:
        """Send the latest sequence number, counted from 0, so that readers notice missing samples.

        With heartbeats of its own (`sporadic_heartbeat`), the publisher's `undeclare` would wait for a thread of Zenoh
        and hold the interpreter's lock. That thread may wait for this lock in a callback.
        """
        from zenoh import CongestionControl

        if self._is_open and self._sent:
            identity = self._publisher.id
            key = f"{self.key}/@adv/pub/{identity.zid}/{identity.eid}/_"
            number = (self._sent - 1).to_bytes(4, "little")
            session.put(key, number, congestion_control=CongestionControl.BLOCK)

    def _start(self) -> None:
        """Send the samples from before the declaration; later ones pass at once."""
        if self._is_closing:
            return
        while self._unsent and not self.may_block:
            self._send_next()
        self._is_started = True

    def _declare(self, session: Any) -> None:
        import zenoh
        from zenoh import ext

        congestion, reliability = zenoh.CongestionControl, zenoh.Reliability
        options: dict[str, Any] = {
            "congestion_control": congestion.BLOCK if self.may_block else congestion.DROP,
            "priority": getattr(zenoh.Priority, _PRIORITIES.get(self._endpoint.type, "DATA")),
            "reliability": reliability.RELIABLE if self._is_reliable else reliability.BEST_EFFORT,
        }
        if self._is_latched:  # as in rmw_publisher_data.cpp
            self._publisher = ext.declare_advanced_publisher(
                session,
                self.key,
                cache=ext.CacheConfig(_kept(self._endpoint.qos)),
                publisher_detection=True,
                sample_miss_detection=ext.MissDetectionConfig(
                    heartbeat=None, sporadic_heartbeat=None
                ),
                **options,
            )
        else:
            self._publisher = session.declare_publisher(self.key, **options)
        self._declared.append(self._publisher)
        self._announce(session)
        self._backend.bridge.post(self._start)
        self._backend.bridge.flush()


class ZenohReader(ZenohEnd):
    """Reader of CDR; a gap in a publisher's sequence numbers counts as lost samples."""

    def _declare(self, session: Any) -> None:
        from zenoh import QueryTarget, ext

        # A router reads types without a definition here with any hash.
        key = self.key.replace(NO_HASH, "*")
        if not self._is_latched:
            self._declared.append(session.declare_subscriber(key, direct(self._take)))
            self._announce(session)
            return
        subscriber = ext.declare_advanced_subscriber(  # as in rmw_subscription_data.cpp
            session,
            key,
            direct(self._take),
            history=ext.HistoryConfig(
                detect_late_publishers=True, max_samples=_kept(self._endpoint.qos)
            ),
            recovery=ext.RecoveryConfig(periodic_queries=None, heartbeat=True),
        )
        self._declared.append(subscriber)
        # A publisher has sent the history before it replies to this query for no sample. Then it may know the reader.
        announce = partial(self._backend.session.order, self._announce)
        caches = f"{key}/@adv/pub/**?_max=0"
        session.get(caches, direct(nothing, announce), target=QueryTarget.ALL, timeout=_QUERY_S)

    def _take(self, sample: Any) -> None:
        """Take a sample in a thread of Zenoh."""
        if (origin := self._origin(sample.attachment)) is not None:
            number, stamp_ns, gid = origin
            self.lost += max(0, number - self._latest.get(gid, number) - 1)
            self._latest[gid] = number
            self._push(sample.payload.to_bytes(), stamp_ns, gid)


def _kept(qos: QoSProfile) -> int:
    """Return the number of samples that are kept for late joiners, or queried by them."""
    return qos.depth if qos.history is History.KEEP_LAST else _ALL_KEPT
