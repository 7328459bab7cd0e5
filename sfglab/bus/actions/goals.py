"""Goals of an action: their states and policies, and how ids, statuses and names stand on the bus.

Sources: design.ros2.org, "Actions"; `rcl_action`'s defaults. Refuses to know callbacks, clocks and who asks.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from enum import Enum, IntEnum
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np

from sfglab.machine import step
from sfglab.messages import message_type, ns_from_stamp, stamp_from_ns
from sfglab.names import ResourceKind, validate_ros_name
from sfglab.qos import DEFAULT, LATCHED

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

NO_GOAL_ID = bytes(16)
CANCEL_GOAL = "action_msgs/srv/CancelGoal"
STATUS = "action_msgs/msg/GoalStatusArray"
# rcl_action's rcl_action_qos_profile_status_default; feedback has rmw's default, services their own.
STATUS_QOS = LATCHED
FEEDBACK_QOS = DEFAULT


class GoalStatus(IntEnum):
    """Where a goal is in its life; the numbers of `action_msgs/msg/GoalStatus`."""

    UNKNOWN = 0
    ACCEPTED = 1
    EXECUTING = 2
    CANCELING = 3
    SUCCEEDED = 4
    CANCELED = 5
    ABORTED = 6


class GoalEvent(Enum):
    """What happens to a goal on its server."""

    EXECUTE = "execute"
    CANCEL_GOAL = "cancel_goal"
    SUCCEED = "succeed"
    ABORT = "abort"
    CANCELED = "canceled"


class CancelCode(IntEnum):
    """What came of a request to cancel; the numbers of `action_msgs/srv/CancelGoal`."""

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
class Goal:
    """What a server remembers of a goal."""

    goal_id: bytes  #: 16 bytes, chosen by the client.
    accepted_ns: int  #: When it was accepted, by the server's clock (Unix time, nanoseconds).
    status: GoalStatus = GoalStatus.ACCEPTED  #: Its status.
    #: When it ended, by a clock that never jumps (ns); None while it runs.
    ended_ns: int | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Canceling:
    """What comes of a request to cancel."""

    #: NONE when goals are being canceled, or there was none to cancel; else why not.
    code: CancelCode
    goal_ids: tuple[bytes, ...] = ()  #: The goals that are being canceled, or may be, oldest first.


class GoalBook:
    """All goals of one server, each of which is remembered for a time after its end."""

    def __init__(self, result_timeout_ns: int) -> None:
        self._timeout_ns = result_timeout_ns
        self._goals: dict[bytes, Goal] = {}

    def __contains__(self, goal_id: bytes) -> bool:
        return goal_id in self._goals

    def goals(self) -> tuple[Goal, ...]:
        """Return all that are remembered, in the order of their acceptance."""
        return tuple(self._goals.values())

    def status(self, goal_id: bytes) -> GoalStatus:
        """Return a goal's status; UNKNOWN if it is not remembered."""
        goal = self._goals.get(goal_id)
        return GoalStatus.UNKNOWN if goal is None else goal.status

    def accept(self, goal_id: bytes, now_ns: int) -> bool:
        """Remember a goal from now on; False, and nothing else, if its id is taken already."""
        if goal_id in self._goals:
            return False
        self._goals[goal_id] = Goal(goal_id=goal_id, accepted_ns=now_ns)
        return True

    def apply(self, goal_id: bytes, event: GoalEvent, now_ns: int) -> GoalStatus:
        """Return a goal's new status after an event now, by the clock that never jumps.

        Raises:
            IllegalInputError: It may not happen now.
        """
        status = step(f"goal {goal_id.hex()}", TRANSITIONS, self.status(goal_id), event)
        ended_ns = now_ns if status in TERMINAL else None
        self._goals[goal_id] = replace(self._goals[goal_id], status=status, ended_ns=ended_ns)
        return status

    def to_cancel(self, goal_id: bytes, until_ns: int) -> Canceling:
        """Return which goals a request is about (`action_msgs/srv/CancelGoal`).

        Args:
            goal_id: One goal; `NO_GOAL_ID`: none in particular.
            until_ns: All goals that were accepted until then; 0: none for that reason. Without both, all goals.
        """
        single = goal_id != NO_GOAL_ID
        if (
            single and not until_ns and not self._cancelable(goal_id)
        ):  # CANCELING too, as in rcl_action
            known = goal_id in self._goals
            return Canceling(
                code=CancelCode.GOAL_TERMINATED if known else CancelCode.UNKNOWN_GOAL_ID
            )
        everything = not single and not until_ns
        chosen = tuple(
            goal.goal_id
            for goal in self._goals.values()
            if everything or goal.goal_id == goal_id or goal.accepted_ns <= until_ns
        )
        return Canceling(code=CancelCode.NONE, goal_ids=tuple(filter(self._cancelable, chosen)))

    def expire(self, now_ns: int) -> tuple[bytes, ...]:
        """Forget the goals that ended too long ago, by the clock that never jumps, and return which."""
        old = tuple(
            goal.goal_id
            for goal in self._goals.values()
            if goal.ended_ns is not None and now_ns - goal.ended_ns >= self._timeout_ns
        )
        for goal_id in old:
            del self._goals[goal_id]
        return old

    def _cancelable(self, goal_id: bytes) -> bool:
        return is_allowed(self.status(goal_id), GoalEvent.CANCEL_GOAL)


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


def read_goal_info(message: Any) -> tuple[bytes, int]:
    """Return a `GoalInfo`'s id and stamp in nanoseconds."""
    return goal_id_from(message.goal_id), ns_from_stamp(message.stamp)


def status_array(goals: Iterable[Goal]) -> Any:
    """Return an `action_msgs/msg/GoalStatusArray`."""
    type_ = message_type("action_msgs/msg/GoalStatus")
    listed = [
        type_(goal_info=goal_info(g.goal_id, g.accepted_ns), status=int(g.status)) for g in goals
    ]
    return message_type(STATUS)(status_list=listed)


def read_statuses(message: Any) -> dict[bytes, GoalStatus]:
    """Return the statuses in a `GoalStatusArray` by goal; a number that is none counts as UNKNOWN."""
    known = {int(status): status for status in GoalStatus}
    entries = [
        (goal_id_from(entry.goal_info.goal_id), entry.status) for entry in message.status_list
    ]
    return {goal_id: known.get(status, GoalStatus.UNKNOWN) for goal_id, status in entries}
