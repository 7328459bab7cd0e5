"""Goals of an action: their states, and how ids, statuses and names stand on the bus.

Sources: design.ros2.org, "Actions"; `rcl_action`'s defaults.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
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
# rcl_action's rcl_action_qos_profile_status_default; feedback has rmw's default, services their own.
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
    """Events of a goal on its server."""

    EXECUTE = "execute"
    CANCEL_GOAL = "cancel_goal"
    SUCCEED = "succeed"
    ABORT = "abort"
    CANCELED = "canceled"


class CancelCode(IntEnum):
    """Answers to a request to cancel; the numbers of `action_msgs/srv/CancelGoal`."""

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


@dataclass(frozen=True, slots=True, kw_only=True)
class Canceling:
    """The goals that a request to cancel selects, and the server's answer."""

    #: NONE if goals are canceled, or if there was none to cancel; otherwise the reason.
    code: CancelCode
    goal_ids: tuple[bytes, ...] = ()  #: Goals that are canceled, or may be, oldest first.


def to_cancel(statuses: Mapping[bytes, GoalStatus], goal_id: bytes, stamp_ns: int) -> Canceling:
    """Return which of a server's goals a request is about: one, or all without an id and a time.

    Goals are not canceled by the time of their acceptance: such a request without an id is rejected.
    """
    cancelable = tuple(
        known for known, status in statuses.items() if is_allowed(status, GoalEvent.CANCEL_GOAL)
    )
    if goal_id == NO_GOAL_ID:
        if stamp_ns:
            return Canceling(code=CancelCode.REJECTED)
        return Canceling(code=CancelCode.NONE, goal_ids=cancelable)
    if goal_id in cancelable:
        return Canceling(code=CancelCode.NONE, goal_ids=(goal_id,))
    # Also of a goal that is CANCELING, as in rcl_action.
    is_known = goal_id in statuses
    code = CancelCode.GOAL_TERMINATED if is_known else CancelCode.UNKNOWN_GOAL_ID
    return Canceling(code=code)


@dataclass(frozen=True, slots=True, kw_only=True)
class ActionTopics:
    """The ROS names of one action's services and topics; hidden, as a token starts with an underscore."""

    send_goal: str
    cancel_goal: str
    get_result: str
    feedback: str
    status: str


def action_topics(name: str) -> ActionTopics:
    """Return the names below an action's absolute one.

    Raises:
        FqnError: It is none, or too long for an action.
    """
    below = f"{validate_ros_name(name, ResourceKind.ACTION)}/_action/"
    return ActionTopics(**{field.name: f"{below}{field.name}" for field in fields(ActionTopics)})


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
