"""TF trees: look-ups along chains and times, transforms from the bus, and the lint."""

import asyncio
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sfglab.messages import message_type
from sfglab.names import TF, TF_STATIC, FqnError
from sfglab.spatial import Pose, StampedTransform
from sfglab.spatial.frames.buffer import (
    Edge,
    ExtrapolationError,
    FrameBuffer,
    FrameLoopError,
    NotConnectedError,
    UnknownFrameError,
)
from sfglab.spatial.frames.lint import lint_frames
from sfglab.spatial.frames.listener import (
    TF_QOS,
    TF_STATIC_QOS,
    TRANSFORMS,
    FramesListener,
    TransformIntake,
)

world = pytest.fixture(lambda live: live)

S = 1_000_000_000


@pytest.fixture
def buffer():
    return FrameBuffer()


def at_x(parent, child, second=0, x_m=0, pose=None):
    pose = pose or Pose.at((x_m, 0, 0))
    return StampedTransform(parent=parent, child=child, stamp_ns=round(second * S), pose=pose)


def put(buffer, parent, child, second=0, x_m=0, *, static=False, pose=None):
    buffer.insert(at_x(parent, child, second, x_m, pose), static=static)


def x_of(buffer, target, source, time_ns=None):
    return buffer.look_up(target, source, time_ns).position_m[0]


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 2**32), st.integers(2, 25))
def test_a_look_up_between_any_frames_is_the_product_of_the_matrices(seed, size):
    rng = np.random.default_rng(seed)
    buffer, from_root = FrameBuffer(), [np.eye(4)]
    for frame in range(1, size):
        parent, static = int(rng.integers(frame)), bool(rng.integers(2))
        poses = [Pose.at(rng.normal(size=3), rng.normal(size=4)) for _ in range(1 if static else 2)]
        for second, pose in enumerate(poses):
            put(buffer, f"f{parent}", f"f{frame}", second, pose=pose, static=static)
        from_root.append(from_root[parent] @ poses[0].interpolate(poses[-1], 0.25).matrix())
    for a, b in rng.integers(size, size=(10, 2)).tolist():
        wanted = np.linalg.inv(from_root[a]) @ from_root[b]
        assert np.allclose(buffer.look_up(f"f{a}", f"f{b}", S // 4).matrix(), wanted, atol=1e-8)


@settings(max_examples=60, deadline=None)
@given(st.lists(st.tuples(st.integers(0, 3), st.integers(0, 60)), max_size=150))
def test_the_history_is_that_of_a_plain_list_whatever_the_order_of_arrival(arrivals):
    buffer, plain = FrameBuffer(history_s=10), {}
    for count, (frame, second) in enumerate(arrivals):
        put(buffer, "map", f"f{frame}", second, count)
        rows = plain.setdefault(f"f{frame}", {})
        rows[second] = count
        for old in [s for s in rows if s < max(rows) - 10]:
            del rows[old]
    for name, rows in plain.items():
        assert buffer.interval("map", name) == (min(rows) * S, max(rows) * S)
        assert rows == {second: x_of(buffer, "map", name, second * S) for second in rows}


def test_nothing_is_extrapolated_unless_asked_and_the_error_says_what_is_known(buffer):
    for second in (1, 2, 3):
        put(buffer, "map", "a", second, second)
    put(buffer, "map", "single", 1, 7)
    for time_ns in (7 * S // 2, S // 2):
        with pytest.raises(ExtrapolationError, match=r"'a' is known from 10{9} to 30{9} ns"):
            buffer.look_up("map", "a", time_ns, extrapolate_ns=S // 2 - 1)
        pose = buffer.look_up("map", "a", time_ns, extrapolate_ns=S // 2)
        assert pose.position_m[0] == pytest.approx(time_ns / S)
        held = buffer.look_up("map", "single", time_ns, extrapolate_ns=3 * S)
        assert held.position_m == (7, 0, 0)


def test_the_latest_common_time_is_that_of_the_slowest_edge(buffer):
    for second in (0, 4):
        put(buffer, "map", "a", second, second)
    for second in (0.5, 2.5):
        put(buffer, "a", "b", second)
    put(buffer, "b", "c", 9)
    assert buffer.interval("map", "b") == (S // 2, 5 * S // 2)
    assert x_of(buffer, "map", "b") == pytest.approx(2.5)
    assert buffer.interval("map", "c") is None
    with pytest.raises(ExtrapolationError):
        buffer.look_up("map", "c")


def test_static_transforms_hold_at_all_times_and_the_last_parent_counts(buffer):
    for x_m in (1, 2):
        put(buffer, "base", "camera", 5, x_m, static=True)
        assert {x_of(buffer, "base", "camera", at) for at in (-(2**62), 2**62, None)} == {x_m}
    put(buffer, "map", "base", 0)
    put(buffer, "odom", "base", 1, 7)
    assert x_of(buffer, "odom", "base", S) == 7
    with pytest.raises(NotConnectedError, match=r"first is 'map', that of the other 'odom'"):
        buffer.look_up("map", "base", 0)


def test_unknown_frames_are_refused_with_a_similar_name_and_loops_leave_the_tree_as_it_was(buffer):
    put(buffer, "a", "agent_x/b", 0, 1)
    put(buffer, "agent_x/b", "c")
    with pytest.raises(UnknownFrameError, match="did you mean 'agent_x/b'"):
        buffer.look_up("a", "agent_x_b", 0)
    with pytest.raises(FrameLoopError, match="a -> c -> agent_x/b -> a"):
        put(buffer, "c", "a")
    with pytest.raises(FrameLoopError):
        put(buffer, "d", "d")
    assert x_of(buffer, "a", "c", 0) == 1


# --- Lint --------------------------------------------------------------------------------------


def tree(*pairs, **options):
    return [Edge(parent=parent, child=child, **options) for parent, child in pairs]


def codes(edges, **options):
    return [finding.code for finding in lint_frames(edges, **options)]


GOOD = tree(("map", "go2/odom"), ("go2/odom", "go2/base"), ("go2/base", "go2/camera"))
AB = ("map", "a")
BEFORE = tree(AB, authority="1", first_ns=0, last_ns=100)
LATER = tree(AB, authority="2", first_ns=101, last_ns=200)
RIVAL = tree(AB, authority="2", first_ns=100, last_ns=200)


@pytest.mark.parametrize(
    ("edges", "options", "found"),
    [
        ([*tree(AB), *tree(AB, static=True)], {}, ["static-and-dynamic"]),
        ([*BEFORE, *LATER], {}, []),  # another publisher after a restart
        ([*BEFORE, *RIVAL], {}, ["two-publishers"]),
        ([*GOOD, *tree(("world", "go1/base"))], {}, ["second-root"]),
        (GOOD, {"root": "earth"}, ["unreachable"]),
        (tree(("map", "base"), ("map", "go2/"), ("map", "go2//a")), {"agents": ["go2"]}, ["name"] * 3),
    ],
)  # fmt: skip
def test_each_error_of_a_tree_is_found_once(edges, options, found):
    assert codes(edges, **options) == found


def test_a_finding_names_its_frames_and_its_consequence():
    edges = [*GOOD, *tree(("map", "go2/base"), ("world", "go1/base"))]
    parents, root, name = lint_frames(edges, root="map", agents=["go2"])
    assert parents.frames == ("go2/base", "go2/odom", "map")
    assert str(parents).startswith(
        "two-parents: 'go2/base' is placed in 'go2/odom' and 'map' (a frame has one parent"
    )
    assert (root.code, root.frames) == ("second-root", ("go1/base", "world"))
    assert (name.code, name.frames) == ("name", ("go1/base",))
    assert "did you mean 'go2/base'?" in name.what
    with pytest.raises(FqnError):
        lint_frames(edges, agents=["Go 2"])


def test_each_loop_is_found_once_and_named_from_child_to_parent():
    edges = tree(("c", "d"), ("d", "c"), ("b", "c"), ("a", "b"), ("b", "a"), ("e", "e"), ("e", "f"))
    loops = [(one.frames, one.what.split(",")[0]) for one in lint_frames(edges)[1:]]
    ways = ["a -> b -> a", "c -> d -> c", "e -> e"]
    assert loops == [(("a", "b"), ways[0]), (("c", "d"), ways[1]), (("e",), ways[2])]


def test_a_buffer_counts_what_the_lint_reports(buffer):
    for second in (100, 200, 150, 300, 120):
        put(buffer, "map", "a", second)
    (edge,) = buffer.edges
    assert (edge.count, edge.backwards, edge.back_ns) == (5, 2, 180 * S)
    assert (edge.first_ns, edge.last_ns) == (100 * S, 120 * S)
    for x_m in (0, 0, 1):
        put(buffer, "map", "b", 1, x_m)
        put(buffer, "map", "c", x_m, x_m, static=True)
    assert codes(buffer.edges) == ["backwards", "repeated", "static-twice"]


# --- Transforms from the bus -------------------------------------------------------------------


def message(*transforms):
    return message_type(TRANSFORMS)(transforms=[t.to_msg() for t in transforms])


async def test_a_listener_gets_latched_static_transforms_and_waits_for_those_to_come(
    here, there, buffer
):
    fixed = here.create_publisher(TRANSFORMS, TF_STATIC, TF_STATIC_QOS)
    fixed.publish(message(at_x("base", "camera", 0, 1.0)))
    moving = here.create_publisher(TRANSFORMS, TF, TF_QOS)
    async with FramesListener(there, buffer) as listener:
        await moving.wait_for_subscriptions()
        waiting = asyncio.create_task(listener.wait_for("map", "camera", 3 * S // 2, timeout_s=10))
        for second in (1, 2):
            moving.publish(message(at_x("map", "base", second, float(second))))
        assert (await waiting).position_m == (2.5, 0, 0)
        with pytest.raises(ExtrapolationError):
            await listener.wait_for("map", "base", 5 * S, timeout_s=0.01)
        assert listener.taken == 3
    assert all(len(edge.authority) == 32 for edge in buffer.edges)


def broken(child="base", x_m=0.0, y_m=0.0, w=1.0):
    """Return the message of a transform with values that tf2 ignores."""
    made = message(at_x("odom", child))
    moved = made.transforms[0].transform
    moved.translation.x, moved.translation.y = x_m, y_m
    moved.rotation.w = w
    return made


POSITION = "its position is not finite"
LENGTH = "the length of its quaternion is not 1 within 0.5 %"


@pytest.mark.parametrize(
    ("key", "first", "second", "why"),
    [
        ("child", "", "", "given ''"),
        ("child", "/", "/", "given ''"),
        ("x_m", math.nan, math.inf, POSITION),
        ("w", 0.0, 3.0, LENGTH),
        ("w", math.nan, math.nan, LENGTH),
    ],
)
def test_transforms_that_tf2_ignores_are_one_finding_and_hide_no_other(
    key, first, second, why, buffer, caplog
):
    intake = TransformIntake(buffer)
    intake.take(message(at_x("c", "c"), at_x("map", "b", 1, 4.0)), static=False)
    for value in (first, second):
        intake.take(broken(**{key: value}, y_m=float(value is second)), static=False)
    intake.take(broken(w=1.0049), static=False)  # is nearly normalised
    assert (intake.taken, intake.refused.total(), len(caplog.records)) == (2, 3, 2)
    assert x_of(buffer, "map", "b", S) == 4
    *tree, finding = lint_frames(buffer.edges, root="map", refused=intake.refused)
    assert [one.code for one in tree] == ["loop", "second-root"]
    assert finding.code == "refused"
    assert "(2x): " in finding.what
    assert why in finding.what
