"""Orders to agents: judged before anybody moves, how they can end, and both as messages of an action.

Ours is `sfglab_interfaces/action/FollowTrajectory`; another, such as nav2_msgs' FollowPath, needs an
`ActionDialect` of its own.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from typing import TYPE_CHECKING, Any

from sfglab.bus import GoalResult, GoalStatus
from sfglab.errors import SfglabError
from sfglab.messages import action_type, message_type, ns_from_stamp
from sfglab.names import Resource, RosFqnBuilder, Scope
from sfglab.spatial.poses import Pose, PoseError, header_msg
from sfglab.spatial.trajectory.exchange import multi_dof_from_trajectory, trajectory_from_multi_dof
from sfglab.spatial.trajectory.limits import Limits, Quantity, limit_violations
from sfglab.spatial.trajectory.motion import pose_at, resampled
from sfglab.spatial.trajectory.path import Interpolation, Trajectory
from sfglab.units import NS_PER_S

if TYPE_CHECKING:
    from collections.abc import Callable


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
    Outcome.INVALID_TRAJECTORY: _refused(
        1, "empty, times that do not increase, or a pose that is none"
    ),
    Outcome.UNKNOWN_AGENT: _refused(2, "this server moves no such agent"),
    Outcome.UNKNOWN_FRAME: _refused(3, "the poses are in another frame than the agent's"),
    Outcome.START_TOO_FAR: _refused(7, "the agent is too far from where the trajectory is now"),
    Outcome.LIMITS_EXCEEDED: _refused(8, "the trajectory is faster than the agent can go"),
    Outcome.BUSY: _refused(9, "the agent is on its way along another trajectory"),
    Outcome.REJECTED: _refused(0, "the server took no such goal, and did not say why"),
    Outcome.PATH_LEFT: _moved(
        GoalStatus.ABORTED, 4, "the agent was too far from where it should have been"
    ),
    Outcome.GOAL_MISSED: _moved(
        GoalStatus.ABORTED, 5, "the agent was not at the last pose in time"
    ),
    Outcome.CANCELED: _moved(
        GoalStatus.CANCELED, 6, "somebody canceled the goal, and the agent braked"
    ),
    Outcome.OVERTAKEN: _moved(GoalStatus.ABORTED, 6, "another goal took its place"),
    Outcome.FAILED: _moved(GoalStatus.ABORTED, 0, "the server ended, or failed"),
}
"""Every outcome. Who refuses a goal takes and aborts it, for only a result can say why, unlike `REJECTED`."""

_BY_CODE = {
    (e.status, e.code): outcome
    for outcome, e in OUTCOMES.items()
    if outcome is not Outcome.REJECTED
}


def outcome_of(status: GoalStatus, code: int) -> Outcome:
    """Return the outcome of a goal's last status and its result's code; `FAILED` for what is in no table."""
    return _BY_CODE.get((status, code), Outcome.FAILED)


class RefusalError(SfglabError, ValueError):
    """An order that an agent does not take."""

    def __init__(self, outcome: Outcome, text: str) -> None:
        self.outcome = outcome  #: Why, as a code.
        self.text = text  #: Why, in words.
        super().__init__(outcome, text)  # all arguments, so that the error survives pickling

    def __str__(self) -> str:
        return f"{self.outcome.value}: {self.text}"


@dataclass(frozen=True, slots=True, kw_only=True)
class Order:
    """A trajectory and who is to move along it."""

    agent: str  #: Its name.
    trajectory: Trajectory  #: Where to be when.
    frame_id: str = "map"  #: The frame of its poses.
    start_ns: int = 0  #: Its time 0, in nanoseconds since the epoch; 0: when the server takes it.


@dataclass(frozen=True, slots=True, kw_only=True)
class Rules:
    """What an agent takes."""

    agent: str  #: Its name.
    frame_id: str  #: The frame it is moved in.
    limits: Limits  #: What it can do.
    start_m: float  #: How far it may be from where the trajectory is.
    slack: float = 1e-3  #: By which share a trajectory may exceed the limits: what rounding does.


def judge(order: Order, rules: Rules, pose: Pose, now_ns: int) -> None:
    """Return if an agent at a pose takes an order now, by the clock of the order's start.

    Raises:
        RefusalError: It does not; with the first reason.
    """
    _check_addressee(order, rules)
    trajectory = order.trajectory
    for violation in limit_violations(trajectory, _widened(rules.limits, 1.0 + rules.slack)):
        raise RefusalError(Outcome.LIMITS_EXCEEDED, str(violation))
    time_s = (now_ns - order.start_ns) / NS_PER_S if order.start_ns else 0.0
    if time_s * NS_PER_S > trajectory.end_ns:
        given = f"given one that was over {time_s - trajectory.end_ns / NS_PER_S:.3f} s ago"
        raise RefusalError(Outcome.INVALID_TRAJECTORY, f"start: {given}, allowed: one that goes on")
    distance_m = pose.distance_m(pose_at(trajectory, time_s))
    if distance_m > rules.start_m:
        text = f"given a trajectory {distance_m:.3f} m away, allowed: {rules.start_m:g} m"
        raise RefusalError(Outcome.START_TOO_FAR, text)


def _check_addressee(order: Order, rules: Rules) -> None:
    if order.agent != rules.agent:
        raise RefusalError(
            Outcome.UNKNOWN_AGENT, f"agent: given {order.agent!r}, allowed: {rules.agent!r}"
        )
    if order.frame_id.removeprefix("/") != rules.frame_id:
        text = f"frame: given {order.frame_id!r}, allowed: {rules.frame_id!r}"
        raise RefusalError(Outcome.UNKNOWN_FRAME, text)


def _widened(limits: Limits, by: float) -> Limits:
    given = {quantity.value: limits.of(quantity) for quantity in Quantity}
    return Limits(**{name: None if limit is None else limit * by for name, limit in given.items()})


_POLYLINE_STEP_NS = 100_000_000
_TYPE = "sfglab_interfaces/action/FollowTrajectory"


@dataclass(frozen=True, slots=True, kw_only=True)
class Feedback:
    """What a server says on the way."""

    share: float  #: Of the trajectory's duration that is over, 0 to 1.
    pose: Pose | None = None  #: Where the agent is; None where the action does not say.
    error_m: float | None = None  #: From there to where it should be; None likewise.


@dataclass(frozen=True, slots=True, kw_only=True)
class Ended:
    """How an execution ended."""

    outcome: Outcome  #: How.
    text: str = ""  #: Why, for people; empty after success.
    pose: Pose | None = None  #: Where the agent was at the end; None where the action does not say.

    def __str__(self) -> str:
        said = self.text or OUTCOMES[self.outcome].meaning
        return f"{self.outcome.value}: {said}"


@dataclass(frozen=True, slots=True, kw_only=True)
class ActionDialect:
    """How orders are said in one type of action."""

    type: str  #: ROS type of the action.
    goal: Callable[[Order], Any]  #: From an order to a goal message.
    feedback: Callable[[Any], Feedback]  #: From a feedback message to what we read of it.
    result: Callable[[GoalResult], Ended]  #: From a goal's end to what we read of it.


def action_name(agent: str) -> str:
    """Return the action that sends an agent along trajectories (paper A, 4.1); FqnError for no agent's name."""
    return str(
        RosFqnBuilder()
        .scope(Scope.GLOBAL)
        .agent(agent)
        .resource(Resource.EXECUTE_TRAJECTORY)
        .build()
    )


