"""What a vendor's RELIABLE writer and reader do when: the model's constants, with their sources.

Times are the vendors' defaults. What a default does in the protocol stands in `writer`, `reader` and
`answers`.
"""

from __future__ import annotations

from dataclasses import dataclass

from sfglab.errors import SfglabError

MS = 1_000_000
S = 1_000_000_000


class VendorError(SfglabError, ValueError):
    """Timing that no writer or reader can keep."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Vendor:
    """How one DDS implementation times its reliability protocol (RTPS 2.5, clause 8.4)."""

    name: str  #: Of the implementation.
    heartbeat_ns: int  #: Period of heartbeats while something is unacknowledged.
    #: The period doubles with each heartbeat that brings no progress, up to this; equal to `heartbeat_ns` where
    #: it does not.
    heartbeat_max_ns: int
    #: A heartbeat travels with each sample while the writer's history is full: of samples that are
    #: unacknowledged, and with TRANSIENT_LOCAL durability of any.
    piggyback_when_full: bool
    nack_delay_ns: int  #: From the first heartbeat that shows a gap to the reader's request.
    ack_delay_ns: int  #: From a heartbeat that shows no gap to the reader's acknowledgement.
    nack_response_ns: int  #: From a request to the writer's repair.
    #: Samples that one request can ask for: a bitmap has 256 bits (RTPS 2.5, clause 9.4.2.6).
    nack_most: int = 256
    #: A heartbeat travels with every sample. The reader answers each at once: with a request if it lacks
    #: something that it has not asked for yet, with an acknowledgement only if it is asked. `nack_delay_ns` is
    #: then how long it waits before it asks for the same again, `ack_delay_ns` before it acknowledges the same
    #: again. The writer's repairs end with a heartbeat to which the reader may ask again at once, and it sends
    #: a periodic one only if it has sent no other for a period, which does not grow.
    prompt: bool = False
    #: A heartbeat that travels with a sample asks for no answer (it is FINAL) when the sample before is younger
    #: than this; 0: it always asks.
    final_within_ns: int = 0
    #: Samples that wait behind a gap, apart from the reader's history; beyond that the newest is dropped. 0:
    #: they wait in the reader's history.
    reorder_most: int = 0
    burst_bytes: int = 0  #: RTPS message in which repairs travel together; 0: each has a frame of its own.

    def __post_init__(self) -> None:
        if not 0 < self.heartbeat_ns <= self.heartbeat_max_ns:
            raise VendorError(
                f"{self.name}: heartbeat_ns, heartbeat_max_ns: given {self.heartbeat_ns}, "
                f"{self.heartbeat_max_ns}; allowed is 0 < heartbeat_ns <= heartbeat_max_ns"
            )
        if min(self.nack_delay_ns, self.ack_delay_ns, self.nack_response_ns) < 0:
            raise VendorError(f"{self.name}: delays: given a negative one, allowed are 0 and more")
        if not 1 <= self.nack_most <= 256:
            raise VendorError(f"{self.name}: nack_most: given {self.nack_most}, allowed are 1 to 256")


FAST_DDS = Vendor(
    name="Fast DDS",
    # fastdds/rtps/attributes/WriterAttributes.hpp: heartbeatPeriod 3 s, nackResponseDelay 5 ms;
    # ReaderAttributes.hpp: heartbeatResponseDelay 5 ms, for requests and acknowledgements alike;
    # StatefulWriter.cpp: a heartbeat is sent along when the history is full; DataWriterImpl.cpp (2.x, 3.x) and
    # PublisherImpl.cpp (before): a VOLATILE writer's sample leaves the history once all have acknowledged it.
    heartbeat_ns=3 * S,
    heartbeat_max_ns=3 * S,
    piggyback_when_full=True,
    nack_delay_ns=5 * MS,
    ack_delay_ns=5 * MS,
    nack_response_ns=5 * MS,
)

CYCLONE_DDS = Vendor(
    name="Cyclone DDS",
    # docs/manual/options.md: HeartbeatInterval 100 ms (min 5 ms, minsched 20 ms, max 8 s), NackDelay 100 ms,
    # AckDelay 10 ms, PrimaryReorderMaxSamples 128, MaxRexmitMessageSize 1456 B. ddsi_hbcontrol.c: a heartbeat
    # travels with every sample and asks for an answer when 4/5 of the interval have passed since the sample
    # before; the interval grows after five heartbeats in vain, which is left out. ddsi_acknack.c: what is new
    # is asked for at once. ddsi_radmin.c: no more is asked for than can wait.
    heartbeat_ns=100 * MS,
    heartbeat_max_ns=8 * S,
    piggyback_when_full=False,
    nack_delay_ns=100 * MS,
    ack_delay_ns=10 * MS,
    nack_response_ns=0,
    nack_most=128,
    prompt=True,
    final_within_ns=80 * MS,
    reorder_most=128,
    burst_bytes=1456,
)

PRESETS = {"fast_dds": FAST_DDS, "cyclone_dds": CYCLONE_DDS}
