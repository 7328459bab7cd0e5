"""The bus: publish, subscribe, call and look around, in rclpy's vocabulary, to be awaited.

`Node` is live: DDS between hosts and with ROS 2 nodes, shared memory on one host. Components annotate with the
classes here, receive the node as an argument and take the time only from `Node.get_clock`: so they run over any
backend, such as the simulated world (`sfglab.bus.sim`).
"""

from __future__ import annotations

from sfglab.bus.actions.client import ActionClient, ClientGoalHandle, GoalResult
from sfglab.bus.actions.goals import CancelCode, GoalStatus
from sfglab.bus.actions.server import ActionServer, CancelResponse, GoalResponse, ServerGoalHandle
from sfglab.bus.api import (
    EndpointAdded,
    EndpointEvent,
    EndpointInfo,
    EndpointKind,
    EndpointRemoved,
    MessageInfo,
)
from sfglab.bus.backend import Clock
from sfglab.bus.dds.domain import DomainConfig
from sfglab.bus.errors import (
    ActionServerGoneError,
    BusError,
    ClosedError,
    DiscoveryTimeoutError,
    DomainError,
    GoalRejectedError,
    GoalTransitionError,
    InvalidMessageError,
    MessageTooLargeError,
    PublishError,
    ReceiveTimeoutError,
    ServiceTimeoutError,
    UnknownGoalError,
    WrongTypeError,
)
from sfglab.bus.graph import Graph
from sfglab.bus.node import Node, Timer
from sfglab.bus.pubsub import Publisher, Subscription
from sfglab.bus.service import Client, Service

__all__ = [
    "ActionClient",
    "ActionServer",
    "ActionServerGoneError",
    "BusError",
    "CancelCode",
    "CancelResponse",
    "Client",
    "ClientGoalHandle",
    "Clock",
    "ClosedError",
    "DiscoveryTimeoutError",
    "DomainConfig",
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
    "GoalTransitionError",
    "Graph",
    "InvalidMessageError",
    "MessageInfo",
    "MessageTooLargeError",
    "Node",
    "PublishError",
    "Publisher",
    "ReceiveTimeoutError",
    "ServerGoalHandle",
    "Service",
    "ServiceTimeoutError",
    "Subscription",
    "Timer",
    "UnknownGoalError",
    "WrongTypeError",
]
