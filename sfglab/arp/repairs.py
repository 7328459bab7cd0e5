"""The module `repairs` computes how long one loss delays a topic until the retransmission, for each kind of heartbeats.

*Riding* heartbeats travel with samples: with every sample, so that the next sample shows a loss, or with one sample
in `depth`. Cyclone DDS sends a heartbeat with every sample, and so does a TRANSIENT_LOCAL writer of Fast DDS once its
history has filled. A VOLATILE writer of Fast DDS sends a heartbeat with one sample in `depth`: the writer removes
acknowledged samples, and a heartbeat travels with a sample while the writer's history is full. Samples of a VOLATILE
writer of Fast DDS then come in batches of `depth`.

*Alone* heartbeats travel without a sample, once per period of the writer, if samples are rarer or the history does
not fill in time.

The delays are of first order in losses: gaps that overlap count as separate gaps. The argument `loss` is the share of
frames that the medium loses. Compared with `sfglab.rtps` at 1 % loss, delays are within 20 % if no sample is published
during a retransmission and batches have at most 12 samples. At 10 % loss delays are 0.9 to 2.5 times the simulated
delays if the history holds the rounds of retransmissions, as the history of a plan does. A shallower history overwrites
samples that others wait for, so the computed delays are too long: eighteenfold with Cyclone DDS, a depth of 2, 80 Hz
and 10 % loss.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple


class Held(NamedTuple):
    """A `Held` is the mean delay of other samples by one loss: T + r T^2 = spread / r + fixed + growing r."""

    spread: float  #: Part of the delay that falls with the rate, without unit.
    fixed: float  #: Part of the delay that does not depend on the rate, seconds.
    growing: float  #: Part of the delay that grows with the rate, seconds squared.


def failing_share(loss: Any) -> Any:
    """Return the share of lost samples whose one retransmission fails: a retransmission needs three frames."""
    return 1 - (1 - loss) ** 3


def riding_held(batch: int, round_s: float, again_s: float, loss: float) -> Held:
    """Return how long one loss delays other samples if a heartbeat travels with one sample in `batch`.

    Rounds follow each other until one succeeds, so their number N has a geometric distribution:
    T = N m / r + N c + (N - 1) a. A heartbeat comes after m samples in the mean: the last sample of a batch of d
    samples carries it, so sample j waits for d - j others, and the last sample for one. The retransmission arrives the
    time c after the heartbeat (`round_s`). The reader waits the additional time a before it requests the same samples
    again (`again_s`).
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
    """Return how long one loss delays other samples if heartbeats travel without samples.

    The arguments are the topic's rate (Hz), the period of heartbeats (s), the time from a heartbeat to the
    retransmission (s), and the share of lost frames.

    The writer's timer starts with the first unacknowledged sample, and the samples of the timer's period wait for the
    end of the period. After a failed retransmission samples wait for another whole period.
    """
    samples = rate_hz * period_s
    more = math.floor(samples)
    # These are means of w / h and (w / h)^2 over the samples 0 .. more of a period; sample i waits h - i / r.
    wait = 1 - more / (2 * samples)
    square = 1 - more / samples + more * (2 * more + 1) / (6 * samples**2)
    fails = failing_share(loss)
    once, again = wait * period_s + round_s, period_s + round_s
    once_square = square * period_s**2 + 2 * wait * period_s * round_s + round_s**2
    rounds = fails / (1 - fails)
    rounds_square = fails * (1 + fails) / (1 - fails) ** 2
    fixed = once + rounds * again
    growing = once_square + 2 * once * rounds * again + rounds_square * again**2
    if rate_hz * growing < fixed:  # Only the lost sample waits: T, not T / 2 + r T^2 / 2.
        return Held(0.0, 2 * fixed, 0.0)
    return Held(0.0, fixed, growing)
