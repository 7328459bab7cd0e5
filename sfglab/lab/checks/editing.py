"""Checks of edits: undone and done again to the byte, small differences, and files that stay whole."""

from __future__ import annotations

import difflib
import math
import signal
import subprocess
import sys
import tempfile
import time
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from sfglab.lab.checks import CheckRow, Checks, refusal
from sfglab.lab.checks.trajectories import random_limits, random_pose
from sfglab.spatial.scene import commands
from sfglab.spatial.scene.editor import Editor
from sfglab.spatial.scene.files import load_scene, read_scene, save_scene, scene_text
from sfglab.spatial.scene.objects import (
    AgentObject,
    Group,
    SceneError,
    TrajectoryObject,
    WaypointObject,
)
from sfglab.spatial.trajectory.path import Align, Interpolation
from sfglab.units import NS_PER_S

if TYPE_CHECKING:
    from collections.abc import Iterator

    import numpy as np

checks = Checks("editing")

_EDITS = 25
_NAMES = ("go2", "spot", "yes", "a: b", '"quoted" \\', "Halle 5 (Süd)", "null")


def _begun(rng: np.random.Generator) -> Editor:
    editor = Editor()
    hall = editor.add("group", "hall")
    for name in ("go2", "drone"):
        agent = editor.add("agent", name, parent=hall, speed_m_s=float(rng.uniform(0.5, 2.0)))
        path = editor.add("trajectory", f"{name} path", agent=agent)
        for _ in range(3):
            editor.insert_waypoint(path, pose=random_pose(rng), align="next")
    return editor


def _command(editor: Editor, rng: np.random.Generator) -> commands.Command:  # noqa: PLR0911 - one return a kind of edit
    """Draw an edit, which the scene may refuse."""
    one, other = (_any(editor, rng, object) for _ in range(2))
    path, waypoint = _any(editor, rng, TrajectoryObject), _any(editor, rng, WaypointObject)
    match int(rng.integers(9)):
        case 0:
            return commands.SetPose(id=one, pose=random_pose(rng))
        case 1:
            return commands.Rename(id=one, name=str(rng.choice(_NAMES)))
        case 2:
            return commands.Move(
                id=one, parent=_any(editor, rng, Group), keep_place=bool(rng.random() < 0.5)
            )
        case 3:
            return commands.SetTime(id=waypoint, time_ns=int(rng.integers(0, 20 * NS_PER_S)))
        case 4:
            return commands.AlignWaypoints(id=path, align=list(Align)[rng.integers(3)])
        case 5:
            return commands.Retime(id=path, limits=random_limits(rng))
        case 6:
            return commands.Stretch(id=path, factor=float(rng.uniform(0.5, 3.0)))
        case 7:
            kinds = [kind.value for kind in Interpolation]
            return commands.SetProperty(id=path, key="interpolation", value=str(rng.choice(kinds)))
        case _:
            return commands.Remove(ids=(other,))


def _any(editor: Editor, rng: np.random.Generator, kind: type[Any]) -> int:
    """Return the id of any object of a kind, of none that there is where there is no such object."""
    known = [thing.id for thing in editor.scene.objects.values() if isinstance(thing, kind)]
    return int(rng.choice(known)) if known else 10**6


def edited(rng: np.random.Generator) -> tuple[Editor, list[str]]:
    """Return an editor after some edits and undos, and the text after each step that can be undone."""
    editor = _begun(rng)
    texts = [scene_text(editor.scene)]
    for _ in range(_EDITS):
        before = editor.scene
        try:
            if rng.random() < 0.2:
                editor.add("agent", str(rng.choice(_NAMES)), pose=random_pose(rng))
            else:
                editor.do(_command(editor, rng))
        except SceneError:
            continue
        if editor.scene != before:
            texts.append(scene_text(editor.scene))
    return editor, texts


@checks.trial("any edits, undone and done again, give the same bytes at every step")
def _undo_and_redo(rng: np.random.Generator) -> str:
    editor, texts = edited(rng)
    for text in texts[-2::-1]:
        label = editor.undo_label
        if not editor.undo() or scene_text(editor.scene) != text:
            return f"undoing {label!r}"
    for text in texts[1:]:
        label = editor.redo_label
        if not editor.redo() or scene_text(editor.scene) != text:
            return f"doing {label!r} again"
    return ""


@checks.trial("an edit that is refused changes nothing")
def _refused_edits_change_nothing(rng: np.random.Generator) -> str:
    editor, _ = edited(rng)
    before, label = editor.scene, editor.undo_label
    wrong: tuple[commands.Command, ...] = (
        commands.Rename(id=10**6, name="x"),
        commands.SetProperty(id=_any(editor, rng, object), key="wings", value=2),
        commands.Move(id=_any(editor, rng, AgentObject), parent=10**6),
        commands.Stretch(id=_any(editor, rng, TrajectoryObject), factor=math.nan),
    )
    for command in wrong:
        if not refusal(partial(editor.do, command), SceneError):
            return f"{command} was done"
    return "" if editor.scene is before and editor.undo_label == label else "something changed"


@checks.trial("a scene's text reads back as the same scene and the same text")
def _text_reads_back(rng: np.random.Generator) -> str:
    editor, _ = edited(rng)
    text = scene_text(editor.scene)
    scene = read_scene(text)
    return "" if scene == editor.scene and scene_text(scene) == text else text[:200]


