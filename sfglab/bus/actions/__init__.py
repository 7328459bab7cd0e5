"""Actions: goals that take their time, with feedback on the way, a result at the end, and a way to cancel.

As ROS 2 defines them (design.ros2.org, "Actions"), on the services and topics of any node of the bus, live or
simulated; made by `Node.create_action_server` and `Node.create_action_client`. Because they are built of
services, a peer must frame these as rmw_cyclonedds does.
"""

from __future__ import annotations

from sfglab.bus.actions.client import ActionClient, ClientGoalHandle
from sfglab.bus.actions.engine import ActionServerOptions
from sfglab.bus.actions.errors import (
    ActionServerGoneError,
    GoalRejectedError,
    GoalTransitionError,
    UnknownGoalError,
)
from sfglab.bus.actions.goals import NO_GOAL_ID, CancelCode, GoalEvent, GoalStatus
from sfglab.bus.actions.handle import CancelResponse, GoalResponse, ServerGoalHandle
from sfglab.bus.actions.routing import CancelReply, GoalResult
from sfglab.bus.actions.server import ActionServer

__all__ = [
    "NO_GOAL_ID",
    "ActionClient",
    "ActionServer",
    "ActionServerGoneError",
    "ActionServerOptions",
    "CancelCode",
    "CancelReply",
    "CancelResponse",
    "ClientGoalHandle",
    "GoalEvent",
    "GoalRejectedError",
    "GoalResponse",
    "GoalResult",
    "GoalStatus",
    "GoalTransitionError",
    "ServerGoalHandle",
    "UnknownGoalError",
]
