"""Edits, undo and redo in known cases; the experiment `planning` tries any sequence of edits."""

import math
from types import SimpleNamespace

import numpy as np
import pytest

from sfglab.lab.experiments.planning.facts import edited
from sfglab.spatial import Pose
from sfglab.spatial.scene.editor import ChangeKind, Editor
from sfglab.spatial.scene.model import Box, SceneError, TrajectoryObject
from sfglab.spatial.trajectory.path import Align

S = 1_000_000_000


@pytest.mark.parametrize("seed", range(5))
def test_after_any_edits_holders_and_held_agree_and_waypoints_are_in_order_of_time(seed):
    scene = edited(np.random.default_rng(seed))[0].scene
    assert {thing.id for thing in scene.walk()} == scene.objects.keys()
    for holder, held in scene.children.items():
        assert {scene.objects[i].parent for i in held} == {holder}
    assert max(scene.objects, default=0) < scene.next_id
    for path in scene.all_of(TrajectoryObject):
        times = [waypoint.time_ns for waypoint in scene.waypoints(path.id)]
        assert times == sorted(set(times))


def refusal(edit, *given, **more):
    with pytest.raises(SceneError) as caught:
        edit(*given, **more)
    return str(caught.value)


@pytest.fixture
def editor():
    return Editor()


@pytest.fixture
def ids(editor):
    """Ids of a hall that holds an agent, and of the agent's trajectory with its three waypoints."""
    hall = editor.add("group", "hall", pose=Pose.at((10.0, 0.0, 0.0)))
    agent = editor.add("agent", "go2", parent=hall)
    path = editor.add("trajectory", "path", agent=agent)
    points = [editor.insert_waypoint(path, pose=Pose.at((float(i), 0.0, 0.0))) for i in range(3)]
    return SimpleNamespace(hall=hall, agent=agent, path=path, points=points)


def put(editor, id_, *position):
    editor.set_pose(id_, Pose.at(position))


def test_undo_after_removing_a_subtree_restores_ids_order_and_references(editor, ids):
    editor.add("obstacle", "pillar", parent=ids.hall)
    before = editor.scene
    editor.remove(ids.hall)
    assert editor.scene.get(ids.path).agent is None, "the trajectory stays, without its agent"
    assert ids.hall not in editor.scene.objects
    assert editor.undo()
    assert editor.scene == before
    editor.rename(ids.agent, "spot")  # what was restored can be edited
    assert editor.redo_label is None


def test_an_edit_that_changes_nothing_leaves_no_step_and_keeps_redo(editor, ids):
    editor.rename(ids.agent, "spot")
    editor.undo()
    assert not editor.rename(ids.agent, "go2")
    assert editor.redo()


def test_a_drag_is_one_step_and_one_that_comes_back_is_none(editor, ids):
    before, label, point = editor.scene, editor.undo_label, ids.points[1]
    for start in (0.0, 5.0):
        editor.begin_drag()
        for i in range(10):
            put(editor, point, 1.0, start + i, 0.0)
        editor.end_drag()
    editor.undo()
    assert editor.scene.get(point).pose.position_m == (1.0, 9.0, 0.0)
    editor.undo()
    assert (editor.scene, editor.undo_label) == (before, label)
    editor.begin_drag()
    for y in (1.0, 0.0, 2.0, 0.0):
        put(editor, point, 1.0, y, 0.0)
    assert (editor.scene, editor.undo_label) == (before, label)


def test_a_drag_that_comes_back_keeps_redo_and_one_that_ends_elsewhere_does_not(editor, ids):
    editor.rename(ids.agent, "spot")
    editor.undo()
    editor.begin_drag()
    for y in (1.0, 0.0, 2.0, 0.0):
        put(editor, ids.points[1], 1.0, y, 0.0)
    editor.end_drag()
    assert editor.redo()
    editor.undo()
    editor.begin_drag()
    put(editor, ids.points[1], 1.0, 3.0, 0.0)
    assert not editor.redo()


def test_undo_in_the_middle_of_a_drag_takes_the_drag_back_and_ends_it(editor, ids):
    before, point = editor.scene, ids.points[1]
    editor.begin_drag()
    put(editor, point, 1.0, 1.0, 0.0)
    editor.undo()
    assert editor.scene == before
    put(editor, point, 1.0, 2.0, 0.0)
    put(editor, point, 1.0, 3.0, 0.0)
    editor.undo()
    assert editor.scene.get(point).pose.position_m == (1.0, 2.0, 0.0)


def test_the_oldest_steps_are_forgotten_first(editor):
    for number in range(1002):
        editor.set_scene("name", f"scene {number}")
    while editor.undo():
        pass
    assert editor.scene.name == "scene 1"


def test_moving_under_another_parent_and_placing_keep_the_frames_apart(editor, ids):
    before = editor.scene.world_pose(ids.points[2])
    editor.move(ids.path, ids.hall)
    assert editor.scene.get(ids.path).pose.position_m == pytest.approx((-10.0, 0.0, 0.0))
    assert editor.scene.world_pose(ids.points[2]).same_as(before)
    assert editor.scene.held_by(ids.hall)[-1] == ids.path
    editor.place(ids.agent, Pose.at((11.0, 2.0, 0.0)))
    assert editor.scene.get(ids.agent).pose.position_m == pytest.approx((1.0, 2.0, 0.0))


