"""What the scene editor decides before any browser: rows, fields, looks, what is added, and in which order."""

import math
import threading
from dataclasses import fields as dataclass_fields
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from sfglab.errors import SfglabError
from sfglab.spatial.poses import Pose
from sfglab.spatial.scene.editor import Change, ChangeKind, Editor
from sfglab.spatial.scene.model import (
    COMMON,
    KINDS,
    ROOT,
    Box,
    Cylinder,
    SceneError,
    Sphere,
)
from sfglab.spatial.scene.tree import Scene
from sfglab.spatial.trajectory.path import Trajectory
from sfglab.view.planner import looks
from sfglab.view.planner.context import JobQueue
from sfglab.view.planner.fields import fields_of, yaw_pitch_roll_deg
from sfglab.view.planner.toolbar import ADDABLE, add, add_waypoint, insert_waypoint
from sfglab.view.planner.viewport import concerned


@pytest.fixture
def editor():
    made = Editor(Scene(name="s"))
    agent = made.add("agent", "dog", parent=made.add("group", "team"), speed_m_s=1.25)
    path = Trajectory.of([(0, Pose()), (2_000_000_000, Pose(position_m=(2.0, 0.0, 0.0)))])
    made.add_trajectory(path, "walk", agent=agent)
    made.add(
        "obstacle",
        "box",
        shape=Box(size_m=(1.0, 2.0, 3.0)),
        pose=Pose.from_yaw((1 / 3, 1, 0.1), 0.3),
    )
    made.add("zone", "keep out", shape=Cylinder(radius_m=0.5, height_m=2.0))
    return made


def field(editor, id_, key):
    return next(f for f in fields_of(editor.scene, id_) if f.key == key)


def put(editor, id_, key, value):
    field(editor, id_, key).edit(editor, value)


# rows


def test_waypoints_are_listed_under_their_trajectory_alone_and_no_more_rows_than_bearable(editor):
    assert [r.id for r in looks.rows_of(editor.scene, ())] == [1, 2, 3, 6, 7]
    for selected in (3, 4):
        assert [r.id for r in looks.rows_of(editor.scene, (selected,))] == [1, 2, 3, 4, 5, 6, 7]
    depths = {r.id: r.depth for r in looks.rows_of(editor.scene, (4,))}
    assert (depths[1], depths[2], depths[4]) == (0, 1, 1)
    assert [r.id for r in looks.rows_of(editor.scene, (4,)) if r.selected] == [4]
    editor = Editor()
    for i in range(looks.MOST_ROWS + 5):
        editor.add("agent", f"a{i}")
    assert len(looks.rows_of(editor.scene, ())) == looks.MOST_ROWS


# fields


def test_every_property_of_every_kind_has_a_field_and_its_own_value_changes_nothing(editor):
    before = editor.scene
    ids = {thing.kind: thing.id for thing in editor.scene.walk()}
    assert ids.keys() == KINDS.keys()
    for kind, id_ in ids.items():
        fields = fields_of(editor.scene, id_)
        keys = " ".join(f.key for f in fields)
        own = {f.name for f in dataclass_fields(KINDS[kind])} - {*COMMON, "time_ns"}
        assert all(name in keys for name in own)
        for each in fields:
            if each.enabled and each.value != "" and each.key != "angles":
                each.edit(editor, each.value)
    for each in fields_of(editor.scene, ROOT):
        each.edit(editor, each.value)
    assert editor.scene == before


def test_typing_one_coordinate_leaves_the_others_and_a_value_that_is_not_allowed_everything(editor):
    shown = field(editor, 6, "position").value
    put(editor, 6, "position", (shown[0], 5.0, shown[2]))
    assert editor.scene.get(6).pose.position_m == (1 / 3, 5.0, 0.1)
    before = editor.scene
    for key, value in (("radius_m", 0.0), ("name", ""), ("position", (math.nan, 0.0, 0.0))):
        with pytest.raises(SfglabError):
            put(editor, 2, key, value)
    assert editor.scene is before


