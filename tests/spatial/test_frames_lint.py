"""The lint of frame trees, and the names that frames may have."""

from __future__ import annotations

import pytest
from matplotlib.figure import Figure

from sfglab.names import FqnError
from sfglab.spatial import Pose, StampedTransform
from sfglab.spatial.frames import Edge, FrameBuffer, FrameRule, draw_tree, lint_frames
from sfglab.spatial.frames.buffer import FrameLoopError
from sfglab.spatial.frames.lint import roots_of, tree_layout


def tree(*pairs, **options):
    return [Edge(parent=parent, child=child, **options) for parent, child in pairs]


def codes(edges, **options):
    return [finding.code for finding in lint_frames(edges, **options)]


GOOD = tree(("map", "go2/odom"), ("go2/odom", "go2/base"), ("go2/base", "go2/camera"))


def test_a_good_tree_has_no_findings():
    rule = FrameRule(agents=frozenset({"go2"}))
    assert codes(GOOD, rule=rule, root="map") == []
    assert roots_of(GOOD) == ("map",)
    assert codes([]) == []


def test_two_parents_are_found_though_a_buffer_keeps_only_the_last():
    (finding,) = lint_frames([*GOOD, *tree(("map", "go2/base"))])
    assert (finding.code, finding.frames) == ("two-parents", ("go2/base", "go2/odom", "map"))
    assert "'go2/odom' and 'map'" in str(finding)


def test_two_publishers_and_two_kinds_of_one_edge_are_found():
    assert codes([*tree(("map", "a"), authority="1"), *tree(("map", "a"), authority="2")]) == ["two-publishers"]
    assert codes([*tree(("map", "a")), *tree(("map", "a"), static=True)]) == ["static-and-dynamic"]


def test_a_publisher_that_took_over_after_a_restart_is_no_finding():
    before = tree(("map", "a"), authority="1", first_ns=0, last_ns=100)
    assert codes([*before, *tree(("map", "a"), authority="2", first_ns=101, last_ns=200)]) == []
    assert codes([*before, *tree(("map", "a"), authority="2", first_ns=100, last_ns=200)]) == ["two-publishers"]


def test_each_loop_is_told_once_and_with_its_way():
    findings = lint_frames(tree(("a", "b"), ("b", "c"), ("c", "a"), ("c", "d")))
    assert [f.code for f in findings] == ["loop"]
    assert findings[0].frames == ("a", "c", "b")
    assert codes(tree(("a", "a"))) == ["loop"]


def test_a_second_root_is_found_and_what_hangs_below_it():
    edges = [*GOOD, *tree(("world", "go1/base"))]
    assert codes(edges) == ["second-root"]
    (finding,) = lint_frames(edges, root="map")
    assert (finding.code, finding.frames) == ("second-root", ("world", "go1/base"))
    (finding,) = lint_frames(GOOD, root="earth")
    assert finding.code == "unreachable"


def test_names_that_match_no_rule_are_found_with_what_was_meant():
    rule = FrameRule(agents=frozenset({"agent_x"}))
    edges = tree(("world", "agent_x_markers"), ("agent_x/base", "agent_x/markers"))
    findings = [f for f in lint_frames(edges, rule=rule) if f.code == "name"]
    assert [f.frames for f in findings] == [("agent_x_markers",)]
    assert "did you mean 'agent_x/markers'?" in findings[0].what


@pytest.mark.parametrize(
    ("frame", "fits"),
    [
        ("map", True),
        ("go2/base", True),
        ("go2/a/b", True),
        ("base", False),
        ("go1/base", False),
        ("go2/", False),
    ],
)
def test_frames_are_called_after_their_agent_or_shared(frame, fits):
    assert (FrameRule(agents=frozenset({"go2"})).problem(frame) is None) == fits


def test_a_rule_is_for_agents_with_sound_names():
    with pytest.raises(FqnError):
        FrameRule(agents=frozenset({"Go 2"}))


def test_time_that_runs_backwards_is_found_with_the_size_of_the_step():
    buffer = FrameBuffer()
    for stamp_ns in (100, 200, 150, 300, 120):
        buffer.insert(StampedTransform(parent="map", child="a", stamp_ns=stamp_ns, pose=Pose()))
    (edge,) = buffer.edges
    assert (edge.count, edge.backwards, edge.back_ns, edge.last_ns) == (5, 2, 180, 120)
    assert codes(buffer.edges) == ["backwards"]
    assert codes(buffer.edges, slack_ns=180) == []


def test_a_buffer_remembers_what_it_refused_and_what_gave_way():
    buffer = FrameBuffer()
    for parent, child in (("a", "b"), ("c", "b"), ("b", "c")):
        transform = StampedTransform(parent=parent, child=child, stamp_ns=0, pose=Pose())
        if (parent, child) == ("b", "c"):
            with pytest.raises(FrameLoopError):
                buffer.insert(transform)
        else:
            buffer.insert(transform)
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
    figure = Figure()
    ax = figure.subplots()
    edges = [*GOOD, *tree(("world", "go1/base"), authority="mocap")]
    draw_tree(ax, edges, findings=lint_frames(edges, root="map"), outside="mocap")
    boxes = {text.get_text().replace("\n", ""): text.get_bbox_patch() for text in ax.texts if text.get_text()}
    assert set(boxes) == {"map", "go2/odom", "go2/base", "go2/camera", "world", "go1/base"}
    marked = {name for name, box in boxes.items() if box.get_linewidth() > 1.5}
    assert marked == {"world", "go1/base"}
