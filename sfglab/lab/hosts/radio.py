"""Counters of the radio between test hosts, since its medium was set."""

from __future__ import annotations

from dataclasses import dataclass

from sfglab.units import NS_PER_S

LATE_AFTER_S = 0.002  #: Delay beyond the due time from which a frame is late.


@dataclass(slots=True, kw_only=True)
class RadioCounters:
    """Counters of all hosts and of the access point, since the medium was set."""

    frames: int = 0  #: Number of frames on air.
    airtime_ns: int = 0  #: Airtime of these frames, ns.
    queue_full: int = 0  #: Number of frames that found their queue full.
    lost: int = 0  #: Number of frames that a receiver did not get, counted per receiver.
    delivered: int = 0  #: Number of frames that reached a receiver, counted per receiver.
    #: Number of delivered frames that arrived more than `LATE_AFTER_S` after they were due.
    late: int = 0
    #: Number of frames that the kernel dropped on their way to the relay or from it.
    overrun: int = 0

    def note(self, due_ns: int, now_ns: int) -> None:
        """Count a frame that is delivered now, given its due time."""
        self.delivered += 1
        self.late += now_ns - due_ns > LATE_AFTER_S * NS_PER_S

    @property
    def kept_up(self) -> bool:
        """Whether the relay was fast enough: no overrun, and at most 1 % of the frames late."""
        return self.overrun == 0 and self.late <= 0.01 * self.delivered

    def said(self) -> str:
        """Return a line of text with the numbers of delivered, late and overrun frames."""
        late = f"{self.late} of them more than {LATE_AFTER_S * 1e3:g} ms late"
        return f"{self.delivered} frames delivered, {late}, {self.overrun} overrun"
