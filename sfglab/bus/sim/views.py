"""Views of endpoints: who knows of which, as a function of what has happened so far.

`discovery` tells observers at the instants at which a participant's view changes.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

from sfglab.bus.sim.loop import NEVER_NS, VirtualLoop
from sfglab.bus.sim.settings import ENDPOINT_NS, PARTICIPANT_NS, REPAIR_NS, SAME_HOST_NS

if TYPE_CHECKING:
    from sfglab.bus.sim.model import Endpoint, Participant, Partition

#: Of the network, until two have met: SPDP, the answer and heartbeat, a request, the data.
_CROSSINGS = 4
_MASK = 2**64 - 1


@dataclass(frozen=True, slots=True)
class Gap:
    """A time in which two participants do not hear each other."""

    start_ns: int  #: From when on.
    end_ns: int  #: Until when; `NEVER_NS` while it lasts.
    lost_ns: int  #: When the silent one's lease runs out.
    back_ns: int  #: When the two know of each other what there is to know, after the end.


def known_spans(learnt_ns: int, forgotten_ns: int, gaps: list[Gap]) -> list[tuple[int, int]]:
    """Return when an endpoint is known, from its ungapped spans: from announcement to retraction or lease."""
    spans = []
    start, end = learnt_ns, forgotten_ns
    for gap in gaps:
        if end <= gap.start_ns or start >= gap.end_ns:
            continue
        if start > gap.start_ns:
            start = (
                NEVER_NS if end < gap.end_ns else gap.back_ns
            )  # it came, and perhaps went, unheard
        elif end < gap.end_ns:
            end = min(gap.lost_ns, gap.back_ns)  # it went unheard
        elif gap.lost_ns < gap.end_ns:
            spans.append((start, gap.lost_ns))
            start = gap.back_ns
    return [*spans, (start, end)] if start < end else spans


class Views:
    """The views of all participants of a world; the seed decides which announcements are lost."""

    def __init__(self, loop: VirtualLoop, seed: int) -> None:
        self.partitions: list[Partition] = []  #: Those of the network so far.
        self._loop = loop
        self._seed = seed

    def knows(self, participant: Participant, endpoint: Endpoint) -> bool:
        """Return whether a participant knows of an endpoint now."""
        now_ns = self._loop.now_ns
        if self.partitions:
            return any(start <= now_ns < end for start, end in self._spans(participant, endpoint))
        if self._learnt_ns(participant, endpoint) > now_ns:
            return False
        return not endpoint.fades or now_ns < self._forgotten_ns(participant, endpoint)

    def turns_ns(self, participant: Participant, endpoint: Endpoint) -> list[int]:
        """Return when from now on a participant may learn or forget an endpoint, also by a partition's end."""
        turns = [self._learnt_ns(participant, endpoint)]
        if endpoint.fades:
            turns.append(self._forgotten_ns(participant, endpoint))
        if self.partitions:
            spans = self._spans(participant, endpoint)
            turns = sorted({*turns, *(turn for span in spans for turn in span)})
        now_ns = self._loop.now_ns
        return [turn for turn in turns if now_ns <= turn < NEVER_NS]

    def _spans(self, participant: Participant, endpoint: Endpoint) -> list[tuple[int, int]]:
        """Return from when until when a participant knows of an endpoint, as far as it is decided now."""
        start_ns, end_ns = (
            self._learnt_ns(participant, endpoint),
            self._forgotten_ns(participant, endpoint),
        )
        if start_ns == NEVER_NS:
            return []
        return known_spans(start_ns, end_ns, self.gaps(participant, endpoint.participant))

    def gaps(self, participant: Participant, silent: Participant) -> list[Gap]:
        """Return when a participant did not hear another one, as far as it is decided now."""
        return [
            self._gap(participant, silent, partition)
            for partition in self.partitions
            if partition.separates(participant, silent)
        ]

    def lease_end_ns(self, participant: Participant, silent_ns: int) -> int:
        """Return when the lease of a participant runs out that was last able to speak at `silent_ns`."""
        announced_ns = silent_ns - (silent_ns - participant.born_ns) % participant.interval_ns
        return max(announced_ns, min(participant.last_sent_ns, silent_ns)) + participant.lease_ns

    def _learnt_ns(self, participant: Participant, endpoint: Endpoint) -> int:
        owner = endpoint.participant
        if owner is participant:
            return endpoint.born_ns
        known_ns = endpoint.born_ns + endpoint.backlog_ns + self._news_ns(participant, endpoint)
        later_ns = max(owner.born_ns, participant.born_ns)
        met_ns = later_ns + self._meeting_ns(participant, owner)
        if owner.crashed_ns is not None and met_ns > owner.crashed_ns:
            return NEVER_NS
        return max(known_ns, met_ns)

    def _forgotten_ns(self, participant: Participant, endpoint: Endpoint) -> int:
        owner = endpoint.participant
        if endpoint.gone_ns is not None:
            away_ns = 0 if owner is participant else self._news_ns(participant, endpoint)
            return endpoint.gone_ns + away_ns
        return NEVER_NS if owner.crashed_ns is None else self.lease_end_ns(owner, owner.crashed_ns)

    def _news_ns(self, participant: Participant, endpoint: Endpoint) -> int:
        """Return how long the news of an endpoint take: SEDP is reliable, so a loss is a delay."""
        owner = endpoint.participant
        if owner.host is participant.host:
            return SAME_HOST_NS
        delay_ns = owner.latency_ns + participant.latency_ns + ENDPOINT_NS
        if owner.loss or participant.loss:
            delay_ns += (
                self._losses(owner, participant, endpoint.number, participant.number) * REPAIR_NS
            )
        return delay_ns

    def _meeting_ns(self, one: Participant, other: Participant) -> int:
        """Return how long two participants take to meet: a lost SPDP is made good by the next one of either."""
        delay_ns = PARTICIPANT_NS
        if one.host is other.host:
            return delay_ns
        delay_ns += _CROSSINGS * (one.latency_ns + other.latency_ns)
        if one.loss or other.loss:
            first, second = sorted((one.number, other.number))
            delay_ns += self._losses(one, other, -first, second) * one.interval_ns // 2
        return delay_ns

    def _losses(self, one: Participant, other: Participant, *what: int) -> int:
        """Return how often something is lost between two before it arrives: the same whenever it is asked."""
        loss = one.loss + other.loss - one.loss * other.loss
        return int(math.log(_uniform(self._seed, *what)) / math.log(loss))

    def _gap(self, participant: Participant, silent: Participant, partition: Partition) -> Gap:
        start_ns, end_ns = partition.start_ns, partition.end_ns
        lost_ns = start_ns + silent.lease_ns
        if end_ns == NEVER_NS:
            back_ns = NEVER_NS
        elif end_ns <= lost_ns:
            back_ns = end_ns + REPAIR_NS
        else:
            wait_ns = min(-(end_ns - p.born_ns) % p.interval_ns for p in (participant, silent))
            back_ns = end_ns + wait_ns + self._meeting_ns(participant, silent)
        return Gap(start_ns, end_ns, lost_ns, back_ns)


def _uniform(seed: int, one: int, other: int) -> float:
    """Return a number of (0, 1] that looks random and depends on nothing but its arguments (SplitMix64)."""
    z = seed
    for value in (one, other):
        z = (z ^ value) + 0x9E3779B97F4A7C15 & _MASK
        z = (z ^ z >> 30) * 0xBF58476D1CE4E5B9 & _MASK
        z = (z ^ z >> 27) * 0x94D049BB133111EB & _MASK
        z ^= z >> 31
    return ((z >> 11) + 1) / 2**53
