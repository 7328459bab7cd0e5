"""Repairs: how long one loss holds up a topic, and what stays lost, for each way that heartbeats come.

*Steady*: a heartbeat rides with every sample, so that the next one shows a loss. Cyclone DDS does so, and a
TRANSIENT_LOCAL writer of Fast DDS once its history has filled.

*Batches*: it rides once in `depth` samples. A Fast DDS writer lets one ride while its history is full, and a
VOLATILE one drops what is acknowledged. Sample j of a batch 1..d waits (d - j) / r for that, and is overwritten
j / r afterwards (KEEP_LAST): of r c samples that are published during a repair's delays c, as many at the head
of each batch are lost for good. A repair that is itself lost is asked for again when the history is full once
more, d - 1 samples after the sample.

*Alone*: it comes with the writer's period, where samples are rarer or the history does not fill in time.

First order in losses: gaps that overlap are counted one by one, and no more than a second repair is reckoned in
batches. Against `sfglab.rtps` with 1 % loss, delays are right to 20 % where r c < 1 and depths are 12 at most;
with 10 % loss and with deep histories they lie above the simulated ones, up to fourfold. `loss` is the share of
frames that the medium loses. Refuses to know links and topics.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

CANDIDATES = (2, 3, 4, 6, 8, 12, 16)
"""Depths that are tried where heartbeats come in batches: one alone repairs nothing, and the deeper it is,
the longer a loss holds up what follows."""


class Held(NamedTuple):
    """By how much one loss holds up others: T + r T^2 = spread / r + fixed + growing r, in the mean."""

    spread: float  #: Without unit.
    fixed: float  #: Seconds.
    growing: float  #: Seconds squared.


def one_repair_loss(loss: float) -> float:
    """Return the share of samples that stays lost with one repair each, of three frames."""
    return loss * (1 - (1 - loss) ** 3)


@lru_cache(maxsize=4096)
def batch_loss(depth: int, during: int, loss: float) -> float:
    """Return which share of samples stays lost with d kept and `during` published in a repair, expected."""
    place, first = _places(depth)
    # Each sample from the d-th on carries a heartbeat until a request comes, as the history stays full.
    tries = np.maximum(place + depth - during - first, 0)
    unasked = (1 - (1 - loss) ** 2) ** tries
    again = (during == 0) & (place + depth - 1 > first)
    stays = np.where(again, 1 - (1 - loss) ** 3, 1.0)
    return float(loss * np.mean(unasked + (1 - unasked) * loss * stays))


def random_batch_loss(depth: int, during: float, loss: float) -> float:
    """Return the same where samples come at random: a Poisson number, in the mean `during`, in a repair."""
    few, chances = np.arange(depth), np.empty(depth)
    chances[0] = math.exp(-during)
    for n in few[1:]:
        chances[n] = chances[n - 1] * during / n
    losses = np.array([batch_loss(depth, int(n), loss) for n in few])
    return float(chances @ losses + (1 - chances.sum()) * loss)


def steady_held(round_s: float, again_s: float, loss: float) -> Held:
    """Return by how much one loss holds up others where the next sample shows it.

    Rounds follow each other until one succeeds, so that their number N is geometric:
    T = N / r + N c + (N - 1) a, with c from a heartbeat to the repair's arrival (`round_s`), and a what the
    reader waits besides before it asks for the same again (`again_s`).
    """
    q = (1 - loss) ** 2
    n, n2 = 1 / q, (2 - q) / q**2
    each = round_s + again_s
    delay, delay2 = n * each - again_s, n2 * each**2 - 2 * n * each * again_s + again_s**2
    return Held(n + n2, delay + 2 * (n2 * each - n * again_s), delay2)


@lru_cache(maxsize=4096)
def batch_held(depth: int, round_s: float, loss: float) -> Held:
    """Return the same where a history must fill first, and does before the periodic heartbeat comes.

    A repair takes T = k / r + n c: k samples until its heartbeat, n rounds of delays. One sample alone holds up
    nothing: the next one shows at once that it is gone.
    """
    if depth == 1:
        return Held(0.0, 0.0, 0.0)
    place, first = _places(depth)
    waited = (first - place).astype(float)
    arrives = 1 - loss
    ways = (
        (arrives**3, waited, 1),
        (
            1 - arrives**2,
            waited + 1,
            2,
        ),  # heartbeat or request lost: the next sample carries a heartbeat
        (
            arrives**2 * loss,
            np.maximum(waited + 1, depth - 1),
            2,
        ),  # the repair lost: when full again
    )
    means = np.array([[k.mean(), (k**2).mean(), n, n * k.mean(), n**2] for _, k, n in ways])
    k, k2, n, kn, n2 = np.array([chance for chance, *_ in ways]) @ means
    return Held(float(k + k2), float(n + 2 * kn) * round_s, float(n2) * round_s**2)


def alone_held(rate_hz: float, period_s: float, round_s: float, loss: float) -> Held:
    """Return the same where heartbeats come alone.

    The writer's timer starts with the first sample that is unacknowledged, and the samples of its period wait
    for its end; after a repair that failed, a whole period more.
    """
    samples = rate_hz * period_s
    more = math.floor(samples)
    # Means of w / h and (w / h)^2 over the samples 0 .. more of a period, of which the i-th waits h - i / r.
    wait = 1 - more / (2 * samples)
    square = 1 - more / samples + more * (2 * more + 1) / (6 * samples**2)
    fails = 1 - (1 - loss) ** 3
    once, again = wait * period_s + round_s, period_s + round_s
    once_square = square * period_s**2 + 2 * wait * period_s * round_s + round_s**2
    more_rounds, more_squares = fails / (1 - fails), fails * (1 + fails) / (1 - fails) ** 2
    mean = once + more_rounds * again
    return Held(0.0, mean, once_square + 2 * once * more_rounds * again + more_squares * again**2)


def _places(depth: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return samples' places in their batch, and the next from the d-th whose heartbeat shows one missing."""
    place = np.arange(1, depth + 1)
    return place, np.maximum(depth, place + 1)
