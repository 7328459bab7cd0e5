"""A planned QoS: rate and depth of each topic, and what the link's arithmetic expects of them.

Whoever found the rates, they are judged alike here: share of the medium, latency, and the share of time in
which the reader holds a value that is still true. Refuses to know how rates are found.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from sfglab.arp.balancing import BalanceInput, balance
from sfglab.arp.depths import expected_losses
from sfglab.arp.link import at_depths, link_of, repair_delay_s, waits_s
from sfglab.errors import SfglabError
from sfglab.qos import QoSProfile

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from sfglab.arp.link import Link
    from sfglab.arp.topics import Topic, TopicFile
    from sfglab.rtps import Medium, Vendor


class UnknownTopicError(SfglabError, LookupError):
    """A topic that a plan does not have."""


@dataclass(frozen=True, slots=True, kw_only=True)
class TopicPlan:
    """One topic's part of a plan."""

    topic: Topic  #: The topic.
    rate_hz: float  #: How often it is sent.
    depth: int  #: History of its writer and of its reader.
    #: Mean time from publication to delivery, expected; infinite where the medium is overloaded.
    latency_s: float
    up_to_date: float  #: Share of time in which the reader holds the value that the sensor has, expected.
    loss: float  #: Share of samples that never come because the medium loses frames, expected.

    @property
    def deadline_ns(self) -> int | None:
        """The longest gap to agree on: the history's length in time, depth / rate; None behind a local cache.

        A DEADLINE of one period would be missed by every jitter and every repair. After depth / rate a sample
        that is still missing has left the history and comes no more, so a longer gap is a fault. What a cache
        holds back leaves gaps of any length.
        """
        if self.topic.cached:
            return None
        return max(1, round(1e9 * max(self.depth, 2) / self.rate_hz))

    @property
    def qos(self) -> QoSProfile:
        """Of the writer, and of the reader alike: equal profiles always match."""
        return QoSProfile(
            reliability=self.topic.reliability,
            durability=self.topic.durability,
            depth=self.depth,
            deadline_ns=self.deadline_ns,
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class Plan:
    """Rates and depths of all topics."""

    topics: tuple[TopicPlan, ...]  #: Each topic's part, in the order given.
    method: str  #: Who found it.
    medium: Medium  #: The link that was reckoned with.
    vendor: Vendor  #: The timing that was reckoned with.
    #: Largest share of a sender's time that is taken, repeats and acknowledgements included; above 1, queues
    #: grow without end.
    utilisation: float
    #: What the programme maximises: mean by weight of r t / (1 + r t), the share of time in which the value
    #: sent last is still true, t being the mean time between changes.
    freshness: float
    latency_s: float  #: Mean by weight of the topics' latencies.
    up_to_date: float  #: Mean by weight of the topics' shares.
    #: What a second of mean latency cost, in freshness; None where no programme was solved.
    latency_price_hz: float | None = None
    #: What one more share of a sender's time would have brought, in the objective: the capacity's dual value;
    #: None where no programme was solved.
    airtime_price: float | None = None

    def __getitem__(self, name: str) -> TopicPlan:
        """Return a topic's part.

        Raises:
            UnknownTopicError: There is no such topic; says which there are.
        """
        for part in self.topics:
            if part.topic.name == name:
                return part
        known = ", ".join(part.topic.name for part in self.topics)
        raise UnknownTopicError(f"topic: given {name!r}, planned are {known}")

    def qos(self, name: str) -> QoSProfile:
        """Return the profile of a topic's writer and reader."""
        return self[name].qos

    @property
    def rates_hz(self) -> NDArray[np.float64]:
        """Rates in the order of the topics, shape (n,)."""
        return np.array([part.rate_hz for part in self.topics])


def assess(  # noqa: PLR0913 - a plan's parts, by keyword
    topics: Sequence[Topic],
    medium: Medium,
    vendor: Vendor,
    *,
    rates_hz: NDArray[np.float64],
    depths: NDArray[np.int64],
    method: str,
) -> Plan:
    """Return rates and depths with what the link's arithmetic expects of them.

    Args:
        topics: The topics.
        medium: The link.
        vendor: Timing of the protocol.
        rates_hz: Of each topic, shape (n,).
        depths: Of each topic, shape (n,).
        method: Who found them.
    """
    rates_hz = np.asarray(rates_hz, float)
    link = at_depths(link_of(topics, medium, vendor), depths, rates_hz)
    latency_s = _latency_s(link, depths, rates_hz)
    losses = expected_losses(link, depths, rates_hz)
    per_change = rates_hz * link.arriving * np.array([t.change_s for t in topics])
    true_when_sent = per_change * -np.expm1(-1 / per_change)  # periodic samples, changes at random times
    up_to_date = true_when_sent * np.exp(-latency_s / np.array([t.change_s for t in topics]))
    weights = np.array([t.weight for t in topics])
    return Plan(
        topics=tuple(
            TopicPlan(
                topic=t, rate_hz=float(r), depth=int(d), latency_s=float(s), up_to_date=float(u), loss=float(p)
            )
            for t, r, d, s, u, p in zip(topics, rates_hz, depths, latency_s, up_to_date, losses, strict=True)
        ),
        method=method,
        medium=medium,
        vendor=vendor,
        utilisation=float(link.utilisation(rates_hz).max()),
        freshness=float(np.average(per_change / (1 + per_change), weights=weights)),
        latency_s=float(np.average(latency_s, weights=weights)),
        up_to_date=float(np.average(up_to_date, weights=weights)),
    )


def plan_as_printed(given: TopicFile) -> Plan:
    """Return the plan of paper B's own problem (`balancing`): one rate and one depth for all, the link unseen.

    Rmax is the largest rate that any topic could have; the depth is rounded down.

    Args:
        given: Topics and link; T_a counts the topics of each of its agents.

    Raises:
        InfeasibleBalanceError: No rate and depth satisfy the printed constraints.
    """
    rate_max_hz = max(t.rate_max_hz for t in given.topics)
    found = balance(BalanceInput(topics=given.topics_of_agents(), rate_max_hz=rate_max_hz))
    return assess(
        given.topics,
        given.medium,
        given.vendor,
        rates_hz=np.full(len(given.topics), found.rate_hz),
        depths=np.full(len(given.topics), int(found.depth + 1e-6)),  # a solver's 5 may be 4.9999999
        method="printed",
    )


def _latency_s(link: Link, depths: NDArray[np.int64], rates_hz: NDArray[np.float64]) -> NDArray[np.float64]:
    sent_hz = link.sent_hz(rates_hz)
    repairs = repair_delay_s(link, sent_hz, inverse=np.reciprocal)
    # A request names only so many samples; where a period brings more, the reader falls behind until what it
    # asks for is overwritten. Nothing waits longer than that.
    within = sent_hz * link.period_s
    behind = (depths > within) & (within > link.nack_most) & (link.loss > 0)
    gone_s = depths / sent_hz
    bounded = np.where(behind, gone_s, np.minimum(repairs, gone_s))
    return np.asarray(link.way_s + np.where(link.batching, bounded, repairs) + waits_s(link, rates_hz))
