"""Settings of a simulated network and middleware, as values, and the trace of what happens.

Knows times, rates and probabilities. Refuses to know events: `world` makes them happen.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

from sfglab.errors import InvalidValueError
from sfglab.fields import between, check_bounds
from sfglab.units import NS_PER_S


@dataclass(frozen=True, slots=True, kw_only=True)
class LinkModel:
    """One host's link to the network, equal in both directions; between two hosts lie two of them."""

    latency_s: float = between(50e-6)  #: How long a packet takes to cross the link, seconds.
    #: What may come on top: drawn for each packet and link, evenly from 0 to this, seconds. Packets of one
    #: publisher stay in order, as on one path.
    jitter_s: float = between(0.0)
    #: Probability with which a packet is lost, drawn for each packet and link.
    loss: float = between(0.0, 0, 1, without=(1,))
    #: Rate of Ethernet frames, bit/s; what is sent faster waits in a queue without end. None is unlimited.
    rate_bps: float | None = None

    def __post_init__(self) -> None:
        check_bounds(self)
        if self.rate_bps is not None and not self.rate_bps > 0:
            raise InvalidValueError("rate_bps", self.rate_bps, "rates above 0, or None")

    @property
    def varies(self) -> bool:
        """Whether two packets may fare differently on it."""
        return self.jitter_s > 0 or self.loss > 0 or self.rate_bps is not None


@dataclass(frozen=True, slots=True, kw_only=True)
class Timing:
    """How long the middleware takes, latency of the links apart; Cyclone DDS 11.0.1 unless said otherwise."""

    same_node_s: float = 100e-6  #: From a publisher to a subscription of the same node: a queue and a wake-up.
    same_host_s: float = 100e-6  #: Between two processes of one host, over the loopback interface.
    stack_s: float = 200e-6  #: What sockets and threads of two hosts add to the links' latency.
    #: From the creation of an endpoint to its being known to participants that know each other, latency apart:
    #: one DATA submessage of SEDP and two threads.
    endpoint_s: float = 300e-6
    #: From the start of a participant to its being known with what it has, latency apart: SPDP, its answer, and
    #: heartbeat, request and data of SEDP behind PreEmptiveAckDelay (10 ms).
    participant_s: float = 18e-3
    #: From a match to the history's arrival at a TRANSIENT_LOCAL reader: PreEmptiveAckDelay.
    history_s: float = 10e-3
    #: From a packet's loss to its repeat: NackDelay, and the interval of heartbeats as well.
    repair_s: float = 100e-3
    announcement_share: float = 0.8  #: Interval of the periodic SPDP announcement as a share of the lease.


@dataclass(frozen=True, slots=True, kw_only=True)
class Costs:
    """What a process spends on what it hears; while it does, everything else that it hears waits.

    Zero by default: then processing takes no time, and times are those of network and protocol alone.
    """

    start_s: float = between(0.0)  #: From its start until it hears anything, seconds.
    message_s: float = between(0.0)  #: For each message that one of its readers takes, seconds.
    endpoint_s: float = between(0.0)  #: For each endpoint that it makes or ends, seconds.
    #: For each endpoint of its domains that is announced or retracted, seconds.
    announcement_s: float = between(0.0)

    def __post_init__(self) -> None:
        check_bounds(self)


def ns_from_s(duration_s: float) -> int:
    """Return a duration in whole nanoseconds."""
    return round(duration_s * NS_PER_S)


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


@dataclass(frozen=True, slots=True, kw_only=True)
class TraceEvent:
    """Something that happened."""

    time_ns: int  #: When, virtual nanoseconds since the start.
    what: str  #: "join", "leave", "crash", "open", "close", "send", "take", "part" or "heal".
    gid: bytes  #: Of the endpoint or participant; empty for what happens to the network.
    data: bytes  #: The sample's CDR, the topic of what is opened, the name of who joins.
