"""Orders, progress and results as messages of an action, in both directions.

Ours is `sfglab_interfaces/action/FollowTrajectory`. Another action, such as nav2_msgs' FollowPath, has fields
of its own and needs an `ActionDialect` of its own: its type, and three functions. Refuses to know the bus.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from sfglab.bus import GoalResult, GoalStatus
from sfglab.errors import SfglabError
from sfglab.messages import action_type, message_type, ns_from_stamp, stamp_from_ns
from sfglab.names import Resource, RosFqnBuilder, Scope
from sfglab.spatial.execution.judging import Order, RefusalError
from sfglab.spatial.execution.outcomes import OUTCOMES, Outcome, outcome_of
from sfglab.spatial.poses import Pose, PoseError
from sfglab.spatial.trajectory import (
    Interpolation,
    multi_dof_from_trajectory,
    resampled,
    trajectory_from_multi_dof,
)

if TYPE_CHECKING:
    from collections.abc import Callable

    from sfglab.spatial.execution.follower import Progress


_NS_PER_S = 1_000_000_000
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
    """Return the action that an agent is sent along trajectories by, after paper A, section 4.1.

    Raises:
        FqnError: It is not the name of an agent.
    """
    return str(RosFqnBuilder().scope(Scope.GLOBAL).agent(agent).resource(Resource.EXECUTE_TRAJECTORY).build())


def goal_message(order: Order) -> Any:
    """Return an order as a goal of ours.

    The message has no word for splines: they go as polylines with a point every tenth of a second beside their
    own, which keep to every limit that the spline keeps to.
    """
    trajectory = order.trajectory
    if trajectory.interpolation is not Interpolation.POLYLINE:
        trajectory = resampled(trajectory, _POLYLINE_STEP_NS)
    message = multi_dof_from_trajectory(
        trajectory, order.agent, frame_id=order.frame_id, start_ns=order.start_ns
    )
    return action_type(_TYPE).goal(agent=order.agent, trajectory=message)


def order_from_goal(goal: Any) -> Order:
    """Return what a goal of ours asks.

    Raises:
        RefusalError: It holds no trajectory.
    """
    message, agent = goal.trajectory, str(goal.agent)
    joint = agent if agent in message.joint_names else ""
    try:
        trajectory = trajectory_from_multi_dof(message, joint)
        start_ns = ns_from_stamp(message.header.stamp)
    except SfglabError as error:
        raise RefusalError(Outcome.INVALID_TRAJECTORY, str(error)) from error
    return Order(agent=agent, trajectory=trajectory, frame_id=str(message.header.frame_id), start_ns=start_ns)


def feedback_message(progress: Progress, pose: Any) -> Any:
    """Return how it stands as feedback of ours, with the agent's stamped pose."""
    sec, nanosec = divmod(progress.time_ns, _NS_PER_S)
    return action_type(_TYPE).feedback(
        progress=progress.share,
        time_from_start=message_type("builtin_interfaces/msg/Duration")(sec=sec, nanosec=nanosec),
        pose=pose,
        distance_error=progress.error_m,
    )


def result_message(outcome: Outcome, text: str, pose: Any) -> Any:
    """Return an end as a result of ours, with the agent's stamped pose."""
    return action_type(_TYPE).result(error_code=OUTCOMES[outcome].code, text=text, final_pose=pose)


def stamped_pose(pose: Pose, frame_id: str, stamp_ns: int) -> Any:
    """Return a `geometry_msgs/msg/PoseStamped`."""
    header = message_type("std_msgs/msg/Header")(stamp=stamp_from_ns(stamp_ns), frame_id=frame_id)
    return message_type("geometry_msgs/msg/PoseStamped")(header=header, pose=pose.to_pose_msg())


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


FOLLOW_TRAJECTORY = ActionDialect(type=_TYPE, goal=goal_message, feedback=_feedback, result=_ended)
"""Our own action."""
