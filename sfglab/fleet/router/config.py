"""Configuration of a router. The module imports neither nodes nor messages, so that it loads fast."""

from __future__ import annotations

from dataclasses import dataclass

from sfglab.bus.address import BusAddress
from sfglab.bus.api import ParameterTransport  # noqa: TC001 - read at run time
from sfglab.bus.zenoh.address import ZenohAddress  # noqa: TC001 - read at run time
from sfglab.errors import InvalidValueError
from sfglab.fleet.policy import TABLE_1, ForwardRule
from sfglab.names import SHARED_FRAMES, validate_agent


@dataclass(frozen=True, slots=True, kw_only=True)
class RouterSettings:
    """Settings of a router."""

    agent: str  #: Name of the agent.
    rules: tuple[ForwardRule, ...] = TABLE_1  #: Forwarding rules.
    #: Time that a path stays open after its last publisher or subscription has gone, s.
    idle_timeout_s: float = 1.0
    #: Whether TF frames leave with the agent's prefix; transforms of frames that clash are dropped.
    prefix_frames: bool = True
    shared_frames: tuple[str, ...] = SHARED_FRAMES  #: Frames without prefix, common to all agents.
    #: Frames of the agent, without prefix, to which others may publish a parent.
    placed_by_others: tuple[str, ...] = ()
    #: Whether a writer advertises each topic that could be forwarded before it is subscribed to, so that ROS 2's
    #: tools list it. In the global domain it costs 0.6 kB per topic and other agent, once.
    advertise_unused_topics: bool = False

    def __post_init__(self) -> None:
        validate_agent(self.agent)


@dataclass(frozen=True, slots=True, kw_only=True)
class RouterConfig(RouterSettings):
    """Configuration of a router's process.

    Raises:
        InvalidValueError: Both sides have the same DDS domain.
        FqnError: The agent's name is not valid.
    """

    local: BusAddress  #: The agent's domain.
    remote: ZenohAddress | BusAddress  #: The global domain, over Zenoh or DDS.
    #: Parameter services, with which ROS 2's tools read this configuration: over "dds" (rmw_cyclonedds) or "ros"
    #: (rmw_fastrtps, with ROS 2 on this host), twelve endpoints; None for none.
    parameters: ParameterTransport | None = None

    def __post_init__(self) -> None:
        RouterSettings.__post_init__(self)
        is_dds = isinstance(self.remote, BusAddress)
        if is_dds and self.local.domain_id == self.remote.domain_id:
            where = f"router of {self.agent}, domain on both sides"
            raise InvalidValueError(where, self.local.domain_id, "two different DDS domains")
