"""Programme of our own QoS balancing: convex, with the link in sight, and its Pareto front.

The problem that paper B publishes (`balancing`) knows neither link nor messages, and has no trade-off. This
programme has one. A higher rate keeps the reader's value truer. It also takes airtime, fills queues, and puts
more samples behind each gap, so latency grows. With rates r, times between changes t and weights w of the
topics:

    maximise    sum_i w_i [ 1 - 1 / (1 + r_i t_i) - price * latency_i(r, u) ] / sum_i w_i
    subject to  airtime_s(r) <= u_s <= utilisation_max     for every sender s
                rate_min_i <= r_i <= rate_max_i, and <= the rate at which the allowed loss can be kept

The utility r t / (1 + r t) is the share of time in which the value sent last is still true when changes and
samples come at random. It saturates for values that change slowly, so such topics leave the medium to others;
samples at even times do a little better, which a finished plan includes (`Plan.up_to_date`). Latency (`link`)
is the way, the queue's wait, convex in u, and the delay by retransmissions, convex in r at given depths.

Depths and the answers that heartbeats ask for depend on the rates. So the two alternate: rates from the convex
programme, then depths (`depths_for`), and again, until nothing gets better. Each programme is solved to its
optimum; of the rounds, the best is kept. That need not be the best of all pairs.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from sfglab.arp.balancing import solve_problem
from sfglab.arp.link import Link, at_depths, link_of, queue_wait_s, repair_delay_s
from sfglab.arp.plan import (
    BATCH_DEPTH,
    InfeasiblePlanError,
    Plan,
    assess,
    depths_for,
    rates_most_hz,
)
from sfglab.arp.topics import Limits
from sfglab.errors import InvalidValueError

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray

    from sfglab.arp.topics import Topic, TopicFile
    from sfglab.rtps import Medium, Vendor

PRICES_HZ = tuple(float(price) for price in np.geomspace(0.1, 1000, 13))
"""Prices of latency that the front is drawn with: from a second costing a tenth of the freshness to a
millisecond costing all of it."""

_ALTERNATIONS_MOST = 4
_GAIN_LEAST = 1e-6
_TAKEN_MORE = 1e-6  # a solver's tolerance
_LOWERINGS = 51  # shares of the way from the lowest rates that are tried


def plan(
    topics: Sequence[Topic],
    medium: Medium,
    vendor: Vendor,
    *,
    latency_price_hz: float | None = None,
    limits: Limits | None = None,
) -> Plan:
    """Return rates and depths for topics on a link, with a vendor's timing; raises what `pareto_front` does.

    The price is what a second of mean latency costs, in freshness; None: the point of the Pareto front at which
    readers are expected to be up to date for the largest share of time. Without limits the usual ones are kept.
    """
    if latency_price_hz is None:
        return max(
            pareto_front(topics, medium, vendor, limits=limits), key=lambda point: point.up_to_date
        )
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

    Arguments are those of `plan`; prices are at least 0: with higher ones, latency and freshness both fall.

    Raises:
        InfeasiblePlanError: The minimal rates alone exceed the capacity; says by how much.
        InvalidValueError: There are no topics or no prices, a price is below 0, or the link loses too many of a
            topic's samples.
        SfglabError: The solver ended without an optimum.
    """
    if not topics or not prices_hz or not all(0 <= price < math.inf for price in prices_hz):
        given = f"{len(topics)} topics and prices {tuple(prices_hz)}"
        allowed = "at least one of each, prices finite and from 0"
        raise InvalidValueError("topics, prices of latency", given, allowed)
    planner = _Planner(tuple(topics), medium, vendor, limits or Limits())
    return tuple(planner.plan(float(price)) for price in prices_hz)


def plan_file(given: TopicFile, *, latency_price_hz: float | None = None) -> Plan:
    """Return the plan for what a file of topics says; raises what `plan` does."""
    price_hz = latency_price_hz
    return plan(given.topics, given.medium, given.vendor, latency_price_hz=price_hz, limits=given)


