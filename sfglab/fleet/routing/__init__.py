"""Schema-driven traffic routing: paper A, section 4.1, Eq. 1 and Table 1.

Bottom up: `policy` (what crosses), `merge` (with which QoS), `paths` (what has to be open), `replies` (which
requests have to wait), `plan` (what to open and close when), `frames` and `transforms` (prefixes), `carrier`
(does it), `router` (the node), `lock` and `app` (the router as a process).
"""

from __future__ import annotations

from sfglab.fleet.routing.policy import TABLE_1, Crossing, Direction, ForwardRule, Policy, Side

__all__ = ["TABLE_1", "Crossing", "Direction", "ForwardRule", "Policy", "Side"]
