"""Scene files: strict reading, whole writing; and the warnings about a plan."""

import errno
import math
import stat
import subprocess
import sys
import time
from pathlib import Path
from unittest.mock import Mock

import pytest

from sfglab.spatial import Pose
from sfglab.spatial.scene.conflicts import ConflictKind
from sfglab.spatial.scene.editor import Editor
from sfglab.spatial.scene.files import load_scene, read_scene, save_scene, scene_text
from sfglab.spatial.scene.model import Box, Cylinder, SceneError, Sphere
from sfglab.spatial.scene.tree import Scene
from sfglab.spatial.trajectory.path import Trajectory

SCENES = Path(__file__).parents[2] / "data" / "scenes"

GOOD = """\
sfglab_scene: 1
name: hall
next_id: 6
objects:
- id: 1
  kind: group
  name: room
- id: 2
  kind: agent
  name: go2
  parent: 1
- id: 3
  kind: trajectory
  name: path
  agent: 2
  waypoints:
  - {id: 4, time_s: 0.0, xyz_m: [0.0, 0.0, 0.0], quat_xyzw: [0.0, 0.0, 0.0, 1.0]}
  - {id: 5, time_s: 1.5, xyz_m: [1.0, 0.0, 0.0], quat_xyzw: [0.0, 0.0, 0.0, 1.0]}
"""


BROKEN = [  # beside what `test_documents.py` has for every file
    ("sfglab_scene: 1", "sfglab_scene: 2", "hall.yaml:1: sfglab_scene: given 2, allowed: 1"),
    ("kind: group", "kind: gruop", r"hall.yaml:6: objects\[0\].kind: given .* mean 'group'"),
    ("kind: group", "kind: waypoint", r"objects\[0\].kind"),
    ("  kind: group\n", "", r"hall.yaml:5: objects\[0\].kind: nothing is given"),
    ("name: room", "name: room\n  pose: {xyz_m: [0, .nan, 0]}", r"hall.yaml:8: .*finite"),
    ("name: room", "name: room\n  pose: {xyz_m: [1.0e+9, 0, 0]}", "from -1000000 to 1000000"),
    ("id: 2\n", "id: 1\n", r"hall.yaml:8: objects\[1\]: .* allowed: an id of its own; .*:5"),
    ("parent: 1", "parent: 9", r"hall.yaml:8: objects\[1\]: agent 2 \(go2\), parent: given 9"),
    ("name: room", "name: room\n  parent: 1", "hall.yaml:5: .*'a loop, 1 in 1', allowed: a tree"),
    ("agent: 2", "agent: 1", r"hall.yaml:12: objects\[2\]: trajectory 3 \(path\), agent: given 1"),
    ("time_s: 1.5", "time_s: 0.0", r"hall.yaml:18: .*waypoints\[1\]: waypoint 5, time_ns: given 0"),
    ("0.0, 1.0]}\n  - {id: 5", "0, 0]}\n  - {id: 5", r"waypoints\[0\].quat_xyzw: given \[0.0"),
]


@pytest.mark.parametrize(("old", "new", "says"), BROKEN)
def test_broken_files_are_refused_in_one_sentence_with_file_and_place(old, new, says):
    assert GOOD.count(old) == 1
    with pytest.raises(SceneError, match=says) as caught:
        read_scene(GOOD.replace(old, new), file="hall.yaml")
    assert str(caught.value).startswith("hall.yaml")
    assert "\n" not in str(caught.value)


def test_a_hand_written_file_may_say_less_in_another_order():
    text = GOOD.replace("next_id: 6\n", "").replace(", quat_xyzw: [0.0, 0.0, 0.0, 1.0]", "")
    head, *objects = text.split("- id: ")
    shuffled = "- id: ".join([head, *objects[1:3], objects[0], *objects[3:]])
    assert read_scene(text) == read_scene(GOOD)
    assert read_scene(shuffled).objects == read_scene(GOOD).objects
    assert (read_scene(text).held_by(), read_scene(shuffled).held_by()) == ((1, 3), (3, 1))


NAMES = ("null", "Yes", "1.5", "- x", "a: b", "#", 'q"\\', "Süd 🐕", "[x")


def test_names_and_numbers_read_back_as_the_same(editor):
    for name in NAMES:
        editor.insert_waypoint(editor.add("trajectory", name), name=name, time_ns=S + 1)
    for radius_m in (1e-7, 1e22, 0.1 + 0.2, 1):
        editor.add("agent", "a", pose=Pose.at((-0.0, 1e-9, 1e6)), radius_m=radius_m)
    text = scene_text(editor.scene)
    assert read_scene(text) == editor.scene
    assert "-0.0" not in text
    assert "radius_m: 1.0\n" in text


