"""Orders to agents: checked before an agent moves, with their outcomes, and as messages of an action.

The action is `sfglab_interfaces/action/FollowTrajectory`.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from typing import Any

from sfglab.bus import GoalResult, GoalStatus
from sfglab.errors import SfglabError
from sfglab.messages import action_type, message_type, ns_from_stamp
from sfglab.names import Resource, RosFqnBuilder, Scope
from sfglab.spatial.poses import Pose, PoseError, header_msg
from sfglab.spatial.trajectory.exchange import multi_dof_from_trajectory, trajectory_from_multi_dof
from sfglab.spatial.trajectory.motion import pose_at, resampled, sample
from sfglab.spatial.trajectory.path import Interpolation, Trajectory
from sfglab.units import NS_PER_S

FOLLOW_TRAJECTORY = "sfglab_interfaces/action/FollowTrajectory"
"""ROS type of the action."""
_POLYLINE_STEP_NS = 100_000_000


class Outcome(Enum):
    """Outcome of an order; `OUTCOMES` has the meanings."""

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
    """Status, code and meaning of an outcome."""

    status: GoalStatus  #: Last status of the goal.
    code: int  #: `error_code` of the action's result.
    refused: bool  #: Whether the agent never moved for this goal.
    meaning: str  #: Meaning, a clause.


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
    Outcome.BUSY: _refused(9, "the agent follows another trajectory"),
    Outcome.REJECTED: _refused(0, "the server rejected the goal without a reason"),
    Outcome.PATH_LEFT: _moved(
        GoalStatus.ABORTED, 4, "the agent was too far from the planned position"
    ),
    Outcome.GOAL_MISSED: _moved(
        GoalStatus.ABORTED, 5, "the agent was not at the last pose in time"
    ),
    Outcome.CANCELED: _moved(GoalStatus.CANCELED, 6, "the goal was canceled, and the agent braked"),
    Outcome.OVERTAKEN: _moved(GoalStatus.ABORTED, 6, "another goal took its place"),
    Outcome.FAILED: _moved(GoalStatus.ABORTED, 0, "the server ended or failed"),
}
"""All outcomes. A server that refuses a goal accepts and aborts it, because only a result has a reason."""

_BY_CODE = {
    (e.status, e.code): outcome
    for outcome, e in OUTCOMES.items()
    if outcome is not Outcome.REJECTED
}


def outcome_of(status: GoalStatus, code: int) -> Outcome:
    """Return the outcome of a goal's last status and its result's code; `FAILED` for unknown ones."""
    return _BY_CODE.get((status, code), Outcome.FAILED)


class RefusalError(SfglabError, ValueError):
    """An order that an agent does not accept."""

    def __init__(self, outcome: Outcome, text: str) -> None:
        self.outcome = outcome  #: Outcome of the order.
        self.text = text  #: Reason, in words.
        super().__init__(outcome, text)  # all arguments, so that the error survives pickling

    def __str__(self) -> str:
        return f"{self.outcome.value}: {self.text}"


@dataclass(frozen=True, slots=True, kw_only=True)
class Order:
    """A trajectory for an agent."""

    agent: str  #: Name of the agent.
    trajectory: Trajectory  #: The trajectory.
    frame_id: str = "map"  #: Frame of its poses.
    start_ns: int = 0  #: Its time 0 as Unix time, ns; 0: when the server accepts the goal.


@dataclass(frozen=True, slots=True, kw_only=True)
class Rules:
    """Conditions on which an agent accepts an order."""

    agent: str  #: Name of the agent.
    frame_id: str  #: Frame of the agent.
    speed_m_s: float | None  #: Highest speed of the agent, m/s; None: no limit.
    start_m: float  #: Largest distance of the agent from the trajectory, m.
    slack: float = 1e-3  #: Share by which a speed may exceed the limit, because of rounding.


def judge(order: Order, rules: Rules, pose: Pose, now_ns: int) -> None:
    """Return if an agent at a pose accepts an order at a time, on the clock of the order's start.

    Raises:
        RefusalError: It does not; with the first reason.
    """
    if order.agent != rules.agent:
        text = f"agent: given {order.agent!r}, allowed: {rules.agent!r}"
        raise RefusalError(Outcome.UNKNOWN_AGENT, text)
    if order.frame_id.removeprefix("/") != rules.frame_id:
        text = f"frame: given {order.frame_id!r}, allowed: {rules.frame_id!r}"
        raise RefusalError(Outcome.UNKNOWN_FRAME, text)
    trajectory = order.trajectory
    _check_speed(trajectory, rules)
    time_s = (now_ns - order.start_ns) / NS_PER_S if order.start_ns else 0.0
    over_s = time_s - trajectory.end_ns / NS_PER_S
    if over_s > 0.0:
        text = f"start: given a trajectory that ended {over_s:.3f} s ago, allowed: a later end"
        raise RefusalError(Outcome.INVALID_TRAJECTORY, text)
    distance_m = pose.distance_m(pose_at(trajectory, time_s))
    if distance_m > rules.start_m:
        text = f"given a trajectory {distance_m:.3f} m away, allowed: {rules.start_m:g} m"
        raise RefusalError(Outcome.START_TOO_FAR, text)


def _check_speed(trajectory: Trajectory, rules: Rules) -> None:
    """Check the speed at each waypoint: goals are polylines, whose speed is constant in a segment."""
    if rules.speed_m_s is None:
        return
    times_s = [waypoint.time_ns / NS_PER_S for waypoint in trajectory.waypoints]
    speeds = sample(trajectory, times_s).speeds_m_s
    fastest = int(speeds.argmax())
    if speeds[fastest] > rules.speed_m_s * (1.0 + rules.slack):
        given = f"given {speeds[fastest]:.4g} m/s at {times_s[fastest]:.3f} s"
        text = f"speed: {given}, allowed: {rules.speed_m_s:g} m/s"
        raise RefusalError(Outcome.LIMITS_EXCEEDED, text)


@dataclass(frozen=True, slots=True, kw_only=True)
class Feedback:
    """Feedback of a server."""

    share: float  #: Share of the trajectory's duration that is over, 0 to 1.
    pose: Pose  #: Pose of the agent.
    error_m: float  #: Distance from the planned position, m.


@dataclass(frozen=True, slots=True, kw_only=True)
class Ended:
    """End of an execution."""

    outcome: Outcome  #: Outcome.
    text: str = ""  #: Reason, in words; empty after success.
    pose: Pose | None = None  #: Pose of the agent at the end; None: the result has none.

    def __str__(self) -> str:
        return f"{self.outcome.value}: {self.text or OUTCOMES[self.outcome].meaning}"


def action_name(agent: str) -> str:
    """Return the default action of an agent (paper A, 4.1); FqnError if this is no agent's name."""
    builder = RosFqnBuilder().scope(Scope.GLOBAL).agent(agent)
    return str(builder.resource(Resource.EXECUTE_TRAJECTORY).build())


