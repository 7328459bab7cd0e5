"""The module `vendors` has the default times of DDS implementations' reliability, and the threads that send."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Literal

from sfglab.fields import between, bounds, check_bounds
from sfglab.units import NS_PER_MS, NS_PER_S

_FROM_ZERO = bounds()


@dataclass(frozen=True, slots=True, kw_only=True)
class Vendor:
    """A `Vendor` has the times of one DDS implementation's reliability protocol (RTPS 2.5, clause 8.4)."""

    name: str  #: Name of the implementation.
    #: Period of heartbeats while a sample is unacknowledged, ns.
    heartbeat_ns: int = field(metadata=bounds(1))
    #: Time from the first heartbeat that shows a gap to the reader's request, ns.
    nack_delay_ns: int = field(metadata=_FROM_ZERO)
    #: Time from a heartbeat that shows no gap to the reader's acknowledgement, ns.
    ack_delay_ns: int = field(metadata=_FROM_ZERO)
    #: Time from a request to the writer's retransmission, ns.
    nack_response_ns: int = field(metadata=_FROM_ZERO)
    #: Largest number of samples that one request can name: a bitmap has 256 bits (RTPS 2.5, clause 9.4.2.6).
    nack_most: int = between(256, 1, 256)
    #: Whether a heartbeat travels with every sample, as with Cyclone DDS. The reader then responds to each heartbeat
    #: at once: with a request for missing samples that it has not requested yet, or with an acknowledgement if the
    #: heartbeat requires one. It repeats a request after `nack_delay_ns`, and an acknowledgement after `ack_delay_ns`.
    #: Retransmissions end with a heartbeat, after which the reader may repeat its request at once. The writer sends a
    #: periodic heartbeat only if it has sent no other for a period. If False, a heartbeat travels with a sample only
    #: while the writer's history is full: of unacknowledged samples, or with TRANSIENT_LOCAL of any samples.
    prompt: bool = False
    #: Time below which the heartbeat of a sample requests no response (FINAL), counted from the sample before, ns;
    #: 0: the heartbeat always requests a response.
    final_within_ns: int = 0
    #: Largest number of samples that wait behind a gap, apart from the reader's history; the reader drops the newest
    #: sample beyond this number. 0: the samples wait in the reader's history.
    reorder_most: int = 0
    #: Size of the RTPS message in which retransmissions travel together, bytes; the loss of any of its frames loses the
    #: message. 0: each retransmission has its own frame.
    burst_bytes: int = 0
    #: Bytes of samples since the last heartbeat after which a heartbeat travels with a sample; 0: no such heartbeat.
    piggyback_bytes: int = between(0)
    #: Bytes that the sending thread of the middleware has sent before the run. Each sample that this thread
    #: sends adds all bytes that the thread has sent so far. None: a sample adds its own size only. This thread always
    #: sends the retransmissions.
    sent_before_bytes: int | None = between(None)
    #: Whether the sending thread also sends the samples. If the host's queue blocks, samples then wait in the history
    #: and travel together later; a publisher waits while the history is full.
    asynchronous: bool = False
    #: Bytes of each RTPS message beyond those that RTPS requires.
    extra_bytes: int = between(0)
    #: Whether the writer responds with a GAP to a request for a sample that has left the history; otherwise the next
    #: heartbeat shows that the sample is gone.
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
    # fastdds/rtps/attributes/WriterAttributes.hpp has heartbeatPeriod 3 s and nackResponseDelay 5 ms.
    # ReaderAttributes.hpp has heartbeatResponseDelay 5 ms for requests and acknowledgements. By StatefulWriter.cpp a
    # heartbeat travels with a sample when the history is full. By DataWriterImpl.cpp (2.x, 3.x) and PublisherImpl.cpp
    # (before 2.x) a VOLATILE writer's sample leaves the history once all readers have acknowledged the sample.
    heartbeat_ns=3 * NS_PER_S,
    nack_delay_ns=5 * NS_PER_MS,
    ack_delay_ns=5 * NS_PER_MS,
    nack_response_ns=5 * NS_PER_MS,
)
"""Fast DDS with synchronous publication, without the heartbeats that the bytes sent cause."""

CYCLONE_DDS = Vendor(
    name="Cyclone DDS",
    # docs/manual/options.md: HeartbeatInterval 100 ms (min 5 ms, minsched 20 ms, max 8 s), NackDelay 100 ms,
    # AckDelay 10 ms, PrimaryReorderMaxSamples 128, MaxRexmitMessageSize 1456 B. ddsi_hbcontrol.c: a heartbeat
    # travels with every sample and requests a response if 4/5 of the interval have passed since the sample
    # before; the interval grows after five heartbeats without progress, which the model leaves out. ddsi_acknack.c: the
    # reader requests new missing samples at once. ddsi_radmin.c: the reader requests no more samples than can wait.
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
"""Size that Fast DDS takes for the send buffer: Asio halves the size, because Linux doubles the requested size.

Measured without losses (2.14 and 3.2): a heartbeat travels with sample 807 of 60 B, 392 of 200 B, 226 of 400 B and
100 of 1000 B.
"""

FAST_DDS_SYNC = replace(
    FAST_DDS,
    name="Fast DDS 2.4 to 3.2, synchronous",
    # StatefulWriter.cpp: a heartbeat also travels with a sample if the samples since the last heartbeat could have
    # filled the socket's buffer.
    piggyback_bytes=_SHOWN_BYTES,
    # FlowControllerImpl.hpp, 2.4 to 3.2: one group of messages lasts as long as the sending thread, which sends
    # retransmissions together. StatefulWriter.cpp takes the bytes of the group so far for the bytes of a sample. After
    # some hundred retransmissions of a process, every retransmission therefore brings a heartbeat (measured). The
    # preset has this state from the start.
    sent_before_bytes=_SHOWN_BYTES,
    burst_bytes=65_500,
    # INFO_DST, and a further submessage, 0x80, for statistics (measured: 2.14 and 3.2)
    extra_bytes=76,
    # ReaderProxy.cpp: a GAP names only samples between samples that are still in the history
    gap_for_gone=False,
)
"""Fast DDS 2.4 to 3.2 with synchronous publication."""

FAST_DDS_ASYNC = replace(
    FAST_DDS_SYNC,
    name="Fast DDS 2.4 to 3.2, asynchronous",
    # After a thousand samples of a process every sample brings a heartbeat (measured: 558 heartbeats for the first 900
    # samples, 900 for the next 900).
    asynchronous=True,
)
"""Fast DDS 2.4 to 3.2 with asynchronous publication."""

FAST_DDS_FOXY = replace(
    FAST_DDS_SYNC,
    name="Fast DDS 2.1, asynchronous",
    # The preset is from the source code, not measured. StatefulWriter.cpp of 2.0 and 2.1 has a group for each round of
    # sending, so the bytes do not add up. The file's second condition, that an unacknowledged sample was overwritten
    # (`acknack_required`), holds only while the history is full; a full history brings a heartbeat in any case.
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
"""Vendors by the names that configurations use.

The preset ``fast_dds`` is the synchronous mode before the project counted its bytes; committed runs use this preset.
"""
