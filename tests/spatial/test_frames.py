"""TF trees: look-ups along chains and times, transforms from the bus and from logs, and the lint."""

import asyncio
import logging
import math
import time
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sfglab.messages import message_type
from sfglab.names import TF, TF_STATIC, FqnError
from sfglab.record import LogReader, LogWriter
from sfglab.spatial import Pose, StampedTransform
from sfglab.spatial.frames.buffer import (
    Edge,
    ExtrapolationError,
    FrameBuffer,
    FrameLoopError,
    NotConnectedError,
    UnknownFrameError,
)
from sfglab.spatial.frames.lint import FrameRule, lint_frames
from sfglab.spatial.frames.listener import (
    TF_QOS,
    TF_STATIC_QOS,
    TRANSFORMS,
    FramesListener,
    TransformIntake,
    fill_from_log,
)

world = pytest.fixture(lambda live: live)

S = 1_000_000_000


@pytest.fixture
def buffer():
    return FrameBuffer()


def step(parent, child, stamp_ns=0, pose=None):
    return StampedTransform(parent=parent, child=child, stamp_ns=stamp_ns, pose=pose or Pose())


def put(buffer, parent, child, stamp_ns=0, pose=None, **options):
    buffer.insert(step(parent, child, stamp_ns, pose), **options)