SAVES = """
import sys
from pathlib import Path
from sfglab.spatial.scene.files import load_scene, save_scene
path = Path(sys.argv[1])
scenes = [load_scene(path.with_name(name)) for name in ("a.yaml", "b.yaml")]
print("ready", flush=True)
while True:
    for scene in scenes:
        save_scene(scene, path)
"""


def test_a_file_whose_writer_is_killed_is_the_old_one_or_the_new_one(tmp_path):
    path = tmp_path / "plan.yaml"
    texts = []
    for name in ("a", "b"):
        editor = Editor(read_scene(GOOD))
        for x in range(200):
            editor.insert_waypoint(3, name=f"{name}{x}")
        editor.save(path.with_name(f"{name}.yaml"))
        texts.append(scene_text(editor.scene))
    argv = [sys.executable, "-c", SAVES, str(path)]
    with subprocess.Popen(argv, stdout=subprocess.PIPE) as writer:
        writer.stdout.readline()
        time.sleep(0.1)
        writer.kill()
    assert path.read_text() in texts


@pytest.mark.parametrize("place", ["os.fsync", "pathlib.Path.replace", "pathlib.Path.open"])
def test_when_saving_fails_the_file_stays_whole_and_nothing_is_left_beside_it(
    tmp_path, monkeypatch, place
):
    path = tmp_path / "hall.yaml"
    path.write_text(GOOD)
    editor = Editor.open(path)
    editor.rename(1, "other")
    with monkeypatch.context() as full:
        full.setattr(place, Mock(side_effect=OSError(errno.ENOSPC, "No space left on device")))
        with pytest.raises(SceneError, match=r"hall\.yaml: .*a file that can be written"):
            editor.save()
    assert path.read_text() == GOOD
    assert list(tmp_path.iterdir()) == [path]
    assert editor.dirty
    editor.save()
    assert load_scene(path).get(1).name == "other"


def test_saving_keeps_permissions_and_follows_links(tmp_path):
    real, link = tmp_path / "real.yaml", tmp_path / "link.yaml"
    save_scene(Scene(), real)
    real.chmod(0o640)
    link.symlink_to(real)
    save_scene(Scene(name="other"), link)
    assert link.is_symlink()
    assert load_scene(real).name == "other"
    assert stat.S_IMODE(real.stat().st_mode) == 0o640


def test_an_editor_is_dirty_until_saved_and_ids_of_a_saved_file_are_not_given_again(tmp_path):
    editor = Editor.open(tmp_path / "new.yaml")
    assert (editor.scene.name, editor.dirty) == ("new", False)
    first = editor.add("agent", "go2")
    assert editor.dirty
    editor.save()
    assert not editor.dirty
    editor.undo()
    assert editor.dirty
    editor.redo()
    assert not editor.dirty
    editor.undo()
    editor.save()
    assert Editor.open(tmp_path / "new.yaml").add("agent", "spot") > first
    for act in (Editor().save, Editor().load):
        with pytest.raises(SceneError, match="file: nothing is given"):
            act()


def test_loading_goes_back_to_what_was_saved_and_a_broken_file_changes_nothing(tmp_path):
    path = tmp_path / "hall.yaml"
    path.write_text(GOOD)
    editor = Editor.open(path)
    editor.select(2)
    editor.rename(1, "other")
    path.write_text(GOOD + "nonsense")
    with pytest.raises(SceneError):
        editor.load()
    assert editor.scene.get(1).name == "other"
    path.write_text(GOOD)
    editor.load()
    assert (editor.scene, editor.undo_label, editor.selection) == (read_scene(GOOD), None, (2,))


@pytest.mark.parametrize("name", ["course", "hall"])
def test_an_example_scene_is_as_the_editor_would_save_it_and_free_of_conflicts(name):
    editor = Editor.open(SCENES / f"{name}.yaml")
    assert scene_text(editor.scene) == editor.file.read_text(encoding="utf-8")
    assert editor.conflicts() == ()


S = 1_000_000_000


@pytest.fixture
def editor():
    return Editor()


def driver(editor, name, *points, step_s=10, **values):
    """Add an agent and its trajectory; return both ids."""
    agent = editor.add("agent", name, **values)
    timed = ((i * step_s * S, Pose.at((*point, 0.0))) for i, point in enumerate(points))
    path = editor.add_trajectory(Trajectory.of(timed), f"{name} path", agent=agent)
    return agent, path


