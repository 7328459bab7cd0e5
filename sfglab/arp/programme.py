"""Our own QoS balancing: a convex programme that sees the link, with its Pareto front.

The problem that paper B prints (`balancing`) knows neither link nor messages, and has no trade-off. This one
has one. Sending more often keeps the reader's value truer; it also takes airtime, fills queues, and puts more
samples behind each gap, so that latency grows. With rates r, times between changes t and weights w of the
topics:

    maximise    sum_i w_i [ 1 - 1 / (1 + r_i t_i) - price * latency_i(r, u) ] / sum_i w_i
    subject to  airtime_s(r) <= u_s <= utilisation_max     for every sender s
                rate_min_i <= r_i <= rate_max_i

The utility r t / (1 + r t) is the share of time in which the value sent last is still true when changes and
samples come at random: it saturates for what changes slowly, so such topics leave the air to others; samples
at even times do a little better, which a finished plan says (`Plan.up_to_date`). Latency (`link`) is the way,
the queue's wait, convex in u, and the hold-up by repairs, convex in r. Depths follow from the rates and the
time that repairs take (`plan.depths_for`); they are no variables because more than that depth never helps.

Airtime counts acknowledgements, which a reader bundles: min(r, 1 / delay) a second; of a topic behind a local
cache only changes travel, min(r, 1 / t) at most. Both are concave. Each is bounded by one of its two branches,
and a topic changes its branch when the solution shows that the other one is smaller (the convex-concave
procedure), so that every solution is feasible and none is worse than the one before.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from sfglab.arp.limits import InfeasiblePlanError, Limits, ProgrammeError
from sfglab.arp.link import link_of, queue_wait_s, repair_delay_s
from sfglab.arp.plan import assess, depths_for

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray

    from sfglab.arp.link import Link
    from sfglab.arp.plan import Plan
    from sfglab.arp.topics import Topic, TopicFile
    from sfglab.rtps import Medium, Vendor

__all__ = [
    "InfeasiblePlanError",
    "Limits",
    "ProgrammeError",
    "build_programme",
    "pareto_front",
    "plan",
    "plan_file",
]

PRICES_HZ = tuple(float(price) for price in np.geomspace(0.1, 1000, 13))
"""Prices of latency that the front is drawn with: from a second costing a tenth of the freshness to a
millisecond costing all of it."""

_ROUNDS_MOST = 12

_TOLERANCES = dict.fromkeys(("tol_gap_abs", "tol_gap_rel", "tol_feas"), 1e-7)
"""Ten times the solver's own: where a topic is worth next to nothing more, it would not come closer."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Programme:
    """The convex programme with its handles; parameters change between solutions, the problem does not.

    Attributes:
        problem: CVXPY's problem; DCP, and DPP in its parameters.
        rates: Expression, shape (n,), Hz.
        bounds_hz: Least and largest rates, each of shape (n,); a solver keeps to them within its tolerance.
        price: Parameter: what a second of mean latency costs.
        branches: Parameters, each of shape (n,): of samples that travel, how many a reading and how many a
            second, in the branch that bounds them; then the same of acknowledgements.
        capacity: The constraint whose dual value is the price of airtime.
    """

    problem: Any
    rates: Any
    bounds_hz: tuple[NDArray[np.float64], NDArray[np.float64]]
    price: Any
    branches: tuple[Any, ...]
    capacity: Any


def build_programme(topics: Sequence[Topic], link: Link, limits: Limits) -> Programme:
    """Return the programme, unsolved.

    Args:
        topics: The topics.
        link: What they cost, from `link_of`.
        limits: What must be kept.
    """
    import cvxpy as cp
    from cvxpy.atoms.affine.binary_operators import multiply

    n = len(topics)
    lowest, highest, change_s, weights = (
        np.array([getattr(t, key) for t in topics])
        for key in ("rate_min_hz", "rate_max_hz", "change_s", "weight")
    )
    weights = weights / weights.sum()
    middle, sent_most = np.sqrt(lowest * highest), np.minimum(highest, link.change_most_hz)
    shares, busy = cp.Variable(n, name="rate_share"), cp.Variable(len(link.senders), name="utilisation")
    rates = multiply(highest, shares)  # of the largest rates: numbers of one size suit the solver
    price, branches = cp.Parameter(nonneg=True), [cp.Parameter(n, nonneg=True) for _ in range(4)]
    # A variable of its own, as a product of parameters would not do (DPP).
    sent_shares = cp.Variable(n, name="sent_share")
    sent = multiply(sent_most, sent_shares)
    acknacks = multiply(branches[2], rates) + branches[3]
    stale = _inverse_at(1 + change_s * middle)(1 + multiply(change_s * link.arriving, rates))
    capacity = link.data_s @ sent + link.acknack_s @ acknacks <= busy
    problem = cp.Problem(
        cp.Maximize(
            1
            - weights @ stale
            - price * _mean_latency_s(link, sent, busy, weights, np.minimum(middle, sent_most))
        ),
        [
            capacity,
            busy <= limits.utilisation_max,
            shares >= lowest / highest,
            shares <= 1,
            sent_shares
            == multiply(branches[0], multiply(highest / sent_most, shares))
            + multiply(1 / sent_most, branches[1]),
        ],
    )
    return Programme(
        problem=problem,
        rates=rates,
        bounds_hz=(lowest, highest),
        price=price,
        branches=tuple(branches),
        capacity=capacity,
    )


