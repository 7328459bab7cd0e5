"""Frames: look-up along chains and times, the lint of trees, transforms from the bus and from logs."""

import asyncio
import logging

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from matplotlib.figure import Figure

from sfglab.errors import InvalidValueError
from sfglab.messages import message_type
from sfglab.names import TF, TF_STATIC, FqnError
from sfglab.record import LogError, LogReader, LogWriter
from sfglab.spatial import Pose, StampedTransform
from sfglab.spatial.frames.buffer import (
    Edge,
    ExtrapolationError,
    FrameBuffer,
    FrameLoopError,
    NotConnectedError,
    UnknownFrameError,
)
from sfglab.spatial.frames.kernel import Insertion
from sfglab.spatial.frames.lint import FrameRule, draw_tree, lint_frames, tree_layout
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


def put(buffer, parent, child, stamp_ns=0, pose=None, **options):
    transform = StampedTransform(parent=parent, child=child, stamp_ns=stamp_ns, pose=pose or Pose())
    return buffer.insert(transform, **options)


def random_pose(rng):
    return Pose.at(rng.normal(size=3), rng.normal(size=4))


def test_a_known_chain_has_known_numbers(buffer):
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
        from_root.append(
            from_root[parent] @ (rows[0] if static else rows[0].interpolate(rows[1], 0.25))
        )
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
        new = Insertion.OUT_OF_ORDER if second < newest else Insertion.APPENDED
        assert told is (Insertion.REPLACED if second in rows else new)
        rows[second] = count
        plain[name] = {s: c for s, c in rows.items() if s >= max(rows) - 10}
    for name, rows in plain.items():
        for second, count in rows.items():
            assert buffer.look_up("map", name, second * S).position_m == (count, 0, 0)
        if rows:
            assert buffer.interval("map", name) == (min(rows) * S, max(rows) * S)


