"""Retransmissions: how long one loss holds up a topic, for each way that heartbeats come.

*Riding*: a heartbeat rides with every sample, so that the next sample shows a loss, or with one sample in
`depth`. Cyclone DDS does the first, and so does a TRANSIENT_LOCAL writer of Fast DDS once its history has
filled. A VOLATILE writer of Fast DDS does the second: it removes what is acknowledged, and a heartbeat rides
while its history is full. Its samples then come in batches of `depth`.

*Alone*: it comes with the writer's period, where samples are rarer or the history does not fill in time.

First order in losses: gaps that overlap are counted one by one. `loss` is the share of frames that the medium
loses. Against `sfglab.rtps` with 1 % loss, delays are right to 20 % where no sample is published during a
retransmission and batches have at most 12 samples. With 10 % loss they are 0.9 to 2.5 times the simulated ones
where the history holds the rounds of retransmissions, as that of a plan does. A shallower one overwrites what
others wait for, so delays are too long: eighteenfold with Cyclone DDS, a depth of 2, 80 Hz and 10 % loss.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple


class Held(NamedTuple):
    """By how much one loss holds up others: T + r T^2 = spread / r + fixed + growing r, in the mean."""

    spread: float  #: Without unit.
    fixed: float  #: Seconds.
    growing: float  #: Seconds squared.


def failing_share(loss: Any) -> Any:
    """Return the share of lost samples that one retransmission does not bring back: it needs three frames."""
    return 1 - (1 - loss) ** 3


def riding_held(batch: int, round_s: float, again_s: float, loss: float) -> Held:
    """Return by how much one loss holds up others where a heartbeat rides with one sample in `batch`.

    Rounds follow each other until one succeeds, so that their number N is geometric:
    T = N m / r + N c + (N - 1) a. A heartbeat comes after m samples in the mean: the last of a batch of d carries
    it, so that sample j waits for d - j others, the last for one. The retransmission comes c after the heartbeat
    (`round_s`). The reader waits a longer before it requests the same again (`again_s`).
    """
    succeeds = (1 - loss) ** 2
    n = 1 / succeeds
    n2 = (2 - succeeds) / succeeds**2
    m = (batch - 1) / 2 + 1 / batch
    each = round_s + again_s
    delay = n * each - again_s
    growing = n2 * each**2 - 2 * n * each * again_s + again_s**2
    return Held(n * m + n2 * m**2, delay + 2 * m * (n2 * each - n * again_s), growing)


def alone_held(rate_hz: float, period_s: float, round_s: float, loss: float) -> Held:
    """Return the same where heartbeats come alone.

    The writer's timer starts with the first sample that is unacknowledged, and the samples of its period wait
    for its end; after a retransmission that failed, a whole period more.
    """
    samples = rate_hz * period_s
    more = math.floor(samples)
    # Means of w / h and (w / h)^2 over the samples 0 .. more of a period, of which the i-th waits h - i / r.
    wait = 1 - more / (2 * samples)
    square = 1 - more / samples + more * (2 * more + 1) / (6 * samples**2)
    fails = failing_share(loss)
    once, again = wait * period_s + round_s, period_s + round_s
    once_square = square * period_s**2 + 2 * wait * period_s * round_s + round_s**2
    rounds = fails / (1 - fails)
    rounds_square = fails * (1 + fails) / (1 - fails) ** 2
    fixed = once + rounds * again
    growing = once_square + 2 * once * rounds * again + rounds_square * again**2
    if rate_hz * growing < fixed:  # the lost sample alone waits: T, not T / 2 + r T^2 / 2
        return Held(0.0, 2 * fixed, 0.0)
    return Held(0.0, fixed, growing)
