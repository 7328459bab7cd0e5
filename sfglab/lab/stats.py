"""Estimates with intervals: medians, slopes and ratios by the bootstrap, shares and differences by scores.

Intervals are percentile intervals of 2,000 seeded resamples (B. Efron and R. Tibshirani, An Introduction to
the Bootstrap, 1993, chapter 13). Intervals of shares are those of Wilson, intervals of their differences
those of Newcombe.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from sfglab.errors import InvalidValueError

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    import pandas as pd

Floats = NDArray[np.float64]
RESAMPLES = 2000
#: Approximate number of rows that are drawn at once from one group; they fit into the processor's cache.
_AT_ONCE = 1 << 14
INTERVAL = (2.5, 97.5)
_Z = 1.959963984540054  # standard score of a 95 % interval


@dataclass(frozen=True, slots=True, kw_only=True)
class Estimate:
    """An estimate with its 95 % confidence interval."""

    value: float  #: Estimate from all samples.
    low: float  #: Lower end of the interval.
    high: float  #: Upper end of the interval.
    unit: str  #: Unit of estimate and interval.

    def __str__(self) -> str:
        return f"{rounded(self.value)} {self.unit} [{rounded(self.low)}, {rounded(self.high)}]"


def rounded(value: float) -> str:
    """Return a number with three significant digits, without an exponent up to a million."""
    return f"{float(f'{value:.3g}'):g}"


def exactly(value: float, unit: str) -> Estimate:
    """Return an estimate without an interval: a count, a share of checks, or a computed value."""
    return Estimate(value=value, low=value, high=value, unit=unit)


def bootstrap(
    samples: Sequence[Floats],
    statistic: Callable[[Sequence[Floats]], float],
    *,
    unit: str,
) -> Estimate:
    """Estimate a statistic of several groups of samples; its interval is that of a bootstrap.

    The bootstrap resamples the rows of each group. Resamples for which the statistic is NaN are left out.

    Args:
        samples: Samples of each group, shape (n, ...).
        statistic: Function from the groups to a number.
        unit: Unit of the statistic.

    Raises:
        InvalidValueError: A group is empty, or no resample gave a number.
    """
    return _bootstrap(samples, lambda drawn: [statistic([group[0] for group in drawn])], unit)


def _bootstrap(
    samples: Sequence[Floats],
    statistics: Callable[[Sequence[Floats]], Sequence[float] | Floats],
    unit: str,
    at_once: int = 1,
) -> Estimate:
    """Estimate as `bootstrap`; `statistics` returns shape (m,) for m resamples at once, each shape (m, n, ...)."""
    if any(len(group) == 0 for group in samples):
        raise InvalidValueError("bootstrap", "a group of no samples", "groups of samples")
    rng = np.random.default_rng(0)
    found = list[float]()
    for begin in range(0, RESAMPLES, at_once):
        many = min(at_once, RESAMPLES - begin)
        found.extend(statistics([g[rng.integers(0, len(g), (many, len(g)))] for g in samples]))
    draws = np.array(found)
    draws = draws[np.isfinite(draws)]
    if draws.size == 0:
        raise InvalidValueError("bootstrap", samples, "samples for which the statistic is finite")
    low, high = np.percentile(draws, INTERVAL)
    value = statistics([group[None] for group in samples])[0]
    return Estimate(value=float(value), low=float(low), high=float(high), unit=unit)


def _rows_at_once(rows: Floats) -> int:
    return 1 + _AT_ONCE // max(1, len(rows))


def median_of(samples: Floats | Sequence[float], *, unit: str) -> Estimate:
    """Estimate the median of samples, shape (n,), n at least 1."""
    group = np.asarray(samples, dtype=np.float64)
    return _bootstrap(
        [group], lambda drawn: np.median(drawn[0], axis=1), unit, _rows_at_once(group)
    )


def ratio_of(pairs: Floats, middle: Callable[..., Any], *, unit: str) -> Estimate:
    """Estimate the ratio of two columns' means or medians (`np.mean` or `np.median`), resampling pairs.

    The pairs have shape (n, 2), n at least 1.
    """

    def ratios(drawn: Sequence[Floats]) -> Floats:
        first, second = middle(drawn[0], axis=1).T
        return first / second  # type: ignore[no-any-return]

    return _bootstrap([pairs], ratios, unit, _rows_at_once(pairs))


def paired_ratios(
    table: pd.DataFrame,
    *,
    by: Sequence[str],
    pair: str,
    order: tuple[str, str],
    values: Sequence[str],
) -> pd.DataFrame:
    """Estimate ratios of medians of paired measurements, resampling the pairs of each group.

    Args:
        table: One row per measurement. Rows of a group with equal values of ``repeat`` are a pair.
        by: Columns whose values identify a group.
        pair: Column with the condition of a measurement.
        order: The two conditions, numerator first.
        values: Columns with measured values. Each of them gets a ratio.

    Returns:
        One row per group and value. Its columns are those of `by`, ``value`` with the name of the measured
        column, the medians under both conditions, ``ratio``, ``low`` and ``high`` of its 95 % interval, and
        ``repeats``.

    Raises:
        KeyError: A group was measured under one of the conditions only.
    """
    import pandas as pd

    rows = []
    for group, measured in table.groupby([*by]):
        for value in values:
            pivot = measured.pivot_table(index="repeat", columns=pair, values=value)
            pairs = pivot[[*order]].dropna()
            ratio = ratio_of(pairs.to_numpy(), np.median, unit="times")
            interval = ratio.value, ratio.low, ratio.high
            rows.append((*group, value, *pairs.median(), *interval, len(pairs)))
    return pd.DataFrame(rows, columns=[*by, "value", *order, "ratio", "low", "high", "repeats"])


def line_slope(x: Floats, y: Floats) -> float:
    """Return the slope of the least-squares line through x and y, shape (n,); NaN if x is constant."""
    spread = np.sum((x - x.mean()) ** 2)
    return float(np.sum((x - x.mean()) * (y - y.mean())) / spread) if spread else math.nan


@dataclass(frozen=True, slots=True, kw_only=True)
class LackOfFit:
    """Result of an F test: whether a model's errors are larger than the differences between replicates."""

    f: float  #: F statistic: mean square of the lack of fit over that of the pure error.
    freedom: tuple[int, int]  #: Degrees of freedom of both mean squares.
    p: float  #: Probability of this or a larger F statistic if the model is right.

    def __str__(self) -> str:
        return f"F({self.freedom[0]}, {self.freedom[1]}) = {self.f:.2f}, p = {self.p:.2g}"


