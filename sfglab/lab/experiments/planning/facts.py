"""Facts of paper A, section 4.5, for any trajectory and any edits; each is tried on random cases."""

from __future__ import annotations

import tempfile
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from sfglab.spatial import Pose
from sfglab.spatial.scene.editor import Editor
from sfglab.spatial.scene.files import load_scene, save_scene, scene_text
from sfglab.spatial.scene.model import (
    Group,
    SceneError,
    SceneObject,
    TrajectoryObject,
    WaypointObject,
)
from sfglab.spatial.trajectory.motion import motion_of, pose_at
from sfglab.spatial.trajectory.path import Align, Interpolation, Trajectory, aligned_quat
from sfglab.units import NS_PER_S

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    Floats = NDArray[np.float64]
    Fact = Callable[[np.random.Generator], str]

_REACH_M = 5.0
_EDITS = 25
_NAMES = ("go2", "spot", "yes", "a: b", '"quoted" \\', "Halle 5 (Süd)", "null")
_NO_ID = 10**6
_EITHER_WAY_RAD = 3.1
"""Angle beyond which two turns are nearly equally short, and rounding chooses between them."""


def random_pose(rng: np.random.Generator) -> Pose:
    """Return a pose within some metres of the origin, with any orientation."""
    return Pose.at(rng.uniform(-_REACH_M, _REACH_M, 3), rng.normal(size=4))


def random_polyline(rng: np.random.Generator) -> Trajectory:
    """Return a polyline of two to seven waypoints, whose times are dense or far apart."""
    count = int(rng.integers(2, 8))
    durations_s = rng.choice([0.05, 0.5, 1.0, 3.0], count) * rng.uniform(0.5, 2.0, count)
    times_ns = np.round(np.cumsum(durations_s) * NS_PER_S).astype(int).tolist()
    return Trajectory.of((time_ns, random_pose(rng)) for time_ns in times_ns)


def _misaligned(rng: np.random.Generator, align: Align) -> str:
    """Return how far the aligned end of a random segment is from the segment's direction."""
    path = random_polyline(rng)
    positions = [waypoint.pose.position_m for waypoint in path.waypoints]
    first = int(rng.integers(len(positions) - 1))
    segment = np.subtract(positions[first + 1], positions[first])
    along = segment / np.linalg.norm(segment)
    index = first + 1 if align is Align.PREVIOUS else first
    turned = Pose.at(quat_xyzw=aligned_quat(positions, index, align) or ()).matrix()
    off = float(np.linalg.norm(turned[:3, 0] - along))
    roll = abs(float(turned[2, 1]))
    return f"x axis off by {off:.1g}, roll {roll:.1g}" if max(off, roll) > 1e-9 else ""


def _polyline_is_linear(rng: np.random.Generator) -> str:
    path = random_polyline(rng)
    for before, after in pairwise(path.waypoints):
        share = float(rng.uniform())
        time_ns = before.time_ns + share * (after.time_ns - before.time_ns)
        found = pose_at(path, time_ns / NS_PER_S)
        wanted = before.pose.interpolate(after.pose, share)
        either_way = before.pose.angle_rad(after.pose) > _EITHER_WAY_RAD
        turned = 0.0 if either_way else found.angle_rad(wanted)
        if found.distance_m(wanted) > 1e-6 or turned > 1e-5:
            return f"{found} instead of {wanted}"
    return ""


def _spline_is_the_pyramid(rng: np.random.Generator) -> str:
    """Compare with times that grow as the knots do: the spline is then a cubic in time."""
    points = rng.uniform(-_REACH_M, _REACH_M, (4, 3))
    knots = np.concatenate(
        [[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1) ** 0.5)]
    )
    timed = ((round(u * NS_PER_S), Pose.at(p)) for u, p in zip(knots, points, strict=True))
    spline = Trajectory.of(timed, Interpolation.CATMULL_ROM)
    at = float(rng.uniform(knots[1], knots[2]))
    found = motion_of(spline).positions(at)[0]
    off = float(np.linalg.norm(found - _pyramid(points, knots, at)))
    return f"off by {off:.1g} m" if off > 1e-6 else ""


