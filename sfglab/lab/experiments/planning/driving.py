"""Trajectories carried out over the action: a scene's agents at once, and all that can become of a goal.

The same runs over DDS and on the simulated bus, all nodes in one process; who makes nodes decides.
"""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable
from contextlib import AsyncExitStack
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, Self

from sfglab.bus import ActionServerGoneError, Node
from sfglab.bus.actions.goals import action_topics
from sfglab.messages import ns_from_stamp
from sfglab.spatial import Pose
from sfglab.spatial.execution.agent import Dynamics
from sfglab.spatial.execution.client import Execution, scene_orders
from sfglab.spatial.execution.orders import FOLLOW_TRAJECTORY, Ended, Feedback, Order, Outcome
from sfglab.spatial.execution.server import AgentSetup, TrajectoryServer
from sfglab.spatial.scene.objects import AgentObject
from sfglab.spatial.trajectory.limits import Limits
from sfglab.spatial.trajectory.motion import pose_at
from sfglab.spatial.trajectory.path import Trajectory
from sfglab.units import NS_PER_S

if TYPE_CHECKING:
    from sfglab.spatial.scene.tree import Scene

MakeNode = Callable[[str], Any]
GoalRow = dict[str, Any]

GONE = "server gone"
_LEAD_S = 1.0
_LOGGED_EVERY = 5  #: Of 50 poses a second, which go into the log.
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
    """Send all agents of a scene along their trajectories at once, on made nodes, and listen to their poses."""
    driven = Driven()
    async with AsyncExitStack() as stack:
        servers = {}
        for agent in scene.all_of(AgentObject):
            home = await stack.enter_async_context(node(agent.name))
            pose, dynamics = scene.world_pose(agent.id), Dynamics(limits=agent.limits)
            setup = AgentSetup(pose=pose, frame_id=scene.frame_id, dynamics=dynamics)
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
        case = ("the scene's trajectory", Outcome.SUCCEEDED)
        goals = (one.timed(order, *case) for one, order in zip(sent, driven.orders, strict=True))
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
        if (
            last is None
            or stamp_ns <= last[0]
            or heard % _LOGGED_EVERY
            or stamp_ns < driven.start_ns
        ):
            return
        speed = pose.distance_m(last[1]) / ((stamp_ns - last[0]) / NS_PER_S)
        driven.tracks.append(_track(order, stamp_ns, pose, speed))
        driven.poses.append((topic, stamp_ns, message))

    topic = f"/global/{order.agent}/pose"
    viewer.create_subscription(
        "geometry_msgs/msg/PoseStamped", topic, lambda message: note(topic, message)
    )


def _track(order: Order, stamp_ns: int, pose: Pose, speed_m_s: float) -> dict[str, Any]:
    t_s = (stamp_ns - order.start_ns) / NS_PER_S
    planned = pose_at(order.trajectory, t_s)
    columns = [f"{what}{axis}_m" for what in ("", "planned_") for axis in "xyz"]
    return {
        "agent": order.agent,
        "t_s": t_s,
        "speed_m_s": speed_m_s,
        "error_m": pose.distance_m(planned),
        **dict(zip(columns, (*pose.position_m, *planned.position_m), strict=True)),
    }


class _Sent:
    """A goal, what is said about it, and the row that comes of it."""

    def __init__(
        self, planner: Node, server: TrajectoryServer, order: Order, **options: Any
    ) -> None:
        self.moving = asyncio.Event()  # set once part of the way is over
        self._heard: list[Feedback] = []
        self._order, self._server, self._clock = order, server, planner.get_clock()
        options |= {"action": server.action_name, "on_feedback": self._hear}
        self.execution = Execution(planner, order.agent, **options)

    def _hear(self, feedback: Feedback) -> None:
        self._heard.append(feedback)
        if feedback.share > _MOVING:
            self.moving.set()

    async def begin(self) -> Self:
        """Send it, and return when the server has answered."""
        await self.execution.begin(self._order)
        return self

    async def timed(self, order: Order, case: str, expected: Outcome) -> GoalRow:
        """Send an order in place of the first, wait for its end, and return the row with the time it took."""
        self._order, begun_ns = order, self._clock.now_ns()
        row = await (await self.begin()).ended(case, expected)
        return {**row, "seconds": (self._clock.now_ns() - begun_ns) / NS_PER_S}

    async def ended(self, case: str, expected: Outcome) -> GoalRow:
        """Return the row about it when it has ended."""
        ended = await self.execution.result()
        self.execution.close()
        return self.row(case, expected, ended)

    def row(self, case: str, expected: Outcome, ended: Ended) -> GoalRow:
        """Return the row about it."""
        shares = [feedback.share for feedback in self._heard]
        last = self._order.trajectory.waypoints[-1].pose
        arrived = ended.outcome is Outcome.SUCCEEDED and ended.pose is not None
        return {
            "case": case,
            "agent": self._order.agent,
            "expected": expected.value,
            "outcome": ended.outcome.value,
            "said": ended.text,
            "feedbacks": len(shares),
            "steady": shares == sorted(shares),
            "share": shares[-1] if shares else 0.0,
            "left_m": last.distance_m(ended.pose)
            if arrived and ended.pose is not None
            else math.nan,
            "end_speed_m_s": self._server.state.speed_m_s,
            "seconds": math.nan,
        }


