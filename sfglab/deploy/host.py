"""Files of a target host outside containers: time, firewall, service (paper A, section 4.4, "Lifecycle Hooks")."""

from __future__ import annotations

import re
from importlib import resources
from typing import TYPE_CHECKING

from sfglab.deploy.deployment import USER_ID, Deployment, domain_ports
from sfglab.deploy.errors import DeployError
from sfglab.deploy.files import PLAIN, PROGRAM, BundleFile, render, text_file

if TYPE_CHECKING:
    from sfglab.fleet.fleet_file import HostSpec


def plan_time(deployment: Deployment) -> tuple[list[str], bool]:
    """Return the time servers of a host in the order of the fleet file, and whether the host is a time server.

    Raises:
        DeployError: A time server is an agent without an address.
    """
    agents = {agent.name: agent for agent in deployment.fleet.agents}
    own = _host_of(deployment.host)
    servers: list[str] = []
    serves = False
    for index, name in enumerate(deployment.common.time_servers):
        server = _host_of(agents[name].host) if name in agents else name
        if not server:
            raise DeployError(
                f"{deployment.common.place}.time_servers[{index}]: given {name!r}, an agent whose host "
                "has no address, allowed: an agent that has one, or the name or address of a host"
            )
        if name == deployment.agent.name or server == own:
            serves = True
        elif server not in servers:
            servers.append(server)
    return servers, serves


def _host_of(host: HostSpec | None) -> str:
    """Return a machine's name or address without the user."""
    return host.address.rpartition("@")[2] if host else ""


# Linux, dev_valid_name(): at most 15 bytes, no '/', ':' or space. nft knows no escapes, and '*' is a wildcard.
_INTERFACE = re.compile(r"(?!\.{1,2}$)[A-Za-z0-9_.@-]{1,15}")
_ADDRESS = re.compile(r"\d+\.\d+\.\d+\.\d+")


def firewall_left_out(deployment: Deployment) -> str:
    """Return the reason why the firewall does not close the ports of the agent's own domain; empty if it does."""
    interface = deployment.agent.global_interface
    if interface is None:
        return "the fleet file names no global interface"
    if deployment.router_interface == interface:
        return f"the agent's own domain is on {interface} as well"
    if deployment.agent.domain == deployment.fleet.global_domain:
        return "the agent's own domain is the global one"
    return ""


def firewall_rules(deployment: Deployment) -> str:
    """Return the firewall rules in the form that ``nft -f`` reads; empty if no port is to be closed.

    Raises:
        DeployError: The name of the global interface is not allowed in Linux.
    """
    left_out = firewall_left_out(deployment)
    if left_out and not deployment.bridge:
        return ""
    own, shared = deployment.agent.domain, deployment.fleet.global_domain
    return render(
        "firewall.nft",
        agent=deployment.agent.name,
        table=_table(deployment),
        interface="" if left_out else _interface(deployment),
        bridge=deployment.bridge,
        local_domain=own,
        global_domain=shared,
        local_ports=_ports(own),
        global_ports=_ports(shared),
    )


def _interface(deployment: Deployment) -> str:
    name = deployment.agent.global_interface or ""
    if not _INTERFACE.fullmatch(name) or _ADDRESS.fullmatch(name):
        raise DeployError(
            f"{deployment.agent.place}: global_interface: given {name!r}, "
            "allowed: the name of a network interface, as in wlan0"
        )
    return name


def _table(deployment: Deployment) -> str:
    """Return the name of the agent's table, of family ``inet``."""
    return f"sfglab_{deployment.agent.name}"


def _ports(domain: int) -> str:
    first, last = domain_ports(domain)
    return f"{first}-{last}" if last > first else str(first)


_UNSAFE = re.compile(r"[^\w .:()-]+", re.ASCII)


def service_unit(deployment: Deployment) -> str:
    """Return the text of the agent's systemd unit."""
    return render(
        "agent.service",
        agent=deployment.agent.name,
        # The description is for people only; systemd interprets '%', quotes and backslashes.
        fleet=_UNSAFE.sub(" ", deployment.fleet.name).strip(),
        service=deployment.service,
        folder=deployment.folder,
        release=deployment.release_folder,
        project=deployment.project,
        options=f"--project-name {deployment.project}",
    )


#: Folder of the tasks that a run of the hooks could not finish, with one folder per agent.
STATE = "/var/lib/sfglab"

SCRIPTS = {
    "initialize.sh": PROGRAM,
    "lib.sh": PLAIN,
    "10-time.sh": PROGRAM,
    "20-firewall.sh": PROGRAM,
    "30-service.sh": PROGRAM,
    "custom.d/README": PLAIN,
}
"""The hooks in the order in which they run, what they share, and the user's; with their permissions."""


def host_files(deployment: Deployment) -> dict[str, BundleFile]:
    """Return the hooks and the unit, by their paths in the agent's folder.

    Raises:
        DeployError: A time server has no address, or an interface has a name that is not allowed in Linux.
    """
    scripts = resources.files(__package__) / "scripts"
    files = {}
    for name, mode in SCRIPTS.items():
        files[f"hooks/{name}"] = text_file(scripts.joinpath(name).read_text("utf-8"), mode)
    rules = firewall_rules(deployment)
    files["hooks/settings.sh"] = text_file(_settings(deployment, firewall=bool(rules)))
    if rules:
        files["hooks/firewall.nft"] = text_file(rules)
    files[f"systemd/{deployment.service}"] = text_file(service_unit(deployment))
    return files


def _settings(deployment: Deployment, *, firewall: bool) -> str:
    servers, serves = plan_time(deployment)
    return render(
        "settings.sh",
        agent=deployment.agent.name,
        folder=deployment.folder,
        service=deployment.service,
        state=f"{STATE}/{deployment.agent.name}",
        gid=USER_ID,
        interface=deployment.agent.global_interface or "",
        servers=servers,
        serves=serves,
        firewall=firewall,
        left_out=firewall_left_out(deployment),
        table=_table(deployment),
    )
