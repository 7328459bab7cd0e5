"""From what the command line says to what an agent is, alone or on top of a fleet file."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from sfglab.fleet.address import BusAddress
from sfglab.fleet.agent.plan import MAX_DOMAIN, AgentConfig, PlanError, config_from_fleet

if TYPE_CHECKING:
    from sfglab.fleet.fleet_file import Fleet


@dataclass(frozen=True, slots=True, kw_only=True)
class SideOptions:
    """What is said of one side of the border; None: nothing."""

    domain_id: int | None = None  #: DDS domain.
    interface: str | None = None  #: Network interface by name.

    def over(self, address: BusAddress) -> BusAddress:
        """Return an address with what is said here in place of what it says."""
        domain_id = address.domain_id if self.domain_id is None else self.domain_id
        return replace(address, domain_id=domain_id, interface=self.interface or address.interface)


def config_from_options(
    agent: str, fleet: Fleet | None, *, local: SideOptions, remote: SideOptions
) -> AgentConfig:
    """Return the agent that the command line describes.

    Args:
        agent: Its name.
        fleet: What the fleet file says; None: there is none.
        local: Of its own domain; the domain is needed where there is no fleet file.
        remote: Of the global domain, which is 0 unless something else is said.

    Raises:
        PlanError: Nothing says which domain is its own.
        UnknownAgentError: The fleet has no such agent.
    """
    if fleet is not None:
        base = config_from_fleet(fleet, agent)
        return replace(base, local=local.over(base.local), remote=remote.over(base.remote))
    if local.domain_id is None:
        raise PlanError(
            f"agent {agent}: its own domain: nothing is given, allowed are 1 to {MAX_DOMAIN} or a fleet file"
        )
    return AgentConfig(
        agent=agent,
        local=local.over(BusAddress(domain_id=local.domain_id)),
        remote=remote.over(BusAddress(domain_id=0)),
    )
