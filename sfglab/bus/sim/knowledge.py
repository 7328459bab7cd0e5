"""When one participant knows another one's endpoint: pure arithmetic on times.

Knows announcements, retractions, partitions of the network and leases. Refuses to know who is concerned and
every clock: all times are arguments, in nanoseconds.
"""

from __future__ import annotations

from dataclasses import dataclass

NEVER_NS = 2**62
"""Later than every time of a simulation."""


@dataclass(frozen=True, slots=True)
class Gap:
    """A time in which two participants do not hear each other."""

    start_ns: int  #: From when on.
    end_ns: int  #: Until when; `NEVER_NS` while it lasts.
    lost_ns: int  #: When the silent one's lease runs out.
    back_ns: int  #: When the two know of each other what there is to know, after the end.


def known_spans(learnt_ns: int, forgotten_ns: int, gaps: list[Gap]) -> list[tuple[int, int]]:
    """Return from when until when an endpoint is known.

    Args:
        learnt_ns: When its announcement arrives, without gaps.
        forgotten_ns: When its retraction arrives, or its participant's lease runs out, without gaps.
        gaps: In the order of time, apart from each other.
    """
    spans = []
    start, end = learnt_ns, forgotten_ns
    for gap in gaps:
        if end <= gap.start_ns or start >= gap.end_ns:
            continue
        if start > gap.start_ns:
            start = NEVER_NS if end < gap.end_ns else gap.back_ns  # it came, and perhaps went, unheard
        elif end < gap.end_ns:
            end = min(gap.lost_ns, gap.back_ns)  # it went unheard
        elif gap.lost_ns < gap.end_ns:
            spans.append((start, gap.lost_ns))
            start = gap.back_ns
    return [*spans, (start, end)] if start < end else spans
