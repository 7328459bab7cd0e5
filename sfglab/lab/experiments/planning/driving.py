"""Trajectories carried out over the action: a scene's agents at once, and all that can become of a goal.

The same scenario runs over DDS and on the simulated bus; who makes nodes decides. Agents, planner and viewer
are nodes of their own in one process.
"""

from __future__ import annotations

import asyncio
import math
from contextlib import AsyncExitStack
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

from sfglab.bus import ActionServerGoneError
from sfglab.messages import ns_from_stamp
from sfglab.spatial import Pose
from sfglab.spatial.execution.agent import Dynamics
from sfglab.spatial.execution.client import Execution, execute, scene_orders, send
from sfglab.spatial.execution.orders import FOLLOW_TRAJECTORY, Ended, Feedback, Order, Outcome
from sfglab.spatial.execution.server import AgentSetup, TrajectoryServer
from sfglab.spatial.scene.objects import AgentObject
from sfglab.spatial.trajectory.limits import Limits
from sfglab.spatial.trajectory.motion import pose_at
from sfglab.spatial.trajectory.path import Trajectory
from sfglab.units import NS_PER_S

if TYPE_CHECKING:
    from collections.abc import Callable, Coroutine

    from sfglab.bus import Node
    from sfglab.spatial.scene.tree import Scene

    MakeNode = Callable[[str], Any]
    GoalRow = dict[str, Any]


GONE = "server gone"
_LEAD_S = 1.0
_LOGGED_EVERY = 5
"""Of 50 poses a second, which go into the log."""
_MOVING = 0.1


@dataclass(slots=True, kw_only=True)
class Driven:
    """What came of driving a scene."""

    start_ns: int = 0  #: The scene's time 0.
    goals: list[GoalRow] = field(default_factory=list)  #: One row an agent.
    tracks: list[dict[str, Any]] = field(default_factory=list)  #: Where everybody was.
    #: Topic, time and message of what was heard of the agents.
    poses: list[tuple[str, int, Any]] = field(default_factory=list)
    orders: tuple[Order, ...] = ()  #: What was sent.


async def drive_scene(node: MakeNode, scene: Scene) -> Driven:
    """Send all agents of a scene along their trajectories at once, and listen to their poses.

    Args:
        node: Makes a node of a name.
        scene: The plan.
    """
    driven = Driven()
    async with AsyncExitStack() as stack:
        servers = {}
        for agent in scene.all_of(AgentObject):
            home = await stack.enter_async_context(node(agent.name))
            setup = AgentSetup(
                pose=scene.world_pose(agent.id),
                frame_id=scene.frame_id,
                dynamics=Dynamics(limits=agent.limits),
            )
            server = TrajectoryServer(home, agent.name, setup=setup)
            servers[agent.name] = await stack.enter_async_context(server)
        viewer = await stack.enter_async_context(node("viewer"))
        planner = await stack.enter_async_context(node("planner"))
        sent = [_Sent(planner, servers[order.agent], order) for order in scene_orders(scene)]
        await asyncio.gather(*(one.execution.ready() for one in sent))
        driven.start_ns = planner.get_clock().now_ns() + round(_LEAD_S * NS_PER_S)
        driven.orders = scene_orders(scene, start_ns=driven.start_ns)
        for order in driven.orders:
            _listen(viewer, order, driven)
        goals = (
            one.row(order, case="the scene's trajectory", expected=Outcome.SUCCEEDED)
            for one, order in zip(sent, driven.orders, strict=True)
        )
        driven.goals = list(await asyncio.gather(*goals))
    return driven


def _listen(viewer: Node, order: Order, driven: Driven) -> None:
    heard = 0
    before: tuple[int, Pose] | None = None

    def note(topic: str, message: Any) -> None:
        nonlocal heard, before
        stamp_ns = ns_from_stamp(message.header.stamp)
        pose, last = Pose.from_msg(message.pose, place=topic), before
        before, heard = (stamp_ns, pose), heard + 1
        if last is None or stamp_ns <= last[0] or heard % _LOGGED_EVERY or stamp_ns < driven.start_ns:
            return
        speed = pose.distance_m(last[1]) / ((stamp_ns - last[0]) / NS_PER_S)
        driven.tracks.append(_track(order, stamp_ns, pose, speed))
        driven.poses.append((topic, stamp_ns, message))

    topic = f"/global/{order.agent}/pose"
    viewer.create_subscription("geometry_msgs/msg/PoseStamped", topic, lambda message: note(topic, message))


