"""Deployment of an agent on its machine: the value that every renderer takes.

Only the router's container uses the host's network, because DDS needs multicast there. The agent's container has
a bridge network of its own without a route to other machines. So data of the agent's domain leaves the machine
only through the router (paper A, section 4.1), whatever the settings of its nodes are.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass

from sfglab.deploy.errors import DeployError
from sfglab.fleet.fleet_file import (
    Accelerator,
    AgentSpec,
    ContainerNetwork,
    DeploymentSpec,
    Fleet,
    HostSpec,
)

#: The last port below net.ipv4.ip_local_port_range, from which Linux assigns ports to any process.
LAST_EPHEMERAL_FREE_PORT = 32767

_LONGEST_INTERFACE = 15  # IFNAMSIZ of Linux, less its closing zero
_CONTAINER_INTERFACE = "eth0"


@dataclass(frozen=True, slots=True, kw_only=True)
class NetworkPlan:
    """Domains and interfaces of an agent's two containers."""

    local_domain: int  #: The agent's own domain.
    global_domain: int  #: The domain that all routers join.
    #: Name of the agent's bridge; empty where its container stands on the host's network.
    bridge: str
    agent_interface: str  #: Interface of the agent's container to its own domain.
    router_interface: str  #: Interface of the router to that domain.
    #: Interface of the router to the other agents; None leaves the choice to DDS.
    global_interface: str | None
    #: First and last UDP port of its own domain, which no other host may reach.
    local_ports: tuple[int, int]
    global_ports: tuple[int, int]  #: First and last UDP port of the global domain.


def domain_ports(domain: int) -> tuple[int, int]:
    """Return the first and last UDP port that a domain's participants have: RTPS 2.5, clause 9.6.2.3.

    PB is 7400 and DG 250; ports that Linux may give to any other program are left out.
    """
    first = 7400 + 250 * domain
    return first, min(first + 249, max(first, LAST_EPHEMERAL_FREE_PORT))


def plan_network(fleet: Fleet, agent: AgentSpec, host: HostSpec) -> NetworkPlan:
    """Return where an agent's containers stand on a machine."""
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


HOME = "/opt/sfglab"  #: Folder of all agents on a machine, with one folder per agent.

CURRENT = "current"  #: Link in an agent's folder to the release that runs.

FLEET_FILE = "/etc/sfglab/fleet.yaml"  #: Path of the fleet file in images.

USER, USER_ID = "sfglab", 10001  #: User in containers; its group has the same number.


@dataclass(frozen=True, slots=True, kw_only=True)
class Release:
    """Contents of an application image, and their origin."""

    version: str  #: Version of sfglab.
    wheel: str  #: File name of sfglab's wheel.
    wheel_sha256: str  #: Its digest, as hexadecimal digits.
    #: The pinned lock file's text: names, versions and digests of all that runs beside it.
    lock: str
    fleet_text: str  #: The fleet file, as it was read.
    revision: str = ""  #: Commit the wheel was built from; empty where it is not known.
    created: str = ""  #: Time of that commit, as in RFC 3339; empty if it is not known.


@dataclass(frozen=True, slots=True, kw_only=True)
class Deployment:
    """One agent on its machine."""

    fleet: Fleet  #: The fleet.
    agent: AgentSpec  #: The agent.
    host: HostSpec  #: Its machine.
    accelerator: Accelerator  #: Accelerator that its images are made for.
    network: NetworkPlan  #: Networks of its containers.
    release: Release  #: Release that runs in them.

    @property
    def common(self) -> DeploymentSpec:
        """Settings of all machines of the fleet."""
        return self.fleet.deployment

    @property
    def folder(self) -> str:
        """Folder of the agent on its machine, with its releases and what the user keeps."""
        return f"{HOME}/{self.agent.name}"

    @property
    def release_folder(self) -> str:
        """Path of the link to the release that runs."""
        return f"{self.folder}/{CURRENT}"

    @property
    def project(self) -> str:
        """Name under which Compose keeps the agent's containers."""
        return f"sfglab-{self.agent.name}"

    @property
    def service(self) -> str:
        """Name of the agent's systemd unit."""
        return f"{self.project}.service"

    @property
    def agent_command(self) -> tuple[str, ...]:
        """Arguments with which sfglab runs the agent beside a router in a container of its own."""
        agent = ("agent", "up", "--fleet", FLEET_FILE, "--agent", self.agent.name)
        return (*agent, "--interface", self.network.agent_interface, "--without", "router")

    @property
    def repository(self) -> str:
        """Repository of the agent's application images; their tags are its releases."""
        return f"{self.common.images}/{self.agent.name.replace('_', '-').lower()}"


def deployment_of(
    fleet: Fleet, agent: str, release: Release, *, detected: Accelerator | None = None
) -> Deployment:
    """Return one agent's deployment; `detected` is for a fleet file that leaves the accelerator to detection.

    Raises:
        DeployError: The file names no machine for it, or nobody says which accelerator it has.
        InvalidValueError: The fleet has no such agent.
    """
    spec = fleet.agent(agent)
    if spec.host is None:
        raise DeployError(
            f"{spec.place}: host: nothing is given, allowed: the machine that {agent} runs on"
        )
    accelerator = spec.host.accelerator or detected
    if accelerator is None:
        known = ", ".join(member.value for member in Accelerator)
        raise DeployError(
            f"{spec.host.place}.accelerator: given 'auto', which is found out on the machine itself; "
            f"allowed when rendering elsewhere: {known}"
        )
    return Deployment(
        fleet=fleet,
        agent=spec,
        host=spec.host,
        accelerator=accelerator,
        network=plan_network(fleet, spec, spec.host),
        release=release,
    )
