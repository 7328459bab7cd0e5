"""Fleet as values, read from its file: what agents publish, subscribe, serve and call, and their frames.

Refuses what is not a fleet at all: unknown keys, wrong types, names that ROS or the schema's agent segment
forbid, domains that DDS does not have. Whether the fleet makes sense is for `sfglab.fleet.lint`. Every part
remembers its place in the file, which does not count when parts are compared.
"""

from __future__ import annotations

from dataclasses import dataclass, field, fields, replace
from functools import partial
from pathlib import Path
from typing import Any, Literal

from sfglab.bus.address import BusAddress
from sfglab.documents import (
    NOWHERE,
    OR_NULL,
    Document,
    DocumentError,
    Place,
    Section,
    named,
    read_by,
    short_for,
    suggestion,
)
from sfglab.errors import SfglabError
from sfglab.fields import between, bounds
from sfglab.fleet.fleet_file.deployment import DeploymentSpec, HostSpec, read_deployment
from sfglab.fleet.policy import TABLE_1, Direction, ForwardRule, Policy
from sfglab.fleet.status.description import AgentDescription, SensorDescription, StreamDescription
from sfglab.names import SHARED_FRAMES, FqnError, ResourceKind, validate_agent, validate_ros_name
from sfglab.qos import (
    COMPRESSED_STREAM,
    DEFAULT,
    LATCHED,
    SENSOR_DATA,
    SERVICES,
    QoSProfile,
)
from sfglab.units import NS_PER_S

MAX_DOMAIN = 232
"""The last domain whose ports exist (RTPS 2.5, clause 9.6.2.3)."""

PROFILES = {
    "default": DEFAULT,
    "sensor_data": SENSOR_DATA,
    "compressed_stream": COMPRESSED_STREAM,
    "latched": LATCHED,
    "services": SERVICES,
}
_POSITIVE = bounds(without=(0,))


def _read_name(section: Section, key: str, kind: ResourceKind = ResourceKind.TOPIC) -> str:
    name = section.text(key)
    try:
        return validate_ros_name(name, kind)
    except FqnError as error:
        raise section.refusal(key, name, error.allowed) from error


def _read_optional_name(section: Section, key: str) -> str:
    return _read_name(section, key) if section.get(key) else ""


def _read_qos(section: Section, key: str) -> QoSProfile:
    if isinstance(section.get(key), str):
        return PROFILES[section.text(key, choices=tuple(PROFILES))]
    inner = section.section(key)
    profile = QoSProfile(
        reliability=inner.choice("reliability", DEFAULT.reliability),
        durability=inner.choice("durability", DEFAULT.durability),
        history=inner.choice("history", DEFAULT.history),
        depth=inner.whole("depth", DEFAULT.depth, low=1),
        deadline_ns=_nanoseconds(inner.positive("deadline_s", None)),
        lifespan_ns=_nanoseconds(inner.positive("lifespan_s", None)),
    )
    inner.close()
    return profile


def _nanoseconds(value_s: float | None) -> int | None:
    return None if value_s is None else max(1, round(value_s * NS_PER_S))


def _read_uses(section: Section, key: str, *, kind: ResourceKind) -> tuple[NameUse, ...]:
    return tuple(
        item.read(NameUse, name=_read_name(item, "name", kind)) for item in section.items(key, short="name")
    )


def _read_frames(section: Section, key: str) -> tuple[FrameSpec, ...]:
    return tuple(map(_read_frame, section.items(key)))


def _read_frame(section: Section) -> FrameSpec:
    frame = section.read(FrameSpec)
    if not frame.static:
        section.positive("rate_hz")  # is needed then
    return frame


_NAME, _OPTIONAL_NAME = read_by(_read_name), read_by(_read_optional_name)
_SERVICES = read_by(partial(_read_uses, kind=ResourceKind.SERVICE))
_ACTIONS = read_by(partial(_read_uses, kind=ResourceKind.ACTION))


class UnknownAgentError(SfglabError, LookupError):
    """The fleet has no agent of that name."""


@dataclass(frozen=True, slots=True, kw_only=True)
class TopicUse:
    """A topic that an agent's nodes publish or subscribe."""

    name: str = field(metadata=_NAME)  #: Absolute ROS name.
    type: str = ""  #: ROS type; empty where the file does not say.
    #: What its endpoints offer or request; None where the file does not say.
    qos: QoSProfile | None = field(default=None, metadata={**OR_NULL, **read_by(_read_qos)})
    #: Messages a second of all its publishers here; None where the file does not say.
    rate_hz: float | None = field(default=None, metadata=_POSITIVE)
    size_bytes: int | None = None  #: Mean serialized size; None where the file does not say.
    count: int = between(1, 1)  #: Endpoints of this agent.
    place: Place = field(default=NOWHERE, compare=False, repr=False)  #: Where it stands.


