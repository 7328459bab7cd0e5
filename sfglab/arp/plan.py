"""Plan of the QoS: rate and depth of each topic, what the link's arithmetic expects of them, the best depths.

Whoever found the rates, they are judged alike: share of the medium, latency, and the share of time in which the
reader holds a value that is still true. Histories are as shallow as the allowed loss lets them be, because what
is deeper waits longer. Arrays have an entry for each topic, shape (n,).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from sfglab.arp.balancing import BalanceInput, balance
from sfglab.arp.link import Link, at_depths, link_of, queue_wait_s, repair_delay_s, waits_s
from sfglab.arp.repairs import CANDIDATES, batch_loss, one_repair_loss, random_batch_loss
from sfglab.errors import InvalidValueError, SfglabError
from sfglab.fields import between, check_bounds
from sfglab.qos import SENSOR_DATA, QoSProfile

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from sfglab.arp.topics import Topic, TopicFile
    from sfglab.rtps import Medium, Vendor


class InfeasiblePlanError(SfglabError, ValueError):
    """The topics' minimal rates alone take more airtime than there is."""

    def __init__(
        self, sender: str, needed: float, allowed: float, largest: tuple[str, ...]
    ) -> None:
        self.sender = sender  #: Whose time it is: the medium's where it is shared, else a host's.
        self.needed = needed  #: Share of its time that the minimal rates take.
        self.allowed = allowed  #: Share that may be planned.
        self.largest = largest  #: Names of the topics that take most, the most first.
        super().__init__(sender, needed, allowed, largest)

    @property
    def lacking(self) -> float:
        """By how much the share exceeds what is allowed."""
        return self.needed - self.allowed

    def __str__(self) -> str:
        return (
            f"QoS plan has no solution: the minimal rates take {self.needed:.3g} of the time of {self.sender}, "
            f"allowed is {self.allowed:.3g}, so {self.lacking:.3g} is lacking; most is taken by "
            f"{', '.join(self.largest)}: lower minimal rates (to {self.allowed / self.needed:.2g} of them if "
            "all alike), send fewer topics, or use a faster link"
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class Limits:
    """What a plan must keep to."""

    #: The most of a sender's time to be taken.
    utilisation_max: float = between(0.9, 0, 1, without=(0, 1))
    #: Share of samples that may stay lost after repairs, where a history can keep it; a plan says what it
    #: expects (`TopicPlan.loss`).
    residual_loss: float = between(1e-4, 0, 1, without=(0, 1))

    def __post_init__(self) -> None:
        check_bounds(self)


_MOST = 1e6


def depths_for(
    link: Link, rates_hz: NDArray[np.float64], *, residual_loss: float
) -> NDArray[np.int64]:
    """Return how deep histories should be at these rates.

    Where a heartbeat rides with every sample, what is published while a sample waits for k repairs must fit
    beside it: k samples until their heartbeats, and r times the delays, with twice the queue's wait each; k
    follows from the losses (`rounds_needed`). No deeper: that repairs what nobody wants any more, before what
    is newer.

    Where heartbeats come once in `depth` samples, depth delays repairs. Of a few candidates the one with the
    least expected latency is taken among those that keep to the allowed loss; if none does, among those that
    lose no more than one repair of every loss would leave; if none does, the one that loses least. Behind a
    local cache what a newer state has replaced is no loss: the wait for the next counts as its latency.
    Best-effort topics get the depth of rmw's profile for sensors.
    """
    rounds = np.array([rounds_needed(float(loss), residual_loss) for loss in link.loss])
    during = np.minimum(link.sent_hz(rates_hz) * _rounds_s(link, rates_hz, rounds), _MOST)
    steady = np.ceil(during) + 1
    depths = np.where(link.reliable, steady, SENSOR_DATA.depth).astype(np.int64)
    if link.batching.any():
        depths[link.batching] = _batch_depths(link, rates_hz, residual_loss)[link.batching]
    return depths


def expected_losses(
    link: Link, depths: NDArray[np.int64], rates_hz: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return which share of each topic's samples never comes because the medium loses frames."""
    sent_hz = link.sent_hz(rates_hz)
    losses = link.loss.copy()
    during = np.minimum(sent_hz * (link.round_s + _SLACK * waits_s(link, rates_hz)), _MOST)
    rounds = np.zeros(len(depths))
    for k in range(1, 9):  # more rounds than that leave nothing that matters
        rounds[depths > sent_hz * _rounds_s(link, rates_hz, k)] = k
    failing = 1 - (1 - link.loss) ** 2
    for i in np.flatnonzero(link.reliable):
        depth = int(depths[i])
        if not link.batching[i]:
            losses[i] *= failing[i] ** rounds[i]
        elif np.isfinite(link.change_most_hz[i]):
            losses[i] = random_batch_loss(depth, during[i], float(link.loss[i]))
        else:
            losses[i] = batch_loss(depth, int(during[i]), float(link.loss[i]))
    return losses


def rates_most_hz(link: Link, *, utilisation: float) -> NDArray[np.float64]:
    """Return up to which rates the allowed loss can be kept, infinite where any can.

    Where heartbeats come in batches, a sample that is published during a repair is one that is lost for good at
    the head of every batch, so there must be none: r c < 1. Behind a local cache that is no loss
    (`depths_for`). The share of each sender's time that is taken, at most, decides how long frames wait.
    """
    bounded = link.batching & ~np.isfinite(link.change_most_hz) & (link.loss > 0)
    wait_s = queue_wait_s(np.full(len(link.senders), utilisation), link, inverse=np.reciprocal)[
        link.sender
    ]
    return np.where(bounded, (1 - 1e-9) / (link.round_s + _SLACK * wait_s), math.inf)


def rounds_needed(loss: float, residual_loss: float) -> int:
    """Return how many repairs a sample must await: loss (1 - (1 - loss)^2)^k <= residual loss, 1 at least."""
    if loss <= residual_loss:
        return 1
    return max(1, math.ceil(math.log(residual_loss / loss) / math.log(1 - (1 - loss) ** 2)))


#: Mean waits in queues that a repair may meet on its three ways before it is too late.
_SLACK = 4.0


def _rounds_s(
    link: Link, rates_hz: NDArray[np.float64], count: int | NDArray[np.int64]
) -> NDArray[np.float64]:
    """Return how long so many repairs, one after the other, take where heartbeats are steady."""
    shown_s = np.minimum(1 / link.sent_hz(rates_hz), link.period_s)
    each = shown_s + link.round_s + 2 * waits_s(link, rates_hz)
    return np.asarray(count * each + (count - 1) * link.again_s)


def _batch_depths(
    link: Link, rates_hz: NDArray[np.float64], residual_loss: float
) -> NDArray[np.int64]:
    """Return the best candidate for each topic, shape (n,)."""
    sent_hz = link.sent_hz(rates_hz)
    losses, delays = [], []
    for depth in CANDIDATES:
        depths = np.full(len(rates_hz), depth)
        losses.append(expected_losses(link, depths, rates_hz))
        delays.append(
            repair_delay_s(at_depths(link, depths, rates_hz), sent_hz, inverse=np.reciprocal)
        )
    loss, delay_s = np.array(losses), np.array(delays)
    states = np.isfinite(link.change_most_hz)
    chosen = np.argmin(delay_s + loss / sent_hz, axis=0)
    for i in np.flatnonzero(~states):
        limits = [residual_loss, one_repair_loss(float(link.loss[i])), float(loss[:, i].min())]
        allowed = next(a for limit in limits if (a := loss[:, i] <= limit * (1 + 1e-9)).any())
        chosen[i] = np.argmin(np.where(allowed, delay_s[:, i], math.inf))
    return np.asarray(np.array(CANDIDATES)[chosen])


@dataclass(frozen=True, slots=True, kw_only=True)
class TopicPlan:
    """One topic's part of a plan."""

    topic: Topic  #: The topic.
    rate_hz: float  #: How often it is sent.
    depth: int  #: History of its writer and of its reader.
    #: Mean time from publication to delivery, expected; infinite on an overloaded medium.
    latency_s: float
    #: Share of time in which the reader holds the value that the sensor has, expected.
    up_to_date: float
    loss: float  #: Share of samples that never come because the medium loses frames, expected.

    @property
    def deadline_ns(self) -> int | None:
        """The longest gap to agree on: the history's length in time, depth / rate; None behind a local cache.

        A DEADLINE of one period would be missed by every jitter and every repair; after depth / rate a missing
        sample comes no more. What a cache holds back leaves gaps of any length.
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
        """Return a topic's part; the InvalidValueError for one that is not there says which there are."""
        parts = {part.topic.name: part for part in self.topics}
        if name not in parts:
            raise InvalidValueError("topic of the plan", name, ", ".join(parts))
        return parts[name]

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
    """Return rates and depths, which a method found, with what the link's arithmetic expects of them."""
    rates_hz = np.asarray(rates_hz, float)
    link = at_depths(link_of(topics, medium, vendor), depths, rates_hz)
    latency_s = _latency_s(link, depths, rates_hz)
    losses = expected_losses(link, depths, rates_hz)
    per_change = rates_hz * link.arriving * np.array([t.change_s for t in topics])
    true_when_sent = per_change * -np.expm1(
        -1 / per_change
    )  # periodic samples, changes at random times
    up_to_date = true_when_sent * np.exp(-latency_s / np.array([t.change_s for t in topics]))
    weights = np.array([t.weight for t in topics])
    return Plan(
        topics=tuple(
            TopicPlan(
                topic=t,
                rate_hz=float(r),
                depth=int(d),
                latency_s=float(s),
                up_to_date=float(u),
                loss=float(p),
            )
            for t, r, d, s, u, p in zip(
                topics, rates_hz, depths, latency_s, up_to_date, losses, strict=True
            )
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

    Rmax is the largest rate that any topic could have, T_a counts an agent's topics; the depth is rounded down.

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


def _latency_s(
    link: Link, depths: NDArray[np.int64], rates_hz: NDArray[np.float64]
) -> NDArray[np.float64]:
    sent_hz = link.sent_hz(rates_hz)
    repairs = repair_delay_s(link, sent_hz, inverse=np.reciprocal)
    # A request names only so many samples; where a period brings more, the reader falls behind until what it
    # asks for is overwritten. Nothing waits longer than that.
    within = sent_hz * link.period_s
    behind = (depths > within) & (within > link.nack_most) & (link.loss > 0)
    gone_s = depths / sent_hz
    bounded = np.where(behind, gone_s, np.minimum(repairs, gone_s))
    return np.asarray(
        link.way_s + np.where(link.batching, bounded, repairs) + waits_s(link, rates_hz)
    )
