"""The bus: publish, subscribe, call and look around, in rclpy's vocabulary, to be awaited.

`Node` is live. Components receive a node as an argument and take the time only from `Node.get_clock`, so they
run over any backend, such as the simulated world (`sfglab.bus.sim`).
"""

from sfglab.bus.actions.client import ClientGoalHandle, GoalResult
from sfglab.bus.actions.goals import CancelCode, GoalStatus
from sfglab.bus.actions.server import CancelResponse, GoalResponse, ServerGoalHandle
from sfglab.bus.api import EndpointAdded, EndpointEvent, EndpointInfo, EndpointKind, EndpointRemoved
from sfglab.bus.backend import Clock
from sfglab.bus.errors import (
    ActionServerGoneError,
    BusError,
    BusTimeoutError,
    ClosedError,
    DomainError,
    GoalRejectedError,
    InvalidMessageError,
    PublishError,
)
from sfglab.bus.graph import Graph
from sfglab.bus.node import Node
from sfglab.bus.pubsub import Publisher, Subscription
from sfglab.bus.service import Service

__all__ = [
    "ActionServerGoneError",
    "BusError",
    "BusTimeoutError",
    "CancelCode",
    "CancelResponse",
    "ClientGoalHandle",
    "Clock",
    "ClosedError",
    "DomainError",
    "EndpointAdded",
    "EndpointEvent",
    "EndpointInfo",
    "EndpointKind",
    "EndpointRemoved",
    "GoalRejectedError",
    "GoalResponse",
    "GoalResult",
    "GoalStatus",
    "Graph",
    "InvalidMessageError",
    "Node",
    "PublishError",
    "Publisher",
    "ServerGoalHandle",
    "Service",
    "Subscription",
]
