"""Deployment of an agent on its target host: the value that every renderer takes.

Only the router's container uses the host's network, because DDS needs multicast there. The agent's container has
a bridge network of its own without a route to other hosts. So data of the agent's domain leaves the target host only
through the router (paper A, section 4.1), with any settings of its nodes.
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
    """Return the first and last UDP port that a domain's participants have: RTPS 2.5, clause 9.6.2.3.

    PB is 7400 and DG 250; ports that Linux may give to any other program are left out.
    """
    first = 7400 + 250 * domain
    return first, min(first + 249, max(first, LAST_EPHEMERAL_FREE_PORT))


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
    release: Release  #: Release that runs in them.

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
        """Interface of the router to that domain."""
        return self.bridge or self._local_interface

    @property
    def _local_interface(self) -> str:
        return self.agent.local_interface or "lo"

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
        return (*agent, "--interface", self.agent_interface, "--without", "router")

    @property
    def repository(self) -> str:
        """Repository of the agent's application images; their tags are its releases."""
        return f"{self.common.images}/{self.agent.name.replace('_', '-').lower()}"


def deployment_of(
    fleet: Fleet, agent: str, release: Release, accelerator: Accelerator | None = None
) -> Deployment:
    """Return one agent's deployment; `accelerator` takes the place of the fleet file's.

    Raises:
        DeployError: The file names no machine for it, or its accelerator is not known.
        InvalidValueError: The fleet has no such agent.
    """
    spec = fleet.agent(agent)
    if spec.host is None:
        raise DeployError(
            f"{spec.place}: host: nothing is given, allowed: the machine that {agent} runs on"
        )
    accelerator = accelerator or spec.host.accelerator
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
        release=release,
    )
