"""A simulated agent on the bus, for rehearsals: an action that moves it, and topics with its pose."""

from __future__ import annotations

import asyncio
from contextlib import AbstractAsyncContextManager
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from sfglab.bus import CancelResponse, GoalResponse, GoalStatus, Node, ServerGoalHandle
from sfglab.messages import action_type, message_type
from sfglab.names import TF, Resource, RosFqnBuilder, Scope
from sfglab.spatial.execution.agent import (
    AgentState,
    Dynamics,
    Follower,
    Limits,
    Progress,
    Tolerances,
    braked,
)
from sfglab.spatial.execution.orders import (
    FOLLOW_TRAJECTORY,
    OUTCOMES,
    Order,
    Outcome,
    RefusalError,
    Rules,
    action_name,
    judge,
    order_from_goal,
    result_message,
    stamped_pose,
)
from sfglab.spatial.frames.listener import TF_QOS, TRANSFORMS
from sfglab.spatial.poses import Pose, StampedTransform, header_msg
from sfglab.spatial.trajectory.exchange import duration_msg
from sfglab.spatial.trajectory.motion import motion_of
from sfglab.spatial.trajectory.path import Trajectory
from sfglab.units import NS_PER_S

if TYPE_CHECKING:
    from sfglab.spatial.scene.model import AgentObject
    from sfglab.spatial.scene.tree import Scene

_FEEDBACK_EVERY = 5  #: Steps from one feedback to the next.


@dataclass(frozen=True, slots=True, kw_only=True)
class AgentSetup:
    """Settings of a simulated agent."""

    pose: Pose = field(default_factory=Pose)  #: Pose before it moves.
    frame_id: str = "map"  #: Frame of its poses.
    dynamics: Dynamics = field(default_factory=Dynamics)  #: Reaction to a plan.
    tolerances: Tolerances = field(default_factory=Tolerances)  #: Required accuracy.
    #: Whether a second goal replaces the first one; otherwise it is refused as `Outcome.BUSY`.
    preempt: bool = False
    #: Whether refused goals are accepted and aborted with the reason; otherwise they are rejected.
    explain: bool = True
    period_s: float = 0.02  #: Time between two steps, and between two poses, s.

    @classmethod
    def of_scene(cls, scene: Scene, agent: AgentObject, *, preempt: bool = False) -> AgentSetup:
        """Return the settings of an agent of a scene, with its limits."""
        limits = Limits(
            speed_m_s=agent.speed_m_s,
            acceleration_m_s2=agent.acceleration_m_s2,
            yaw_rate_rad_s=agent.yaw_rate_rad_s,
        )
        return cls(
            pose=scene.world_pose(agent.id),
            frame_id=scene.frame_id,
            dynamics=Dynamics(limits=limits),
            preempt=preempt,
        )


