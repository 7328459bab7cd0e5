"""Freshness of what a reader has: how old it is, and for how long it is what the sensor says now."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from sfglab.units import NS_PER_S

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from sfglab.rtps import Flow, FlowOutcome


def age_ms(outcome: FlowOutcome, *, duration_s: float) -> float:
    """Return the age of information at a reader, mean over the time of publishing, milliseconds.

    It is how long ago the newest sample that it has was published; before it has any, the time since the start
    (S. Kaul, R. Yates and M. Gruteser, Real-time status: How often should one update?, INFOCOM 2012).
    """
    order = np.argsort(outcome.received_ns[outcome.delivered], kind="stable")
    received_s = outcome.received_ns[outcome.delivered][order] / NS_PER_S
    newest_s = np.maximum.accumulate(outcome.published_ns[outcome.delivered][order] / NS_PER_S)
    times = np.concatenate(([0.0], np.minimum(received_s, duration_s), [duration_s]))
    since = np.concatenate(([0.0], newest_s))
    area = ((times[1:] - since) ** 2 - (times[:-1] - since) ** 2).sum() / 2
    return float(1e3 * area / duration_s)


def up_to_date(flow: Flow, outcome: FlowOutcome, *, duration_s: float) -> float:
    """Return the share of time in which the reader has the value that the sensor has now.

    At a reading the sensor's value is known: that of the last sample published, held back or not. Until the
    next reading it stays with probability exp(-t / change_s), as changes come at random; that is integrated.
    """
    # In whole nanoseconds, as the model schedules: rounding adds up, and a reading must not precede its sample.
    first_ns, period_ns = round(flow.phase_s * NS_PER_S), round(NS_PER_S / flow.rate_hz)
    readings = np.arange(first_ns, round(duration_s * NS_PER_S), period_ns) / NS_PER_S
    received = outcome.received_ns[outcome.delivered] / NS_PER_S
    times = np.unique(np.concatenate([readings, received[received < duration_s], [duration_s]]))
    starts, ends = times[:-1], times[1:]
    read_at = readings[np.maximum(np.searchsorted(readings, starts, side="right") - 1, 0)]
    # Nanoseconds are rounded where the model schedules; half of one is far below any period.
    published = outcome.published_ns / NS_PER_S - 1 / NS_PER_S
    true = _last(outcome.value, published, read_at)
    known = _last(outcome.value[outcome.delivered], received, starts)
    since, until = starts - read_at, ends - read_at
    stays = flow.change_s * (np.exp(-since / flow.change_s) - np.exp(-until / flow.change_s))
    return float(stays[(true == known) & (known >= 0)].sum() / duration_s)


def _last(values: NDArray[np.int32], since: NDArray[np.float64], at: NDArray[np.float64]) -> NDArray[np.int64]:
    """Return the value at each time; -1 before the first."""
    place = np.searchsorted(since, at, side="right") - 1
    if not len(values):
        return np.full(len(at), -1)
    return np.where(place >= 0, values[place], -1)