@checks.trial("a saved scene is the file that is loaded")
def _saved_and_loaded(rng: np.random.Generator) -> str:
    scene = _begun(rng).scene
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "hall.yaml"
        save_scene(scene, path)
        return (
            ""
            if load_scene(path) == scene and path.read_text() == scene_text(scene)
            else scene.name
        )


@checks.trial("moving a waypoint changes one line of the file")
def _one_line_changes(rng: np.random.Generator) -> str:
    editor = _begun(rng)
    path = _any(editor, rng, TrajectoryObject)
    editor.do(commands.AlignWaypoints(id=path, align=Align.NONE))
    before = scene_text(editor.scene)
    editor.do(
        commands.SetPose(id=int(rng.choice(editor.scene.held_by(path))), pose=random_pose(rng))
    )
    after = scene_text(editor.scene)
    changed = [
        line for line in difflib.ndiff(before.splitlines(), after.splitlines()) if line[0] in "+-"
    ]
    return "" if len(changed) == 2 else f"{len(changed)} lines"


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
  - {id: 5, time_s: 1.5, xyz_m: [1.0, 0.0, 0.0], quat_xyzw: [0.0, 0.0, 0.6, 0.8]}
"""
"""A scene file that is read; broken ones are made of it."""
_FAULTS: tuple[tuple[str, str, str, int], ...] = (
    ("broken YAML", "objects:", "objects: [", 5),
    ("a loop", "name: room", "name: room\n  parent: 2", 5),
    ("a number that is none", "xyz_m: [1.0, 0.0, 0.0]", "xyz_m: [1.0, .nan, 0.0]", 18),
    ("a quaternion of length zero", "[0.0, 0.0, 0.6, 0.8]", "[0.0, 0.0, 0.0, 0.0]", 18),
    ("time that runs backwards", "time_s: 0.0", "time_s: 2.0", 18),
    ("two waypoints at one time", "time_s: 1.5", "time_s: 0.0", 18),
    ("an id twice", "- id: 2", "- id: 1", 8),
    ("an unknown key", "  name: room", "  name: room\n  wings: 2", 8),
    ("a key twice", "name: hall", "name: hall\nname: hall", 3),
    ("a missing key", "  kind: agent\n", "", 8),
    ("an unknown kind", "kind: group", "kind: gruop", 6),
    ("a parent that is not there", "parent: 1", "parent: 9", 8),
    ("an agent that is none", "agent: 2", "agent: 1", 12),
    ("an alias", "next_id: 6\nobjects:\n", "next_id: 6\nobjects: &a\n- *a\n", 5),
    ("an id that was given before", "next_id: 6", "next_id: 3", 3),
    ("another version", "sfglab_scene: 1", "sfglab_scene: 2", 1),
    ("nothing at all", GOOD, "", 1),
)
"""What is broken, what is replaced by what, and the line that must be named."""


def faults() -> Iterator[dict[str, Any]]:
    """Yield for every kind of broken file how it is refused, with the file before and after."""
    with tempfile.TemporaryDirectory() as folder:
        for name, old, new, line in _FAULTS:
            path = Path(folder) / "hall.yaml"
            path.write_text(GOOD)
            editor = Editor.open(path)
            editor.do(commands.Rename(id=1, name="unsaved"))
            scene, broken = editor.scene, GOOD.replace(old, new, 1)
            path.write_text(broken)
            said = refusal(editor.load, SceneError)
            yield {
                "fault": name,
                "said": said.removeprefix(f"{folder}/"),
                "names_the_line": f"hall.yaml:{line}: " in said,
                "one_line": bool(said) and "\n" not in said,
                "file_kept": path.read_text() == broken,
                "scene_kept": editor.scene is scene,
            }


_SAVES = """
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


def survives_kills(rng: np.random.Generator, count: int) -> CheckRow:
    """Return how often a file is whole after one of so many writers was killed at a drawn moment."""
    whole = 0
    with tempfile.TemporaryDirectory() as folder:
        texts = _two_scenes(Path(folder), rng)
        path = Path(folder) / "plan.yaml"
        for _ in range(count):
            path.write_text(texts[0])
            with subprocess.Popen(
                [sys.executable, "-c", _SAVES, str(path)], stdout=subprocess.PIPE
            ) as writer:
                assert writer.stdout is not None
                writer.stdout.readline()
                time.sleep(float(rng.uniform(0.02, 0.2)))
                writer.send_signal(signal.SIGKILL)
            whole += path.read_text() in texts
    name = "a file whose writer is killed is the old one or the new one, whole"
    return CheckRow(
        check=name, checked=count, held=whole, example=f"{len(texts[0])} and {len(texts[1])} bytes"
    )


def _two_scenes(folder: Path, rng: np.random.Generator) -> list[str]:
    texts = []
    for name in ("a.yaml", "b.yaml"):
        editor, _ = edited(rng)
        path = editor.add("trajectory", "long")
        for _ in range(200):
            editor.insert_waypoint(path, pose=random_pose(rng))
        texts.append(scene_text(editor.scene))
        (folder / name).write_text(texts[-1])
    return texts
