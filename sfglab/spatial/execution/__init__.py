"""Trajectories carried out: sent to an action's server, and a server that moves a simulated agent.

Paper A, section 4.5: the trajectory inspector publishes to a configurable ROS 2 action server. Bottom up:
`orders` (what an agent takes, outcomes, messages), `agent` (how it moves), `server`, `client`.
"""

from __future__ import annotations

from sfglab.spatial.execution.agent import Dynamics, Tolerances
from sfglab.spatial.execution.client import Execution, execute, scene_orders, send
from sfglab.spatial.execution.orders import FOLLOW_TRAJECTORY, ActionDialect, Ended, Feedback, Order, Outcome
from sfglab.spatial.execution.server import AgentSetup, TrajectoryServer

__all__ = [
    "FOLLOW_TRAJECTORY",
    "ActionDialect",
    "AgentSetup",
    "Dynamics",
    "Ended",
    "Execution",
    "Feedback",
    "Order",
    "Outcome",
    "Tolerances",
    "TrajectoryServer",
    "execute",
    "scene_orders",
    "send",
]
