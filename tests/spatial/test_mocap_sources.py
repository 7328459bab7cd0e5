"""Sources: Vicon by a library that is mimicked, topics over DDS, and logs."""

import asyncio
import enum
import sys
from contextlib import aclosing
from dataclasses import replace
from types import SimpleNamespace
from unittest.mock import Mock

import numpy as np
import pytest

from sfglab.messages import message_type
from sfglab.qos import QoSProfile
from sfglab.record import LogReader, LogWriter
from sfglab.spatial import Pose, StampedTransform
from sfglab.spatial.execution.orders import stamped_pose
from sfglab.spatial.mocap.sources import LogSource, TopicSource, ViconSource
from sfglab.spatial.mocap.tracking import Lapse, MocapError

world = pytest.fixture(lambda live: live)

S = 1_000_000_000
TURN = Pose.from_yaw((1.0, 2.0, 3.0), 0.7)


class Clock:
    def __init__(self):
        self.time_ns = 100 * S
        self.waits = []

    def now_ns(self):
        return self.time_ns

    async def sleep_for(self, duration_s):
        self.waits.append(duration_s)
        self.time_ns += round(duration_s * 1e9)


Result = enum.Enum("Result", ["Success", "NotConnected", "NoFrame", "ClientConnectionFailed"])
StreamMode = enum.Enum("StreamMode", ["ClientPull", "ServerPush"])
Direction = enum.Enum("Direction", ["Up", "Left", "Forward"])


@pytest.fixture
def client(monkeypatch):
    """The interface of pyvicon-datastream 0.2: mm, w x y z, None when occluded, seconds."""
    x, y, z, w = TURN.quat_xyzw
    places = {
        ("agent_x", "markers"): (np.array([1000.0, 2000.0, 3000.0]), np.array([w, x, y, z])),
        ("drone", "drone"): (None, None),
        ("broken", "broken"): (np.zeros(3), np.zeros(4)),
    }
    orders = ("connect", "enable_segment_data", "set_stream_mode", "set_axis_mapping")
    answers = {f"{name}.return_value": Result.Success for name in orders} | {
        "get_frame.side_effect": [
            Result.Success,
            Result.NoFrame,
            Result.Success,
            Result.NotConnected,
        ],
        "get_frame_number.side_effect": [1001, 1003],
        "get_latency_total.return_value": 0.0065,
        "get_subject_count.return_value": len(places),
        "get_subject_name.side_effect": lambda index: list(places)[index][0],
        "get_subject_root_segment_name.side_effect": dict(places.keys()).get,
        "get_segment_global_translation.side_effect": lambda *names: places[names][0],
        "get_segment_global_quaternion.side_effect": lambda *names: places[names][1],
    }
    client = Mock(**answers)
    library = {"Result": Result, "StreamMode": StreamMode, "Direction": Direction}
    module = SimpleNamespace(PyViconDatastream=lambda: client, **library)
    monkeypatch.setitem(sys.modules, "pyvicon_datastream", module)
    return client


async def test_vicon_frames_are_taken_with_capture_time_units_and_order(client):
    taken = []

    async def take():
        async with aclosing(ViconSource("tracker:801", clock=Clock()).captures()) as captures:
            async for capture in captures:
                taken.append(capture)  # noqa: PERF401 - it ends with an error

    with pytest.raises(MocapError, match=r"801: it cannot send a frame \(NotConnected"):
        await take()
    assert [c.number for c in taken] == [1001, 1003]
    assert (taken[0].receipt_ns, taken[0].capture_ns) == (100 * S, 100 * S - 6_500_000)
    seen = taken[0].sights
    assert seen.pop("agent_x/markers").same_as(TURN)
    assert seen == {"drone": Lapse.OCCLUDED, "broken": Lapse.INVALID}
    client.connect.assert_called_once_with("tracker:801")
    client.set_stream_mode.assert_called_once_with(StreamMode.ServerPush)
    client.set_axis_mapping.assert_called_once_with(Direction.Forward, Direction.Left, Direction.Up)
    client.disconnect.assert_called_once_with()


async def test_a_tracker_that_does_not_answer_is_one_error(client):
    client.connect.return_value = Result.ClientConnectionFailed
    with pytest.raises(MocapError, match=r"it cannot connect \(ClientConnectionFailed"):
        await anext(ViconSource("nowhere", clock=Clock()).captures())


def test_without_the_library_the_error_says_how_to_install_it(monkeypatch):
    monkeypatch.setitem(sys.modules, "pyvicon_datastream", None)
    with pytest.raises(MocapError, match="pip install pyvicon-datastream"):
        ViconSource("tracker", clock=Clock())


def pose_message(stamp_ns):
    return stamped_pose(TURN, "map", stamp_ns)


async def test_topics_become_captures_with_the_stamp_of_the_header(here, there):
    publisher = here.create_publisher("geometry_msgs/msg/PoseStamped", "/a", QoSProfile())
    broken = pose_message(6 * S)
    broken.pose.position.x = float("nan")
    async with (
        aclosing(TopicSource(there, {"a": "/a"}).captures()) as captures,
        asyncio.timeout(60),
    ):
        coming = asyncio.ensure_future(anext(captures))
        await publisher.wait_for_subscriptions()
        publisher.publish(pose_message(5 * S))
        first = await coming
        publisher.publish(broken)
        second = await anext(captures)
    now_ns = there.get_clock().now_ns()
    assert first == replace(first, number=None, capture_ns=5 * S, sights={"a": TURN})
    assert now_ns - 60 * S < first.receipt_ns <= now_ns
    assert second.sights == {"a": Lapse.INVALID}


@pytest.fixture
def log(tmp_path):
    with LogWriter(tmp_path / "run.mcap") as writer:
        for stamp_ns in range(0, 4 * S, S):
            half_ns = stamp_ns + S // 2
            value = StampedTransform(parent="map", child="b", stamp_ns=half_ns, pose=Pose())
            writer.write("/a", pose_message(stamp_ns), log_time_ns=stamp_ns + 6_000_000)
            writer.write("/b", value.to_msg(), log_time_ns=half_ns + 6_000_000)
        writer.write("/text", message_type("std_msgs/msg/String")(data=""), log_time_ns=0)
    return tmp_path / "run.mcap"


async def test_a_log_is_replayed_in_the_order_and_at_the_pace_of_receipt(log):
    clock = Clock()
    with LogReader(log) as reader:
        taken = [c async for c in LogSource(reader, {"a": "/a", "b": "/b"}, clock).captures()]
    assert [c.capture_ns for c in taken] == [i * S // 2 for i in range(8)]
    assert [c.receipt_ns - c.capture_ns for c in taken] == [6_000_000] * 8
    assert [c.sights for c in taken] == [{"a": TURN}, {"b": Pose()}] * 4
    assert clock.waits == pytest.approx([0.0, *[0.5] * 7])


async def test_a_log_with_another_type_is_refused(log):
    with (
        LogReader(log) as reader,
        pytest.raises(MocapError, match="/text: given the type std_msgs/msg/String"),
    ):
        await anext(LogSource(reader, {"a": "/text"}, Clock()).captures())
