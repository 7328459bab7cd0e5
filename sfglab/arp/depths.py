"""How deep histories should be: as shallow as the allowed loss lets them, because what is deeper waits longer.

Knows the link's arithmetic and the rates. Refuses to know how rates are found.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from sfglab.arp.link import at_depths, queue_wait_s, repair_delay_s, waits_s
from sfglab.arp.repairs import CANDIDATES, batch_loss, one_repair_loss, random_batch_loss
from sfglab.qos import SENSOR_DATA

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from sfglab.arp.link import Link


_MOST = 1e6


def depths_for(link: Link, rates_hz: NDArray[np.float64], *, residual_loss: float) -> NDArray[np.int64]:
    """Return how deep histories should be, shape (n,).

    Where a heartbeat rides with every sample, what is published while a sample waits for k repairs must fit
    beside it: k samples until their heartbeats, and r times the delays, with twice the queue's wait each; k
    follows from the losses (`rounds_needed`). No deeper, as then samples are repaired that nobody wants any
    more, which hold up newer ones.

    Where heartbeats come once in `depth` samples, depth delays repairs. Of a few candidates the one with the
    least expected latency is taken among those that keep to the allowed loss; if none does, among those that
    lose no more than one repair of every loss would leave; if none does, the one that loses least. Behind a
    local cache samples are states, and what a newer one has replaced is no loss: there the wait for the next
    sample counts as the latency of what is lost.

    Best-effort topics get the depth of rmw's profile for sensors.

    Args:
        link: The link.
        rates_hz: Of each topic, shape (n,).
        residual_loss: Share of samples that may stay lost.
    """
    rounds = rounds_needed(link.loss, residual_loss)
    during = np.minimum(link.sent_hz(rates_hz) * _rounds_s(link, rates_hz, rounds), _MOST)
    steady = np.ceil(during) + 1
    depths = np.where(link.reliable, steady, SENSOR_DATA.depth).astype(np.int64)
    if link.batching.any():
        depths[link.batching] = _batch_depths(link, rates_hz, residual_loss)[link.batching]
    return depths


def expected_losses(
    link: Link, depths: NDArray[np.int64], rates_hz: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return which share of each topic's samples never comes because the medium loses frames, shape (n,).

    Args:
        link: The link.
        depths: Of each topic, shape (n,).
        rates_hz: Of each topic, shape (n,).
    """
    sent_hz = link.sent_hz(rates_hz)
    losses = np.full(len(depths), link.loss)
    during = np.minimum(sent_hz * (link.round_s + _SLACK * waits_s(link, rates_hz)), _MOST)
    rounds = np.zeros(len(depths))
    for k in range(1, 9):  # more rounds than that leave nothing that matters
        rounds[depths > sent_hz * _rounds_s(link, rates_hz, k)] = k
    failing = 1 - (1 - link.loss) ** 2
    for i in np.flatnonzero(link.reliable):
        depth = int(depths[i])
        if not link.batching[i]:
            losses[i] = link.loss * failing ** rounds[i]
        elif np.isfinite(link.change_most_hz[i]):
            losses[i] = random_batch_loss(depth, during[i], link.loss)
        else:
            losses[i] = batch_loss(depth, int(during[i]), link.loss)
    return losses


def rates_most_hz(link: Link, *, utilisation: float) -> NDArray[np.float64]:
    """Return up to which rates the allowed loss can be kept, infinite where any can, shape (n,).

    Where heartbeats come in batches, a sample that is published during a repair is one that is lost for good at
    the head of every batch, so there must be none: r c < 1. Behind a local cache that is no loss
    (`depths_for`).

    Args:
        link: The link.
        utilisation: Share of each sender's time that is taken, at most: decides how long frames wait.
    """
    bounded = link.batching & ~np.isfinite(link.change_most_hz) & (link.loss > 0)
    taken = np.full(len(link.senders), utilisation)
    wait_s = queue_wait_s(taken, link, inverse=np.reciprocal)[link.sender]
    return np.where(bounded, (1 - 1e-9) / (link.round_s + _SLACK * wait_s), math.inf)


def rounds_needed(loss: float, residual_loss: float) -> int:
    """Return how many repairs a sample must be able to wait for: p f^k <= residual loss, at least one.

    Args:
        loss: p, share of frames that the medium loses; f = 1 - (1 - p)^2 is a repair's.
        residual_loss: Share of samples that may stay lost.
    """
    if loss <= residual_loss:
        return 1
    return max(1, math.ceil(math.log(residual_loss / loss) / math.log(1 - (1 - loss) ** 2)))


_SLACK = 4.0
"""Mean waits in queues that a repair may meet on its three ways before it is too late."""


def _rounds_s(link: Link, rates_hz: NDArray[np.float64], rounds: int) -> NDArray[np.float64]:
    """Return how long so many repairs, one after the other, take where heartbeats are steady."""
    shown_s = np.minimum(1 / link.sent_hz(rates_hz), link.period_s)
    each = shown_s + link.round_s + 2 * waits_s(link, rates_hz)
    return np.asarray(rounds * each + (rounds - 1) * link.again_s)


def _batch_depths(link: Link, rates_hz: NDArray[np.float64], residual_loss: float) -> NDArray[np.int64]:
    """Return the best candidate for each topic, shape (n,)."""
    sent_hz = link.sent_hz(rates_hz)
    losses, delays = [], []
    for depth in CANDIDATES:
        depths = np.full(len(rates_hz), depth)
        losses.append(expected_losses(link, depths, rates_hz))
        delays.append(repair_delay_s(at_depths(link, depths, rates_hz), sent_hz, inverse=np.reciprocal))
    loss, delay_s = np.array(losses), np.array(delays)
    states = np.isfinite(link.change_most_hz)
    chosen = np.argmin(delay_s + loss / sent_hz, axis=0)
    for i in np.flatnonzero(~states):
        limits = [residual_loss, one_repair_loss(link.loss), float(loss[:, i].min())]
        allowed = next(a for limit in limits if (a := loss[:, i] <= limit * (1 + 1e-9)).any())
        chosen[i] = np.argmin(np.where(allowed, delay_s[:, i], math.inf))
    return np.asarray(np.array(CANDIDATES)[chosen])
