"""The module `prediction` predicts each number that paper C states in section 4 from the other six numbers.

The project fitted six constants of the memory model to the seven numbers, so the agreement of model and paper
shows little. A prediction of a number shows more, because the predicted number does not take part in the fit. The
module leaves out each number in turn:

1. Log-normal `PRIORS` describe nine constants with knowledge that does not use the paper's numbers. Six of the nine
   constants are the fitted constants of `sfglab.soc.memory.FITTED`. The other three constants are assumed constants:
   the read latency, the call of a delegate and the publication. A prediction treats an assumed constant as
   uncertain too. The constants of the reference design have no prior.
2. The other six numbers narrow the priors to a posterior distribution of the constants. A number may differ from the
   model by the relative error `NOISE`. The posterior is Laplace's approximation: a normal distribution of the
   constants' logarithms, linearised at the distribution's maximum.
3. The posterior gives the model's value of the number that was left out. The paper's number differs from the model's
   value by `NOISE` as well, so the 95 % interval contains `NOISE` a second time.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from sfglab.soc.memory import STORED
from sfglab.soc.paper_values import STATED, stated_by_model

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    Floats = NDArray[np.float64]

#: Assumed relative error of model and stated number together, one standard deviation.
NOISE = 0.05
_Z = 1.96  # A normal distribution has 95 % of its values within this number of standard deviations.
_STEP = 1e-4  # step of finite differences of logarithms


@dataclass(frozen=True, slots=True)
class Prior:
    """A `Prior` is the log-normal distribution of a constant without knowledge of the paper's numbers."""

    median: float  #: Median, in the constant's unit.
    #: Factor of the 95 % interval, which reaches from median / factor to median * factor.
    factor: float


PRIORS = {
    "read_latency_cycles": Prior(30, 3),  # DDR4's first word comes 100 to 900 ns after a request
    # A write response can come from the port's buffer (Xilinx UG1085), or take as long as a read.
    "write_latency_cycles": Prior(15, 4),
    "delegate_s": Prior(80e-6, 4),  # a call takes two thread switches on a Cortex-A53
    "publish_s": Prior(80e-6, 4),  # a publication is like a delegate's round trip
    "publish_s_per_byte": Prior(1e-9, 4),  # a Cortex-A53 copies 0.25 to 4 GB/s
    "deliver_s": Prior(80e-6, 4),  # a delivery wakes one subscriber
    "deliver_s_per_byte": Prior(0.5e-9, 8),  # a delivery makes no copy (loan) to two copies
    "endpoint_s": Prior(200e-6, 10),  # no knowledge limits the time of an endpoint
    "cancel_s": Prior(160e-6, 4),  # a cancellation takes two round trips to the delegate
}
"""`PRIORS` has an assumed prior for each of the six fitted and the three assumed constants."""

_MEDIANS = np.log([prior.median for prior in PRIORS.values()])
_DEVIATIONS = np.log([prior.factor for prior in PRIORS.values()]) / _Z


@dataclass(frozen=True, slots=True, kw_only=True)
class Prediction:
    """A `Prediction` of one number of `STATED` follows from the priors and the other numbers."""

    value: float  #: Median of the predicted number.
    low: float  #: Lower end of the 95 % interval.
    high: float  #: Upper end of the 95 % interval.


def predictions(numbers: Sequence[float]) -> list[Prediction]:
    """Predict each of the numbers in `STATED` from the other numbers; the prediction takes about a second.

    Args:
        numbers: Numbers that the paper states, in the order of `STATED`.
    """
    logs = np.log(numbers)
    # The result does not depend on the start of the search, so the number that is left out has no influence.
    start, _ = _posterior(logs, list(range(len(STATED))), _MEDIANS)
    return [_prediction(logs, left_out, start) for left_out in range(len(STATED))]


def _prediction(logs: Floats, left_out: int, start: Floats) -> Prediction:
    others = [i for i in range(len(STATED)) if i != left_out]
    best, covariance = _posterior(logs, others, start)
    middle = float(_log_numbers(best)[left_out])
    slope = _slopes(best)[left_out]
    model_variance = float(slope @ covariance @ slope)
    half = _Z * math.sqrt(model_variance + NOISE**2)
    return Prediction(
        value=math.exp(middle), low=math.exp(middle - half), high=math.exp(middle + half)
    )


def _posterior(logs: Floats, kept: list[int], start: Floats) -> tuple[Floats, Floats]:
    """Return the most likely logarithms of the constants, shape (9,), and the covariance of the logarithms."""
    from scipy.optimize import least_squares

    def errors(constants: Floats) -> Floats:
        by_numbers = (_log_numbers(constants) - logs)[kept] / NOISE
        by_priors = (constants - _MEDIANS) / _DEVIATIONS
        return np.concatenate([by_numbers, by_priors])

    found = least_squares(errors, start, xtol=1e-6, ftol=1e-6)
    return found.x, np.linalg.inv(found.jac.T @ found.jac)


def _log_numbers(constants: Floats) -> Floats:
    values = np.exp(constants).tolist()
    costs = replace(STORED, **dict(zip(PRIORS, values, strict=True)))
    return np.log(stated_by_model(costs))


def _slopes(constants: Floats) -> Floats:
    """Return central differences of the numbers' logarithms, shape (numbers, constants)."""
    steps = _STEP * np.eye(len(constants))
    differences = [_log_numbers(constants + s) - _log_numbers(constants - s) for s in steps]
    return np.stack(differences, axis=1) / (2 * _STEP)
