"""Programme of our own QoS balancing: convex, with the link in sight, and its Pareto front.

The problem that paper B prints (`balancing`) knows neither link nor messages, and has no trade-off. This one
has one. Sending more often keeps the reader's value truer; it also takes airtime, fills queues, and puts more
samples behind each gap: latency grows. With rates r, times between changes t and weights w of the topics:

    maximise    sum_i w_i [ 1 - 1 / (1 + r_i t_i) - price * latency_i(r, u) ] / sum_i w_i
    subject to  airtime_s(r) <= u_s <= utilisation_max     for every sender s
                rate_min_i <= r_i <= rate_max_i, and <= what the allowed loss lets through

The utility r t / (1 + r t) is the share of time in which the value sent last is still true when changes and
samples come at random: it saturates for what changes slowly, so such topics leave the air to others; samples
at even times do a little better, which a finished plan says (`Plan.up_to_date`). Latency (`link`) is the way,
the queue's wait, convex in u, and the hold-up by repairs, convex in r at given depths.

Depths and rates depend on each other where heartbeats come once in `depth` samples, as with a VOLATILE writer
of Fast DDS: a deeper history loses less and acknowledges less, but repairs later. So the two alternate: rates
by the convex programme, then depths by trying a few (`depths_for`), and again, until nothing gets better. Each
programme is solved to its optimum; of the rounds, the best is kept. That need not be the best of all pairs.

There, samples that are published during a repair are lost for good, so the allowed loss bounds the rates; by
how much depends on how long repairs queue (`rates_most_hz`). So a few bounds of u are tried, each with the
rates that it permits: emptier air lets a topic be faster. Where losses bound no rate there is one, the given.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from sfglab.arp.link import Link, at_depths, link_of, queue_wait_s, repair_delay_s
from sfglab.arp.plan import InfeasiblePlanError, Limits, Plan, assess, depths_for, rates_most_hz
from sfglab.errors import InvalidValueError, SfglabError

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
_LEVELS = (1.0, 0.9, 0.8, 0.7, 0.6, 0.5, 0.4, 0.3)
_TAKEN_MORE = 1e-6  # a solver's tolerance


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
        InvalidValueError: There are no topics or no prices, or a price is below 0.
        SfglabError: The solver ended without an optimum.
    """
    if not topics or not prices_hz or not all(0 <= price < math.inf for price in prices_hz):
        given = f"{len(topics)} topics and prices {tuple(prices_hz)}"
        raise InvalidValueError("topics, prices", given, "at least one of each, prices from 0")
    planner = _Planner(tuple(topics), medium, vendor, limits or Limits())
    return tuple(planner.plan(float(price)) for price in prices_hz)


def plan_file(given: TopicFile, *, latency_price_hz: float | None = None) -> Plan:
    """Return the plan for what a file of topics says; raises what `plan` does."""
    limits = Limits(utilisation_max=given.utilisation_max, residual_loss=given.residual_loss)
    return plan(
        given.topics, given.medium, given.vendor, latency_price_hz=latency_price_hz, limits=limits
    )


