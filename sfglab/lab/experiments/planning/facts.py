"""Facts of paper A, section 4.5, for any trajectory and any edits; each is tried on random cases."""

from __future__ import annotations

import tempfile
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from sfglab.spatial import Pose
from sfglab.spatial.scene.editor import Editor
from sfglab.spatial.scene.files import load_scene, save_scene, scene_text
from sfglab.spatial.trajectory.motion import motion_of, pose_at
from sfglab.spatial.trajectory.path import Align, Interpolation, Trajectory, aligned_quat
from sfglab.units import NS_PER_S

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    Floats = NDArray[np.float64]
    Fact = Callable[[np.random.Generator], str]

_REACH_M = 5.0
_EITHER_WAY_RAD = 3.1
"""Angle beyond which two turns are nearly equally short, and rounding chooses between them."""


def random_pose(rng: np.random.Generator) -> Pose:
    """Return a random pose: each coordinate within 5 m of the origin, with any orientation."""
    return Pose.at(rng.uniform(-_REACH_M, _REACH_M, 3), rng.normal(size=4))


def _misaligned(rng: np.random.Generator, align: Align) -> str:
    """Align the middle one of three waypoints; return its deviation from the segment's direction; empty if none."""
    positions = rng.uniform(-_REACH_M, _REACH_M, (3, 3))
    arrives, leaves = np.diff(positions, axis=0)
    segment = arrives if align is Align.PREVIOUS else leaves
    turned = Pose.at(quat_xyzw=aligned_quat(positions.tolist(), 1, align) or ()).matrix()
    off = float(np.linalg.norm(turned[:3, 0] - segment / np.linalg.norm(segment)))
    roll = abs(float(turned[2, 1]))
    return f"x axis off by {off:.1g}, roll {roll:.1g}" if max(off, roll) > 1e-9 else ""


def _polyline_is_linear(rng: np.random.Generator) -> str:
    times_ns = np.cumsum(rng.integers(NS_PER_S // 20, 3 * NS_PER_S, 5)).tolist()
    path = Trajectory.of((time_ns, random_pose(rng)) for time_ns in times_ns)
    for before, after in pairwise(path.waypoints):
        share = float(rng.uniform())
        time_ns = before.time_ns + share * (after.time_ns - before.time_ns)
        found = pose_at(path, time_ns / NS_PER_S)
        wanted = before.pose.interpolate(after.pose, share)
        either_way = before.pose.angle_rad(after.pose) > _EITHER_WAY_RAD
        within_rad = np.pi if either_way else 1e-5
        if not found.same_as(wanted, within_m=1e-6, within_rad=within_rad):
            return f"{found} instead of {wanted}"
    return ""


def _spline_is_the_pyramid(rng: np.random.Generator) -> str:
    """Compare the spline with Barry and Goldman's pyramid, for times that grow like the knots.

    For such times the spline is a cubic in time.
    """
    points = rng.uniform(-_REACH_M, _REACH_M, (4, 3))
    distances_m = np.linalg.norm(np.diff(points, axis=0), axis=1)
    knots = np.cumsum([0.0, *np.sqrt(distances_m)])
    timed = ((round(u * NS_PER_S), Pose.at(p)) for u, p in zip(knots, points, strict=True))
    spline = Trajectory.of(timed, Interpolation.CATMULL_ROM)
    at = float(rng.uniform(knots[1], knots[2]))
    found = motion_of(spline).positions(at)[0]
    off = float(np.linalg.norm(found - _pyramid(points, knots, at)))
    return f"off by {off:.1g} m" if off > 1e-6 else ""


def _pyramid(points: Floats, knots: Floats, at: float) -> Floats:
    """Return the spline through four points between the second and the third, as Barry and Goldman define it."""

    def between(one: Floats, other: Floats, start: float, end: float) -> Floats:
        return one + (other - one) * (at - start) / (end - start)

    first = [between(points[i], points[i + 1], knots[i], knots[i + 1]) for i in range(3)]
    second = [between(first[i], first[i + 1], knots[i], knots[i + 2]) for i in range(2)]
    return between(second[0], second[1], knots[1], knots[2])


def edited(rng: np.random.Generator) -> tuple[Editor, list[str]]:
    """Return an editor after edits in random order, and the text of the scene before and after each."""
    editor = Editor()
    hall = editor.add("group", "hall")
    go2 = editor.add("agent", "go2", parent=hall)
    drone = editor.add("agent", "drone")
    path = editor.add("trajectory", "path", agent=drone)
    for _ in range(3):
        point = editor.insert_waypoint(path, pose=random_pose(rng), align="next")
    edits = [
        partial(editor.add, "agent", '"quoted" \\', pose=random_pose(rng)),
        partial(editor.insert_waypoint, path, time_ns=NS_PER_S // 2),
        partial(editor.set_pose, hall, random_pose(rng)),
        partial(editor.rename, hall, "a: Halle 5 (Süd)"),
        partial(editor.rename, go2, "null"),
        partial(editor.move, path, hall),
        partial(editor.remove, drone),
        partial(editor.set_waypoint_time, point, int(rng.integers(3 * NS_PER_S, 9 * NS_PER_S))),
        partial(editor.align, path, Align.PREVIOUS),
        partial(editor.set_property, path, "interpolation", Interpolation.CATMULL_ROM),
    ]
    texts = [scene_text(editor.scene)]
    for number in rng.permutation(len(edits)):
        edits[number]()
        texts.append(scene_text(editor.scene))
    return editor, texts


def _undo_and_redo(rng: np.random.Generator) -> str:
    editor, texts = edited(rng)
    for step, wanted in ((editor.undo, texts[-2::-1]), (editor.redo, texts[1:])):
        for text in wanted:
            step()
            if scene_text(editor.scene) != text:
                return f"another scene before: {editor.redo_label}"
    return ""


def _saved_is_loaded(rng: np.random.Generator) -> str:
    editor, _ = edited(rng)
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "scene.yaml"
        save_scene(editor.scene, file)
        return "" if load_scene(file) == editor.scene else "another scene was loaded"


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