def goal_message(order: Order) -> Any:
    """Return an order as a goal; a spline becomes a polyline with a point every tenth of a second."""
    trajectory = order.trajectory
    if trajectory.interpolation is not Interpolation.POLYLINE:
        trajectory = resampled(trajectory, _POLYLINE_STEP_NS)
    message = multi_dof_from_trajectory(
        trajectory, order.agent, frame_id=order.frame_id, start_ns=order.start_ns
    )
    return action_type(FOLLOW_TRAJECTORY).goal(agent=order.agent, trajectory=message)


def order_from_goal(goal: Any) -> Order:
    """Return the order of a goal, or raise a RefusalError if it has no trajectory."""
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
    """Return an outcome as a result, with the agent's stamped pose."""
    return action_type(FOLLOW_TRAJECTORY).result(
        error_code=OUTCOMES[outcome].code, text=text, final_pose=pose
    )


def stamped_pose(pose: Pose, frame_id: str, stamp_ns: int) -> Any:
    """Return a `geometry_msgs/msg/PoseStamped`."""
    stamped = message_type("geometry_msgs/msg/PoseStamped")
    return stamped(header=header_msg(frame_id, stamp_ns), pose=pose.to_pose_msg())


def feedback_of(message: Any) -> Feedback:
    """Return the feedback in a message."""
    return Feedback(
        share=float(message.progress),
        pose=Pose.from_msg(message.pose.pose, place="feedback"),
        error_m=float(message.distance_error),
    )


def ended_of(result: GoalResult) -> Ended:
    """Return the end in a result."""
    message = result.result
    try:
        pose = Pose.from_msg(message.final_pose.pose, place="result")
    except PoseError:  # a server that failed left the message empty
        pose = None
    outcome = outcome_of(GoalStatus(result.status), int(message.error_code))
    return Ended(outcome=outcome, text=str(message.text), pose=pose)