class _Planner:
    """Finds the plans of one front; keeps its programmes, as prices share them where depths are the same."""

    def __init__(
        self, topics: tuple[Topic, ...], medium: Medium, vendor: Vendor, limits: Limits
    ) -> None:
        self._topics, self._medium, self._vendor, self._limits = topics, medium, vendor, limits
        self._bare = link_of(topics, medium, vendor)
        self._lowest = np.array([topic.rate_min_hz for topic in topics])
        highest = np.array([topic.rate_max_hz for topic in topics])
        in_batches = at_depths(self._bare, np.full(len(topics), BATCH_DEPTH), highest)
        most_hz = rates_most_hz(in_batches, highest, utilisation_max=limits.utilisation_max)
        self._highest = np.maximum(most_hz, self._lowest)
        self._programmes: dict[bytes, Programme] = {}
        middle_hz = np.sqrt(self._lowest * self._highest)
        self._first = at_depths(self._bare, self._depths(self._bare, middle_hz), middle_hz)
        _check_feasible(topics, self._first, limits)

    def plan(self, price: float) -> Plan:
        """Return the plan at a price of latency: the best of the rounds."""
        link, best = self._first, None
        for _ in range(_ALTERNATIONS_MOST):
            programme = self._programme(link)
            rates_hz, airtime_price = solve(programme, link, price)
            rates_hz, depths = self._within_capacity(link, rates_hz)
            found = assess(
                self._topics,
                self._medium,
                self._vendor,
                rates_hz=rates_hz,
                depths=depths,
                method="ours",
            )
            found = replace(found, latency_price_hz=price, airtime_price=airtime_price)
            if best is not None and _worth(found) <= _worth(best) + _GAIN_LEAST:
                break
            best = found
            link = at_depths(self._bare, depths, rates_hz)
            if self._programme(link) is programme:
                break
        assert best is not None
        return best

    def _within_capacity(
        self, link: Link, rates_hz: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
        """Return rates with their depths, lowered where they take more than was reckoned with."""
        for share in np.linspace(1, 0, _LOWERINGS):
            lowered_hz = self._lowest + share * (rates_hz - self._lowest)
            depths = self._depths(link, lowered_hz)
            taken = at_depths(self._bare, depths, lowered_hz).utilisation(lowered_hz)
            if taken.max() <= self._limits.utilisation_max + _TAKEN_MORE:
                break
        return lowered_hz, depths

    def _depths(self, link: Link, rates_hz: NDArray[np.float64]) -> NDArray[np.int64]:
        return depths_for(link, rates_hz, residual_loss=self._limits.residual_loss)

    def _programme(self, link: Link) -> Programme:
        """Return the programme for a link, which depends on its depths only by three arrays."""
        parts = link.held.round(9), link.acknack_share, link.acknack_most_hz
        key = b"".join(part.tobytes() for part in parts)
        if key not in self._programmes:
            bounds_hz = self._lowest, self._highest
            self._programmes[key] = build_programme(self._topics, link, bounds_hz, self._limits)
        return self._programmes[key]


def _worth(found: Plan) -> float:
    return found.freshness - (found.latency_price_hz or 0.0) * found.latency_s


def _check_feasible(topics: Sequence[Topic], link: Link, limits: Limits) -> None:
    """Raise an InfeasiblePlanError if the minimal rates take more of a sender's time than is allowed."""
    sent_hz = np.minimum([topic.rate_min_hz for topic in topics], link.change_most_hz)
    needed = link.load(sent_hz)
    worst = int(needed.argmax())
    if needed[worst] <= limits.utilisation_max:
        return
    acknacks_s = link.acknack_s[worst] * link.acknacks_hz(sent_hz)
    taken = link.data_s[worst] * sent_hz + acknacks_s
    largest = tuple(topics[i].name for i in np.argsort(-taken, kind="stable")[:3])
    raise InfeasiblePlanError(
        link.senders[worst], float(needed[worst]), limits.utilisation_max, largest
    )


_BRANCHINGS_MOST = 12

_TOLERANCES = dict.fromkeys(("tol_gap_abs", "tol_gap_rel", "tol_feas"), 1e-7)
"""Ten times the solver's own: where a topic is worth next to nothing more, it would not come closer."""

Bounds = tuple["NDArray[np.float64]", "NDArray[np.float64]"]
"""Least and largest rates, Hz, each of shape (n,)."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Programme:
    """The convex programme with its handles; parameters change between solutions, the problem does not."""

    problem: Any  #: CVXPY's problem; DCP, and DPP in its parameters.
    rates: Any  #: Expression, shape (n,), Hz.
    bounds_hz: Bounds  #: Least and largest rates; a solver keeps to them within its tolerance.
    price: Any  #: Parameter: what a second of mean latency costs.
    #: Parameters, each of shape (n,): of samples that travel, how many per reading and how many per second, in
    #: the branch that bounds them; then the same of acknowledgements.
    branches: tuple[Any, ...]
    capacity: Any  #: The constraint whose dual value is the price of airtime.


def build_programme(
    topics: Sequence[Topic], link: Link, bounds_hz: Bounds, limits: Limits
) -> Programme:
    """Return the programme, unsolved; `link` is what the topics cost, from `at_depths`."""
    import cvxpy as cp
    from cvxpy.atoms.affine.binary_operators import multiply

    n = len(topics)
    lowest, highest = bounds_hz
    change_s = np.array([topic.change_s for topic in topics])
    weights = np.array([topic.weight for topic in topics])
    weights = weights / weights.sum()
    middle = np.sqrt(lowest * highest)
    sent_most = np.minimum(highest, link.change_most_hz)
    shares = cp.Variable(n, name="rate_share")
    # A variable of its own, as a product of parameters would not do (DPP).
    sent_shares = cp.Variable(n, name="sent_share")
    busy = cp.Variable(len(link.senders), name="utilisation")
    price = cp.Parameter(nonneg=True)
    branches = [cp.Parameter(n, nonneg=True) for _ in range(4)]
    per_reading, per_second, acknacks_per_reading, acknacks_per_second = branches
    rates = multiply(highest, shares)  # of the largest rates: numbers of one size suit the solver
    sent = multiply(sent_most, sent_shares)
    read_shares = multiply(per_reading, multiply(highest / sent_most, shares))
    acknacks = multiply(acknacks_per_reading, rates) + acknacks_per_second
    stale = _inverse_at(1 + change_s * middle)(1 + multiply(change_s * link.arriving, rates))
    usual_sent = np.minimum(middle, sent_most)
    latency_s = _mean_latency_s(link, sent, busy, weights, usual_sent)
    capacity = link.data_s @ sent + link.acknack_s @ acknacks <= busy
    constraints = [
        capacity,
        busy <= limits.utilisation_max,
        shares >= lowest / highest,
        shares <= 1,
        sent_shares == read_shares + multiply(1 / sent_most, per_second),
    ]
    problem = cp.Problem(cp.Maximize(1 - weights @ stale - price * latency_s), constraints)
    return Programme(
        problem=problem,
        rates=rates,
        bounds_hz=bounds_hz,
        price=price,
        branches=tuple(branches),
        capacity=capacity,
    )


def _mean_latency_s(
    link: Link, sent: Any, busy: Any, weights: NDArray[np.float64], usual: NDArray[np.float64]
) -> Any:
    """Return the mean by weight of the topics' latencies, as an expression."""
    carried = np.bincount(link.sender, weights, minlength=len(link.senders))
    waits = carried @ queue_wait_s(busy, link, inverse=_inverse_at(np.ones(len(link.senders))))
    repairs = weights @ repair_delay_s(link, sent, inverse=_inverse_at(usual))
    return waits + repairs + weights @ link.way_s


def _inverse_at(usual: NDArray[np.float64]) -> Callable[[Any], Any]:
    """Return 1 / x, written so that the solver sees numbers near 1 where x is near its usual value."""
    from cvxpy.atoms.affine.binary_operators import multiply
    from cvxpy.atoms.elementwise.inv_pos import inv_pos

    return lambda x: multiply(1 / usual, inv_pos(multiply(1 / usual, x)))  # type: ignore[no-untyped-call]


def solve(programme: Programme, link: Link, price: float) -> tuple[NDArray[np.float64], float]:
    """Return rates and the capacity's dual value at a price of latency, after the branches have settled.

    Samples and acknowledgements that travel grow with the readings up to a bound: in one branch they are a
    share of the readings, in the other the bound. `link` is what the programme was built with.

    Raises:
        SfglabError: The solver ended without an optimum.
    """
    programme.price.value = price
    rates_hz, before = programme.bounds_hz[0], None
    shares = np.ones_like(link.acknack_share), link.acknack_share
    changes_hz = link.change_most_hz
    most_hz = changes_hz, link.acknacks_hz(changes_hz)
    for _ in range(_BRANCHINGS_MOST):
        is_bound = [share * rates_hz > most for share, most in zip(shares, most_hz, strict=True)]
        if before is not None and np.array_equal(is_bound, before):
            break
        before = is_bound
        for i, bound in enumerate(is_bound):
            programme.branches[2 * i].value = np.where(bound, 0.0, shares[i])
            programme.branches[2 * i + 1].value = np.where(bound, most_hz[i], 0.0)
        solve_problem(programme.problem, "QoS plan", "CLARABEL", **_TOLERANCES)
        rates_hz = np.clip(programme.rates.value, *programme.bounds_hz)
    return rates_hz, float(np.max(programme.capacity.dual_value))
