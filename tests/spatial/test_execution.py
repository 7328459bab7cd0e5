"""Trajectories sent to agents over the bus: the same facts live and simulated."""

import asyncio
from contextlib import asynccontextmanager
from pathlib import Path

import pytest
from waiting import until

from sfglab import bus
from sfglab.cli import plan
from sfglab.errors import InvalidValueError
from sfglab.messages import ns_from_stamp
from sfglab.spatial import Pose
from sfglab.spatial.execution.agent import Limits, Tolerances
from sfglab.spatial.execution.client import Execution, execute, scene_orders
from sfglab.spatial.execution.orders import (
    Order,
    Outcome,
    action_name,
)
from sfglab.spatial.execution.server import AgentSetup, TrajectoryServer
from sfglab.spatial.frames.buffer import FrameBuffer
from sfglab.spatial.frames.listener import FramesListener
from sfglab.spatial.scene.editor import Editor
from sfglab.spatial.scene.files import load_scene
from sfglab.spatial.trajectory.path import Interpolation, Trajectory

HALL = Path(__file__).parents[2] / "data" / "scenes" / "hall.yaml"
S = 1_000_000_000
QUICK = AgentSetup(limits=Limits(speed_m_s=1.0, acceleration_m_s2=2.0))

simulated = pytest.mark.parametrize("world", ["simulated-apart"], indirect=True)


def path(length_m=0.3, duration_s=0.6, interpolation=Interpolation.POLYLINE):
    """Forward along x and left, in three waypoints."""
    ends = ((0.0, 0.0), (0.6 * length_m, 0.0), (length_m, 0.2 * length_m))
    return Trajectory.of(
        ((round(duration_s * S * i / 2), Pose.at((x, y, 0.0))) for i, (x, y) in enumerate(ends)),
        interpolation,
    )


def order(*length_and_duration, agent="go2"):
    return Order(agent=agent, trajectory=path(*length_and_duration))


async def send(node, order, **options):
    execution = Execution(node, order.agent, **options)
    await execution.begin(order)
    return execution


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
        assert server.action_name == "/global/go2/execute_trajectory" == action_name("go2")
        ended = await execute(near, order(), on_feedback=heard.append)
        assert not server.busy
    assert ended.outcome is Outcome.SUCCEEDED
    assert not ended.text
    assert ended.pose.same_as(path().waypoints[-1].pose, within_m=0.05)
    shares = [feedback.share for feedback in heard]
    assert len(shares) > 1
    assert shares == sorted(shares)
    assert shares[-1] == 1.0
    assert all(feedback.error_m < 0.2 for feedback in heard)


async def test_a_canceled_agent_brakes_and_only_then_the_goal_ends(node):
    async with served(node, QUICK) as (near, server):
        moving = asyncio.Event()
        execution = await send(
            near, order(8.0, 10.0), on_feedback=lambda f: f.share > 0.03 and moving.set()
        )
        await asyncio.wait_for(moving.wait(), 60)
        assert server.state.speed_m_s > 0.3
        await execution.cancel()
        ended = await execution.result()
        execution.close()
        assert ended.outcome is Outcome.CANCELED
        assert server.state.speed_m_s == 0.0
        assert ended.pose.same_as(server.state.pose)
        assert 0.05 < ended.pose.position_m[0] < 4.0


@pytest.mark.parametrize(("after_s", "speed_m_s"), [(0.0, 0.0), (0.05, 0.0), (3.0, 0.3)])
@simulated
async def test_a_task_that_is_cancelled_while_it_sends_or_drives_leaves_nobody_moving(
    after_s, speed_m_s, node
):
    async with served(node, QUICK) as (near, server):
        task = asyncio.create_task(execute(near, order(8.0, 10.0)))
        await asyncio.sleep(after_s)
        assert server.state.speed_m_s >= speed_m_s
        task.cancel()
        with pytest.raises(asyncio.CancelledError):
            await task
        assert (server.state.speed_m_s, server.busy) == (0.0, False)
        at = server.state.pose
        await asyncio.sleep(1.0)
        assert server.state.pose == at


