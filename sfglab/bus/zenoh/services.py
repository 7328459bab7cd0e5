"""Services over Zenoh: a server is a queryable, a client a querier, each with a request and a reply endpoint.

The bus sends requests and replies as frames on two topics (`sfglab.messages.frame_service`). In rmw_zenoh_cpp a
query carries the request, and its reply the response. The two endpoints of a server or client therefore share
an `_Entity`, which exists in Zenoh while the one that receives is open.
"""

from __future__ import annotations

import struct
import threading
import time
from functools import partial
from itertools import count
from typing import TYPE_CHECKING, Any, NoReturn

from sfglab.bus.zenoh.endpoints import ZenohEnd, direct, locality
from sfglab.bus.zenoh.layout import (
    ATTACHMENT,
    CLIENT,
    GID_BYTES,
    SERVER,
    end_gid,
    participant_guid,
)
from sfglab.bus.zenoh.participant import Announcement
from sfglab.messages import ServiceFrame, frame_service, unframe_service

if TYPE_CHECKING:
    from collections.abc import Callable

    from sfglab.bus.api import RawEndpoint
    from sfglab.bus.endpoints import Inbox
    from sfglab.bus.zenoh.participant import ZenohParticipant

# Most requests that wait for a reply of one server. The oldest are dropped first: a handler may fail.
_UNANSWERED = 1000
# Time-out of rmw_client_data.cpp, s; callers wait for a shorter time.
_TIMEOUT_S = 600.0


class Services:
    """Servers and clients of one participant."""

    def __init__(self, participant: ZenohParticipant) -> None:
        self._participant = participant
        self._entities: dict[tuple[object, ...], _Entity] = {}

    def open(
        self, endpoint: RawEndpoint, notify: Callable[[], None], inbox: Inbox | None
    ) -> ServiceEnd:
        """Open a reader, which needs an inbox, or a writer, of the server or client with the same USER_DATA."""
        is_request = endpoint.dds_topic.startswith("rq/")
        kind = _Server if is_request == (inbox is not None) else _Client
        key = kind, self._participant.key(endpoint), endpoint.user_data, endpoint.forwards
        self._entities = {key: entity for key, entity in self._entities.items() if entity.ends}
        if key not in self._entities:
            self._entities[key] = kind(self._participant, endpoint)
        return ServiceEnd(self._entities[key], endpoint, notify, inbox)


class ServiceEnd(ZenohEnd):
    """Request or reply endpoint of a server or client; a reader has an inbox."""

    lost = 0

    def __init__(
        self,
        entity: _Entity,
        endpoint: RawEndpoint,
        notify: Callable[[], None],
        inbox: Inbox | None,
    ) -> None:
        self.gid = end_gid(entity.announcement.gid, endpoint.dds_topic)  #: 16-byte GID.
        self._entity = entity
        super().__init__(entity.participant, endpoint, notify, inbox)
        entity.change((*entity.ends, self))

    @property
    def matched_prefixes(self) -> frozenset[bytes]:
        """GID prefixes of matching endpoints, and of clients that wait for a reply."""
        waiting = tuple(self._entity.waiting.values())
        return super().matched_prefixes.union(gid[:12] for _, gid in waiting)

    def write(self, cdr: Any, source_timestamp_ns: int | None = None) -> None:
        """Send the frame of a request or reply, stamped with the present time."""
        del source_timestamp_ns
        self._entity.send(unframe_service(bytes(cdr)))

    def write_message(self, message: Any) -> NoReturn:
        """Raise TypeError because only frames can be sent."""
        raise TypeError(f"service: given {message!r}, allowed are frames")

    def push(self, frame: ServiceFrame, stamp_ns: int, gid: bytes) -> None:
        """Queue a received frame if this is a reader; callable from any thread."""
        if self.inbox is not None:
            sample = (frame_service(frame), stamp_ns, time.time_ns(), gid)
            self.inbox.push_from_thread((sample,))
            self._participant.bridge.flush()

    def close(self) -> None:
        """Close the endpoint."""
        super().close()
        self._entity.change(tuple(end for end in self._entity.ends if end is not self))


