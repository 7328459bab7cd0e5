"""The one fit of the model's free constants to the numbers that paper C states.

Six constants to seven ratios, by least squares on their logarithms: so nearly as many constants as numbers that
agreement shows only that the stated numbers are possible together; what is worth looking at is what was not
fitted (`stated.TENDENCIES`), and what the assumed constants change (`sensitivity`). Knows the fit; refuses to
know the paths.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from sfglab.errors import SfglabError
from sfglab.soc.memory.costs import FITTED_NAMES, STORED, Costs
from sfglab.soc.memory.stated import Residual, residuals


class FitError(SfglabError, RuntimeError):
    """The solver found no minimum."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Fit:
    """A fit and how good it is."""

    costs: Costs  #: The constants, fitted and standing.
    residuals: tuple[Residual, ...]  #: Every stated number beside the model's.
    rms: float  #: Root mean square of the residuals' logarithms.


@dataclass(frozen=True, slots=True, kw_only=True)
class Variant:
    """A fit with one assumed constant changed."""

    name: str  #: Of the constant.
    factor: float  #: By which it was multiplied.
    fit: Fit  #: What the others become, and how good that is.

    @property
    def worst(self) -> float:
        """The largest residual, relative and without sign."""
        return max(abs(item.relative) for item in self.fit.residuals)


def fit(start: Costs = STORED) -> Fit:
    """Fit `FITTED_NAMES` to `STATED`; all other constants stay.

    Args:
        start: Where the search starts, and the constants that stay.

    Raises:
        FitError: The solver did not converge.
    """
    from scipy.optimize import least_squares

    def errors(logs: list[float]) -> list[float]:
        return [math.log(item.model / item.stated) for item in residuals(_with(start, logs))]

    found = least_squares(errors, [math.log(value) for value in _values(start)], x_scale="jac", xtol=1e-12)
    if not found.success:
        raise FitError(f"fit of {', '.join(FITTED_NAMES)}: {found.message}")
    costs = _with(start, found.x)
    left = tuple(residuals(costs))
    return Fit(costs=costs, residuals=left, rms=math.sqrt(2 * found.cost / len(left)))


def sensitivity(start: Costs = STORED) -> list[Variant]:
    """Return the fits with each assumed constant halved and doubled: none of them is known well.

    Args:
        start: The constants to change.
    """
    found = []
    for factor in (0.5, 2.0):
        latency = factor * start.memory.read_latency_cycles
        variants = {
            "read_latency_cycles": replace(start, memory=replace(start.memory, read_latency_cycles=latency)),
            "delegate_s": replace(start, delegate_s=factor * start.delegate_s),
            "publish_s": replace(start, publish_s=factor * start.publish_s),
        }
        found += [Variant(name=name, factor=factor, fit=fit(costs)) for name, costs in variants.items()]
    return found


def _values(costs: Costs) -> list[float]:
    return [getattr(costs.memory if hasattr(costs.memory, name) else costs, name) for name in FITTED_NAMES]


def _with(costs: Costs, logs: list[float]) -> Costs:
    """Return the costs with the fitted constants set, given their logarithms."""
    values = {name: math.exp(log) for name, log in zip(FITTED_NAMES, logs, strict=True)}
    memory = replace(costs.memory, write_latency_cycles=values.pop("write_latency_cycles"))
    return replace(costs, memory=memory, **values)
