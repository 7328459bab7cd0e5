"""Decisions of the scene editor without a browser: rows, fields, nodes, additions, and their order."""

import asyncio
import threading
from dataclasses import fields as dataclass_fields
from dataclasses import replace
from functools import partial
from unittest.mock import AsyncMock, Mock

import pytest
from scipy.spatial.transform import Rotation

from sfglab.spatial.execution.orders import Order
from sfglab.spatial.poses import Pose
from sfglab.spatial.scene.editor import Editor
from sfglab.spatial.scene.model import COMMON, KINDS, ROOT, Box, Cylinder, SceneError, Sphere
from sfglab.spatial.trajectory.path import Trajectory
from sfglab.view.planner import looks, sending
from sfglab.view.planner.context import JobQueue
from sfglab.view.planner.fields import fields_of, yaw_pitch_roll_deg
from sfglab.view.planner.toolbar import (
    ADDABLE,
    add,
    append_waypoint,
    duplicate,
    insert_waypoint,
    remove,
)


@pytest.fixture
def editor():
    made = Editor()
    agent = made.add("agent", "dog", parent=made.add("group", "team"), speed_m_s=1.25)
    path = Trajectory.of([(0, Pose()), (2_000_000_000, Pose(position_m=(2.0, 0.0, 0.0)))])
    made.add_trajectory(path, "walk", agent=agent)
    made.add("obstacle", "box", shape=Box(size_m=(1.0, 2.0, 3.0)))
    made.add("zone", "keep out", shape=Cylinder(radius_m=0.5, height_m=2.0))
    return made


def field(editor, id_, key):
    return next(f for f in fields_of(editor.scene, id_) if f.key == key)


def put(editor, id_, key, value):
    field(editor, id_, key).edit(editor, value)


def test_waypoints_are_listed_under_their_trajectory_alone_and_no_more_rows_than_bearable(editor):
    def rows(*selection):
        return [(thing.id, depth) for thing, depth in looks.rows_of(editor.scene, selection)]

    closed = [(1, 0), (2, 1), (3, 0), (6, 0), (7, 0)]
    assert rows() == closed
    for selected in (3, 4):
        assert rows(selected) == [*closed[:3], (4, 1), (5, 1), *closed[3:]]
    for _ in range(looks.MOST_ROWS):
        editor.add("group", "g")
    assert len(rows()) == looks.MOST_ROWS


def test_every_property_of_every_kind_has_a_field_and_its_own_value_changes_nothing(editor):
    before = editor.scene
    ids = {thing.kind: thing.id for thing in before.walk()}
    assert ids.keys() == KINDS.keys() == {"waypoint", *ADDABLE}
    for kind, id_ in ids.items():
        keys = {f.key for f in fields_of(before, id_)}
        own = {f.name for f in dataclass_fields(KINDS[kind])} - {*COMMON, "time_ns"}
        assert own <= keys
    for id_ in (ROOT, *ids.values()):
        for each in fields_of(before, id_):
            if each.value != "":
                each.edit(editor, each.value)
    assert editor.scene == before


@pytest.mark.parametrize(
    ("id_", "key", "value", "made"),
    [
        (2, "speed_m_s", 0.0, {"speed_m_s": None}),
        (2, "position", (1.0, 2.0, 3.0), {"pose": Pose(position_m=(1.0, 2.0, 3.0))}),
        (6, "shape.size_m", (1.0, 1.0, 0.25), {"shape": Box(size_m=(1.0, 1.0, 0.25))}),
        (3, "agent", "none", {"agent": None}),
        (7, "shape", "box", {"shape": Box(size_m=(1.0, 1.0, 2.0))}),
        (6, "shape", "cylinder", {"shape": Cylinder(radius_m=0.5, height_m=3.0)}),
        (7, "shape", "sphere", {"shape": Sphere(radius_m=0.5)}),
    ],
)
def test_a_field_edits_its_property_and_another_shape_is_about_as_large(
    editor, id_, key, value, made
):
    before = editor.scene.get(id_)
    put(editor, id_, key, value)
    assert editor.scene.get(id_) == replace(before, **made)


def test_an_aligned_waypoint_cannot_be_turned_and_a_group_is_never_offered_to_itself(editor):
    assert field(editor, 4, "angles").enabled
    put(editor, 4, "align", "next")
    assert not field(editor, 4, "angles").enabled
    inner = editor.add("group", "inner", parent=1)
    assert field(editor, 1, "parent").choices == ("the scene",)
    assert field(editor, inner, "parent").choices == ("the scene", "team  #1")