class _Planner:
    """Finds the plans of one front; keeps its programmes, as prices share them where depths are the same."""

    def __init__(
        self, topics: tuple[Topic, ...], medium: Medium, vendor: Vendor, limits: Limits
    ) -> None:
        self._topics, self._medium, self._vendor, self._limits = topics, medium, vendor, limits
        self._bare = link_of(topics, medium, vendor)
        self._lowest = np.array([t.rate_min_hz for t in topics])
        self._highest = np.array([t.rate_max_hz for t in topics])
        self._programmes: dict[bytes, Programme] = {}
        middle_hz = np.sqrt(self._lowest * self._ceiling_hz(0.0))
        self._first = at_depths(self._bare, self._depths(self._bare, middle_hz), middle_hz)
        needed = _check_feasible(topics, self._first, limits)
        bounded = bool(np.isfinite(rates_most_hz(self._bare, utilisation=0.0)).any())
        shares = np.array(_LEVELS if bounded else (1.0,))
        levels = limits.utilisation_max * shares
        self._levels = levels[(shares == 1) | (levels > needed)]

    def plan(self, price: float) -> Plan:
        """Return the plan at a price of latency: the best of those with the air as full as each level."""
        best = self._plan_at(price, float(self._levels[0]))
        for level in self._levels[1:]:
            found = self._plan_at(price, float(level))
            if _worth(found) < _worth(best):
                break
            best = found
        return best

    def _plan_at(self, price: float, level: float) -> Plan:
        """Return the best plan of the rounds, in which rates and depths alternate."""
        link, best = self._first, None
        for _ in range(_ALTERNATIONS_MOST):
            programme = self._programme(link)
            programme.ceiling.value = self._ceiling_hz(level) / self._highest
            programme.level.value = level
            rates_hz, airtime_price = solve(programme, link, price)
            rates_hz, depths = self._within_capacity(
                link, np.minimum(rates_hz, self._ceiling_hz(level))
            )
            found = assess(
                self._topics,
                self._medium,
                self._vendor,
                rates_hz=rates_hz,
                depths=depths,
                method="ours",
            )
            found = replace(found, latency_price_hz=price, airtime_price=airtime_price)
            if best is None or _worth(found) > _worth(best) + _GAIN_LEAST:
                best = found
            else:
                break
            link = at_depths(self._bare, depths, rates_hz)
            if self._programme(link) is programme:
                break
        assert best is not None
        return best

    def _within_capacity(
        self, link: Link, rates_hz: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
        """Return rates with their depths, lowered where they take more than was reckoned with."""
        for share in np.linspace(1, 0, 51):
            lowered_hz = self._lowest + share * (rates_hz - self._lowest)
            depths = self._depths(link, lowered_hz)
            taken = at_depths(self._bare, depths, lowered_hz).utilisation(lowered_hz)
            if taken.max() <= self._limits.utilisation_max + _TAKEN_MORE:
                break
        return lowered_hz, depths

    def _depths(self, link: Link, rates_hz: NDArray[np.float64]) -> NDArray[np.int64]:
        return depths_for(link, rates_hz, residual_loss=self._limits.residual_loss)

    def _programme(self, link: Link) -> Programme:
        key = (
            link.held.round(9).tobytes()
            + link.acknack_share.tobytes()
            + link.acknack_most_hz.tobytes()
        )
        if key not in self._programmes:
            self._programmes[key] = build_programme(self._topics, link, self._limits)
        return self._programmes[key]

    def _ceiling_hz(self, level: float) -> NDArray[np.float64]:
        return np.clip(rates_most_hz(self._bare, utilisation=level), self._lowest, self._highest)


def _worth(found: Plan) -> float:
    return found.freshness - (found.latency_price_hz or 0.0) * found.latency_s


def _check_feasible(topics: Sequence[Topic], link: Link, limits: Limits) -> float:
    """Return which share of a sender's time the minimal rates take."""
    sent_hz = np.minimum(np.array([t.rate_min_hz for t in topics]), link.change_most_hz)
    needed = link.load(sent_hz)
    worst = int(needed.argmax())
    if needed[worst] <= limits.utilisation_max:
        return float(needed[worst])
    acknacks = np.minimum(link.acknack_share * sent_hz, link.acknack_most_hz)
    taken = link.data_s[worst] * sent_hz + link.acknack_s[worst] * acknacks
    largest = tuple(topics[i].name for i in np.argsort(-taken, kind="stable")[:3])
    raise InfeasiblePlanError(
        link.senders[worst], float(needed[worst]), limits.utilisation_max, largest
    )


_ROUNDS_MOST = 12

_TOLERANCES = dict.fromkeys(("tol_gap_abs", "tol_gap_rel", "tol_feas"), 1e-7)
"""Ten times the solver's own: where a topic is worth next to nothing more, it would not come closer."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Programme:
    """The convex programme with its handles; parameters change between solutions, the problem does not."""

    problem: Any  #: CVXPY's problem; DCP, and DPP in its parameters.
    rates: Any  #: Expression, shape (n,), Hz.
    #: Least and largest rates, each of shape (n,); a solver keeps to them within its tolerance.
    bounds_hz: tuple[NDArray[np.float64], NDArray[np.float64]]
    #: Parameter: share of the largest rate up to which the allowed loss can be kept, shape (n,).
    ceiling: Any
    level: Any  #: Parameter: the most of each sender's time that may be taken.
    price: Any  #: Parameter: what a second of mean latency costs.
    #: Parameters, each of shape (n,): of samples that travel, how many a reading and how many a second, in the
    #: branch that bounds them; then the same of acknowledgements.
    branches: tuple[Any, ...]
    capacity: Any  #: The constraint whose dual value is the price of airtime.


def build_programme(topics: Sequence[Topic], link: Link, limits: Limits) -> Programme:
    """Return the programme, unsolved; `link` is what the topics cost, from `at_depths`."""
    import cvxpy as cp
    from cvxpy.atoms.affine.binary_operators import multiply

    n = len(topics)
    lowest, highest, change_s, weights = (
        np.array([getattr(t, key) for t in topics])
        for key in ("rate_min_hz", "rate_max_hz", "change_s", "weight")
    )
    weights = weights / weights.sum()
    middle, sent_most = np.sqrt(lowest * highest), np.minimum(highest, link.change_most_hz)
    shares, busy = (
        cp.Variable(n, name="rate_share"),
        cp.Variable(len(link.senders), name="utilisation"),
    )
    rates = multiply(highest, shares)  # of the largest rates: numbers of one size suit the solver
    price, branches = cp.Parameter(nonneg=True), [cp.Parameter(n, nonneg=True) for _ in range(4)]
    ceiling = cp.Parameter(n, nonneg=True, value=np.ones(n))
    level = cp.Parameter(nonneg=True, value=limits.utilisation_max)
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
            busy <= level,
            shares >= lowest / highest,
            shares <= ceiling,
            sent_shares
            == multiply(branches[0], multiply(highest / sent_most, shares))
            + multiply(1 / sent_most, branches[1]),
        ],
    )
    return Programme(
        problem=problem,
        rates=rates,
        bounds_hz=(lowest, highest),
        ceiling=ceiling,
        level=level,
        price=price,
        branches=tuple(branches),
        capacity=capacity,
    )


def _mean_latency_s(
    link: Link, sent: Any, busy: Any, weights: NDArray[np.float64], usual: NDArray[np.float64]
) -> Any:
    carried = np.bincount(link.sender, weights, minlength=len(link.senders))
    waits = carried @ queue_wait_s(busy, link, inverse=_inverse_at(np.ones(len(link.senders))))
    return (
        waits
        + weights @ repair_delay_s(link, sent, inverse=_inverse_at(usual))
        + weights @ link.way_s
    )


def _inverse_at(usual: NDArray[np.float64]) -> Callable[[Any], Any]:
    """Return 1 / x, written so that the solver sees numbers near 1 where x is near its usual value."""
    from cvxpy.atoms.affine.binary_operators import multiply
    from cvxpy.atoms.elementwise.inv_pos import inv_pos

    return lambda x: multiply(1 / usual, inv_pos(multiply(1 / usual, x)))  # type: ignore[no-untyped-call]


def solve(programme: Programme, link: Link, price: float) -> tuple[NDArray[np.float64], float]:
    """Return rates and the capacity's dual value at a price of latency, after the branches have settled.

    The programme's other parameters are set; `link` is what it was built with. Raises SfglabError where the
    solver ends without an optimum.
    """
    programme.price.value = price
    rates_hz, chosen = programme.bounds_hz[0], None
    # At most so many samples travel, and so many acknowledgements, however often is read.
    shares = np.ones_like(link.acknack_share), link.acknack_share
    most = (
        link.change_most_hz,
        np.minimum(link.acknack_share * link.change_most_hz, link.acknack_most_hz),
    )
    for _ in range(_ROUNDS_MOST):
        flat = [share * rates_hz > ceiling for share, ceiling in zip(shares, most, strict=True)]
        if chosen is not None and np.array_equal(flat, chosen):
            break
        chosen = flat
        for i, (there, share, ceiling) in enumerate(zip(flat, shares, most, strict=True)):
            programme.branches[2 * i].value = np.where(there, 0.0, share)
            programme.branches[2 * i + 1].value = np.where(there, ceiling, 0.0)
        problem = programme.problem
        problem.solve(solver="CLARABEL", **_TOLERANCES)
        if problem.status != "optimal":
            raise SfglabError(f"QoS plan: solver CLARABEL ended with status {problem.status!r}")
        rates_hz = np.clip(programme.rates.value, *programme.bounds_hz)
    return rates_hz, float(np.max(programme.capacity.dual_value))
