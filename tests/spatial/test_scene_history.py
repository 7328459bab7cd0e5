"""Edits, undo and redo in known cases; the experiment `planning` tries any sequence of edits."""

import math

import numpy as np
import pytest

from sfglab.lab.experiments.planning.facts import edited
from sfglab.spatial import Pose
from sfglab.spatial.scene.editor import ChangeKind, Editor
from sfglab.spatial.scene.model import Box, SceneError, TrajectoryObject
from sfglab.spatial.trajectory.path import Align

S = 1_000_000_000


@pytest.mark.parametrize("seed", range(10))
def test_after_any_edits_whoever_is_held_knows_by_whom_and_waypoints_go_by_time(seed):
    editor, _ = edited(np.random.default_rng(seed))
    scene = editor.scene
    assert {thing.id for thing in scene.walk()} == scene.objects.keys()
    assert all(
        scene.objects[i].parent == holder for holder, held in scene.children.items() for i in held
    )
    assert max(scene.objects, default=0) < scene.next_id
    for path in scene.all_of(TrajectoryObject):
        times = [scene.objects[i].time_ns for i in scene.held_by(path.id)]
        assert times == sorted(set(times))


def refusal(edit, *given, **more):
    with pytest.raises(SceneError) as caught:
        edit(*given, **more)
    return str(caught.value)


@pytest.fixture
def planned():
    """Return an editor with a hall that holds an agent, and the agent's trajectory of three waypoints."""
    editor = Editor()
    hall = editor.add("group", "hall", pose=Pose.at((10.0, 0.0, 0.0)))
    agent = editor.add("agent", "go2", parent=hall)
    path = editor.add("trajectory", "path", agent=agent)
    points = [editor.insert_waypoint(path, pose=Pose.at((float(i), 0.0, 0.0))) for i in range(3)]
    return editor, hall, agent, path, points


def test_undo_after_removing_a_subtree_restores_ids_order_and_references(planned):
    editor, hall, agent, path, _ = planned
    editor.add("obstacle", "pillar", parent=hall)
    before = editor.scene
    editor.remove(hall)
    assert editor.scene.get(path).agent is None, "the trajectory stays, without its agent"
    assert hall not in editor.scene.objects
    assert editor.undo()
    assert editor.scene == before
    assert editor.scene.driven_by(agent).id == path
    editor.rename(agent, "spot")  # what was restored can be edited
    assert editor.redo_label is None


def test_an_edit_that_changes_nothing_leaves_no_step_and_keeps_redo(planned):
    editor, _, agent, _, _ = planned
    editor.rename(agent, "spot")
    editor.undo()
    assert not editor.rename(agent, "go2")
    assert editor.redo()


def test_a_drag_is_one_step_and_two_drags_are_two(planned):
    editor, _, _, _, points = planned
    before = editor.scene
    for start in (0.0, 5.0):
        editor.begin_drag()
        for i in range(10):
            editor.set_pose(points[1], Pose.at((1.0, start + i, 0.0)))
        editor.end_drag()
    editor.undo()
    assert editor.scene.get(points[1]).pose.position_m == (1.0, 9.0, 0.0)
    editor.undo()
    assert editor.scene == before


def test_a_drag_back_to_where_it_began_leaves_no_step(planned):
    editor, _, _, _, points = planned
    label, home = editor.undo_label, editor.scene.get(points[1]).pose
    editor.begin_drag()
    for y in (1.0, 2.0):
        editor.set_pose(points[1], Pose.at((1.0, y, 0.0)))
        editor.set_pose(points[1], home)
        assert editor.undo_label == label


def test_undo_in_the_middle_of_a_drag_takes_the_drag_back_and_ends_it(planned):
    editor, _, _, _, points = planned
    before = editor.scene
    editor.begin_drag()
    editor.set_pose(points[1], Pose.at((1.0, 1.0, 0.0)))
    editor.undo()
    assert editor.scene == before
    editor.set_pose(points[1], Pose.at((1.0, 2.0, 0.0)))
    editor.set_pose(points[1], Pose.at((1.0, 3.0, 0.0)))
    editor.undo()
    assert editor.scene.get(points[1]).pose.position_m == (1.0, 2.0, 0.0)


def test_the_oldest_steps_are_forgotten_first():
    editor = Editor()
    for number in range(1002):
        editor.set_scene("name", f"scene {number}")
    while editor.undo():
        pass
    assert editor.scene.name == "scene 1"


def test_moving_under_another_parent_keeps_the_place_in_the_scene(planned):
    editor, hall, _, path, points = planned
    before = editor.scene.world_pose(points[2])
    editor.move(path, hall)
    assert editor.scene.get(path).pose.position_m == pytest.approx((-10.0, 0.0, 0.0))
    assert editor.scene.world_pose(points[2]).same_as(before)
    assert editor.scene.held_by(hall)[-1] == path


def test_aligned_waypoints_keep_looking_along_their_segments_while_a_neighbour_is_dragged(planned):
    editor, _, _, path, points = planned
    editor.align(path, Align.NEXT)
    editor.set_pose(points[1], Pose.from_yaw((0.0, 1.0, 0.0), 0.3))
    yaws = [editor.scene.get(i).pose.yaw_rad for i in points]
    assert yaws == pytest.approx([math.pi / 2, math.atan2(-1, 2), math.atan2(-1, 2)])


def test_a_time_beyond_a_neighbours_changes_their_order(planned):
    editor, _, _, path, (first, second, third) = planned
    editor.set_waypoint_time(first, 90 * S)
    assert editor.scene.held_by(path) == (second, third, first)


