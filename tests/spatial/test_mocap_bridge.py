"""The bridge: Eq. 4, both trees of Fig. 6, counts and times, and a live run over DDS."""

from __future__ import annotations

import asyncio
import logging

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sfglab.bus import Node
from sfglab.messages import message_type
from sfglab.names import TF_STATIC
from sfglab.spatial import Pose, StampedTransform
from sfglab.spatial.frames import (
    TF_STATIC_QOS,
    TRANSFORMS,
    ExtrapolationError,
    FrameBuffer,
    FrameRule,
    FramesListener,
    UnknownFrameError,
    lint_frames,
)
from sfglab.spatial.frames.lint import roots_of
from sfglab.spatial.mocap import (
    BridgeCore,
    Capture,
    Lapse,
    MappedObject,
    MocapBridge,
    MocapMapping,
    SyntheticConfig,
    SyntheticMotion,
    SyntheticSource,
    mocap_trees,
    read_mapping,
    status_topic,
    synthetic_captures,
)
from sfglab.spatial.mocap.bridge import STATUS, STATUS_QOS
from sfglab.spatial.mocap.mapping import PlacingError, direct_name, place_via_proxy
from sfglab.spatial.mocap.tracking import TrackState

S = 1_000_000_000
MARKERS = Pose.at((0.1, 0.0, 0.2), (0, 0, 0.3, 1))
CAMERA = Pose.at((0.3, 0.0, 0.0))
FIG_6 = read_mapping("world: map\nobjects: {agent_x/markers: {via: agent_x/markers, frame: agent_x/base}}")


def frame(parent, child, pose, stamp_ns=0):
    return StampedTransform(parent=parent, child=child, stamp_ns=stamp_ns, pose=pose)


ROBOT = (frame("agent_x/base", "agent_x/markers", MARKERS), frame("agent_x/base", "agent_x/camera", CAMERA))


def capture(number=0, pose=None, **sights):
    sights = sights or {"agent_x/markers": pose or Pose()}
    stamp_ns = S + number * 10_000_000
    return Capture(number=number, capture_ns=stamp_ns, receipt_ns=stamp_ns + 6_000_000, sights=sights)


def robot_tree():
    buffer = FrameBuffer()
    for transform in ROBOT:
        buffer.insert(transform, static=True)
    return buffer


def test_figure_6_the_direct_receiver_breaks_the_tree_and_the_proxy_frame_does_not():
    motion = SyntheticMotion()
    made = list(
        synthetic_captures(
            {"agent_x/markers": motion}, SyntheticConfig(), np.random.default_rng(1), start_ns=S, duration_s=1.0
        )
    )
    trees = mocap_trees(ROBOT, FIG_6, [m.capture for m in made])
    rule = FrameRule(agents=frozenset({"agent_x"}))

    left = lint_frames(trees.direct.edges, rule=rule)
    assert {f.code for f in left} == {"second-root", "name"}
    assert [f.frames for f in left if f.code == "name"] == [("agent_x_markers",)]
    assert roots_of(trees.direct.edges) == ("agent_x/base", "map")

    renamed = lint_frames(trees.renamed.edges, rule=rule)
    assert {f.code for f in renamed} == {"two-parents", "second-root"}

    assert lint_frames(trees.proxy.edges, rule=rule, root="map") == ()
    last = made[-1]
    truth = last.truth["agent_x/markers"] @ MARKERS.inverse() @ CAMERA
    placed = trees.proxy.look_up("map", "agent_x/camera", last.capture.capture_ns)
    assert placed.same_as(truth, within_m=0.01, within_rad=0.02)


def test_equation_4_in_known_numbers():
    seen = frame("map", "agent_x", Pose.from_yaw((1.0, 2.0, 0.0), np.pi / 2), stamp_ns=7)
    buffer = FrameBuffer()
    buffer.insert(frame("a/base", "a/markers", Pose.at((0.5, 0.0, 0.0))), static=True)
    placed = place_via_proxy(buffer, MappedObject(id="agent_x", via="a/markers", frame="a/base"), seen)
    assert (placed.parent, placed.child, placed.stamp_ns) == ("map", "a/base", 7)
    assert placed.pose.same_as(Pose.from_yaw((1.0, 1.5, 0.0), np.pi / 2))


