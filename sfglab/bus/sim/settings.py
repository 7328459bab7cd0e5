"""Settings of a simulated world: costs of processes, and fixed delays of network and middleware."""

from __future__ import annotations

from dataclasses import dataclass

from sfglab.fields import between, check_bounds
from sfglab.units import NS_PER_S

#: Latency of a host's link to the network, s; a path between two hosts has two links.
LATENCY_S = 50e-6

# Delays of the middleware, without the latency of the links; Cyclone DDS 11.0.1 unless stated otherwise.
# Delay from a publisher to a subscription of the same host: a queue and a wake-up.
LOOPBACK_NS = 100_000
# Delay of sockets and threads of two hosts, beside the latency of the links.
STACK_NS = 200_000
# Delay from the creation of an endpoint to its discovery, between participants that have discovered each other:
# one DATA submessage of SEDP and two threads.
ENDPOINT_NS = 300_000
# Delay from the start of a participant to the discovery of its endpoints: SPDP, its response, and heartbeat,
# request and data of SEDP behind PreEmptiveAckDelay (10 ms).
PARTICIPANT_NS = 18_000_000
# Delay from a match to the history's arrival at a TRANSIENT_LOCAL reader: PreEmptiveAckDelay.
HISTORY_NS = 10_000_000
ANNOUNCEMENT_SHARE = 0.8  # Interval of the periodic SPDP announcement as a share of the lease.


@dataclass(frozen=True, slots=True, kw_only=True)
class Costs:
    """Processing times of a process, during which all its other work waits; 0 by default."""

    #: Time from the start of a process until it receives anything, s.
    start_s: float = between(0.0)
    message_s: float = between(0.0)  #: Time for each message that one of its readers takes, s.
    #: Time for each endpoint that the process creates or closes, s.
    endpoint_s: float = between(0.0)
    #: Time for each endpoint of its domains that appears or disappears, s.
    announcement_s: float = between(0.0)

    def __post_init__(self) -> None:
        check_bounds(self)


def ns_from_s(duration_s: float) -> int:
    """Return a duration in seconds as whole nanoseconds."""
    return round(duration_s * NS_PER_S)
