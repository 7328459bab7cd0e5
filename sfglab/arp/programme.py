"""The module `programme` has sfglab's QoS balancing: a convex problem that includes the link, and its Pareto front.

The problem that paper B publishes (`balancing`) includes neither link nor messages, and has no trade-off. The
problem of this module has a trade-off. A higher rate keeps the reader's value true for longer. A higher rate also
takes airtime, fills queues, and puts more samples behind each gap, so latency grows. The topics have rates
r, times between changes t and weights w:

    maximise    sum_i w_i [ 1 - 1 / (1 + r_i t_i) - price * latency_i(r, u) ] / sum_i w_i
    subject to  airtime(r) <= u <= utilisation_max
                rate_min_i <= r_i <= rate_max_i, and <= the rate at which the allowed loss can be kept

The utility r t / (1 + r t) is the share of time in which the value sent last is still true if changes and samples
come at random. The utility saturates for values that change slowly, so such topics leave the medium to others.
Samples at even times have a slightly higher utility, which a finished plan includes (`Plan.up_to_date`). The latency
(`link`) is the sum of the way, the queue's wait, convex in u, and the delay by retransmissions, convex in r for
given depths.

Depths depend on the rates, and so do the responses that heartbeats request. Therefore the planner alternates: the
planner finds rates with the convex programme, then depths (`depths_for`), and repeats both steps until the plan gets
no better. The solver solves each programme to its optimum, and the planner returns the best plan of all rounds. The
best plan of all rounds need not be the best of all pairs of rates and depths.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from sfglab.arp.balancing import solve_problem
from sfglab.arp.link import Link, at_depths, link_of, queue_wait_s, repair_delay_s
from sfglab.arp.plan import BATCH_DEPTH, Plan, assess, depths_for, rates_most_hz
from sfglab.errors import SfglabError

if TYPE_CHECKING:
    from collections.abc import Callable

    from sfglab.arp.link import Floats
    from sfglab.arp.plan import Depths
    from sfglab.arp.topics import TopicFile

PRICES_HZ = np.geomspace(0.1, 1000, 13).tolist()
"""Prices of latency of the Pareto front, 1/s: from a second that costs a tenth of the freshness to a millisecond
that costs all of it."""

_ALTERNATIONS_MOST = 4
_GAIN_LEAST = 1e-6
_TAKEN_MORE = 1e-6  # The solver has this tolerance.
# The planner tries this number of rates between the lowest rates and the solver's rates.
_LOWERINGS = 51


def plan_file(given: TopicFile, *, latency_price_hz: float | None = None) -> Plan:
    """Return rates and depths for topics on their link, with their vendor's timing.

    Args:
        given: Topics and link.
        latency_price_hz: Freshness that a second of mean latency costs, 1/s. None selects the plan of the Pareto front
            with which readers are expected to be up to date for the largest share of time.

    Raises:
        InvalidValueError: The link loses too many of a topic's samples.
        SfglabError: The minimal rates alone exceed the capacity, or the solver ended without an optimum.
    """
    if latency_price_hz is None:
        return max(pareto_front(given), key=lambda point: point.up_to_date)
    return _Planner(given).plan(latency_price_hz)


def pareto_front(given: TopicFile) -> tuple[Plan, ...]:
    """Return plans of which none is better in both freshness and latency: one plan per price of `PRICES_HZ`.

    Raises:
        InvalidValueError: The link loses too many of a topic's samples.
        SfglabError: The minimal rates alone exceed the capacity, or the solver ended without an optimum.
    """
    planner = _Planner(given)
    return tuple(planner.plan(price) for price in PRICES_HZ)


class _Planner:
    """A `_Planner` finds the plans of one front, and keeps programmes, because equal depths have equal programmes."""

    def __init__(self, given: TopicFile) -> None:
        self._given = given
        self._bare = link_of(given)
        self._lowest = np.array([topic.rate_min_hz for topic in given.topics])
        highest = np.array([topic.rate_max_hz for topic in given.topics])
        in_batches = at_depths(self._bare, np.full(len(highest), BATCH_DEPTH), highest)
        most_hz = rates_most_hz(in_batches, highest, utilisation_max=given.utilisation_max)
        self._highest = np.maximum(most_hz, self._lowest)
        self._programmes: dict[bytes, _Programme] = {}
        middle_hz = np.sqrt(self._lowest * self._highest)
        self._first = at_depths(self._bare, self._depths(self._bare, middle_hz), middle_hz)
        self._check_feasible()

    def _check_feasible(self) -> None:
        """Check that the minimal rates take no more of the medium's time than is allowed.

        Raises:
            SfglabError: The minimal rates take more.
        """
        link, allowed = self._first, self._given.utilisation_max
        sent_hz = np.minimum(self._lowest, link.change_most_hz)
        taken = link.data_s * sent_hz + link.acknack_s * link.acknacks_hz(sent_hz)
        needed = float(taken.sum())
        if needed <= allowed:
            return
        largest = np.argsort(-taken, kind="stable")[:3]
        names = [self._given.topics[i].name for i in largest]
        raise SfglabError(
            f"QoS plan has no solution: the minimal rates take {needed:.3g} of the channel's time, "
            f"allowed: {allowed:.3g}. These topics take most: {', '.join(names)}. Multiply all minimal rates by "
            f"{allowed / needed:.2g}, send fewer topics, or use a faster link"
        )

    def plan(self, price: float) -> Plan:
        """Return the plan at a price of latency: the best of the rounds."""
        link, best, best_worth = self._first, None, -math.inf
        for _ in range(_ALTERNATIONS_MOST):
            programme = self._programme(link)
            rates_hz, depths = self._within_capacity(link, programme.solve(link, price))
            found = assess(self._given, rates_hz, depths, method="ours")
            found = replace(found, latency_price_hz=price)
            worth = found.freshness - price * found.latency_s
            if worth <= best_worth + _GAIN_LEAST:
                break
            best, best_worth = found, worth
            link = at_depths(self._bare, depths, rates_hz)
            if self._programme(link) is programme:
                break
        assert best is not None
        return best

    def _within_capacity(self, link: Link, rates_hz: Floats) -> tuple[Floats, Depths]:
        """Return rates with their depths; the function lowers rates that take more of the link than allowed."""
        for share in np.linspace(1, 0, _LOWERINGS):
            lowered_hz = self._lowest + share * (rates_hz - self._lowest)
            depths = self._depths(link, lowered_hz)
            taken = at_depths(self._bare, depths, lowered_hz).utilisation(lowered_hz)
            if taken <= self._given.utilisation_max + _TAKEN_MORE:
                break
        return lowered_hz, depths

    def _depths(self, link: Link, rates_hz: Floats) -> Depths:
        return depths_for(link, rates_hz, residual_loss=self._given.residual_loss)

    def _programme(self, link: Link) -> _Programme:
        """Return the programme for a link; a programme depends on the link's depths only through three arrays."""
        parts = link.held.round(9), link.acknack_share, link.acknack_most_hz
        key = b"".join(part.tobytes() for part in parts)
        if key not in self._programmes:
            bounds_hz = self._lowest, self._highest
            self._programmes[key] = _Programme(self._given, link, bounds_hz)
        return self._programmes[key]


