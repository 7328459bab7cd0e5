"""The module `plan` plans QoS: rate and depth of each topic, with the effects that the link's arithmetic predicts.

All methods' plans are assessed with the same values: share of the medium, latency, and the share of time in which the
reader holds a value that is still true. Histories are as shallow as the allowed loss permits, because samples in a
deeper history wait longer. Arrays have one entry per topic, shape (n,).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from sfglab.arp.balancing import BalanceInput, balance_closed_form
from sfglab.arp.link import Link, at_depths, link_of, queue_wait_s, repair_delay_s, wait_s
from sfglab.arp.repairs import failing_share
from sfglab.qos import SENSOR_DATA, QoSProfile

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from sfglab.arp.topics import Topic, TopicFile
    from sfglab.rtps import Medium, Vendor

    Floats = NDArray[np.float64]
    Depths = NDArray[np.int64]

BATCH_DEPTH = 4
"""Depth of a history if a heartbeat travels with every `depth`-th sample. Behind a loss a deeper history delays more
samples; in a shallower history a retransmission that is lost itself comes too late."""
_BATCH_DEPTH_LEAST = 2  # A history of one sample loses the sample before its retransmission.

_DURING_MOST = 1e6  #: Largest number of samples during retransmissions in the arithmetic.
_WAITS_PER_ROUND = 2  #: Number of waits in queues on the ways of a request and its retransmission.
#: Number of mean queue waits that a retransmission may meet on its three ways before the retransmission is too late.
_SLACK = 4.0
#: Used share of the highest rate, because depths and waits differ a little from the arithmetic.
_RATE_MARGIN = 0.99
_HALVINGS = 40  #: Number of bisection steps over a share.


def depths_for(link: Link, rates_hz: Floats, *, residual_loss: float) -> Depths:
    """Return the depths of the topics' histories, samples, shape (n,), for given rates, Hz, shape (n,).

    If a heartbeat travels with every sample, a history holds a sample and the samples that are published while this
    sample waits for k retransmissions: k samples until the heartbeats, and r times the delays, each with twice the
    queue's wait; `rounds_needed` derives k from the losses. A deeper history would retransmit outdated samples before
    newer samples. If a heartbeat travels with every `depth`-th sample, histories have `BATCH_DEPTH` samples, or the
    samples of a heartbeat's period if the period has fewer samples. Best-effort topics get the depth of rmw's profile
    for sensors.
    """
    rounds = np.array([rounds_needed(float(loss), residual_loss) for loss in link.loss])
    sent_hz = link.sent_hz(rates_hz)
    rounds_s = rounds * _round_s(link, rates_hz) + (rounds - 1) * link.again_s
    during = np.minimum(sent_hz * rounds_s, _DURING_MOST)
    in_batches = np.clip(np.floor(sent_hz * link.period_s), _BATCH_DEPTH_LEAST, BATCH_DEPTH)
    depths = np.where(link.batching, in_batches, np.ceil(during) + 1)
    return np.where(link.reliable, depths, SENSOR_DATA.depth).astype(np.int64)


def expected_losses(link: Link, depths: Depths, rates_hz: Floats) -> Floats:
    """Return the expected share of each topic's samples that is never delivered because the medium loses frames.

    Depths (samples), rates (Hz) and shares have shape (n,), one value per topic.

    If heartbeats come in batches, a batch loses at its head as many samples as are published during a
    retransmission. A batch also loses each later sample whose one retransmission fails.
    """
    sent_hz = link.sent_hz(rates_hz)
    # `rounds` is the largest number of rounds that take less time than the history lasts.
    longer_s = depths / sent_hz + link.again_s
    rounds = np.ceil(longer_s / (_round_s(link, rates_hz) + link.again_s)) - 1
    failing = 1 - (1 - link.loss) ** 2
    steady = link.loss * failing ** np.maximum(rounds, 0)
    during = np.minimum(sent_hz * _repair_s(link, wait_s(link, rates_hz)), _DURING_MOST)
    # Periodic samples are published during a retransmission in whole numbers, changes at random in the mean.
    overwritten = np.where(link.cached, during, np.floor(during)) / depths
    in_batches = link.loss * np.minimum(1.0, overwritten + failing_share(link.loss))
    repaired = np.where(link.batching, in_batches, steady)
    return np.where(link.reliable, repaired, link.loss)


def rates_most_hz(link: Link, highest_hz: Floats, *, utilisation_max: float) -> Floats:
    """Return the highest rates, Hz, shape (n,), that keep the allowed loss, on a link `at_depths` of batches.

    The argument `highest_hz` has the rates that other bounds allow, shape (n,).

    If heartbeats come in batches, a sample that is published during a retransmission is lost. Therefore no sample may
    be published during a retransmission: r c < 1. With a local cache a newer state has replaced the lost sample. The
    wait of frames depends on the rates, so a bisection finds the utilisation that fits its own rates.
    """
    bounded = link.batching & ~link.cached & (link.loss > 0)
    if not bounded.any():
        return highest_hz
    low, high = 0.0, utilisation_max
    for _ in range(_HALVINGS):
        middle = (low + high) / 2
        if link.utilisation(_rates_at_hz(link, highest_hz, middle, bounded)) > middle:
            low = middle
        else:
            high = middle
    return _rates_at_hz(link, highest_hz, high, bounded)


def _rates_at_hz(
    link: Link, highest_hz: Floats, utilisation: float, bounded: NDArray[np.bool_]
) -> Floats:
    """Return the highest rates at a channel utilisation; `bounded` tells which topics have batches to protect."""
    waiting_s = queue_wait_s(utilisation, link, inverse=np.reciprocal)
    most_hz = np.minimum(highest_hz, _RATE_MARGIN / _repair_s(link, waiting_s))
    return np.where(bounded, most_hz, highest_hz)


def _repair_s(link: Link, waiting_s: float) -> Floats:
    """Return how long a retransmission takes after the heartbeat, with slack for longer queues."""
    return link.round_s + _SLACK * waiting_s


def rounds_needed(loss: float, residual_loss: float) -> int:
    """Return how many retransmissions k the history must wait for, at least 1.

    k is the smallest number with loss (1 - (1 - loss)^2)^k <= residual loss; both losses are shares.
    """
    if loss <= residual_loss:
        return 1
    return max(1, math.ceil(math.log(residual_loss / loss) / math.log(1 - (1 - loss) ** 2)))


def _round_s(link: Link, rates_hz: Floats) -> Floats:
    """Return the time of one round if a heartbeat travels with every sample."""
    shown_s = np.minimum(1 / link.sent_hz(rates_hz), link.period_s)
    return np.asarray(shown_s + link.round_s + _WAITS_PER_ROUND * wait_s(link, rates_hz))


@dataclass(frozen=True, slots=True, kw_only=True)
class TopicPlan:
    """A `TopicPlan` is one topic's part of a plan."""

    topic: Topic  #: Topic of the plan.
    rate_hz: float  #: Planned number of samples per second, Hz.
    depth: int  #: Depth of the writer's and the reader's history.
    #: Expected mean time from publication to delivery, seconds; infinite on an overloaded medium.
    latency_s: float
    #: Expected share of time in which the reader holds the value that the sensor has.
    up_to_date: float
    loss: float  #: Expected share of samples that never arrive because the medium loses frames.

    @property
    def deadline_ns(self) -> int | None:
        """DEADLINE: largest agreed gap between samples, ns: the length of the history in time; None with a local cache.

        Any jitter and any retransmission would exceed a DEADLINE of one period. After depth / rate a missing
        sample no longer arrives. With a local cache gaps can have any length.
        """
        if self.topic.cached:
            return None
        return max(1, round(1e9 * max(self.depth, 2) / self.rate_hz))

    @property
    def qos(self) -> QoSProfile:
        """QoS of the writer and of the reader; equal profiles always match."""
        return QoSProfile(
            reliability=self.topic.reliability,
            durability=self.topic.durability,
            depth=self.depth,
            deadline_ns=self.deadline_ns,
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class Plan:
    """A `Plan` has the rates and depths of all topics."""

    topics: tuple[TopicPlan, ...]  #: Each topic's part, in the order given.
    method: str  #: Method that found the plan.
    medium: Medium  #: Link that the plan assumes.
    vendor: Vendor  #: Timing that the plan assumes.
    #: Channel utilisation: share of the medium's time that samples, repeats and acknowledgements take. Above 1,
    #: queues grow without limit.
    utilisation: float
    #: Objective without latency: weighted mean of r t / (1 + r t), the share of time in which the value
    #: sent last is still true, with the rate r and the mean time t between changes.
    freshness: float
    latency_s: float  #: Weighted mean of the topics' latencies, seconds.
    #: Weighted mean of the topics' shares of time in which readers are up to date.
    up_to_date: float
    #: Freshness that one second of mean latency costs, 1/s; None if no optimisation problem was solved.
    latency_price_hz: float | None = None


def assess(given: TopicFile, rates_hz: Floats, depths: Depths, *, method: str) -> Plan:
    """Return a plan with given rates and depths, and with its predicted effects on the link.

    Args:
        given: Topics and link.
        rates_hz: Rate of each topic, Hz, shape (n,).
        depths: History depth of each topic, samples, shape (n,).
        method: Name of the method that found them.

    Raises:
        InvalidValueError: The link loses too many of a topic's samples.
    """
    link = at_depths(link_of(given), depths, rates_hz)
    change_s = np.array([topic.change_s for topic in given.topics])
    weights = np.array([topic.weight for topic in given.topics])
    latency_s = _latency_s(link, depths, rates_hz)
    losses = expected_losses(link, depths, rates_hz)
    per_change = rates_hz * link.arriving * change_s
    arriving = rates_hz * (1 - losses) * change_s
    # The formula takes samples as periodic and changes as random in time.
    true_when_sent = arriving * -np.expm1(-1 / arriving)
    up_to_date = true_when_sent * np.exp(-latency_s / change_s)
    columns = [column.tolist() for column in (rates_hz, depths, latency_s, up_to_date, losses)]
    parts = []
    for topic, rate, depth, latency, share, loss in zip(given.topics, *columns, strict=True):
        part = TopicPlan(
            topic=topic,
            rate_hz=rate,
            depth=depth,
            latency_s=latency,
            up_to_date=share,
            loss=loss,
        )
        parts.append(part)
    return Plan(
        topics=tuple(parts),
        method=method,
        medium=given.medium,
        vendor=given.vendor,
        utilisation=link.utilisation(rates_hz),
        freshness=float(np.average(per_change / (1 + per_change), weights=weights)),
        latency_s=float(np.average(latency_s, weights=weights)),
        up_to_date=float(np.average(up_to_date, weights=weights)),
    )


def plan_as_printed(given: TopicFile) -> Plan:
    """Return the plan of paper B's own problem (`balancing`): one rate and one depth for all topics, without the link.

    Rmax is the largest rate that any topic may have, T_a is the number of an agent's topics, and the depth is rounded
    down.

    Raises:
        InfeasibleBalanceError: No rate and depth satisfy the published constraints.
        InvalidValueError: The link loses too many of a topic's samples.
    """
    rate_max_hz = max(t.rate_max_hz for t in given.topics)
    topics = given.topics_of_agents()
    found = balance_closed_form(BalanceInput(topics=topics, rate_max_hz=rate_max_hz))
    count = len(given.topics)
    depth = int(round(found.depth, 6))  # The digits after the sixth digit are noise.
    rates_hz = np.full(count, found.rate_hz)
    depths = np.full(count, depth)
    return assess(given, rates_hz, depths, method="paper")


def _latency_s(link: Link, depths: Depths, rates_hz: Floats) -> Floats:
    sent_hz = link.sent_hz(rates_hz)
    repairs = repair_delay_s(link, sent_hz, inverse=np.reciprocal)
    # A request names a limited number of samples. If a period brings more samples, the reader falls behind until the
    # samples that the reader requests are overwritten. No sample waits longer than the history lasts.
    within = sent_hz * link.period_s
    behind = (depths > within) & (within > link.nack_most) & (link.loss > 0)
    gone_s = depths / sent_hz
    bounded = np.where(behind, gone_s, np.minimum(repairs, gone_s))
    return np.asarray(
        link.way_s + np.where(link.batching, bounded, repairs) + wait_s(link, rates_hz)
    )
