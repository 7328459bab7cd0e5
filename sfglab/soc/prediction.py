"""Predictions of the numbers that paper C states in section 4, each from the other six.

Six constants of the memory model are fitted to seven numbers, so their agreement shows little. A
prediction shows more. Each number is left out in turn:

1. Log-normal `PRIORS` say what is known of the constants without the paper's numbers.
2. The other six numbers, exact up to `NOISE`, narrow them to a posterior distribution (Laplace's
   approximation: normal in the logarithms, linearised at its maximum).
3. The posterior gives the number that was left out with a 95 % interval.

The same distribution tells which single measurement on a board would narrow the interval most.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from sfglab.soc.memory import STORED, Costs, with_values
from sfglab.soc.paper_values import STATED, speed_ups, stated_by_model

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray

    Floats = NDArray[np.float64]

#: Assumed relative error of model and stated number together, one standard deviation.
NOISE = 0.05
#: Assumed relative error of a measurement on a board, one standard deviation.
BOARD_NOISE = 0.02
_Z = 1.96  # 95 % of a normal distribution are within so many standard deviations.
_STEP = 1e-4  # of logarithms, for derivatives


@dataclass(frozen=True, slots=True)
class Prior:
    """Log-normal distribution of a constant, as known without the paper's numbers."""

    median: float  #: Median, in the constant's unit.
    factor: float  #: 95 % lie between median / factor and median * factor.
    source: str  #: Source of both, or that they are assumed.


PRIORS = {
    "read_latency_cycles": Prior(
        30, 3, "assumed: 100 to 900 ns from a request to DDR4's first word"
    ),
    "write_latency_cycles": Prior(
        15, 4, "assumed: buffered by the port (Xilinx UG1085) to as slow as a read"
    ),
    "delegate_s": Prior(80e-6, 4, "assumed: two thread switches on a Cortex-A53"),
    "publish_s": Prior(80e-6, 4, "assumed: like a delegate's round trip"),
    "publish_s_per_byte": Prior(1e-9, 4, "assumed: a Cortex-A53 copies 0.25 to 4 GB/s"),
    "deliver_s": Prior(80e-6, 4, "assumed: one subscriber is woken"),
    "deliver_s_per_byte": Prior(0.5e-9, 8, "assumed: between a loan and two copies"),
    "endpoint_s": Prior(200e-6, 10, "assumed: nothing is known"),
    "cancel_s": Prior(160e-6, 4, "assumed: two round trips to the delegate"),
}
"""Constants that are not known, by name. The others are those of the reference design."""

_MEDIANS = np.log([prior.median for prior in PRIORS.values()])
_DEVIATIONS = np.log([prior.factor for prior in PRIORS.values()]) / _Z


@dataclass(frozen=True, slots=True, kw_only=True)
class Prediction:
    """A number of `STATED`, predicted from the priors and the other numbers."""

    value: float  #: Median.
    low: float  #: Lower end of the 95 % interval.
    high: float  #: Upper end of the 95 % interval.
    decider: str  #: Measurement on a board that would narrow the interval most.
    #: Ends of the interval after that measurement, around the same median.
    narrowed: tuple[float, float]


def predictions(numbers: Sequence[float]) -> list[Prediction]:
    """Predict each of the numbers in `STATED` from the other numbers, which takes about a second.

    Args:
        numbers: Numbers that the paper states, in the order of `STATED`.
    """
    logs = np.log(numbers)
    start, _ = _posterior(logs, list(range(len(STATED))), _MEDIANS)
    return [_prediction(logs, left_out, start) for left_out in range(len(STATED))]


def _prediction(logs: Floats, left_out: int, start: Floats) -> Prediction:
    others = [i for i in range(len(STATED)) if i != left_out]
    best, covariance = _posterior(logs, others, start)
    middle = float(_log_numbers(best)[left_out])
    # By the constants' logarithms.
    slope = _gradient(_log_numbers, best)[left_out]
    variance = float(slope @ covariance @ slope)
    low, high = _interval(middle, variance)
    # A measurement is of a constant by itself, or of a transfer time in Fig. 6 or 7.
    measured = np.vstack([np.eye(len(PRIORS)), _gradient(_log_times, best)])
    shared = measured @ covariance @ slope
    own = np.sum(measured @ covariance * measured, axis=1)
    gains = shared**2 / (own + BOARD_NOISE**2)
    return Prediction(
        value=math.exp(middle),
        low=low,
        high=high,
        decider=_measurements()[int(np.argmax(gains))],
        narrowed=_interval(middle, variance - float(gains.max())),
    )


def _posterior(logs: Floats, kept: list[int], start: Floats) -> tuple[Floats, Floats]:
    """Return the most likely logarithms of the constants, shape (9,), and their covariance."""
    from scipy.optimize import least_squares

    def errors(constants: Floats) -> Floats:
        by_numbers = (_log_numbers(constants) - logs)[kept] / NOISE
        by_priors = (constants - _MEDIANS) / _DEVIATIONS
        return np.concatenate([by_numbers, by_priors])

    found = least_squares(errors, start, xtol=1e-6, ftol=1e-6)
    return found.x, np.linalg.inv(found.jac.T @ found.jac)


def _costs(constants: Floats) -> Costs:
    values = np.exp(constants).tolist()
    return with_values(STORED, dict(zip(PRIORS, values, strict=True)))


def _log_numbers(constants: Floats) -> Floats:
    return np.log(stated_by_model(_costs(constants)))


def _log_times(constants: Floats) -> Floats:
    times_s = []
    for bar in speed_ups(_costs(constants)):
        times_s += [bar.smt_s, bar.gateway_s]
    return np.log(times_s)


def _measurements() -> list[str]:
    """Return the names of the measurements on a board: constants, then times as in `_log_times`."""
    names = list(PRIORS)
    for bar in speed_ups():
        of = f"{bar.panel.value}, {bar.message_bytes} B, {bar.subscribers} hardware subscribers"
        names += [f"time from {of}, over the topic", f"time from {of}, through the gateway"]
    return names


def _gradient(function: Callable[[Floats], Floats], at: Floats) -> Floats:
    """Return central differences of a function, shape (values, constants)."""
    steps = _STEP * np.eye(len(at))
    differences = [function(at + step) - function(at - step) for step in steps]
    return np.stack(differences, axis=1) / (2 * _STEP)


def _interval(middle: float, variance: float) -> tuple[float, float]:
    """Return the ends of the 95 % interval of a logarithm, as values."""
    half = _Z * math.sqrt(max(variance, 0.0) + NOISE**2)
    return math.exp(middle - half), math.exp(middle + half)
