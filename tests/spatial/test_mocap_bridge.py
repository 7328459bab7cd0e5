"""The bridge: Eq. 4, both trees of Fig. 6, its status, its mapping of objects to frames, and a live run."""

import logging
import math
from pathlib import Path

import numpy as np
import pytest

from sfglab.component import beside
from sfglab.documents import DocumentError
from sfglab.errors import InvalidValueError
from sfglab.lab.checks.trees import figure_6
from sfglab.messages import deserialize, message_type, ns_from_stamp, serialize
from sfglab.names import TF_STATIC
from sfglab.spatial import Pose, StampedTransform
from sfglab.spatial.frames.buffer import ExtrapolationError, FrameBuffer, UnknownFrameError
from sfglab.spatial.frames.lint import lint_frames
from sfglab.spatial.frames.listener import TF_STATIC_QOS, TRANSFORMS, FramesListener
from sfglab.spatial.mocap.bridge import (
    STATUS,
    STATUS_QOS,
    BridgeCore,
    MocapBridge,
    status_message,
    status_topic,
)
from sfglab.spatial.mocap.mapping import (
    MappedObject,
    MocapMapping,
    PlacingError,
    direct_name,
    load_mapping,
    place_via_proxy,
    read_mapping,
)
from sfglab.spatial.mocap.synthetic import SyntheticConfig, SyntheticMotion, SyntheticSource
from sfglab.spatial.mocap.tracking import Capture, Lapse, Limits, TrackState, Verdict

world = pytest.fixture(lambda live: live)

S = 1_000_000_000
ROBOT, FIG_6 = figure_6()


def frame(parent, child, pose, stamp_ns=0):
    return StampedTransform(parent=parent, child=child, stamp_ns=stamp_ns, pose=pose)


def capture(number=0, pose=None, **sights):
    sights = sights or {"agent_x/markers": pose or Pose()}
    stamp_ns = S + number * 10_000_000
    return Capture(
        number=number, capture_ns=stamp_ns, receipt_ns=stamp_ns + 6_000_000, sights=sights
    )


def robot_tree():
    buffer = FrameBuffer()
    for transform in ROBOT:
        buffer.insert(transform, static=True)
    return buffer


def test_the_root_is_published_with_the_robots_transform_at_the_time_of_capture():
    buffer = robot_tree()
    for second in (0, 1, 2):
        buffer.insert(
            frame("agent_x/odom", "agent_x/base", Pose.at((float(second), 0, 0)), second * S)
        )
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


def test_a_frame_that_has_another_parent_is_not_published():
    buffer = robot_tree()
    buffer.insert(frame("agent_x/odom", "agent_x/base", Pose()))
    mapped = MappedObject(id="o", via="agent_x/markers", frame="agent_x/base")
    with pytest.raises(
        PlacingError, match=r"stands in 'agent_x/odom' already; .* its tree, 'agent_x/odom'"
    ):
        place_via_proxy(buffer, mapped, frame("map", "o", Pose()))
    with pytest.raises(UnknownFrameError):
        place_via_proxy(FrameBuffer(), MappedObject(id="o", via="x"), frame("map", "o", Pose()))


def test_the_direct_receiver_joins_subject_and_segment_and_an_offset_stands_for_frames():
    assert direct_name("agent_x/markers") == "agent_x_markers"
    assert direct_name("drone") == "drone_drone"
    mapped = MappedObject(id="o", via="go2/base", frame="go2/base", offset=Pose.at((0, 0, -0.1)))
    placed = place_via_proxy(FrameBuffer(), mapped, frame("map", "o", Pose.at((1, 2, 3))))
    assert placed.pose.position_m == pytest.approx((1, 2, 2.9))


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


async def test_live_the_bridge_joins_a_robots_tree_to_the_world(node, here, there, caplog):
    caplog.set_level(logging.WARNING)
    async with node("bridge") as between:
        given = {"agent_x/markers": SyntheticMotion()}, SyntheticConfig(), np.random.default_rng(2)
        bridge = MocapBridge(between, SyntheticSource(*given, clock=between.get_clock()), FIG_6)
        buffer = FrameBuffer()
        async with beside(bridge.run()) as (task,), FramesListener(there, buffer) as listener:
            publisher = here.create_publisher(TRANSFORMS, TF_STATIC, TF_STATIC_QOS)
            publisher.publish(message_type(TRANSFORMS)(transforms=[t.to_msg() for t in ROBOT]))
            placed = await listener.wait_for("map", "agent_x/markers", timeout_s=25)
            await listener.wait_for("map", "agent_x/camera", timeout_s=10)
            statuses = there.create_subscription(STATUS, status_topic(), qos=STATUS_QOS)
            told = await statuses.take(timeout_s=10)
            while not told.objects[0].frame:
                told = await statuses.take(timeout_s=10)
    assert task.cancelled()
    assert [(o.id, o.frame) for o in told.objects] == [("agent_x/markers", "agent_x/base")]
    (status,) = bridge.core.statuses
    assert status.receipt_latency.median_ns > 5_900_000
    assert 0 < status.publication_latency.median_ns < 500_000_000
    assert abs(placed.position_m[0]) < 2.1
    assert lint_frames(buffer.edges, root="map") == ()
    assert all("'agent_x/markers' is unknown" in r.message for r in caplog.records)


