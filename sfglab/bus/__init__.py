"""Nodes of ROS 2 for asyncio, named as in rclpy: publishers, subscriptions, services, actions and the graph.

`Node` joins a DDS domain. A component receives its node as an argument and reads the time only from
`Node.get_clock`. It therefore runs over any backend, such as the simulated world (`sfglab.bus.sim`). A public
name is loaded from its module at its first use. A process that needs only addresses starts in a third of the
time.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from sfglab.lazy import loader

__all__ = [
    "BusError",
    "BusTimeoutError",
    "CancelCode",
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
    "BusError": "errors",
    "BusTimeoutError": "errors",
    "CancelCode": "actions.goals",
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
    from sfglab.bus.actions.server import ServerGoalHandle
    from sfglab.bus.api import (
        EndpointAdded,
        EndpointEvent,
        EndpointInfo,
        EndpointKind,
        EndpointRemoved,
    )
    from sfglab.bus.backend import Clock
    from sfglab.bus.errors import (
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
