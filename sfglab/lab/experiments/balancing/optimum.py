"""Eq. 1 to 6 solved with CVXPY and by the closed form, over topics, limits and weights. Exact."""

from __future__ import annotations

from itertools import product
from typing import TYPE_CHECKING

from sfglab.arp.balancing import BalanceInput, InfeasibleBalanceError, balance, balance_closed_form
from sfglab.lab.checks import CheckRow
from sfglab.lab.experiments.balancing.rows import BalanceRow

if TYPE_CHECKING:
    from collections.abc import Callable

    from sfglab.arp.balancing import Balance
    from sfglab.lab.experiments.balancing.config import Config


WEIGHTS = (0.05, 0.5, 0.95)
_TOLERANCE = 1e-5
"""Relative; the solver stops at 1e-8 of the objective."""


def balance_rows(config: Config) -> list[BalanceRow]:
    """Solve every combination of topics, Rmax, Rmin and weight."""
    combinations = product(config.topics, config.rates_hz, config.rates_min_hz, WEIGHTS)
    return [_solve(topics, rate_max, rate_min, weight) for topics, rate_max, rate_min, weight in combinations]


def _solve(topics: tuple[int, ...], rate_max_hz: int, rate_min_hz: float, weight: float) -> BalanceRow:
    given = BalanceInput(topics=topics, rate_max_hz=rate_max_hz, rate_min_hz=rate_min_hz)
    solved, why = _attempt(lambda: balance(given, weight=weight))
    closed, why_closed = _attempt(lambda: balance_closed_form(given))
    nan = float("nan")
    return BalanceRow(
        topics="+".join(map(str, topics)),
        rate_max_hz=rate_max_hz,
        rate_min_hz=rate_min_hz,
        weight=weight,
        solvable=solved is not None,
        solvable_closed=closed is not None,
        rate_hz=solved.rate_hz if solved else nan,
        depth=solved.depth if solved else nan,
        rate_closed_hz=closed.rate_hz if closed else nan,
        depth_closed=closed.depth if closed else nan,
        why=why or why_closed,
    )


def _attempt(solve: Callable[[], Balance]) -> tuple[Balance | None, str]:
    try:
        return solve(), ""
    except InfeasibleBalanceError as error:
        return None, str(error)


def balance_checks(rows: list[BalanceRow]) -> list[CheckRow]:
    """Return how often CVXPY and the closed form agree, and how often the equations hold.

    Args:
        rows: From `balance_rows`.
    """
    checks: dict[str, Callable[[BalanceRow], bool]] = {
        "OPT: CVXPY finds an optimum where the closed form does, and nowhere else": lambda r: (
            r.solvable == r.solvable_closed
        ),
        "OPT: R is the closed form's": lambda r: _close(r.rate_hz, r.rate_closed_hz),
        "OPT: D is the closed form's": lambda r: _close(r.depth, r.depth_closed),
        "OPT: Eq. 4 holds, and Rmin <= R <= Rmax": lambda r: (
            _at_most(r.rate_hz + r.rate_min_hz, r.rate_max_hz / _average(r.topics))
            and _at_most(r.rate_min_hz, r.rate_hz)
            and _at_most(r.rate_hz, r.rate_max_hz)
        ),
    }
    found = [row for row in rows if row.solvable]
    results = []
    for name, holds in checks.items():
        rows_ = rows if "optimum where" in name else found
        failed = [row for row in rows_ if not holds(row)]
        example = str((failed or rows_)[0])
        results.append(CheckRow(check=name, checked=len(rows_), held=len(rows_) - len(failed), example=example))
    return results


def _average(topics: str) -> float:
    counts = [int(part) for part in topics.split("+")]
    return sum(counts) / len(counts)


def _close(one: float, other: float) -> bool:
    return abs(one - other) <= _TOLERANCE * abs(other)


def _at_most(one: float, other: float) -> bool:
    return one <= other + _TOLERANCE * abs(other)
