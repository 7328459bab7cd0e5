"""Goals of an action: their states, and their ids, statuses and names in messages.

Sources: design.ros2.org, "Actions"; `rcl_action`'s defaults.
"""

from __future__ import annotations

from enum import Enum, IntEnum
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np

from sfglab.messages import message_type, stamp_from_ns
from sfglab.names import ResourceKind, validate_ros_name
from sfglab.qos import DEFAULT, LATCHED

if TYPE_CHECKING:
    from collections.abc import Mapping

NO_GOAL_ID = bytes(16)
CANCEL_GOAL = "action_msgs/srv/CancelGoal"
STATUS = "action_msgs/msg/GoalStatusArray"
# Status has rcl_action's rcl_action_qos_profile_status_default, feedback has rmw's default profile.
STATUS_QOS = LATCHED
FEEDBACK_QOS = DEFAULT
#: Number of ended goals whose results a server keeps, and of goals whose feedback a client takes.
KEPT_GOALS = 100


class GoalStatus(IntEnum):
    """States of a goal; the numbers of `action_msgs/msg/GoalStatus`."""

    UNKNOWN = 0
    ACCEPTED = 1
    EXECUTING = 2
    CANCELING = 3
    SUCCEEDED = 4
    CANCELED = 5
    ABORTED = 6


class GoalEvent(Enum):
    """Events of a goal's state machine on its server, named as in rcl_action's `rcl_action_goal_event_t`."""

    EXECUTE = "execute"
    CANCEL_GOAL = "cancel_goal"
    SUCCEED = "succeed"
    ABORT = "abort"
    CANCELED = "canceled"


class CancelCode(IntEnum):
    """Return codes of a cancel request; the numbers of `action_msgs/srv/CancelGoal`."""

    NONE = 0
    REJECTED = 1
    UNKNOWN_GOAL_ID = 2
    GOAL_TERMINATED = 3


# design.ros2.org, "Actions", "Goal States".
TRANSITIONS: Mapping[tuple[GoalStatus, GoalEvent], GoalStatus] = MappingProxyType(
    {
        (GoalStatus.ACCEPTED, GoalEvent.EXECUTE): GoalStatus.EXECUTING,
        (GoalStatus.ACCEPTED, GoalEvent.CANCEL_GOAL): GoalStatus.CANCELING,
        (GoalStatus.EXECUTING, GoalEvent.CANCEL_GOAL): GoalStatus.CANCELING,
        (GoalStatus.EXECUTING, GoalEvent.SUCCEED): GoalStatus.SUCCEEDED,
        (GoalStatus.EXECUTING, GoalEvent.ABORT): GoalStatus.ABORTED,
        (GoalStatus.CANCELING, GoalEvent.SUCCEED): GoalStatus.SUCCEEDED,
        (GoalStatus.CANCELING, GoalEvent.ABORT): GoalStatus.ABORTED,
        (GoalStatus.CANCELING, GoalEvent.CANCELED): GoalStatus.CANCELED,
    }
)
TERMINAL = frozenset({GoalStatus.SUCCEEDED, GoalStatus.CANCELED, GoalStatus.ABORTED})


def is_allowed(status: GoalStatus, event: GoalEvent) -> bool:
    """Return whether an event may happen to a goal of this status."""
    return (status, event) in TRANSITIONS


def to_cancel(
    statuses: Mapping[bytes, GoalStatus], goal_id: bytes, stamp_ns: int
) -> tuple[CancelCode, tuple[bytes, ...]]:
    """Return the response to a cancel request and the goals that it selects: one goal, or all without an id.

    Goals cannot be selected by the time of their acceptance: a request with a time and no id is rejected.
    """
    cancelable = tuple(
        known for known, status in statuses.items() if is_allowed(status, GoalEvent.CANCEL_GOAL)
    )
    if goal_id == NO_GOAL_ID:
        return (CancelCode.REJECTED, ()) if stamp_ns else (CancelCode.NONE, cancelable)
    if goal_id in cancelable:
        return CancelCode.NONE, (goal_id,)
    # A goal that is CANCELING counts as terminated, as in rcl_action.
    is_known = goal_id in statuses
    return CancelCode.GOAL_TERMINATED if is_known else CancelCode.UNKNOWN_GOAL_ID, ()


_ENDPOINTS = ("send_goal", "cancel_goal", "get_result", "feedback", "status")


def action_topics(name: str) -> dict[str, str]:
    """Return the names of an action's services and topics, given its absolute name; tools hide such names.

    Raises:
        FqnError: The name is no absolute name, or too long for an action.
    """
    below = f"{validate_ros_name(name, ResourceKind.ACTION)}/_action/"
    return {endpoint: below + endpoint for endpoint in _ENDPOINTS}


def uuid_message(goal_id: bytes) -> Any:
    """Return a `unique_identifier_msgs/msg/UUID`."""
    return message_type("unique_identifier_msgs/msg/UUID")(uuid=np.frombuffer(goal_id, np.uint8))


def goal_id_from(message: Any) -> bytes:
    """Return the 16 bytes of a `unique_identifier_msgs/msg/UUID`."""
    return bytes(bytearray(message.uuid))


def goal_info(goal_id: bytes = NO_GOAL_ID, stamp_ns: int = 0) -> Any:
    """Return an `action_msgs/msg/GoalInfo`."""
    type_ = message_type("action_msgs/msg/GoalInfo")
    return type_(goal_id=uuid_message(goal_id), stamp=stamp_from_ns(stamp_ns))
