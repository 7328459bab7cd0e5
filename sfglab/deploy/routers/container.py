"""The file that another's router reads inside an agent's second container."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from sfglab.deploy.routers.targets import render_router
from sfglab.fleet.fleet_file import RouterSoftware

if TYPE_CHECKING:
    from sfglab.fleet.fleet_file import Fleet


ROUTER_FILES = {
    RouterSoftware.DDS_ROUTER: "router/dds-router.yaml",
    RouterSoftware.ZENOH_BRIDGE: "router/zenoh-bridge.json5",
}
"""Where it stands in the agent's folder; our own router reads the fleet file."""

_TARGETS = {RouterSoftware.DDS_ROUTER: "dds-router", RouterSoftware.ZENOH_BRIDGE: "zenoh-bridge"}


def render_router_file(fleet: Fleet, agent: str, interface: str) -> str:
    """Return the configuration of the router that the fleet uses, empty for our own.

    Args:
        fleet: The fleet.
        agent: Whose router.
        interface: Where it meets the agent, in place of what the fleet file says of the agent's own nodes.

    Raises:
        RouterFileError: That router cannot express the fleet's policy.
    """
    software = fleet.deployment.router
    if software not in _TARGETS:
        return ""
    agents = tuple(replace(a, local_interface=interface) if a.name == agent else a for a in fleet.agents)
    return render_router(replace(fleet, agents=agents), agent, _TARGETS[software])
