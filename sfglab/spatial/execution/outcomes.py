"""How the execution of a trajectory can end, in one table.

Knows the action's codes and what each means. Refuses to know when which one is due (`judging`, `follower`).
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

from sfglab.bus import GoalStatus


class Outcome(Enum):
    """How it ended; `OUTCOMES` has the meanings."""

    SUCCEEDED = "succeeded"
    INVALID_TRAJECTORY = "invalid trajectory"
    UNKNOWN_AGENT = "unknown agent"
    UNKNOWN_FRAME = "unknown frame"
    START_TOO_FAR = "start too far"
    LIMITS_EXCEEDED = "limits exceeded"
    BUSY = "busy"
    REJECTED = "rejected"
    PATH_LEFT = "path left"
    GOAL_MISSED = "goal missed"
    CANCELED = "canceled"
    OVERTAKEN = "overtaken"
    FAILED = "failed"


@dataclass(frozen=True, slots=True, kw_only=True)
class Ending:
    """What an outcome is on the wire and to people."""

    status: GoalStatus  #: The goal's last status.
    code: int  #: `error_code` of `sfglab_interfaces/action/FollowTrajectory`.
    refused: bool  #: The agent never moved for this goal.
    meaning: str  #: One clause.


def _refused(code: int, meaning: str) -> Ending:
    return Ending(status=GoalStatus.ABORTED, code=code, refused=True, meaning=meaning)


def _moved(status: GoalStatus, code: int, meaning: str) -> Ending:
    return Ending(status=status, code=code, refused=False, meaning=meaning)


OUTCOMES: dict[Outcome, Ending] = {
    Outcome.SUCCEEDED: _moved(GoalStatus.SUCCEEDED, 0, "the agent went along the whole trajectory"),
    Outcome.INVALID_TRAJECTORY: _refused(1, "empty, times that do not increase, or a pose that is none"),
    Outcome.UNKNOWN_AGENT: _refused(2, "this server moves no such agent"),
    Outcome.UNKNOWN_FRAME: _refused(3, "the poses are in another frame than the agent's"),
    Outcome.START_TOO_FAR: _refused(7, "the agent is too far from where the trajectory is now"),
    Outcome.LIMITS_EXCEEDED: _refused(8, "the trajectory is faster than the agent can go"),
    Outcome.BUSY: _refused(9, "the agent is on its way along another trajectory"),
    Outcome.REJECTED: _refused(0, "the server took no such goal, and did not say why"),
    Outcome.PATH_LEFT: _moved(GoalStatus.ABORTED, 4, "the agent was too far from where it should have been"),
    Outcome.GOAL_MISSED: _moved(GoalStatus.ABORTED, 5, "the agent was not at the last pose in time"),
    Outcome.CANCELED: _moved(GoalStatus.CANCELED, 6, "somebody canceled the goal, and the agent braked"),
    Outcome.OVERTAKEN: _moved(GoalStatus.ABORTED, 6, "another goal took its place"),
    Outcome.FAILED: _moved(GoalStatus.ABORTED, 0, "the server ended, or failed"),
}
"""Every outcome. A server that refuses a goal takes it and aborts it at once, because on ROS 2 the answer to a
goal is yes or no, and only a result can say why; `REJECTED` is the plain no."""

_BY_CODE = {(e.status, e.code): outcome for outcome, e in OUTCOMES.items() if outcome is not Outcome.REJECTED}


def outcome_of(status: GoalStatus, code: int) -> Outcome:
    """Return the outcome of a goal's last status and its result's code; `FAILED` for what is in no table."""
    return _BY_CODE.get((status, code), Outcome.FAILED)
