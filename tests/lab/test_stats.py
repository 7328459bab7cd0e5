"""Estimates agree with closed forms, and their intervals cover what they should."""

from itertools import product

import numpy as np
import pandas as pd
import pytest
import scipy.stats

from sfglab.errors import InvalidValueError
from sfglab.lab.stats import (
    bootstrap,
    difference_of,
    lack_of_fit,
    median_of,
    paired_ratios,
    share_of,
)


@pytest.mark.slow
def test_the_interval_of_a_median_covers_the_truth_about_95_times_of_100():
    rng = np.random.default_rng(0)
    covered = 0
    for _ in range(200):
        estimate = median_of(rng.normal(5, 1, 60), unit="x")
        covered += estimate.low <= 5 <= estimate.high
    assert 180 <= covered <= 200


def test_an_interval_is_repeated_and_groups_are_resampled_apart():
    groups = [np.arange(5.0), np.arange(10.0, 30.0)]

    def ratio(g):
        return float(g[0].mean() / g[1].mean())

    first = bootstrap(groups, ratio, unit="1")
    assert first == bootstrap(groups, ratio, unit="1")
    assert first.low < first.value < first.high
    assert str(first).startswith("0.103 1 [")


def test_empty_groups_and_undefined_statistics_are_refused():
    with pytest.raises(InvalidValueError, match="no samples"):
        bootstrap([np.array([])], lambda g: float(g[0].mean()), unit="x")
    with pytest.raises(InvalidValueError, match="statistic is finite"):
        bootstrap([np.ones(3)], lambda _: float("nan"), unit="x")


@pytest.mark.parametrize(
    ("of", "runs", "low", "high"),
    [(81, 263, 0.2553, 0.3662), (0, 20, 0.0, 0.1611), (20, 20, 0.8389, 1.0)],
)
def test_an_interval_of_a_share_is_wilsons(of, runs, low, high):
    """The values of R. G. Newcombe, Statistics in Medicine 17 (1998), pages 857 to 872, table I."""
    share = share_of(of, runs, unit="1")
    assert (share.value, share.low, share.high) == pytest.approx((of / runs, low, high), abs=1e-4)


@pytest.mark.parametrize(
    ("more", "less", "low", "high"),
    [
        ((56, 70), (48, 80), 0.0524, 0.3339),
        ((9, 10), (3, 10), 0.1705, 0.8090),
        ((10, 10), (0, 20), 0.6791, 1.0),
    ],
)
def test_an_interval_of_a_difference_is_newcombes(more, less, low, high):
    """The values of R. G. Newcombe, Statistics in Medicine 17 (1998), pages 873 to 890, table II, method 10."""
    one, other = (share_of(*pair, unit="1") for pair in (more, less))
    found = difference_of(one, other, unit="1")
    assert (found.low, found.high) == pytest.approx((low, high), abs=1e-4)


def test_the_lack_of_fit_of_a_constant_is_the_analysis_of_variance_and_needs_replicates():
    groups = [np.array([1.0, 1.3, 0.8]), np.array([2.0, 1.7]), np.array([1.1, 1.4, 1.2, 0.9])]
    errors, setting = np.concatenate(groups), np.repeat([4, 2, 9], [3, 2, 4])
    found = lack_of_fit(errors - errors.mean(), setting, parameters=1)
    assert (found.f, found.p, *found.freedom) == pytest.approx(
        (*scipy.stats.f_oneway(*groups), 2, 6)
    )
    for alone, many in ((np.arange(9), 1), (setting, 3), (np.zeros(9), 1)):
        assert lack_of_fit(errors, alone, parameters=many) is None


def test_paired_ratios_are_those_of_the_medians_and_leave_out_what_lacks_a_partner():
    places = product(range(20), (1, 2), (("slow", 4.0), ("fast", 1.0)))
    rows = [
        (repeat, size, name, size * times * (repeat + 9)) for repeat, size, (name, times) in places
    ]
    rows.append((20, 1, "slow", 1e6))
    frame = pd.DataFrame(rows, columns=["repeat", "size", "transport", "s"])
    found = paired_ratios(
        frame, by=["size"], pair="transport", order=("slow", "fast"), values=["s"]
    )
    assert found["repeats"].to_list() == [20, 20]
    assert found["ratio"].to_list() == pytest.approx([4, 4])
    assert (found["slow"] / found["fast"]).to_list() == pytest.approx([4, 4])
    assert (found["low"] <= found["ratio"]).all()
    assert (found["ratio"] <= found["high"]).all()