def _track(order: Order, stamp_ns: int, pose: Pose, speed_m_s: float) -> dict[str, Any]:
    t_s = (stamp_ns - order.start_ns) / NS_PER_S
    planned = pose_at(order.trajectory, t_s)
    x, y, z = pose.position_m
    planned_x, planned_y, planned_z = planned.position_m
    return {
        "agent": order.agent,
        "t_s": t_s,
        "x_m": x,
        "y_m": y,
        "z_m": z,
        "speed_m_s": speed_m_s,
        "planned_x_m": planned_x,
        "planned_y_m": planned_y,
        "planned_z_m": planned_z,
        "error_m": pose.distance_m(planned),
    }


class _Sent:
    """A goal and what is said about it.

    Args:
        planner: Who sends it.
        server: Where to.
        order: Whom it is for.
    """

    def __init__(self, planner: Node, server: TrajectoryServer, order: Order) -> None:
        self._heard: list[Feedback] = []
        self._server, self._clock = server, planner.get_clock()
        self.execution = Execution(
            planner, order.agent, action=server.action_name, on_feedback=self._heard.append
        )

    async def row(self, order: Order, *, case: str, expected: Outcome) -> GoalRow:
        """Send an order, wait for its end, and return the row about it."""
        begun_ns = self._clock.now_ns()
        try:
            await self.execution.begin(order)
            ended = await self.execution.result()
        finally:
            self.execution.close()
        seconds = (self._clock.now_ns() - begun_ns) / NS_PER_S
        return _row(case, order, expected, ended, self._heard, self._server, seconds)


def _row(  # noqa: PLR0913, PLR0917 - a row's worth
    case: str,
    order: Order,
    expected: Outcome,
    ended: Ended,
    heard: list[Feedback],
    server: TrajectoryServer,
    seconds: float,
) -> GoalRow:
    shares = [feedback.share for feedback in heard]
    last = order.trajectory.waypoints[-1].pose
    arrived = ended.outcome is Outcome.SUCCEEDED and ended.pose is not None
    return {
        "case": case,
        "agent": order.agent,
        "expected": expected.value,
        "outcome": ended.outcome.value,
        "said": ended.text,
        "feedbacks": len(shares),
        "steady": shares == sorted(shares),
        "share": shares[-1] if shares else 0.0,
        "left_m": last.distance_m(ended.pose) if arrived and ended.pose is not None else math.nan,
        "end_speed_m_s": server.state.speed_m_s,
        "seconds": seconds,
    }


async def try_goals(node: MakeNode) -> list[GoalRow]:
    """Return what became of goals that succeed, are canceled, refused, overtaken, or lose their server.

    Args:
        node: Makes a node of a name.
    """
    rows: list[GoalRow] = []
    limits = Limits(speed_m_s=1.0, acceleration_m_s2=2.0)
    async with node("planner") as planner:
        for preempt in (False, True):
            setup = AgentSetup(dynamics=Dynamics(limits=limits), preempt=preempt)
            async with node("spot") as home, TrajectoryServer(home, "spot", setup=setup) as server:
                stage = _Trials(planner, server, rows)
                for trial in stage.preempting() if preempt else stage.one_at_a_time():
                    await trial
        await _lose_server(node, planner, rows)
    return rows


def _way(length_m: float, duration_s: float, *, x_m: float = 0.0) -> Trajectory:
    ends = ((0.0, x_m), (duration_s, x_m + length_m))
    return Trajectory.of((round(t * NS_PER_S), Pose.at((x, 0.0, 0.0))) for t, x in ends)


