"""The bus: publish, subscribe, call and look around, in rclpy's vocabulary, to be awaited.

`Node` is live. Components receive a node as an argument and take the time only from `Node.get_clock`, so they
run over any backend, such as the simulated world (`sfglab.bus.sim`). A public name is loaded from its module at its
first use: a process that only needs addresses starts in a third of the time.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from sfglab.lazy import loader

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

_MODULES = {
    "ActionServerGoneError": "errors",
    "BusError": "errors",
    "BusTimeoutError": "errors",
    "CancelCode": "actions.goals",
    "CancelResponse": "actions.server",
    "ClientGoalHandle": "actions.client",
    "Clock": "backend",
    "ClosedError": "errors",
    "DomainError": "errors",
    "EndpointAdded": "api",
    "EndpointEvent": "api",
    "EndpointInfo": "api",
    "EndpointKind": "api",
    "EndpointRemoved": "api",
    "GoalRejectedError": "errors",
    "GoalResponse": "actions.server",
    "GoalResult": "actions.client",
    "GoalStatus": "actions.goals",
    "Graph": "graph",
    "InvalidMessageError": "errors",
    "Node": "node",
    "PublishError": "errors",
    "Publisher": "pubsub",
    "ServerGoalHandle": "actions.server",
    "Service": "service",
    "Subscription": "pubsub",
}

if TYPE_CHECKING:
    from sfglab.bus.actions.client import ClientGoalHandle, GoalResult
    from sfglab.bus.actions.goals import CancelCode, GoalStatus
    from sfglab.bus.actions.server import CancelResponse, GoalResponse, ServerGoalHandle
    from sfglab.bus.api import (
        EndpointAdded,
        EndpointEvent,
        EndpointInfo,
        EndpointKind,
        EndpointRemoved,
    )
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
else:
    __getattr__ = loader(__name__, _MODULES)
