"""Estimates with intervals: medians, slopes and ratios by the bootstrap.

Every figure that the ledger prints is an `Estimate`. Intervals are percentile intervals of 2,000 seeded
resamples (B. Efron and R. Tibshirani, An Introduction to the Bootstrap, 1993, chapter 13). Knows arrays;
refuses to know experiments and logs.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from sfglab.errors import SfglabError

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray

    Floats = NDArray[np.float64]


RESAMPLES = 2000
INTERVAL = (2.5, 97.5)


class StatsError(SfglabError, ValueError):
    """Too few or unusable samples for the estimate asked for."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Estimate:
    """A figure with its 95 % interval."""

    value: float  #: The estimate from all samples.
    low: float  #: Lower end of the interval.
    high: float  #: Upper end of the interval.
    unit: str  #: Unit of all three.

    def __str__(self) -> str:
        return f"{self.value:.3g} {self.unit} [{self.low:.3g}, {self.high:.3g}]"


def exactly(value: float, unit: str) -> Estimate:
    """Return a figure that has no interval: a count, a share of checks, a value by calculation."""
    return Estimate(value=value, low=value, high=value, unit=unit)


def bootstrap(
    samples: Sequence[Floats], statistic: Callable[[Sequence[Floats]], float], *, unit: str, seed: int = 0
) -> Estimate:
    """Estimate a statistic of several groups of samples, resampling the rows of each group.

    Args:
        samples: Groups, each of shape (n, ...), resampled independently of each other.
        statistic: Takes resampled groups, returns one number; a resample that gives NaN is left out.
        unit: Unit of the result.
        seed: Seed of the resampling.

    Raises:
        StatsError: A group is empty, or no resample gave a number.
    """
    if any(len(group) == 0 for group in samples):
        raise StatsError("bootstrap: a group holds no samples")
    rng = np.random.default_rng(seed)
    draws = np.array(
        [statistic([g[rng.integers(0, len(g), len(g))] for g in samples]) for _ in range(RESAMPLES)]
    )
    draws = draws[np.isfinite(draws)]
    if draws.size == 0:
        raise StatsError("bootstrap: the statistic is undefined for these samples")
    low, high = np.percentile(draws, INTERVAL)
    return Estimate(value=float(statistic(samples)), low=float(low), high=float(high), unit=unit)


def median_of(samples: Floats | Sequence[float], *, unit: str, seed: int = 0) -> Estimate:
    """Estimate the median of samples.

    Args:
        samples: Shape (n,), n at least 1.
        unit: Unit of the samples.
        seed: Seed of the resampling.
    """
    return bootstrap(
        [np.asarray(samples, dtype=np.float64)],
        lambda groups: float(np.median(groups[0])),
        unit=unit,
        seed=seed,
    )


def line_fit(x: Floats, y: Floats) -> tuple[float, float]:
    """Return slope and intercept of the least-squares line.

    Args:
        x: Shape (n,).
        y: Shape (n,).

    Returns:
        Slope and intercept; both NaN where x holds fewer than two different values.
    """
    spread = np.sum((x - x.mean()) ** 2)
    if spread == 0:
        return float("nan"), float("nan")
    slope = float(np.sum((x - x.mean()) * (y - y.mean())) / spread)
    return slope, float(y.mean() - slope * x.mean())
