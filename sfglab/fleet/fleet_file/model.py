"""A fleet as values: its agents, what their nodes publish, subscribe, serve and call, and their frames.

Knows what is true of a fleet, not where it is written nor whether it makes sense: `sfglab.fleet.lint` finds
what does not. Every part remembers its place in the file, which does not count when parts are compared.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from sfglab.bus.address import BusAddress
from sfglab.documents import NOWHERE, Place, suggestion
from sfglab.errors import SfglabError
from sfglab.fleet.fleet_file.deployment import DeploymentSpec
from sfglab.fleet.policy import Policy
from sfglab.names import SHARED_FRAMES

if TYPE_CHECKING:
    from sfglab.fleet.fleet_file.deployment import HostSpec
    from sfglab.qos import QoSProfile


class UnknownAgentError(SfglabError, LookupError):
    """The fleet has no agent of that name."""


@dataclass(frozen=True, slots=True, kw_only=True)
class TopicUse:
    """A topic that an agent's nodes publish or subscribe."""

    name: str  #: Absolute ROS name.
    type: str = ""  #: ROS type; empty where the file does not say.
    qos: QoSProfile | None = None  #: What its endpoints offer or request; None where the file does not say.
    #: Messages a second of all its publishers here; None where the file does not say.
    rate_hz: float | None = None
    size_bytes: int | None = None  #: Mean serialized size; None where the file does not say.
    count: int = 1  #: Endpoints of this agent.
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

    topic: str  #: Global topic that carries it.
    type: str  #: ROS type of its messages.
    codec: str  #: ``h264``, ``rvl``, ``png`` or ``jpeg``.
    width: int  #: Pixels.
    height: int  #: Pixels.
    rate_hz: float  #: Messages a second.
    size_bytes: int | None = None  #: Mean serialized size of a message; None where the file does not say.
    decoded_topic: str = ""  #: Where the decoded stream belongs; empty: derived from `topic`.
    camera_info_topic: str = ""  #: Where the calibration is published; empty: nowhere.
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
    rate_hz: float = 0.0  #: How often it is sent when it is not static.
    place: Place = field(default=NOWHERE, compare=False, repr=False)  #: Where it stands.


@dataclass(frozen=True, slots=True, kw_only=True)
class FrameTree:
    """The transforms of one agent."""

    frames: tuple[FrameSpec, ...] = ()  #: One transform each.
    prefix_frames: bool = True  #: Frames leave the agent as ``<agent>/<frame>``, as paper A, section 4.1 asks.
    #: Frames that all agents mean by the same name and that are never prefixed.
    shared_frames: tuple[str, ...] = SHARED_FRAMES
    #: Frames of this agent, without prefix, that others may give a parent.
    placed_by_others: tuple[str, ...] = ()
    static_broadcasters: int = 1  #: Nodes that publish on /tf_static.
    place: Place = field(default=NOWHERE, compare=False, repr=False)  #: Where it stands.


@dataclass(frozen=True, slots=True, kw_only=True)
class AgentSpec:
    """One agent: a computer, or several, behind one router."""

    name: str  #: The agent segment of its names.
    domain: int  #: Its own DDS domain, D_i in the paper.
    global_interface: str | None = None  #: Interface to the other agents; None leaves the choice to DDS.
    local_interface: str | None = None  #: Interface of its own domain; None leaves the choice to DDS.
    processes: int = 1  #: ROS processes, each a DDS participant.
    lifecycle: bool = True  #: Whether it runs status provider and discoverer (paper A, section 4.2).
    sensors: tuple[SensorSpec, ...] = ()  #: What its metadata announces.
    tf: FrameTree = field(default_factory=FrameTree)  #: Its transforms.
    publishes: tuple[TopicUse, ...] = ()  #: Topics, without those of `sensors`, `tf` and `lifecycle`.
    subscribes: tuple[TopicUse, ...] = ()  #: Topics.
    serves: tuple[NameUse, ...] = ()  #: Services.
    calls: tuple[NameUse, ...] = ()  #: Services.
    action_servers: tuple[NameUse, ...] = ()  #: Actions.
    action_clients: tuple[NameUse, ...] = ()  #: Actions.
    #: The machine it runs on; None where the file does not say, so that it cannot be deployed.
    host: HostSpec | None = None
    place: Place = field(default=NOWHERE, compare=False, repr=False)  #: Where it stands.

    @property
    def streams(self) -> tuple[StreamSpec, ...]:
        """The streams of all its sensors."""
        return tuple(stream for sensor in self.sensors for stream in sensor.streams)


@dataclass(frozen=True, slots=True, kw_only=True)
class Fleet:
    """Agents that share a global domain."""

    name: str  #: What the fleet is called.
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