class TrajectoryServer(AbstractAsyncContextManager["TrajectoryServer"]):
    """Moves one simulated agent along the trajectories that it is sent, one at a time.

    It publishes ``/global/<agent>/pose`` and ``odometry``, and the frame ``<agent>/base`` on ``/tf``. A goal
    that is canceled or leaves its path ends when the agent stands. By default, the action is
    ``/global/<agent>/execute_trajectory``.

    ```python
    async with Node("go2", domain_id=7) as node, TrajectoryServer(node, "go2"):
        await asyncio.Event().wait()
    ```

    Raises:
        FqnError: It is not the name of an agent.
    """

    def __init__(
        self, node: Node, agent: str, *, name: str = "", setup: AgentSetup | None = None
    ) -> None:
        self._node, self._agent, self._setup = node, agent, setup or AgentSetup()
        self.state = AgentState(pose=self._setup.pose)  #: State of the agent.
        self._rules = Rules(
            agent=agent,
            frame_id=self._setup.frame_id,
            speed_m_s=self._setup.dynamics.limits.speed_m_s,
            start_m=self._setup.tolerances.start_m,
        )
        self._run: _Run | None = None
        # Imports SciPy now and not after the start of a goal.
        motion_of(Trajectory.standing(self._setup.pose))
        self._stepped_ns = node.get_clock().now_ns()
        self._publishers = tuple(
            node.create_publisher(kind, topic, qos) for kind, topic, qos in _topics(agent)
        )
        self._action = node.create_action_server(
            FOLLOW_TRAJECTORY,
            name or action_name(agent),
            self._execute,
            goal_callback=self._respond,
            cancel_callback=lambda _: CancelResponse.ACCEPT,
        )
        self.action_name = self._action.action_name  #: The fully resolved ROS action.
        self._timer = node.create_timer(self._setup.period_s, self._tick)

    @property
    def busy(self) -> bool:
        """Whether it follows a goal."""
        return self._run is not None

    def close(self) -> None:
        """End the server; a running goal is aborted. Further calls have no effect."""
        self._timer.cancel()
        self._action.close()
        for publisher in self._publishers:
            publisher.close()

    async def __aexit__(self, *_: object) -> None:
        self.close()

    def _respond(self, goal: Any) -> GoalResponse:
        if not self._setup.explain:
            try:
                self._judged(goal)
            except RefusalError:
                return GoalResponse.REJECT
        return GoalResponse.ACCEPT

    def _judged(self, goal: Any) -> Order:
        """Return the order of a goal that can be followed now, or raise a RefusalError."""
        order = order_from_goal(goal)
        judge(order, self._rules, self.state.pose, self._node.get_clock().now_ns())
        if self.busy and not self._setup.preempt:
            raise RefusalError(Outcome.BUSY, OUTCOMES[Outcome.BUSY].meaning)
        return order

    async def _execute(self, handle: ServerGoalHandle) -> Any:
        try:
            order = self._judged(handle.request)
        except RefusalError as refusal:
            return self._finish(handle, refusal.outcome, refusal.text)
        run = self._begin(handle, order)
        try:
            outcome = await run.done
        finally:
            if self._run is run:
                self._run = None
        text = "" if outcome is Outcome.SUCCEEDED else OUTCOMES[outcome].meaning
        return self._finish(handle, outcome, text)

    def _begin(self, handle: ServerGoalHandle, order: Order) -> _Run:
        if self._run is not None:
            self._run.end(Outcome.OVERTAKEN)
        now_ns = self._node.get_clock().now_ns()
        follower = Follower(
            order.trajectory,
            state=self.state,
            now_ns=now_ns,
            start_ns=order.start_ns or now_ns,
            dynamics=self._setup.dynamics,
            tolerances=self._setup.tolerances,
        )
        self._run = _Run(handle=handle, follower=follower)
        return self._run

    def _finish(self, handle: ServerGoalHandle, outcome: Outcome, text: str) -> Any:
        status = OUTCOMES[outcome].status
        if status is GoalStatus.SUCCEEDED:
            handle.succeed()
        elif status is GoalStatus.CANCELED:
            handle.canceled()
        else:
            handle.abort()
        return result_message(outcome, text, self._pose_message())

    def _tick(self) -> None:
        """Move the agent to the current time, and publish its pose."""
        now_ns = self._node.get_clock().now_ns()
        dt_s, self._stepped_ns = (now_ns - self._stepped_ns) / NS_PER_S, now_ns
        if self._run is not None:
            self._advance(self._run, now_ns)
        elif dt_s > 0.0 and self.state.speed_m_s > 0.0:
            self.state = braked(self.state, dt_s, self._setup.dynamics)
        self._publish()

    def _advance(self, run: _Run, now_ns: int) -> None:
        if run.handle.is_cancel_requested:
            run.follower.stop(Outcome.CANCELED)
        progress = run.follower.step(now_ns)
        self.state = progress.state
        run.steps += 1
        is_due = progress.outcome is not None or run.steps % _FEEDBACK_EVERY == 1
        if is_due and run.handle.is_active and not run.done.done():
            run.handle.publish_feedback(_feedback(progress, self._pose_message()))
        if progress.outcome is not None:
            run.end(progress.outcome)

    def _pose_message(self) -> Any:
        return stamped_pose(self.state.pose, self._setup.frame_id, self._stepped_ns)

    def _publish(self) -> None:
        state, frame_id, child = self.state, self._setup.frame_id, f"{self._agent}/base"
        transform = StampedTransform(
            parent=frame_id, child=child, stamp_ns=self._stepped_ns, pose=state.pose
        )
        pose, odometry, transforms = self._publishers
        pose.publish(self._pose_message())
        odometry.publish(_odometry(state, transform))
        transforms.publish(message_type(TRANSFORMS)(transforms=[transform.to_msg()]))


@dataclass(slots=True, kw_only=True)
class _Run:
    """A goal that is followed."""

    handle: ServerGoalHandle
    follower: Follower
    steps: int = 0
    done: asyncio.Future[Outcome] = field(
        default_factory=lambda: asyncio.get_running_loop().create_future()
    )

    def end(self, outcome: Outcome) -> None:
        if not self.done.done():
            self.done.set_result(outcome)


def _topics(agent: str) -> tuple[tuple[str, str, Any], ...]:
    own = RosFqnBuilder().scope(Scope.GLOBAL).agent(agent)
    return (
        ("geometry_msgs/msg/PoseStamped", str(own.resource(Resource.POSE).build()), 10),
        ("nav_msgs/msg/Odometry", str(own.resource(Resource.ODOMETRY).build()), 10),
        (TRANSFORMS, TF, TF_QOS),
    )


def _odometry(state: AgentState, transform: StampedTransform) -> Any:
    """Return a `nav_msgs/msg/Odometry`; its twist is in the agent's own frame, as the message has it."""
    vector = message_type("geometry_msgs/msg/Vector3")
    turned = Pose(quat_xyzw=state.pose.quat_xyzw).inverse()
    twist = message_type("geometry_msgs/msg/Twist")(
        linear=vector(*turned.apply(state.velocity_m_s)),
        angular=vector(*turned.apply((0.0, 0.0, state.yaw_rate_rad_s))),
    )
    no_covariance = np.zeros(36)
    return message_type("nav_msgs/msg/Odometry")(
        header=header_msg(transform.parent, transform.stamp_ns),
        child_frame_id=transform.child,
        pose=message_type("geometry_msgs/msg/PoseWithCovariance")(
            pose=state.pose.to_pose_msg(), covariance=no_covariance
        ),
        twist=message_type("geometry_msgs/msg/TwistWithCovariance")(
            twist=twist, covariance=no_covariance
        ),
    )


def _feedback(progress: Progress, pose: Any) -> Any:
    """Return the progress as feedback, with the agent's stamped pose."""
    return action_type(FOLLOW_TRAJECTORY).feedback(
        progress=progress.share,
        time_from_start=duration_msg(progress.time_ns),
        pose=pose,
        distance_error=progress.error_m,
    )
