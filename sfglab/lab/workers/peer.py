"""Peer on a node of its own: ``python -m sfglab.lab.workers.peer CONFIG``.

A peer publishes numbered messages and counts those of others. It reports messages and endpoints as they
arrive, serves and calls metadata services, and simulates agents that do not run. Reports are JSON lines.
The report ``ready`` has the time of its subscriptions as ``t_ns``, ns since the epoch.

Orders, each ``{"do": ...}`` with the name of a method of `_Peer` and its arguments:

- ``talk``, ``hush``: begins or ends to publish. Report ``hushed`` with the number ``sent``.
- ``tell``: reports ``told``, with the number of messages ``heard`` from each source and all ``endpoints`` ever seen.
- ``call``: calls services. Report ``called`` with ``answers`` in the order of the names.
- ``look``: reports ``publishers`` of the topics whose messages it reports.
- ``beat``, ``mode``: a simulated agent sends a heartbeat, or changes its way to answer.

Reports without an order are ``heard`` (a message of a topic in `PeerConfig.reports`, as CDR in base64) and
``asked`` (a call of the metadata service of a simulated agent).
"""

from __future__ import annotations

import asyncio
import base64
import contextlib
import time
from collections import Counter
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from sfglab.bus import Node, Publisher, Subscription
from sfglab.bus.address import BusAddress
from sfglab.bus.api import EndpointAdded
from sfglab.component import Orders, Report, Reporter, run_component
from sfglab.errors import SfglabError
from sfglab.fleet.status.description import AgentDescription
from sfglab.fleet.status.heartbeat import (
    AGENT_HEARTBEAT,
    GET_METADATA,
    Heartbeat,
    Phase,
    heartbeat_topic,
    metadata_service,
)
from sfglab.messages import default_message, message_type, service_type
from sfglab.qos import LATCHED, Durability, QoSProfile

if TYPE_CHECKING:
    from collections.abc import Sequence

    from sfglab.bus.api import EndpointEvent

TRANSFORMS = "tf2_msgs/msg/TFMessage"
QUIET_S = 0.3  #: Time without a message after which none is expected any longer, s.
VOLATILE = QoSProfile(depth=200)
LATE = QoSProfile(depth=100, durability=LATCHED.durability)
"""QoS of a subscriber to the last messages of many publishers, as in tf2's listeners."""
ALL = QoSProfile(durability=Durability.TRANSIENT_LOCAL, depth=1000)
"""QoS of subscriptions whose messages are reported."""


@dataclass(frozen=True, slots=True, kw_only=True)
class TopicUse:
    """A topic with numbered messages, to which the peer subscribes."""

    name: str  #: ROS name.
    type: str  #: ROS type: ``std_msgs/msg/String`` or `TRANSFORMS`.
    latched: bool  #: Whether it is published once, transient local.
    publish: bool  #: Whether the peer also publishes.


@dataclass(frozen=True, slots=True, kw_only=True)
class PeerConfig:
    """Configuration of a peer: its node, its domain and the topics that it reports."""

    name: str  #: Name of its node, and of the source in its messages.
    address: BusAddress  #: Address on the bus.
    topics: tuple[TopicUse, ...] = ()  #: Topics with numbered messages.
    rate_hz: float = 10.0  #: Messages per second on each topic that is not latched.
    #: Whether a router adds the prefix of its transforms; otherwise the peer writes it.
    behind_router: bool = False
    serves: tuple[str, ...] = ()  #: Metadata services that answer with its name.
    reports: dict[str, str] = field(default_factory=dict)  #: Types of topics that it reports.
    late_s: float = 0.0  #: Time of an answer in mode ``late``, s.


@dataclass(slots=True)
class _Agent:
    """A simulated agent."""

    publisher: Publisher  #: Publisher of its heartbeats.
    mode: str = "answer"  #: Mode of its service: ``answer``, ``refuse``, ``late`` or ``mute``.
    incarnation: int = 0
    revision: int = 0
    #: Event that is set when the mode changes.
    changed: asyncio.Event = field(default_factory=asyncio.Event)


