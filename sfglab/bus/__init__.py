"""The bus: publish, subscribe, call and look around, in rclpy's vocabulary, to be awaited.

`Node` is live: DDS between hosts and with ROS 2 nodes, shared memory on one host. Components are written
against the protocols in `sfglab.bus.api`.
"""

from __future__ import annotations

from sfglab.bus.actions import (
    ActionClient,
    ActionServer,
    ActionServerGoneError,
    CancelCode,
    CancelResponse,
    ClientGoalHandle,
    GoalRejectedError,
    GoalResponse,
    GoalResult,
    GoalStatus,
    GoalTransitionError,
    ServerGoalHandle,
    UnknownGoalError,
)
from sfglab.bus.api import (
    EndpointAdded,
    EndpointEvent,
    EndpointInfo,
    EndpointKind,
    EndpointRemoved,
    MessageInfo,
)
from sfglab.bus.dds.config import DomainConfig
from sfglab.bus.errors import (
    BusError,
    ClosedError,
    DiscoveryTimeoutError,
    DomainError,
    InvalidMessageError,
    MessageTooLargeError,
    PublishError,
    ReceiveTimeoutError,
    ServiceTimeoutError,
    WrongTypeError,
)
from sfglab.bus.graph import Graph
from sfglab.bus.node import Node
from sfglab.bus.publisher import Publisher
from sfglab.bus.service import Client, Service
from sfglab.bus.subscription import Subscription

__all__ = [
    "ActionClient",
    "ActionServer",
    "ActionServerGoneError",
    "BusError",
    "CancelCode",
    "CancelResponse",
    "Client",
    "ClientGoalHandle",
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
    "UnknownGoalError",
    "WrongTypeError",
]
