"""The nodes of the 3D view as values, and the functions that add them to viser's scene."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from sfglab.spatial.poses import Pose
from sfglab.spatial.scene.model import (
    AgentObject,
    Box,
    Cylinder,
    ObstacleObject,
    Shape,
    Sphere,
    TrajectoryObject,
    ZoneObject,
    ZoneRule,
)
from sfglab.units import NS_PER_S
from sfglab.view.planner import looks

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from sfglab.spatial.scene.conflicts import Conflict, Ghost
    from sfglab.spatial.scene.tree import Scene
    from sfglab.spatial.trajectory.path import Trajectory
    from sfglab.view.planner.looks import Colour

_Style = dict[str, Any]  # options of viser
_OBSTACLE: _Style = {"color": (125, 130, 140)}
_STYLES: dict[ZoneRule, _Style] = {
    ZoneRule.FORBIDDEN: {"color": (214, 60, 60), "opacity": 0.3, "cast_shadow": False},
    # Only the far walls are drawn, so that they hide nothing inside.
    ZoneRule.INSIDE: {"color": (70, 150, 90), "opacity": 0.2, "side": "back", "cast_shadow": False},
}
_CONFLICT: _Style = {"color": (255, 20, 20), "cast_shadow": False}
_MOST_CONFLICTS = 20
_MOST_TIMES = 100
_LINE_PX = 3.0
_AXES_M = 0.22
_LIFT_M = 0.12
_MARK_M = 0.22
_FLOOR_M = 40.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Look:
    """A node of the 3D view. If only its pose or text differ, the node is kept and changed."""

    #: Function that adds the node, given viser's scene, the name and `values`.
    add: Callable[..., Any]
    values: tuple[Any, ...]  #: Arguments of `add`, which can be compared.
    ids: tuple[int, ...] = ()  #: Objects that a click selects, one for each instance of the node.
    pose: Pose = field(default=Pose(), compare=False)  #: Pose in the scene's frame.
    text: str = field(default="", compare=False)  #: Text of a label.


Looks = dict[str, Look]  #: Nodes by name.


def looks_of_objects(scene: Scene, opened: int | None) -> Looks:
    """Return the nodes of obstacles, zones and trajectories; the opened trajectory is broader and has times."""
    colours = looks.agent_colours(scene)
    found: Looks = {}
    for thing in scene.walk():
        name = f"/objects/{thing.id}"
        if isinstance(thing, ObstacleObject | ZoneObject):
            style = _STYLES[thing.rule] if isinstance(thing, ZoneObject) else _OBSTACLE
            found[name] = Look(
                add=add_body,
                values=(thing.shape, style),
                # A click passes through to objects inside.
                ids=() if "side" in style else (thing.id,),
                pose=scene.world_pose(thing.id),
            )
        elif isinstance(thing, TrajectoryObject) and scene.held_by(thing.id):
            colour = colours.get(thing.agent or 0, looks.NOBODY)
            found |= _trajectory(scene, thing, name, colour, is_open=thing.id == opened)
    return found


def _trajectory(
    scene: Scene, thing: TrajectoryObject, name: str, colour: Colour, *, is_open: bool
) -> Looks:
    path = scene.world_trajectory(thing.id)
    assert path is not None  # the trajectory holds a waypoint
    held = scene.held_by(thing.id)
    found = {f"{name}/waypoints": Look(add=add_waypoints, values=(path,), ids=held)}
    if len(held) > 1:
        width_px = 2.0 * _LINE_PX if is_open else _LINE_PX
        found[f"{name}/line"] = Look(add=add_line, values=(path, colour, width_px))
    if is_open:
        for id_, waypoint in list(zip(held, path.waypoints, strict=True))[:_MOST_TIMES]:
            text = f"{waypoint.time_ns / NS_PER_S:g} s"
            found[f"{name}/time {id_}"] = _label(text, waypoint.pose.position_m, "center-right")
    return found


def looks_of_ghosts(scene: Scene, ghosts: Iterable[Ghost]) -> Looks:
    """Return the nodes of the agents at a time."""
    colours = looks.agent_colours(scene)
    found: Looks = {}
    for ghost in ghosts:
        name = f"/ghosts/{ghost.agent}"
        radius_m = scene.of_kind(ghost.agent, AgentObject).radius_m
        style = {"color": colours[ghost.agent], "opacity": 0.8}
        values = (Sphere(radius_m=radius_m), style)
        body = Look(add=add_body, values=values, ids=(ghost.agent,), pose=ghost.pose)
        text = f"{ghost.name} {ghost.speed_m_s:.2f} m/s" if ghost.driving else ghost.name
        below_m = np.subtract(ghost.pose.position_m, (0.0, 0.0, radius_m + _LIFT_M))
        found[f"{name}/body"] = body
        found[f"{name}/axes"] = Look(add=add_axes, values=(1.5 * radius_m,), pose=ghost.pose)
        found[f"{name}/label"] = _label(text, below_m, "top-center")
    return found


def looks_of_conflicts(conflicts: Iterable[Conflict]) -> Looks:
    """Return the marks of conflicts that have a place."""
    found: Looks = {}
    for index, conflict in enumerate(conflicts):
        if conflict.position_m is None or len(found) >= 2 * _MOST_CONFLICTS:
            continue
        name, position = f"/conflicts/{index}", conflict.position_m
        mark = (Sphere(radius_m=_MARK_M), _CONFLICT)
        text = f"⚠ {conflict.kind.value}"
        if conflict.time_s is not None:
            text += f" {conflict.time_s:.1f} s"
        beside_m = np.add(position, (2.0 * _MARK_M, 0.0, 0.0))
        found[f"{name}/mark"] = Look(add=add_body, values=mark, pose=Pose.at(position))
        found[f"{name}/label"] = _label(text, beside_m, "center-left")
    return found


def _label(text: str, position_m: Iterable[float], anchor: str) -> Look:
    return Look(add=add_label, values=(anchor,), pose=Pose.at(position_m), text=text)


# --- viser ------------------------------------------------------------------------------------


def add_floor(api: Any) -> None:
    """Add a grid at height zero to viser's scene `api`."""
    api.add_grid(
        "/floor",
        _FLOOR_M,
        _FLOOR_M,
        cell_size=1.0,
        section_size=5.0,
        cell_color=(222, 225, 230),
        section_color=(190, 195, 205),
        fade_distance=4.0 * _FLOOR_M,
    )