def test_the_root_is_published_with_the_robots_transform_at_the_time_of_capture():
    buffer = robot_tree()
    for second in (0, 1, 2):
        buffer.insert(frame("agent_x/odom", "agent_x/base", Pose.at((float(second), 0, 0)), second * S))
    mapped = MappedObject(id="o", via="agent_x/markers")
    seen = frame("map", "o", Pose(), stamp_ns=3 * S // 2)
    placed = place_via_proxy(buffer, mapped, seen)
    assert placed.child == "agent_x/odom"
    buffer.insert(placed)
    assert buffer.look_up("map", "agent_x/markers", 3 * S // 2).same_as(Pose(), within_rad=1e-7)
    assert place_via_proxy(buffer, mapped, seen) == placed  # also when it hears itself
    late = frame("map", "o", Pose(), stamp_ns=2 * S + 1)
    with pytest.raises(ExtrapolationError):
        place_via_proxy(buffer, mapped, late)
    assert place_via_proxy(buffer, mapped, late, reach_ns=1).child == "agent_x/odom"


def test_an_offset_stands_for_frames_that_the_robot_does_not_publish():
    mapped = MappedObject(id="o", via="go2/base", frame="go2/base", offset=Pose.at((0, 0, -0.1)))
    placed = place_via_proxy(FrameBuffer(), mapped, frame("map", "o", Pose.at((1, 2, 3))))
    assert placed.pose.position_m == pytest.approx((1, 2, 2.9))


def test_a_frame_that_has_another_parent_is_not_published():
    buffer = robot_tree()
    buffer.insert(frame("agent_x/odom", "agent_x/base", Pose()))
    mapped = MappedObject(id="o", via="agent_x/markers", frame="agent_x/base")
    with pytest.raises(PlacingError, match=r"stands in 'agent_x/odom' already; .* its tree, 'agent_x/odom'"):
        place_via_proxy(buffer, mapped, frame("map", "o", Pose()))
    with pytest.raises(UnknownFrameError):
        place_via_proxy(FrameBuffer(), MappedObject(id="o", via="x"), frame("map", "o", Pose()))


def test_the_direct_receiver_joins_subject_and_segment():
    assert direct_name("agent_x/markers") == "agent_x_markers"
    assert direct_name("drone") == "drone_drone"


def test_the_core_keeps_three_times_and_counts_everything():
    core = BridgeCore(FIG_6, robot_tree())
    published = [core.take(c, c.receipt_ns + 500_000) for c in (capture(0), capture(1), capture(4))]
    assert [t.stamp_ns for (t,) in published] == [S, S + 10_000_000, S + 40_000_000]
    lapses = (Lapse.OCCLUDED, Lapse.INVALID, Pose.at((50, 0, 0)))
    for number, sight in enumerate(lapses, start=5):
        assert core.take(capture(number, **{"agent_x/markers": sight}), 0) == ()
    core.take(capture(8, stranger=Pose()), 0)
    (status,) = core.statuses
    assert (core.captures, core.dropped, core.unmapped) == (7, 2, {"stranger": 1})
    assert status.verdicts == {"sound": 3, "occluded": 1, "invalid": 1, "jumped": 1}
    assert (status.published, status.unplaced, status.absent) == (3, 0, 1)
    assert (status.state, status.frame) == (TrackState.SUSPECT, "agent_x/base")
    assert status.capture_ns == S + 40_000_000
    assert (status.receipt_latency.median_ns, status.receipt_latency.largest_ns) == (6_000_000, 6_000_000)
    assert status.publication_latency.median_ns == 500_000


def test_a_server_that_begins_anew_has_dropped_nothing():
    core = BridgeCore(FIG_6, robot_tree())
    for number, stamp in ((100, 0), (0, 1), (1, 2)):
        core.take(Capture(number=number, capture_ns=stamp, receipt_ns=stamp, sights={}), stamp)
    assert core.dropped == 0


def test_what_the_tree_does_not_allow_is_said_until_it_does():
    buffer = FrameBuffer()
    core = BridgeCore(FIG_6, buffer)
    assert core.take(capture(0), 0) == ()
    assert core.statuses[0].unplaced == 1
    assert "'agent_x/markers' is unknown" in core.statuses[0].problem
    for transform in ROBOT:
        buffer.insert(transform, static=True)
    assert len(core.take(capture(1), 0)) == 1
    assert core.statuses[0].problem == ""


def test_two_objects_do_not_move_one_root():
    objects = {id_: MappedObject(id=id_, via=f"agent_x/{id_}") for id_ in ("markers", "camera")}
    core = BridgeCore(MocapMapping(world="map", objects=objects), robot_tree())
    (only,) = core.take(capture(0, markers=Pose(), camera=Pose()), 0)
    assert only.child == "agent_x/base"
    assert "'markers' moves it already" in core.statuses[1].problem


def test_live_the_bridge_joins_a_robots_tree_to_the_world(domain_id, caplog):
    motion = SyntheticMotion()

    async def main():
        options = {"domain_id": domain_id, "interface": "lo"}
        async with (
            Node("robot", **options) as robot,
            Node("bridge", **options) as node,
            Node("viewer", **options) as viewer,
        ):
            clock = node.get_clock()
            source = SyntheticSource(
                {"agent_x/markers": motion}, SyntheticConfig(), np.random.default_rng(2), clock=clock
            )
            bridge = MocapBridge(node, source, FIG_6)
            task = asyncio.create_task(bridge.run())
            buffer = FrameBuffer()
            try:
                async with FramesListener(viewer, buffer) as listener:
                    publisher = robot.create_publisher(TRANSFORMS, TF_STATIC, TF_STATIC_QOS)
                    publisher.publish(message_type(TRANSFORMS)(transforms=[t.to_msg() for t in ROBOT]))
                    placed = await listener.wait_for("map", "agent_x/markers", timeout_s=25)
                    await listener.wait_for("map", "agent_x/camera", timeout_s=10)
                    statuses = viewer.create_subscription(STATUS, status_topic(), qos=STATUS_QOS)
                    told = await statuses.take(timeout_s=10)
                    while not told.objects[0].frame:
                        told = await statuses.take(timeout_s=10)
            finally:
                task.cancel()
                await asyncio.gather(task, return_exceptions=True)
            assert task.cancelled()
            assert [(o.id, o.frame) for o in told.objects] == [("agent_x/markers", "agent_x/base")]
            (status,) = bridge.statuses
            assert status.receipt_latency.median_ns > 5_900_000
            assert 0 < status.publication_latency.median_ns < 500_000_000
            assert abs(placed.position_m[0]) < 2.1
            assert lint_frames(buffer.edges, root="map") == ()

    with caplog.at_level(logging.WARNING):
        asyncio.run(main())
    assert all("'agent_x/markers' is unknown" in r.message for r in caplog.records)


def random_pose(rng):
    return Pose.at(rng.normal(size=3).tolist(), rng.normal(size=4).tolist())


@settings(max_examples=50, deadline=None)
@given(st.integers(0, 2**32), st.integers(1, 12))
def test_whatever_the_robots_tree_the_proxy_stands_where_it_was_seen_and_the_tree_stays_whole(seed, size):
    rng = np.random.default_rng(seed)
    buffer = FrameBuffer()
    for child in range(1, size + 1):
        parent, static = int(rng.integers(child)), bool(rng.integers(2))
        for stamp_ns in (0,) if static else (0, 2 * S):
            buffer.insert(frame(f"a/{parent}", f"a/{child}", random_pose(rng), stamp_ns), static=static)
    via, seen = f"a/{rng.integers(size + 1)}", random_pose(rng)
    core = BridgeCore(MocapMapping(world="map", objects={"o": MappedObject(id="o", via=via)}), buffer)
    (transform,) = core.take(Capture(number=0, capture_ns=S, receipt_ns=S, sights={"o": seen}), S)
    assert transform.child == "a/0"
    buffer.insert(transform)
    assert buffer.look_up("map", via, S).same_as(seen, within_m=1e-9, within_rad=1e-6)
    assert lint_frames(buffer.edges, root="map", rule=FrameRule(agents=frozenset({"a"}))) == ()