def goal_message(order: Order) -> Any:
    """Return an order as a goal of ours; splines become polylines with a point every tenth of a second."""
    trajectory = order.trajectory
    if trajectory.interpolation is not Interpolation.POLYLINE:
        trajectory = resampled(trajectory, _POLYLINE_STEP_NS)
    message = multi_dof_from_trajectory(
        trajectory, order.agent, frame_id=order.frame_id, start_ns=order.start_ns
    )
    return action_type(_TYPE).goal(agent=order.agent, trajectory=message)


def order_from_goal(goal: Any) -> Order:
    """Return what a goal of ours asks; RefusalError where it holds no trajectory."""
    message, agent = goal.trajectory, str(goal.agent)
    joint = agent if agent in message.joint_names else ""
    try:
        trajectory = trajectory_from_multi_dof(message, joint)
        start_ns = ns_from_stamp(message.header.stamp)
    except SfglabError as error:
        raise RefusalError(Outcome.INVALID_TRAJECTORY, str(error)) from error
    return Order(
        agent=agent, trajectory=trajectory, frame_id=str(message.header.frame_id), start_ns=start_ns
    )


def result_message(outcome: Outcome, text: str, pose: Any) -> Any:
    """Return an end as a result of ours, with the agent's stamped pose."""
    return action_type(_TYPE).result(error_code=OUTCOMES[outcome].code, text=text, final_pose=pose)


def stamped_pose(pose: Pose, frame_id: str, stamp_ns: int) -> Any:
    """Return a `geometry_msgs/msg/PoseStamped`."""
    stamped = message_type("geometry_msgs/msg/PoseStamped")
    return stamped(header=header_msg(frame_id, stamp_ns), pose=pose.to_pose_msg())


def _feedback(message: Any) -> Feedback:
    return Feedback(
        share=float(message.progress),
        pose=Pose.from_msg(message.pose.pose, place="feedback"),
        error_m=float(message.distance_error),
    )


def _ended(result: GoalResult) -> Ended:
    message = result.result
    try:
        pose = Pose.from_msg(message.final_pose.pose, place="result")
    except PoseError:  # a server that failed left the message as it is
        pose = None
    outcome = outcome_of(GoalStatus(result.status), int(message.error_code))
    return Ended(outcome=outcome, text=str(message.text), pose=pose)


#: Ours.
FOLLOW_TRAJECTORY = ActionDialect(type=_TYPE, goal=goal_message, feedback=_feedback, result=_ended)
