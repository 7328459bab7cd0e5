"""Processes of an agent and their configurations, from the fleet file and the command line.

The module is pure. It refuses everything that can be refused before a process starts.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

from sfglab.bus.address import BusAddress
from sfglab.bus.api import ParameterTransport  # noqa: TC001 - read at run time
from sfglab.component import argument_of
from sfglab.domains import MAX_DOMAIN
from sfglab.errors import InvalidValueError
from sfglab.fleet.agent.supervision import Component
from sfglab.fleet.decoder.config import DecoderConfig
from sfglab.fleet.discovery.config import DiscoveryConfig, DiscoverySettings
from sfglab.fleet.discovery.config import Timing as DiscoveryTiming
from sfglab.fleet.discovery.listener import discovery_topic
from sfglab.fleet.gop_config import GopCacheConfig
from sfglab.fleet.policy import TABLE_1, ForwardRule
from sfglab.fleet.router.config import RouterConfig
from sfglab.fleet.status.config import StatusConfig, StatusSettings
from sfglab.fleet.status.description import AgentDescription, SensorDescription
from sfglab.fleet.status.heartbeat import Schedule
from sfglab.names import SHARED_FRAMES

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from sfglab.fleet.fleet_file import Fleet


#: Names of the components, in order of start.
COMPONENTS = ("router", "status", "discoverer", "keeper", "decoder")


@dataclass(frozen=True, slots=True, kw_only=True)
class AgentConfig:
    """Configuration of one agent."""

    agent: str  #: Name of the agent.
    local: BusAddress  #: The agent's own domain, D_i in the paper.
    remote: BusAddress  #: The domain that all agents share, D_0 in the paper.
    components: tuple[str, ...] = COMPONENTS  #: Components that run, of `COMPONENTS`.
    sensors: tuple[SensorDescription, ...] = ()  #: Sensors in the agent's metadata.
    rules: tuple[ForwardRule, ...] = TABLE_1  #: Forwarding rules of the router.
    prefix_frames: bool = True  #: Whether the router prefixes TF frames with its name.
    shared_frames: tuple[str, ...] = SHARED_FRAMES  #: Frames that are common to all agents.
    placed_by_others: tuple[
        str, ...
    ] = ()  #: Frames of the agent to which others may publish a parent.
    #: Whether router and decoder advertise topics before a subscription exists, so that ROS 2's tools list them. In
    #: the global domain it costs 0.6 kB per topic and other agent, once.
    advertise_unused_topics: bool = True
    #: Whether descriptions are published on a topic and read there. If false, each agent queries the paper's
    #: metadata service of each other agent.
    published_descriptions: bool = True
    #: Parameter services of router and decoder for ROS 2's tools: over "dds" (rmw_cyclonedds) or "ros"
    #: (rmw_fastrtps, with ROS 2 on this host), twelve endpoints each; None for none.
    parameters: ParameterTransport | None = None
    schedule: Schedule = field(default_factory=Schedule)  #: Periods of the heartbeat.
    #: Timeouts of the discoverer.
    discovery: DiscoveryTiming = field(default_factory=DiscoveryTiming)
    #: Whether the metadata lists the accelerators that work on this host. Each of them is tried.
    detect: bool = True


def plan(config: AgentConfig) -> tuple[Component, ...]:
    """Return the processes of an agent, in the order of `COMPONENTS`; no GOP cache without a stream to keep.

    Raises:
        SfglabError: A domain, name, description or wait is not allowed.
    """
    for address in (config.local, config.remote):
        if not 0 <= address.domain_id <= MAX_DOMAIN:
            raise InvalidValueError(
                f"agent {config.agent}, domain", address.domain_id, f"0 to {MAX_DOMAIN}"
            )
    return tuple(
        Component(name=name, argv=(sys.executable, "-m", module, argument_of(configure(config))))
        for name, (module, configure) in _MODULES.items()
        if name in config.components and (name != "keeper" or _videos(config))
    )


def without(config: AgentConfig, components: Iterable[str]) -> AgentConfig:
    """Return the agent without the named components; `InvalidValueError` if one of them does not exist."""
    dropped = frozenset(components)
    for name in sorted(dropped - set(COMPONENTS)):
        raise InvalidValueError(f"agent {config.agent}, component", name, ", ".join(COMPONENTS))
    return replace(
        config, components=tuple(name for name in config.components if name not in dropped)
    )


def router_config(config: AgentConfig) -> RouterConfig:
    """Return the configuration of an agent's router."""
    return RouterConfig(
        agent=config.agent,
        local=config.local,
        remote=config.remote,
        rules=config.rules,
        prefix_frames=config.prefix_frames,
        shared_frames=config.shared_frames,
        placed_by_others=config.placed_by_others,
        advertise_unused_topics=config.advertise_unused_topics,
        parameters=config.parameters,
    )


