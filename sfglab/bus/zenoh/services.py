"""Services over Zenoh, as in rmw_zenoh_cpp: a query carries a request, and its reply the response.

The bus sends requests and replies as frames on two topics (`sfglab.messages.frame_service`), each with a reader
and a writer. The reader's token announces the server or client: a router opens its writer only when it
discovers the other side, which may be a router as well.
"""

from __future__ import annotations

import time
from functools import partial
from typing import Any, NoReturn

from sfglab.bus.zenoh.endpoints import ZenohEnd
from sfglab.bus.zenoh.layout import ATTACHMENT, GID_BYTES, gid_of
from sfglab.bus.zenoh.session import direct
from sfglab.messages import ServiceFrame, frame_service, unframe_service

# Most requests of a node's servers that wait for a reply. The oldest are dropped first: a handler may fail.
_UNANSWERED = 1000
# Time-out of rmw_client_data.cpp, s; callers wait for a shorter time.
_TIMEOUT_S = 600.0


class RequestReader(ZenohEnd):
    """Reader of requests: the queryable of a server."""

    def _declare(self, session: Any) -> None:
        queryable = session.declare_queryable(self.key, direct(self._take), complete=True)
        self._declared.append(queryable)
        self._announce(session)

    def _take(self, query: Any) -> None:
        """Queue a request in a thread of Zenoh."""
        if (origin := self._origin(query.attachment)) is None:
            query.drop()
            return
        number, stamp_ns, gid = origin
        client = int.from_bytes(gid[:8], "little")
        requests = self._backend.requests
        requests[client, number] = query, gid
        if len(requests) > _UNANSWERED:
            _, (oldest, _) = requests.popitem(last=False)
            oldest.drop()
        frame = ServiceFrame(client, number, query.payload.to_bytes())
        self._push(frame_service(frame), stamp_ns, gid)


class ReplyReader(ZenohEnd):
    """Reader of the replies to a client, which Zenoh gives to the query of each request."""

    def _declare(self, session: Any) -> None:
        self._backend.clients[self.owner] = self
        self._announce(session)

    def take(self, request: ServiceFrame, reply: Any) -> None:
        """Queue a response, with the frame of its request, in a thread of Zenoh.

        The response counts as one of the first server, because all servers of a service have the same rights.
        """
        if reply.ok is not None:  # the caller's time-out reports an error
            frame = request._replace(cdr=reply.ok.payload.to_bytes())
            gid = (*self.peers, bytes(GID_BYTES))[0]
            self._push(frame_service(frame), time.time_ns(), gid)


class ServiceWriter(ZenohEnd):
    """Writer of requests or replies."""

    def write(self, cdr: Any, source_timestamp_ns: int | None = None) -> None:
        """Send the frame of a request or reply, stamped with the present time."""
        del source_timestamp_ns
        send = self._ask if self._endpoint.dds_topic.startswith("rq/") else self._answer
        self._backend.session.order(partial(send, unframe_service(bytes(cdr))))

    def write_message(self, message: Any) -> NoReturn:
        """Raise TypeError because only frames can be sent."""
        raise TypeError(f"service: given {message!r}, allowed are frames")

    def _declare(self, session: Any) -> None:
        """Declare nothing."""

    def _ask(self, frame: ServiceFrame, session: Any) -> None:
        """Send a request; without a reader of the replies it is dropped."""
        from zenoh import ConsolidationMode, Priority, QueryTarget

        if (client := self._backend.clients.get(self.owner)) is None:
            return
        values = next(self._numbers), time.time_ns(), GID_BYTES, gid_of(client.token)
        session.get(
            self.key,
            direct(partial(client.take, frame)),
            payload=frame.cdr,
            attachment=ATTACHMENT.pack(*values),
            target=QueryTarget.ALL_COMPLETE,
            consolidation=ConsolidationMode.NONE,
            timeout=_TIMEOUT_S,
            priority=Priority.DATA_HIGH,
        )

    def _answer(self, frame: ServiceFrame, _: Any) -> None:
        """Reply to the request with the client and number of a frame; unknown ones are ignored."""
        query, gid = self._backend.requests.pop(frame[:2], (None, b""))
        if query is not None:
            values = frame.sequence, time.time_ns(), GID_BYTES, gid
            with query:
                query.reply(self.key, frame.cdr, attachment=ATTACHMENT.pack(*values))
