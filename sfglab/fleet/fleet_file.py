"""Fleet as values, read from its file: names that agents use, their frames, and the machines they run on.

Refuses what is not a fleet at all: unknown keys, wrong types, forbidden names and domains, impossible machines.
Whether it makes sense is for `sfglab.fleet.lint`; what runs on the machines (paper A, 4.4) for `sfglab.deploy`.
"""

from __future__ import annotations

import re
from dataclasses import asdict, dataclass, field, replace
from enum import Enum
from functools import partial
from pathlib import Path
from typing import Any, Literal

from sfglab.documents import (
    NOWHERE,
    OR_NULL,
    Document,
    DocumentError,
    Place,
    Section,
    by_name,
    matching,
    named,
    read_by,
    short_for,
    suggestion,
)
from sfglab.domains import MAX_DOMAIN
from sfglab.errors import InvalidValueError
from sfglab.fields import between, bounds
from sfglab.fleet.policy import TABLE_1, Direction, ForwardRule, Policy
from sfglab.fleet.status.description import AgentDescription, SensorDescription, StreamDescription
from sfglab.names import SHARED_FRAMES, FqnError, ResourceKind, validate_agent, validate_ros_name
from sfglab.qos import (
    COMPRESSED_STREAM,
    DEFAULT,
    LATCHED,
    SENSOR_DATA,
    SERVICES,
    Durability,
    History,
    Liveliness,
    QoSProfile,
    Reliability,
)
from sfglab.schema import ELSEWHERE
from sfglab.tables import html_table
from sfglab.units import NS_PER_S

PROFILES = {
    "default": DEFAULT,
    "sensor_data": SENSOR_DATA,
    "compressed_stream": COMPRESSED_STREAM,
    "latched": LATCHED,
    "services": SERVICES,
}
_POSITIVE = bounds(without=(0,))


AUTO = "auto"  #: In place of an accelerator's name: found out on the machine.
_COMPONENT = r"[a-z0-9]+(?:(?:\.|_{1,2}|-+)[a-z0-9]+)*"
_REGISTRY = r"[a-zA-Z0-9](?:[a-zA-Z0-9.-]*[a-zA-Z0-9])?(?::[0-9]{1,5})?"
REPOSITORY = re.compile(rf"(?:{_REGISTRY}/)?{_COMPONENT}(?:/{_COMPONENT})*")
"""A repository of images (OCI Distribution Specification 1.1, "Pulling manifests")."""
IMAGE = re.compile(
    rf"{REPOSITORY.pattern}(?::[\w][\w.-]{{0,127}})?(?:@sha256:[0-9a-f]{{64}})?", re.ASCII
)
ADDRESS = re.compile(r"(?:[a-z_][a-z0-9_-]*@)?[A-Za-z0-9](?:[A-Za-z0-9.-]*[A-Za-z0-9])?")
HOST = re.compile(r"[A-Za-z0-9](?:[A-Za-z0-9.:-]*[A-Za-z0-9])?")
DEVICE = re.compile(r"/dev/(?!(?:.*/)?\.\.(?:/|$))[A-Za-z0-9][A-Za-z0-9._/-]*")
PACKAGE = re.compile(r"[a-z0-9][a-z0-9+.-]+")  # Debian Policy 5.6.7
FOLDER = re.compile(r"[\w][\w./ -]*", re.ASCII)


def _read_name(section: Section, key: str, kind: ResourceKind = ResourceKind.TOPIC) -> str:
    name = section.text(key)
    try:
        return validate_ros_name(name, kind)
    except FqnError as error:
        raise section.refusal(key, name, error.allowed) from error


def _read_optional_name(section: Section, key: str) -> str:
    return _read_name(section, key) if section.get(key) else ""