def add_body(api: Any, name: str, shape: Shape, style: _Style) -> Any:
    """Add a box, sphere or cylinder to viser's scene, and return its node."""
    if isinstance(shape, Box):
        return api.add_box(name, dimensions=shape.size_m, **style)
    if isinstance(shape, Cylinder):
        return api.add_cylinder(name, shape.radius_m, shape.height_m, **style)
    return api.add_icosphere(name, shape.radius_m, **style)


def add_line(api: Any, name: str, path: Trajectory, colour: Colour, width_px: float) -> Any:
    """Add the line of a trajectory to viser's scene, and return its node."""
    points, linear = looks.line_of(path), looks.linear(colour)
    return api.add_line_segments(name, points, linear, thickness=width_px, thickness_units="screen")


def add_waypoints(api: Any, name: str, path: Trajectory) -> Any:
    """Add the axes of all waypoints to viser's scene, and return their one node with instances."""
    return api.add_batched_axes(
        name,
        np.array([looks.wxyz(waypoint.pose) for waypoint in path.waypoints]),
        np.array([waypoint.pose.position_m for waypoint in path.waypoints]),
        axes_length=_AXES_M,
        axes_radius=_AXES_M / 10.0,
    )


def add_axes(api: Any, name: str, length_m: float) -> Any:
    """Add the axes of an agent, with a length in metres, to viser's scene, and return their node."""
    return api.add_frame(name, axes_length=length_m, axes_radius=length_m / 30.0)


def add_label(api: Any, name: str, anchor: str) -> Any:
    """Add an empty label to viser's scene, and return its node."""
    return api.add_label(name, "", anchor=anchor)
