"""What the toolbar adds, and where: sensible first values that people then drag. Pure, over an editor."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from sfglab.spatial.poses import Pose
from sfglab.spatial.scene import (
    ROOT,
    AgentObject,
    Group,
    SceneError,
    TrajectoryObject,
    WaypointObject,
)
from sfglab.spatial.trajectory import Align, Box, Trajectory
from sfglab.view.planner.rows import open_trajectory

if TYPE_CHECKING:
    from sfglab.spatial.poses import Vec3
    from sfglab.spatial.scene import Editor, Scene


ADDABLE = ("agent", "obstacle", "zone", "trajectory", "group")
"""What the toolbar adds."""
_STEP_S = 2.0
_STEP_M = 1.0
_NS_PER_S = 1_000_000_000


def add(editor: Editor, kind: str, at_m: Vec3) -> int:
    """Add an object, in the selected group where there is one, and select it.

    Args:
        editor: Where.
        kind: One of `ADDABLE`.
        at_m: Near where, in the scene's frame. A trajectory of a selected agent begins where that agent is.

    Returns:
        Its id.
    """
    scene = editor.scene
    parent = next((i for i in editor.selection if isinstance(scene.get(i), Group)), ROOT)
    name = _free_name(scene, kind)
    if kind == "trajectory":
        id_ = _add_trajectory(editor, name, at_m, parent)
    else:
        x, y, z = at_m
        lift = {"agent": 0.3, "obstacle": 0.5, "zone": 0.5}.get(kind, 0.0)
        pose = scene.world_pose(parent).inverse() @ Pose(position_m=(x, y, z + lift))
        shape = {"shape": Box(size_m=(1.0, 1.0, 1.0))} if kind in {"obstacle", "zone"} else {}
        id_ = editor.add(kind, name, parent=parent, pose=pose, **shape)
    editor.select(id_)
    return id_


def add_waypoint(editor: Editor) -> int:
    """Add a waypoint after the last one of the trajectory that is worked on, and select it."""
    id_ = _worked_on(editor)
    path = editor.scene.trajectory(id_)
    if path is None:
        made = editor.insert_waypoint(id_, align=Align.NEXT)
    else:
        last = path.waypoints[-1]
        ahead = np.array(last.pose.apply((_STEP_M, 0.0, 0.0)))
        if len(path.waypoints) > 1:
            way = np.subtract(last.pose.position_m, path.waypoints[-2].pose.position_m)
            ahead = np.array(last.pose.position_m) + way
        pose = Pose.at(ahead.tolist(), last.pose.quat_xyzw)
        before = path.waypoints[-2].time_ns if len(path.waypoints) > 1 else last.time_ns - 2 * _NS_PER_S
        align = editor.scene.of_kind(editor.scene.held_by(id_)[-1], WaypointObject).align
        time_ns = 2 * last.time_ns - before
        made = editor.insert_waypoint(id_, time_ns=time_ns, pose=pose, align=align)
    editor.select(made)
    return made


def insert_waypoint(editor: Editor) -> int:
    """Add a waypoint at the slider's time, where the trajectory that is worked on is then, and select it."""
    id_ = _worked_on(editor)
    made = editor.insert_waypoint(id_, time_ns=max(0, round(editor.time_s * _NS_PER_S)), align=Align.NEXT)
    editor.select(made)
    return made


def _add_trajectory(editor: Editor, name: str, at_m: Vec3, parent: int) -> int:
    scene = editor.scene
    agents = (i for i in editor.selection if isinstance(scene.get(i), AgentObject))
    agent = next((i for i in agents if scene.driven_by(i) is None), None)
    start = Pose(position_m=at_m) if agent is None else scene.world_pose(agent)
    start = scene.world_pose(parent).inverse() @ start
    end = Pose(position_m=start.apply((_STEP_S * _STEP_M, 0.0, 0.0)), quat_xyzw=start.quat_xyzw)
    path = Trajectory.of([(0, start), (round(_STEP_S * _NS_PER_S), end)])
    return editor.add_trajectory(path, name, agent=agent, parent=parent)


def _worked_on(editor: Editor) -> int:
    found = open_trajectory(editor.scene, editor.selection)
    if found is None:
        driven = (editor.scene.driven_by(i) for i in editor.selection if i in editor.scene.objects)
        found = next((t.id for t in driven if t is not None), None)
    if found is None:
        one = [t.id for t in editor.scene.all_of(TrajectoryObject)]
        if len(one) != 1:
            raise SceneError("selection", None, "a selected trajectory, to add a waypoint to")
        found = one[0]
    return found


def _free_name(scene: Scene, kind: str) -> str:
    taken = {thing.name for thing in scene.objects.values()}
    return next(name for i in range(1, len(taken) + 2) if (name := f"{kind} {i}") not in taken)