def _pyramid(points: Floats, knots: Floats, at: float) -> Floats:
    """Return the spline through four points between the second and the third, as Barry and Goldman define it."""
    level = list(points)
    for height in (1, 2):
        raised = []
        for first in range(4 - height):
            left, right = knots[first], knots[first + height]
            raised.append(
                ((right - at) * level[first] + (at - left) * level[first + 1]) / (right - left)
            )
        level = raised
    return np.asarray(((knots[2] - at) * level[0] + (at - knots[1]) * level[1]) / np.diff(knots)[1])


def edited(rng: np.random.Generator) -> tuple[Editor, list[str]]:
    """Return an editor after random edits, and the text of the scene after each step."""
    editor = Editor()
    hall = editor.add("group", "hall")
    for name in ("go2", "drone"):
        agent = editor.add("agent", name, parent=hall)
        path = editor.add("trajectory", f"{name} path", agent=agent)
        for _ in range(3):
            editor.insert_waypoint(path, pose=random_pose(rng), align="next")
    texts = [scene_text(editor.scene)]
    for _ in range(_EDITS):
        before = editor.scene
        try:
            _edit(editor, rng)
        except SceneError:
            continue  # not allowed: nothing changed
        if editor.scene != before:
            texts.append(scene_text(editor.scene))
    return editor, texts


def _edit(editor: Editor, rng: np.random.Generator) -> None:
    """Do a random edit, which the scene may refuse."""
    anything = _any(editor, rng, SceneObject)
    path = _any(editor, rng, TrajectoryObject)
    match int(rng.integers(8)):
        case 0:
            editor.add("agent", str(rng.choice(_NAMES)), pose=random_pose(rng))
        case 1:
            editor.set_pose(anything, random_pose(rng))
        case 2:
            editor.rename(anything, str(rng.choice(_NAMES)))
        case 3:
            editor.move(anything, _any(editor, rng, Group))
        case 4:
            waypoint = _any(editor, rng, WaypointObject)
            editor.set_waypoint_time(waypoint, int(rng.integers(20 * NS_PER_S)))
        case 5:
            editor.align(path, list(Align)[rng.integers(3)])
        case 6:
            kind = list(Interpolation)[rng.integers(2)]
            editor.set_property(path, "interpolation", kind)
        case _:
            editor.remove(anything)


def _any(editor: Editor, rng: np.random.Generator, kind: type[Any]) -> int:
    """Return the id of any object of a kind; if there is none, an id that no object has."""
    known = [thing.id for thing in editor.scene.objects.values() if isinstance(thing, kind)]
    return int(rng.choice(known)) if known else _NO_ID


def _undo_and_redo(rng: np.random.Generator) -> str:
    editor, texts = edited(rng)
    for text in texts[-2::-1]:
        label = editor.undo_label
        if not editor.undo() or scene_text(editor.scene) != text:
            return f"undo: {label}"
    for text in texts[1:]:
        label = editor.redo_label
        if not editor.redo() or scene_text(editor.scene) != text:
            return f"redo: {label}"
    return ""


def _saved_is_loaded(rng: np.random.Generator) -> str:
    editor, _ = edited(rng)
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "scene.yaml"
        save_scene(editor.scene, file)
        if load_scene(file) != editor.scene:
            return "another scene was loaded"
        written = file.read_text("utf-8")
    return "" if written == scene_text(editor.scene) else "the file has another text"


FACTS: dict[str, Fact] = {
    "aligned to the previous waypoint, x looks along the segment that arrives, without roll": partial(
        _misaligned, align=Align.PREVIOUS
    ),
    "aligned to the next waypoint, x looks along the segment that leaves, without roll": partial(
        _misaligned, align=Align.NEXT
    ),
    "a polyline is linear in position and SLERP in orientation": _polyline_is_linear,
    "a spline is Barry and Goldman's pyramid with centripetal knots": _spline_is_the_pyramid,
    "any edits, undone and done again, give the same bytes at every step": _undo_and_redo,
    "a saved scene is the file that is loaded": _saved_is_loaded,
}
"""Functions by fact: each draws one case and returns what is wrong with it; empty: the fact holds."""