def test_aligned_waypoints_keep_looking_along_their_segments_while_a_neighbour_moves(editor, ids):
    editor.align(ids.path, Align.NEXT)
    editor.set_pose(ids.points[1], Pose.from_yaw((0.0, 1.0, 0.0), 0.3))
    yaws = [editor.scene.get(i).pose.yaw_rad for i in ids.points]
    assert yaws == pytest.approx([math.pi / 2, math.atan2(-1, 2), math.atan2(-1, 2)])


def test_waypoints_are_kept_in_order_of_time_and_inserted_on_the_path(editor, ids):
    first, second, third = ids.points
    new = editor.insert_waypoint(ids.path, time_ns=3 * S // 2)
    assert editor.scene.get(new).pose.position_m == pytest.approx((1.5, 0.0, 0.0))
    editor.set_waypoint_time(first, 90 * S)
    assert editor.scene.held_by(ids.path) == (second, new, third, first)


def test_a_copy_of_a_group_drives_its_own_agent(editor, ids):
    editor.move(ids.path, ids.hall)
    copy = editor.duplicate(ids.hall)
    new_agent, new_path = editor.scene.held_by(copy)
    assert editor.scene.get(new_path).agent == new_agent != ids.agent
    assert len(editor.scene.held_by(new_path)) == 3
    assert "a time of its own" in refusal(editor.duplicate, editor.scene.held_by(new_path)[0])


def test_a_trajectory_from_elsewhere_is_added_in_one_step(editor, ids):
    imported, before = editor.scene.trajectory(ids.path), editor.scene
    new = editor.add_trajectory(imported, "imported")
    assert editor.scene.trajectory(new) == imported
    editor.undo()
    assert editor.scene == before
    assert "follows" in refusal(editor.add_trajectory, imported, "imported", agent=ids.agent)


def test_refusals_name_place_given_and_allowed_and_change_nothing(editor, ids):
    hall, agent, path, points = ids.hall, ids.agent, ids.path, ids.points
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
        f"agent {agent} (go2), radius_m: given -1, allowed: a finite number above zero"
    )
    for id_, key, value, says in (
        (agent, "colour", "red", "acceleration_m_s2, name, parent, pose, radius_m, speed_m_s"),
        (agent, "radius", 1.0, "did you mean 'radius_m'?"),
        (agent, "id", 7, "acceleration_m_s2, name"),
        (agent, "kind", "group", "acceleration_m_s2, name"),
        (agent, "name", "", "name: given ''"),
        (agent, "name", "two\nlines", "printable"),
        (agent, "radius_m", math.nan, "allowed"),
        (agent, "pose", Pose.at((1e7, 0.0, 0.0)), "a finite number from -1000000 to 1000000"),
        (path, "agent", path, "an agent in the scene, or none"),
        (other, "agent", agent, f"follows {path}"),
        (points[0], "parent", hall, "the id of a trajectory"),
        (inner, "parent", agent, "the id of a group"),
        (999, "name", "x", "the id of an object in the scene"),
    ):
        assert says in refusal(editor.set_property, id_, key, value)
    assert "the id of a trajectory" in refusal(editor.align, agent, Align.NEXT)
    assert "another field" in refusal(editor.add, "agent", "spot", id=hall)
    for shape in ({"kind": "cone"}, {"kind": "cylinder", "radius_m": 1.0}, Box(size_m=(1, 0, 1))):
        assert "shape" in refusal(editor.add, "obstacle", "pillar", shape=shape)
    assert "frame_id, margin_m, name" in refusal(editor.set_scene, "size", 1)
    assert "frame_id: given ''" in refusal(editor.set_scene, "frame_id", "")
    assert (editor.scene, editor.undo_label) == (before, label)


def test_a_waypoint_needs_no_name(editor, ids):
    editor.rename(ids.points[0], "door")
    assert editor.rename(ids.points[0], "")
    assert editor.scene.get(ids.points[0]).name == ""


def test_listeners_hear_what_changed_and_then_no_more(editor, ids):
    heard = []
    end = editor.listen(heard.append)
    editor.rename(ids.agent, "spot")
    new = editor.insert_waypoint(ids.path)
    editor.remove(*ids.points[:2])
    editor.undo()
    editor.redo()
    end()
    editor.undo()
    assert [c.kind for c in heard] == [*[ChangeKind.EDIT] * 3, ChangeKind.UNDO, ChangeKind.REDO]
    assert (heard[0].changed, heard[0].label) == ((ids.agent,), "Rename")
    assert (heard[1].added, heard[1].changed) == ((new,), (ids.path,))
    assert heard[2].removed == heard[3].added == tuple(ids.points[:2])


def test_removed_objects_are_no_longer_selected(editor, ids):
    editor.select(ids.agent, ids.path, ids.agent)
    editor.remove(ids.hall)
    assert editor.selection == (ids.path,)
    editor.remove()
    assert editor.selection == ()
    assert "the id of an object" in refusal(editor.select, ids.agent)
