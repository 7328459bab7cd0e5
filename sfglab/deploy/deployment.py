"""Deployment of an agent on its target host: the value from which all files are rendered.

Only the router's container uses the host's network, because DDS needs multicast there. The agent's container has
a bridge network of its own without a route to other hosts. Therefore data of the agent's domain leaves the target
host only through the router (paper A, section 4.1), independently of the settings of the agent's nodes.
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


def domain_ports(domain: int) -> tuple[int, int]:
    """Return the first and the last UDP port of a domain's participants (RTPS 2.5, clause 9.6.2.3).

    The port base PB is 7400 and the domain gain DG is 250. Ports that Linux may assign to any other program are left
    out.
    """
    first = 7400 + 250 * domain
    return first, min(first + 249, max(first, LAST_EPHEMERAL_FREE_PORT))


def bridge_name(agent: str) -> str:
    """Return the name of an agent's bridge: allowed for an interface of Linux, and unique among agents."""
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
    wheel_sha256: str  #: SHA-256 of the wheel, as hexadecimal digits.
    #: Text of the lock file: names, versions and digests of all packages that sfglab needs.
    lock: str
    fleet_text: str  #: The fleet file, as it was read.
    revision: str = ""  #: Commit that the wheel was built from; empty if it is not known.
    created: str = ""  #: Time of that commit, as in RFC 3339; empty if it is not known.


@dataclass(frozen=True, slots=True, kw_only=True)
class Deployment:
    """One agent on its target host."""

    fleet: Fleet  #: Fleet of the agent.
    agent: AgentSpec  #: The agent.
    host: HostSpec  #: Target host of the agent.
    accelerator: Accelerator  #: Accelerator that the agent's images are made for.
    release: Release  #: Release in the agent's images.

    @property
    def common(self) -> DeploymentSpec:
        """Settings of all machines of the fleet."""
        return self.fleet.deployment

    @property
    def bridge(self) -> str:
        """Name of the agent's bridge; empty if its container uses the machine's network."""
        is_bridged = self.host.network is ContainerNetwork.BRIDGE
        return bridge_name(self.agent.name) if is_bridged else ""

    @property
    def agent_interface(self) -> str:
        """Interface of the agent's container to its own domain."""
        return _CONTAINER_INTERFACE if self.bridge else self._local_interface

    @property
    def router_interface(self) -> str:
        """Interface of the router's container to the agent's own domain."""
        return self.bridge or self._local_interface

    @property
    def _local_interface(self) -> str:
        return self.agent.local_interface or "lo"

    @property
    def folder(self) -> str:
        """Folder of the agent on its host, with the agent's releases and the user's files."""
        return f"{HOME}/{self.agent.name}"

    @property
    def release_folder(self) -> str:
        """Path of the link to the release that runs."""
        return f"{self.folder}/{CURRENT}"

    @property
    def project(self) -> str:
        """Name of the agent's Compose project."""
        return f"sfglab-{self.agent.name}"

    @property
    def service(self) -> str:
        """Name of the agent's systemd unit."""
        return f"{self.project}.service"

    @property
    def agent_command(self) -> tuple[str, ...]:
        """Arguments of sfglab that run the agent without a router, because the router has its own container."""
        agent = ("agent", "up", "--fleet", FLEET_FILE, "--agent", self.agent.name)
        return (*agent, "--interface", self.agent_interface, "--without", "router")

    @property
    def repository(self) -> str:
        """Repository of the agent's application images; their tags are its releases."""
        return f"{self.common.images}/{self.agent.name.replace('_', '-').lower()}"


def deployment_of(
    fleet: Fleet, agent: str, release: Release, accelerator: Accelerator | None = None
) -> Deployment:
    """Return the deployment of one agent.

    Args:
        fleet: The fleet.
        agent: Name of the agent.
        release: Release that is deployed.
        accelerator: Accelerator of the host; None for that of the fleet file.

    Raises:
        DeployError: The fleet file has no host for the agent, or the accelerator is not known.
        InvalidValueError: The fleet has no such agent.
    """
    spec = fleet.agent(agent)
    if spec.host is None:
        raise DeployError(
            f"{spec.place}: host: nothing is given, needed: the machine that {agent} runs on"
        )
    accelerator = accelerator or spec.host.accelerator
    if accelerator is None:
        known = ", ".join(member.value for member in Accelerator)
        raise DeployError(
            f"{spec.host.place}.accelerator: given 'auto', which only the machine itself can detect; "
            f"allowed when rendering elsewhere: {known}"
        )
    return Deployment(
        fleet=fleet,
        agent=spec,
        host=spec.host,
        accelerator=accelerator,
        release=release,
    )