TWO = read_mapping("world: map\nobjects: {x: {via: a/markers}, y: {via: b/markers}}")


def bridge():
    buffer = FrameBuffer()
    buffer.insert(frame("a/base", "a/markers", Pose()), static=True)
    return BridgeCore(TWO, buffer)


def test_every_object_of_the_mapping_is_told_by_the_interface_s_names_and_the_status_is_global():
    core = bridge()
    sights = (
        {"x": Pose(), "z": Pose()},
        {"x": Lapse.OCCLUDED},
        {"x": Lapse.INVALID},
        {"x": Pose.at((90, 0, 0)), "y": Pose()},
    )
    for number, seen in enumerate(sights):
        time_ns = S + number * 10_000_000
        capture = Capture(
            number=2 * number, capture_ns=time_ns, receipt_ns=time_ns + 6_000_000, sights=seen
        )
        published = [t.stamp_ns for t in core.take(capture, time_ns + 7_000_000)]
        assert published == ([S] if number == 0 else [])
    assert core.statuses[0].receipt_latency.largest_ns == 6_000_000
    told = deserialize(serialize(status_message(core, 5 * S)), STATUS)
    assert (ns_from_stamp(told.stamp), told.world) == (5 * S, "map")
    assert (told.captures, told.dropped, told.unmapped) == (4, 3, 1)
    x, y = told.objects
    assert (x.id, x.frame, x.state) == ("x", "a/base", x.SUSPECT)
    assert (x.published, x.sound, x.occluded, x.invalid, x.jumped, x.absent) == (1, 1, 1, 1, 1, 0)
    assert (ns_from_stamp(x.captured), x.receipt_latency_s, x.publication_latency_s) == (
        S,
        0.006,
        0.001,
    )
    assert (y.published, y.unplaced, y.absent) == (0, 1, 3)
    assert "'b/markers' is unknown" in y.problem
    assert math.isnan(y.receipt_latency_s)
    assert {getattr(x, state.name) for state in TrackState} == {0, 1, 2, 3}
    assert all(hasattr(x, verdict.value) for verdict in Verdict)
    assert status_topic() == "/global/mocap_status"
    assert status_topic("go2") == "/global/go2/mocap_status"


EXAMPLE = Path(__file__).parents[2] / "data" / "mocap" / "two_agents.yaml"


def test_the_example_says_what_it_says():
    mapping = load_mapping(EXAMPLE)
    assert mapping.world == "map"
    assert mapping.objects["agent_x/markers"] == MappedObject(
        id="agent_x/markers", via="agent_x/markers", frame="agent_x/base"
    )
    go2 = mapping.objects["Go2 Body"]
    assert (go2.via, go2.frame, go2.offset) == ("go2/base", "", Pose.at((0.031, -0.002, -0.118)))
    assert mapping.limits == Limits(speed_m_s=6.0, turn_rad_s=10.0)


GOOD = "world: map\nobjects:\n  a:\n    via: a/markers\n"


REFUSED = [  # beside what `test_documents.py` has for every file, and `checks.trees` for a mapping's numbers
    ("world: map\nobjects: {}\n", r"m\.yaml:2: objects: given \{\}, allowed: .* at least one"),
    (
        "world: /map\nobjects: {a: {via: b}}",
        r"m\.yaml:1: world: given '/map', .* without leading slash",
    ),
    (
        "world: map\nobjects: {a: {via: 3}}",
        r"objects\.a\.via: given 3, allowed: a text",
    ),
    (
        GOOD + "    frame:\n",
        r"m\.yaml:5: objects\.a\.frame: nothing is given, allowed: a text",
    ),
    (
        GOOD + "  b:\n    via: a/markers\n",
        r"m\.yaml:6: objects\.b\.via: .* objects\.a\.via has that one",
    ),
    (
        GOOD + "    frame: x\n  b: {via: c, frame: x}\n",
        r"m\.yaml:6: objects\.b\.frame: given 'x', .* objects\.a\.frame has",
    ),
    (GOOD + "  b: {via: map}\n", r"objects\.b\.via: given 'map', .* world has that one"),
    (
        GOOD + "    offset:\n      position_m: [0, 0, 0]\n      quat_xyzw: [0, 0, 0, 0]\n",
        r"m\.yaml:7: objects\.a\.offset\.quat_xyzw: .* length",
    ),
]


@pytest.mark.parametrize(("text", "says"), REFUSED)
def test_what_the_mapping_must_not_say_is_refused_with_its_place(text, says):
    with pytest.raises(DocumentError, match=says):
        read_mapping(text, file="m.yaml")


def test_a_mapping_that_is_built_is_checked_too():
    objects = {id_: MappedObject(id=id_, via="a/markers") for id_ in ("a", "b")}
    with pytest.raises(InvalidValueError, match="a frame of its own"):
        MocapMapping(world="map", objects=objects)
