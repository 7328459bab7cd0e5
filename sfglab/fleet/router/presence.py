"""Presence of agents over Zenoh: a router's exchange of heartbeats and descriptions with other routers.

All agents publish and subscribe to these two topics (paper A, section 4.2). As topics like any other, each router
would receive four tokens of every other agent, and a token costs a hub twenty times as much as a sample. So here
nothing is announced:

- A heartbeat is a plain sample on the key of ``/global/agent_heartbeat``.
- After each new connection a router sends its agent's last heartbeat again and queries those of the others, because
  heartbeats are latched in the domains of agents.
- A description is queried from its agent's router, on a key below ``/global/<agent>``, when a heartbeat has another
  version than the known description. The heartbeat follows the description.

In its agent's domain a router has latched publishers for each other agent, as for topics of several sources.
"""

from __future__ import annotations

import logging
import struct
import time
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import count
from typing import TYPE_CHECKING, Any

from sfglab.bus.api import EndpointAdded, EndpointKind, user_data
from sfglab.bus.errors import BusError
from sfglab.bus.loop import nothing
from sfglab.bus.pubsub import Publisher, Subscription, topic_endpoint
from sfglab.bus.zenoh.endpoints import direct
from sfglab.bus.zenoh.layout import ATTACHMENT, GID_BYTES
from sfglab.fleet.discovery.config import Timing
from sfglab.fleet.discovery.validation import MAX_METADATA_BYTES, is_valid_heartbeat
from sfglab.fleet.policy import Direction, Policy
from sfglab.fleet.refusals import WarnOnce
from sfglab.fleet.router.plan import ROUTER_KEY
from sfglab.fleet.status.heartbeat import (
    AGENT_HEARTBEAT,
    AGENT_METADATA,
    heartbeat_topic,
    metadata_service,
    metadata_topic,
)
from sfglab.messages import CdrError, deserialize
from sfglab.names import dds_topic
from sfglab.qos import LATCHED

if TYPE_CHECKING:
    from collections.abc import Callable

    from sfglab.bus import EndpointEvent, Node
    from sfglab.bus.zenoh.backend import ZenohBackend

_log = logging.getLogger(__name__)
_HEARTBEATS, _DESCRIPTIONS = heartbeat_topic(), metadata_topic()
_TYPES = {_HEARTBEATS: AGENT_HEARTBEAT, _DESCRIPTIONS: AGENT_METADATA}
#: DDS topics that routers over Zenoh do not forward, but exchange as described here.
TOPICS = frozenset(map(dds_topic, _TYPES))
MAX_SOURCES = 2000  #: Most routers whose heartbeats a router publishes in its agent's domain.
_QUERY_S = 2.0  # longest wait for a description
_SETTLE_S = 0.1  # between a new connection and what is sent over it
_TIMING = Timing()

_Version = tuple[int, int]


@dataclass(slots=True)
class _Source:
    """Another agent's router, with its publishers in the agent's domain by topic."""

    agent: str
    heartbeat: bytes = b""
    version: _Version = (0, 0)  # version of the description that the heartbeat announces
    expires_s: float = 0.0
    described: _Version | None = None  # version of the published description
    is_querying: bool = False
    publishers: dict[str, Publisher] = field(default_factory=dict)


