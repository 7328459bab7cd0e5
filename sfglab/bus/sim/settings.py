"""Settings of a simulated network and middleware: links, costs of processes, and fixed delays."""

from __future__ import annotations

from dataclasses import dataclass

from sfglab.errors import InvalidValueError
from sfglab.fields import between, check_bounds
from sfglab.units import NS_PER_S


@dataclass(frozen=True, slots=True, kw_only=True)
class LinkModel:
    """One host's link to the network, equal in both directions; between two hosts lie two links."""

    latency_s: float = between(50e-6)  #: Time for a packet to cross the link, seconds.
    #: Probability with which each link loses a packet.
    loss: float = between(0.0, 0, 1, without=(1,))
    #: Rate of Ethernet frames, bit/s; what is sent faster waits in a queue without end. None is unlimited.
    rate_bps: float | None = None

    def __post_init__(self) -> None:
        check_bounds(self)
        if self.rate_bps is not None and not self.rate_bps > 0:
            raise InvalidValueError("rate_bps", self.rate_bps, "rates above 0, or None")


# Delays of the middleware, without the latency of the links; Cyclone DDS 11.0.1 unless said otherwise.
# From a publisher to a subscription of the same host: a queue and a wake-up.
LOOPBACK_NS = 100_000
STACK_NS = 200_000  # Time of sockets and threads of two hosts, beside the links' latency.
# From the creation of an endpoint to its being known to participants that know each other: one
# DATA submessage of SEDP and two threads.
ENDPOINT_NS = 300_000
# From the start of a participant to its being known with what it has: SPDP, its answer, and
# heartbeat, request and data of SEDP behind PreEmptiveAckDelay (10 ms).
PARTICIPANT_NS = 18_000_000
# From a match to the history's arrival at a TRANSIENT_LOCAL reader: PreEmptiveAckDelay.
HISTORY_NS = 10_000_000
# From a packet's loss to its repeat: NackDelay, and the interval of heartbeats as well.
REPAIR_NS = 100_000_000
ANNOUNCEMENT_SHARE = 0.8  # Interval of the periodic SPDP announcement as a share of the lease.


@dataclass(frozen=True, slots=True, kw_only=True)
class Costs:
    """Times that a process spends on what it receives, while all else waits; 0 by default."""

    start_s: float = between(0.0)  #: Time from its start until it receives anything, seconds.
    message_s: float = between(0.0)  #: For each message that one of its readers takes, seconds.
    endpoint_s: float = between(0.0)  #: For each endpoint that it makes or ends, seconds.
    #: For each endpoint of its domains that comes or goes, seconds.
    announcement_s: float = between(0.0)

    def __post_init__(self) -> None:
        check_bounds(self)


def ns_from_s(duration_s: float) -> int:
    """Return a duration in whole nanoseconds."""
    return round(duration_s * NS_PER_S)
