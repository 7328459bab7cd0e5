"""Heartbeats and descriptions of agents between routers over Zenoh.

All agents publish and subscribe to these two topics (paper A, section 4.2). As topics like any other, a router would
receive four tokens of each other agent, and a token costs a hub twenty times as much as a sample. So they have none:

- A heartbeat is a plain sample on the key of ``/global/agent_heartbeat``. Its sequence number is that of the agent's
  newest description, 0 for none.
- A router queries a description from the agent's router, on a key below ``/global/<agent>``, when a heartbeat has
  another number than the description that it knows. The heartbeat follows the description.
- The query carries the heartbeat of the router's own agent. So a new agent, which all others query, knows them at once
  and not only when each of them sends its next heartbeat.
- Soon after each new connection a router sends its agent's last heartbeat again. At the connection itself the hub
  does not know all subscriptions yet, and after an outage other routers may connect a moment later.

There, a router has two latched publishers for each other agent, as for a topic with several sources.
"""

from __future__ import annotations

import struct
import time
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Any

from sfglab.bus.api import EndpointKind, user_data
from sfglab.bus.pubsub import Publisher, Subscription, topic_endpoint
from sfglab.bus.zenoh.layout import ATTACHMENT, GID_BYTES
from sfglab.bus.zenoh.session import direct
from sfglab.fleet.discovery.validation import is_valid_heartbeat
from sfglab.fleet.router.plan import ROUTER_KEY
from sfglab.fleet.status.heartbeat import (
    AGENT_HEARTBEAT,
    AGENT_METADATA,
    heartbeat_topic,
    metadata_service,
    metadata_topic,
)
from sfglab.messages import CdrError, deserialize
from sfglab.qos import LATCHED

if TYPE_CHECKING:
    from collections.abc import Callable

    from sfglab.bus import EndpointEvent, Node
    from sfglab.bus.api import RawEndpoint
    from sfglab.bus.zenoh.backend import ZenohBackend

_HEARTBEATS = replace(topic_endpoint(AGENT_HEARTBEAT, heartbeat_topic(), LATCHED), forwards=True)
_DESCRIPTIONS = replace(topic_endpoint(AGENT_METADATA, metadata_topic(), LATCHED), forwards=True)
#: DDS topics that are exchanged as described here.
TOPICS = (_HEARTBEATS.dds_topic, _DESCRIPTIONS.dds_topic)
MAX_SOURCES = 2000  #: Most routers whose heartbeats a router publishes in its agent's domain.
# Announced periods without a heartbeat after which an agent's messages are withdrawn.
_SILENT_PERIODS = 4
_QUERY_S = 2.0  # longest wait for a description
_REPEAT_S = 1.0  # time from a connection until the heartbeat is repeated


@dataclass(slots=True)
class _Source:
    """Another agent's router, with its publishers in the agent's domain."""

    heartbeats: Publisher
    descriptions: Publisher
    heartbeat: bytes = b""  # the newest one
    expires_s: float = 0.0
    described: int = 0  # number of the published description
    is_querying: bool = False

    def close(self) -> None:
        self.heartbeats.close()
        self.descriptions.close()


