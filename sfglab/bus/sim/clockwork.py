"""The world's durations in whole nanoseconds, rounded once."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Self

if TYPE_CHECKING:
    from sfglab.bus.sim.link import Costs, Timing


def ns_from_s(duration_s: float) -> int:
    """Return a duration in whole nanoseconds."""
    return round(duration_s * 1e9)


@dataclass(frozen=True, slots=True, kw_only=True)
class Clockwork:
    """`Timing` and `Costs`, attribute by attribute, in nanoseconds; the share is none."""

    same_node_ns: int
    same_host_ns: int
    stack_ns: int
    endpoint_ns: int
    participant_ns: int
    history_ns: int
    repair_ns: int
    start_cost_ns: int
    message_cost_ns: int
    endpoint_cost_ns: int
    announcement_cost_ns: int
    announcement_share: float

    @classmethod
    def of(cls, timing: Timing, costs: Costs) -> Self:
        """Return the same in nanoseconds."""
        return cls(
            same_node_ns=ns_from_s(timing.same_node_s),
            same_host_ns=ns_from_s(timing.same_host_s),
            stack_ns=ns_from_s(timing.stack_s),
            endpoint_ns=ns_from_s(timing.endpoint_s),
            participant_ns=ns_from_s(timing.participant_s),
            history_ns=ns_from_s(timing.history_s),
            repair_ns=ns_from_s(timing.repair_s),
            start_cost_ns=ns_from_s(costs.start_s),
            message_cost_ns=ns_from_s(costs.message_s),
            endpoint_cost_ns=ns_from_s(costs.endpoint_s),
            announcement_cost_ns=ns_from_s(costs.announcement_s),
            announcement_share=timing.announcement_share,
        )
