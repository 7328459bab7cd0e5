"""Processes of an agent and their configurations, from the fleet file and the command line.

The module has no I/O. It refuses everything that can be refused before a process starts.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Any, Literal

from sfglab.bus.address import BusAddress
from sfglab.bus.zenoh.address import ZenohAddress
from sfglab.component import argument_of
from sfglab.domains import MAX_DOMAIN
from sfglab.errors import InvalidValueError
from sfglab.fleet.agent.supervision import Component
from sfglab.fleet.decoder.config import DecoderConfig
from sfglab.fleet.discovery.config import DiscoveryConfig, DiscoverySettings
from sfglab.fleet.discovery.listener import discovery_topic
from sfglab.fleet.gop_config import GopCacheConfig
from sfglab.fleet.router.config import RouterConfig
from sfglab.fleet.status.config import StatusConfig, StatusSettings
from sfglab.fleet.status.description import AgentDescription, SensorDescription
from sfglab.fleet.status.heartbeat import Schedule

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from sfglab.fleet.fleet_file import Fleet


#: Names of the components, in order of start.
COMPONENTS = ("router", "status", "discoverer", "keeper", "decoder")


@dataclass(frozen=True, slots=True, kw_only=True)
class AgentConfig:
    """Configuration of one agent."""

    #: Configuration of its router: the agent's name, its own domain, and the global one. The decoder advertises
    #: topics and has parameter services as the router does.
    router: RouterConfig
    components: tuple[str, ...] = COMPONENTS  #: Components that run, of `COMPONENTS`.
    sensors: tuple[SensorDescription, ...] = ()  #: Sensors in the agent's metadata.
    #: Whether descriptions are published on a topic and read there. If false, each agent queries the paper's
    #: metadata service of each other agent.
    published_descriptions: bool = True


def plan(config: AgentConfig) -> tuple[Component, ...]:
    """Return the processes of an agent, in the order of `COMPONENTS`; no GOP cache without a stream to keep.

    Raises:
        SfglabError: A domain, name, description or wait is not allowed.
    """
    for address in (config.router.local, config.router.remote):
        if not 0 <= address.domain_id <= MAX_DOMAIN:
            where = f"agent {config.router.agent}, domain"
            raise InvalidValueError(where, address.domain_id, f"0 to {MAX_DOMAIN}")
    return tuple(
        Component(name=name, argv=(sys.executable, "-m", module, argument_of(configure(config))))
        for name, (module, configure) in _MODULES.items()
        if name in config.components and (name != "keeper" or _videos(config))
    )


def without(config: AgentConfig, components: Iterable[str]) -> AgentConfig:
    """Return the configuration of an agent without the named components.

    Raises:
        InvalidValueError: There is no such component.
    """
    dropped = frozenset(components)
    for name in sorted(dropped - set(COMPONENTS)):
        where = f"agent {config.router.agent}, component to leave out"
        raise InvalidValueError(where, name, ", ".join(COMPONENTS))
    return replace(
        config, components=tuple(name for name in config.components if name not in dropped)
    )


def _status(config: AgentConfig) -> StatusConfig:
    # Heartbeats of a starting agent make up for losses while DDS discovers endpoints. Over Zenoh, those of 1,000
    # agents that start together would be more than a hub forwards.
    is_zenoh = isinstance(config.router.remote, ZenohAddress)
    settings = StatusSettings(
        schedule=Schedule(startup_s=0) if is_zenoh else Schedule(),
        agent=config.router.agent,
        description=AgentDescription(sensors=config.sensors),
        publish_description=config.published_descriptions,
    )
    return StatusConfig(address=config.router.local, settings=settings)


def _discoverer(config: AgentConfig) -> DiscoveryConfig:
    settings = DiscoverySettings(
        agent=config.router.agent,
        use_published_descriptions=config.published_descriptions,
    )
    return DiscoveryConfig(address=config.router.local, settings=settings)


def _videos(config: AgentConfig) -> tuple[str, ...]:
    """Return the streams whose late joiners need a whole group of pictures."""
    streams = (stream for sensor in config.sensors for stream in sensor.streams)
    return tuple(stream.topic for stream in streams if stream.codec == "h264")


def _decoder(config: AgentConfig) -> DecoderConfig:
    # Remote streams come through the router, so both sides of the decoder are the agent's own domain.
    router = config.router
    return DecoderConfig(
        remote=router.local,
        local=router.local,
        discovery_topic=discovery_topic(router.agent),
        advertise_unused_topics=router.advertise_unused_topics,
        parameters=router.parameters,
    )


_MODULES: dict[str, tuple[str, Callable[[AgentConfig], Any]]] = {
    "router": ("sfglab.fleet.router.node", lambda config: config.router),
    "status": ("sfglab.fleet.status.node", _status),
    "discoverer": ("sfglab.fleet.discovery.node", _discoverer),
    "keeper": (
        "sfglab.fleet.gop_cache",
        lambda config: GopCacheConfig(address=config.router.local, streams=_videos(config)),
    ),
    "decoder": ("sfglab.fleet.decoder.node", _decoder),
}

Side = tuple[int | None, str | None]
"""DDS domain and network interface given for one side of the domain boundary; None: not given."""


Middleware = Literal["dds", "zenoh"]


def config_of(
    agent: str,
    fleet: Fleet | None,
    *,
    local: Side = (None, None),
    remote: Side = (None, None),
    middleware: Middleware | None = None,
    **zenoh: Any,
) -> AgentConfig:
    """Return an agent's configuration from options over a fleet file; without a file the global domain is 0.

    Args:
        agent: Name of the agent.
        fleet: The fleet file; None for none.
        local: Domain and interface of the agent's own side.
        remote: Those of the global side.
        middleware: Middleware between the agents; None for the file's, otherwise DDS.
        zenoh: Fields of `ZenohAddress`; empty ones are as in the file.

    Raises:
        InvalidValueError: Its own domain is given neither by an option nor by a file, the fleet has no such agent,
            or hubs, peers or certificates are given for DDS.
    """
    over = partial(_global_side, agent, middleware=middleware, **zenoh)
    if fleet is None:
        domain_id, interface = local
        if domain_id is None:
            allowed = f"--domain or ROS_DOMAIN_ID, from 1 to {MAX_DOMAIN}, or a fleet file"
            raise InvalidValueError(f"agent {agent}: its own domain", None, allowed)
        side = over(dds=_address(remote, 0, None), described=None)
        router = RouterConfig(
            agent=agent,
            local=BusAddress(domain_id=domain_id, interface=interface),
            remote=side,
            advertise_unused_topics=isinstance(side, BusAddress),
        )
        return AgentConfig(router=router)
    spec = fleet.agent(agent)
    dds = _address(remote, fleet.global_domain, spec.global_interface)
    side = over(dds=dds, described=fleet.zenoh)
    router = RouterConfig(
        agent=agent,
        local=_address(local, spec.domain, spec.local_interface),
        remote=side,
        rules=fleet.policy.rules,
        prefix_frames=spec.tf.prefix_frames,
        shared_frames=spec.tf.shared_frames,
        placed_by_others=spec.tf.placed_by_others,
        # A router that advertises receives the tokens of all endpoints, which grow with the square of the fleet.
        advertise_unused_topics=fleet.offers and isinstance(side, BusAddress),
    )
    config = AgentConfig(
        router=router,
        sensors=spec.description.sensors,
        published_descriptions=fleet.descriptions == "published",
    )
    return config if spec.lifecycle else without(config, ("status", "discoverer"))


def _global_side(
    agent: str,
    dds: BusAddress,
    described: ZenohAddress | None,
    middleware: Middleware | None,
    **zenoh: Any,
) -> ZenohAddress | BusAddress:
    """Return the address of an agent's router among the others: that over DDS, or one over Zenoh in its domain."""
    given = {name: value for name, value in zenoh.items() if value}
    if middleware == "dds" and given:
        words = f"agent {agent}, {' and '.join(given)} with --global dds"
        texts = [value if isinstance(value, str) else ", ".join(value) for value in given.values()]
        raise InvalidValueError(words, "; ".join(texts), "none, because only Zenoh uses them")
    if middleware == "dds" or not (middleware or described or given):
        return dds
    given |= {"domain_id": dds.domain_id, "name": agent}
    return replace(described or ZenohAddress(hubs=()), **given)


def _address(given: Side, domain_id: int, interface: str | None) -> BusAddress:
    """Return an address of the given values, and of the other ones where nothing is given."""
    given_id, given_interface = given
    return BusAddress(
        domain_id=domain_id if given_id is None else given_id,
        interface=given_interface or interface,
    )
