"""Trajectories sent to agents over the bus: the same facts live and simulated."""

import asyncio
from contextlib import asynccontextmanager
from pathlib import Path

import pytest
from waiting import until

from sfglab import bus
from sfglab.errors import InvalidValueError
from sfglab.messages import ns_from_stamp
from sfglab.spatial import Pose
from sfglab.spatial.execution.agent import Limits
from sfglab.spatial.execution.client import Execution, scene_orders
from sfglab.spatial.execution.orders import Order, Outcome
from sfglab.spatial.execution.server import AgentSetup, TrajectoryServer
from sfglab.spatial.frames.buffer import FrameBuffer
from sfglab.spatial.frames.listener import FramesListener
from sfglab.spatial.scene.editor import Editor
from sfglab.spatial.scene.files import load_scene
from sfglab.spatial.trajectory.path import Trajectory

HALL = Path(__file__).parents[2] / "data" / "scenes" / "hall.yaml"
S = 1_000_000_000
QUICK = AgentSetup(limits=Limits(speed_m_s=1.0, acceleration_m_s2=2.0))
LAST = Pose.at((0.3, 0.06, 0.0))

simulated = pytest.mark.parametrize("world", ["simulated-apart"], indirect=True)


def order(scale=1.0, agent="go2"):
    """Forward along x and left, in three waypoints; 0.3 m in 0.6 s times the scale."""
    places = ((0.0, 0.0), (0.18, 0.0), (0.3, 0.06))
    path = Trajectory.of(
        (round(0.3 * S * scale) * i, Pose.at((scale * x, scale * y, 0.0)))
        for i, (x, y) in enumerate(places)
    )
    return Order(agent=agent, trajectory=path)


async def send(node, order, **options):
    execution = Execution(node, order.agent, **options)
    await execution.begin(order)
    return execution


async def execute(node, order, **options):
    execution = await send(node, order, **options)
    ended = await execution.result()
    execution.close()
    return ended


@asynccontextmanager
async def served(node, setup=None):
    """A node that sends orders, and the server of an agent on another one."""
    async with (
        node("go2") as far,
        node("planner") as near,
        TrajectoryServer(far, "go2", setup=setup) as server,
    ):
        yield near, server


async def test_an_agent_goes_along_a_trajectory_and_says_how_it_gets_on(node):
    heard = []
    async with served(node) as (near, server):
        assert server.action_name == "/global/go2/execute_trajectory"
        ended = await execute(near, order(), on_feedback=heard.append)
        assert not server.busy
    assert (ended.outcome, ended.text) == (Outcome.SUCCEEDED, "")
    assert ended.pose.same_as(LAST, within_m=0.05)
    first, *_, last = shares = [feedback.share for feedback in heard]
    assert shares == sorted(shares)
    assert first < last == 1.0
    assert max(feedback.error_m for feedback in heard) < 0.2


async def test_a_canceled_agent_brakes_and_only_then_the_goal_ends(node):
    async with served(node, QUICK) as (near, server):
        heard = []
        execution = await send(near, order(20.0), on_feedback=heard.append)
        await until(lambda: heard and heard[-1].share > 0.03)
        assert server.state.speed_m_s > 0.2
        await execution.cancel()
        ended = await execution.result()
        execution.close()
        assert ended.outcome is Outcome.CANCELED
        assert server.state.speed_m_s == 0.0
        assert ended.pose.same_as(server.state.pose)
        assert 0.0 < ended.pose.position_m[0] < 3.0


@simulated
async def test_a_cancellation_while_the_answer_is_on_its_way_stops_what_was_taken(node):
    async with served(node, QUICK) as (near, server):
        execution = Execution(near, "go2")
        sending = asyncio.ensure_future(execution.begin(order(20.0)))
        await until(lambda: server.busy, every_s=1e-5)
        assert not sending.done()
        await execution.cancel()
        assert (await execution.result()).outcome is Outcome.CANCELED
        assert (server.state.speed_m_s, server.busy) == (0.0, False)


async def test_what_an_agent_does_not_take_ends_at_once_with_the_reason(node):
    async with served(node) as (near, server):
        ended = await execute(near, order(agent="spot"), action=server.action_name)
        assert str(ended) == "unknown agent: agent: given 'spot', allowed: 'go2'"
        first = await send(near, order())
        await until(lambda: server.busy)
        assert (await execute(near, order())).outcome is Outcome.BUSY
        assert (await first.result()).outcome is Outcome.SUCCEEDED
        first.close()


async def test_a_server_that_goes_away_is_an_error_and_none_at_all_another(node):
    async with node("planner") as near:
        far = node("go2")
        async with far:
            TrajectoryServer(far, "go2")
            execution = await send(near, order(100.0))
        with pytest.raises(bus.BusError, match="/global/go2/execute_trajectory"):
            await execution.result()
        execution.close()
        with pytest.raises(bus.BusTimeoutError, match="/global/spot/execute_trajectory"):
            await execute(near, order(agent="spot"), timeout_s=0.1)


async def test_poses_odometry_and_transforms_agree(node):
    async with node("go2") as far, node("viewer") as near:
        poses, odometries, buffer = [], [], FrameBuffer()
        pose = "geometry_msgs/msg/PoseStamped"
        near.create_subscription(pose, "/global/go2/pose", poses.append)
        near.create_subscription("nav_msgs/msg/Odometry", "/global/go2/odometry", odometries.append)
        async with FramesListener(near, buffer), TrajectoryServer(far, "go2"):
            await execute(near, order())
            await until(lambda: poses and odometries)
    last_ns = buffer.interval("map", "go2/base")[1]  # a pose may come before its transform
    told = {ns_from_stamp(odometry.header.stamp): odometry for odometry in odometries}
    common = 0
    for message in poses:
        stamp_ns = ns_from_stamp(message.header.stamp)
        if stamp_ns in told and stamp_ns <= last_ns:
            common += 1
            odometry = told[stamp_ns]
            assert (odometry.pose.pose, odometry.child_frame_id) == (message.pose, "go2/base")
            assert buffer.look_up("map", "go2/base", stamp_ns).same_as(Pose.from_msg(message.pose))
    assert common > 10
    assert max(odometry.twist.twist.linear.x for odometry in odometries) > 0.2


def test_a_scene_gives_orders_for_the_agents_that_are_named_and_refuses_others():
    editor = Editor(load_scene(HALL))
    editor.add("agent", "idle")
    [order] = scene_orders(editor.scene, agents=("drone",), start_ns=7)
    assert (order.agent, order.frame_id, order.start_ns) == ("drone", "map", 7)
    for name in ("spot", "idle"):
        with pytest.raises(InvalidValueError, match=rf"given '{name}', allowed: .*: go2, drone"):
            scene_orders(editor.scene, agents=(name,))
    assert len(scene_orders(editor.scene)) == 2