@dataclass(frozen=True, slots=True, kw_only=True)
class NameUse:
    """A service or an action that an agent serves or calls."""

    name: str  #: Absolute ROS name.
    type: str = ""  #: ROS type; empty where the file does not say.
    place: Place = field(default=NOWHERE, compare=False, repr=False)  #: Where it stands.


@dataclass(frozen=True, slots=True, kw_only=True)
class StreamSpec:
    """A sensor's compressed stream, as the agent's metadata announces it (sfglab_interfaces/msg/StreamInfo)."""

    topic: str = field(metadata=_NAME)  #: Global topic that carries it.
    type: str  #: ROS type of its messages.
    codec: Literal["h264", "rvl", "png", "jpeg"]  #: How they are coded.
    width: int = field(metadata=bounds(1))  #: Pixels.
    height: int = field(metadata=bounds(1))  #: Pixels.
    rate_hz: float = field(metadata=_POSITIVE)  #: Messages a second.
    size_bytes: int | None = between(
        None, 1
    )  #: Mean serialized size of a message; None: the file does not say.
    #: Where the decoded stream belongs; empty: derived from `topic`.
    decoded_topic: str = field(default="", metadata=_OPTIONAL_NAME)
    #: Where the calibration is published; empty: nowhere.
    camera_info_topic: str = field(default="", metadata=_OPTIONAL_NAME)
    place: Place = field(default=NOWHERE, compare=False, repr=False)  #: Where it stands.


@dataclass(frozen=True, slots=True, kw_only=True)
class SensorSpec:
    """A sensor and what it sends (sfglab_interfaces/msg/SensorInfo)."""

    name: str  #: Unique within its agent.
    model: str = ""  #: Maker and model, for people.
    streams: tuple[StreamSpec, ...] = ()  #: What leaves the agent.
    place: Place = field(default=NOWHERE, compare=False, repr=False)  #: Where it stands.


@dataclass(frozen=True, slots=True, kw_only=True)
class FrameSpec:
    """One transform that an agent broadcasts, with frame names as its nodes write them."""

    child: str  #: The frame that is placed.
    parent: str  #: The frame in which it is placed.
    static: bool = False  #: Sent once on /tf_static instead of again and again on /tf.
    rate_hz: float = between(0.0, without=(0,))  #: How often it is sent when it is not static.
    place: Place = field(default=NOWHERE, compare=False, repr=False)  #: Where it stands.


@dataclass(frozen=True, slots=True, kw_only=True)
class FrameTree:
    """The transforms of one agent."""

    #: One transform each.
    frames: tuple[FrameSpec, ...] = field(default=(), metadata=read_by(_read_frames))
    prefix_frames: bool = True  #: Frames leave the agent as ``<agent>/<frame>``, as paper A, section 4.1 asks.
    #: Frames that all agents mean by the same name and that are never prefixed.
    shared_frames: tuple[str, ...] = SHARED_FRAMES
    #: Frames of this agent, without prefix, that others may give a parent.
    placed_by_others: tuple[str, ...] = ()
    static_broadcasters: int = between(1, 1)  #: Nodes that publish on /tf_static.
    place: Place = field(default=NOWHERE, compare=False, repr=False)  #: Where it stands.


@dataclass(frozen=True, slots=True, kw_only=True)
class AgentSpec:
    """One agent: a computer, or several, behind one router."""

    name: str  #: The agent segment of its names.
    domain: int = field(metadata=bounds(0, MAX_DOMAIN))  #: Its own DDS domain, D_i in the paper.
    global_interface: str | None = None  #: Interface to the other agents; None leaves the choice to DDS.
    local_interface: str | None = None  #: Interface of its own domain; None leaves the choice to DDS.
    processes: int = between(1, 1)  #: ROS processes, each a DDS participant.
    lifecycle: bool = True  #: Whether it runs status provider and discoverer (paper A, section 4.2).
    sensors: tuple[SensorSpec, ...] = ()  #: What its metadata announces.
    tf: FrameTree = field(default_factory=FrameTree)  #: Its transforms.
    #: Topics, without those of `sensors`, `tf` and `lifecycle`.
    publishes: tuple[TopicUse, ...] = field(default=(), metadata=short_for("name"))
    subscribes: tuple[TopicUse, ...] = field(default=(), metadata=short_for("name"))  #: Topics.
    serves: tuple[NameUse, ...] = field(default=(), metadata=_SERVICES)  #: Services.
    calls: tuple[NameUse, ...] = field(default=(), metadata=_SERVICES)  #: Services.
    action_servers: tuple[NameUse, ...] = field(default=(), metadata=_ACTIONS)  #: Actions.
    action_clients: tuple[NameUse, ...] = field(default=(), metadata=_ACTIONS)  #: Actions.
    #: The machine it runs on; None where the file does not say, so that it cannot be deployed.
    host: HostSpec | None = None
    place: Place = field(default=NOWHERE, compare=False, repr=False)  #: Where it stands.

    @property
    def streams(self) -> tuple[StreamSpec, ...]:
        """The streams of all its sensors."""
        return tuple(stream for sensor in self.sensors for stream in sensor.streams)

    @property
    def description(self) -> AgentDescription:
        """What the file says of its sensors; accelerators and software are not in it."""
        return AgentDescription(sensors=tuple(map(_describe, self.sensors)))