def lack_of_fit(
    errors: Floats, setting: NDArray[np.integer], *, parameters: int
) -> LackOfFit | None:
    """Test a fit against the pure error (N. Draper and H. Smith, Applied Regression Analysis, 1998, chapter 2).

    Errors, shape (n,), have equal variance if the model is right. Equal numbers in `setting`, shape (n,),
    mark replicates. `parameters` is the number of the model's parameters. The result is None if no
    replicates differ, or if there are not more settings than parameters.
    """
    from scipy.stats import f as f_distribution

    _, of, size = np.unique(setting, return_inverse=True, return_counts=True)
    means = np.bincount(of, errors) / size
    freedom = len(size) - parameters, len(errors) - len(size)
    pure = float(np.sum((errors - means[of]) ** 2))
    if min(freedom) < 1 or pure == 0:
        return None
    ratio = (float(np.sum(errors**2)) - pure) / freedom[0] / (pure / freedom[1])
    return LackOfFit(f=ratio, freedom=freedom, p=float(f_distribution.sf(ratio, *freedom)))


def wilson(successes: float, runs: int) -> tuple[float, float]:
    """Return the 95 % interval of a share, which is also valid at 0 and 1 (E. B. Wilson, JASA 22, 1927)."""
    share, z2 = successes / runs, _Z**2
    middle = (share + z2 / (2 * runs)) / (1 + z2 / runs)
    half = _Z / (1 + z2 / runs) * math.sqrt(share * (1 - share) / runs + z2 / (4 * runs**2))
    # At 0 and 1, one end is the share itself up to rounding.
    return max(0.0, min(share, middle - half)), min(1.0, max(share, middle + half))


def share_of(successes: float, runs: int, *, unit: str) -> Estimate:
    """Estimate a share with Wilson's interval; `runs` is at least 1."""
    low, high = wilson(successes, runs)
    return Estimate(value=successes / runs, low=low, high=high, unit=unit)


def difference_of(more: Estimate, less: Estimate, *, unit: str) -> Estimate:
    """Estimate a difference of shares of independent runs, both of them results of `share_of`.

    The interval is method 10 of R. G. Newcombe, Statistics in Medicine 17 (1998), pages 873 to 890.
    """
    value = more.value - less.value
    low = value - math.hypot(more.value - more.low, less.high - less.value)
    high = value + math.hypot(more.high - more.value, less.value - less.low)
    return Estimate(value=value, low=low, high=high, unit=unit)