@dataclass(frozen=True, slots=True, kw_only=True)
class _QoS:
    """QoS of an endpoint; what is left out is ROS 2's default."""

    reliability: Reliability = DEFAULT.reliability  #: Whether what is lost is sent again.
    #: Whether who joins later gets what was sent before.
    durability: Durability = DEFAULT.durability
    history: History = DEFAULT.history  #: Whether all messages are kept, or the last `depth`.
    depth: int = between(DEFAULT.depth, 1)  #: Messages that are kept.
    #: Longest time between two messages.
    deadline_s: float | None = field(default=None, metadata=_POSITIVE)
    #: After it a message is of no use.
    lifespan_s: float | None = field(default=None, metadata=_POSITIVE)
    liveliness: Liveliness = DEFAULT.liveliness  #: Who says that a publisher lives.
    #: Longest silence of who lives.
    lease_s: float | None = field(default=None, metadata=_POSITIVE)


def _read_qos(section: Section, key: str) -> QoSProfile:
    if isinstance(section.get(key), str):
        return PROFILES[section.text(key, choices=tuple(PROFILES))]
    given = asdict(section.section(key).read(_QoS))
    given |= {
        f"{k[:-2]}_ns": _nanoseconds(given.pop(k)) for k in ("deadline_s", "lifespan_s", "lease_s")
    }
    return QoSProfile(**given)


def _nanoseconds(value_s: float | None) -> int | None:
    return None if value_s is None else max(1, round(value_s * NS_PER_S))


def _read_uses(section: Section, key: str, *, kind: ResourceKind) -> tuple[NameUse, ...]:
    items = section.items(key, short="name")
    return tuple(item.read(NameUse, name=_read_name(item, "name", kind)) for item in items)


def _read_frames(section: Section, key: str) -> tuple[FrameSpec, ...]:
    return tuple(map(_read_frame, section.items(key)))


def _read_frame(section: Section) -> FrameSpec:
    frame = section.read(FrameSpec)
    if not frame.static:
        section.positive("rate_hz")  # is needed then
    return frame


def _read_accelerator(section: Section, key: str) -> Accelerator | None:
    name = section.text(key, choices=(AUTO, *(member.value for member in Accelerator)))
    return None if name == AUTO else Accelerator(name)


def _read_folder(section: Section, key: str) -> str:
    folder: str = section.text(key)
    if not FOLDER.fullmatch(folder):
        raise section.refusal(key, folder, "a folder beside the fleet file")
    if ".." in folder.split("/"):
        raise section.refusal(key, folder, "a folder beside the fleet file, not above it")
    return folder


_NAME, _OPTIONAL_NAME = read_by(_read_name), read_by(_read_optional_name, like=str | None)
_SERVICES = read_by(partial(_read_uses, kind=ResourceKind.SERVICE)) | short_for("name")
_ACTIONS = read_by(partial(_read_uses, kind=ResourceKind.ACTION)) | short_for("name")


@dataclass(frozen=True, slots=True, kw_only=True)
class _Part:
    """A part of the file, which remembers its place; that does not count when parts are compared."""

    place: Place = field(default=NOWHERE, compare=False, repr=False)  #: Where it stands.


class Architecture(Enum):
    """A processor architecture, by its name in container images."""

    AMD64 = "amd64"
    ARM64 = "arm64"


class Accelerator(Enum):
    """What a machine has beside its processor that can encode, decode or compute."""

    JETSON = "jetson"
    CUDA = "cuda"
    ROCM = "rocm"
    VAAPI = "vaapi"
    V4L2 = "v4l2"
    NONE = "none"


class RosDistribution(Enum):
    """The ROS 2 distribution inside the images, for the user's own nodes: sfglab needs none."""

    NONE = "none"
    HUMBLE = "humble"
    JAZZY = "jazzy"


class RouterSoftware(Enum):
    """What runs in an agent's second container."""

    SFGLAB = "sfglab"
    DDS_ROUTER = "dds-router"


class ContainerNetwork(Enum):
    """Which network the agent's container sees."""

    BRIDGE = "bridge"
    HOST = "host"


