"""What one agent's files are made from: the one value that every renderer takes.

Pure: knows fleet, machine and release; refuses to know how a file looks.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from sfglab.deploy.errors import DeployError
from sfglab.deploy.network import NetworkPlan, plan_network
from sfglab.fleet.fleet_file import Accelerator, Fleet, HostSpec

if TYPE_CHECKING:
    from sfglab.fleet.fleet_file import AgentSpec, DeploymentSpec


HOME = "/opt/sfglab"
"""Where machines keep what they are given, one folder an agent."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Release:
    """What goes into an application image, and where it comes from."""

    version: str  #: Of sfglab.
    wheel: str  #: File name of sfglab's wheel.
    wheel_sha256: str  #: Its digest, as hexadecimal digits.
    lock: str  #: The pinned lock file's text: names, versions and digests of all that runs beside it.
    fleet_text: str  #: The fleet file, as it was read.
    revision: str = ""  #: Commit the wheel was built from; empty where it is not known.
    created: str = ""  #: When that was, as RFC 3339 has it; empty where it is not known.


@dataclass(frozen=True, slots=True, kw_only=True)
class Deployment:
    """One agent on its machine."""

    fleet: Fleet  #: The fleet.
    agent: AgentSpec  #: The agent.
    host: HostSpec  #: Its machine.
    accelerator: Accelerator  #: What its images are made for.
    network: NetworkPlan  #: Where its containers stand.
    release: Release  #: What runs in them.

    @property
    def common(self) -> DeploymentSpec:
        """What is the same for all machines of the fleet."""
        return self.fleet.deployment

    @property
    def folder(self) -> str:
        """Where the machine keeps the agent's files."""
        return f"{HOME}/{self.agent.name}"

    @property
    def service(self) -> str:
        """Name of the agent's systemd unit."""
        return f"sfglab-{self.agent.name}.service"

    @property
    def repository(self) -> str:
        """Repository of the agent's application images; their tags are its releases."""
        return f"{self.common.images}/{self.agent.name.replace('_', '-').lower()}"


def deployment_of(
    fleet: Fleet, agent: str, release: Release, *, detected: Accelerator | None = None
) -> Deployment:
    """Return one agent's deployment.

    Args:
        fleet: The fleet.
        agent: The agent's name.
        release: What is deployed.
        detected: What its machine was found to have, for a fleet file that leaves it to detection.

    Raises:
        DeployError: The file names no machine for it, or nobody says which accelerator it has.
        UnknownAgentError: The fleet has no such agent.
    """
    spec = fleet.agent(agent)
    if spec.host is None:
        raise DeployError(f"{spec.place}: host: nothing is given, allowed: the machine that {agent} runs on")
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
