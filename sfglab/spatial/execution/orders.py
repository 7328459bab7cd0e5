"""Orders to agents: checked before an agent moves, with their outcomes, and as messages of an action.

The action is `sfglab_interfaces/action/FollowTrajectory`.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from typing import Any, Self

from sfglab.bus import GoalResult, GoalStatus
from sfglab.errors import InvalidValueError, SfglabError
from sfglab.messages import action_type, message_type, ns_from_stamp
from sfglab.names import Resource, RosFqnBuilder, Scope
from sfglab.spatial.poses import Pose, PoseError, header_msg
from sfglab.spatial.trajectory.motion import resampled, sample
from sfglab.spatial.trajectory.path import Interpolation, Trajectory
from sfglab.units import NS_PER_S

FOLLOW_TRAJECTORY = "sfglab_interfaces/action/FollowTrajectory"
"""ROS type of the action that moves an agent along a trajectory."""
_POLYLINE_STEP_NS = 100_000_000
_SUCCEEDED = GoalStatus.SUCCEEDED
_ABORTED = GoalStatus.ABORTED
_CANCELED = GoalStatus.CANCELED


class Outcome(Enum):
    """Outcome of an order.

    A server that refuses a goal accepts and then aborts it, because only a result contains a reason. An outcome
    `REJECTED` has no result. The simulated agents of sfglab never report `PATH_LEFT`.
    """

    status: GoalStatus  #: Last status of the goal.
    code: int  #: `error_code` of the action's result.
    meaning: str  #: Meaning, a clause.

    def __new__(cls, word: str, status: GoalStatus, code: int, meaning: str) -> Self:
        """Use the word alone as the value of a member."""
        made = object.__new__(cls)
        made._value_ = word
        made.status, made.code, made.meaning = status, code, meaning
        return made

    SUCCEEDED = "succeeded", _SUCCEEDED, 0, "the agent went along the whole trajectory"
    INVALID_TRAJECTORY = (
        "invalid trajectory",
        _ABORTED,
        1,
        "empty, times that do not increase, or a pose that is none",
    )
    UNKNOWN_AGENT = "unknown agent", _ABORTED, 2, "this server moves no such agent"
    UNKNOWN_FRAME = "unknown frame", _ABORTED, 3, "the poses are in another frame than the agent's"
    START_TOO_FAR = (
        "start too far",
        _ABORTED,
        7,
        "the agent is too far from where the trajectory is now",
    )
    LIMITS_EXCEEDED = (
        "limits exceeded",
        _ABORTED,
        8,
        "the trajectory is faster than the agent can go",
    )
    BUSY = "busy", _ABORTED, 9, "the agent follows another trajectory"
    REJECTED = "rejected", _ABORTED, 0, "the server rejected the goal without a reason"
    PATH_LEFT = "path left", _ABORTED, 4, "the agent was too far from the planned position"
    GOAL_MISSED = "goal missed", _ABORTED, 5, "the agent was not at the last pose in time"
    CANCELED = "canceled", _CANCELED, 6, "the goal was canceled, and the agent braked"
    FAILED = "failed", _ABORTED, 0, "the server ended or failed"


# `FAILED` comes after `REJECTED`, which no server reports.
_BY_CODE = {(outcome.status, outcome.code): outcome for outcome in Outcome}


def outcome_of(status: GoalStatus, code: int) -> Outcome:
    """Return the outcome of a goal's last status and its result's code; `FAILED` for unknown ones."""
    return _BY_CODE.get((status, code), Outcome.FAILED)


class RefusalError(SfglabError, ValueError):
    """An order that an agent does not accept."""

    def __init__(self, outcome: Outcome, text: str) -> None:
        self.outcome = outcome  #: Outcome of the order.
        self.text = text  #: Cause of the refusal, as a sentence.
        super().__init__(f"{outcome.value}: {text}")


@dataclass(frozen=True, slots=True, kw_only=True)
class Order:
    """A trajectory that an agent is to execute, with its frame and start time."""

    agent: str  #: Name of the agent.
    trajectory: Trajectory  #: The trajectory.
    frame_id: str = "map"  #: Frame of the trajectory's poses.
    #: Unix time of the trajectory's time 0, ns; 0: when the server accepts the goal.
    start_ns: int = 0


@dataclass(frozen=True, slots=True, kw_only=True)
class Feedback:
    """Feedback of a server on the execution of a trajectory."""

    share: float  #: Share of the trajectory's duration that is over, 0 to 1.
    pose: Pose  #: Pose of the agent.
    error_m: float  #: Distance from the planned position, m.


@dataclass(frozen=True, slots=True, kw_only=True)
class Ended:
    """Result of the execution of a trajectory."""

    outcome: Outcome  #: Outcome of the execution.
    text: str = ""  #: Cause, as a sentence; empty after success.
    pose: Pose | None = None  #: Pose of the agent at the end; None: the result has none.

    def __str__(self) -> str:
        return f"{self.outcome.value}: {self.text or self.outcome.meaning}"


def action_name(agent: str) -> str:
    """Return the name of an agent's default action, ``/global/<agent>/execute_trajectory`` (paper A, section 4.1).

    Raises:
        FqnError: The name is not allowed for an agent.
    """
    builder = RosFqnBuilder().scope(Scope.GLOBAL).agent(agent)
    return str(builder.resource(Resource.EXECUTE_TRAJECTORY).build())


def goal_message(order: Order) -> Any:
    """Return an order as a goal; a spline becomes a polyline with a point every tenth of a second.

    Velocities are those of the segment that leaves a waypoint; at the last, of the segment that arrives.

    Raises:
        MessageError: A time does not fit into a stamp.
    """
    trajectory = order.trajectory
    if trajectory.interpolation is not Interpolation.POLYLINE:
        trajectory = resampled(trajectory, _POLYLINE_STEP_NS)
    times_s = [waypoint.time_ns / NS_PER_S for waypoint in trajectory.waypoints]
    found = sample(trajectory, times_s)
    vector = message_type("geometry_msgs/msg/Vector3")
    points = []
    for index, waypoint in enumerate(trajectory.waypoints):
        velocity = message_type("geometry_msgs/msg/Twist")(
            linear=vector(*found.velocities_m_s[index].tolist()),
            angular=vector(*found.angular_rad_s[index].tolist()),
        )
        point = message_type("trajectory_msgs/msg/MultiDOFJointTrajectoryPoint")(
            transforms=[waypoint.pose.to_transform_msg()],
            velocities=[velocity],
            accelerations=[],
            time_from_start=duration_msg(waypoint.time_ns),
        )
        points.append(point)
    message = message_type("trajectory_msgs/msg/MultiDOFJointTrajectory")(
        header=header_msg(order.frame_id, order.start_ns), joint_names=[order.agent], points=points
    )
    return action_type(FOLLOW_TRAJECTORY).goal(agent=order.agent, trajectory=message)


def order_from_goal(goal: Any) -> Order:
    """Return the order in a goal of the action.

    The trajectory is that of the joint with the agent's name or, if there is none, that of the first joint.

    Raises:
        RefusalError: The goal has no valid trajectory.
    """
    message, agent = goal.trajectory, str(goal.agent)
    names = list(message.joint_names)
    column = names.index(agent) if agent in names else 0
    timed = []
    try:
        if not names:
            raise InvalidValueError("joint_names", names, repr(agent))
        for index, point in enumerate(message.points):
            if len(point.transforms) != len(names):
                place = f"point {index}, number of transforms"
                raise InvalidValueError(place, len(point.transforms), f"{len(names)} as of joints")
            pose = Pose.from_msg(point.transforms[column], place=f"point {index}")
            timed.append((ns_from_stamp(point.time_from_start), pose))
        trajectory = Trajectory.of(timed)
        start_ns = ns_from_stamp(message.header.stamp)
    except SfglabError as error:
        raise RefusalError(Outcome.INVALID_TRAJECTORY, str(error)) from error
    return Order(
        agent=agent, trajectory=trajectory, frame_id=str(message.header.frame_id), start_ns=start_ns
    )


def duration_msg(time_ns: int) -> Any:
    """Return a duration in nanoseconds as a `builtin_interfaces/msg/Duration`."""
    sec, nanosec = divmod(time_ns, NS_PER_S)
    return message_type("builtin_interfaces/msg/Duration")(sec=sec, nanosec=nanosec)


def stamped_pose(pose: Pose, frame_id: str, stamp_ns: int) -> Any:
    """Return a pose in a frame at a time (ns since the epoch) as a `geometry_msgs/msg/PoseStamped`."""
    stamped = message_type("geometry_msgs/msg/PoseStamped")
    return stamped(header=header_msg(frame_id, stamp_ns), pose=pose.to_pose_msg())


def feedback_of(message: Any) -> Feedback:
    """Return the values of a feedback message of the action."""
    return Feedback(
        share=float(message.progress),
        pose=Pose.from_msg(message.pose.pose, place="feedback"),
        error_m=float(message.distance_error),
    )


def ended_of(result: GoalResult) -> Ended:
    """Return the end of an execution from the result of its goal."""
    message = result.result
    try:
        pose = Pose.from_msg(message.final_pose.pose, place="result")
    except PoseError:  # a server that failed left the message empty
        pose = None
    outcome = outcome_of(GoalStatus(result.status), int(message.error_code))
    return Ended(outcome=outcome, text=str(message.text), pose=pose)
