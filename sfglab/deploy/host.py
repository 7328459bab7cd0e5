"""Files of a machine beside containers: time, firewall, service (paper A, section 4.4, "Lifecycle Hooks")."""

from __future__ import annotations

import re
from dataclasses import dataclass
from importlib import resources

from sfglab.deploy.deployment import USER_ID, Deployment
from sfglab.deploy.errors import DeployError
from sfglab.deploy.files import PLAIN, PROGRAM, BundleFile, render


@dataclass(frozen=True, slots=True, kw_only=True)
class TimePlan:
    """Time synchronisation of a machine."""

    #: Names or addresses of machines that it asks, in the order of the fleet file.
    servers: tuple[str, ...]
    serves: bool  #: Whether it is a time server itself.


def plan_time(deployment: Deployment) -> TimePlan:
    """Return whom a machine asks for the time, and whether it serves; `DeployError` if it has no address."""
    agents = {agent.name: agent for agent in deployment.fleet.agents}
    own = deployment.host.address.rpartition("@")[2]
    servers: list[str] = []
    serves = False
    for index, name in enumerate(deployment.common.time_servers):
        server = name
        if name in agents:
            host = agents[name].host
            server = host.address.rpartition("@")[2] if host else ""
        if not server:
            raise DeployError(
                f"{deployment.common.place}.time_servers[{index}]: given {name!r}, an agent whose host "
                "has no address, allowed: an agent that has one, or the name or address of a host"
            )
        if name == deployment.agent.name or server == own:
            serves = True
        elif server not in servers:
            servers.append(server)
    return TimePlan(servers=tuple(servers), serves=serves)


# Linux, dev_valid_name(): at most 15 bytes, no '/', ':' or space. nft knows no escapes, and '*' is a wildcard.
_INTERFACE = re.compile(r"(?!\.{1,2}$)[A-Za-z0-9_.@-]{1,15}")
_ADDRESS = re.compile(r"\d+\.\d+\.\d+\.\d+")


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
    """Return what ``nft -f`` loads, empty if nothing is to close; `DeployError` if an interface is none."""
    network = deployment.network
    left_out = firewall_left_out(deployment)
    if left_out and not network.bridge:
        return ""
    return render(
        "firewall.nft",
        agent=deployment.agent.name,
        table=_table(deployment),
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


def _table(deployment: Deployment) -> str:
    """Return the name of the agent's table, of family ``inet``."""
    return f"sfglab_{deployment.agent.name}"


def _range(ports: tuple[int, int]) -> str:
    first, last = ports
    return f"{first}-{last}" if last > first else str(first)


_UNSAFE = re.compile(r"[^\w .:()-]+", re.ASCII)


def service_unit(deployment: Deployment) -> str:
    """Return the unit's text."""
    return render(
        "agent.service",
        agent=deployment.agent.name,
        # For people only; systemd gives '%', quotes and backslashes a meaning.
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
        DeployError: A time server has no address, or an interface a name that Linux does not take.
    """
    scripts = resources.files(__package__) / "scripts"
    files = {
        f"hooks/{name}": BundleFile(
            text=scripts.joinpath(name).read_text(encoding="utf-8"), mode=mode
        )
        for name, mode in SCRIPTS.items()
    }
    rules = firewall_rules(deployment)
    files["hooks/settings.sh"] = BundleFile(text=_settings(deployment, firewall=bool(rules)))
    if rules:
        files["hooks/firewall.nft"] = BundleFile(text=rules)
    files[f"systemd/{deployment.service}"] = BundleFile(text=service_unit(deployment))
    return files


def _settings(deployment: Deployment, *, firewall: bool) -> str:
    time = plan_time(deployment)
    return render(
        "settings.sh",
        agent=deployment.agent.name,
        folder=deployment.folder,
        service=deployment.service,
        state=f"{STATE}/{deployment.agent.name}",
        gid=USER_ID,
        interface=deployment.network.global_interface or "",
        servers=time.servers,
        serves=time.serves,
        firewall=firewall,
        left_out=firewall_left_out(deployment),
        table=_table(deployment),
    )
