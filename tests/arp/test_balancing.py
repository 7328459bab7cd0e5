"""Paper B, Eq. 1 to 6: the solver finds the closed form, and says what is impossible."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sfglab.arp.balancing import (
    BalanceInput,
    InfeasibleBalanceError,
    balance,
    balance_closed_form,
)
from sfglab.errors import InvalidValueError

EXPERIMENT = (7, 6, 6)  # section 3.1: six, five and five sensors, and one localisation result each


@pytest.mark.parametrize(
    ("rate_max_hz", "rate_hz", "depth"),
    [(100, 14.789, 738.5), (1000, 156.895, 783.5)],
)
def test_optimum_for_the_papers_rates_with_rmin_1(rate_max_hz, rate_hz, depth):
    found = balance(BalanceInput(topics=EXPERIMENT, rate_max_hz=rate_max_hz))
    assert found.rate_hz == pytest.approx(rate_hz, abs=1e-3)
    assert found.depth == pytest.approx(depth, abs=0.1)


@settings(max_examples=40, deadline=None)
@given(
    topics=st.lists(st.integers(1, 30), min_size=1, max_size=6).map(tuple),
    rate_max_hz=st.floats(100, 5000),
    rate_min_hz=st.floats(0.1, 1.5),
    weight=st.floats(0.05, 0.95),
)
def test_solver_and_closed_form_agree_whatever_the_weight(topics, rate_max_hz, rate_min_hz, weight):
    problem = BalanceInput(topics=topics, rate_max_hz=rate_max_hz, rate_min_hz=rate_min_hz)
    exact, found = balance_closed_form(problem), balance(problem, weight=weight)
    assert found.rate_hz == pytest.approx(exact.rate_hz, rel=1e-4, abs=1e-3)
    assert found.depth == pytest.approx(exact.depth, rel=1e-4, abs=1e-2)


@pytest.mark.parametrize(
    ("values", "says"),
    [
        ({"rate_min_hz": 10}, r"Eq\. 4.*lacks 4\.21.*raise Rmax to 126"),
        ({"depth_max": 10, "depth_min": 3}, r"Eq\. 5"),
    ],
)
def test_an_infeasible_problem_names_its_equation_and_what_would_help(values, says):
    with pytest.raises(InfeasibleBalanceError, match=says):
        balance(BalanceInput(topics=EXPERIMENT, rate_max_hz=100, **values))


@pytest.mark.parametrize("values", [{"topics": (3, 0)}, {"rate_min_hz": 0}, {"depth_min": 6000}])
def test_meaningless_input_is_refused(values):
    with pytest.raises(InvalidValueError):
        BalanceInput(**{"topics": (3,), "rate_max_hz": 100} | values)
