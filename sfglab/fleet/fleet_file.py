"""Fleet file: names that agents use, their frames, and their target hosts.

A file with unknown keys, wrong types, forbidden names or domains, or impossible hosts is refused.
`sfglab.fleet.lint` checks whether the fleet works, and `sfglab.deploy` deploys it (paper A, section 4.4).
"""

from __future__ import annotations

import re
from dataclasses import asdict, dataclass, field, replace
from enum import Enum
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from sfglab.bus.zenoh.address import ZenohAddress
from sfglab.documents import (
    NOWHERE,
    OR_NULL,
    ByName,
    Document,
    Matching,
    Place,
    ReadAs,
    ShortFor,
    named,
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
from sfglab.units import NS_PER_S
from sfglab.validation import suggestion

if TYPE_CHECKING:
    from collections.abc import Callable

PROFILES = {
    "default": DEFAULT,
    "sensor_data": SENSOR_DATA,
    "compressed_stream": COMPRESSED_STREAM,
    "latched": LATCHED,
    "services": SERVICES,
}
_POSITIVE = bounds(without=(0,))


AUTO = "auto"  #: Value instead of an accelerator's name: the accelerator is detected on the host.
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


def _named(check: Callable[[str], str]) -> ReadAs:
    """Return the reading of a text that a function of `sfglab.names` checks."""

    def checked(text: str) -> str:
        try:
            return check(text)
        except FqnError as error:
            raise InvalidValueError((), text, error.allowed) from error

    return ReadAs(str, checked)


_TOPIC = _named(validate_ros_name)
_SERVICE = _named(partial(validate_ros_name, kind=ResourceKind.SERVICE))
_ACTION = _named(partial(validate_ros_name, kind=ResourceKind.ACTION))


@dataclass(frozen=True, slots=True, kw_only=True)
class _QoS:
    """QoS of an endpoint; missing fields have ROS 2's defaults."""

    #: RELIABLE, with retransmission, or BEST_EFFORT.
    reliability: Reliability = DEFAULT.reliability
    #: Whether late joiners receive earlier messages.
    durability: Durability = DEFAULT.durability
    history: History = DEFAULT.history  #: Whether all messages are kept, or the last `depth`.
    depth: int = between(DEFAULT.depth, 1)  #: Number of messages that are kept.
    #: Longest time between two messages, s; None for no limit.
    deadline_s: float | None = field(default=None, metadata=_POSITIVE)
    #: Time after which a message is dropped, s; None for no limit.
    lifespan_s: float | None = field(default=None, metadata=_POSITIVE)
    liveliness: Liveliness = DEFAULT.liveliness  #: Source of a publisher's liveliness assertions.
    #: Longest time between liveliness assertions, s; None for no limit.
    lease_s: float | None = field(default=None, metadata=_POSITIVE)


def _profile(given: str | _QoS | None) -> QoSProfile | None:
    if not isinstance(given, _QoS):
        return None if given is None else PROFILES[given]
    values = asdict(given)
    for name in ("deadline", "lifespan", "lease"):
        values[f"{name}_ns"] = _nanoseconds(values.pop(f"{name}_s"))
    return QoSProfile(**values)


def _nanoseconds(value_s: float | None) -> int | None:
    return None if value_s is None else max(1, round(value_s * NS_PER_S))


def _folder(folder: str) -> str:
    if not FOLDER.fullmatch(folder):
        raise InvalidValueError((), folder, "a folder beside the fleet file")
    if ".." in folder.split("/"):
        raise InvalidValueError((), folder, "a folder beside the fleet file, not above it")
    return folder


def _optional(name: str | None) -> str:
    return str(_TOPIC.make(name)) if name else ""


OptionalTopic = Annotated[str, ReadAs(Annotated[str | None, OR_NULL], _optional)]


@dataclass(frozen=True, slots=True, kw_only=True)
class _Part:
    """A part of the file with its place, which comparisons ignore."""

    place: Place = field(default=NOWHERE, compare=False, repr=False)  #: Place in the file.


class Architecture(Enum):
    """A processor architecture, by its name in container images."""

    AMD64 = "amd64"
    ARM64 = "arm64"


class Accelerator(Enum):
    """Hardware of a target host, beside its processor, that can encode, decode or compute."""

    JETSON = "jetson"
    CUDA = "cuda"
    ROCM = "rocm"
    VAAPI = "vaapi"
    V4L2 = "v4l2"
    NONE = "none"


class RosDistribution(Enum):
    """ROS 2 distribution inside the images; the user's nodes may need one, sfglab does not."""

    NONE = "none"
    HUMBLE = "humble"
    JAZZY = "jazzy"


class RouterSoftware(Enum):
    """Router in an agent's second container."""

    SFGLAB = "sfglab"
    DDS_ROUTER = "dds-router"


class ContainerNetwork(Enum):
    """Network of the agent's container."""

    BRIDGE = "bridge"
    HOST = "host"


@dataclass(frozen=True, slots=True, kw_only=True)
class HostSpec(_Part):
    """Target host of an agent."""

    model: str = ""  #: Manufacturer and model, as information for people.
    #: Address for SSH, ``[user@]host``; empty for this machine.
    address: Annotated[str, Matching(ADDRESS, "[user@]host, as ssh takes it")] = ""
    architecture: Architecture = Architecture.AMD64  #: Architecture of the host's processor.
    #: Accelerator of the host; None: it is detected.
    accelerator: Annotated[
        Accelerator | None, ReadAs(Literal[AUTO] | Accelerator, lambda a: None if a == AUTO else a)
    ] = None
    #: Network of the agent's container: a bridge of its own, or the host's interfaces. The latter is for
    #: robots whose controllers use DDS over a cable.
    network: ContainerNetwork = ContainerNetwork.BRIDGE
    #: Device nodes that the agent needs beside its accelerator's, as in ``/dev/video0``.
    devices: tuple[Annotated[str, Matching(DEVICE, "device nodes, as in /dev/video0")], ...] = ()
    #: Folder of the user's colcon workspace, relative to the fleet file; empty: none.
    workspace: Annotated[str, ReadAs(str, _folder)] = ""
    #: Debian packages that the agent's own software needs.
    packages: tuple[Annotated[str, Matching(PACKAGE, "names of Debian packages")], ...] = ()
    #: Program and arguments of the user's software, which runs beside the agent; empty: none.
    launch: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class DeploymentSpec(_Part):
    """Settings of all target hosts of a fleet."""

    #: Repository prefix of its images, as in ``localhost/esslingen``.
    images: Annotated[
        str, Matching(REPOSITORY, "a repository of images, as in localhost/esslingen")
    ] = "localhost/fleet"
    ros: RosDistribution = RosDistribution.NONE  #: The ROS 2 distribution inside the images.
    #: Software of the router in the second container.
    router: RouterSoftware = RouterSoftware.SFGLAB
    #: Image of a router of another project; empty for that of sfglab.
    router_image: Annotated[str, Matching(IMAGE, "an image, as in ubuntu-ddsrouter:v3.5.0")] = ""
    #: Agents or hosts that serve the time.
    time_servers: tuple[
        Annotated[str, Matching(HOST, "agents' or hosts' names or addresses")], ...
    ] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class TopicUse(_Part):
    """A topic that an agent's nodes publish or subscribe."""

    name: Annotated[str, _TOPIC]  #: Absolute ROS name.
    type: str = ""  #: ROS type; empty if the file does not give it.
    #: QoS that its endpoints offer or request; None if not given.
    qos: Annotated[
        QoSProfile | None,
        ReadAs(Annotated[Literal[tuple(PROFILES)] | _QoS | None, OR_NULL], _profile),
    ] = None
    count: int = between(1, 1)  #: Number of its endpoints in this agent.


@dataclass(frozen=True, slots=True, kw_only=True)
class ServiceUse(_Part):
    """A service that an agent serves or calls."""

    name: Annotated[str, _SERVICE]  #: Absolute ROS name.
    type: str = ""  #: ROS type; empty if the file does not give it.


@dataclass(frozen=True, slots=True, kw_only=True)
class ActionUse(_Part):
    """An action that an agent serves or calls."""

    name: Annotated[str, _ACTION]  #: Absolute ROS name.
    type: str = ""  #: ROS type; empty if the file does not give it.


Services = tuple[Annotated[ServiceUse, ShortFor("name")], ...]
Actions = tuple[Annotated[ActionUse, ShortFor("name")], ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class StreamSpec(_Part):
    """A sensor's compressed stream, as the agent's metadata announces it (sfglab_interfaces/msg/StreamInfo)."""

    topic: Annotated[str, _TOPIC]  #: Global topic of the stream.
    type: str  #: ROS type of its messages.
    codec: Literal["h264", "rvl", "png", "jpeg"]  #: Codec of the messages.
    width: int = field(metadata=bounds(1))  #: Width of the images, pixels.
    height: int = field(metadata=bounds(1))  #: Height of the images, pixels.
    rate_hz: float = field(metadata=_POSITIVE)  #: Rate, messages per second.
    #: Topic of the decoded stream; empty to derive it from `topic`.
    decoded_topic: OptionalTopic = ""
    #: Topic of the calibration; empty if there is none.
    camera_info_topic: OptionalTopic = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class SensorSpec(_Part):
    """A sensor and its streams (sfglab_interfaces/msg/SensorInfo)."""

    name: str  #: Name, unique within its agent.
    model: str = ""  #: Manufacturer and model, as information for people.
    streams: tuple[StreamSpec, ...] = ()  #: Streams that leave the agent.


@dataclass(frozen=True, slots=True, kw_only=True)
class FrameSpec(_Part):
    """One transform that an agent broadcasts, with frame names as its nodes write them."""

    child: str  #: Child frame.
    parent: str  #: Parent frame.
    #: Whether the transform is sent once on /tf_static; otherwise it is sent periodically on /tf.
    static: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class FrameTree(_Part):
    """The transforms (TF) that the nodes of one agent broadcast, and how its router renames their frames."""

    #: The transforms.
    frames: tuple[FrameSpec, ...] = ()
    #: Whether frames leave the agent as ``<agent>/<frame>``, as paper A, section 4.1 requires.
    prefix_frames: bool = True
    #: Frames that all agents mean by the same name, and that never get a prefix.
    shared_frames: tuple[str, ...] = SHARED_FRAMES
    #: Frames of this agent, without prefix, to which others may publish a parent.
    placed_by_others: tuple[str, ...] = ()
    static_broadcasters: int = between(1, 1)  #: Number of nodes that publish on /tf_static.


@dataclass(frozen=True, slots=True, kw_only=True)
class AgentSpec(_Part):
    """One agent: one or several computers behind one router."""

    name: Annotated[str, _named(validate_agent)]  #: The agent segment of its names.
    #: The agent's own DDS domain, D_i in the paper.
    domain: int = field(metadata=bounds(0, MAX_DOMAIN))
    #: Interface to the other agents; None leaves the choice to DDS.
    global_interface: str | None = None
    #: Interface of the agent's own domain; None leaves the choice to DDS.
    local_interface: str | None = None
    processes: int = between(1, 1)  #: Number of ROS processes, each of which is a DDS participant.
    #: Whether the agent runs a status provider and a discoverer (paper A, section 4.2).
    lifecycle: bool = True
    sensors: tuple[SensorSpec, ...] = ()  #: Sensors in the agent's metadata.
    tf: FrameTree = field(default_factory=FrameTree)  #: Transforms that the agent broadcasts.
    #: Published topics, without those of `sensors`, `tf` and `lifecycle`.
    publishes: tuple[Annotated[TopicUse, ShortFor("name")], ...] = ()
    subscribes: tuple[Annotated[TopicUse, ShortFor("name")], ...] = ()  #: Subscribed topics.
    serves: Services = ()  #: Services that the agent serves.
    calls: Services = ()  #: Services that the agent calls.
    action_servers: Actions = ()  #: Actions that the agent serves.
    action_clients: Actions = ()  #: Actions that the agent calls.
    #: Target host; None: not given, and the agent cannot be deployed.
    host: HostSpec | None = None

    @property
    def streams(self) -> tuple[StreamSpec, ...]:
        """Streams of all sensors of the agent."""
        return tuple(stream for sensor in self.sensors for stream in sensor.streams)

    @property
    def description(self) -> AgentDescription:
        """Description of the agent's sensors, without accelerators and software."""
        return AgentDescription(sensors=tuple(map(_describe, self.sensors)))


@dataclass(frozen=True, slots=True, kw_only=True)
class _GlobalDomain:
    """The global domain, which all routers join."""

    domain: int = between(0, 0, MAX_DOMAIN)  #: Number of the domain, D_0 in the paper.
    #: Interface to it for agents that give none; None leaves the choice to DDS.
    interface: str | None = None
    #: Hubs, HOST[:PORT], one or two: the agents meet over Zenoh in place of DDS, as clients of the hubs.
    hubs: tuple[str, ...] = ()
    #: Agents, HOST[:PORT], in place of hubs: the agents meet over Zenoh, and the others connect with these.
    peers: tuple[str, ...] = ()
    #: With Zenoh: folder of certificates on each agent's host; empty without encryption.
    certificates: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class _Shared(_Part):
    """Fields that a fleet and its file have in common."""

    name: str = field(metadata=named("fleet"))  #: Name of the fleet.
    #: Whether ROS 2's tools list the topics of other agents before a node subscribes to them.
    offers: bool = True
    #: Exchange of agents' descriptions: published on a latched topic, or queried over each agent's metadata
    #: service, as in the paper.
    descriptions: Literal["published", "queried"] = "published"
    #: Agents of the fleet, at least one, in the order of the file.
    agents: Annotated[tuple[AgentSpec, ...], ByName("name")]
    #: Settings of all target hosts.
    deployment: DeploymentSpec = field(default_factory=DeploymentSpec)


@dataclass(frozen=True, slots=True, kw_only=True)
class FleetFile(_Shared):
    """Content of a fleet file, as it is written; `Fleet` is the checked result."""

    #: The domain that all routers join.
    border: _GlobalDomain = field(default_factory=_GlobalDomain, metadata=named("global"))
    #: Forwarding rules: Table 1 of paper A, or own rules.
    policy: Literal["table-1"] | tuple[Annotated[ForwardRule, ShortFor("pattern")], ...] = "table-1"


@dataclass(frozen=True, slots=True, kw_only=True)
class Fleet(_Shared):
    """Agents that share a global domain, as read from a fleet file."""

    global_domain: int = 0  #: The domain that all routers join, D_0 in the paper.
    #: Zenoh between the agents, without an agent's name; None for DDS.
    zenoh: ZenohAddress | None = None
    policy: Policy = field(default_factory=Policy)  #: Forwarding rules.
    #: Place of each rule of the policy; empty if the file names a known policy.
    rule_places: tuple[Place, ...] = field(default=(), compare=False, repr=False)

    def __repr__(self) -> str:
        return f"<fleet {self.name}: {len(self.agents)} agents around domain {self.global_domain}>"

    def agent(self, name: str) -> AgentSpec:
        """Return an agent by its name.

        Raises:
            InvalidValueError: The fleet has no such agent.
        """
        agents = {agent.name: agent for agent in self.agents}
        if name not in agents:
            allowed = ", ".join(agents) + suggestion(name, agents)
            raise InvalidValueError(f"fleet {self.name}: agent", name, allowed)
        return agents[name]


def load_fleet(path: Path | str) -> Fleet:
    """Read a fleet from a YAML file, such as ``data/fleets/esslingen.yaml``.

    Raises:
        DocumentError: The file cannot be read, or has a mistake; the error names the place, the given value and the
            allowed values.
    """
    return _read(Document.of_file(Path(path), "a fleet file in UTF-8", one_line=True))


def read_fleet(text: str, file: str = "fleet.yaml") -> Fleet:
    """Read a fleet from the YAML text of a file; errors name the file `file`.

    Raises:
        DocumentError: As for `load_fleet`.
    """
    return _read(Document(text, file, one_line=True))


def _read(document: Document) -> Fleet:
    file = document.read(FleetFile)
    if not file.agents:
        raise document.refusal(("agents",), None, "at least one agent")
    policy, places = _policy(document, file)
    return Fleet(
        place=file.place,
        name=file.name,
        global_domain=file.border.domain,
        zenoh=_zenoh(document, file.border),
        policy=policy,
        offers=file.offers,
        descriptions=file.descriptions,
        agents=tuple(_agent(agent, file.border.interface) for agent in file.agents),
        deployment=_deployment(document, file),
        rule_places=places,
    )


def _agent(agent: AgentSpec, interface: str | None) -> AgentSpec:
    return replace(agent, global_interface=agent.global_interface or interface)


def _zenoh(document: Document, border: _GlobalDomain) -> ZenohAddress | None:
    if not (border.hubs or border.peers):
        if border.certificates:
            allowed = "certificates together with hubs or peers, because DDS does not use them"
            raise document.refusal(("global", "certificates"), border.certificates, allowed)
        return None
    try:
        return ZenohAddress(
            domain_id=border.domain,
            hubs=border.hubs,
            peers=border.peers,
            certificates=border.certificates,
        )
    except InvalidValueError as error:
        raise document.refusal(("global",), error.given, error.allowed) from error


def _deployment(document: Document, file: FleetFile) -> DeploymentSpec:
    """Return the settings of all machines, with images under the fleet's name by default."""
    if "images" in document.value.get("deployment", ()):
        return file.deployment
    name = re.sub("[^a-z0-9]+", "-", file.name.lower()).strip("-") or "fleet"
    return replace(file.deployment, images=f"localhost/{name}")


def _policy(document: Document, file: FleetFile) -> tuple[Policy, tuple[Place, ...]]:
    if isinstance(file.policy, str):
        return Policy(rules=TABLE_1), ()
    if not file.policy:
        allowed = "'table-1' or at least one rule, because no topic is forwarded without a rule"
        raise document.refusal(("policy",), [], allowed)
    rules = tuple(
        replace(rule, directions=rule.directions or frozenset(Direction)) for rule in file.policy
    )
    places = tuple(document.place(("policy", position)) for position in range(len(rules)))
    return Policy(rules=rules), places


def _describe(sensor: SensorSpec) -> SensorDescription:
    streams = tuple(map(StreamDescription.of, sensor.streams))
    return SensorDescription(name=sensor.name, model=sensor.model, streams=streams)
