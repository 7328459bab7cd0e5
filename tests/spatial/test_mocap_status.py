"""The bridge's status as a message."""

from __future__ import annotations

import math

from sfglab.messages import deserialize, ns_from_stamp, serialize
from sfglab.spatial import Pose, StampedTransform
from sfglab.spatial.frames import FrameBuffer
from sfglab.spatial.mocap import BridgeCore, Capture, Lapse, Verdict, read_mapping, status_topic
from sfglab.spatial.mocap.bridge import STATUS, status_message
from sfglab.spatial.mocap.tracking import TrackState

S = 1_000_000_000
TWO = read_mapping("world: map\nobjects: {x: {via: a/markers}, y: {via: b/markers}}")


def bridge():
    buffer = FrameBuffer()
    link = StampedTransform(parent="a/base", child="a/markers", stamp_ns=0, pose=Pose())
    buffer.insert(link, static=True)
    return BridgeCore(TWO, buffer)


def test_every_object_of_the_mapping_is_told_with_its_counts_and_times():
    core = bridge()
    sights = ({"x": Pose(), "z": Pose()}, {"x": Lapse.OCCLUDED}, {"x": Pose.at((90, 0, 0)), "y": Pose()})
    for number, seen in enumerate(sights):
        time_ns = S + number * 10_000_000
        core.take(
            Capture(number=2 * number, capture_ns=time_ns, receipt_ns=time_ns + 6_000_000, sights=seen),
            time_ns + 7_000_000,
        )
    told = deserialize(serialize(status_message(core, 5 * S)), STATUS)
    assert (ns_from_stamp(told.stamp), told.world) == (5 * S, "map")
    assert (told.captures, told.dropped, told.unmapped) == (3, 2, 1)
    x, y = told.objects
    assert (x.id, x.frame, x.state) == ("x", "a/base", x.SUSPECT)
    assert (x.published, x.sound, x.occluded, x.jumped, x.flipped, x.absent) == (1, 1, 1, 1, 0, 0)
    assert (ns_from_stamp(x.captured), x.receipt_latency_s, x.publication_latency_s) == (S, 0.006, 0.001)
    assert (y.published, y.unplaced, y.absent) == (0, 1, 2)
    assert "'b/markers' is unknown" in y.problem
    assert math.isnan(y.receipt_latency_s)


def test_states_and_verdicts_have_the_interface_s_names():
    told = status_message(bridge(), 0).objects[0]
    assert {getattr(told, state.name) for state in TrackState} == {0, 1, 2, 3}
    assert all(hasattr(told, verdict.value) for verdict in Verdict)


def test_the_status_is_global_so_that_routers_let_it_cross():
    assert status_topic() == "/global/mocap_status"
    assert status_topic("go2") == "/global/go2/mocap_status"