async def try_goals(node: MakeNode) -> list[GoalRow]:
    """Return what became of goals that succeed, are canceled, refused, overtaken, or lose their server."""
    rows: list[GoalRow] = []
    limits = Limits(speed_m_s=1.0, acceleration_m_s2=2.0)
    async with node("planner") as planner:
        for preempt in (False, True):
            setup = AgentSetup(dynamics=Dynamics(limits=limits), preempt=preempt)
            async with node("spot") as home, TrajectoryServer(home, "spot", setup=setup) as server:
                trials = _Trials(planner, server, rows)
                if preempt:
                    await trials.second(
                        "a second goal that may overtake", Outcome.OVERTAKEN, Outcome.SUCCEEDED
                    )
                else:
                    await trials.one_at_a_time()
            # The next server has the same name. A client takes the former one for it until that is known to be gone.
            status = action_topics(server.action_name).status
            while planner.graph.publishers(status):
                await planner.get_clock().sleep_for(0.005)
        await _lose_server(node, planner, rows)
    return rows


def _way(length_m: float, duration_s: float, *, x_m: float = 0.0) -> Trajectory:
    ends = ((0.0, x_m), (duration_s, x_m + length_m))
    return Trajectory.of((round(t * NS_PER_S), Pose.at((x, 0.0, 0.0))) for t, x in ends)


class _Trials:
    """Goals that are tried on one server, one after another, and the rows about them."""

    def __init__(self, planner: Node, server: TrajectoryServer, rows: list[GoalRow]) -> None:
        self._planner, self._server, self._rows = planner, server, rows

    async def one_at_a_time(self) -> None:
        """Try what is to be tried where a second goal is refused."""
        near = Order(agent="spot", trajectory=_way(0.2, 0.5))
        for case, order, expected in (
            ("a short way", near, Outcome.SUCCEEDED),
            ("another agent", replace(near, agent="go2"), Outcome.UNKNOWN_AGENT),
            ("another frame", replace(near, frame_id="odom"), Outcome.UNKNOWN_FRAME),
            ("far away", replace(near, trajectory=_way(0.1, 1.0, x_m=5.0)), Outcome.START_TOO_FAR),
            ("too fast", replace(near, trajectory=_way(2.0, 1.0)), Outcome.LIMITS_EXCEEDED),
            ("long over", replace(near, start_ns=1), Outcome.INVALID_TRAJECTORY),
        ):
            await self._try(case, order, expected)
        await self._broken("no waypoint", near, lambda points: points[:0])
        await self._broken("time backwards", near, lambda points: points[::-1])
        await self.second("a second goal", Outcome.SUCCEEDED, Outcome.BUSY)
        sent = await self._sent(self._from_here(6.0, 8.0)).begin()
        await sent.moving.wait()
        await sent.execution.cancel()
        self._rows.append(await sent.ended("canceled on the way", Outcome.CANCELED))

    def _from_here(self, length_m: float, duration_s: float) -> Order:
        x_m = self._server.state.pose.position_m[0]
        return Order(agent="spot", trajectory=_way(length_m, duration_s, x_m=x_m))

    def _sent(self, order: Order, **options: Any) -> _Sent:
        return _Sent(self._planner, self._server, order, **options)

    async def _try(self, case: str, order: Order, expected: Outcome) -> None:
        self._rows.append(await self._sent(order).timed(order, case, expected))

    async def _broken(
        self, case: str, order: Order, change: Callable[[list[Any]], list[Any]]
    ) -> None:
        def goal(order: Order) -> Any:
            message = FOLLOW_TRAJECTORY.goal(order)
            message.trajectory.points = change(list(message.trajectory.points))
            return message

        sent = await self._sent(order, dialect=replace(FOLLOW_TRAJECTORY, goal=goal)).begin()
        self._rows.append(await sent.ended(case, Outcome.INVALID_TRAJECTORY))

    async def second(self, case: str, first: Outcome, second: Outcome) -> None:
        """Send a goal while another is on its way; given is how both have to end."""
        sent = await self._sent(self._from_here(0.4, 0.8)).begin()
        while not self._server.busy:
            await self._planner.get_clock().sleep_for(0.005)
        await self._try(f"{case}: the second", self._from_here(0.2, 0.4), second)
        self._rows.append(await sent.ended(f"{case}: the first", first))


async def _lose_server(node: MakeNode, planner: Node, rows: list[GoalRow]) -> None:
    """Let a server go away in the middle of a goal; the client hears of it as an error."""
    async with node("ghost") as home:
        order = Order(agent="ghost", trajectory=_way(5.0, 60.0))
        sent = await _Sent(planner, TrajectoryServer(home, "ghost"), order).begin()
    try:
        ended = await sent.execution.result()
        outcome, said = ended.outcome.value, ended.text
    except ActionServerGoneError as error:
        outcome, said = GONE, str(error)
    sent.execution.close()
    row = sent.row(GONE, Outcome.FAILED, Ended(outcome=Outcome.FAILED, text=said))
    rows.append({**row, "expected": GONE, "outcome": outcome})