def _mean_latency_s(
    link: Link, sent: Any, busy: Any, weights: NDArray[np.float64], usual: NDArray[np.float64]
) -> Any:
    from cvxpy.atoms.elementwise.maximum import maximum

    carried = np.bincount(link.sender, weights, minlength=len(link.senders))
    waits = carried @ queue_wait_s(busy, link, inverse=_inverse_at(np.ones(len(link.senders))))
    repairs = weights @ repair_delay_s(link, sent, inverse=_inverse_at(usual), larger=maximum)
    return waits + repairs + weights @ link.way_s


def _inverse_at(usual: NDArray[np.float64]) -> Callable[[Any], Any]:
    """Return 1 / x, written so that the solver sees numbers near 1 where x is near its usual value."""
    from cvxpy.atoms.affine.binary_operators import multiply
    from cvxpy.atoms.elementwise.inv_pos import inv_pos

    return lambda x: multiply(1 / usual, inv_pos(multiply(1 / usual, x)))  # type: ignore[no-untyped-call]


def plan(
    topics: Sequence[Topic],
    medium: Medium,
    vendor: Vendor,
    *,
    latency_price_hz: float | None = None,
    limits: Limits | None = None,
) -> Plan:
    """Return rates and depths for topics on a link.

    Args:
        topics: The topics.
        medium: The link.
        vendor: Timing of the reliability protocol.
        latency_price_hz: What a second of mean latency costs, in freshness; None: the point of the Pareto front
            at which readers are expected to be up to date for the largest share of time.
        limits: What must be kept; None: the usual ones.

    Raises:
        InfeasiblePlanError: The minimal rates alone exceed the capacity; says by how much.
        ProgrammeError: An input has no meaning, or the solver ended without an optimum.
    """
    if latency_price_hz is None:
        front = pareto_front(topics, medium, vendor, limits=limits)
        return max(front, key=lambda point: point.up_to_date)
    return pareto_front(topics, medium, vendor, limits=limits, prices_hz=(latency_price_hz,))[0]


def pareto_front(
    topics: Sequence[Topic],
    medium: Medium,
    vendor: Vendor,
    *,
    limits: Limits | None = None,
    prices_hz: Sequence[float] = PRICES_HZ,
) -> tuple[Plan, ...]:
    """Return plans of which none is better in both freshness and latency: one for each price of latency.

    Args:
        topics: The topics.
        medium: The link.
        vendor: Timing of the protocol.
        limits: What must be kept; None: the usual ones.
        prices_hz: Prices of latency, at least 0; with higher ones, latency and freshness both fall.

    Raises:
        InfeasiblePlanError: The minimal rates alone exceed the capacity; says by how much.
        ProgrammeError: An input has no meaning, or the solver ended without an optimum.
    """
    limits = limits or Limits()
    if not topics or not prices_hz or not all(0 <= price < math.inf for price in prices_hz):
        raise ProgrammeError(
            f"topics, prices: given {len(topics)} topics and prices {tuple(prices_hz)}; "
            "needed is at least one of each, allowed are prices from 0"
        )
    link = link_of(topics, medium, vendor)
    _check_feasible(topics, link, limits)
    programme = build_programme(topics, link, limits)
    points = []
    for price in prices_hz:
        rates_hz, airtime_price = _solve(programme, link, float(price))
        depths = depths_for(link, rates_hz, residual_loss=limits.residual_loss)
        point = assess(topics, medium, vendor, rates_hz=rates_hz, depths=depths, method="ours")
        points.append(replace(point, latency_price_hz=float(price), airtime_price=airtime_price))
    return tuple(points)


def plan_file(given: TopicFile, *, latency_price_hz: float | None = None) -> Plan:
    """Return the plan for what a file of topics says; raises what `plan` does."""
    limits = Limits(utilisation_max=given.utilisation_max, residual_loss=given.residual_loss)
    return plan(given.topics, given.medium, given.vendor, latency_price_hz=latency_price_hz, limits=limits)


def _check_feasible(topics: Sequence[Topic], link: Link, limits: Limits) -> None:
    lowest = np.array([t.rate_min_hz for t in topics])
    sent_hz = np.minimum(lowest, link.change_most_hz)
    needed = link.load(sent_hz)
    worst = int(needed.argmax())
    if needed[worst] <= limits.utilisation_max:
        return
    taken = link.data_s[worst] * sent_hz + link.acknack_s[worst] * np.minimum(sent_hz, link.acknack_most_hz)
    largest = tuple(topics[i].name for i in np.argsort(-taken, kind="stable")[:3])
    raise InfeasiblePlanError(link.senders[worst], float(needed[worst]), limits.utilisation_max, largest)


def _solve(programme: Programme, link: Link, price: float) -> tuple[NDArray[np.float64], float]:
    """Return rates and the capacity's dual value, after the branches have settled."""
    programme.price.value = price
    rates_hz, chosen = programme.bounds_hz[0], None
    # At most so many samples travel, and are acknowledged, however often is read.
    ceilings = link.change_most_hz, np.minimum(link.change_most_hz, link.acknack_most_hz)
    for _ in range(_ROUNDS_MOST):
        flat = [rates_hz > ceiling for ceiling in ceilings]
        if chosen is not None and np.array_equal(flat, chosen):
            break
        chosen = flat
        for i, (there, ceiling) in enumerate(zip(flat, ceilings, strict=True)):
            programme.branches[2 * i].value = (~there).astype(float)
            programme.branches[2 * i + 1].value = np.where(there, ceiling, 0.0)
        _run_solver(programme.problem)
        rates_hz = np.clip(programme.rates.value, *programme.bounds_hz)
    return rates_hz, float(np.max(programme.capacity.dual_value))


def _run_solver(problem: Any) -> None:
    problem.solve(solver="CLARABEL", **_TOLERANCES)
    if problem.status != "optimal":
        raise ProgrammeError(f"QoS plan: solver CLARABEL ended with status {problem.status!r}")