class _Trials:
    """Goals that are tried on one server, one after another.

    Args:
        planner: Who sends.
        server: Where to.
        rows: What came of them.
    """

    def __init__(self, planner: Node, server: TrajectoryServer, rows: list[GoalRow]) -> None:
        self._planner, self._server, self._rows = planner, server, rows

    def one_at_a_time(self) -> tuple[Coroutine[Any, Any, None], ...]:
        """Return what to try where a second goal is refused."""
        near = Order(agent="spot", trajectory=_way(0.2, 0.5))
        return (
            self._try("a short way", near),
            self._try("another agent", replace(near, agent="go2"), Outcome.UNKNOWN_AGENT),
            self._try("another frame", replace(near, frame_id="odom"), Outcome.UNKNOWN_FRAME),
            self._try("far away", replace(near, trajectory=_way(0.1, 1.0, x_m=5.0)), Outcome.START_TOO_FAR),
            self._try("too fast", replace(near, trajectory=_way(2.0, 1.0)), Outcome.LIMITS_EXCEEDED),
            self._try("long over", replace(near, start_ns=1), Outcome.INVALID_TRAJECTORY),
            self._broken("no waypoint", near, lambda points: points[:0]),
            self._broken("time backwards", near, lambda points: points[::-1]),
            self._second("a second goal", Outcome.SUCCEEDED, Outcome.BUSY),
            self._cancel(),
        )

    def preempting(self) -> tuple[Coroutine[Any, Any, None], ...]:
        """Return what to try where a second goal takes the first one's place."""
        return (self._second("a second goal that may overtake", Outcome.OVERTAKEN, Outcome.SUCCEEDED),)

    def _from_here(self, length_m: float, duration_s: float) -> Order:
        x_m = self._server.state.pose.position_m[0]
        return Order(agent="spot", trajectory=_way(length_m, duration_s, x_m=x_m))

    async def _try(self, case: str, order: Order, expected: Outcome = Outcome.SUCCEEDED) -> None:
        sent = _Sent(self._planner, self._server, order)
        self._rows.append(await sent.row(order, case=case, expected=expected))

    async def _broken(self, case: str, order: Order, change: Callable[[list[Any]], list[Any]]) -> None:
        def goal(order: Order) -> Any:
            message = FOLLOW_TRAJECTORY.goal(order)
            message.trajectory.points = change(list(message.trajectory.points))
            return message

        dialect = replace(FOLLOW_TRAJECTORY, goal=goal)
        ended = await execute(self._planner, order, dialect=dialect, action=self._server.action_name)
        self._note(case, order, Outcome.INVALID_TRAJECTORY, ended, [])

    async def _second(self, case: str, first: Outcome, second: Outcome) -> None:
        heard: list[Feedback] = []
        order = self._from_here(0.4, 0.8)
        execution = await send(self._planner, order, on_feedback=heard.append)
        while not self._server.busy:
            await self._planner.get_clock().sleep_for(0.005)
        await self._try(f"{case}: the second", self._from_here(0.2, 0.4), second)
        self._note(f"{case}: the first", order, first, await execution.result(), heard)
        execution.close()

    async def _cancel(self) -> None:
        moving, heard = asyncio.Event(), list[Feedback]()

        def note(feedback: Feedback) -> None:
            heard.append(feedback)
            if feedback.share > _MOVING:
                moving.set()

        order = self._from_here(6.0, 8.0)
        execution = await send(self._planner, order, on_feedback=note)
        await moving.wait()
        await execution.cancel()
        self._note("canceled on the way", order, Outcome.CANCELED, await execution.result(), heard)
        execution.close()

    def _note(self, case: str, order: Order, expected: Outcome, ended: Ended, heard: list[Feedback]) -> None:
        self._rows.append(_row(case, order, expected, ended, heard, self._server, math.nan))


async def _lose_server(node: MakeNode, planner: Node, rows: list[GoalRow]) -> None:
    """Let a server go away in the middle of a goal; the client hears of it as an error."""
    order = Order(agent="ghost", trajectory=_way(5.0, 60.0))
    async with node("ghost") as home:
        server = TrajectoryServer(home, "ghost")
        execution = await send(planner, order)
    try:
        ended = await execution.result()
        outcome, said = ended.outcome.value, ended.text
    except ActionServerGoneError as error:
        outcome, said = GONE, str(error)
    execution.close()
    row = _row(GONE, order, Outcome.FAILED, Ended(outcome=Outcome.FAILED, text=said), [], server, math.nan)
    rows.append({**row, "expected": GONE, "outcome": outcome})
