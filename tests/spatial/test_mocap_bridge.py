"""The bridge: Eq. 4, its status, and its mapping of objects to frames."""

import math
from dataclasses import replace
from pathlib import Path

import pytest

from sfglab.documents import Document, DocumentError
from sfglab.lab.checks.trees import figure_6
from sfglab.messages import deserialize, serialize, stamp_from_ns
from sfglab.spatial import Pose, StampedTransform
from sfglab.spatial.frames.buffer import ExtrapolationError, FrameBuffer, UnknownFrameError
from sfglab.spatial.mocap.bridge import (
    STATUS,
    BridgeCore,
    status_message,
    status_topic,
)
from sfglab.spatial.mocap.mapping import (
    MappedObject,
    MocapMapping,
    PlacingError,
    load_mapping,
    place_via_proxy,
)
from sfglab.spatial.mocap.tracking import Capture, Lapse, Limits

S = 1_000_000_000
ROBOT, FIG_6 = figure_6()
BASE, MARKERS, ODOM = "agent_x/base", "agent_x/markers", "agent_x/odom"


def frame(parent, child, pose=None, stamp_ns=0):
    return StampedTransform(parent=parent, child=child, stamp_ns=stamp_ns, pose=pose or Pose())


def capture(number=0, **sights):
    stamp_ns = S + number * 10_000_000
    receipt_ns = stamp_ns + 6_000_000
    return Capture(number=number, capture_ns=stamp_ns, receipt_ns=receipt_ns, sights=sights)


@pytest.fixture
def tree():
    buffer = FrameBuffer()
    for transform in ROBOT:
        buffer.insert(transform, static=True)
    return buffer


