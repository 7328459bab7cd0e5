"""Vendors: the default times of DDS implementations' reliability, and in which thread they send."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Literal

from sfglab.fields import between, bounds, check_bounds
from sfglab.units import NS_PER_MS, NS_PER_S

_FROM_ZERO = bounds()


@dataclass(frozen=True, slots=True, kw_only=True)
class Vendor:
    """How one DDS implementation times its reliability protocol (RTPS 2.5, clause 8.4)."""

    name: str  #: Name of the implementation.
    #: Period of heartbeats while something is unacknowledged.
    heartbeat_ns: int = field(metadata=bounds(1))
    #: Time from the first heartbeat that shows a gap to the reader's request.
    nack_delay_ns: int = field(metadata=_FROM_ZERO)
    #: Time from a heartbeat that shows no gap to the reader's acknowledgement.
    ack_delay_ns: int = field(metadata=_FROM_ZERO)
    #: Time from a request to the writer's retransmission.
    nack_response_ns: int = field(metadata=_FROM_ZERO)
    #: Samples that one request can ask for: a bitmap has 256 bits (RTPS 2.5, clause 9.4.2.6).
    nack_most: int = between(256, 1, 256)
    #: A heartbeat travels with every sample; else only while the writer's history is full, of samples that are
    #: unacknowledged, or with TRANSIENT_LOCAL durability of any. The reader answers each heartbeat at once: with
    #: a request if it lacks something that it has not asked for yet, with an acknowledgement only if it is asked.
    #: `nack_delay_ns` is then how long it waits before it asks for the same again, `ack_delay_ns` before it
    #: acknowledges the same again. The writer's repairs end with a heartbeat to which the reader may ask again at
    #: once, and it sends a periodic one only if it has sent no other for a period.
    prompt: bool = False
    #: A heartbeat that travels with a sample asks for no answer (it is FINAL) when the sample before is younger
    #: than this; 0: it always asks.
    final_within_ns: int = 0
    #: Samples that wait behind a gap, apart from the reader's history; beyond that the newest is dropped. 0:
    #: they wait in the reader's history.
    reorder_most: int = 0
    #: RTPS message in which repairs travel together, lost with any frame of it; 0: each has a frame of its own.
    burst_bytes: int = 0
    #: A heartbeat travels along once so many bytes of samples were sent since the last one; 0: however many.
    piggyback_bytes: int = between(0)
    #: Bytes that the sending thread of the middleware has sent before the run. Each sample that this thread
    #: sends adds all of its bytes so far. None: a sample adds its own size only. This thread always sends the
    #: retransmissions.
    sent_before_bytes: int | None = between(None)
    #: Samples are sent by that thread too: where the host's queue blocks, they wait in the history, and travel
    #: together later; who publishes waits once that is full.
    asynchronous: bool = False
    #: Bytes of each RTPS message beyond those that RTPS requires.
    extra_bytes: int = between(0)
    #: A request for what has left the history is answered by a GAP; else the next heartbeat shows that it is gone.
    gap_for_gone: bool = True

    @property
    def shows_each(self) -> bool:
        """Whether a heartbeat travels with every sample."""
        return self.prompt or (
            self.asynchronous and (self.sent_before_bytes or 0) >= self.piggyback_bytes > 0
        )

    def __post_init__(self) -> None:
        check_bounds(self, f"{self.name}: ")


FAST_DDS = Vendor(
    name="Fast DDS",
    # fastdds/rtps/attributes/WriterAttributes.hpp: heartbeatPeriod 3 s, nackResponseDelay 5 ms;
    # ReaderAttributes.hpp: heartbeatResponseDelay 5 ms, for requests and acknowledgements alike;
    # StatefulWriter.cpp: a heartbeat is sent along when the history is full; DataWriterImpl.cpp (2.x, 3.x) and
    # PublisherImpl.cpp (before): a VOLATILE writer's sample leaves the history once all have acknowledged it.
    heartbeat_ns=3 * NS_PER_S,
    nack_delay_ns=5 * NS_PER_MS,
    ack_delay_ns=5 * NS_PER_MS,
    nack_response_ns=5 * NS_PER_MS,
)
"""Fast DDS with synchronous publication, without the heartbeats that sent bytes cause."""

CYCLONE_DDS = Vendor(
    name="Cyclone DDS",
    # docs/manual/options.md: HeartbeatInterval 100 ms (min 5 ms, minsched 20 ms, max 8 s), NackDelay 100 ms,
    # AckDelay 10 ms, PrimaryReorderMaxSamples 128, MaxRexmitMessageSize 1456 B. ddsi_hbcontrol.c: a heartbeat
    # travels with every sample and asks for an answer when 4/5 of the interval have passed since the sample
    # before; the interval grows after five heartbeats in vain, which is left out. ddsi_acknack.c: what is new
    # is asked for at once. ddsi_radmin.c: no more is asked for than can wait.
    heartbeat_ns=100 * NS_PER_MS,
    nack_delay_ns=100 * NS_PER_MS,
    ack_delay_ns=10 * NS_PER_MS,
    nack_response_ns=0,
    nack_most=128,
    prompt=True,
    final_within_ns=80 * NS_PER_MS,
    reorder_most=128,
    burst_bytes=1456,
)
"""Cyclone DDS with its default settings."""

SEND_BUFFER_BYTES = 212_992
"""Default size of a socket's send buffer on Linux (net.core.wmem_default)."""
_SHOWN_BYTES = SEND_BUFFER_BYTES // 2
"""Size that Fast DDS takes for it: Asio halves it, as Linux doubles the requested size.

Measured without losses (2.14 and 3.2): a heartbeat rides with sample 807 of 60 B, 392 of 200 B, 226 of 400 B,
100 of 1000 B.
"""