@pytest.mark.parametrize("typed", [(30.0, 20.0, -10.25), (50.0, 90.0, 0.0), (50.0, -90.0, 0.0)])
def test_turns_read_back_as_they_were_typed(editor, typed):
    put(editor, 2, "angles", typed)
    assert field(editor, 2, "angles").value == pytest.approx(typed, abs=0.01)


def test_a_line_passes_every_waypoint_and_is_in_linear_colours(editor):
    points = looks.line_of(editor.scene.world_trajectory(3))
    assert points[0, 0].tolist() == [0, 0, 0]
    assert points[-1, 1].tolist() == [2, 0, 0]
    assert (points[1:, 0] == points[:-1, 1]).all()
    assert looks.linear((0, 255, 128)).tolist() == [0, 255, 55]


def test_a_typed_coordinate_or_angle_leaves_the_others_which_are_shown_rounded(editor):
    turned = Rotation.from_euler("ZYX", (0.123456789, 1.0, 0.0), degrees=True)
    editor.set_pose(2, Pose.from_rotation((1.0 / 3.0, 0.0, 0.0), turned))
    for key in ("position", "angles"):
        first, _, last = field(editor, 2, key).value
        put(editor, 2, key, (first, 10.0, last))
    pose = editor.scene.get(2).pose
    assert pose.position_m == (1.0 / 3.0, 10.0, 0.0)
    assert yaw_pitch_roll_deg(pose) == pytest.approx((0.123456789, 10.0, 0.0), abs=1e-9)


@pytest.mark.parametrize("kind", ADDABLE)
def test_an_added_object_is_where_the_camera_looks_is_selected_and_is_one_step(kind):
    editor = Editor()
    id_ = add(editor, kind, (3.0, 4.0, 0.0))
    assert editor.scene.get(id_).kind == kind
    assert editor.selection == (id_,)
    place = editor.scene.held_by(id_)[0] if kind == "trajectory" else id_
    assert editor.scene.world_pose(place).position_m[:2] == (3.0, 4.0)
    editor.undo()
    assert editor.scene.objects == {}


def test_an_added_trajectory_begins_at_the_selected_agent_unless_that_has_one():
    editor = Editor()
    agent = editor.add("agent", "a", pose=Pose(position_m=(5.0, 0.0, 1.0)))
    for owner in (agent, None):
        editor.select(agent)
        added = add(editor, "trajectory", (0.0, 0.0, 0.0))
        assert editor.scene.get(added).agent == owner
    assert editor.scene.motion(agent).waypoints[0].pose.position_m == (5.0, 0.0, 1.0)


def test_a_waypoint_is_ahead_of_the_last_one_or_at_the_sliders_time(editor):
    def selected():
        made = editor.scene.get(editor.selection[0])
        return made.time_ns, made.pose.position_m

    editor.select(3)
    append_waypoint(editor)
    assert selected() == (3_000_000_000, (3.0, 0.0, 0.0))
    editor.set_time(0.5)
    insert_waypoint(editor)
    assert selected() == (500_000_000, (0.5, 0.0, 0.0))
    editor.select()
    with pytest.raises(SceneError, match="a selected trajectory"):
        append_waypoint(editor)


def test_a_removed_waypoint_leaves_its_trajectory_selected_and_a_copy_is_selected(editor):
    editor.select(4)
    remove(editor)
    assert editor.selection == (3,)
    assert 4 not in editor.scene.objects
    duplicate(editor)
    assert editor.scene.get(editor.selection[0]).name == "walk"
    assert editor.selection != (3,)
    remove(editor)
    assert editor.selection == ()


def test_jobs_are_done_in_order_and_only_the_newest_of_a_row_of_one_key():
    done, gate = [], threading.Event()
    jobs = JobQueue(done.append)
    jobs.submit(gate.wait)
    for number in range(3):
        jobs.submit(partial(done.append, number), key="slider")
    jobs.submit(Editor().save)  # it has no file
    jobs.submit(partial(done.append, "next drag"), key="slider")
    gate.set()
    jobs.close(AsyncMock())
    slider, error, drag = done
    assert (slider, type(error), drag) == (2, SceneError, "next drag")


async def test_no_goal_or_cancellation_outlives_a_sender_whose_server_is_silent(monkeypatch):
    def never(*_):
        return asyncio.Event().wait()

    execution = Mock(return_value=Mock(begin=never, cancel=never))
    monkeypatch.setattr(sending, "Execution", execution)
    monkeypatch.setattr(sending, "_CLOSE_S", 0.01)
    sender = sending.Sender(lambda: Mock(close=AsyncMock()), lambda _: None)
    sender.send(1, Order(agent="dog", trajectory=Trajectory.standing(Pose())), "/walk")
    await asyncio.sleep(0)
    await sender.close()
    assert asyncio.all_tasks() == {asyncio.current_task()}
