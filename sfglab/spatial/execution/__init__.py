"""Trajectories carried out: sent to an action's server, and a server that moves a simulated agent.

Paper A, section 4.5: the trajectory inspector publishes to a configurable ROS 2 action server. Bottom up:
`outcomes`, `agent` and `follower` (how it moves), `judging` (what it takes), `wire` (messages), `server`,
`client`.
"""

from __future__ import annotations

from sfglab.spatial.execution.agent import AgentState, Dynamics, DynamicsError, Target, braked, steered
from sfglab.spatial.execution.client import ExecuteOptions, Execution, execute, scene_orders, send
from sfglab.spatial.execution.follower import (
    TRANSITIONS,
    Follower,
    FollowerEvent,
    Phase,
    Progress,
    Tolerances,
)
from sfglab.spatial.execution.judging import ExecutionError, Order, RefusalError, Rules, judge
from sfglab.spatial.execution.outcomes import OUTCOMES, Ending, Outcome, outcome_of
from sfglab.spatial.execution.server import AgentSetup, TrajectoryServer
from sfglab.spatial.execution.wire import FOLLOW_TRAJECTORY, ActionDialect, Ended, Feedback, action_name

__all__ = [
    "FOLLOW_TRAJECTORY",
    "OUTCOMES",
    "TRANSITIONS",
    "ActionDialect",
    "AgentSetup",
    "AgentState",
    "Dynamics",
    "DynamicsError",
    "Ended",
    "Ending",
    "ExecuteOptions",
    "Execution",
    "ExecutionError",
    "Feedback",
    "Follower",
    "FollowerEvent",
    "Order",
    "Outcome",
    "Phase",
    "Progress",
    "RefusalError",
    "Rules",
    "Target",
    "Tolerances",
    "TrajectoryServer",
    "action_name",
    "braked",
    "execute",
    "judge",
    "outcome_of",
    "scene_orders",
    "send",
    "steered",
]
