"""What a link between a host and the network can be set to, as values.

Knows rates, loss and queues in numbers. Refuses to know the kernel: `shaping` puts them there.
"""

from __future__ import annotations

from dataclasses import dataclass

from sfglab.lab.hosts.errors import LinkError

FRAME_BYTES = 1514
"""A full Ethernet frame without its checksum: 1500 B of payload and 14 B of header (IEEE 802.3, clause 3)."""

# The kernel's struct tc_ratespec counts bytes per second in 32 bits (linux/pkt_sched.h).
_MAX_RATE_BPS = 8 * (2**32 - 1)
_MIN_RATE_BPS = 1000
# Tokens for this long may be spent at once, so that a late timer does not lower the rate.
_BURST_S = 0.001
_DEFAULT_QUEUE_S = 0.1


@dataclass(frozen=True, slots=True, kw_only=True)
class Link:
    """The emulated properties of one host's link, equal in both directions."""

    rate_bps: float | None = None  #: Rate of Ethernet frames in bit/s; None is unlimited.
    #: Probability in [0, 1] with which a frame is lost, drawn anew for each frame and direction.
    loss: float = 0.0
    #: Size of the drop-tail queue before a limited rate; None is 100 ms at that rate, but at least ten full
    #: frames.
    queue_bytes: int | None = None

    def __post_init__(self) -> None:
        if self.rate_bps is not None and not _MIN_RATE_BPS <= self.rate_bps <= _MAX_RATE_BPS:
            raise LinkError(
                f"rate_bps: given {self.rate_bps}, allowed is {_MIN_RATE_BPS} to {_MAX_RATE_BPS} or None"
            )
        if not 0 <= self.loss <= 1:
            raise LinkError(f"loss: given {self.loss}, allowed is a probability from 0 to 1, or None")
        if self.queue_bytes is None:
            return
        if self.rate_bps is None:
            raise LinkError("queue_bytes: only a link with rate_bps has a queue; give both or neither")
        if self.queue_bytes < FRAME_BYTES:
            raise LinkError(
                f"queue_bytes: given {self.queue_bytes}, allowed is one frame ({FRAME_BYTES}) or more"
            )

    @property
    def burst_bytes(self) -> int:
        """Return the size of the token bucket: 1 ms at the rate, but at least two full frames."""
        assert self.rate_bps is not None
        return max(2 * FRAME_BYTES, round(self.rate_bps / 8 * _BURST_S))

    @property
    def limit_bytes(self) -> int:
        """Return the size of the queue in bytes, given or by default."""
        assert self.rate_bps is not None
        if self.queue_bytes is not None:
            return self.queue_bytes
        return max(10 * FRAME_BYTES, round(self.rate_bps / 8 * _DEFAULT_QUEUE_S))

    @property
    def loss_per_million(self) -> int:
        """Return how many of a million frames are lost."""
        return round(self.loss * 1_000_000)


@dataclass(frozen=True, slots=True, kw_only=True)
class LinkCounters:
    """What a link has lost since it was last set; up is from the host into the network, down the reverse."""

    lost_up_packets: int = 0  #: Frames from the host dropped by `Link.loss`.
    lost_up_bytes: int = 0  #: Their bytes, without the Ethernet header.
    lost_down_packets: int = 0  #: Frames to the host dropped by `Link.loss`.
    lost_down_bytes: int = 0  #: Their bytes, without the Ethernet header.
    overflow_up_packets: int = 0  #: Frames from the host that found the queue full.
    overflow_down_packets: int = 0  #: Frames to the host that found the queue full.