def test_the_root_is_published_with_the_robots_transform_at_the_time_of_capture(tree):
    for second in (0, 2):
        tree.insert(frame(ODOM, BASE, Pose.at((second, 0, 0)), second * S))
    mapped = MappedObject(id="o", via=MARKERS)
    placed = place_via_proxy(tree, mapped, frame("map", "o", stamp_ns=3 * S // 2))
    assert placed.child == ODOM
    tree.insert(placed)
    assert tree.look_up("map", MARKERS, 3 * S // 2).same_as(Pose(), within_rad=1e-7)
    late = frame("map", "o", stamp_ns=2 * S + 1)
    with pytest.raises(ExtrapolationError):
        place_via_proxy(tree, mapped, late)
    assert place_via_proxy(tree, mapped, late, reach_ns=1).child == ODOM


@pytest.mark.parametrize(
    ("mapped", "error", "says"),
    [
        (
            MappedObject(id="o", via=MARKERS, frame=BASE),
            PlacingError,
            rf"already '{ODOM}'; .* its tree, '{ODOM}'",
        ),
        (MappedObject(id="o", via="map"), PlacingError, "directly below the world"),
        (MappedObject(id="o", via="x"), UnknownFrameError, "'x' is unknown"),
    ],
)
def test_a_frame_is_published_only_where_the_tree_stays_whole(mapped, error, says, tree):
    tree.insert(frame(ODOM, BASE))
    tree.insert(frame("map", "stick"))
    with pytest.raises(error, match=says):
        place_via_proxy(tree, mapped, frame("map", "o"))


def test_an_offset_replaces_frames():
    mapped = MappedObject(id="o", via="go2/base", frame="go2/base", offset=Pose.at((0, 0, -0.1)))
    placed = place_via_proxy(FrameBuffer(), mapped, frame("map", "o", Pose.at((1, 2, 3))))
    assert placed.pose.position_m == pytest.approx((1, 2, 2.9))


def test_lost_captures_are_counted_but_not_those_before_a_restart_of_the_server():
    core = BridgeCore(FIG_6, FrameBuffer())
    for number in (100, 103, 0, 1):
        core.take(capture(number))
    assert (core.captures, core.dropped) == (4, 2)


def test_a_root_must_be_the_same_for_a_while_and_only_later_faults_are_logged(tree, caplog):
    objects = {id_: MappedObject(id=id_, via=f"agent_x/{id_}") for id_ in ("markers", "camera")}
    core = BridgeCore(MocapMapping(world="map", objects=objects), tree, settle_ns=S)
    placed = []
    for number in range(300):
        if number == 50:
            tree.insert(frame(ODOM, BASE), static=True)
        found = core.take(capture(number, markers=Pose(), camera=Pose()))
        placed.append([one.child for one in found])
    assert placed == [[]] * 150 + [[ODOM]] * 150
    assert core.statuses[0].unplaced == 150
    assert "'markers' moves it already" in caplog.text
    assert len(caplog.records) == 1


def mapping(text):
    return Document(text, "m.yaml").read(MocapMapping)


def test_the_status_has_the_counts_of_each_object_and_its_topic_is_global():
    buffer = FrameBuffer()
    buffer.insert(frame("a/base", "a/markers"), static=True)
    text = "world: map\nobjects: {x: {via: a/markers}, y: {via: b/markers}}"
    core = BridgeCore(mapping(text), buffer)
    sights = (
        {"x": Pose(), "z": Pose()},
        {"x": Lapse.OCCLUDED},
        {"x": Lapse.INVALID},
        {"x": Pose.at((90, 0, 0)), "y": Pose()},
    )
    published = [len(core.take(capture(2 * number, **seen))) for number, seen in enumerate(sights)]
    assert published == [1, 0, 0, 0]
    told = deserialize(serialize(status_message(core, 5 * S)), STATUS)
    stamp = stamp_from_ns(5 * S)
    assert told == replace(told, stamp=stamp, world="map", captures=4, dropped=3, unmapped=1)
    x, y = told.objects
    assert x == replace(x, id="x", frame="a/base", state=x.SUSPECT, problem="")
    assert x == replace(x, published=1, sound=1, occluded=1, invalid=1, jumped=1, absent=0)
    assert x == replace(x, captured=stamp_from_ns(S), receipt_latency_s=0.006)
    assert y == replace(y, published=0, unplaced=1, absent=3)
    assert "'b/markers' is unknown" in y.problem
    assert math.isnan(y.receipt_latency_s)
    assert status_topic() == "/global/mocap_status"
    assert status_topic("go2") == "/global/go2/mocap_status"
    buffer.insert(frame("b/base", "b/markers"), static=True)
    assert len(core.take(capture(8, y=Pose()))) == 1
    assert core.statuses[1].problem == ""


EXAMPLE = Path(__file__).parents[2] / "data" / "mocap" / "two_agents.yaml"


def test_the_example_is_read():
    found = load_mapping(EXAMPLE)
    go2 = MappedObject(id="Go2 Body", via="go2/base", offset=Pose.at((0.031, -0.002, -0.118)))
    agent_x = MappedObject(id=MARKERS, via=MARKERS, frame=BASE)
    assert found.objects == {MARKERS: agent_x, "Go2 Body": go2}
    assert found.limits == Limits(speed_m_s=6.0, turn_rad_s=10.0)


GOOD = "world: map\nobjects:\n  a:\n    via: a/markers\n"
REFUSED = [  # besides those that `test_documents.py` has for all files
    ("world: map\nobjects: {}\n", r"m\.yaml:2: objects: given \{\}, allowed: .* at least one"),
    ("world: /map\nobjects: {a: {via: b}}", r"m\.yaml:1: world: .* without leading slash"),
    (
        GOOD + "  b: {via: a/markers}\n",
        r"m\.yaml:5: objects\.b\.via: given 'a/markers', .* of its own; this one belongs to a",
    ),
    (
        GOOD + "  b: {via: c, frame: map}\n",
        r"objects\.b\.frame: given 'map', .* belongs to the world",
    ),
    (
        GOOD + "    offset: {position_m: [0, 0, 0], quat_xyzw: [0, 0, 0, 0]}\n",
        r"m\.yaml:5: objects\.a\.offset\.quat_xyzw: .* length",
    ),
]


@pytest.mark.parametrize(("text", "says"), REFUSED)
def test_a_wrong_mapping_is_refused_with_the_place_of_the_mistake(text, says):
    with pytest.raises(DocumentError, match=says):
        mapping(text)
