"""The printed optimum, Eq. 1 to 6, by CVXPY and by the closed form, and the Pareto front of our own problem."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from itertools import product
from typing import TYPE_CHECKING, Any

import numpy as np

from sfglab.arp import Plan, balancing, load_topics, pareto_front, plan_as_printed
from sfglab.lab.checks import CheckRow, check_row
from sfglab.lab.experiments.balancing.experiment import Config, exp
from sfglab.lab.paths import find_project

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from sfglab.lab.bench import Bench

WEIGHTS = (0.05, 0.5, 0.95)
_TOLERANCE = 1e-5  #: Relative; the solver stops at 1e-8 of the objective.
_NAN = float("nan")


@exp.table("balance")
@dataclass(frozen=True, slots=True, kw_only=True)
class BalanceRow:
    """Eq. 6 solved twice."""

    topics: str  #: Topics of each agent, as text.
    rate_max_hz: int  #: Rmax.
    rate_min_hz: float  #: Rmin.
    depth_min: float  #: Dmin.
    weight: float  #: Share of R in the objective.
    solvable: bool  #: Whether CVXPY found an optimum.
    solvable_closed: bool  #: Whether the closed form did.
    rate_hz: float  #: R by CVXPY; NaN without an optimum.
    depth: float  #: D by CVXPY.
    rate_closed_hz: float  #: R by the closed form.
    depth_closed: float  #: D by the closed form.
    why: str  #: Which constraint fails, and by how much.


@exp.part("Eq. 6", timed=False)
def solve_printed(bench: Bench[Config]) -> None:
    """Solve every combination of topics, Rmax, Rmin and weight twice, and compare."""
    rows = list(balance_rows(bench.config))
    bench.write_all("balance", rows)
    bench.write_all("check", balance_checks(rows))


def balance_rows(config: Config) -> Iterator[BalanceRow]:
    """Yield every combination, solved."""
    for case in product(
        config.topics, config.rates_hz, config.rates_min_hz, config.depths_min, WEIGHTS
    ):
        topics, rate_max_hz, rate_min_hz, depth_min, weight = case
        of: dict[str, Any] = {
            "rate_max_hz": rate_max_hz,
            "rate_min_hz": rate_min_hz,
            "depth_min": depth_min,
        }
        given = balancing.BalanceInput(topics=topics, **of)
        solved, why = _attempt(partial(balancing.balance, given, weight=weight))
        closed, why_closed = _attempt(partial(balancing.balance_closed_form, given))
        yield BalanceRow(
            topics="+".join(map(str, topics)),
            **of,
            weight=weight,
            solvable=solved is not None,
            solvable_closed=closed is not None,
            rate_hz=solved.rate_hz if solved else _NAN,
            depth=solved.depth if solved else _NAN,
            rate_closed_hz=closed.rate_hz if closed else _NAN,
            depth_closed=closed.depth if closed else _NAN,
            why=why or why_closed,
        )


def _attempt(solve: Callable[[], balancing.Balance]) -> tuple[balancing.Balance | None, str]:
    try:
        return solve(), ""
    except balancing.InfeasibleBalanceError as error:
        return None, str(error)


def balance_checks(rows: list[BalanceRow]) -> Iterator[CheckRow]:
    """Yield how often CVXPY and the closed form agree in `balance_rows`, and how often the equations hold."""
    name = "OPT: CVXPY finds an optimum where the closed form does, and nowhere else"
    yield check_row(name, [(str(row), row.solvable == row.solvable_closed) for row in rows])
    checks: dict[str, Callable[[BalanceRow], bool]] = {
        "OPT: R is the closed form's": lambda r: _close(r.rate_hz, r.rate_closed_hz),
        "OPT: D is the closed form's": lambda r: _close(r.depth, r.depth_closed),
        "OPT: Eq. 4 holds, and Rmin <= R <= Rmax": lambda r: (
            _at_most(r.rate_hz + r.rate_min_hz, r.rate_max_hz / mean_topics(r.topics))
            and _at_most(r.rate_min_hz, r.rate_hz)
            and _at_most(r.rate_hz, r.rate_max_hz)
        ),
        # By the paper's own figures, without our functions: what is left of Dmax, 5000, is all that D may take.
        "OPT: Eq. 5 holds with nothing to spare, and Dmin <= D <= Dmax": lambda r: (
            _close(5000 * r.rate_hz / r.rate_max_hz - r.depth_min, r.depth)
            and _at_most(r.depth_min, r.depth)
            and _at_most(r.depth, 5000)
        ),
    }
    for name, holds in checks.items():
        yield check_row(name, [(str(row), holds(row)) for row in rows if row.solvable])


def mean_topics(topics: str) -> float:
    """Return T_avg of a row's topics."""
    return balancing.average_topics([int(part) for part in topics.split("+")])


def _close(one: float, other: float) -> bool:
    return abs(one - other) <= _TOLERANCE * abs(other)


def _at_most(one: float, other: float) -> bool:
    return one <= other + _TOLERANCE * abs(other)


@exp.table("front")
@dataclass(frozen=True, slots=True, kw_only=True)
class FrontRow:
    """A point of our own problem's Pareto front, or the printed optimum judged alike."""

    method: str  #: ``ours`` or ``printed``.
    rate_max_hz: int  #: Rmax.
    latency_price_hz: float  #: Price of latency; NaN for the printed optimum.
    rate_low_hz: float  #: Rate of the slowest topic.
    rate_high_hz: float  #: Rate of the fastest topic.
    depth_high: int  #: Deepest history.
    utilisation: float  #: Share of the air that is taken; above 1, more than there is.
    freshness: float  #: Share of time in which the value sent last is still true, mean over topics.
    latency_ms: float  #: Mean expected latency; infinite where the air is overloaded.
    #: Share of time in which the station has the sensor's value, expected, mean over topics.
    up_to_date: float
    airtime_price: float  #: Shadow price of the air; NaN for the printed optimum.
    chosen: bool  #: Whether it is the point that is used.


@exp.part("Pareto front", timed=False)
def solve_own(bench: Bench[Config]) -> None:
    """Write our problem's Pareto front and the printed optimum for every Rmax."""
    config = bench.config
    given = load_topics(find_project().data / config.topic_file)
    prices = tuple(float(price) for price in np.geomspace(0.1, 1000, config.weights))
    for rate in config.rates_hz:
        limited = given.limited_to(float(rate))
        points = pareto_front(limited.topics, limited.medium, limited.vendor, prices_hz=prices)
        best = max(points, key=lambda point: point.up_to_date)
        bench.write_all(
            "front", (_front_row(point, rate, chosen=point is best) for point in points)
        )
        bench.write("front", _front_row(plan_as_printed(limited), rate, chosen=False))


def _front_row(point: Plan, rate_max_hz: int, *, chosen: bool) -> FrontRow:
    return FrontRow(
        method=point.method,
        rate_max_hz=rate_max_hz,
        latency_price_hz=_NAN if point.latency_price_hz is None else point.latency_price_hz,
        rate_low_hz=float(point.rates_hz.min()),
        rate_high_hz=float(point.rates_hz.max()),
        depth_high=max(part.depth for part in point.topics),
        utilisation=point.utilisation,
        freshness=point.freshness,
        latency_ms=1e3 * point.latency_s,
        up_to_date=point.up_to_date,
        airtime_price=_NAN if point.airtime_price is None else point.airtime_price,
        chosen=chosen,
    )
