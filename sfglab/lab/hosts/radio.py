"""What the radio between test hosts has done since its medium was set."""

from __future__ import annotations

from dataclasses import dataclass, field

from sfglab.units import NS_PER_S


@dataclass(slots=True, kw_only=True)
class RadioHost:
    """What one host has done with the medium since it was set."""

    frames: int = 0  #: Frames that it sent.
    bytes_: int = 0  #: Their bytes: Ethernet header and payload, no checksum.
    airtime_ns: int = 0  #: How long they were on air, nanoseconds.
    queue_full: int = 0  #: Frames that found its queue full.
    lost: int = 0  #: Frames of it that a receiver did not get, each receiver counted.

    @property
    def airtime_s(self) -> float:
        """`airtime_ns` in seconds."""
        return self.airtime_ns / NS_PER_S


@dataclass(frozen=True, slots=True, kw_only=True)
class RadioCounters:
    """What the radio has done since its medium was set, and whether it kept up."""

    hosts: dict[str, RadioHost] = field(default_factory=dict)  #: By name.
    delivered: int = 0  #: Frames that reached a receiver, each receiver counted.
    #: Of those, frames that were delivered more than `late_after_s` after they were due.
    late: int = 0
    late_after_s: float = 0.0  #: What counts as late, seconds.
    late_mean_s: float = 0.0  #: Mean delay beyond the due time, of all frames, seconds.
    late_most_s: float = 0.0  #: The longest of these delays, seconds.
    overrun: int = 0  #: Frames that the kernel dropped because the relay did not take them, or it.
    elapsed_s: float = 0.0  #: How long ago the medium was set, seconds.

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
        return (
            f"{self.delivered} frames delivered, {self.late} of them more than {self.late_after_s * 1e3:g} ms "
            f"late (mean {self.late_mean_s * 1e3:.2f} ms, most {self.late_most_s * 1e3:.1f} ms), "
            f"{self.overrun} overrun"
        )