@dataclass(frozen=True, slots=True, kw_only=True)
class HostSpec(_Part):
    """The machine that an agent runs on."""

    model: str = ""  #: Maker and model, for people.
    #: Where SSH reaches it, ``[user@]host``; empty: it is this machine.
    address: str = field(default="", metadata=matching(ADDRESS, "[user@]host, as ssh takes it"))
    architecture: Architecture = Architecture.AMD64  #: Its processor's.
    #: What it has; None leaves it to detection.
    accelerator: Accelerator | None = field(
        default=None, metadata=read_by(_read_accelerator, like=Literal[AUTO] | Accelerator)
    )
    #: What the agent's container sees: a bridge of its own, or, for robots whose own controllers speak DDS over
    #: a cable, the host's interfaces.
    network: ContainerNetwork = ContainerNetwork.BRIDGE
    #: Device nodes that the agent needs beside its accelerator's, as in ``/dev/video0``.
    devices: tuple[str, ...] = field(
        default=(), metadata=matching(DEVICE, "device nodes, as in /dev/video0")
    )
    #: Folder of the user's colcon workspace, relative to the fleet file; empty: none.
    workspace: str = field(default="", metadata=read_by(_read_folder))
    #: Debian packages that the agent's own software needs.
    packages: tuple[str, ...] = field(
        default=(), metadata=matching(PACKAGE, "names of Debian packages")
    )
    #: Program and arguments of the user's software, beside the agent; empty: none.
    launch: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class DeploymentSpec(_Part):
    """What is the same for all machines of a fleet."""

    #: Where its images belong, a repository prefix as in ``localhost/esslingen``.
    images: str = field(
        default="localhost/fleet",
        metadata=matching(REPOSITORY, "a repository of images, as in localhost/esslingen"),
    )
    ros: RosDistribution = RosDistribution.NONE  #: The ROS 2 distribution inside the images.
    router: RouterSoftware = RouterSoftware.SFGLAB  #: What runs in the second container.
    #: Image of another's router; empty for our own.
    router_image: str = field(
        default="", metadata=matching(IMAGE, "an image, as in ubuntu-ddsrouter:v3.5.0")
    )
    #: Agents or hosts whose clocks count.
    time_servers: tuple[str, ...] = field(
        default=(), metadata=matching(HOST, "agents' or hosts' names or addresses")
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class TopicUse(_Part):
    """A topic that an agent's nodes publish or subscribe."""

    name: str = field(metadata=_NAME)  #: Absolute ROS name.
    type: str = ""  #: ROS type; empty where the file does not say.
    #: What its endpoints offer or request; None where the file does not say.
    qos: QoSProfile | None = field(
        default=None,
        metadata={**OR_NULL, **read_by(_read_qos, like=Literal[tuple(PROFILES)] | _QoS | None)},
    )
    #: Messages a second of all its publishers here; None where the file does not say.
    rate_hz: float | None = field(default=None, metadata=_POSITIVE)
    size_bytes: int | None = None  #: Mean serialized size; None where the file does not say.
    count: int = between(1, 1)  #: Endpoints of this agent.


@dataclass(frozen=True, slots=True, kw_only=True)
class NameUse(_Part):
    """A service or an action that an agent serves or calls."""

    name: str  #: Absolute ROS name.
    type: str = ""  #: ROS type; empty where the file does not say.


@dataclass(frozen=True, slots=True, kw_only=True)
class StreamSpec(_Part):
    """A sensor's compressed stream, as the agent's metadata announces it (sfglab_interfaces/msg/StreamInfo)."""

    topic: str = field(metadata=_NAME)  #: Global topic that carries it.
    type: str  #: ROS type of its messages.
    codec: Literal["h264", "rvl", "png", "jpeg"]  #: How they are coded.
    width: int = field(metadata=bounds(1))  #: Pixels.
    height: int = field(metadata=bounds(1))  #: Pixels.
    rate_hz: float = field(metadata=_POSITIVE)  #: Messages a second.
    #: Mean serialized size of a message; None: the file does not say.
    size_bytes: int | None = between(None, 1)
    #: Where the decoded stream belongs; empty: derived from `topic`.
    decoded_topic: str = field(default="", metadata=_OPTIONAL_NAME)
    #: Where the calibration is published; empty: nowhere.
    camera_info_topic: str = field(default="", metadata=_OPTIONAL_NAME)


@dataclass(frozen=True, slots=True, kw_only=True)
class SensorSpec(_Part):
    """A sensor and what it sends (sfglab_interfaces/msg/SensorInfo)."""

    name: str  #: Unique within its agent.
    model: str = ""  #: Maker and model, for people.
    streams: tuple[StreamSpec, ...] = ()  #: What leaves the agent.


@dataclass(frozen=True, slots=True, kw_only=True)
class FrameSpec(_Part):
    """One transform that an agent broadcasts, with frame names as its nodes write them."""

    child: str  #: The frame that is placed.
    parent: str  #: The frame in which it is placed.
    static: bool = False  #: Sent once on /tf_static instead of again and again on /tf.
    #: How often it is sent; needed when it is not static.
    rate_hz: float = between(0.0, without=(0,))


@dataclass(frozen=True, slots=True, kw_only=True)
class FrameTree(_Part):
    """The transforms of one agent."""

    #: One transform each.
    frames: tuple[FrameSpec, ...] = field(default=(), metadata=read_by(_read_frames))
    #: Frames leave the agent as ``<agent>/<frame>``, as paper A, section 4.1 asks.
    prefix_frames: bool = True
    #: Frames that all agents mean by the same name and that are never prefixed.
    shared_frames: tuple[str, ...] = SHARED_FRAMES
    #: Frames of this agent, without prefix, that others may give a parent.
    placed_by_others: tuple[str, ...] = ()
    static_broadcasters: int = between(1, 1)  #: Nodes that publish on /tf_static.


@dataclass(frozen=True, slots=True, kw_only=True)
class AgentSpec(_Part):
    """One agent: a computer, or several, behind one router."""

    name: str  #: The agent segment of its names.
    domain: int = field(metadata=bounds(0, MAX_DOMAIN))  #: Its own DDS domain, D_i in the paper.
    #: Interface to the other agents; None leaves the choice to DDS.
    global_interface: str | None = None
    #: Interface of its own domain; None leaves the choice to DDS.
    local_interface: str | None = None
    processes: int = between(1, 1)  #: ROS processes, each a DDS participant.
    #: Whether it runs status provider and discoverer (paper A, section 4.2).
    lifecycle: bool = True
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

    @property
    def streams(self) -> tuple[StreamSpec, ...]:
        """The streams of all its sensors."""
        return tuple(stream for sensor in self.sensors for stream in sensor.streams)

    @property
    def description(self) -> AgentDescription:
        """What the file says of its sensors; accelerators and software are not in it."""
        return AgentDescription(sensors=tuple(map(_describe, self.sensors)))


@dataclass(frozen=True, slots=True, kw_only=True)
class _GlobalDomain:
    """The global domain, which all routers join."""

    domain: int = between(0, 0, MAX_DOMAIN)  #: Its number, D_0 in the paper.
    #: Interface to it of agents that name none; None leaves the choice to DDS.
    interface: str | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class FleetKeys:
    """Keys of a fleet file that `Fleet` holds in another form."""

    #: The domain that all routers join.
    border: _GlobalDomain = field(default_factory=_GlobalDomain, metadata=named("global"))
    #: What crosses: Table 1 of paper A, or rules of one's own.
    policy: Literal["table-1"] | tuple[ForwardRule, ...] = field(
        default="table-1", metadata=short_for("pattern")
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class Fleet(_Part):
    """Agents that share a global domain."""

    name: str = field(metadata=named("fleet"))  #: What the fleet is called.
    #: The domain that all routers join, D_0 in the paper.
    global_domain: int = field(default=0, metadata=ELSEWHERE)
    policy: Policy = field(default_factory=Policy, metadata=ELSEWHERE)  #: What crosses.
    #: Whether ROS 2's tools list on each agent what could be had from the others, before anybody subscribes.
    offers: bool = True
    #: How agents learn what the others are: each is asked, as in the paper, or offers it on one topic of all.
    descriptions: Literal["asked", "offered"] = "asked"
    #: In the order of the file; at least one.
    agents: tuple[AgentSpec, ...] = field(metadata=by_name("name"))
    #: What is the same on all their machines.
    deployment: DeploymentSpec = field(default_factory=DeploymentSpec)
    #: Where each rule of the policy stands; empty where the file names a known one.
    rule_places: tuple[Place, ...] = field(default=(), compare=False, repr=False)

    def __repr__(self) -> str:
        return f"<fleet {self.name}: {len(self.agents)} agents around domain {self.global_domain}>"

    def _repr_html_(self) -> str:
        head = "agent", "domain", "machine", "streams", "publishes", "subscribes"
        return html_table([head, *map(_agent_row, self.agents)], repr(self)[1:-1])

    def agent(self, name: str) -> AgentSpec:
        """Return an agent by its name; `InvalidValueError` if there is no such agent."""
        agents = {agent.name: agent for agent in self.agents}
        if name not in agents:
            allowed = ", ".join(agents) + suggestion(name, agents)
            raise InvalidValueError(f"fleet {self.name}: agent", name, allowed)
        return agents[name]


def _agent_row(agent: AgentSpec) -> tuple[object, ...]:
    machine = agent.host.architecture.value if agent.host else ""
    streams = ", ".join(f"{s.topic} ({s.codec}, {s.rate_hz:g} Hz)" for s in agent.streams)
    topics = (", ".join(use.name for use in uses) for uses in (agent.publishes, agent.subscribes))
    return agent.name, agent.domain, machine, streams, *topics


def load_fleet(path: Path | str) -> Fleet:
    """Read a fleet from a file; a `DocumentError` says where it is none, what is given and what is allowed."""
    return _read(Document.of_file(Path(path), "a fleet file in UTF-8", one_line=True))


def read_fleet(text: str, file: str = "fleet.yaml") -> Fleet:
    """Read a fleet from the YAML text of a file, whose name is for messages; errors as of `load_fleet`."""
    return _read(Document(text, file, one_line=True))


def _read(document: Document) -> Fleet:
    top = document.section()
    keys = top.read(FleetKeys, whole_section=False)
    policy, places = _policy(top, keys)
    fleet = top.read(
        Fleet,
        global_domain=keys.border.domain,
        policy=policy,
        agents=tuple(
            _read_agent(agent, section, keys.border.interface)
            for agent, section in top.members("agents")
        ),
        deployment=_read_deployment(top.section("deployment"), top.text("fleet")),
        rule_places=places,
    )
    if not fleet.agents:
        raise top.refusal("agents", None, "at least one agent")
    return fleet


def _read_deployment(section: Section, fleet: str) -> DeploymentSpec:
    """Read what is the same for all machines; without the section, everything has its default."""
    name = re.sub("[^a-z0-9]+", "-", fleet.lower()).strip("-") or "fleet"
    given: dict[str, Any] = {} if section.has("images") else {"images": f"localhost/{name}"}
    return section.read(DeploymentSpec, **given)


def _policy(top: Section, keys: FleetKeys) -> tuple[Policy, tuple[Place, ...]]:
    if isinstance(keys.policy, str):
        return Policy(rules=TABLE_1), ()
    open_rules = tuple(
        replace(r, directions=r.directions or frozenset(Direction)) for r in keys.policy
    )
    if not open_rules:
        raise top.refusal("policy", [], "'table-1' or at least one rule: nothing would ever cross")
    return Policy(rules=open_rules), tuple(s.here for s in top.items("policy", short="pattern"))


def _read_agent(name: str, section: Section, interface: str | None) -> AgentSpec:
    try:
        validate_agent(name)
    except FqnError as error:
        raise DocumentError(section.here, name, error.allowed) from error
    return section.read(
        AgentSpec, name=name, global_interface=section.text("global_interface", interface)
    )


def _describe(sensor: SensorSpec) -> SensorDescription:
    streams = tuple(map(StreamDescription.of, sensor.streams))
    return SensorDescription(name=sensor.name, model=sensor.model, streams=streams)