def random_pose(rng):
    return Pose.at(rng.normal(size=3), rng.normal(size=4))


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 2**32), st.integers(2, 25))
def test_a_look_up_between_any_frames_is_the_product_of_the_matrices(seed, size):
    rng = np.random.default_rng(seed)
    buffer, from_root = FrameBuffer(), [np.eye(4)]
    for frame in range(1, size):
        parent, static = int(rng.integers(frame)), bool(rng.integers(2))
        first, second = random_pose(rng), random_pose(rng)
        put(buffer, f"f{parent}", f"f{frame}", 0, first, static=static)
        if not static:
            put(buffer, f"f{parent}", f"f{frame}", S, second)
            first = first.interpolate(second, 0.25)
        from_root.append(from_root[parent] @ first.matrix())
    for a, b in rng.integers(size, size=(10, 2)).tolist():
        wanted = np.linalg.inv(from_root[a]) @ from_root[b]
        assert np.allclose(buffer.look_up(f"f{a}", f"f{b}", S // 4).matrix(), wanted, atol=1e-8)


@settings(max_examples=60, deadline=None)
@given(st.lists(st.tuples(st.integers(0, 3), st.integers(0, 60)), max_size=150))
def test_the_history_is_that_of_a_plain_list_whatever_the_order_of_arrival(arrivals):
    buffer, plain = FrameBuffer(history_s=10), {}
    for count, (frame, second) in enumerate(arrivals):
        put(buffer, "map", f"f{frame}", second * S, Pose.at((count, 0, 0)))
        rows = plain.setdefault(f"f{frame}", {})
        if second >= max(rows, default=0) - 10:
            rows[second] = count
        for old in [s for s in rows if s < max(rows) - 10]:
            del rows[old]
    for name, rows in plain.items():
        for second, count in rows.items():
            assert buffer.look_up("map", name, second * S).position_m == (count, 0, 0)
        assert buffer.interval("map", name) == (min(rows) * S, max(rows) * S)


def test_nothing_is_extrapolated_unless_asked_and_the_error_says_what_is_known(buffer):
    for i in range(3):
        put(buffer, "map", "a", (i + 1) * S, Pose.from_yaw((i, 0, 0), 0.1 * i))
    put(buffer, "map", "single", S, Pose.at((1, 2, 3)))
    for time_ns, x_m in ((7 * S // 2, 2.5), (S // 2, -0.5)):
        with pytest.raises(
            ExtrapolationError, match="'a' is known from 1000000000 to 3000000000 ns"
        ):
            buffer.look_up("map", "a", time_ns, extrapolate_ns=S // 2 - 1)
        pose = buffer.look_up("map", "a", time_ns, extrapolate_ns=S // 2)
        assert pose.same_as(Pose.from_yaw((x_m, 0, 0), 0.1 * x_m), within_rad=1e-7)
        held = buffer.look_up("map", "single", time_ns, extrapolate_ns=3 * S)
        assert held.position_m == (1, 2, 3)


def test_the_latest_common_time_is_that_of_the_slowest_edge(buffer):
    for i in range(5):
        put(buffer, "map", "a", i * S, Pose.at((i, 0, 0)))
    for i in range(3):
        put(buffer, "a", "b", i * S + 1, Pose.at((0, i, 0)))
    assert buffer.interval("map", "b") == (1, 2 * S + 1)
    assert buffer.look_up("map", "b").position_m == pytest.approx((2.0, 2.0, 0.0), abs=1e-6)
    put(buffer, "b", "c", 9 * S)
    assert buffer.interval("map", "c") is None
    with pytest.raises(ExtrapolationError):
        buffer.look_up("map", "c")


def test_static_transforms_hold_at_all_times_and_the_last_parent_counts(buffer):
    for x_m in (1, 2):
        put(buffer, "base", "camera", 5 * S, Pose.at((x_m, 0, 0)), static=True)
        for time_ns in (-(2**62), 2**62, None):
            assert buffer.look_up("base", "camera", time_ns).position_m == (x_m, 0, 0)
    put(buffer, "map", "base", 0)
    put(buffer, "odom", "base", S, Pose.at((7, 0, 0)))
    assert buffer.look_up("odom", "base", S).position_m == (7, 0, 0)
    with pytest.raises(NotConnectedError, match=r"first is 'map', that of the other 'odom'"):
        buffer.look_up("map", "base", 0)


def test_unknown_frames_are_refused_with_similar_names_and_loops_leave_the_tree_as_it_was(buffer):
    put(buffer, "map", "agent_x/markers")
    with pytest.raises(UnknownFrameError, match="did you mean 'agent_x/markers'"):
        buffer.look_up("map", "agent_x_markers", 0)
    with pytest.raises(UnknownFrameError, match="2 frames are known"):
        buffer.parent_of("zzz")
    put(buffer, "a", "b", 0, Pose.at((1, 0, 0)))
    put(buffer, "b", "c", 0)
    with pytest.raises(FrameLoopError, match="a -> c -> b -> a"):
        put(buffer, "c", "a")
    with pytest.raises(FrameLoopError):
        put(buffer, "d", "d")
    assert buffer.look_up("a", "c", 0).position_m == (1, 0, 0)


# --- Lint --------------------------------------------------------------------------------------


def tree(*pairs, **options):
    return [Edge(parent=parent, child=child, **options) for parent, child in pairs]


def codes(edges, **options):
    return [finding.code for finding in lint_frames(edges, **options)]


GOOD = tree(("map", "go2/odom"), ("go2/odom", "go2/base"), ("go2/base", "go2/camera"))
AB = ("map", "a")
BEFORE = tree(AB, authority="1", first_ns=0, last_ns=100)


def later(first_ns):
    return tree(AB, authority="2", first_ns=first_ns, last_ns=200)


@pytest.mark.parametrize(
    ("edges", "found"),
    [
        (GOOD, []),
        ([*tree(AB, authority="1"), *tree(AB, authority="2")], ["two-publishers"]),
        ([*tree(AB), *tree(AB, static=True)], ["static-and-dynamic"]),
        ([*BEFORE, *later(101)], []),  # another publisher after a restart
        ([*BEFORE, *later(100)], ["two-publishers"]),
        (tree(("a", "b"), ("b", "c"), ("c", "a"), ("c", "d")), ["loop"]),
        ([*GOOD, *tree(("world", "go1/base"))], ["second-root"]),
        (tree(AB, backwards=1, back_ns=3), ["backwards"]),
        (tree(AB, contradicting=1), ["repeated"]),
        (tree(AB, contradicting=2, static=True), ["static-twice"]),
    ],
)
def test_each_error_of_a_tree_is_found_once(edges, found):
    assert codes(edges) == found


def test_a_finding_names_its_frames_and_its_consequence():
    edges = [*GOOD, *tree(("map", "go2/base"), ("world", "go1/base"))]
    parents, root = lint_frames(edges, root="map")
    assert (parents.code, parents.frames) == ("two-parents", ("go2/base", "go2/odom", "map"))
    assert "'go2/odom' and 'map' (a frame has one parent" in str(parents)
    assert (root.code, root.frames) == ("second-root", ("go1/base", "world"))
    assert codes(GOOD, root="earth") == ["unreachable"]


@pytest.mark.parametrize(
    ("edges", "found"),
    [
        (tree(("d", "d"), ("d", "e")), [("d",)]),
        (tree(("a", "b"), ("b", "c"), ("c", "a"), ("c", "d")), [("a", "b", "c")]),
        (tree(("a", "b"), ("b", "a"), ("c", "d"), ("d", "c"), ("b", "c")), [("a", "b"), ("c", "d")]),
    ],
)  # fmt: skip
def test_each_loop_is_found_once_and_named_from_child_to_parent(edges, found):
    loops = [one for one in lint_frames(edges) if one.code == "loop"]
    assert [one.frames for one in loops] == found
    pairs = {(edge.child, edge.parent) for edge in edges}
    for one in loops:
        way = one.what.removesuffix(", from child to parent").split(" -> ")
        assert set(pairwise(way)) <= pairs
        assert (way[0], len(way)) == (way[-1], len(one.frames) + 1)


def test_thousands_of_frames_are_judged_at_once():
    star = tree(*(("map", f"a{i}") for i in range(5000)))
    chain = tree(*((f"b{i}", f"b{i + 1}") for i in range(5000)))
    begin_s = time.process_time()
    assert codes([*star, *chain, *tree(("map", "b0"))], root="map") == []
    assert time.process_time() - begin_s < 1.0


def test_names_that_match_no_rule_are_found_and_a_rule_is_for_agents_with_sound_names():
    rule = FrameRule(agents=frozenset({"agent_x"}))
    edges = tree(("map", "agent_x_markers"), ("map", "agent_x/markers"))
    (finding,) = lint_frames(edges, rule=rule, root="map")
    assert (finding.code, finding.frames) == ("name", ("agent_x_markers",))
    assert "did you mean 'agent_x/markers'?" in finding.what
    with pytest.raises(FqnError):
        FrameRule(agents=frozenset({"Go 2"}))


def test_frames_have_their_agents_prefix_or_are_shared():
    allows = FrameRule(agents=frozenset({"go2"})).allows
    assert all(map(allows, ("map", "go2/base", "go2/a/b")))
    assert not any(map(allows, ("base", "go1/base", "go2/", "go2//a")))


def test_a_buffer_counts_what_the_lint_reports(buffer):
    for stamp_ns in (100, 200, 150, 300, 120):
        put(buffer, "map", "a", stamp_ns)
    (edge,) = buffer.edges
    assert (edge.count, edge.backwards, edge.back_ns, edge.last_ns) == (5, 2, 180, 120)
    for x_m in (0, 0, 1):
        put(buffer, "map", "b", 1, Pose.at((x_m, 0, 0)))
        put(buffer, "map", "c", x_m, Pose.at((x_m, 0, 0)), static=True)
    assert codes(buffer.edges) == ["backwards", "repeated", "static-twice"]
    put(buffer, "a", "b")
    with pytest.raises(FrameLoopError):
        put(buffer, "b", "a")
    assert {"two-parents", "loop"} <= set(codes(buffer.edges))


# --- Bus and logs ------------------------------------------------------------------------------


def message(*transforms):
    return message_type(TRANSFORMS)(transforms=[t.to_msg() for t in transforms])


def at_x(parent, child, second, x_m):
    return step(parent, child, second * S, Pose.at((x_m, 0, 0)))


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
        with pytest.raises(UnknownFrameError):
            await listener.wait_for("map", "go2/base", timeout_s=0.01)
        assert listener.taken == 3
    assert all(len(edge.authority) == 32 for edge in buffer.edges)
    assert lint_frames(buffer.edges, root="map") == ()


def broken(child="base", x_m=0.0, y_m=0.0, w=1.0):
    """Return the message of a transform with values that tf2 ignores."""
    made = message(step("odom", child, S))
    made.transforms[0].transform.translation.x = x_m
    made.transforms[0].transform.translation.y = y_m
    made.transforms[0].transform.rotation.w = w
    return made


POSITION = "its position is not finite"
LENGTH = "the length of its quaternion is not 1 within 0.5 %"


@pytest.mark.parametrize(
    ("first", "second", "why"),
    [
        ({"child": ""}, {"child": "", "x_m": 1.0}, "given ''"),
        ({"child": "/"}, {"child": "/", "x_m": 1.0}, "given ''"),
        ({"x_m": math.nan}, {"x_m": math.inf, "y_m": 1.0}, POSITION),
        ({"w": 0.0}, {"w": 3.0}, LENGTH),
        ({"w": math.nan}, {"w": math.nan, "y_m": 1.0}, LENGTH),
    ],
)
def test_transforms_that_tf2_ignores_are_one_finding_whatever_their_numbers(
    first, second, why, buffer, caplog
):
    intake = TransformIntake(buffer)
    with caplog.at_level(logging.WARNING):
        for values in (first, second):
            intake.take(broken(**values), static=False)
    assert (intake.taken, list(intake.refused.values())) == (0, [2])
    assert len(caplog.records) == 1
    (finding,) = lint_frames(buffer.edges, refused=intake.refused)
    assert finding.code == "refused"
    assert "(2x): " in finding.what
    assert why in finding.what


def test_a_broken_transform_leaves_the_others_and_nearly_normalised_ones_are_taken(buffer):
    intake = TransformIntake(buffer)
    intake.take(message(step("c", "c", S), at_x("map", "b", 1, 4.0)), static=False)
    intake.take(broken(w=1.0049), static=False)
    assert buffer.look_up("map", "b", S).position_m == (4, 0, 0)
    assert (intake.taken, intake.refused.total()) == (2, 1)
    assert codes(buffer.edges, root="map", refused=intake.refused) == ["loop", "second-root"]


def test_a_log_fills_a_buffer(tmp_path):
    with LogWriter(tmp_path / "run.mcap") as log:
        for second in (0, 100):
            log.write(TF, message(at_x("map", "base", second, second)), log_time_ns=second * S)
        log.write(TF_STATIC, message(at_x("base", "camera", 0, 0.5)), log_time_ns=50 * S)
    buffer = FrameBuffer(history_s=None)
    with LogReader(tmp_path / "run.mcap") as reader:
        assert fill_from_log(reader, buffer).taken == 3
    assert buffer.look_up("map", "camera", 10 * S).position_m == (10.5, 0, 0)