class Presence:
    """Exchange of one router.

    Args:
        local: Node in the agent's domain.
        remote: Backend of the node over Zenoh.
        agent: Name of the agent.
        tag: Name of the agent's domain among all hosts.
    """

    def __init__(self, local: Node, remote: ZenohBackend, agent: str, tag: str) -> None:
        self._local, self._remote = local.backend, remote
        self._session = remote.session
        self._user_data = user_data({ROUTER_KEY: tag})
        self._key = remote.key(_HEARTBEATS)
        self._own_key = self._description_key(agent)
        self._subscriptions = {
            key: Subscription(self._local, endpoint, partial(self._on_own, key), raw=True)
            for key, endpoint in ((self._key, _HEARTBEATS), (self._own_key, _DESCRIPTIONS))
        }
        self._own: dict[str, bytes] = {}  # newest messages of the agent, by key
        self._described = 0  # number of its descriptions
        self._sources: dict[bytes, _Source] = {}
        self._declared: list[Any] = []
        self._is_followed = False  # whether a node of the agent's domain subscribes to heartbeats
        self._timer = local.create_timer(1.0, self._expire)
        self._session.order(self._declare)

    def feed(self, event: EndpointEvent) -> bool:
        """Take note of an endpoint in the agent's domain; return whether it is one of the exchanged topics."""
        endpoint = event.endpoint
        if endpoint.dds_topic not in TOPICS:
            return False
        if endpoint.kind is EndpointKind.SUBSCRIPTION and not self._is_followed:
            self._is_followed = True
            self._session.order(self._follow)
        return True

    def close(self) -> None:
        """End the exchange."""
        self._timer.cancel()
        for subscription in self._subscriptions.values():
            subscription.close()
        for source in self._sources.values():
            source.close()
        self._sources.clear()
        self._is_followed = False  # samples that were received before are ignored
        self._session.order(self._undeclare)

    def _description_key(self, agent: str) -> str:
        endpoint = topic_endpoint(AGENT_METADATA, metadata_service(agent), LATCHED)
        return self._remote.key(endpoint)

    def _on_own(self, key: str, cdr: Any) -> None:
        """Take a message of the agent; its first description may come after the heartbeat that announces it."""
        self._own[key] = bytes(cdr)
        self._described += key != self._key
        if (key == self._key or self._described == 1) and self._session.is_open:
            self._session.order(self._announce)

    def _newest(self, key: str) -> bytes | None:
        """Return the agent's newest message; None if its publisher has gone."""
        return self._own.get(key) if self._subscriptions[key].get_publisher_count() else None

    def _attachment(self) -> bytes:
        return ATTACHMENT.pack(self._described, time.time_ns(), GID_BYTES, self._remote.guid)

    # In threads of Zenoh

    def _declare(self, session: Any) -> None:
        answer = direct(self._on_query)
        self._declared.append(session.declare_queryable(self._own_key, answer))
        connected = direct(lambda _: self._on_loop(self._on_connected))
        listener = session.info.declare_transport_events_listener(connected, history=True)
        self._declared.append(listener)

    def _undeclare(self, _: Any) -> None:
        while self._declared:
            self._declared.pop().undeclare()

    def _follow(self, session: Any) -> None:
        take = direct(partial(self._take, self._on_heartbeat))
        self._declared.append(session.declare_subscriber(self._key, take))

    def _announce(self, session: Any) -> None:
        if (cdr := self._newest(self._key)) is not None:
            session.put(self._key, cdr, attachment=self._attachment())

    def _on_query(self, query: Any) -> None:
        if query.payload is not None:
            self._take(self._on_heartbeat, query)
        self._session.order(partial(self._reply, query))

    def _reply(self, query: Any, _: Any) -> None:
        with query:
            if (cdr := self._newest(self._own_key)) is not None:
                query.reply(self._own_key, cdr, attachment=self._attachment())

    def _query(self, gid: bytes, agent: str, session: Any) -> None:
        """Query the description of the agent of a router with this GID."""
        from zenoh import CongestionControl, ConsolidationMode, QueryTarget

        def on_reply(reply: Any) -> None:
            if reply.ok is not None:
                self._take(partial(self._on_description, gid), reply.ok)

        session.get(
            self._description_key(agent),
            direct(on_reply, partial(self._on_loop, partial(self._on_query_end, gid))),
            payload=self._newest(self._key),
            attachment=self._attachment(),
            target=QueryTarget.ALL,
            consolidation=ConsolidationMode.NONE,
            congestion_control=CongestionControl.DROP,  # also of replies: a slow agent delays no other
            timeout=_QUERY_S,
        )

    def _take(self, then: Callable[..., None], sample: Any) -> None:
        """Let the loop call `then` with the GID, the number and the CDR of another router's sample."""
        try:
            number, _, _, gid = ATTACHMENT.unpack(sample.attachment.to_bytes())
        except (AttributeError, struct.error):
            return
        if gid != self._remote.guid:
            self._on_loop(partial(then, gid, number, sample.payload.to_bytes()))

    def _on_loop(self, function: Callable[[], None]) -> None:
        self._remote.bridge.post(function)
        self._remote.bridge.flush()

    # On the loop

    def _on_connected(self) -> None:
        loop = self._remote.bridge.loop
        loop.call_later(_REPEAT_S, self._session.order, self._announce)

    def _on_heartbeat(self, gid: bytes, number: int, cdr: bytes) -> None:
        try:
            message = deserialize(cdr, AGENT_HEARTBEAT)
        except CdrError:
            return
        source = self._sources.get(gid)
        is_full = source is None and len(self._sources) >= MAX_SOURCES
        if is_full or not self._is_followed or not is_valid_heartbeat(message):
            return
        if source is None:
            heartbeats, descriptions = map(self._publisher, (_HEARTBEATS, _DESCRIPTIONS))
            source = self._sources[gid] = _Source(heartbeats, descriptions)
        source.heartbeat = cdr
        source.expires_s = time.monotonic() + _SILENT_PERIODS * message.period_s
        if source.is_querying:
            return
        if number == source.described:
            source.heartbeats.publish_raw(cdr)
            return
        source.is_querying = True
        self._session.order(partial(self._query, gid, message.agent))

    def _on_description(self, asked: bytes, gid: bytes, number: int, cdr: bytes) -> None:
        """Publish a description, unless it is of another agent with the same name."""
        if gid == asked and (source := self._sources.get(gid)) is not None:
            source.described = number
            source.descriptions.publish_raw(cdr)

    def _on_query_end(self, gid: bytes) -> None:
        if (source := self._sources.get(gid)) is not None:
            source.is_querying = False
            source.heartbeats.publish_raw(source.heartbeat)

    def _publisher(self, endpoint: RawEndpoint) -> Publisher:
        return Publisher(self._local, replace(endpoint, user_data=self._user_data))

    def _expire(self) -> None:
        now_s = time.monotonic()
        for gid, source in list(self._sources.items()):
            if source.expires_s < now_s:
                source.close()
                del self._sources[gid]
