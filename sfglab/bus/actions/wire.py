"""Actions as they are on the bus: names below `_action`, their quality of service, ids and stamps.

Knows the two topics and three services of an action (design.ros2.org, "Actions"; `rcl_action`'s defaults) and
how values become messages. Refuses to know when any of it is sent.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from sfglab.bus.actions.goals import NO_GOAL_ID, Goal, GoalStatus
from sfglab.messages import message_type, ns_from_stamp, stamp_from_ns
from sfglab.names import ResourceKind, validate_ros_name
from sfglab.qos import DEFAULT, LATCHED

if TYPE_CHECKING:
    from collections.abc import Iterable


CANCEL_GOAL = "action_msgs/srv/CancelGoal"
STATUS = "action_msgs/msg/GoalStatusArray"
# rcl_action's rcl_action_qos_profile_status_default; feedback has rmw's default, services their own.
STATUS_QOS = LATCHED
FEEDBACK_QOS = DEFAULT


@dataclass(frozen=True, slots=True, kw_only=True)
class ActionTopics:
    """The ROS names of one action's services and topics; hidden, as a token starts with an underscore."""

    send_goal: str
    cancel_goal: str
    get_result: str
    feedback: str
    status: str


def action_topics(name: str) -> ActionTopics:
    """Return the names below an action's.

    Args:
        name: The absolute name.

    Raises:
        FqnError: It is none, or too long for an action.
    """
    below = f"{validate_ros_name(name, ResourceKind.ACTION)}/_action/"
    return ActionTopics(
        send_goal=f"{below}send_goal",
        cancel_goal=f"{below}cancel_goal",
        get_result=f"{below}get_result",
        feedback=f"{below}feedback",
        status=f"{below}status",
    )


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


def read_goal_info(message: Any) -> tuple[bytes, int]:
    """Return a `GoalInfo`'s id and stamp in nanoseconds."""
    return goal_id_from(message.goal_id), ns_from_stamp(message.stamp)


def status_array(goals: Iterable[Goal]) -> Any:
    """Return an `action_msgs/msg/GoalStatusArray`."""
    type_ = message_type("action_msgs/msg/GoalStatus")
    return message_type(STATUS)(
        status_list=[
            type_(goal_info=goal_info(goal.goal_id, goal.accepted_ns), status=int(goal.status))
            for goal in goals
        ]
    )


def read_statuses(message: Any) -> dict[bytes, GoalStatus]:
    """Return the statuses in a `GoalStatusArray` by goal; a number that is none counts as UNKNOWN."""
    known = set(itertools.chain(GoalStatus))
    return {
        goal_id_from(entry.goal_info.goal_id): GoalStatus(entry.status)
        if entry.status in known
        else GoalStatus.UNKNOWN
        for entry in message.status_list
    }