FAST_DDS_SYNC = replace(
    FAST_DDS,
    name="Fast DDS, synchronous",
    # StatefulWriter.cpp: a heartbeat also rides once the socket's buffer could have been filled since the last.
    piggyback_bytes=_SHOWN_BYTES,
    # FlowControllerImpl.hpp, 2.4 to 3.2: one group of messages lasts as long as the thread, which sends repairs
    # together; the bytes that StatefulWriter.cpp takes for a sample's are the group's so far. So after some
    # hundred repairs of a process every one brings a heartbeat (measured). This is how it is then.
    sent_before_bytes=_SHOWN_BYTES,
    burst_bytes=65_500,
    extra_bytes=76,  # INFO_DST, and a submessage of its own, 0x80, for statistics (measured: 2.14 and 3.2)
    gap_for_gone=False,  # ReaderProxy.cpp: a GAP is for what lies between samples that are still there
)
"""Fast DDS 2.4 to 3.2 with synchronous publication."""

FAST_DDS_ASYNC = replace(
    FAST_DDS_SYNC,
    name="Fast DDS, asynchronous",
    # After a thousand samples of a process every one brings a heartbeat (measured: 558 in the first 900, 900 in
    # the next).
    asynchronous=True,
)
"""Fast DDS 2.4 to 3.2 with asynchronous publication."""

FAST_DDS_FOXY = replace(
    FAST_DDS_SYNC,
    name="Fast DDS 2.1, asynchronous",
    # Read, not measured. StatefulWriter.cpp of 2.0 and 2.1 has a group for each round of sending, so that bytes
    # do not add up. Its second condition, that a sample was overwritten unacknowledged (`acknack_required`),
    # holds where the history is full, which brings a heartbeat by itself.
    sent_before_bytes=None,
    asynchronous=True,
    extra_bytes=16,
)

PresetName = Literal["fast_dds", "cyclone_dds", "fast_dds_sync", "fast_dds_async", "fast_dds_foxy"]
PRESETS = {
    "fast_dds": FAST_DDS,
    "cyclone_dds": CYCLONE_DDS,
    "fast_dds_sync": FAST_DDS_SYNC,
    "fast_dds_async": FAST_DDS_ASYNC,
    "fast_dds_foxy": FAST_DDS_FOXY,
}
"""The vendors by the names that configurations use.

``fast_dds`` is the synchronous mode before its bytes were counted; committed runs were made with it.
"""