def _status(config: AgentConfig) -> StatusConfig:
    description = AgentDescription(sensors=config.sensors)
    settings = StatusSettings(
        agent=config.agent,
        description=description,
        schedule=config.schedule,
        publish_description=config.published_descriptions,
    )
    return StatusConfig(address=config.local, settings=settings, detect=config.detect)


def _discoverer(config: AgentConfig) -> DiscoveryConfig:
    settings = DiscoverySettings(
        agent=config.agent,
        timing=config.discovery,
        use_published_descriptions=config.published_descriptions,
    )
    return DiscoveryConfig(address=config.local, settings=settings)


def _videos(config: AgentConfig) -> tuple[str, ...]:
    """Return the streams whose late joiners need a whole group of pictures."""
    streams = (stream for sensor in config.sensors for stream in sensor.streams)
    return tuple(stream.topic for stream in streams if stream.codec == "h264")


def _decoder(config: AgentConfig) -> DecoderConfig:
    # Remote streams come through the router, so both sides of the decoder are the agent's own domain.
    return DecoderConfig(
        remote=config.local,
        local=config.local,
        discovery_topic=discovery_topic(config.agent),
        advertise_unused_topics=config.advertise_unused_topics,
        parameters=config.parameters,
    )


_MODULES: dict[str, tuple[str, Callable[[AgentConfig], Any]]] = {
    "router": ("sfglab.fleet.router.node", router_config),
    "status": ("sfglab.fleet.status.node", _status),
    "discoverer": ("sfglab.fleet.discovery.node", _discoverer),
    "keeper": (
        "sfglab.fleet.gop_cache",
        lambda c: GopCacheConfig(address=c.local, streams=_videos(c)),
    ),
    "decoder": ("sfglab.fleet.decoder.node", _decoder),
}


def config_from_fleet(fleet: Fleet, agent: str) -> AgentConfig:
    """Return an agent's configuration from a fleet file; `InvalidValueError` if the fleet has no such agent."""
    spec = fleet.agent(agent)
    config = AgentConfig(
        agent=agent,
        local=BusAddress(domain_id=spec.domain, interface=spec.local_interface),
        remote=BusAddress(domain_id=fleet.global_domain, interface=spec.global_interface),
        sensors=spec.description.sensors,
        rules=fleet.policy.rules,
        prefix_frames=spec.tf.prefix_frames,
        shared_frames=spec.tf.shared_frames,
        placed_by_others=spec.tf.placed_by_others,
        advertise_unused_topics=fleet.offers,
        published_descriptions=fleet.descriptions == "published",
    )
    return config if spec.lifecycle else without(config, ("status", "discoverer"))


Side = tuple[int | None, str | None]
"""DDS domain and network interface given for one side of the domain boundary; None: not given."""


def config_from_options(
    agent: str, fleet: Fleet | None, *, local: Side = (None, None), remote: Side = (None, None)
) -> AgentConfig:
    """Return an agent's configuration from options over a fleet file; without a file the global domain is 0.

    Raises:
        InvalidValueError: Its own domain is given neither by an option nor by a file, or the fleet has no
            such agent.
    """
    domain_id, _ = local
    if fleet is not None:
        base = config_from_fleet(fleet, agent)
    elif domain_id is None:
        raise InvalidValueError(
            f"agent {agent}: its own domain", None, f"1 to {MAX_DOMAIN} or a fleet file"
        )
    else:
        shared = BusAddress(domain_id=0)
        base = AgentConfig(agent=agent, local=BusAddress(domain_id=domain_id), remote=shared)
    return replace(base, local=_over(base.local, local), remote=_over(base.remote, remote))


def _over(address: BusAddress, given: Side) -> BusAddress:
    """Return an address in which the given values replace its own."""
    domain_id, interface = given
    if domain_id is not None:
        address = replace(address, domain_id=domain_id)
    return replace(address, interface=interface or address.interface)
