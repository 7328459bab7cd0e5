"""A scene as numbers and words for a screen: rows, colours, lines, outlines, first camera. Pure, no viser."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import islice
from typing import TYPE_CHECKING

import numpy as np

from sfglab.spatial.scene.model import (
    ROOT,
    AgentObject,
    Box,
    Cylinder,
    ObstacleObject,
    SceneObject,
    Shape,
    Sphere,
    TrajectoryObject,
    WaypointObject,
    ZoneObject,
)
from sfglab.spatial.trajectory.motion import motion_of
from sfglab.units import NS_PER_S

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import NDArray

    from sfglab.spatial.poses import Pose, Quat, Vec3
    from sfglab.spatial.scene.tree import Scene
    from sfglab.spatial.trajectory.path import Trajectory


Colour = tuple[int, int, int]

NOBODY: Colour = (110, 110, 110)  #: Colour of a trajectory without an agent.
_AGENTS: tuple[Colour, ...] = (
    (0, 114, 178),
    (213, 94, 0),
    (0, 158, 115),
    (204, 121, 167),
    (120, 90, 200),
    (170, 130, 0),
    (86, 180, 233),
    (150, 60, 60),
)
"""Told apart also by people who do not see all colours, after Okabe and Ito."""
_PER_SEGMENT = 24
_MOST_SAMPLES = 4000
_ROUND = 24


def agent_colours(scene: Scene) -> dict[int, Colour]:
    """Return every agent's colour by id, in order of ids, so that no renaming or sorting changes one."""
    ids = sorted(agent.id for agent in scene.all_of(AgentObject))
    return {id_: _AGENTS[i % len(_AGENTS)] for i, id_ in enumerate(ids)}


def wxyz(pose: Pose) -> Quat:
    """Return an orientation with its real part first."""
    x, y, z, w = pose.quat_xyzw
    return (w, x, y, z)


def linear(colour: Colour) -> NDArray[np.uint8]:
    """Return an sRGB colour as the linear one that viser takes for lines, which otherwise look pale."""
    shares = np.asarray(colour, float) / 255.0
    bent = np.where(shares <= 0.04045, shares / 12.92, ((shares + 0.055) / 1.055) ** 2.4)
    return np.asarray(np.round(255.0 * bent), np.uint8)


def line_of(trajectory: Trajectory) -> NDArray[np.float32]:
    """Return a trajectory as line segments, shape (n, 2, 3)."""
    knots = motion_of(trajectory).times_s
    if len(knots) < 2:
        return np.zeros((0, 2, 3), np.float32)
    each = max(1, min(_PER_SEGMENT, _MOST_SAMPLES // (len(knots) - 1)))
    places = np.arange((len(knots) - 1) * each + 1) / each
    times = np.interp(places, np.arange(len(knots)), knots)
    points = motion_of(trajectory).positions(times).astype(np.float32)
    return np.stack([points[:-1], points[1:]], axis=1)


def outline_of(shape: Shape) -> NDArray[np.float32]:
    """Return the edges of a body in its own frame, shape (n, 2, 3)."""
    if isinstance(shape, Box):
        corners = np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], float)
        pairs = [
            (a, b) for i, a in enumerate(corners) for b in corners[i:] if np.abs(a - b).sum() == 2.0
        ]
        return np.asarray(np.array(pairs) * (np.array(shape.size_m) / 2.0), np.float32)
    if isinstance(shape, Cylinder):
        ring = _ring(shape.radius_m)
        half = np.array([0.0, 0.0, shape.height_m / 2.0])
        posts = np.stack([ring[:: _ROUND // 4, 0] - half, ring[:: _ROUND // 4, 0] + half], axis=1)
        return np.concatenate([ring - half, ring + half, posts]).astype(np.float32)
    assert isinstance(shape, Sphere)
    ring = _ring(shape.radius_m)
    return np.concatenate([ring, ring[..., [0, 2, 1]], ring[..., [2, 0, 1]]]).astype(np.float32)


def camera_for(scene: Scene) -> tuple[Vec3, Vec3]:
    """Return position and target of a camera that sees the whole scene from above and behind."""
    centres: Mapping[int, Vec3] = {
        thing.id: scene.world_pose(thing.id).position_m
        for thing in scene.walk()
        if isinstance(thing, AgentObject | ObstacleObject | ZoneObject | WaypointObject)
    }
    reach = {
        t.id: t.shape.reach_m for t in scene.walk() if isinstance(t, ObstacleObject | ZoneObject)
    }
    if not centres:
        return (-5.0, -6.0, 5.0), (0.0, 0.0, 0.0)
    points = np.array(list(centres.values()))
    middle = (points.min(axis=0) + points.max(axis=0)) / 2.0
    extent = np.linalg.norm(points - middle, axis=1) + np.array(
        [reach.get(i, 0.5) for i in centres]
    )
    away = max(2.5, float(extent.max())) * np.array([0.15, -1.0, 0.85])
    x, y, z = (float(c) for c in middle)
    a, b, c = (float(v) for v in middle + away)
    return (a, b, c), (x, y, z)


def _ring(radius_m: float) -> NDArray[np.float64]:
    turn = np.linspace(0.0, 2.0 * np.pi, _ROUND + 1)
    points = radius_m * np.stack([np.cos(turn), np.sin(turn), np.zeros_like(turn)], axis=1)
    return np.stack([points[:-1], points[1:]], axis=1)


MOST_ROWS = 300  #: Largest number of rows: a browser shows as many buttons with ease.


@dataclass(frozen=True, slots=True, kw_only=True)
class TreeRow:
    """One object in the list."""

    id: int  #: Id of the object.
    kind: str  #: Kind of the object.
    depth: int  #: Number of holders above it.
    text: str  #: Label of the row.
    selected: bool  #: Whether it is selected.


def rows_of(scene: Scene, selection: tuple[int, ...]) -> tuple[TreeRow, ...]:
    """Return up to `MOST_ROWS` rows of a scene in order, waypoints of the opened trajectory alone."""
    opened = open_trajectory(scene, selection)
    shown = (t for t in scene.walk() if not isinstance(t, WaypointObject) or t.parent == opened)
    return tuple(
        TreeRow(
            id=thing.id,
            kind=thing.kind,
            depth=_depth(scene, thing),
            text=title_of(thing),
            selected=thing.id in selection,
        )
        for thing in islice(shown, MOST_ROWS)
    )


def open_trajectory(scene: Scene, selection: tuple[int, ...]) -> int | None:
    """Return the trajectory that is selected last, itself or by a waypoint."""
    for id_ in reversed(selection):
        thing = scene.objects.get(id_)
        if isinstance(thing, TrajectoryObject):
            return thing.id
        if isinstance(thing, WaypointObject):
            return thing.parent
    return None


def title_of(thing: SceneObject) -> str:
    """Return an object's name with its id; a waypoint's time too."""
    if isinstance(thing, WaypointObject):
        return f"{thing.time_ns / NS_PER_S:.2f} s {thing.name}".rstrip() + f"  #{thing.id}"
    return f"{thing.name}  #{thing.id}"


def _depth(scene: Scene, thing: SceneObject) -> int:
    depth = 0
    while thing.parent != ROOT:
        thing, depth = scene.get(thing.parent), depth + 1
    return depth