def test_a_limit_is_switched_on_and_off_sizes_and_drivers_are_typed_and_another_form_is_about_as_large(
    editor,
):
    assert not field(editor, 2, "acceleration_m_s2").enabled
    for id_, key, value, made in (
        (2, "acceleration_m_s2?", True, {"acceleration_m_s2": 1.0}),
        (2, "speed_m_s?", False, {"speed_m_s": None}),
        (6, "shape.size_m", (1.0, 1.0, 0.25), {"shape": Box(size_m=(1.0, 1.0, 0.25))}),
        (3, "agent", "none", {"agent": None}),
        (3, "agent", "dog  #2", {"agent": 2}),
        (7, "shape", "box", {"shape": Box(size_m=(1.0, 1.0, 2.0))}),
        (7, "shape", "cylinder", {"shape": Cylinder(radius_m=0.5, height_m=2.0)}),
        (7, "shape", "sphere", {"shape": Sphere(radius_m=0.5)}),
    ):
        before = editor.scene.get(id_)
        put(editor, id_, key, value)
        assert editor.scene.get(id_) == replace(before, **made)
    assert field(editor, 2, "acceleration_m_s2").enabled


def test_an_aligned_waypoint_cannot_be_turned_and_a_group_is_never_offered_to_itself(editor):
    assert field(editor, 4, "angles").enabled
    put(editor, 4, "align", "next")
    assert not field(editor, 4, "angles").enabled
    inner = editor.add("group", "inner", parent=1)
    assert field(editor, 1, "parent").choices == ("the scene",)
    assert field(editor, inner, "parent").choices == ("the scene", "team  #1")


angles = st.tuples(st.floats(-179, 179), st.floats(-89, 89), st.floats(-179, 179))


@given(angles)
def test_turns_read_back_as_they_were_typed(typed):
    editor = Editor()
    id_ = editor.add("agent", "a")
    put(editor, id_, "angles", typed)
    assert yaw_pitch_roll_deg(editor.scene.get(id_).pose) == pytest.approx(typed, abs=1e-6)


@pytest.mark.parametrize("pitch", [90.0, -90.0])
@given(yaw=st.floats(-179, 179))
def test_straight_up_or_down_the_turn_still_describes_the_same_orientation(pitch, yaw):
    pose = Pose.from_rotation((0, 0, 0), Rotation.from_euler("ZYX", (yaw, pitch, 0), degrees=True))
    again = Rotation.from_euler("ZYX", yaw_pitch_roll_deg(pose), degrees=True)
    assert Pose.from_rotation((0, 0, 0), again).angle_rad(pose) < 1e-5


# looks


def test_agents_keep_their_colours_when_they_are_renamed_and_differ(editor):
    other = editor.add("agent", "cat")
    before = looks.agent_colours(editor.scene)
    put(editor, other, "name", "a cat")
    assert looks.agent_colours(editor.scene) == before
    assert before[2] != before[other]


def test_a_line_passes_every_waypoint_and_is_in_linear_colours(editor):
    points = looks.line_of(editor.scene.world_trajectory(3))
    assert points[0, 0].tolist() == [0, 0, 0]
    assert points[-1, 1].tolist() == [2, 0, 0]
    assert (points[1:, 0] == points[:-1, 1]).all()
    assert looks.line_of(Trajectory.standing(Pose())).shape == (0, 2, 3)
    assert looks.linear((0, 255, 128)).tolist() == [0, 255, 55]


@pytest.mark.parametrize(
    "shape", [Box(size_m=(1, 2, 3)), Sphere(radius_m=0.7), Cylinder(radius_m=0.4, height_m=1.5)]
)
def test_an_outline_lies_on_its_body(shape):
    assert (
        np.abs(shape.distances_m(looks.outline_of(shape).reshape(-1, 3).astype(float))).max() < 1e-6
    )


def test_the_camera_sees_an_empty_scene_and_stands_outside_of_a_large_one(editor):
    assert looks.camera_for(Scene())[1] == (0.0, 0.0, 0.0)
    editor.add("zone", "hall", shape=Box(size_m=(30.0, 30.0, 4.0)))
    position, look_at = looks.camera_for(editor.scene)
    assert np.linalg.norm(np.subtract(position, look_at)) > 15.0


# what is added


@pytest.mark.parametrize("kind", ADDABLE)
def test_what_is_added_stands_where_one_looks_is_selected_and_is_one_step(kind):
    editor = Editor()
    id_ = add(editor, kind, (3.0, 4.0, 0.0))
    assert editor.scene.get(id_).kind == kind
    assert editor.selection == (id_,)
    place = editor.scene.held_by(id_)[0] if kind == "trajectory" else id_
    assert editor.scene.world_pose(place).position_m[:2] == (3.0, 4.0)
    editor.undo()
    assert editor.scene.objects == {}


