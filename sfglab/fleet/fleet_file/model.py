"""A fleet as values: its agents, what their nodes publish, subscribe, serve and call, and their frames.

Knows what is true of a fleet, not where it is written nor whether it makes sense: `sfglab.fleet.border` finds
what does not. Every part remembers its place in the file, which does not count when parts are compared.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from sfglab.documents import NOWHERE, Place, suggestion
from sfglab.errors import SfglabError
from sfglab.fleet.address import BusAddress
from sfglab.fleet.fleet_file.deployment import DeploymentSpec
from sfglab.fleet.routing import Policy
from sfglab.fleet.routing.frames import SHARED_FRAMES

if TYPE_CHECKING:
    from sfglab.fleet.fleet_file.deployment import HostSpec
    from sfglab.qos import QoSProfile

__all__ = [
    "AgentSpec",
    "Fleet",
    "FrameSpec",
    "FrameTree",
    "NameUse",
    "SensorSpec",
    "StreamSpec",
    "TopicUse",
    "UnknownAgentError",
]


class UnknownAgentError(SfglabError, LookupError):
    """The fleet has no agent of that name."""


@dataclass(frozen=True, slots=True, kw_only=True)
class TopicUse:
    """A topic that an agent's nodes publish or subscribe.

    Attributes:
        name: Absolute ROS name.
        type: ROS type; empty where the file does not say.
        qos: What its endpoints offer or request; None where the file does not say.
        rate_hz: Messages a second of all its publishers here; None where the file does not say.
        size_bytes: Mean serialized size; None where the file does not say.
        count: Endpoints of this agent.
        place: Where it stands.
    """

    name: str
    type: str = ""
    qos: QoSProfile | None = None
    rate_hz: float | None = None
    size_bytes: int | None = None
    count: int = 1
    place: Place = field(default=NOWHERE, compare=False, repr=False)


@dataclass(frozen=True, slots=True, kw_only=True)
class NameUse:
    """A service or an action that an agent serves or calls.

    Attributes:
        name: Absolute ROS name.
        type: ROS type; empty where the file does not say.
        place: Where it stands.
    """

    name: str
    type: str = ""
    place: Place = field(default=NOWHERE, compare=False, repr=False)


@dataclass(frozen=True, slots=True, kw_only=True)
class StreamSpec:
    """A sensor's compressed stream, as the agent's metadata announces it (sfglab_interfaces/msg/StreamInfo).

    Attributes:
        topic: Global topic that carries it.
        type: ROS type of its messages.
        codec: ``h264``, ``rvl``, ``png`` or ``jpeg``.
        width: Pixels.
        height: Pixels.
        rate_hz: Messages a second.
        size_bytes: Mean serialized size of a message; None where the file does not say.
        decoded_topic: Where the decoded stream belongs; empty: derived from `topic`.
        camera_info_topic: Where the calibration is published; empty: nowhere.
        place: Where it stands.
    """

    topic: str
    type: str
    codec: str
    width: int
    height: int
    rate_hz: float
    size_bytes: int | None = None
    decoded_topic: str = ""
    camera_info_topic: str = ""
    place: Place = field(default=NOWHERE, compare=False, repr=False)


@dataclass(frozen=True, slots=True, kw_only=True)
class SensorSpec:
    """A sensor and what it sends (sfglab_interfaces/msg/SensorInfo).

    Attributes:
        name: Unique within its agent.
        model: Maker and model, for people.
        streams: What leaves the agent.
        place: Where it stands.
    """

    name: str
    model: str = ""
    streams: tuple[StreamSpec, ...] = ()
    place: Place = field(default=NOWHERE, compare=False, repr=False)


@dataclass(frozen=True, slots=True, kw_only=True)
class FrameSpec:
    """One transform that an agent broadcasts, with frame names as its nodes write them.

    Attributes:
        child: The frame that is placed.
        parent: The frame in which it is placed.
        static: Sent once on /tf_static instead of again and again on /tf.
        rate_hz: How often it is sent when it is not static.
        place: Where it stands.
    """

    child: str
    parent: str
    static: bool = False
    rate_hz: float = 0.0
    place: Place = field(default=NOWHERE, compare=False, repr=False)


@dataclass(frozen=True, slots=True, kw_only=True)
class FrameTree:
    """The transforms of one agent.

    Attributes:
        frames: One transform each.
        prefix_frames: Frames leave the agent as ``<agent>/<frame>``, as paper A, section 4.1 asks.
        shared_frames: Frames that all agents mean by the same name and that are never prefixed.
        placed_by_others: Frames of this agent, without prefix, that others may give a parent.
        static_broadcasters: Nodes that publish on /tf_static.
        place: Where it stands.
    """

    frames: tuple[FrameSpec, ...] = ()
    prefix_frames: bool = True
    shared_frames: tuple[str, ...] = SHARED_FRAMES
    placed_by_others: tuple[str, ...] = ()
    static_broadcasters: int = 1
    place: Place = field(default=NOWHERE, compare=False, repr=False)


@dataclass(frozen=True, slots=True, kw_only=True)
class AgentSpec:
    """One agent: a computer, or several, behind one router.

    Attributes:
        name: The agent segment of its names.
        domain: Its own DDS domain, D_i in the paper.
        global_interface: Interface to the other agents; None leaves the choice to DDS.
        local_interface: Interface of its own domain; None leaves the choice to DDS.
        processes: ROS processes, each a DDS participant.
        lifecycle: Whether it runs status provider and discoverer (paper A, section 4.2).
        sensors: What its metadata announces.
        tf: Its transforms.
        publishes: Topics, without those of `sensors`, `tf` and `lifecycle`.
        subscribes: Topics.
        serves: Services.
        calls: Services.
        action_servers: Actions.
        action_clients: Actions.
        host: The machine it runs on; None where the file does not say, so that it cannot be deployed.
        place: Where it stands.
    """

    name: str
    domain: int
    global_interface: str | None = None
    local_interface: str | None = None
    processes: int = 1
    lifecycle: bool = True
    sensors: tuple[SensorSpec, ...] = ()
    tf: FrameTree = field(default_factory=FrameTree)
    publishes: tuple[TopicUse, ...] = ()
    subscribes: tuple[TopicUse, ...] = ()
    serves: tuple[NameUse, ...] = ()
    calls: tuple[NameUse, ...] = ()
    action_servers: tuple[NameUse, ...] = ()
    action_clients: tuple[NameUse, ...] = ()
    host: HostSpec | None = None
    place: Place = field(default=NOWHERE, compare=False, repr=False)

    @property
    def streams(self) -> tuple[StreamSpec, ...]:
        """The streams of all its sensors."""
        return tuple(stream for sensor in self.sensors for stream in sensor.streams)


@dataclass(frozen=True, slots=True, kw_only=True)
class Fleet:
    """Agents that share a global domain.

    Attributes:
        name: What the fleet is called.
        global_domain: The domain that all routers join, D_0 in the paper.
        policy: What crosses.
        agents: The agents, in the order of the file.
        deployment: What is the same on all their machines.
        rule_places: Where each rule of the policy stands; empty where the file names a known one.
        place: Where it stands.
    """

    name: str
    global_domain: int = 0
    policy: Policy = field(default_factory=Policy)
    agents: tuple[AgentSpec, ...] = ()
    deployment: DeploymentSpec = field(default_factory=DeploymentSpec)
    rule_places: tuple[Place, ...] = field(default=(), compare=False, repr=False)
    place: Place = field(default=NOWHERE, compare=False, repr=False)

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
