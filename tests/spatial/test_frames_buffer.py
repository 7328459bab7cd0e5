"""The buffer of frames: look-up along chains, at times, and what it refuses."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sfglab.errors import InvalidValueError
from sfglab.spatial import Pose, StampedTransform
from sfglab.spatial.frames import (
    ExtrapolationError,
    FrameBuffer,
    NotConnectedError,
    UnknownFrameError,
)
from sfglab.spatial.frames.buffer import FrameLoopError
from sfglab.spatial.frames.history import Insertion

S = 1_000_000_000


def put(buffer, parent, child, stamp_ns=0, pose=None, **options):
    transform = StampedTransform(parent=parent, child=child, stamp_ns=stamp_ns, pose=pose or Pose())
    return buffer.insert(transform, **options)


def random_pose(rng):
    return Pose.at(rng.normal(size=3), rng.normal(size=4))


def test_a_known_chain_has_known_numbers():
    buffer = FrameBuffer()
    put(buffer, "map", "odom", 0, Pose.from_yaw((1, 0, 0), 0))
    put(buffer, "map", "odom", S, Pose.from_yaw((3, 0, 0), np.pi))
    put(buffer, "odom", "base", 0, Pose.at((0, 1, 0)), static=True)
    assert buffer.look_up("map", "base", S // 2).same_as(Pose.from_yaw((1, 0, 0), np.pi / 2))
    assert buffer.look_up("base", "map", S).same_as(Pose.from_yaw((3, -1, 0), np.pi))
    assert buffer.look_up("map", "map", 17) == Pose()
    assert buffer.root_of("base") == "map"
    assert buffer.parent_of("base") == "odom"
    assert buffer.parent_of("map") is None
    assert buffer.frames == ("base", "map", "odom")
    assert "odom" in buffer


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 2**32), st.integers(2, 25))
def test_look_up_between_any_frames_is_the_product_of_the_matrices(seed, size):
    rng = np.random.default_rng(seed)
    buffer, from_root = FrameBuffer(), [Pose()]
    for frame in range(1, size):
        parent, static = int(rng.integers(frame)), bool(rng.integers(2))
        rows = [random_pose(rng), random_pose(rng)]
        for stamp_ns, pose in enumerate(rows[: 1 if static else 2]):
            put(buffer, f"f{parent}", f"f{frame}", stamp_ns * S, pose, static=static)
        edge = rows[0] if static else rows[0].interpolate(rows[1], 0.25)
        from_root.append(from_root[parent] @ edge)
    for _ in range(10):
        a, b = (int(i) for i in rng.integers(size, size=2))
        wanted = np.linalg.inv(from_root[a].matrix()) @ from_root[b].matrix()
        assert np.allclose(buffer.look_up(f"f{a}", f"f{b}", S // 4).matrix(), wanted, atol=1e-8)


@settings(max_examples=60, deadline=None)
@given(st.permutations(range(40)), st.data())
def test_the_order_of_arrival_does_not_matter(order, data):
    rng = np.random.default_rng(1)
    rows = [random_pose(rng) for _ in order]
    buffer = FrameBuffer(history_s=100)
    for i in order:
        put(buffer, "map", "a", i * S, rows[i])
    row, fraction = data.draw(st.integers(0, 38)), data.draw(st.floats(0, 0.999))
    time_ns = int((row + fraction) * S)
    wanted = rows[row].interpolate(rows[row + 1], (time_ns - row * S) / S)
    assert buffer.look_up("map", "a", time_ns).same_as(wanted, within_rad=1e-6)


@settings(max_examples=60, deadline=None)
@given(st.lists(st.tuples(st.integers(0, 3), st.integers(0, 60)), max_size=150))
def test_the_history_is_that_of_a_plain_list(arrivals):
    buffer, plain = FrameBuffer(history_s=10), {f"f{i}": {} for i in range(4)}
    for count, (frame, second) in enumerate(arrivals):
        name, rows = f"f{frame}", plain[f"f{frame}"]
        newest = max(rows, default=second)
        told = put(buffer, "map", name, second * S, Pose.at((count, 0, 0)))
        if second < newest - 10:
            assert told is Insertion.TOO_OLD
            continue
        replaced, late = second in rows, second < newest
        assert told is (
            Insertion.REPLACED if replaced else Insertion.OUT_OF_ORDER if late else Insertion.APPENDED
        )
        rows[second] = count
        plain[name] = {s: c for s, c in rows.items() if s >= max(rows) - 10}
    for name, rows in plain.items():
        for second, count in rows.items():
            assert buffer.look_up("map", name, second * S).position_m == (count, 0, 0)
        if rows:
            assert buffer.interval("map", name) == (min(rows) * S, max(rows) * S)


def test_memory_stays_bounded_however_long_transforms_come():
    buffer = FrameBuffer(history_s=1.0)
    for i in range(20_000):
        put(buffer, "map", "a", i * S // 100)
    assert len(buffer._history.stamps) < 1000
    assert buffer.interval("map", "a") == (19_899 * S // 100, 19_999 * S // 100)


def test_nothing_is_extrapolated_unless_asked_and_the_error_says_what_is_known():
    buffer = FrameBuffer()
    for i in range(3):
        put(buffer, "map", "a", (i + 1) * S, Pose.from_yaw((i, 0, 0), 0.1 * i))
    known = r"'a' is known from 1000000000 to 3000000000 ns"
    with pytest.raises(ExtrapolationError, match=rf"{known} \(500.000 ms after that\)"):
        buffer.look_up("map", "a", 7 * S // 2)
    with pytest.raises(ExtrapolationError, match=rf"{known} \(0.000 ms before that\)"):
        buffer.look_up("a", "map", S - 1)
    with pytest.raises(ExtrapolationError):
        buffer.look_up("map", "a", 7 * S // 2, extrapolate_ns=S // 2 - 1)
    ahead = buffer.look_up("map", "a", 7 * S // 2, extrapolate_ns=S // 2)
    assert ahead.same_as(Pose.from_yaw((2.5, 0, 0), 0.25), within_rad=1e-7)
    assert buffer.look_up("map", "a", S // 2, extrapolate_ns=S).same_as(Pose.from_yaw((-0.5, 0, 0), -0.05))


def test_a_single_transform_is_held_when_extrapolation_is_asked_for():
    buffer = FrameBuffer()
    put(buffer, "map", "a", S, Pose.at((1, 2, 3)))
    assert buffer.look_up("map", "a", S).position_m == (1, 2, 3)
    assert buffer.look_up("map", "a", 2 * S, extrapolate_ns=S).position_m == (1, 2, 3)


def test_the_latest_common_time_is_that_of_the_slowest_edge():
    buffer = FrameBuffer()
    for i in range(5):
        put(buffer, "map", "a", i * S, Pose.at((i, 0, 0)))
    for i in range(3):
        put(buffer, "a", "b", i * S + 1, Pose.at((0, i, 0)))
    assert buffer.interval("map", "b") == (1, 2 * S + 1)
    assert buffer.look_up("map", "b").position_m == pytest.approx((2.0, 2.0, 0.0), abs=1e-6)


def test_edges_that_share_no_time_have_no_interval_and_the_error_names_one():
    buffer = FrameBuffer()
    put(buffer, "map", "a", S)
    put(buffer, "a", "b", 2 * S)
    assert buffer.interval("map", "b") is None
    with pytest.raises(ExtrapolationError):
        buffer.look_up("map", "b")


def test_static_transforms_hold_at_all_times():
    buffer = FrameBuffer()
    put(buffer, "base", "camera", 5 * S, Pose.at((1, 0, 0)), static=True)
    for time_ns in (-(2**62), 0, 2**62, None):
        assert buffer.look_up("base", "camera", time_ns).position_m == (1, 0, 0)
    assert put(buffer, "base", "camera", S, Pose.at((2, 0, 0)), static=True) is Insertion.REPLACED
    assert buffer.look_up("base", "camera", 0).position_m == (2, 0, 0)


def test_the_last_parent_counts_and_the_old_history_is_gone():
    buffer = FrameBuffer()
    put(buffer, "map", "a", 0)
    put(buffer, "odom", "a", S, Pose.at((7, 0, 0)))
    assert buffer.look_up("odom", "a", S).position_m == (7, 0, 0)
    with pytest.raises(NotConnectedError, match=r"the root 'map', the other one below 'odom'"):
        buffer.look_up("map", "a", 0)


def test_unknown_frames_are_refused_with_names_that_look_similar():
    buffer = FrameBuffer()
    put(buffer, "map", "agent_x/markers")
    with pytest.raises(UnknownFrameError, match="did you mean 'agent_x/markers'"):
        buffer.look_up("map", "agent_x_markers", 0)
    with pytest.raises(UnknownFrameError, match="2 frames are known"):
        buffer.root_of("zzz")


def test_loops_are_refused_and_leave_the_tree_as_it_was():
    buffer = FrameBuffer()
    put(buffer, "a", "b", 0, Pose.at((1, 0, 0)))
    put(buffer, "b", "c", 0)
    with pytest.raises(FrameLoopError, match="a -> c -> b -> a"):
        put(buffer, "c", "a")
    with pytest.raises(FrameLoopError):
        put(buffer, "d", "d")
    assert buffer.look_up("a", "c", 0).position_m == (1, 0, 0)


@pytest.mark.parametrize("name", ["", " base"])
def test_frames_without_a_sound_name_are_refused(name):
    with pytest.raises(InvalidValueError):
        put(FrameBuffer(), "map", name)


def test_clearing_forgets_transforms_but_not_the_tree():
    buffer = FrameBuffer()
    put(buffer, "map", "a", 5 * S)
    buffer.clear()
    with pytest.raises(ExtrapolationError, match="known never"):
        buffer.look_up("map", "a", 5 * S)
    assert put(buffer, "map", "a", S) is Insertion.APPENDED


@pytest.mark.parametrize("history_s", [0, -1.0, float("nan")])
def test_a_history_of_no_time_is_refused(history_s):
    with pytest.raises(InvalidValueError, match="history_s"):
        FrameBuffer(history_s=history_s)