class _Entity:
    """Server or client; a router may have several readers or writers of one."""

    kind: str

    def __init__(self, participant: ZenohParticipant, endpoint: RawEndpoint) -> None:
        self.participant = participant
        self.ends: tuple[ServiceEnd, ...] = ()
        #: Queries of a server, with their clients' GIDs, by client and number.
        self.waiting: dict[tuple[int, int], tuple[Any, bytes]] = {}
        self.announcement = Announcement(participant, endpoint, self.kind, self._declare)
        self._endpoint = endpoint

    def change(self, ends: tuple[ServiceEnd, ...]) -> None:
        """Change the endpoints; the entity is declared while there is a reader.

        A router opens its writer only when it discovers the other side, which may be a router as well.
        """
        before, now = (any(end.inbox for end in those) for those in (self.ends, ends))
        self.ends = ends
        if now and not before:
            self.announcement.open()
            self.announcement.show()
        if before and not now:
            self.announcement.close()

    def send(self, frame: ServiceFrame) -> None:
        """Send a request or reply."""
        raise NotImplementedError

    def _declare(self, session: Any) -> Any:
        raise NotImplementedError


class _Server(_Entity):
    """Server: a queryable whose queries wait for their replies, by client and number."""

    kind = SERVER

    def __init__(self, participant: ZenohParticipant, endpoint: RawEndpoint) -> None:
        super().__init__(participant, endpoint)
        self._lock = threading.Lock()

    def send(self, frame: ServiceFrame) -> None:
        """Reply to the request with the client and number of a frame; unknown ones are ignored."""
        with self._lock:
            query, gid = self.waiting.pop((frame.client_guid, frame.sequence), (None, b""))
        if query is not None:
            attachment = ATTACHMENT.pack(frame.sequence, time.time_ns(), GID_BYTES, gid)
            reply = partial(self._reply, query, frame.cdr, attachment)
            self.participant.session.caller.order(reply)

    def _reply(self, query: Any, cdr: bytes, attachment: bytes) -> None:
        with query:
            query.reply(self.announcement.key, cdr, attachment=attachment)

    def _declare(self, session: Any) -> Any:
        options = {"complete": True, "allowed_origin": locality(self._endpoint)}
        return session.declare_queryable(self.announcement.key, direct(self._on_query), **options)

    def _on_query(self, query: Any) -> None:
        """Queue a request, in a thread of Zenoh."""
        try:
            number, stamp_ns, _, gid = ATTACHMENT.unpack(query.attachment.to_bytes())
            frame = ServiceFrame(
                int.from_bytes(gid[:8], "little"), number, query.payload.to_bytes()
            )
        except (AttributeError, struct.error):
            query.drop()  # not a request of ROS 2
            return
        with self._lock:
            self.waiting[frame.client_guid, number] = query, gid
            if len(self.waiting) > _UNANSWERED:
                oldest, _ = self.waiting.pop(next(iter(self.waiting)))
                oldest.drop()
        for end in self.ends:
            end.push(frame, stamp_ns, gid)


class _Client(_Entity):
    """Client: a querier. Clients behind a router share it; each reply gets the frame of its request."""

    kind = CLIENT

    def __init__(self, participant: ZenohParticipant, endpoint: RawEndpoint) -> None:
        super().__init__(participant, endpoint)
        self._numbers = count(1)
        self._querier: Any = None

    def send(self, frame: ServiceFrame) -> None:
        """Send a request; without a session or a reader it is dropped, as without a server."""
        if self._querier is None:
            self.participant.session.order(partial(self._ask, frame))  # after its declaration
        else:
            self.participant.session.caller.order(partial(self._ask, frame))

    def _ask(self, frame: ServiceFrame, _: Any = None) -> None:
        if self._querier is None:
            return
        values = next(self._numbers), time.time_ns(), GID_BYTES, self.announcement.gid
        handler = direct(partial(self._on_reply, frame))
        self._querier.get(handler, payload=frame.cdr, attachment=ATTACHMENT.pack(*values))

    def _declare(self, session: Any) -> Any:
        from zenoh import ConsolidationMode, Priority, QueryTarget

        self._querier = session.declare_querier(
            self.announcement.key,
            target=QueryTarget.ALL_COMPLETE,
            consolidation=ConsolidationMode.NONE,
            timeout=_TIMEOUT_S,
            priority=Priority.DATA_HIGH,
            allowed_destination=locality(self._endpoint),
        )
        return self._querier

    def _on_reply(self, frame: ServiceFrame, reply: Any) -> None:
        """Queue a response with the frame of its request, in a thread of Zenoh."""
        if reply.ok is None:
            return  # the caller's time-out reports it
        response = frame._replace(cdr=reply.ok.payload.to_bytes())
        server = participant_guid(str(reply.replier_id.zid))
        for end in self.ends:
            peers = tuple(end.peers.values())
            gids = [peer.gid for peer in peers if peer.participant == server]
            end.push(response, time.time_ns(), gids[0] if gids else bytes(GID_BYTES))
