"""Configuration of a status provider. The module imports neither nodes nor the bus."""

from __future__ import annotations

from dataclasses import dataclass, field

from sfglab.bus.address import BusAddress
from sfglab.fleet.status.description import AgentDescription
from sfglab.fleet.status.heartbeat import Schedule
from sfglab.names import validate_agent


@dataclass(frozen=True, slots=True, kw_only=True)
class StatusSettings:
    """Settings of a status provider."""

    agent: str  #: Name of the agent.
    #: Description of the agent.
    description: AgentDescription = field(default_factory=AgentDescription)
    schedule: Schedule = field(default_factory=Schedule)  #: Times of the heartbeats.
    #: Whether the description is also published on a latched topic. The paper's metadata service answers
    #: queries in both cases.
    publish_description: bool = True

    def __post_init__(self) -> None:
        validate_agent(self.agent)
        self.description.check(self.agent)


@dataclass(frozen=True, slots=True, kw_only=True)
class StatusConfig:
    """Configuration of a status provider's process."""

    address: BusAddress  #: The agent's local domain.
    settings: StatusSettings  #: Settings of the status provider.
    #: Whether software and accelerators are detected, in place of the described ones. Heartbeats do not wait
    #: for the trials of the accelerators; the description is updated afterwards.
    detect: bool = True