class _Peer:
    """A peer on its node."""

    def __init__(self, node: Node, config: PeerConfig, report: Reporter) -> None:
        self._node = node
        self._config = config
        self._report = report
        self._tasks = asyncio.TaskGroup()
        self._endpoints: dict[str, tuple[str, str, str, str]] = {}
        self._heard: Counter[tuple[str, str]] = Counter()  # messages by topic and source
        self._last_s = 0.0
        self._sent = 0
        self._talking: asyncio.Task[None] | None = None
        self._publishers: dict[TopicUse, Publisher] = {}
        self._agents: dict[str, _Agent] = {}

    async def serve(self, orders: Orders) -> None:
        """Open all endpoints, report ``ready``, and follow orders until cancelled."""
        async with self._tasks:
            t_ns = self._node.get_clock().now_ns()
            self._open()
            self._report({"is": "ready", "t_ns": t_ns})
            while True:
                order = await orders.get()
                await getattr(self, order.pop("do"))(**order)

    def _open(self) -> None:
        self._node.graph.listen(self._note)
        for name, type_ in self._config.reports.items():
            subscription = self._node.create_subscription(type_, name, qos=ALL, raw=True)
            self._tasks.create_task(self._forward(subscription))
        for topic in self._config.topics:
            qos = LATCHED if topic.latched else VOLATILE
            if topic.publish:
                publisher = self._node.create_publisher(topic.type, topic.name, qos)
                self._publishers[topic] = publisher
            qos = LATE if topic.latched else VOLATILE
            subscription = self._node.create_subscription(topic.type, topic.name, qos=qos)
            self._tasks.create_task(self._count(subscription, topic.name))
        for name in self._config.serves:
            self._node.create_service(GET_METADATA, name, self._answer)
        self._publish(latched=True)

    # Endpoints, and messages that are reported.

    def _note(self, event: EndpointEvent) -> None:
        if isinstance(event, EndpointAdded):
            end = event.endpoint
            owner, tag = end.participant.hex(), end.user_data.decode(errors="replace")
            self._endpoints[end.gid.hex()] = (end.dds_topic, end.kind.value, owner, tag)

    async def look(self) -> None:
        """Report the publishers of the topics whose messages it reports."""
        found = []
        for topic in self._config.reports:
            for publisher in self._node.graph.publishers(topic):
                row = {
                    "topic": topic,
                    "type": publisher.type,
                    "reliability": publisher.qos.reliability.value,
                    "durability": publisher.qos.durability.value,
                }
                found.append(row)
        self._report({"is": "publishers", "publishers": found})

    async def _forward(self, subscription: Subscription) -> None:
        while True:
            cdr, info = await subscription.take_with_info()
            report = {
                "is": "heard",
                "topic": subscription.topic_name,
                "cdr": base64.b64encode(cdr).decode(),
                "sent_ns": info.source_timestamp_ns,
                "received_ns": info.received_timestamp_ns,
            }
            self._report(report)

    # Numbered messages.

    async def talk(self) -> None:
        """Begin to publish."""
        self._talking = self._tasks.create_task(self._publish_all())

    async def hush(self) -> None:
        """End publishing, and report the number of messages when no message has arrived for a while."""
        assert self._talking is not None, "it talks"
        self._talking.cancel()
        while (left_s := self._last_s + QUIET_S - time.monotonic()) > 0:  # noqa: ASYNC110 - there is no event for silence
            await asyncio.sleep(left_s)
        self._report({"is": "hushed", "sent": self._sent})

    async def _publish_all(self) -> None:
        while True:
            self._sent += 1
            self._publish(latched=False)
            await asyncio.sleep(1 / self._config.rate_hz)

    def _publish(self, *, latched: bool) -> None:
        for topic, publisher in self._publishers.items():
            if topic.latched is latched:
                publisher.publish(self._message(topic.type))

    def _message(self, type_: str) -> Any:
        name = self._config.name
        if type_ != TRANSFORMS:
            return message_type(type_)(data=f"{name} {self._sent}")
        stamped = default_message("geometry_msgs/msg/TransformStamped")
        stamped.header.frame_id = "map"
        stamped.child_frame_id = "probe" if self._config.behind_router else f"{name}/probe"
        stamped.transform.rotation.w = 1.0
        return message_type(TRANSFORMS)(transforms=[stamped])

    async def _count(self, subscription: Subscription, name: str) -> None:
        while True:
            message = await subscription.take()
            self._last_s = time.monotonic()
            self._heard[name, self._source_of(message)] += 1

    def _source_of(self, message: Any) -> str:
        """Return the name of the peer that published a message."""
        if not hasattr(message, "transforms"):
            source: str = message.data.split()[0]
            return source
        owner, slash, _ = message.transforms[0].child_frame_id.partition("/")
        return owner if slash else self._config.name

    async def tell(self) -> None:
        """Report the messages of each source, and all endpoints ever seen."""
        heard = []
        for (name, source), received in sorted(self._heard.items()):
            heard.append({"name": name, "source": source, "received": received})
        endpoints: Sequence[tuple[str, ...]] = sorted(self._endpoints.values())
        participant = self._node.guid.hex()
        told = {"heard": heard, "endpoints": endpoints, "participant": participant}
        self._report({"is": "told", **told})

    # Metadata services.

    def _answer(self, _request: Any) -> Any:
        metadata = default_message("sfglab_interfaces/msg/AgentMetadata")
        response = service_type(GET_METADATA).response
        return response(success=True, message=self._config.name, metadata=metadata)

    async def call(self, names: Sequence[str], timeout_s: float) -> None:
        """Call metadata services at the same time, and report their answers in the order of the names."""
        answers = await asyncio.gather(*(self._call(name, timeout_s) for name in names))
        self._report({"is": "called", "answers": answers})

    async def _call(self, name: str, timeout_s: float) -> Report:
        """Call a metadata service; return whether it answered, its text, incarnation and time, s."""
        client = self._node.create_client(GET_METADATA, name)
        start_s = time.monotonic()
        answer = {"answered": False, "message": "", "incarnation": 0}
        with contextlib.suppress(SfglabError):
            await client.wait_for_service(timeout_s=timeout_s)
            request = service_type(GET_METADATA).request()
            response = await client.call(request, timeout_s=max(timeout_s, 5.0))
            answer["answered"] = bool(response.success)
            answer["message"] = str(response.message)
            answer["incarnation"] = int(response.metadata.incarnation)
        client.close()
        return {**answer, "took_s": time.monotonic() - start_s}

    # Simulated agents.

    def _agent(self, name: str) -> _Agent:
        """Return a simulated agent; a new one is made on first use."""
        if name not in self._agents:
            publisher = self._node.create_publisher(AGENT_HEARTBEAT, heartbeat_topic(), LATCHED)
            agent = _Agent(publisher)

            async def answer(_request: Any) -> Any:
                return await self._answer_for(name, agent)

            self._node.create_service(GET_METADATA, metadata_service(name), answer)
            self._agents[name] = agent
        return self._agents[name]

    async def mode(self, agent: str, mode: str) -> None:
        """Change the way in which a simulated agent answers."""
        changed = self._agent(agent)
        changed.mode = mode
        changed.changed.set()
        changed.changed = asyncio.Event()

    async def beat(self, agent: str, incarnation: int, revision: int, period_s: float) -> None:
        """Send a heartbeat of a simulated agent."""
        beating = self._agent(agent)
        beating.incarnation = incarnation
        beating.revision = revision
        heartbeat = Heartbeat(
            agent=agent,
            incarnation=incarnation,
            revision=revision,
            phase=Phase.STARTUP,
            period_s=period_s,
            version="made up",
        )
        beating.publisher.publish(heartbeat.to_message(self._node.get_clock().now_ns()))

    async def _answer_for(self, name: str, agent: _Agent) -> Any:
        clock = self._node.get_clock()
        self._report({"is": "asked", "agent": name, "t_ns": clock.now_ns()})
        if agent.mode == "late":
            await asyncio.sleep(self._config.late_s)
        while agent.mode == "mute":
            await agent.changed.wait()
        metadata = AgentDescription(software=("made up",)).to_message(
            name,
            incarnation=agent.incarnation,
            revision=agent.revision,
            stamp_ns=clock.now_ns(),
        )
        is_refused = agent.mode == "refuse"
        message = "refused as ordered" if is_refused else ""
        response = service_type(GET_METADATA).response
        return response(success=not is_refused, message=message, metadata=metadata)


async def serve(config: PeerConfig, report: Reporter, orders: Orders) -> None:
    """Run a node with the configured name and follow orders until cancelled."""
    async with Node(config.name, **config.address.options()) as node:
        await _Peer(node, config, report).serve(orders)


def main() -> None:
    """Run the process; `sfglab.lab.workers.idle` calls this function as well."""
    run_component(PeerConfig, serve)


if __name__ == "__main__":
    main()
