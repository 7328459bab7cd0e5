"""Uses of names in a fleet, implied ones included (paper A, 4.2), and the agents that they reach."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any

from sfglab.documents import NOWHERE, Place
from sfglab.fleet.discovery.listener import DISCOVERY_EVENT, discovery_topic
from sfglab.fleet.lint.report import Hearing
from sfglab.fleet.policy import Crossing, Direction
from sfglab.fleet.router.frames import TF_TYPE
from sfglab.fleet.status.heartbeat import (
    AGENT_HEARTBEAT,
    AGENT_METADATA,
    GET_METADATA,
    heartbeat_topic,
    metadata_service,
    metadata_topic,
)
from sfglab.names import TF, TF_STATIC, ResourceKind, dds_names
from sfglab.qos import COMPRESSED_STREAM, LATCHED, QoSProfile

if TYPE_CHECKING:
    from collections.abc import Iterator

    from sfglab.fleet.fleet_file import AgentSpec, Fleet

CAMERA_INFO = "sensor_msgs/msg/CameraInfo"


@dataclass(frozen=True, slots=True, kw_only=True)
class Use:
    """One agent's use of one topic, service or action: the agent offers it or consumes it."""

    agent: str  #: Name of the agent.
    name: str  #: ROS name.
    kind: ResourceKind  #: Topic, service or action.
    #: Whether the agent publishes or serves the name; otherwise the agent subscribes to it or calls it.
    speaks: bool
    type: str = ""  #: ROS type; empty if unknown.
    qos: QoSProfile | None = None  #: QoS of a topic's endpoints; None if unknown.
    count: int = 1  #: Number of endpoints, or of servers and clients.
    implied: bool = False  #: Whether the fleet file only implies the use.
    place: Place = NOWHERE  #: Place of the use in the fleet file.


@dataclass(slots=True)
class Meeting:
    """All uses of one name by the agents of a fleet."""

    kind: ResourceKind  #: Topic, service or action.
    name: str  #: ROS name.
    #: Part of the name's DDS topics that is forwarded from one agent to another.
    crossing: Crossing
    speakers: list[Use] = field(default_factory=list)  #: Uses that publish or serve.
    hearers: list[Use] = field(default_factory=list)  #: Uses that subscribe or call.

    @property
    def first(self) -> Use:
        """First of the uses; findings report its place."""
        return (self.speakers + self.hearers)[0]

    @property
    def senders(self) -> list[str]:
        """Agents that publish or serve the name."""
        return list(dict.fromkeys(use.agent for use in self.speakers))

    @property
    def implied(self) -> bool:
        """Whether the file only implies the name."""
        return all(use.implied for use in self.speakers + self.hearers)


class View:
    """Topics, services and actions of a fleet, with the agents that use them; the input of all checks."""

    def __init__(self, fleet: Fleet) -> None:
        self.fleet = fleet  #: The fleet.
        #: All uses, in the order of the file.
        self.uses = tuple(use for agent in fleet.agents for use in _uses_of(agent, fleet))

    @cached_property
    def meetings(self) -> tuple[Meeting, ...]:
        """Uses by kind and name, in the order of the file."""
        found: dict[tuple[ResourceKind, str], Meeting] = {}
        for use in self.uses:
            key = use.kind, use.name
            if key not in found:
                found[key] = Meeting(*key, self.crossing(use.name, use.kind))
            (found[key].speakers if use.speaks else found[key].hearers).append(use)
        return tuple(found.values())

    def crossing(self, name: str, kind: ResourceKind) -> Crossing:
        """Return how much of a name is forwarded from one agent to another, over the routers of both."""
        ways = {self.fleet.policy.crossing(name, kind, way) for way in Direction}
        # Only topics can cross in one direction alone, which does not lead to another agent.
        return ways.pop() if len(ways) == 1 else Crossing.NONE

    def hearings(self) -> tuple[Hearing, ...]:
        """Return senders and receivers of each name that is forwarded or that several agents use."""
        rows = []
        for meeting in sorted(
            self.meetings, key=lambda meeting: (meeting.name, meeting.kind.value)
        ):
            hearers = list(dict.fromkeys(use.agent for use in meeting.hearers))
            crosses = meeting.crossing is Crossing.WHOLE
            if crosses or len({*meeting.senders, *hearers}) > 1:
                row = Hearing(
                    name=meeting.name,
                    kind=meeting.kind,
                    speakers=tuple(meeting.senders),
                    hearers=tuple(hearers),
                    crosses=crosses,
                    rules=self._rules_of(meeting.name, meeting.kind),
                )
                rows.append(row)
        return tuple(rows)

    def _rules_of(self, name: str, kind: ResourceKind) -> tuple[str, ...]:
        topics = dds_names(name, kind)
        rules = self.fleet.policy.rules
        return tuple(rule.pattern for rule in rules if any(map(rule.matches, topics)))


def _uses_of(agent: AgentSpec, fleet: Fleet) -> Iterator[Use]:
    yield from _written(agent)
    for s in agent.streams:
        yield _use(agent, s.topic, s.type, speaks=True, place=s.place, qos=COMPRESSED_STREAM)
        if s.camera_info_topic:
            yield _use(agent, s.camera_info_topic, CAMERA_INFO, speaks=True, implied=True)
    yield from _transforms(agent)
    if agent.lifecycle:
        yield from _lifecycle(agent, fleet)


def _use(
    agent: AgentSpec, name: str, type_: str, kind: ResourceKind = ResourceKind.TOPIC, **more: Any
) -> Use:
    more.setdefault("place", agent.place)
    return Use(agent=agent.name, name=name, type=type_, kind=kind, **more)


def _written(agent: AgentSpec) -> Iterator[Use]:
    for speaks, topics in ((True, agent.publishes), (False, agent.subscribes)):
        for t in topics:
            more: dict[str, Any] = {"place": t.place, "qos": t.qos, "count": t.count}
            yield _use(agent, t.name, t.type, speaks=speaks, **more)
    names = (
        (ResourceKind.SERVICE, True, agent.serves),
        (ResourceKind.SERVICE, False, agent.calls),
        (ResourceKind.ACTION, True, agent.action_servers),
        (ResourceKind.ACTION, False, agent.action_clients),
    )
    for kind, speaks, uses in names:
        for use in uses:
            yield _use(agent, use.name, use.type, kind, speaks=speaks, place=use.place)


def _transforms(agent: AgentSpec) -> Iterator[Use]:
    more: dict[str, Any] = {"speaks": True, "implied": True, "place": agent.tf.place}
    static = [frame for frame in agent.tf.frames if frame.static]
    if len(static) < len(agent.tf.frames):
        yield _use(agent, TF, TF_TYPE, **more)
    if static:
        count = agent.tf.static_broadcasters
        yield _use(agent, TF_STATIC, TF_TYPE, qos=LATCHED, count=count, **more)


def _lifecycle(agent: AgentSpec, fleet: Fleet) -> Iterator[Use]:
    topics = {heartbeat_topic(): AGENT_HEARTBEAT}
    if fleet.descriptions == "published":
        topics[metadata_topic()] = AGENT_METADATA
    for speaks in (True, False):
        for name, type_ in topics.items():
            yield _use(agent, name, type_, speaks=speaks, qos=LATCHED, implied=True)
    yield _use(agent, discovery_topic(agent.name), DISCOVERY_EVENT, speaks=True, implied=True)
    for other in fleet.agents:
        if other.lifecycle:
            name, speaks = metadata_service(other.name), other is agent
            yield _use(agent, name, GET_METADATA, ResourceKind.SERVICE, speaks=speaks, implied=True)
