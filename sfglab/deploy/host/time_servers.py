"""Whose clock an agent's machine goes by: the fleet file names agents or hosts, NTP wants addresses."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from sfglab.deploy.errors import DeployError

if TYPE_CHECKING:
    from sfglab.deploy.deployment import Deployment
    from sfglab.fleet.fleet_file import AgentSpec


@dataclass(frozen=True, slots=True, kw_only=True)
class TimePlan:
    """What a machine does about time."""

    #: Names or addresses of the machines that it asks, in the order of the fleet file.
    servers: tuple[str, ...]
    serves: bool  #: Whether it is a time server itself.


def plan_time(deployment: Deployment) -> TimePlan:
    """Return whom an agent's machine asks for the time, and whether it answers others.

    Args:
        deployment: The agent on its machine.

    Raises:
        DeployError: A time server is an agent whose machine has no address.
    """
    agents = {agent.name: agent for agent in deployment.fleet.agents}
    own = _machine(deployment.host.address)
    servers: list[str] = []
    serves = False
    for index, name in enumerate(deployment.common.time_servers):
        agent = agents.get(name)
        server = name if agent is None else _server(deployment, index, agent)
        if name == deployment.agent.name or server == own:
            serves = True
        elif server not in servers:
            servers.append(server)
    return TimePlan(servers=tuple(servers), serves=serves)


def _server(deployment: Deployment, index: int, agent: AgentSpec) -> str:
    address = _machine(agent.host.address) if agent.host else ""
    if not address:
        raise DeployError(
            f"{deployment.common.place}.time_servers[{index}]: given {agent.name!r}, an agent whose host "
            "has no address, allowed: an agent that has one, or the name or address of a host"
        )
    return address


def _machine(address: str) -> str:
    """Return what stands behind the user's name in ``[user@]host``."""
    return address.rpartition("@")[2]
