"""The module `balancing` has the QoS balancing that paper B publishes: section 2.4, Eq. 1 to 6, and its closed form.

The input of the balancing is the number of topics per agent. The result is a rate R (the paper's DEADLINE, in hertz)
and a depth D. The published problem has no trade-off: the bound of D rises with R, so one point has the best R and
the best D for any weights. The closed form shows that there is no trade-off. The problem contains neither links nor
losses.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from sfglab.errors import InvalidValueError, SfglabError

if TYPE_CHECKING:
    from collections.abc import Sequence

#: Dmax: largest number of samples that Fast DDS kept in 2023 (paper B, section 2.4, reference 17).
DEPTH_MAX = 5000


@dataclass(frozen=True, slots=True, kw_only=True)
class BalanceInput:
    """A `BalanceInput` is the input of the published problem.

    Raises:
        InvalidValueError: An agent has no topics, or a lower limit is not positive or above its upper limit.
    """

    #: Number of topics of each agent, T_a of Eq. 1: topics of its sensors and of the results that the agent receives.
    topics: tuple[int, ...]
    rate_max_hz: float  #: Rmax, the rate at which a single topic could be sent, Hz.
    #: Rmin, the smallest rate, Hz; the paper does not state the value of Rmin.
    rate_min_hz: float = 1.0
    depth_max: float = DEPTH_MAX  #: Dmax, the largest depth, samples.
    #: Dmin, the smallest depth, samples; the paper does not state the value of Dmin.
    depth_min: float = 1.0

    def __post_init__(self) -> None:
        if not self.topics or min(self.topics) < 1:
            raise InvalidValueError("topics", self.topics, "at least one agent with topics each")
        for low, high in (("rate_min_hz", "rate_max_hz"), ("depth_min", "depth_max")):
            smaller, larger = getattr(self, low), getattr(self, high)
            if not 0 < smaller <= larger:
                raise InvalidValueError(f"{low}, {high}", (smaller, larger), f"0 < {low} <= {high}")


@dataclass(frozen=True, slots=True, kw_only=True)
class Balance:
    """A `Balance` is a solution of the published problem."""

    rate_hz: float  #: R, the rate at which each topic is sent, Hz.
    #: D, the depth of each history, samples, as a real number; users round the depth down.
    depth: float


class InfeasibleBalanceError(SfglabError, ValueError):
    """No rate and depth satisfy the published constraints."""


def average_topics(topics: Sequence[int]) -> float:
    """Return T_avg of Eq. 2, the mean of the number of topics of each agent (Eq. 1)."""
    return sum(topics) / len(topics)


def balance_closed_form(given: BalanceInput) -> Balance:
    """Return the optimum of Eq. 6 without a solver: the point that attains both upper bounds.

    The optimum is R* = min(Rmax / T_avg - Rmin, Rmax) and D* = min(Dmax R* / Rmax - Dmin, Dmax).

    Raises:
        InfeasibleBalanceError: A lower bound is above the upper bound of Eq. 4 or Eq. 5; the error names the violated
            constraint and the missing amount.
    """
    rate_hz = min(
        given.rate_max_hz / average_topics(given.topics) - given.rate_min_hz, given.rate_max_hz
    )
    if rate_hz < given.rate_min_hz:
        needed_hz = 2 * given.rate_min_hz * average_topics(given.topics)
        raise InfeasibleBalanceError(
            "QoS balancing has no solution: Eq. 4, Rmax / T_avg - R >= Rmin with R >= Rmin, in Hz, lacks "
            f"{given.rate_min_hz - rate_hz:g}; raise Rmax to {needed_hz:g} Hz, lower Rmin or use fewer topics"
        )
    depth = min(given.depth_max * rate_hz / given.rate_max_hz - given.depth_min, given.depth_max)
    if depth < given.depth_min:
        raise InfeasibleBalanceError(
            "QoS balancing has no solution: Eq. 5, Dmax R / Rmax - D >= Dmin with D >= Dmin, in samples, lacks "
            f"{given.depth_min - depth:g}; raise Dmax, lower Dmin or use fewer topics"
        )
    return Balance(rate_hz=rate_hz, depth=depth)


def balance(given: BalanceInput, *, weight: float = 0.5) -> Balance:
    """Solve Eq. 6 with CVXPY, as the paper does.

    The objective divides R and D by their largest values, and weights the two quotients with a number between 0 and 1.
    The weight does not change the optimum.

    Raises:
        InfeasibleBalanceError: No rate and depth satisfy the constraints; the error names the violated constraint
            and the missing amount.
        SfglabError: The solver ended without an optimum.
    """
    import cvxpy as cp

    rate, depth = cp.Variable(name="R"), cp.Variable(name="D")
    constraints = [
        given.rate_max_hz / average_topics(given.topics) - rate >= given.rate_min_hz,
        given.depth_max * rate / given.rate_max_hz - depth >= given.depth_min,
        given.rate_min_hz <= rate,
        rate <= given.rate_max_hz,
        given.depth_min <= depth,
        depth <= given.depth_max,
    ]
    rate_share, depth_share = rate / given.rate_max_hz, depth / given.depth_max
    objective = cp.Maximize(weight * rate_share + (1 - weight) * depth_share)
    try:
        solve_problem(cp.Problem(objective, constraints), "QoS balancing")
    except SfglabError:
        # This call raises an error with the violated constraint and the missing amount.
        balance_closed_form(given)
        raise
    found: Any = rate.value, depth.value
    return Balance(rate_hz=float(found[0]), depth=float(found[1]))


def solve_problem(problem: Any, about: str, **settings: Any) -> None:
    """Solve a CVXPY problem; the optimum is in the problem's variables.

    Args:
        problem: The problem.
        about: Name of the problem in the error.
        settings: Options of CVXPY's `solve`.

    Raises:
        SfglabError: The solver ended without an optimum.
    """
    from cvxpy import SolverError

    try:
        with warnings.catch_warnings():
            # The code below refuses the solutions that CVXPY warns of.
            warnings.filterwarnings("ignore", message="Solution may be inaccurate")
            problem.solve(solver="CLARABEL", **settings)
        ended = f"with status {problem.status!r}"
    except SolverError as error:
        ended = f"without an answer ({error})"
    if problem.status != "optimal":
        advice = "use rates and sizes that differ less from each other"
        raise SfglabError(f"{about}: solver CLARABEL ended {ended}; {advice}")
