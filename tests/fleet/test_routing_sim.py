"""The same router in the simulated world: many agents, late ones too, and every message where it belongs."""

import asyncio

import numpy as np
import pytest
from cameras import behind_router

from sfglab.component import beside
from sfglab.fleet.router.config import RouterSettings
from sfglab.fleet.router.node import Router
from sfglab.messages import default_message, message_type
from sfglab.names import TF_STATIC
from sfglab.spatial import Pose, StampedTransform
from sfglab.spatial.frames.buffer import FrameBuffer
from sfglab.spatial.frames.lint import lint_frames
from sfglab.spatial.frames.listener import TF_STATIC_QOS, TRANSFORMS, FramesListener
from sfglab.spatial.mocap.bridge import STATUS, STATUS_QOS, MocapBridge, status_topic
from sfglab.spatial.mocap.mapping import MappedObject, MocapMapping
from sfglab.spatial.mocap.synthetic import (
    SyntheticConfig,
    SyntheticMotion,
    SyntheticSource,
    synthetic_captures,
)

STRING = "std_msgs/msg/String"
sim = pytest.fixture(lambda: {"limit_s": 1000})


async def test_paths_are_reported_when_they_change(sim):
    told = []
    near, far = (sim.node("router", domain_id=domain) for domain in (7, 0))
    router = Router(near, far, RouterSettings(agent="a"), on_paths=told.append)
    async with beside(router.run()):
        await asyncio.sleep(2)
        sim.node("one", domain_id=7).create_subscription(STRING, "/global/x")
        await asyncio.sleep(2)
    ((path,),) = told
    assert (path.topic, path.readers, path.writers) == ("rt/global/x", 1, 0)


async def test_motion_capture_and_a_robot_behind_two_routers_have_one_tree_with_one_root(sim):
    go2, robot_router = behind_router(sim, "go2", placed_by_others=("base",))
    # Motion capture moves other agents' frames, so its own router filters none.
    station, station_router = behind_router(sim, "station", prefix_frames=False)
    clock, rng = station.get_clock(), np.random.default_rng(0)
    motions = {"Go2": SyntheticMotion()}
    captures = synthetic_captures(motions, SyntheticConfig(), rng, start_ns=clock.now_ns())
    mapped = MappedObject(id="Go2", via="go2/markers")
    mapping = MocapMapping(world="map", objects={"Go2": mapped})
    bridge = MocapBridge(station, SyntheticSource(captures, clock), mapping)
    inside, outside = FrameBuffer(), FrameBuffer()
    async with (
        beside(robot_router.run(), station_router.run(), bridge.run()),
        FramesListener(go2, inside) as at_robot,
        FramesListener(sim.node("viewer"), outside) as at_viewer,
    ):
        publisher = go2.create_publisher(TRANSFORMS, TF_STATIC, TF_STATIC_QOS)
        # Inside as well, only a tree with prefixes has the root that motion capture places.
        fixed = StampedTransform(parent="go2/base", child="go2/markers", stamp_ns=0, pose=Pose())
        publisher.publish(message_type(TRANSFORMS)(transforms=[fixed.to_msg()]))
        for listener in (at_robot, at_viewer):
            await listener.wait_for("map", "go2/markers", timeout_s=60)
        for buffer in (inside, outside):
            assert lint_frames(buffer.edges, root="map") == ()
            assert buffer.frames == ("go2/base", "go2/markers", "map")
        statuses = go2.create_subscription(STATUS, status_topic(), qos=STATUS_QOS)
        status = default_message("sfglab_interfaces/msg/MocapObject")
        while not status.frame:
            (status,) = (await statuses.take(timeout_s=60)).objects
        assert (status.id, status.frame, status.state) == ("Go2", "go2/base", status.TRACKED)
        assert status.receipt_latency_s > 0.006
