"""Warnings of a plan, and where everybody is at a time."""

from __future__ import annotations

import math

import pytest

from sfglab.spatial import Pose
from sfglab.spatial.scene import AlignWaypoints, Editor, Retime, SceneError, SetProperty, SetScene
from sfglab.spatial.scene.conflicts import ConflictKind
from sfglab.spatial.trajectory import Align

S = 1_000_000_000


def driver(editor, name, *points, step_ns=10 * S, **values):
    """Add an agent and its trajectory; return both ids."""
    agent = editor.add("agent", name, **values)
    path = editor.add("trajectory", f"{name} path", agent=agent)
    for i, point in enumerate(points):
        editor.insert_waypoint(path, time_ns=i * step_ns, pose=Pose.at((*point, 0.0)))
    return agent, path


def only(editor):
    (found,) = editor.conflicts()
    return found


def test_two_agents_that_meet_are_reported_with_time_place_and_clearance():
    editor = Editor()
    a, _ = driver(editor, "a", (-5, 0), (5, 0), radius_m=0.3)
    b, _ = driver(editor, "b", (0, -5), (0, 5), radius_m=0.4)
    found = only(editor)
    assert (found.kind, found.objects) == (ConflictKind.AGENTS, (a, b))
    assert found.time_s == pytest.approx(5.0)
    assert found.position_m == pytest.approx((0.0, 0.0, 0.0))
    assert found.text == "a and b overlap by 0.700 m at 5.000 s; allowed: 0.1 m"


def test_the_margin_counts_beyond_the_radii():
    editor = Editor()
    driver(editor, "a", (-5, 0), (5, 0), radius_m=0.3)
    driver(editor, "b", (-5, 1), (5, 1), radius_m=0.3)
    assert editor.conflicts() == ()
    editor.do(SetScene(key="margin_m", value=0.5))
    assert only(editor).text.startswith("a and b are 0.400 m apart")


def test_agents_in_groups_meet_where_the_groups_put_them():
    editor = Editor()
    driver(editor, "a", (-5, 0), (5, 0))
    group = editor.add("group", "there", pose=Pose.at((0.0, 5.0, 0.0)))
    editor.add("agent", "b", parent=group, pose=Pose.at((0.0, -5.0, 0.0)))
    assert only(editor).kind is ConflictKind.AGENTS


def test_one_who_stands_in_the_way_after_its_trajectory_is_hit():
    editor = Editor()
    driver(editor, "early", (0, 5), (0, 0), step_ns=S)
    _, late = driver(editor, "late", (-5, 0), (5, 0))
    found = only(editor)
    assert found.time_s == pytest.approx(5.0)
    editor.remove(late)
    assert only(editor).kind is ConflictKind.AGENTS  # both stand at the origin now


def test_an_agent_that_cuts_a_corner_into_a_turned_box_is_reported():
    editor = Editor()
    driver(editor, "a", (-5, 1.5), (5, 1.5), radius_m=0.3)
    box = editor.add("obstacle", "crate", shape={"kind": "box", "size_m": [2, 2, 2]})
    assert editor.conflicts() == ()
    editor.place(box, Pose.from_yaw((0.0, 0.0, 0.0), math.pi / 4))
    found = only(editor)
    assert found.kind is ConflictKind.OBSTACLE
    assert found.text == "a is 0.214 m inside crate at 5.000 s"


def test_forbidden_zones_are_for_agents_and_inside_zones_for_waypoints():
    editor = Editor()
    agent, path = driver(editor, "a", (0, 0), (4, 0))
    zone = editor.add("zone", "lab", shape={"kind": "box", "size_m": [4, 4, 4]}, rule="inside")
    found = only(editor)
    last = editor.scene.held_by(path)[-1]
    assert (found.kind, found.objects) == (ConflictKind.OUTSIDE, (path, last))
    assert found.text == f"a path: waypoint {last} lies 2.000 m outside of lab"
    editor.add("zone", "annex", shape={"kind": "sphere", "radius_m": 1}, rule="inside", pose=Pose.at((4, 0, 0)))
    assert editor.conflicts() == ()
    editor.do(SetProperty(id=zone, key="rule", value="forbidden"))
    kinds = {c.kind: c for c in editor.conflicts()}
    assert kinds[ConflictKind.ZONE].objects == (agent, zone)


def test_limits_of_the_agent_are_checked_segment_by_segment():
    editor = Editor()
    agent, path = driver(editor, "a", (0, 0), (1, 0), (9, 0), step_ns=S, speed_m_s=2.0)
    found = only(editor)
    assert found.objects == (agent, path, editor.scene.held_by(path)[1])
    assert found.text == "a: speed_m_s 8.000 at 1.000 s; allowed: 2"
    editor.do(Retime(id=path))
    assert editor.conflicts() == ()


def test_loose_ends_are_warned_of():
    editor = Editor()
    path = editor.add("trajectory", "path")
    assert [c.kind for c in editor.conflicts()] == [ConflictKind.NO_AGENT, ConflictKind.NO_WAYPOINTS]
    agent = editor.add("agent", "a")
    editor.do(SetProperty(id=path, key="agent", value=agent))
    editor.insert_waypoint(path)
    assert editor.conflicts() == ()


def test_a_spline_swings_out_of_a_lane_that_its_polyline_keeps():
    editor = Editor()
    _, path = driver(editor, "a", (0, 0), (4, 0), (4, 4), (8, 4), radius_m=0.1)
    editor.add(
        "obstacle", "wall", shape={"kind": "box", "size_m": [8, 0.2, 2]}, pose=Pose.at((0.0, -0.25, 0.0))
    )
    assert editor.conflicts() == ()
    editor.do(SetProperty(id=path, key="interpolation", value="catmull_rom"))
    assert only(editor).kind is ConflictKind.OBSTACLE


def test_ghosts_stand_drive_and_stand_again():
    editor = Editor()
    moving, path = driver(editor, "a", (0, 0), (4, 0), step_ns=2 * S)
    editor.do(AlignWaypoints(id=path, align=Align.NEXT))
    standing = editor.add("agent", "b", pose=Pose.at((0.0, 3.0, 0.0)))
    seen = []
    for time_s in (-1.0, 1.0, 9.0):
        editor.set_time(time_s)
        seen.append(editor.ghosts())
    assert [[g.agent for g in moment] for moment in seen] == [[moving, standing]] * 3
    assert [moment[0].pose.position_m[0] for moment in seen] == pytest.approx([0.0, 2.0, 4.0])
    assert [moment[0].speed_m_s for moment in seen] == pytest.approx([0.0, 2.0, 0.0])
    assert [moment[0].driving for moment in seen] == [False, True, False]
    assert seen[1][1].pose.position_m == (0.0, 3.0, 0.0)


def test_a_time_that_is_none_is_refused():
    with pytest.raises(SceneError, match="a finite number of seconds"):
        Editor().set_time(math.nan)
