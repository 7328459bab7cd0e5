"""Which container sees which network: only the router stands on the host's, because DDS needs multicast there.

The agent's container sees a bridge of its own without a way out; the router, on the host, meets it at the
bridge and the other agents at the global interface. So nothing that an agent says in its own domain can leave
but through the router (paper A, section 4.1), whatever its nodes are set to.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from typing import TYPE_CHECKING

from sfglab.fleet.fleet_file import ContainerNetwork

if TYPE_CHECKING:
    from sfglab.fleet.fleet_file import AgentSpec, Fleet, HostSpec


LAST_EPHEMERAL_FREE_PORT = 32767
"""The last port below those that Linux gives to anybody who asks (net.ipv4.ip_local_port_range)."""

_LONGEST_INTERFACE = 15  # IFNAMSIZ of Linux, less its closing zero
_CONTAINER_INTERFACE = "eth0"


@dataclass(frozen=True, slots=True, kw_only=True)
class NetworkPlan:
    """Domains and interfaces of an agent's two containers."""

    local_domain: int  #: The agent's own domain.
    global_domain: int  #: The domain that all routers join.
    #: Name of the agent's bridge on the host; empty where its container stands on the host's network.
    bridge: str
    agent_interface: str  #: Where the agent's container speaks its own domain.
    router_interface: str  #: Where the router meets it.
    global_interface: str | None  #: Where the router meets the other agents; None leaves the choice to DDS.
    local_ports: tuple[int, int]  #: First and last UDP port of its own domain, which nobody outside may reach.
    global_ports: tuple[int, int]  #: First and last UDP port of the global domain.


def domain_ports(domain: int) -> tuple[int, int]:
    """Return the first and last UDP port that a domain's participants have by the standard's formula.

    Ports that Linux may give to any other program are left out. Source: RTPS 2.5, clause 9.6.2.3, with
    PB = 7400 and DG = 250.
    """
    first = 7400 + 250 * domain
    return first, min(first + 249, max(first, LAST_EPHEMERAL_FREE_PORT))


def plan_network(fleet: Fleet, agent: AgentSpec, host: HostSpec) -> NetworkPlan:
    """Return where an agent's containers stand.

    Args:
        fleet: The fleet.
        agent: One of its agents.
        host: The machine it runs on.
    """
    bridged = host.network is ContainerNetwork.BRIDGE
    bridge = bridge_name(agent.name) if bridged else ""
    inside = agent.local_interface or "lo"
    return NetworkPlan(
        local_domain=agent.domain,
        global_domain=fleet.global_domain,
        bridge=bridge,
        agent_interface=_CONTAINER_INTERFACE if bridged else inside,
        router_interface=bridge if bridged else inside,
        global_interface=agent.global_interface,
        local_ports=domain_ports(agent.domain),
        global_ports=domain_ports(fleet.global_domain),
    )


def bridge_name(agent: str) -> str:
    """Return a name that Linux takes for an interface and that no other agent's bridge has."""
    name = f"sfg-{agent}"
    if len(name) <= _LONGEST_INTERFACE:
        return name
    digest = hashlib.sha256(agent.encode()).hexdigest()[:4]
    return f"{name[: _LONGEST_INTERFACE - 5]}-{digest}"