def test_memory_stays_bounded_and_clearing_forgets_transforms_but_not_the_tree():
    buffer = FrameBuffer(history_s=1.0)
    for i in range(20_000):
        put(buffer, "map", "a", i * S // 100)
    assert len(buffer._history.stamps) < 1000
    assert buffer.interval("map", "a") == (19_899 * S // 100, 19_999 * S // 100)
    buffer = FrameBuffer()
    put(buffer, "map", "a", 5 * S)
    buffer.clear()
    with pytest.raises(ExtrapolationError, match="known never"):
        buffer.look_up("map", "a", 5 * S)
    assert put(buffer, "map", "a", S) is Insertion.APPENDED


def test_nothing_is_extrapolated_unless_asked_and_the_error_says_what_is_known(buffer):
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
    assert buffer.look_up("map", "a", S // 2, extrapolate_ns=S).same_as(
        Pose.from_yaw((-0.5, 0, 0), -0.05)
    )
    put(buffer, "map", "single", S, Pose.at((1, 2, 3)))  # which is held
    assert buffer.look_up("map", "single", 2 * S, extrapolate_ns=S).position_m == (1, 2, 3)


def test_the_latest_common_time_is_the_slowest_edges_and_without_one_the_error_says_so(buffer):
    for i in range(5):
        put(buffer, "map", "a", i * S, Pose.at((i, 0, 0)))
    for i in range(3):
        put(buffer, "a", "b", i * S + 1, Pose.at((0, i, 0)))
    assert buffer.interval("map", "b") == (1, 2 * S + 1)
    assert buffer.look_up("map", "b").position_m == pytest.approx((2.0, 2.0, 0.0), abs=1e-6)
    buffer = FrameBuffer()
    put(buffer, "map", "a", S)
    put(buffer, "a", "b", 2 * S)
    assert buffer.interval("map", "b") is None
    with pytest.raises(ExtrapolationError):
        buffer.look_up("map", "b")


def test_static_transforms_hold_at_all_times_and_the_last_parent_counts(buffer):
    put(buffer, "base", "camera", 5 * S, Pose.at((1, 0, 0)), static=True)
    for time_ns in (-(2**62), 0, 2**62, None):
        assert buffer.look_up("base", "camera", time_ns).position_m == (1, 0, 0)
    assert put(buffer, "base", "camera", S, Pose.at((2, 0, 0)), static=True) is Insertion.REPLACED
    assert buffer.look_up("base", "camera", 0).position_m == (2, 0, 0)
    buffer = FrameBuffer()
    put(buffer, "map", "a", 0)
    put(buffer, "odom", "a", S, Pose.at((7, 0, 0)))
    assert buffer.look_up("odom", "a", S).position_m == (7, 0, 0)
    with pytest.raises(NotConnectedError, match=r"the root 'map', the other one below 'odom'"):
        buffer.look_up("map", "a", 0)


def test_unknown_frames_are_refused_with_similar_names_and_loops_leave_the_tree_as_it_was(buffer):
    put(buffer, "map", "agent_x/markers")
    with pytest.raises(UnknownFrameError, match="did you mean 'agent_x/markers'"):
        buffer.look_up("map", "agent_x_markers", 0)
    with pytest.raises(UnknownFrameError, match="2 frames are known"):
        buffer.root_of("zzz")
    buffer = FrameBuffer()
    put(buffer, "a", "b", 0, Pose.at((1, 0, 0)))
    put(buffer, "b", "c", 0)
    with pytest.raises(FrameLoopError, match="a -> c -> b -> a"):
        put(buffer, "c", "a")
    with pytest.raises(FrameLoopError):
        put(buffer, "d", "d")
    assert buffer.look_up("a", "c", 0).position_m == (1, 0, 0)


def test_frames_without_a_sound_name_and_a_history_of_no_time_are_refused():
    for name in ("", " base"):
        with pytest.raises(InvalidValueError):
            put(FrameBuffer(), "map", name)
    for history_s in (0, -1.0, float("nan")):
        with pytest.raises(InvalidValueError, match="history_s"):
            FrameBuffer(history_s=history_s)


def tree(*pairs, **options):
    return [Edge(parent=parent, child=child, **options) for parent, child in pairs]


def codes(edges, **options):
    return [finding.code for finding in lint_frames(edges, **options)]


GOOD = tree(("map", "go2/odom"), ("go2/odom", "go2/base"), ("go2/base", "go2/camera"))


def test_a_good_tree_has_no_findings_and_two_parents_are_found():
    assert codes(GOOD, rule=FrameRule(agents=frozenset({"go2"})), root="map") == []
    assert codes([]) == []
    (finding,) = lint_frames([*GOOD, *tree(("map", "go2/base"))])
    assert (finding.code, finding.frames) == ("two-parents", ("go2/base", "go2/odom", "map"))
    assert "'go2/odom' and 'map'" in str(finding)


def test_two_publishers_and_two_kinds_of_an_edge_are_found_but_no_takeover_after_a_restart():
    assert codes([*tree(("map", "a"), authority="1"), *tree(("map", "a"), authority="2")]) == [
        "two-publishers"
    ]
    assert codes([*tree(("map", "a")), *tree(("map", "a"), static=True)]) == ["static-and-dynamic"]
    before = tree(("map", "a"), authority="1", first_ns=0, last_ns=100)
    assert codes([*before, *tree(("map", "a"), authority="2", first_ns=101, last_ns=200)]) == []
    assert codes([*before, *tree(("map", "a"), authority="2", first_ns=100, last_ns=200)]) == [
        "two-publishers"
    ]


def test_each_loop_is_told_once_and_a_second_root_with_what_hangs_below_it():
    findings = lint_frames(tree(("a", "b"), ("b", "c"), ("c", "a"), ("c", "d")))
    assert [f.code for f in findings] == ["loop"]
    assert findings[0].frames == ("a", "c", "b")
    assert codes(tree(("a", "a"))) == ["loop"]
    edges = [*GOOD, *tree(("world", "go1/base"))]
    assert codes(edges) == ["second-root"]
    (finding,) = lint_frames(edges, root="map")
    assert (finding.code, finding.frames) == ("second-root", ("world", "go1/base"))
    (finding,) = lint_frames(GOOD, root="earth")
    assert finding.code == "unreachable"


def test_names_that_match_no_rule_are_found_and_a_rule_is_for_agents_with_sound_names():
    rule = FrameRule(agents=frozenset({"agent_x"}))
    edges = tree(("world", "agent_x_markers"), ("agent_x/base", "agent_x/markers"))
    findings = [f for f in lint_frames(edges, rule=rule) if f.code == "name"]
    assert [f.frames for f in findings] == [("agent_x_markers",)]
    assert "did you mean 'agent_x/markers'?" in findings[0].what
    with pytest.raises(FqnError):
        FrameRule(agents=frozenset({"Go 2"}))


@pytest.mark.parametrize(
    ("frame", "fits"),
    [
        *((frame, True) for frame in ("map", "go2/base", "go2/a/b")),
        *((frame, False) for frame in ("base", "go1/base", "go2/")),
    ],
)
def test_frames_are_called_after_their_agent_or_shared(frame, fits):
    assert (FrameRule(agents=frozenset({"go2"})).problem(frame) is None) == fits


def test_time_that_runs_backwards_and_what_a_buffer_refused_are_found(buffer):
    for stamp_ns in (100, 200, 150, 300, 120):
        put(buffer, "map", "a", stamp_ns)
    (edge,) = buffer.edges
    assert (edge.count, edge.backwards, edge.back_ns, edge.last_ns) == (5, 2, 180, 120)
    assert codes(buffer.edges) == ["backwards"]
    buffer = FrameBuffer()
    for parent in "ac":
        put(buffer, parent, "b")
    with pytest.raises(FrameLoopError):
        put(buffer, "b", "c")
    assert set(codes(buffer.edges)) == {"two-parents", "loop"}


def test_a_layout_has_roots_above_children_and_no_two_frames_in_one_place():
    edges = [*GOOD, *tree(("map", "go2/base"), ("world", "go1/base"), ("a", "b"), ("b", "a"))]
    places = tree_layout(edges)
    assert set(places) == {name for e in edges for name in (e.parent, e.child)}
    assert len(set(places.values())) == len(places)
    assert places["map"][1] == places["world"][1] == 0
    assert places["go2/camera"][1] == -3
    assert tree_layout([]) == {}


def test_a_drawn_tree_shows_every_frame_and_marks_those_of_findings():
    ax = Figure().subplots()
    edges = [*GOOD, *tree(("world", "go1/base"), authority="mocap")]
    draw_tree(ax, edges, findings=lint_frames(edges, root="map"), outside="mocap")
    boxes = {
        text.get_text().replace("\n", ""): text.get_bbox_patch()
        for text in ax.texts
        if text.get_text()
    }
    assert set(boxes) == {"map", "go2/odom", "go2/base", "go2/camera", "world", "go1/base"}
    assert {name for name, box in boxes.items() if box.get_linewidth() > 1.5} == {
        "world",
        "go1/base",
    }


def message(*transforms):
    return message_type(TRANSFORMS)(transforms=[t.to_msg() for t in transforms])


def step(parent, child, second, x_m):
    return StampedTransform(
        parent=parent, child=child, stamp_ns=second * S, pose=Pose.at((x_m, 0, 0))
    )


async def test_a_listener_hears_static_transforms_of_before_and_waits_for_those_to_come(
    here, there, buffer
):
    fixed = here.create_publisher(TRANSFORMS, TF_STATIC, TF_STATIC_QOS)
    fixed.publish(message(step("base", "camera", 0, 1.0)))
    moving = here.create_publisher(TRANSFORMS, TF, TF_QOS)
    async with FramesListener(there, buffer, agent="go2") as listener:
        await moving.wait_for_subscriptions()
        waiting = asyncio.create_task(
            listener.wait_for("map", "go2/camera", 3 * S // 2, timeout_s=10)
        )
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


def test_a_broken_transform_is_counted_and_said_once_while_the_rest_goes_on(caplog, buffer):
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


def test_a_log_fills_a_buffer_with_all_that_it_has_and_one_without_transforms_is_refused(tmp_path):
    with LogWriter(tmp_path / "run.mcap") as log:
        for second in range(100):
            log.write(
                TF, message(step("map", "base", second, float(second))), log_time_ns=second * S
            )
        log.write(TF_STATIC, message(step("base", "camera", 0, 0.5)), log_time_ns=50 * S)
    buffer = FrameBuffer(history_s=None)
    with LogReader(tmp_path / "run.mcap") as reader:
        intake = fill_from_log(reader, buffer)
    assert intake.taken == {"appended": 101}
    assert buffer.look_up("map", "camera", 10 * S + S // 2).position_m == (11.0, 0, 0)
    with LogWriter(tmp_path / "text.mcap") as log:
        log.write("/text", message_type("std_msgs/msg/String")(data="x"), log_time_ns=0)
    with LogReader(tmp_path / "text.mcap") as reader, pytest.raises(LogError, match="/tf"):
        fill_from_log(reader, FrameBuffer())
