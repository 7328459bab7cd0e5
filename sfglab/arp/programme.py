"""Our own QoS balancing: a convex programme that sees the link, with its Pareto front.

The problem that paper B prints (`balancing`) knows neither link nor messages, and has no trade-off. This one
has one. Sending more often keeps the reader's value truer; it also takes airtime, fills queues, and puts more
samples behind each gap, so that latency grows. With rates r, times between changes t and weights w of the
topics:

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
rates that it permits: emptier air lets single topics be faster. Where losses bound no rate there is one, the
given.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from sfglab.arp.convex import Programme, build_programme, solve
from sfglab.arp.depths import depths_for, rates_most_hz
from sfglab.arp.limits import InfeasiblePlanError, Limits, ProgrammeError
from sfglab.arp.link import at_depths, link_of
from sfglab.arp.plan import assess

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from sfglab.arp.link import Link
    from sfglab.arp.plan import Plan
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
    planner = _Planner(tuple(topics), medium, vendor, limits)
    return tuple(planner.plan(float(price)) for price in prices_hz)


def plan_file(given: TopicFile, *, latency_price_hz: float | None = None) -> Plan:
    """Return the plan for what a file of topics says; raises what `plan` does."""
    limits = Limits(utilisation_max=given.utilisation_max, residual_loss=given.residual_loss)
    return plan(given.topics, given.medium, given.vendor, latency_price_hz=latency_price_hz, limits=limits)


class _Planner:
    """Finds the plans of one front; keeps its programmes, as prices share them where depths are the same."""

    def __init__(self, topics: tuple[Topic, ...], medium: Medium, vendor: Vendor, limits: Limits) -> None:
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
        self._levels = (
            limits.utilisation_max * shares[(shares == 1) | (shares * limits.utilisation_max > needed)]
        )

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
            rates_hz, depths = self._within_capacity(link, np.minimum(rates_hz, self._ceiling_hz(level)))
            found = assess(
                self._topics, self._medium, self._vendor, rates_hz=rates_hz, depths=depths, method="ours"
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
        key = link.held.round(9).tobytes() + link.acknack_share.tobytes() + link.acknack_most_hz.tobytes()
        if key not in self._programmes:
            self._programmes[key] = build_programme(self._topics, link, self._limits)
        return self._programmes[key]

    def _ceiling_hz(self, level: float) -> NDArray[np.float64]:
        return np.clip(rates_most_hz(self._bare, utilisation=level), self._lowest, self._highest)


def _worth(found: Plan) -> float:
    return found.freshness - (found.latency_price_hz or 0.0) * found.latency_s


def _check_feasible(topics: Sequence[Topic], link: Link, limits: Limits) -> float:
    """Return which share of a sender's time the minimal rates take."""
    lowest = np.array([t.rate_min_hz for t in topics])
    sent_hz = np.minimum(lowest, link.change_most_hz)
    needed = link.load(sent_hz)
    worst = int(needed.argmax())
    if needed[worst] <= limits.utilisation_max:
        return float(needed[worst])
    acknacks = np.minimum(link.acknack_share * sent_hz, link.acknack_most_hz)
    taken = link.data_s[worst] * sent_hz + link.acknack_s[worst] * acknacks
    largest = tuple(topics[i].name for i in np.argsort(-taken, kind="stable")[:3])
    raise InfeasiblePlanError(link.senders[worst], float(needed[worst]), limits.utilisation_max, largest)
