"""What the simulated network and middleware are like, as values.

Knows times, rates and probabilities. Refuses to know events: `world` makes them happen.
"""

from __future__ import annotations

from dataclasses import dataclass

from sfglab.bus.sim.errors import WorldError

__all__ = ["Costs", "LinkModel", "Timing"]


@dataclass(frozen=True, slots=True, kw_only=True)
class LinkModel:
    """One host's link to the network, equal in both directions; between two hosts lie two of them.

    Attributes:
        latency_s: How long a packet takes to cross the link, seconds.
        jitter_s: What may come on top: drawn for each packet and link, evenly from 0 to this, seconds. Packets
            of one publisher stay in order, as on one path.
        loss: Probability with which a packet is lost, drawn for each packet and link.
        rate_bps: Rate of Ethernet frames, bit/s; what is sent faster waits in a queue without end. None is
            unlimited.
    """

    latency_s: float = 50e-6
    jitter_s: float = 0.0
    loss: float = 0.0
    rate_bps: float | None = None

    def __post_init__(self) -> None:
        for name in ("latency_s", "jitter_s"):
            if not getattr(self, name) >= 0:
                raise WorldError(f"link {name}: given {getattr(self, name)}, allowed are 0 s and more")
        if not 0 <= self.loss < 1:
            raise WorldError(f"link loss: given {self.loss}, allowed is a probability from 0 to below 1")
        if self.rate_bps is not None and not self.rate_bps > 0:
            raise WorldError(f"link rate_bps: given {self.rate_bps}, allowed are rates above 0, or None")

    @property
    def varies(self) -> bool:
        """Whether two packets may fare differently on it."""
        return self.jitter_s > 0 or self.loss > 0 or self.rate_bps is not None


@dataclass(frozen=True, slots=True, kw_only=True)
class Timing:
    """How long the middleware takes, latency of the links apart; Cyclone DDS 11.0.1 unless said otherwise.

    Attributes:
        same_node_s: From a publisher to a subscription of the same node: a queue and a wake-up.
        same_host_s: Between two processes of one host, over the loopback interface.
        stack_s: What sockets and threads of two hosts add to the links' latency.
        endpoint_s: From the creation of an endpoint to its being known to participants that know each other,
            latency apart: one DATA submessage of SEDP and two threads.
        participant_s: From the start of a participant to its being known with what it has, latency apart: SPDP,
            its answer, and heartbeat, request and data of SEDP behind PreEmptiveAckDelay (10 ms).
        history_s: From a match to the history's arrival at a TRANSIENT_LOCAL reader: PreEmptiveAckDelay.
        repair_s: From a packet's loss to its repeat: NackDelay, and the interval of heartbeats as well.
        announcement_share: Interval of the periodic SPDP announcement as a share of the lease.
    """

    same_node_s: float = 100e-6
    same_host_s: float = 100e-6
    stack_s: float = 200e-6
    endpoint_s: float = 300e-6
    participant_s: float = 18e-3
    history_s: float = 10e-3
    repair_s: float = 100e-3
    announcement_share: float = 0.8


@dataclass(frozen=True, slots=True, kw_only=True)
class Costs:
    """What a process spends on what it hears; while it does, everything else that it hears waits.

    Zero by default: then processing takes no time, and times are those of network and protocol alone.

    Attributes:
        start_s: From its start until it hears anything, seconds.
        message_s: For each message that one of its subscriptions or inlets takes, seconds.
        endpoint_s: For each endpoint that it makes or ends, seconds.
        announcement_s: For each endpoint of its domains that is announced or retracted, seconds.
    """

    start_s: float = 0.0
    message_s: float = 0.0
    endpoint_s: float = 0.0
    announcement_s: float = 0.0

    def __post_init__(self) -> None:
        for name in ("start_s", "message_s", "endpoint_s", "announcement_s"):
            if not getattr(self, name) >= 0:
                raise WorldError(f"costs {name}: given {getattr(self, name)}, allowed are 0 s and more")
