"""The firewall of one agent: a table of its own for nftables, which touches nobody else's rules.

DDS has no border of its own: a participant announces itself on every interface that it is given, and whoever
knows a domain's number can join it. The table closes the own domain's ports at the global interface in both
directions, so that what a node says there never leaves the machine, whatever it is set to (paper A, sections
4.1 and 4.4). What the table accepts, another table may still drop.
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

from sfglab.deploy.errors import DeployError
from sfglab.deploy.templates import render

if TYPE_CHECKING:
    from sfglab.deploy.deployment import Deployment


# Linux, dev_valid_name(): at most 15 bytes, no '/', ':' or space. nft knows no escapes, and '*' is a wildcard.
_INTERFACE = re.compile(r"(?!\.{1,2}$)[A-Za-z0-9_.@-]{1,15}")
_ADDRESS = re.compile(r"\d+\.\d+\.\d+\.\d+")


def firewall_table(deployment: Deployment) -> str:
    """Return the name of the agent's table, of family ``inet``."""
    return f"sfglab_{deployment.agent.name}"


def firewall_left_out(deployment: Deployment) -> str:
    """Return why the own domain's ports are not closed; empty where they are."""
    network = deployment.network
    if network.global_interface is None:
        return "the fleet file names no global interface"
    if network.router_interface == network.global_interface:
        return f"the agent's own domain is on {network.global_interface} as well"
    if network.local_domain == network.global_domain:
        return "the agent's own domain is the global one"
    return ""


def firewall_rules(deployment: Deployment) -> str:
    """Return the table as ``nft -f`` loads it, in one transaction; empty where there is nothing to close.

    Args:
        deployment: The agent on its machine.

    Raises:
        DeployError: The global interface has a name that Linux does not take.
    """
    network = deployment.network
    left_out = firewall_left_out(deployment)
    if left_out and not network.bridge:
        return ""
    return render(
        "sfglab.deploy.host",
        "firewall.nft",
        agent=deployment.agent.name,
        table=firewall_table(deployment),
        interface="" if left_out else _interface(deployment),
        bridge=network.bridge,
        local_domain=network.local_domain,
        global_domain=network.global_domain,
        local_ports=_range(network.local_ports),
        global_ports=_range(network.global_ports),
    )


def _interface(deployment: Deployment) -> str:
    name = deployment.network.global_interface or ""
    if not _INTERFACE.fullmatch(name) or _ADDRESS.fullmatch(name):
        raise DeployError(
            f"{deployment.agent.place}: global_interface: given {name!r}, "
            "allowed: the name of a network interface, as in wlan0"
        )
    return name


def _range(ports: tuple[int, int]) -> str:
    first, last = ports
    return f"{first}-{last}" if last > first else str(first)
