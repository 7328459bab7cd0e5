"""Transforms from the bus and from logs into a buffer."""

from __future__ import annotations

import asyncio
import logging

import pytest

from sfglab.bus import Node
from sfglab.messages import message_type
from sfglab.names import TF, TF_STATIC
from sfglab.record import LogError, LogReader, LogWriter
from sfglab.spatial import Pose, StampedTransform
from sfglab.spatial.frames import (
    TF_QOS,
    TF_STATIC_QOS,
    TRANSFORMS,
    ExtrapolationError,
    FrameBuffer,
    FramesListener,
    UnknownFrameError,
    fill_from_log,
    lint_frames,
)
from sfglab.spatial.frames.listener import TransformIntake

S = 1_000_000_000


def message(*transforms):
    return message_type(TRANSFORMS)(transforms=[t.to_msg() for t in transforms])


def step(parent, child, second, x_m):
    return StampedTransform(parent=parent, child=child, stamp_ns=second * S, pose=Pose.at((x_m, 0, 0)))


def test_a_listener_hears_static_transforms_of_before_and_waits_for_those_to_come(domain_id):
    async def main():
        async with (
            Node("robot", domain_id=domain_id, interface="lo") as robot,
            Node("viewer", domain_id=domain_id, interface="lo") as viewer,
        ):
            fixed = robot.create_publisher(TRANSFORMS, TF_STATIC, TF_STATIC_QOS)
            fixed.publish(message(step("base", "camera", 0, 1.0)))
            moving = robot.create_publisher(TRANSFORMS, TF, TF_QOS)
            buffer = FrameBuffer()
            async with FramesListener(viewer, buffer, agent="go2") as listener:
                await moving.wait_for_subscriptions()
                waiting = asyncio.create_task(listener.wait_for("map", "go2/camera", 3 * S // 2, timeout_s=10))
                for second in (1, 2):
                    moving.publish(message(step("map", "base", second, float(second))))
                assert (await waiting).position_m == (2.5, 0, 0)
                with pytest.raises(ExtrapolationError):
                    await listener.wait_for("map", "go2/base", 5 * S, timeout_s=0.01)
                with pytest.raises(UnknownFrameError):
                    await listener.wait_for("map", "base", timeout_s=0.01)
                assert listener.taken["appended"] == 3
            assert all(len(edge.authority) == 32 for edge in buffer.edges)
            assert lint_frames(buffer.edges, root="map") == ()

    asyncio.run(main())


def test_a_broken_transform_is_counted_and_said_once_while_the_rest_goes_on(caplog):
    buffer = FrameBuffer()
    intake = TransformIntake(buffer)
    broken = message(step("map", "a", 1, 0.0), step("map", "b", 1, 4.0), step("c", "c", 1, 0.0))
    broken.transforms[0].transform.rotation.w = float("nan")
    with caplog.at_level(logging.WARNING):
        intake.take(broken, static=False)
        intake.take(broken, static=False)
    assert intake.refused == {"PoseError": 2, "FrameLoopError": 2}
    assert intake.taken == {"appended": 1, "replaced": 1}
    assert [r.message.split(":")[0] for r in caplog.records] == ["transform refused"] * 2
    assert "tf map -> a, quaternion" in caplog.text
    assert buffer.look_up("map", "b", S).position_m == (4, 0, 0)


def test_a_log_fills_a_buffer_with_all_that_it_has(tmp_path):
    with LogWriter(tmp_path / "run.mcap") as log:
        for second in range(100):
            log.write(TF, message(step("map", "base", second, float(second))), log_time_ns=second * S)
        log.write(TF_STATIC, message(step("base", "camera", 0, 0.5)), log_time_ns=50 * S)
    buffer = FrameBuffer(history_s=None)
    with LogReader(tmp_path / "run.mcap") as reader:
        intake = fill_from_log(reader, buffer)
    assert intake.taken == {"appended": 101}
    assert buffer.look_up("map", "camera", 10 * S + S // 2).position_m == (11.0, 0, 0)


def test_a_log_without_transforms_is_refused(tmp_path):
    with LogWriter(tmp_path / "run.mcap") as log:
        log.write("/text", message_type("std_msgs/msg/String")(data="x"), log_time_ns=0)
    with LogReader(tmp_path / "run.mcap") as reader, pytest.raises(LogError, match="/tf"):
        fill_from_log(reader, FrameBuffer())
