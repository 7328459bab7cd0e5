"""Schema-driven traffic routing: paper A, section 4.1, Eq. 1 and Table 1."""

from __future__ import annotations

from sfglab.fleet.routing.policy import TABLE_1, Crossing, Direction, ForwardRule, Policy, Side

__all__ = ["TABLE_1", "Crossing", "Direction", "ForwardRule", "Policy", "Side"]
