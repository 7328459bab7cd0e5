"""Scene files, clean, strict, and whole on disk whatever happens; and warnings of a plan."""

import difflib
import errno
import math
import stat
import subprocess
import sys
import time
from pathlib import Path

import pytest

from sfglab.spatial import Pose
from sfglab.spatial.scene.conflicts import ConflictKind
from sfglab.spatial.scene.editor import ChangeKind, Editor
from sfglab.spatial.scene.files import load_scene, read_scene, save_scene, scene_text
from sfglab.spatial.scene.model import SceneError
from sfglab.spatial.scene.tree import Scene

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
    (GOOD, "a: [1\nb: 2\n", "hall.yaml:2: .* allowed: YAML"),
    ("sfglab_scene: 1", "sfglab_scene: 2", "hall.yaml:1: sfglab_scene: given 2, allowed: 1"),
    ("name: hall", "nam: hall", "hall.yaml:2: nam: given 'nam', .* did you mean 'name'"),
    ("kind: group", "kind: gruop", r"hall.yaml:6: objects\[0\].kind: given .* mean 'group'"),
    ("kind: group", "kind: waypoint", r"objects\[0\].kind"),
    ("  kind: group\n", "", r"hall.yaml:5: objects\[0\].kind: nothing is given"),
    ("name: room", "name: room\n  radius_m: 1.0", r"hall.yaml:8: .*radius_m: given 'radius_m'"),
    ("name: room", "name: room\n  pose: {xyz_m: [0, .nan, 0]}", r"hall.yaml:8: .*finite"),
    ("name: room", "name: room\n  pose: {xyz_m: [0, 0]}", "xyz_m: .* allowed: 3 values"),
    (
        "name: room",
        "name: room\n  pose: {xyz_m: [1.0e+9, 0, 0]}",
        "a finite number from -1000000 to 1000000",
    ),
    ("id: 2\n", "id: 1\n", r"hall.yaml:8: objects\[1\]: .* allowed: an id of its own; .*:5"),
    ("parent: 1", "parent: 9", r"hall.yaml:8: objects\[1\]: agent 2 \(go2\), parent: given 9"),
    ("name: room", "name: room\n  parent: 1", "hall.yaml:5: .*'a loop, 1 in 1', allowed: a tree"),
    ("agent: 2", "agent: 1", r"hall.yaml:12: objects\[2\]: trajectory 3 \(path\), agent: given 1"),
    ("time_s: 1.5", "time_s: 0.0", r"hall.yaml:18: .*waypoints\[1\]: waypoint 5, time_ns: given 0"),
    ("time_s: 1.5", "time_s: .inf", "a finite number"),
    ("time_s: 1.5, ", "", "hall.yaml:18: .*time_s: nothing is given"),
    (
        "[1.0, 0.0, 0.0], quat_xyzw: [0.0, 0.0, 0.0, 1.0]",
        "[1.0, 0.0, 0.0], quat_xyzw: [0, 0, 0, 0]",
        r"hall.yaml:18: objects\[2\].waypoints\[1\].quat_xyzw: given \[0.0, 0.0, 0.0, 0.0\]",
    ),
]


@pytest.mark.parametrize(("old", "new", "says"), BROKEN, ids=map(str, range(len(BROKEN))))
def test_broken_files_are_refused_in_one_sentence_with_file_and_place(old, new, says):
    assert GOOD.count(old) == 1
    with pytest.raises(SceneError, match=says) as caught:
        read_scene(GOOD.replace(old, new), file="hall.yaml")
    assert str(caught.value).startswith("hall.yaml")
    assert "\n" not in str(caught.value)


def test_a_hand_written_file_may_say_less_in_another_order_and_siblings_keep_theirs():
    first, second = GOOD.index("- id: 1"), GOOD.index("- id: 2")
    shuffled = GOOD[:first] + GOOD[second:] + GOOD[first:second]
    assert read_scene(shuffled).objects == read_scene(GOOD).objects
    assert read_scene(GOOD.replace("next_id: 6\n", "")) == read_scene(GOOD)
    assert read_scene(GOOD.replace(", quat_xyzw: [0.0, 0.0, 0.0, 1.0]", "")) == read_scene(GOOD)
    text = GOOD.replace("- id: 1\n  kind: group\n  name: room\n", "").replace(
        "next_id: 6", "next_id: 8"
    )
    text += "- {id: 7, kind: group, name: first}\n- {id: 1, kind: group, name: room}\n"
    assert read_scene(text).held_by() == (3, 7, 1)


def test_an_aligned_waypoint_edited_by_hand_looks_along_its_new_segment():
    text = GOOD.replace("quat_xyzw: [0.0, 0.0, 0.0, 1.0]}", "align: previous}")
    pose = read_scene(text.replace("[1.0, 0.0", "[0.0, 2.0")).get(5).pose
    assert pose.same_as(Pose.from_yaw((0.0, 2.0, 0.0), 1.5707963267948966))