_BRANCHINGS_MOST = 12

_TOLERANCES = dict.fromkeys(("tol_gap_abs", "tol_gap_rel", "tol_feas"), 1e-7)
"""Tolerances of ten times the solver's own: for topics with nearly no further utility the solver reaches no less."""


class _Programme:
    """A `_Programme` is the convex programme (DCP). Only parameters, in which it is DPP, change between solutions.

    The argument `link` has the costs of the topics, from `at_depths`. The argument `bounds_hz` has the smallest and the
    largest rates, shape (n,) each; a solver keeps to the bounds within its tolerance.
    """

    def __init__(self, given: TopicFile, link: Link, bounds_hz: tuple[Floats, Floats]) -> None:
        import cvxpy as cp
        from cvxpy.atoms.affine.binary_operators import multiply

        n = len(given.topics)
        lowest, highest = self._bounds_hz = bounds_hz
        change_s = np.array([topic.change_s for topic in given.topics])
        weights = np.array([topic.weight for topic in given.topics])
        weights = weights / weights.sum()
        middle = np.sqrt(lowest * highest)
        sent_most = np.minimum(highest, link.change_most_hz)
        shares = cp.Variable(n, name="rate_share")
        # `sent_shares` is a separate variable, because a product of parameters would not be DPP.
        sent_shares = cp.Variable(n, name="sent_share")
        busy = cp.Variable(name="utilisation")
        #: Cost of a second of mean latency.
        self._price = cp.Parameter(nonneg=True)
        #: Samples that travel, per reading and per second, in the branch that bounds the samples; then the same two
        #: values for acknowledgements; shape (n,) each.
        self._branches = [cp.Parameter(n, nonneg=True) for _ in range(4)]
        per_reading, per_second, acknacks_per_reading, acknacks_per_second = self._branches
        # The variables are shares of the largest rates, because numbers of one size suit the solver.
        self._rates = multiply(highest, shares)
        sent = multiply(sent_most, sent_shares)
        read_shares = multiply(per_reading, multiply(highest / sent_most, shares))
        acknacks = multiply(acknacks_per_reading, self._rates) + acknacks_per_second
        stale = _inverse_at(1 + change_s * middle)(
            1 + multiply(change_s * link.arriving, self._rates)
        )
        usual_sent = np.minimum(middle, sent_most)
        latency_s = _mean_latency_s(link, sent, busy, weights, usual_sent)
        constraints = [
            link.data_s @ sent + link.acknack_s @ acknacks <= busy,
            busy <= given.utilisation_max,
            shares >= lowest / highest,
            shares <= 1,
            sent_shares == read_shares + multiply(1 / sent_most, per_second),
        ]
        objective = cp.Maximize(1 - weights @ stale - self._price * latency_s)
        self._problem = cp.Problem(objective, constraints)

    def solve(self, link: Link, price: float) -> Floats:
        """Return the topics' rates, Hz, shape (n,), at a price of latency, after the branches have settled.

        Samples and acknowledgements that travel grow with the readings up to a bound. In one branch the number of
        travelling samples is a share of the readings; in the other branch the number is the bound. The argument `link`
        is the link of the constructor.

        Raises:
            SfglabError: The solver ended without an optimum.
        """
        self._price.value = price
        rates_hz = self._bounds_hz[0]
        before = None
        shares = np.ones_like(link.acknack_share), link.acknack_share
        changes_hz = link.change_most_hz
        most_hz = changes_hz, link.acknacks_hz(changes_hz)
        for _ in range(_BRANCHINGS_MOST):
            is_bound = [
                share * rates_hz > most for share, most in zip(shares, most_hz, strict=True)
            ]
            if before is not None and np.array_equal(is_bound, before):
                break
            before = is_bound
            for i, bound in enumerate(is_bound):
                self._branches[2 * i].value = np.where(bound, 0.0, shares[i])
                self._branches[2 * i + 1].value = np.where(bound, most_hz[i], 0.0)
            solve_problem(self._problem, "QoS plan", **_TOLERANCES)
            rates_hz = np.clip(self._rates.value, *self._bounds_hz)
        return rates_hz


def _mean_latency_s(link: Link, sent: Any, busy: Any, weights: Floats, usual: Floats) -> Any:
    """Return the mean by weight of the topics' latencies, as an expression."""
    waits = queue_wait_s(busy, link, inverse=_inverse_at(1.0))
    repairs = weights @ repair_delay_s(link, sent, inverse=_inverse_at(usual))
    return waits + repairs + weights @ link.way_s


def _inverse_at(usual: Floats | float) -> Callable[[Any], Any]:
    """Return 1 / x, written so that the solver sees numbers near 1 where x is near its usual value."""
    from cvxpy.atoms.affine.binary_operators import multiply
    from cvxpy.atoms.elementwise.inv_pos import inv_pos

    return lambda x: multiply(1 / usual, inv_pos(multiply(1 / usual, x)))  # type: ignore[no-untyped-call]
