"""Counters of the radio between test hosts, since its medium was set."""

from __future__ import annotations

from dataclasses import dataclass, field

from sfglab.units import NS_PER_MS, NS_PER_S

LATE_AFTER_S = 0.002  #: Delay beyond the due time from which a frame is late.


@dataclass(slots=True, kw_only=True)
class RadioHost:
    """Counters of one host, since the medium was set."""

    frames: int = 0  #: Frames that it sent.
    bytes_: int = 0  #: Their bytes: Ethernet header and payload, no checksum.
    airtime_ns: int = 0  #: Airtime of these frames, ns.
    queue_full: int = 0  #: Frames that found its queue full.
    lost: int = 0  #: Frames of it that a receiver did not get, each receiver counted.

    @property
    def airtime_s(self) -> float:
        """`airtime_ns` in seconds."""
        return self.airtime_ns / NS_PER_S


@dataclass(slots=True, kw_only=True)
class RadioCounters:
    """Counters of all hosts, since the medium was set."""

    hosts: dict[str, RadioHost] = field(default_factory=dict)  #: By name.
    delivered: int = 0  #: Frames that reached a receiver, each receiver counted.
    #: Delivered frames that came more than `LATE_AFTER_S` after they were due.
    late: int = 0
    late_sum_ns: int = 0  #: Sum of the delays beyond the due time, of all frames, ns.
    late_most_ns: int = 0  #: The longest of these delays, ns.
    overrun: int = 0  #: Frames that the kernel dropped because the relay did not take them, or it.

    def note(self, due_ns: int, now_ns: int) -> None:
        """Count a frame that was due at a time and is delivered now."""
        delay_ns = max(0, now_ns - due_ns)
        self.delivered += 1
        self.late += delay_ns > LATE_AFTER_S * NS_PER_S
        self.late_sum_ns += delay_ns
        self.late_most_ns = max(self.late_most_ns, delay_ns)

    @property
    def lost(self) -> int:
        """Frames that a receiver did not get, each receiver counted."""
        return sum(host.lost for host in self.hosts.values())

    @property
    def queue_full(self) -> int:
        """Frames that found their sender's queue full."""
        return sum(host.queue_full for host in self.hosts.values())

    @property
    def kept_up(self) -> bool:
        """Whether the relay was the medium it should be: nothing overrun, at most 1 % of the frames late."""
        return self.overrun == 0 and self.late <= 0.01 * self.delivered

    def said(self) -> str:
        """Return in one line how well the relay kept up."""
        mean_ms = self.late_sum_ns / max(1, self.delivered) / NS_PER_MS
        return (
            f"{self.delivered} frames delivered, {self.late} of them more than {LATE_AFTER_S * 1e3:g} ms "
            f"late (mean {mean_ms:.2f} ms, most {self.late_most_ns / NS_PER_MS:.1f} ms), "
            f"{self.overrun} overrun"
        )