def test_inserting_a_waypoint_adds_its_line_and_the_next_id():
    scene = read_scene(GOOD)
    editor = Editor(scene)
    editor.insert_waypoint(3, time_ns=1_000_000_001)
    before, after = (scene_text(each).splitlines() for each in (scene, editor.scene))
    found = [line for line in difflib.ndiff(before, after) if line[0] in "+-"]
    assert [line for line in found if "id: 6, time_s: 1.000000001" in line]
    assert len(found) == 3


@pytest.mark.parametrize("number", [1e-7, 1e22, 0.1 + 0.2, -0.0])
def test_numbers_read_back_as_the_same_floats(number):
    within = max(min(number, 1e6), -1e6)
    scene = Editor()
    id_ = scene.add("agent", "a", pose=Pose.at((within, 0.0, 0.0)), radius_m=abs(number) or 1)
    again = read_scene(scene_text(scene.scene))
    assert again == scene.scene
    assert isinstance(again.get(id_).radius_m, float)
    assert "-0.0" not in scene_text(scene.scene)


@pytest.mark.parametrize("name", ["null", "Yes", "1.5", "- x", "a: b", "#", 'q"\\', "Süd 🐕", "[x"])
def test_names_read_back_as_the_same_text(name, editor):
    editor.add("group", name)
    path = editor.add("trajectory", name)
    editor.rename(editor.insert_waypoint(path), name)
    assert read_scene(scene_text(editor.scene)) == editor.scene


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
    texts = []
    for y, name in enumerate("ab"):
        editor = Editor(read_scene(GOOD))
        for x in range(200):
            editor.insert_waypoint(3, pose=Pose.at((x, y, 0)))
        save_scene(editor.scene, tmp_path / f"{name}.yaml")
        texts.append(scene_text(editor.scene))
    path = tmp_path / "plan.yaml"
    argv = [sys.executable, "-c", SAVES, str(path)]
    with subprocess.Popen(argv, stdout=subprocess.PIPE) as writer:
        writer.stdout.readline()
        time.sleep(0.1)
        writer.kill()
    assert path.read_text() in texts


@pytest.mark.parametrize("fails", ["fsync", "replace", "text", "write"])
def test_when_saving_fails_the_file_stays_whole_and_nothing_is_left_beside_it(
    tmp_path, monkeypatch, fails
):
    path = tmp_path / "hall.yaml"
    save_scene(read_scene(GOOD), path)
    before = path.read_bytes()

    def full(*_args, **_kwargs):
        raise OSError(errno.ENOSPC, "No space left on device")

    def broken(_scene):
        raise ZeroDivisionError

    places = {"fsync": "os.fsync", "replace": "pathlib.Path.replace", "write": "pathlib.Path.open"}
    place = places.get(fails, "sfglab.spatial.scene.files.scene_text")
    monkeypatch.setattr(place, broken if fails == "text" else full)
    editor = Editor(read_scene(GOOD), file=path)
    editor.rename(1, "other")
    with pytest.raises(ZeroDivisionError if fails == "text" else SceneError):
        editor.save()
    monkeypatch.undo()
    assert path.read_bytes() == before
    assert list(tmp_path.iterdir()) == [path]
    assert editor.dirty
    editor.save()
    assert load_scene(path).get(1).name == "other"


def test_saving_to_where_nothing_is_and_loading_what_is_not_there_says_so(tmp_path):
    with pytest.raises(SceneError, match=r"hall\.yaml: .*a file that can be written"):
        save_scene(Scene(), tmp_path / "nowhere" / "hall.yaml")
    with pytest.raises(SceneError, match=r"hall\.yaml: .*a readable text file"):
        load_scene(tmp_path / "hall.yaml")


def test_saving_keeps_permissions_and_follows_links(tmp_path):
    real, link = tmp_path / "real.yaml", tmp_path / "link.yaml"
    save_scene(Scene(), real)
    real.chmod(0o640)
    link.symlink_to(real)
    save_scene(Scene(name="other"), link)
    assert link.is_symlink()
    assert load_scene(real).name == "other"
    assert stat.S_IMODE(real.stat().st_mode) == 0o640


def test_an_editor_is_dirty_until_saved_and_again_clean_after_undo(tmp_path):
    editor = Editor.open(tmp_path / "new.yaml")
    assert editor.scene.name == "new"
    heard = []
    editor.listen(heard.append)
    assert not editor.dirty
    editor.add("agent", "go2")
    assert editor.dirty
    editor.save()
    assert not editor.dirty
    editor.add("agent", "spot")
    editor.undo()
    assert not editor.dirty
    assert heard[1].kind is ChangeKind.SAVE


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
    assert editor.scene == read_scene(GOOD)
    assert editor.undo_label is None
    assert editor.selection == (2,)


def test_ids_of_a_saved_file_are_not_given_again_and_without_a_file_nothing_is_saved(tmp_path):
    editor = Editor.open(tmp_path / "hall.yaml")
    first = editor.add("agent", "go2")
    editor.save()
    editor.undo()
    editor.save()
    assert Editor.open(tmp_path / "hall.yaml").add("agent", "spot") > first
    for act in (Editor().save, Editor().load):
        with pytest.raises(SceneError, match="file: nothing is given"):
            act()


