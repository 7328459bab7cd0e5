"""Trajectories carried out: sent to an action's server, and a server that moves a simulated agent.

Paper A, section 4.5: the trajectory inspector publishes to a configurable ROS 2 action server. Bottom up:
`orders` (what an agent takes, outcomes, messages), `agent` (how it moves), `server`, `client`.
"""

from __future__ import annotations

from sfglab.spatial.execution.agent import (
    TRANSITIONS,
    AgentState,
    Dynamics,
    Follower,
    Phase,
    Tolerances,
)
from sfglab.spatial.execution.client import Execution, execute, scene_orders, send
from sfglab.spatial.execution.orders import (
    FOLLOW_TRAJECTORY,
    OUTCOMES,
    ActionDialect,
    Ended,
    ExecutionError,
    Feedback,
    Order,
    Outcome,
    RefusalError,
    Rules,
    action_name,
    judge,
    outcome_of,
)
from sfglab.spatial.execution.server import AgentSetup, TrajectoryServer

__all__ = [
    "FOLLOW_TRAJECTORY",
    "OUTCOMES",
    "TRANSITIONS",
    "ActionDialect",
    "AgentSetup",
    "AgentState",
    "Dynamics",
    "Ended",
    "Execution",
    "ExecutionError",
    "Feedback",
    "Follower",
    "Order",
    "Outcome",
    "Phase",
    "RefusalError",
    "Rules",
    "Tolerances",
    "TrajectoryServer",
    "action_name",
    "execute",
    "judge",
    "outcome_of",
    "scene_orders",
    "send",
]
