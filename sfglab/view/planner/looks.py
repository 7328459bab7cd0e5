"""A scene as values for a screen: rows, colours, lines and first camera. The module does not depend on viser."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from sfglab.spatial.scene.model import (
    ROOT,
    AgentObject,
    SceneObject,
    TrajectoryObject,
    WaypointObject,
)
from sfglab.spatial.trajectory.motion import motion_of
from sfglab.units import NS_PER_S

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from sfglab.spatial.poses import Pose, Quat
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
"""Colours of agents, distinct for people with colour blindness (after Okabe and Ito)."""
_PER_SEGMENT = 24
_MOST_SAMPLES = 4000
_NEAR_M = 4.0
_FROM = np.array([0.2, -1.3, 1.1])


def agent_colours(scene: Scene) -> dict[int, Colour]:
    """Return the colour of each agent by id; the order of ids decides, so that renaming and sorting change none."""
    ids = sorted(agent.id for agent in scene.all_of(AgentObject))
    return {id_: _AGENTS[i % len(_AGENTS)] for i, id_ in enumerate(ids)}


def wxyz(pose: Pose) -> Quat:
    """Return a pose's quaternion in viser's order: w, x, y, z."""
    x, y, z, w = pose.quat_xyzw
    return (w, x, y, z)


def linear(colour: Colour) -> NDArray[np.uint8]:
    """Return an sRGB colour, 0 to 255, as linear RGB, shape (3,), which viser expects for lines (IEC 61966-2-1)."""
    shares = np.asarray(colour, float) / 255.0
    bent = np.where(shares <= 0.04045, shares / 12.92, ((shares + 0.055) / 1.055) ** 2.4)
    return np.asarray(np.round(255.0 * bent), np.uint8)


def line_of(trajectory: Trajectory) -> NDArray[np.float32]:
    """Return a trajectory as line segments, metres, shape (n, 2, 3)."""
    knots = motion_of(trajectory).times_s
    if len(knots) < 2:
        return np.zeros((0, 2, 3), np.float32)
    each = max(1, min(_PER_SEGMENT, _MOST_SAMPLES // (len(knots) - 1)))
    places = np.arange((len(knots) - 1) * each + 1) / each
    times = np.interp(places, np.arange(len(knots)), knots)
    points = motion_of(trajectory).positions(times).astype(np.float32)
    return np.stack([points[:-1], points[1:]], axis=1)


def camera_for(scene: Scene) -> tuple[list[float], list[float]]:
    """Return position and target, metres, of a camera that sees the origins of all objects obliquely from above."""
    places = [scene.world_pose(thing.id).position_m for thing in scene.walk()]
    points = np.array(places or [(0.0, 0.0, 0.0)])
    low, high = points.min(axis=0), points.max(axis=0)
    middle = (low + high) / 2.0
    away = max(_NEAR_M, float(np.linalg.norm(high - low)) / 2.0) * _FROM
    return (middle + away).tolist(), middle.tolist()


MOST_ROWS = 300  #: Largest number of rows, which a browser still shows without delay.


def rows_of(scene: Scene, selection: tuple[int, ...]) -> list[tuple[SceneObject, int]]:
    """Return up to `MOST_ROWS` objects in the order of the tree, each with its depth.

    Of the waypoints, only those of the opened trajectory are included.
    """
    opened = open_trajectory(scene, selection)
    depths = {ROOT: -1}
    rows = []
    for thing in scene.walk():
        depths[thing.id] = depths[thing.parent] + 1
        if not isinstance(thing, WaypointObject) or thing.parent == opened:
            rows.append((thing, depths[thing.id]))
    return rows[:MOST_ROWS]


def open_trajectory(scene: Scene, selection: tuple[int, ...]) -> int | None:
    """Return the id of the opened trajectory: the last one that is selected, directly or by one of its waypoints."""
    for id_ in reversed(selection):
        thing = scene.objects.get(id_)
        if isinstance(thing, TrajectoryObject):
            return thing.id
        if isinstance(thing, WaypointObject):
            return thing.parent
    return None


def title_of(thing: SceneObject) -> str:
    """Return an object's name with its id, and for a waypoint also its time."""
    if isinstance(thing, WaypointObject):
        return f"{thing.time_ns / NS_PER_S:.2f} s {thing.name}".rstrip() + f"  #{thing.id}"
    return f"{thing.name}  #{thing.id}"
