"""The convex programme itself, at given depths: its problem for CVXPY, and its solution.

Airtime counts acknowledgements, a share of the samples and at most so many a second, as a reader bundles them;
of a topic behind a local cache only changes travel, min(r, 1 / t) at most. Both are concave. Each is bounded by
one of its two branches, and a topic changes its branch when the solution shows that the other one is smaller
(the convex-concave procedure), so that every solution is feasible and none is worse than the one before.
Refuses to know depths.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from sfglab.arp.limits import ProgrammeError
from sfglab.arp.link import queue_wait_s, repair_delay_s

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray

    from sfglab.arp.limits import Limits
    from sfglab.arp.link import Link
    from sfglab.arp.topics import Topic


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
    ceiling: Any  #: Parameter: share of the largest rate up to which the allowed loss can be kept, shape (n,).
    level: Any  #: Parameter: the most of each sender's time that may be taken.
    price: Any  #: Parameter: what a second of mean latency costs.
    #: Parameters, each of shape (n,): of samples that travel, how many a reading and how many a second, in the
    #: branch that bounds them; then the same of acknowledgements.
    branches: tuple[Any, ...]
    capacity: Any  #: The constraint whose dual value is the price of airtime.


def build_programme(topics: Sequence[Topic], link: Link, limits: Limits) -> Programme:
    """Return the programme, unsolved.

    Args:
        topics: The topics.
        link: What they cost, from `at_depths`.
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
    repairs = weights @ repair_delay_s(link, sent, inverse=_inverse_at(usual))
    return waits + repairs + weights @ link.way_s


def _inverse_at(usual: NDArray[np.float64]) -> Callable[[Any], Any]:
    """Return 1 / x, written so that the solver sees numbers near 1 where x is near its usual value."""
    from cvxpy.atoms.affine.binary_operators import multiply
    from cvxpy.atoms.elementwise.inv_pos import inv_pos

    return lambda x: multiply(1 / usual, inv_pos(multiply(1 / usual, x)))  # type: ignore[no-untyped-call]


def solve(programme: Programme, link: Link, price: float) -> tuple[NDArray[np.float64], float]:
    """Return rates and the capacity's dual value, after the branches have settled.

    Args:
        programme: With its other parameters set.
        link: What it was built with.
        price: What a second of mean latency costs.

    Raises:
        ProgrammeError: The solver ended without an optimum.
    """
    programme.price.value = price
    rates_hz, chosen = programme.bounds_hz[0], None
    # At most so many samples travel, and so many acknowledgements, however often is read.
    shares = np.ones_like(link.acknack_share), link.acknack_share
    most = link.change_most_hz, np.minimum(link.acknack_share * link.change_most_hz, link.acknack_most_hz)
    for _ in range(_ROUNDS_MOST):
        flat = [share * rates_hz > ceiling for share, ceiling in zip(shares, most, strict=True)]
        if chosen is not None and np.array_equal(flat, chosen):
            break
        chosen = flat
        for i, (there, share, ceiling) in enumerate(zip(flat, shares, most, strict=True)):
            programme.branches[2 * i].value = np.where(there, 0.0, share)
            programme.branches[2 * i + 1].value = np.where(there, ceiling, 0.0)
        _run_solver(programme.problem)
        rates_hz = np.clip(programme.rates.value, *programme.bounds_hz)
    return rates_hz, float(np.max(programme.capacity.dual_value))


def _run_solver(problem: Any) -> None:
    problem.solve(solver="CLARABEL", **_TOLERANCES)
    if problem.status != "optimal":
        raise ProgrammeError(f"QoS plan: solver CLARABEL ended with status {problem.status!r}")