class Presence:
    """Exchange of one router.

    Args:
        local: Node in the agent's domain.
        remote: Backend of the node over Zenoh.
        agent: Name of the agent.
        policy: Forwarding rules, which have to let the topics cross.
        tag: Name of the agent's domain among all hosts.
    """

    def __init__(
        self, local: Node, remote: ZenohBackend, agent: str, *, policy: Policy, tag: str
    ) -> None:
        participant = remote.participant
        self._local, self._agent = local, agent
        self._session, self._bridge = participant.session, remote.bridge
        self._gid = participant.guid
        self._participant = participant
        self._key = self._key_of(_HEARTBEATS, AGENT_HEARTBEAT)
        self._user_data = user_data({ROUTER_KEY: tag})
        self._warn = WarnOnce(_log)
        self._numbers = count(1)
        self._is_joining = False
        # Own messages by topic, with their versions, and those that queries of other routers get, by key.
        self._own: dict[str, tuple[bytes, _Version]] = {}
        self._own_expires_s = 0.0
        self._replies: dict[str, bytes] = {}
        self._sources: dict[bytes, _Source] = {}
        self._wanted: set[str] = set()  # topics with subscriptions in the agent's domain
        self._declared: list[Any] = []
        self._ends: list[Callable[[], None]] = [local.create_timer(1.0, self._expire).cancel]
        names = dds_topic(_HEARTBEATS)
        if policy.crosses(names, Direction.OUTWARD):
            self._follow_own()
        if policy.crosses(names, Direction.INWARD):
            for topic in _TYPES:
                hear = partial(self._on_subscription, topic)
                end = local.graph.watch(dds_topic(topic), EndpointKind.SUBSCRIPTION, hear)
                self._ends.append(end)
        self._session.order(self._declare)

    def close(self) -> None:
        """End the exchange."""
        for end in self._ends:
            end()
        for source in self._sources.values():
            _close(source)
        self._session.order(self._undeclare)

    # The agent's own heartbeats and description

    def _follow_own(self) -> None:
        for topic, kind in _TYPES.items():
            endpoint = replace(topic_endpoint(kind, topic, LATCHED), forwards=True)
            take = partial(self._on_own, topic)
            subscription = Subscription(self._local.backend, endpoint, take, raw=True)
            self._ends.append(subscription.close)

    def _on_own(self, topic: str, cdr: Any) -> None:
        message = _read(bytes(cdr), topic)
        if message is None or message.agent != self._agent:
            sentence = (
                f"presence: a message on {topic} that is not of agent {self._agent} stays here"
            )
            self._warn(topic, sentence)
            return
        self._own[topic] = bytes(cdr), (message.incarnation, message.revision)
        if topic == _HEARTBEATS:
            self._own_expires_s = _expiry_s(message.period_s)
        is_described = self._offer()
        # A description that comes after its heartbeat was perhaps queried in vain.
        if topic == _HEARTBEATS or is_described:
            self._announce()

    def _offer(self) -> bool:
        """Update the replies to queries; return whether there is a description of the last heartbeat's version."""
        heartbeat, description = (self._own.get(topic) for topic in _TYPES)
        replies = {}
        if heartbeat is not None and time.monotonic() < self._own_expires_s:
            replies[self._key] = heartbeat[0]
            if description is not None and description[1] == heartbeat[1]:
                replies[self._description_key(self._agent)] = description[0]
        self._replies = replies
        return len(replies) > 1

    def _announce(self) -> None:
        """Send the last heartbeat; without a session none waits, because `_join` sends the last one."""
        if (cdr := self._replies.get(self._key)) is not None and self._session.is_open:
            self._session.order(partial(self._put, cdr))

    def _put(self, cdr: bytes, session: Any) -> None:
        from zenoh import CongestionControl, Locality

        options = {
            "congestion_control": CongestionControl.DROP,
            "allowed_destination": Locality.REMOTE,
        }
        session.put(self._key, cdr, attachment=self._attachment(), **options)

    def _on_query(self, key: str, query: Any) -> None:
        """Reply to a query, from a thread of Zenoh, which must not wait."""
        self._session.caller.order(partial(self._reply, key, query))

    def _reply(self, key: str, query: Any) -> None:
        with query:
            if (cdr := self._replies.get(key)) is not None:
                query.reply(key, cdr, attachment=self._attachment())

    def _attachment(self) -> bytes:
        return ATTACHMENT.pack(next(self._numbers), time.time_ns(), GID_BYTES, self._gid)

    def _description_key(self, agent: str) -> str:
        return self._key_of(metadata_service(agent), AGENT_METADATA)

    def _key_of(self, name: str, kind: str) -> str:
        return self._participant.key(topic_endpoint(kind, name, LATCHED))

    # Connections

    def _declare(self, session: Any) -> None:
        from zenoh import Locality

        for key in (self._key, self._description_key(self._agent)):
            answer = direct(partial(self._on_query, key))
            self._declared.append(
                session.declare_queryable(key, answer, allowed_origin=Locality.REMOTE)
            )
        listener = session.info.declare_transport_events_listener(
            direct(lambda _: self._on_loop(self._join_soon)), history=True
        )
        self._declared.append(listener)

    def _undeclare(self, _: Any) -> None:
        while self._declared:
            self._declared.pop().undeclare()

    def _join_soon(self) -> None:
        if not self._is_joining:
            self._is_joining = True
            self._local.backend.loop.call_later(_SETTLE_S, self._join)

    def _join(self) -> None:
        self._is_joining = False
        self._announce()
        if _HEARTBEATS in self._wanted:
            self._session.order(partial(self._query, self._key, self._take, nothing))

    def _on_loop(self, function: Callable[..., None], *arguments: Any) -> None:
        """Call a function on the loop, from a thread of Zenoh."""
        self._bridge.post(partial(function, *arguments))
        self._bridge.flush()

    # Other agents

    def _on_subscription(self, topic: str, event: EndpointEvent) -> None:
        """Begin to receive what a node of the agent's domain subscribes to; there is no end to it."""
        is_own = event.endpoint.participant == self._local.guid
        if is_own or not isinstance(event, EndpointAdded) or topic in self._wanted:
            return
        self._wanted.add(topic)
        if topic == _HEARTBEATS:
            self._session.order(self._subscribe)
            self._join_soon()
        else:
            for gid, source in self._sources.items():
                self._describe(gid, source)

    def _subscribe(self, session: Any) -> None:
        from zenoh import Locality

        subscriber = session.declare_subscriber(
            self._key, direct(self._take), allowed_origin=Locality.REMOTE
        )
        self._declared.append(subscriber)

    def _query(
        self, key: str, take: Callable[[Any], None], end: Callable[[], None], session: Any
    ) -> None:
        """Query all routers; `take` gets their samples, in a thread of Zenoh."""
        from zenoh import ConsolidationMode, Locality, QueryTarget

        def on_reply(reply: Any) -> None:
            if reply.ok is not None:
                take(reply.ok)

        session.get(
            key,
            direct(on_reply, end),
            target=QueryTarget.ALL,
            consolidation=ConsolidationMode.NONE,
            allowed_destination=Locality.REMOTE,
            timeout=_QUERY_S,
        )

    def _take(self, sample: Any) -> None:
        """Take a heartbeat in a thread of Zenoh."""
        if (gid := _gid(sample)) is not None:
            self._on_loop(self._on_heartbeat, gid, sample.payload.to_bytes())

    def _on_heartbeat(self, gid: bytes, cdr: bytes) -> None:
        message = _read(cdr, _HEARTBEATS)
        if message is None or not is_valid_heartbeat(message):
            self._warn(gid, f"presence: dropped malformed heartbeats of {gid.hex()}")
            return
        source = self._sources.get(gid)
        if source is None:
            if len(self._sources) >= MAX_SOURCES:
                sentence = f"presence: dropped heartbeats of more than {MAX_SOURCES} routers"
                self._warn("full", sentence)
                return
            source = self._sources[gid] = _Source(message.agent)
        source.agent, source.heartbeat = message.agent, cdr
        source.version = message.incarnation, message.revision
        source.expires_s = _expiry_s(message.period_s)
        if not self._describe(gid, source):
            self._publish(source, _HEARTBEATS, cdr)

    def _describe(self, gid: bytes, source: _Source) -> bool:
        """Query the description of a source if it is wanted and not known; return whether it is being queried."""
        version = source.version
        is_wanted = _DESCRIPTIONS in self._wanted and source.described != version
        if not is_wanted or source.is_querying:
            return source.is_querying
        source.is_querying = True

        def take(sample: Any) -> None:
            if _gid(sample) == gid:  # not that of another agent with the same name
                self._on_loop(self._on_description, gid, version, sample.payload.to_bytes())

        end = partial(self._on_loop, self._on_query_end, gid)
        self._session.order(partial(self._query, self._description_key(source.agent), take, end))
        return True

    def _on_description(self, gid: bytes, version: _Version, cdr: bytes) -> None:
        if (source := self._sources.get(gid)) is not None and len(cdr) <= MAX_METADATA_BYTES:
            source.described = version
            self._publish(source, _DESCRIPTIONS, cdr)

    def _on_query_end(self, gid: bytes) -> None:
        if (source := self._sources.get(gid)) is not None:
            source.is_querying = False
            self._publish(source, _HEARTBEATS, source.heartbeat)

    def _publish(self, source: _Source, topic: str, cdr: bytes) -> None:
        """Publish a message of another agent in the agent's domain."""
        if topic not in source.publishers:
            endpoint = topic_endpoint(_TYPES[topic], topic, LATCHED, user_data=self._user_data)
            source.publishers[topic] = Publisher(self._local.backend, endpoint)
        try:
            source.publishers[topic].publish_raw(cdr)
        except BusError as error:
            self._warn((source.agent, topic), f"presence: {error}")

    def _expire(self) -> None:
        """Withdraw the messages of agents that fell silent."""
        self._offer()
        now_s = time.monotonic()
        for gid, source in list(self._sources.items()):
            if source.expires_s < now_s:
                del self._sources[gid]
                _close(source)


def _close(source: _Source) -> None:
    for publisher in source.publishers.values():
        publisher.close()


def _expiry_s(period_s: float) -> float:
    """Return the time at which an agent counts as silent after a heartbeat, as in `Timing`, on the monotonic clock."""
    return time.monotonic() + _TIMING.missed * period_s + _TIMING.slack_ns / 1e9


def _gid(sample: Any) -> bytes | None:
    """Return the GID in a sample's attachment; None if it has none."""
    try:
        gid: bytes = ATTACHMENT.unpack(sample.attachment.to_bytes())[3]
    except (AttributeError, struct.error):
        return None
    return gid


def _read(cdr: bytes, topic: str) -> Any:
    """Return a message of a topic; None for other bytes."""
    try:
        return deserialize(cdr, _TYPES[topic])
    except CdrError:
        return None