def test_a_selected_agent_without_trajectory_drives_the_one_that_is_added():
    editor = Editor()
    agent = editor.add("agent", "a", pose=Pose(position_m=(5.0, 0.0, 1.0)))
    editor.select(agent)
    first = add(editor, "trajectory", (0.0, 0.0, 0.0))
    assert editor.scene.get(first).agent == agent
    assert editor.scene.motion(agent).waypoints[0].pose.position_m == (5.0, 0.0, 1.0)
    editor.select(agent)
    second = add(editor, "trajectory", (0.0, 0.0, 0.0))
    assert editor.scene.get(second).agent is None


def test_a_waypoint_goes_on_as_the_last_two_did_or_stands_at_the_sliders_time(editor):
    editor.select(2)
    id_ = add_waypoint(editor)
    made = editor.scene.get(id_)
    assert (made.time_ns, made.pose.position_m) == (4_000_000_000, (4.0, 0.0, 0.0))
    editor.set_time(0.5)
    id_ = insert_waypoint(editor)
    made = editor.scene.get(id_)
    assert (made.time_ns, made.pose.position_m) == (500_000_000, (0.5, 0.0, 0.0))
    with pytest.raises(SceneError, match="time of its own"):
        insert_waypoint(editor)
    with pytest.raises(SceneError, match="a selected trajectory"):
        add_waypoint(Editor())


# what a change concerns


def test_a_moved_waypoint_redraws_its_trajectory_and_a_moved_group_all_it_holds(editor):
    def edited(*ids):
        return concerned(editor.scene, Change(kind=ChangeKind.EDIT, changed=ids))

    assert edited(4) == {3}
    assert edited(1) == {1, 2}
    assert edited(2) == {2, 3}
    assert edited(6) == {6}


# order and threads


def test_jobs_are_done_in_order_and_only_the_newest_of_a_row_of_one_key():
    done, gate = [], threading.Event()
    jobs = JobQueue(done.append)
    jobs.submit(gate.wait)
    for i in range(3):
        jobs.submit(lambda i=i: done.append(i), key="slider")
    jobs.submit(lambda: done.append("end"))
    jobs.submit(lambda: done.append("next drag"), key="slider")
    gate.set()
    jobs.close()
    assert done == [2, "end", "next drag"]


def test_what_is_typed_is_done_before_an_undo_and_once_or_by_itself():
    done = []
    jobs = JobQueue(done.append)
    jobs.later("name", lambda: done.append("ty"), delay_s=60.0)
    jobs.later("name", lambda: done.append("typed"), delay_s=60.0)
    assert jobs.waits("name")
    jobs.call(lambda: done.append("undo"))
    jobs.close()
    assert done == ["typed", "undo"]
    done = threading.Event()
    jobs = JobQueue(print)
    jobs.later("name", done.set, delay_s=0.01)
    assert done.wait(60.0)
    jobs.close()


def test_a_job_that_fails_is_told_and_the_next_one_is_done():
    refused, done = [], []
    jobs = JobQueue(refused.append)
    jobs.submit(lambda: add_waypoint(Editor()))
    jobs.submit(lambda: done.append(1))
    with pytest.raises(SceneError):
        jobs.call(lambda: Editor().save())
    jobs.close()
    assert [type(e) for e in refused] == [SceneError]
    assert done == [1]
    with pytest.raises(SfglabError, match="closed"):
        jobs.call(lambda: None)
    assert not jobs._thread.is_alive()


def test_what_waits_for_a_quiet_moment_is_not_done_before_an_undo_and_only_once():
    done, checked = [], threading.Event()
    jobs = JobQueue(done.append)
    for number in range(3):
        jobs.later("conflicts", lambda n=number: done.append(n), delay_s=0.2, settles=False)
        jobs.call(lambda: done.append("edit"))
    jobs.later("end", checked.set, delay_s=0.4, settles=False)
    assert checked.wait(60.0)
    jobs.later("never", lambda: done.append("never"), delay_s=60.0, settles=False)
    jobs.close()
    assert done == ["edit", "edit", "edit", 2]


def test_kinds_that_the_viewport_draws_are_all_there_are():
    assert {"waypoint", *ADDABLE} == KINDS.keys()