def test_a_waypoint_without_pose_is_inserted_on_the_path(planned):
    editor, _, _, path, _ = planned
    before = editor.scene.world_trajectory(path)
    new = editor.insert_waypoint(path, time_ns=3 * S // 2)
    assert editor.scene.get(new).pose.position_m == pytest.approx((1.5, 0.0, 0.0))
    assert editor.scene.held_by(path).index(new) == 2
    assert editor.scene.world_trajectory(path).end_ns == before.end_ns


def test_a_copy_of_a_group_drives_its_own_agent(planned):
    editor, hall, agent, path, _ = planned
    editor.move(path, hall)
    copy = editor.duplicate(hall)
    new_agent, new_path = editor.scene.held_by(copy)
    assert editor.scene.get(new_path).agent == new_agent != agent
    assert len(editor.scene.held_by(new_path)) == 3
    assert editor.scene.held_by() == (hall, copy)
    assert "a time of its own" in refusal(editor.duplicate, editor.scene.held_by(new_path)[0])


def test_a_trajectory_from_elsewhere_is_added_in_one_step(planned):
    editor, _, agent, path, _ = planned
    imported = editor.scene.trajectory(path)
    before = editor.scene
    new = editor.add_trajectory(imported, "imported")
    assert editor.scene.trajectory(new) == imported
    editor.undo()
    assert editor.scene == before
    with pytest.raises(SceneError, match="follows"):
        editor.add_trajectory(imported, "imported", agent=agent)
    assert editor.scene is before


def test_refusals_name_place_given_and_allowed_and_change_nothing(planned):
    editor, hall, agent, path, points = planned
    inner = editor.add("group", "corner", parent=hall)
    other = editor.add("trajectory", "other")
    before, label = editor.scene, editor.undo_label

    assert refusal(editor.move, hall, inner) == (
        f"group {inner} (corner), parent: given 'a loop, {inner} in {hall} in {inner}', "
        "allowed: a tree"
    )
    assert refusal(editor.set_waypoint_time, points[0], S) == (
        f"waypoint {points[1]}, time_ns: given {S}, "
        f"allowed: a time of its own; waypoint {points[0]} has this one"
    )
    assert refusal(editor.set_property, agent, "radius_m", -1) == (
        f"agent {agent} (go2), radius_m: given -1, allowed: a number above zero"
    )
    assert "radius_m, speed_m_s" in refusal(editor.set_property, agent, "colour", "red")
    assert "an agent in the scene, or none" in refusal(editor.set_property, path, "agent", path)
    assert f"follows {path}" in refusal(editor.set_property, other, "agent", agent)
    assert "the id of a trajectory" in refusal(editor.move, points[0], hall)
    assert "the id of a group" in refusal(editor.move, inner, agent)
    far = Pose.at((1e7, 0.0, 0.0))
    assert "from -1000000 to 1000000" in refusal(editor.set_pose, agent, far)
    assert "the id of a trajectory" in refusal(editor.align, agent, Align.NEXT)
    assert "the id of an object in the scene" in refusal(editor.remove, 999)
    assert "printable" in refusal(editor.rename, agent, "two\nlines")
    for id_, key, value in (
        (agent, "radius_m", math.nan),
        (agent, "radius_m", "wide"),
        (agent, "yaw_rate_rad_s", math.inf),
        (path, "agent", 99),
    ):
        assert "allowed" in refusal(editor.set_property, id_, key, value)
    assert "box or sphere or cylinder" in refusal(
        editor.add, "obstacle", "pillar", shape={"kind": "cone"}
    )
    for shape in ({"kind": "cylinder", "radius_m": 1.0}, 7, Box(size_m=(1.0, 0.0, 1.0))):
        assert "shape" in refusal(editor.add, "obstacle", "pillar", shape=shape)
    assert "frame_id, margin_m, name" in refusal(editor.set_scene, "size", 1)
    assert (editor.scene, editor.undo_label) == (before, label)


def test_listeners_hear_what_changed_and_then_no_more(planned):
    editor, _hall, agent, path, points = planned
    heard = []
    end = editor.listen(heard.append)
    editor.rename(agent, "spot")
    new = editor.insert_waypoint(path)
    editor.remove(points[0], points[1])
    editor.undo()
    editor.redo()
    assert [c.kind for c in heard] == [*[ChangeKind.EDIT] * 3, ChangeKind.UNDO, ChangeKind.REDO]
    assert (heard[0].changed, heard[0].label) == ((agent,), "Rename")
    assert (heard[1].added, heard[1].changed) == ((new,), (path,))
    assert heard[2].removed == heard[3].added == (points[0], points[1])
    end()
    editor.undo()
    assert len(heard) == 5


def test_what_is_removed_is_not_selected_any_more(planned):
    editor, hall, agent, path, _ = planned
    heard = []
    editor.select(agent, path, agent)
    editor.listen(heard.append)
    editor.select(agent, path)
    assert heard == []
    editor.remove(hall)
    assert editor.selection == (path,)
    editor.remove()
    assert editor.selection == ()
    with pytest.raises(SceneError):
        editor.select(agent)


def test_a_gizmo_in_the_scenes_frame_moves_what_lies_in_a_group(planned):
    editor, _, agent, _, _ = planned
    editor.place(agent, Pose.at((11.0, 2.0, 0.0)))
    assert editor.scene.get(agent).pose.position_m == pytest.approx((1.0, 2.0, 0.0))