@simulated
async def test_ctrl_c_while_an_answer_is_on_its_way_cancels_what_was_taken(
    node, monkeypatch, capsys
):
    stops = []
    monkeypatch.setattr(plan, "on_stop", stops.append)
    async with served(node, QUICK) as (near, server):
        orders = [order(8.0, 10.0)]
        sending = asyncio.ensure_future(plan._send_all(near, orders, 0.0))
        async with asyncio.timeout(60):
            while not server.busy:
                await asyncio.sleep(1e-5)
        stops[0]()
        assert await sending == 130
        assert (server.state.speed_m_s, server.busy) == (0.0, False)
    assert capsys.readouterr().out.startswith("go2: canceled")


async def test_what_an_agent_does_not_take_ends_at_once_with_the_reason(node):
    setup = AgentSetup(limits=Limits(speed_m_s=0.9))
    async with served(node, setup) as (near, server):
        ended = await execute(near, order(agent="spot"), action=server.action_name)
        assert (ended.outcome, ended.text) == (
            Outcome.UNKNOWN_AGENT,
            "agent: given 'spot', allowed: 'go2'",
        )
        assert server.state.pose == Pose()


async def test_a_second_goal_is_refused(node):
    setup = AgentSetup(tolerances=Tolerances(start_m=2.0))
    async with served(node, setup) as (near, server):
        first = await send(near, Order(agent="go2", trajectory=path(0.5, 1.0)))
        await until(lambda: server.busy)
        second = await execute(near, order(0.2, 0.3))
        assert second.outcome is Outcome.BUSY
        assert (await first.result()).outcome is Outcome.SUCCEEDED
        first.close()


async def test_a_server_that_goes_away_is_an_error_and_none_at_all_another(node):
    async with node("planner") as near:
        far = node("go2")
        async with far:
            TrajectoryServer(far, "go2")
            execution = await send(near, Order(agent="go2", trajectory=path(5.0, 60.0)))
        with pytest.raises(bus.BusError, match="/global/go2/execute_trajectory"):
            await execution.result()
        execution.close()
        with pytest.raises(bus.BusTimeoutError, match="/global/spot/execute_trajectory"):
            await execute(near, order(agent="spot"), timeout_s=0.1)


async def test_poses_odometry_and_transforms_agree(node):
    async with node("go2") as far, node("viewer") as near:
        poses, odometries, buffer = {}, [], FrameBuffer()

        def note(message):
            poses[ns_from_stamp(message.header.stamp)] = message.pose

        near.create_subscription("geometry_msgs/msg/PoseStamped", "/global/go2/pose", note)
        near.create_subscription("nav_msgs/msg/Odometry", "/global/go2/odometry", odometries.append)
        async with FramesListener(near, buffer), TrajectoryServer(far, "go2"):
            await execute(near, order())
            await until(lambda: poses and odometries)
        last_ns = buffer.interval("map", "go2/base")[1]  # a pose may come before its transform
        compared = 0
        for odometry in odometries:
            stamp_ns = ns_from_stamp(odometry.header.stamp)
            if stamp_ns in poses and stamp_ns <= last_ns:
                pose = poses[stamp_ns]
                assert (odometry.pose.pose, odometry.child_frame_id) == (pose, "go2/base")
                assert buffer.look_up("map", "go2/base", stamp_ns).same_as(Pose.from_msg(pose))
                compared += 1
        assert compared > 10
        assert max(odometry.twist.twist.linear.x for odometry in odometries) > 0.2


def test_a_scene_gives_orders_for_the_agents_that_are_named_and_refuses_others():
    scene = load_scene(HALL)
    [order] = scene_orders(scene, agents=("drone",), start_ns=7)
    assert (order.agent, order.frame_id, order.start_ns) == ("drone", "map", 7)
    with pytest.raises(InvalidValueError, match=r"given 'spot', allowed: .*: go2, drone"):
        scene_orders(scene, agents=("spot",))
    editor = Editor(scene)
    editor.add("agent", "idle")
    with pytest.raises(InvalidValueError, match="given 'idle'"):
        scene_orders(editor.scene, agents=("idle",))
    assert len(scene_orders(editor.scene)) == 2
