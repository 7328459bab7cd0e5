"""A simulated agent on the bus, for rehearsals: an action that moves it, and topics with its pose."""

from __future__ import annotations

import asyncio
from contextlib import AbstractAsyncContextManager
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from sfglab.messages import action_type, default_message, message_type
from sfglab.names import TF, Resource, RosFqnBuilder, Scope
from sfglab.spatial.execution.agent import AgentState, Follower, Limits, braked
from sfglab.spatial.execution.orders import (
    FOLLOW_TRAJECTORY,
    Order,
    Outcome,
    RefusalError,
    action_name,
    duration_msg,
    order_from_goal,
    stamped_pose,
)
from sfglab.spatial.frames.listener import TF_QOS, TRANSFORMS
from sfglab.spatial.poses import Pose, StampedTransform
from sfglab.spatial.trajectory.motion import motion_of, pose_at, sample
from sfglab.spatial.trajectory.path import Trajectory
from sfglab.units import NS_PER_S

if TYPE_CHECKING:
    from sfglab.bus import Node, ServerGoalHandle
    from sfglab.spatial.scene.model import AgentObject
    from sfglab.spatial.scene.tree import Scene

_FEEDBACK_EVERY = 5  #: Steps from one feedback to the next.
_START_M = 0.5  #: Distance from the trajectory up to which a goal is accepted, m.
_PERIOD_S = 0.02  #: Time between two steps, and between two poses, s.
_ROUNDING = 1e-3  #: Share by which a trajectory may exceed the highest speed.


@dataclass(frozen=True, slots=True, kw_only=True)
class AgentSetup:
    """Settings of a simulated agent."""

    pose: Pose = field(default_factory=Pose)  #: Pose before the first motion.
    frame_id: str = "map"  #: Frame of the poses.
    limits: Limits = field(default_factory=Limits)  #: Limits of the motion.

    @classmethod
    def of_scene(cls, scene: Scene, agent: AgentObject) -> AgentSetup:
        """Return the settings of an agent of a scene, with its limits."""
        limits = Limits(
            speed_m_s=agent.speed_m_s,
            acceleration_m_s2=agent.acceleration_m_s2,
            yaw_rate_rad_s=agent.yaw_rate_rad_s,
        )
        pose = scene.world_pose(agent.id)
        return cls(pose=pose, frame_id=scene.frame_id, limits=limits)


def check_order(order: Order, agent: str, setup: AgentSetup, pose: Pose, now_ns: int) -> None:
    """Check that an agent at a pose can execute an order.

    Args:
        order: The order.
        agent: Name of the agent.
        setup: Settings of the agent.
        pose: Present pose of the agent.
        now_ns: Present time, Unix time, ns, as in `Order.start_ns`.

    Raises:
        RefusalError: The agent cannot execute the order; the error has the first cause.
    """
    if order.agent != agent:
        text = f"agent: given {order.agent!r}, allowed: {agent!r}"
        raise RefusalError(Outcome.UNKNOWN_AGENT, text)
    if order.frame_id.removeprefix("/") != setup.frame_id:
        text = f"frame: given {order.frame_id!r}, allowed: {setup.frame_id!r}"
        raise RefusalError(Outcome.UNKNOWN_FRAME, text)
    trajectory = order.trajectory
    limit_m_s = setup.limits.speed_m_s
    # Goals are polylines, whose speed is constant between two waypoints.
    times_s = [waypoint.time_ns / NS_PER_S for waypoint in trajectory.waypoints]
    speeds_m_s = sample(trajectory, times_s).speeds_m_s
    fastest = int(speeds_m_s.argmax())
    fastest_m_s = float(speeds_m_s[fastest])
    if limit_m_s is not None and fastest_m_s > limit_m_s * (1.0 + _ROUNDING):
        place = f"speed at {times_s[fastest]:.3f} s"
        text = f"{place}: given {fastest_m_s:.4g} m/s, allowed: {limit_m_s:g} m/s"
        raise RefusalError(Outcome.LIMITS_EXCEEDED, text)
    time_s = (now_ns - order.start_ns) / NS_PER_S if order.start_ns else 0.0
    over_s = time_s - trajectory.end_ns / NS_PER_S
    if over_s > 0.0:
        text = f"start: given a trajectory that ended {over_s:.3f} s ago, allowed: a later end"
        raise RefusalError(Outcome.INVALID_TRAJECTORY, text)
    distance_m = pose.distance_m(pose_at(trajectory, time_s))
    if distance_m > _START_M:
        text = f"start: given a trajectory {distance_m:.3f} m away, allowed: {_START_M:g} m"
        raise RefusalError(Outcome.START_TOO_FAR, text)