def test_both_example_scenes_are_as_the_editor_would_save_them_and_free_of_conflicts():
    first, second = SCENES.glob("*.yaml")
    for path in (first, second):
        editor = Editor.open(path)
        assert scene_text(editor.scene) == path.read_text(encoding="utf-8")
        assert editor.conflicts() == ()


S = 1_000_000_000


@pytest.fixture
def editor():
    return Editor()


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


def test_two_agents_that_meet_are_reported_and_the_margin_counts_beyond_the_radii(editor):
    a, _ = driver(editor, "a", (-5, 0), (5, 0), radius_m=0.3)
    b, _ = driver(editor, "b", (0, -5), (0, 5), radius_m=0.4)
    found = only(editor)
    assert (found.kind, found.objects) == (ConflictKind.AGENTS, (a, b))
    assert found.time_s == pytest.approx(5.0)
    assert found.position_m == pytest.approx((0.0, 0.0, 0.0))
    assert found.text == "a and b are 0.800 m closer than the margin of 0.1 m at 5.000 s"
    editor = Editor()
    driver(editor, "a", (-5, 0), (5, 0), radius_m=0.3)
    driver(editor, "b", (-5, 1), (5, 1), radius_m=0.3)
    assert editor.conflicts() == ()
    editor.set_scene("margin_m", 0.5)
    assert only(editor).text.startswith("a and b are 0.100 m closer than the margin of 0.5 m")


def test_agents_in_groups_meet_where_these_put_them(editor):
    driver(editor, "a", (-5, 0), (5, 0))
    group = editor.add("group", "there", pose=Pose.at((0.0, 5.0, 0.0)))
    editor.add("agent", "b", parent=group, pose=Pose.at((0.0, -5.0, 0.0)))
    assert only(editor).kind is ConflictKind.AGENTS


def test_an_agent_that_cuts_a_corner_into_a_turned_box_is_reported(editor):
    driver(editor, "a", (-5, 1.5), (5, 1.5), radius_m=0.3)
    box = editor.add("obstacle", "crate", shape={"kind": "box", "size_m": [2, 2, 2]})
    assert editor.conflicts() == ()
    editor.place(box, Pose.from_yaw((0.0, 0.0, 0.0), math.pi / 4))
    found = only(editor)
    assert found.kind is ConflictKind.OBSTACLE
    assert found.text == "a is 0.214 m inside crate at 5.000 s"


def test_agents_stay_out_of_forbidden_zones_and_in_inside_zones(editor):
    agent, _ = driver(editor, "a{", (0, 0), (4, 0))
    zone = editor.add("zone", "lab", shape={"kind": "box", "size_m": [4, 4, 4]}, rule="inside")
    found = only(editor)
    assert (found.kind, found.objects) == (ConflictKind.OUTSIDE, (agent, zone))
    assert found.text == "a{ is 2.000 m outside of lab at 10.000 s"
    editor.add(
        "zone",
        "annex",
        shape={"kind": "sphere", "radius_m": 2},
        rule="inside",
        pose=Pose.at((4, 0, 0)),
    )
    assert editor.conflicts() == ()
    editor.set_property(zone, "rule", "forbidden")
    assert {c.kind: c for c in editor.conflicts()}[ConflictKind.ZONE].objects == (agent, zone)


def test_a_trajectory_that_is_faster_than_its_agent_is_reported(editor):
    agent, path = driver(editor, "a", (0, 0), (1, 0), (9, 0), step_ns=S, speed_m_s=2.0)
    found = only(editor)
    assert found.objects == (agent, path)
    assert found.text == "a drives 6.000 m/s faster than its limit of 2 m/s at 1.000 s"
    editor.set_property(agent, "speed_m_s", 8.0)
    assert editor.conflicts() == ()


def test_loose_ends_are_warned_of(editor):
    path = editor.add("trajectory", "path")
    assert [c.kind for c in editor.conflicts()] == [
        ConflictKind.NO_AGENT,
        ConflictKind.NO_WAYPOINTS,
    ]
    editor.set_property(path, "agent", editor.add("agent", "a"))
    editor.insert_waypoint(path)
    assert editor.conflicts() == ()


def test_ghosts_stand_drive_and_stand_again_and_a_time_must_be_finite(editor):
    moving, _ = driver(editor, "a", (0, 0), (4, 0), step_ns=2 * S)
    standing = editor.add("agent", "b", pose=Pose.at((0.0, 3.0, 0.0)))
    seen = []
    for time_s in (-1.0, 1.0, 9.0):
        editor.set_time(time_s)
        first, second = editor.ghosts()
        seen.append((first.pose.position_m[0], first.speed_m_s, first.driving))
        assert (first.agent, second.agent) == (moving, standing)
        assert second.pose.position_m == (0.0, 3.0, 0.0)
    assert seen == [(0.0, 0.0, False), (2.0, 2.0, True), (4.0, 0.0, False)]
    with pytest.raises(SceneError, match="a finite number of seconds"):
        editor.set_time(math.nan)
