"""Edits, undo and redo in known cases; the experiment `planning` tries any sequence of edits."""

import math
from types import SimpleNamespace

import numpy as np
import pytest

from sfglab.lab.experiments.planning.facts import edited
from sfglab.spatial import Pose
from sfglab.spatial.scene.editor import Editor
from sfglab.spatial.scene.model import SceneError, TrajectoryObject
from sfglab.spatial.trajectory.path import Align

S = 1_000_000_000


@pytest.mark.parametrize("seed", range(5))
def test_after_any_edits_holders_and_held_agree_and_waypoints_are_in_order_of_time(seed):
    scene = edited(np.random.default_rng(seed))[0].scene
    assert {thing.id for thing in scene.walk()} == scene.objects.keys()
    for holder, held in scene.children.items():
        assert {scene.objects[id_].parent for id_ in held} == {holder}
    for path in scene.all_of(TrajectoryObject):
        times = [waypoint.time_ns for waypoint in scene.waypoints(path.id)]
        assert times == sorted(set(times))


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
    editor.select(ids.agent, ids.path, ids.agent)
    before = editor.scene
    editor.remove(ids.hall)
    assert editor.scene.get(ids.path).agent is None, "the trajectory stays, without its agent"
    assert ids.hall not in editor.scene.objects
    assert editor.selection == (ids.path,)
    editor.undo()
    assert editor.scene == before
    editor.rename(ids.agent, "spot")  # what was restored can be edited
    assert editor.redo_label is None


def drag(editor, id_, *ys):
    editor.begin_drag()
    for y in ys:
        put(editor, id_, 1.0, y, 0.0)


def test_edits_and_drags_that_change_nothing_leave_no_step_and_keep_redo(editor, ids):
    editor.rename(ids.agent, "spot")
    editor.undo()
    before, label = editor.scene, editor.undo_label
    assert not editor.rename(ids.agent, "go2")
    drag(editor, ids.points[1], 1.0, 0.0, 2.0, 0.0)
    editor.end_drag()
    assert (editor.scene, editor.undo_label, editor.redo_label) == (before, label, "Rename")
    drag(editor, ids.points[1], 1.0, 3.0)
    assert not editor.redo()


def test_a_drag_is_one_step_and_undo_in_its_middle_takes_it_back_and_ends_it(editor, ids):
    before, point = editor.scene, ids.points[1]
    drag(editor, point, 1.0, 5.0)
    editor.undo()
    assert editor.scene == before
    for y in (2.0, 3.0):
        put(editor, point, 1.0, y, 0.0)
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
    assert editor.scene.get(ids.path).pose.position_m == (-10.0, 0.0, 0.0)
    assert editor.scene.world_pose(ids.points[2]).same_as(before)
    assert editor.scene.held_by(ids.hall) == (ids.agent, ids.path)
    editor.place(ids.agent, Pose.at((11.0, 2.0, 0.0)))
    assert editor.scene.get(ids.agent).pose.position_m == (1.0, 2.0, 0.0)


def test_aligned_waypoints_keep_looking_along_their_segments_while_a_neighbour_moves(editor, ids):
    editor.align(ids.path, Align.NEXT)
    editor.set_pose(ids.points[1], Pose.from_yaw((0.0, 1.0, 0.0), 0.3))
    yaws = [editor.scene.get(i).pose.yaw_rad for i in ids.points]
    assert yaws == pytest.approx([math.pi / 2, math.atan2(-1, 2), math.atan2(-1, 2)])


def test_a_copy_of_a_group_drives_its_own_agent(editor, ids):
    editor.move(ids.path, ids.hall)
    copy = editor.duplicate(ids.hall)
    new_agent, new_path = editor.scene.held_by(copy)
    assert editor.scene.get(new_path).agent == new_agent != ids.agent
    assert len(editor.scene.held_by(new_path)) == 3


def test_refusals_name_place_given_and_allowed_and_change_nothing(editor, ids):
    hall, agent, path, points = ids.hall, ids.agent, ids.path, ids.points
    inner = editor.add("group", "corner", parent=hall)
    other = editor.add("trajectory", "other")
    before, label = editor.scene, editor.undo_label
    loop = f"group {inner} (corner), parent: given 'a loop, {inner} in {hall} in {inner}', "
    taken = f"waypoint {points[1]}, time_ns: given {S}, allowed: a time of its own; "
    radius = f"agent {agent} (go2), radius_m: given -1, allowed: a finite number above zero"
    for says, edit, *given in (
        (f"{loop}allowed: a tree", editor.move, hall, inner),
        (f"{taken}waypoint {points[0]} has", editor.set_waypoint_time, points[0], S),
        (radius, editor.set_property, agent, "radius_m", -1),
        ("did you mean 'radius_m'?", editor.set_property, agent, "radius", 1.0),
        ("another field", editor.set_property, agent, "id", 7),
        ("allowed", editor.set_property, agent, "kind", "group"),
        ("printable", editor.rename, agent, "two\nlines"),
        (f"follows {path}", editor.set_property, other, "agent", agent),
        ("the id of a trajectory", editor.set_property, points[0], "parent", hall),
        ("the id of a trajectory", editor.align, agent, Align.NEXT),
        ("the id of an object", editor.select, 999),
        ("frame_id, margin_m, name", editor.set_scene, "size", 1),
        ("group or agent or obstacle", editor.add, "cone"),
        ("a time of its own", editor.duplicate, points[0]),
    ):
        with pytest.raises(SceneError) as caught:
            edit(*given)
        assert says in str(caught.value)
    with pytest.raises(SceneError, match="shape"):
        editor.add("obstacle", "pillar", shape={"kind": "cone"})
    assert (editor.scene, editor.undo_label) == (before, label)


def test_listeners_hear_each_change_and_then_no_more(editor, ids):
    heard = []
    end = editor.listen(lambda change: heard.append((change.value, change.is_of_scene)))
    editor.rename(ids.points[0], "door")
    editor.rename(ids.points[0], "")  # a waypoint needs no name
    editor.undo()
    editor.redo()
    editor.select(ids.agent)
    editor.set_time(1.0)
    end()
    editor.remove()
    of_scene = [(kind, True) for kind in ("edit", "edit", "undo", "redo")]
    assert heard == [*of_scene, ("selection", False), ("time", False)]