class TrajectoryServer(AbstractAsyncContextManager["TrajectoryServer"]):
    """Action server that moves one simulated agent along one received trajectory at a time.

    The server publishes ``/global/<agent>/pose`` and ``odometry``, and the frame ``<agent>/base`` on ``/tf``. A goal
    that is canceled ends when the agent stands. By default, the action is
    ``/global/<agent>/execute_trajectory``.

    ```python
    async with Node("go2", domain_id=7) as node, TrajectoryServer(node, "go2"):
        await asyncio.Event().wait()
    ```

    Raises:
        FqnError: The name is not allowed for an agent.
    """

    def __init__(
        self, node: Node, agent: str, *, name: str = "", setup: AgentSetup | None = None
    ) -> None:
        self._node, self._agent, self._setup = node, agent, setup or AgentSetup()
        self.state = AgentState(pose=self._setup.pose)  #: State of the agent.
        self._run: _Run | None = None
        # The call imports SciPy now instead of after the start of a goal.
        motion_of(Trajectory.standing(self._setup.pose))
        self._stepped_ns = node.get_clock().now_ns()
        own = RosFqnBuilder().scope(Scope.GLOBAL).agent(agent)
        pose = str(own.resource(Resource.POSE).build())
        odometry = str(own.resource(Resource.ODOMETRY).build())
        self._pose = node.create_publisher("geometry_msgs/msg/PoseStamped", pose, 10)
        self._odometry = node.create_publisher("nav_msgs/msg/Odometry", odometry, 10)
        self._transforms = node.create_publisher(TRANSFORMS, TF, TF_QOS)
        self._action = node.create_action_server(
            FOLLOW_TRAJECTORY, name or action_name(agent), self._execute
        )
        self.action_name = self._action.action_name  #: The fully resolved ROS action.
        self._timer = node.create_timer(_PERIOD_S, self._tick)

    @property
    def busy(self) -> bool:
        """Whether the agent follows a goal."""
        return self._run is not None

    def close(self) -> None:
        """End the server; a running goal is aborted. Further calls have no effect."""
        self._timer.cancel()
        self._action.close()
        for publisher in (self._pose, self._odometry, self._transforms):
            publisher.close()

    async def __aexit__(self, *_: object) -> None:
        self.close()

    async def _execute(self, handle: ServerGoalHandle) -> Any:
        try:
            order = self._accepted(handle.request)
        except RefusalError as refusal:
            return self._finish(handle, refusal.outcome, refusal.text)
        now_ns = self._node.get_clock().now_ns()
        follower = Follower(
            order.trajectory,
            state=self.state,
            now_ns=now_ns,
            start_ns=order.start_ns or now_ns,
            limits=self._setup.limits,
        )
        ended: asyncio.Future[Outcome] = asyncio.get_running_loop().create_future()
        self._run = _Run(handle=handle, follower=follower, ended=ended)
        try:
            outcome = await ended
        finally:
            self._run = None
        text = "" if outcome is Outcome.SUCCEEDED else outcome.meaning
        return self._finish(handle, outcome, text)

    def _accepted(self, goal: Any) -> Order:
        """Return the order of a goal, if the agent can follow it now.

        Raises:
            RefusalError: The agent cannot follow the goal.
        """
        order = order_from_goal(goal)
        now_ns = self._node.get_clock().now_ns()
        check_order(order, self._agent, self._setup, self.state.pose, now_ns)
        if self.busy:
            raise RefusalError(Outcome.BUSY, Outcome.BUSY.meaning)
        return order

    def _finish(self, handle: ServerGoalHandle, outcome: Outcome, text: str) -> Any:
        if outcome is Outcome.SUCCEEDED:
            handle.succeed()
        elif outcome is Outcome.CANCELED:
            handle.canceled()
        else:
            handle.abort()
        result = action_type(FOLLOW_TRAJECTORY).result
        return result(error_code=outcome.code, text=text, final_pose=self._pose_message())

    def _tick(self) -> None:
        """Move the agent to the current time, and publish its pose."""
        now_ns = self._node.get_clock().now_ns()
        dt_s, self._stepped_ns = (now_ns - self._stepped_ns) / NS_PER_S, now_ns
        if self._run is not None:
            self._advance(self._run, now_ns)
        elif dt_s > 0.0 and self.state.speed_m_s > 0.0:
            self.state = braked(self.state, dt_s, self._setup.limits)
        self._publish()

    def _advance(self, run: _Run, now_ns: int) -> None:
        follower = run.follower
        if run.handle.is_cancel_requested:
            follower.stop(Outcome.CANCELED)
        follower.step(now_ns)
        self.state = follower.state
        run.steps += 1
        is_due = follower.outcome is not None or run.steps % _FEEDBACK_EVERY == 1
        if is_due and run.handle.is_active:
            feedback = action_type(FOLLOW_TRAJECTORY).feedback(
                progress=follower.share,
                time_from_start=duration_msg(follower.time_ns),
                pose=self._pose_message(),
                distance_error=follower.error_m,
            )
            run.handle.publish_feedback(feedback)
        if follower.outcome is not None and not run.ended.done():
            run.ended.set_result(follower.outcome)

    def _pose_message(self) -> Any:
        return stamped_pose(self.state.pose, self._setup.frame_id, self._stepped_ns)

    def _publish(self) -> None:
        pose = self._pose_message()
        child = f"{self._agent}/base"
        transform = StampedTransform(
            parent=self._setup.frame_id,
            child=child,
            stamp_ns=self._stepped_ns,
            pose=self.state.pose,
        )
        self._pose.publish(pose)
        self._odometry.publish(_odometry(self.state, pose, child))
        self._transforms.publish(message_type(TRANSFORMS)(transforms=[transform.to_msg()]))


@dataclass(slots=True, kw_only=True)
class _Run:
    """A goal that the agent follows."""

    handle: ServerGoalHandle
    follower: Follower
    ended: asyncio.Future[Outcome]
    steps: int = 0


def _odometry(state: AgentState, stamped: Any, child: str) -> Any:
    """Return a `nav_msgs/msg/Odometry`; its twist is in the agent's own frame, as the message has it."""
    vector = message_type("geometry_msgs/msg/Vector3")
    turned = Pose(quat_xyzw=state.pose.quat_xyzw).inverse()
    twist = message_type("geometry_msgs/msg/Twist")(
        linear=vector(*turned.apply(state.velocity_m_s)),
        angular=vector(*turned.apply((0.0, 0.0, state.yaw_rate_rad_s))),
    )
    return message_type("nav_msgs/msg/Odometry")(
        header=stamped.header,
        child_frame_id=child,
        pose=default_message("geometry_msgs/msg/PoseWithCovariance", pose=stamped.pose),
        twist=default_message("geometry_msgs/msg/TwistWithCovariance", twist=twist),
    )
