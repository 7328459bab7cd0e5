"""Predictions of paper C's stated speed-ups out of sample: each from priors and the other numbers alone.

A fit of six constants to seven numbers agrees with nearly any. So every number is left out once: the constants
get log-normal priors from what is known of such boards, the other six numbers narrow them (as exact as `NOISE`
says), and the one left out is predicted, with intervals of the linearised posterior (Laplace's approximation on
logarithms). So a measurement on a board is worth by how much it would narrow the prediction.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING

import numpy as np

from sfglab.soc.memory import STORED, Costs, with_values
from sfglab.soc.paper_values import PAPER_VALUES, Panel, residuals, speed_ups

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    Floats = NDArray[np.float64]

#: Relative error of model and stated number together, one standard deviation: assumed.
NOISE = 0.05
BOARD_NOISE = 0.02  #: The same of a measurement on a board: assumed.
_Z = 1.96
_STEP = 1e-4


@dataclass(frozen=True, slots=True)
class Prior:
    """What is known of a constant beside the paper's numbers: log-normal."""

    median: float  #: In the constant's unit.
    factor: float  #: 95 % lie between median / factor and median * factor.
    source: str  #: Where it comes from, or that it is assumed.


PRIORS = {
    "read_latency_cycles": Prior(
        30, 3, "assumed: 100 to 900 ns from a request to DDR4's first word"
    ),
    "write_latency_cycles": Prior(
        15, 4, "assumed: buffered by the port (Xilinx UG1085) to as slow as a read"
    ),
    "delegate_s": Prior(80e-6, 4, "assumed: two thread switches on a Cortex-A53"),
    "publish_s": Prior(80e-6, 4, "assumed: as a delegate's round trip"),
    "publish_s_per_byte": Prior(1e-9, 4, "assumed: a Cortex-A53 copies 0.25 to 4 GB/s"),
    "deliver_s": Prior(80e-6, 4, "assumed: waking one reader"),
    "deliver_s_per_byte": Prior(0.5e-9, 8, "assumed: between a loan and two copies"),
    "endpoint_s": Prior(200e-6, 10, "assumed: nothing is known"),
    "cancel_s": Prior(160e-6, 4, "assumed: two round trips to the delegate"),
}
"""Constants that are not known; width, clock, chunk and control cycles are the reference design's."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Prediction:
    """A stated number as the priors and the other numbers predict it."""

    panel: Panel  #: Whose speed-up.
    text: str  #: How the paper puts it.
    paper: float  #: The paper's number.
    value: float  #: Predicted.
    low: float  #: Lower end of the 95 % interval.
    high: float  #: Upper end.
    decider: str  #: The single measurement on a board that would narrow it most.
    narrowed: tuple[float, float]  #: The interval's ends then, were its middle the same.

    @property
    def covers(self) -> bool:
        """Whether the paper's number lies in the interval."""
        return self.low <= self.paper <= self.high

    def __str__(self) -> str:
        return (
            f"{self.value:.3g} [{self.low:.3g}, {self.high:.3g}] for {self.paper:g} ({self.text})"
        )


@cache
def predictions(start: Costs = STORED) -> tuple[Prediction, ...]:
    """Return every stated number left out once, in the order of `PAPER_VALUES`; some tenths of a second."""
    best, _ = _posterior(start, _medians(), range(len(PAPER_VALUES)))
    return tuple(_predicted(start, best, left_out) for left_out in range(len(PAPER_VALUES)))


def _medians() -> Floats:
    return np.log([prior.median for prior in PRIORS.values()])


def _costs(start: Costs, logs: Floats) -> Costs:
    return with_values(start, dict(zip(PRIORS, np.exp(logs).tolist(), strict=True)))


def _log_numbers(costs: Costs) -> Floats:
    return np.log([item.model for item in residuals(costs)])


def _log_times(costs: Costs) -> Floats:
    return np.log([time_s for bar in speed_ups(costs) for time_s in (bar.smt_s, bar.gateway_s)])


def _posterior(start: Costs, logs: Floats, kept: range | list[int]) -> tuple[Floats, Floats]:
    """Return the most likely logarithms of the constants, and their covariance."""
    from scipy.optimize import least_squares

    stated = np.log([item.value for item in PAPER_VALUES])[list(kept)]
    spread = np.log([prior.factor for prior in PRIORS.values()]) / _Z

    def errors(logs: Floats) -> Floats:
        found = _log_numbers(_costs(start, logs))[list(kept)]
        return np.concatenate([(found - stated) / NOISE, (logs - _medians()) / spread])

    found = least_squares(errors, logs, xtol=1e-6, ftol=1e-6)
    return found.x, np.linalg.inv(found.jac.T @ found.jac)


def _gradient(function: Callable[[Costs], Floats], start: Costs, logs: Floats) -> Floats:
    """Return derivatives by the constants' logarithms, shape (values, constants)."""
    steps = _STEP * np.eye(len(logs))
    return np.array(
        [
            (function(_costs(start, logs + s)) - function(_costs(start, logs - s))) / (2 * _STEP)
            for s in steps
        ]
    ).T


def _predicted(start: Costs, best: Floats, left_out: int) -> Prediction:
    logs, covariance = _posterior(
        start, best, [i for i in range(len(PAPER_VALUES)) if i != left_out]
    )
    middle = float(_log_numbers(_costs(start, logs))[left_out])
    g = _gradient(_log_numbers, start, logs)[left_out]
    # Each constant measured by itself, and each time of Fig. 6 and 7, of which ratios alone are stated.
    candidates = np.vstack([np.eye(len(logs)), _gradient(_log_times, start, logs)])
    shared, own = candidates @ covariance @ g, np.sum(candidates @ covariance * candidates, axis=1)
    gains = shared**2 / (own + BOARD_NOISE**2)
    variance = float(g @ covariance @ g)
    item = PAPER_VALUES[left_out]
    low, high = _interval(middle, variance)
    return Prediction(
        panel=item.panel,
        text=item.text,
        paper=item.value,
        value=math.exp(middle),
        low=low,
        high=high,
        decider=_candidate_names()[int(np.argmax(gains))],
        narrowed=_interval(middle, variance - float(gains.max())),
    )


def _interval(middle: float, variance: float) -> tuple[float, float]:
    half = _Z * math.sqrt(max(variance, 0.0) + NOISE**2)
    return math.exp(middle - half), math.exp(middle + half)


def _candidate_names() -> list[str]:
    times = [
        f"time from {bar.panel.value}, {bar.message_bytes} B, {bar.subscribers} nodes, {way}"
        for bar in speed_ups()
        for way in ("software-mapped", "through the gateway")
    ]
    return [*PRIORS, *times]