def warnings(editor):
    return [(found.kind, found.objects, found.text) for found in editor.conflicts()]


def test_two_agents_that_meet_are_reported_and_the_margin_counts_beyond_the_radii(editor):
    a, _ = driver(editor, "a", (-5, 0), (5, 0), radius_m=0.3)
    group = editor.add("group", "there", pose=Pose.at((1.0, 0.0, 0.0)))
    b = editor.add("agent", "b", parent=group, pose=Pose.at((0.0, 1.0, 0.0)), radius_m=0.5)
    assert warnings(editor) == []
    editor.set_scene("margin_m", 0.4)
    text = "a and b: centres are 1.000 m apart (radii and margin: 1.200 m) at 6.000 s"
    assert warnings(editor) == [(ConflictKind.AGENTS, (a, b), text)]
    [found] = editor.conflicts()
    assert (found.time_s, *found.position_m) == pytest.approx((6.0, 1.0, 0.0, 0.0))


@pytest.mark.parametrize(
    ("shape", "gap_m"),
    [
        (Box(size_m=(2, 4, 6)), math.hypot(2, 2, 1)),
        (Sphere(radius_m=2), math.hypot(3, 4, 4) - 2),
        (Cylinder(radius_m=1, height_m=6), math.hypot(4, 1)),
    ],
)
def test_a_conflict_is_as_deep_as_the_shape_is_near_where_its_pose_puts_it(shape, gap_m, editor):
    place = Pose.at((1.0, 2.0, 3.0), (0.1, 0.2, 0.3, 1.0))
    body = editor.add("obstacle", "body", shape=shape, pose=place)
    near = Pose.at(place.apply((3.0, 4.0, 4.0)))
    agent = editor.add("agent", "a", pose=near, radius_m=gap_m + 0.125)
    text = "a is 0.125 m inside body at 0.000 s"
    assert warnings(editor) == [(ConflictKind.OBSTACLE, (agent, body), text)]


def test_agents_stay_out_of_forbidden_zones_and_in_inside_zones(editor):
    agent, _ = driver(editor, "a{", (0, 0), (4, 0))
    ball = {"kind": "sphere", "radius_m": 2}
    zone = editor.add("zone", "lab", shape=ball, rule="inside")
    text = "a{ is 2.000 m outside of lab at 10.000 s"
    assert warnings(editor) == [(ConflictKind.OUTSIDE, (agent, zone), text)]
    editor.add("zone", "annex", shape=ball, rule="inside", pose=Pose.at((4, 0, 0)))
    assert warnings(editor) == []
    editor.set_property(zone, "rule", "forbidden")
    assert (ConflictKind.ZONE, (agent, zone)) in [found[:2] for found in warnings(editor)]


def test_a_trajectory_that_is_faster_than_its_agent_is_reported(editor):
    agent, path = driver(editor, "a", (0, 0), (1, 0), (9, 0), step_s=1, speed_m_s=2.0)
    text = "a drives 6.000 m/s faster than its limit of 2 m/s at 1.000 s"
    assert warnings(editor) == [(ConflictKind.LIMIT, (agent, path), text)]
    editor.set_property(agent, "speed_m_s", 8.0)
    assert warnings(editor) == []


def test_loose_ends_are_warned_of(editor):
    path = editor.add("trajectory", "path")
    kinds = [found.kind for found in editor.conflicts()]
    assert kinds == [ConflictKind.NO_AGENT, ConflictKind.NO_WAYPOINTS]
    editor.set_property(path, "agent", editor.add("agent", "a"))
    editor.insert_waypoint(path)
    assert warnings(editor) == []


def test_ghosts_stand_drive_and_stand_again_and_a_time_must_be_finite(editor):
    driver(editor, "a", (0, 0), (4, 0), step_s=2)
    editor.add("agent", "b", pose=Pose.at((3.0, 0.0, 0.0)))
    for time_s, x_m, speed_m_s in ((-1.0, 0.0, 0.0), (1.0, 2.0, 2.0), (9.0, 4.0, 0.0)):
        editor.set_time(time_s)
        seen = [(g.name, g.pose.position_m[0], g.speed_m_s, g.driving) for g in editor.ghosts()]
        assert seen == [("a", x_m, speed_m_s, speed_m_s > 0), ("b", 3.0, 0.0, False)]
    with pytest.raises(SceneError, match="a finite number of seconds"):
        editor.set_time(math.nan)