@dataclass(frozen=True, slots=True, kw_only=True)
class Fleet:
    """Agents that share a global domain."""

    name: str = field(metadata=named("fleet"))  #: What the fleet is called.
    global_domain: int = 0  #: The domain that all routers join, D_0 in the paper.
    policy: Policy = field(default_factory=Policy)  #: What crosses.
    agents: tuple[AgentSpec, ...] = ()  #: The agents, in the order of the file.
    #: What is the same on all their machines.
    deployment: DeploymentSpec = field(default_factory=DeploymentSpec)
    #: Where each rule of the policy stands; empty where the file names a known one.
    rule_places: tuple[Place, ...] = field(default=(), compare=False, repr=False)
    place: Place = field(default=NOWHERE, compare=False, repr=False)  #: Where it stands.

    def agent(self, name: str) -> AgentSpec:
        """Return an agent by its name.

        Raises:
            UnknownAgentError: There is no such agent.
        """
        found = {agent.name: agent for agent in self.agents}.get(name)
        if found is None:
            names = tuple(agent.name for agent in self.agents)
            allowed = ", ".join(names) + suggestion(name, names)
            raise UnknownAgentError(f"fleet {self.name}: agent: given {name!r}, allowed: {allowed}")
        return found

    def local_address(self, name: str) -> BusAddress:
        """Return where on the bus an agent's own nodes stand."""
        agent = self.agent(name)
        return BusAddress(domain_id=agent.domain, interface=agent.local_interface)

    def global_address(self, name: str) -> BusAddress:
        """Return where on the bus an agent's router meets the others."""
        return BusAddress(domain_id=self.global_domain, interface=self.agent(name).global_interface)


def load_fleet(path: Path | str) -> Fleet:
    """Read a fleet from a file.

    Raises:
        DocumentError: The file cannot be read or is not a fleet; says where, what is given and allowed.
    """
    return _read(Document.of_file(Path(path), "a fleet file in UTF-8"))


def read_fleet(text: str, file: str = "fleet.yaml") -> Fleet:
    """Read a fleet from the text of a file.

    Args:
        text: YAML.
        file: The file's name, for messages.

    Raises:
        DocumentError: It is not a fleet; says where, what is given and what is allowed.
    """
    return _read(Document(text, file))


def _read(document: Document) -> Fleet:
    top = document.section()
    border = top.section("global")
    interface = border.text("interface", None)
    policy, places = _read_policy(top)
    fleet = top.read(
        Fleet,
        global_domain=border.whole("domain", 0, low=0, high=MAX_DOMAIN),
        policy=policy,
        agents=tuple(_read_agent(agent, section, interface) for agent, section in top.members("agents")),
        deployment=read_deployment(top.section("deployment"), top.text("fleet")),
        rule_places=places,
    )
    border.close()
    if not fleet.agents:
        raise top.refusal("agents", None, "at least one agent")
    return fleet


def _read_policy(top: Section) -> tuple[Policy, tuple[Place, ...]]:
    given = top.get("policy", "table-1")
    if isinstance(given, str):
        top.text("policy", "table-1", choices=("table-1",))
        return Policy(rules=TABLE_1), ()
    sections = tuple(top.items("policy", short="pattern"))
    rules = (section.read(ForwardRule) for section in sections)
    open_rules = tuple(replace(r, directions=r.directions or frozenset(Direction)) for r in rules)
    if not open_rules:
        raise top.refusal("policy", given, "'table-1' or at least one rule: nothing would ever cross")
    return Policy(rules=open_rules), tuple(section.here for section in sections)


def _read_agent(name: str, section: Section, interface: str | None) -> AgentSpec:
    try:
        validate_agent(name)
    except FqnError as error:
        raise DocumentError(section.here, name, error.allowed) from error
    return section.read(AgentSpec, name=name, global_interface=section.text("global_interface", interface))


def _describe(sensor: SensorSpec) -> SensorDescription:
    streams = tuple(
        StreamDescription(**{name: getattr(stream, name) for name in _DESCRIBED}) for stream in sensor.streams
    )
    return SensorDescription(name=sensor.name, model=sensor.model, streams=streams)


_DESCRIBED: tuple[Any, ...] = tuple(f.name for f in fields(StreamDescription))
