"""Checks of agents: their domains, descriptions, target hosts and routers must make sense together."""

from __future__ import annotations

from typing import TYPE_CHECKING

from sfglab.fleet.fleet_file import ContainerNetwork, RouterSoftware
from sfglab.fleet.lint.report import Finding, a_warning, an_error
from sfglab.fleet.status.description import DescriptionError

if TYPE_CHECKING:
    from collections.abc import Iterator

    from sfglab.fleet.fleet_file import AgentSpec, HostSpec
    from sfglab.fleet.lint.uses import View

#: Highest domain whose ports are below Linux' ephemeral range (ROS 2, "The ROS_DOMAIN_ID").
LAST_SAFE_DOMAIN = 101


def check_domains(view: View) -> Iterator[Finding]:
    """Find agents that share a domain, with each other or with the routers."""
    first_of: dict[int, str] = {}
    for agent in view.fleet.agents:
        first = first_of.setdefault(agent.domain, agent.name)
        if agent.domain == view.fleet.global_domain and view.fleet.zenoh is None:
            yield an_error(
                "domain-global",
                agent.place,
                what=f"{agent.name} uses domain {agent.domain}, the global one",
                why="all agents receive its local topics (paper A, 4.1: D_i != 0)",
                remedy=f"give it a domain of its own, 1 to {LAST_SAFE_DOMAIN}",
            )
        elif first != agent.name:
            yield an_error(
                "domain-shared",
                agent.place,
                what=f"{agent.name} and {first} both use domain {agent.domain}",
                why="on one network their local topics mix, and both routers serve both agents",
                remedy="give every agent a domain of its own",
            )
        if agent.domain > LAST_SAFE_DOMAIN:
            yield a_warning(
                "domain-high",
                agent.place,
                what=f"{agent.name} uses domain {agent.domain}, above {LAST_SAFE_DOMAIN}",
                why="its ports are in the range of outgoing connections: some starts will fail",
                remedy=f"use 1 to {LAST_SAFE_DOMAIN}",
            )


def check_descriptions(view: View) -> Iterator[Finding]:
    """Find sensors that the agent's metadata could not announce."""
    for agent in view.fleet.agents:
        try:
            agent.description.check(agent.name)
        except DescriptionError as error:
            yield an_error(
                "description",
                agent.sensors[0].place,
                what=f"{agent.name} cannot announce its sensors: {error}",
                why="its status provider does not start: no agent discovers it (paper A, section 4.2)",
                remedy=f"name streams /global/{agent.name}/<component>/<stream>/<resource>",
            )


def check_hosts(view: View) -> Iterator[Finding]:
    """Find agents that share a host and describe its hardware differently."""
    first: dict[str, tuple[AgentSpec, HostSpec]] = {}
    for agent in view.fleet.agents:
        host = agent.host
        if host is None:
            continue
        address = host.address.rpartition("@")[2]
        other, known = first.setdefault(address, (agent, host))
        if (known.architecture, known.accelerator) != (host.architecture, host.accelerator):
            where = f"{agent.name} and {other.name} run on {address or 'this machine'}"
            yield an_error(
                "machine-twice",
                host.place,
                what=f"{where}, with different hardware",
                why="one machine has one architecture, and images for one accelerator do not run on "
                "another",
                remedy="correct the address, or give both agents the same architecture and accelerator",
            )


def check_interfaces(view: View) -> Iterator[Finding]:
    """Find agents with a host whose domains would use every network interface of it."""
    for agent in view.fleet.agents:
        if agent.host is None:
            continue
        if agent.global_interface is None:
            yield an_error(
                "interface-unnamed",
                agent.place,
                what=f"no key names the interface over which {agent.name} reaches the other agents",
                why="the host gets bridges for containers, which DDS may choose, and the firewall "
                "needs the interface",
                remedy="name it: global: {interface: wlan0} for all agents, or global_interface: of "
                "this one",
            )
        on_host = agent.host.network is ContainerNetwork.HOST
        if on_host and agent.local_interface is None:
            yield an_error(
                "domain-everywhere",
                agent.place,
                what=f"{agent.name} uses the network of its host, and its own domain every interface",
                why="on the host's network, only the interface keeps the domain inside (paper A, 4.1)",
                remedy="name local_interface: (lo, or that of a cable to the robot's controllers), or "
                "use network: bridge",
            )


def check_router_image(view: View) -> Iterator[Finding]:
    """Find images of a DDS Router that are missing, unused, or without a fixed version."""
    common = view.fleet.deployment
    image = common.router_image
    if common.router is RouterSoftware.SFGLAB:
        if image:
            yield an_error(
                "router-image-unused",
                common.place,
                what=f"router_image {image} is given, but the router is that of sfglab",
                why="it runs in the image of the agent, and no container would use this one",
                remedy="leave router_image out, or give router: dds-router",
            )
    elif not image:
        yield an_error(
            "router-image-missing",
            common.place,
            what=f"the router is {common.router.value}, but router_image is missing",
            why="its project publishes several images, and the release must say which one runs",
            remedy="give router_image: with a tag, as in ubuntu-ddsrouter:v3.5.0",
        )
    elif not _is_pinned(image):
        yield an_error(
            "router-image-moves",
            common.place,
            what=f"router_image {image} has no fixed tag",
            why="the image changes without a change in this file, so a rollback could start another one",
            remedy="give a version as its tag, or a digest",
        )


def _is_pinned(image: str) -> bool:
    name = image.rpartition("/")[2]
    return "@sha256:" in image or (":" in name and not name.endswith(":latest"))
