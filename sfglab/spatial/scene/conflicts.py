"""Warnings about a plan, and where everybody is at a time.

Warnings, not refusals: a plan in the making may be wrong. Distances come from `trajectory.clearance`: exact for
polylines, within a millimetre for splines.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass
from enum import Enum
from itertools import combinations
from typing import TYPE_CHECKING

import numpy as np

from sfglab.spatial.scene.objects import (
    AgentObject,
    ObstacleObject,
    TrajectoryObject,
    WaypointObject,
    ZoneObject,
    ZoneRule,
)
from sfglab.spatial.trajectory.clearance import (
    Approach,
    ObstacleApproach,
    Shape,
    closest_approach,
    closest_to_shape,
)
from sfglab.spatial.trajectory.limits import limit_violations
from sfglab.spatial.trajectory.motion import motion_of, sample
from sfglab.units import NS_PER_S

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from sfglab.spatial.poses import Pose, Vec3
    from sfglab.spatial.scene.tree import Scene
    from sfglab.spatial.trajectory.path import Trajectory


_TOLERANCE_M = 1e-3

_Body = tuple["ConflictKind", "ObstacleObject | ZoneObject", "Pose"]


class ConflictKind(Enum):
    """What is wrong."""

    AGENTS = "agents"  #: Two agents come closer than their radii and the scene's margin.
    OBSTACLE = "obstacle"  #: An agent touches an obstacle.
    ZONE = "zone"  #: An agent touches a forbidden zone.
    LIMIT = "limit"  #: A trajectory asks more of its agent than it can do.
    OUTSIDE = "outside"  #: A waypoint lies in no zone of those that waypoints must lie in.
    NO_AGENT = "no agent"  #: Nobody drives a trajectory.
    NO_WAYPOINTS = "no waypoints"  #: A trajectory has none, so its agent stands.


@dataclass(frozen=True, slots=True, kw_only=True)
class Conflict:
    """A warning."""

    kind: ConflictKind  #: What is wrong.
    objects: tuple[int, ...]  #: Ids of whom it concerns.
    text: str  #: One sentence for people, with value and what is allowed.
    time_s: float | None = None  #: When it is worst; None where time does not matter.
    #: Where then, in the scene's frame; None where place does not matter.
    position_m: Vec3 | None = None


def conflicts(scene: Scene) -> tuple[Conflict, ...]:
    """Return all warnings of a scene, by kind and in the tree's order."""
    return (
        *_meetings(scene),
        *_touches(scene),
        *_over_limits(scene),
        *_outside(scene),
        *_loose_ends(scene),
    )


@functools.lru_cache(maxsize=4096)
def _approach(a: Trajectory, b: Trajectory) -> Approach:
    """Return the closest approach of two agents; while one of many is dragged, the others' are still known."""
    return closest_approach(a, b, tolerance_m=_TOLERANCE_M)


@functools.lru_cache(maxsize=4096)
def _to_body(motion: Trajectory, shape: Shape, pose: Pose) -> ObstacleApproach:
    return closest_to_shape(motion, shape, pose, tolerance_m=_TOLERANCE_M)


def _meetings(scene: Scene) -> Iterator[Conflict]:
    agents: list[AgentObject] = list(scene.all_of(AgentObject))
    motions = {agent.id: scene.motion(agent.id) for agent in agents}
    for a, b in combinations(agents, 2):
        found = _approach(motions[a.id], motions[b.id])
        clearance_m = found.distance_m - a.radius_m - b.radius_m
        if clearance_m < scene.margin_m:
            gap = (
                f"are {clearance_m:.3f} m apart"
                if clearance_m >= 0
                else f"overlap by {-clearance_m:.3f} m"
            )
            x, y, z = (
                (p + q) / 2.0 for p, q in zip(found.position_a_m, found.position_b_m, strict=True)
            )
            yield Conflict(
                kind=ConflictKind.AGENTS,
                objects=(a.id, b.id),
                text=f"{a.name} and {b.name} {gap} {_when(found.time_s)}; allowed: {scene.margin_m:g} m",
                time_s=found.time_s,
                position_m=(x, y, z),
            )


def _touches(scene: Scene) -> Iterator[Conflict]:
    obstacles = [(ConflictKind.OBSTACLE, thing) for thing in scene.all_of(ObstacleObject)]
    zones = [
        (ConflictKind.ZONE, z) for z in scene.all_of(ZoneObject) if z.rule is ZoneRule.FORBIDDEN
    ]
    bodies = [(kind, thing, scene.world_pose(thing.id)) for kind, thing in [*obstacles, *zones]]
    for agent in scene.all_of(AgentObject) if bodies else ():
        motion = scene.motion(agent.id)
        for kind, thing, pose in (bodies[i] for i in _near(motion, bodies, agent.radius_m)):
            found = _to_body(motion, thing.shape, pose)
            clearance_m = found.clearance_m - agent.radius_m
            if clearance_m < 0.0:
                yield Conflict(
                    kind=kind,
                    objects=(agent.id, thing.id),
                    text=f"{agent.name} is {-clearance_m:.3f} m inside {thing.name} {_when(found.time_s)}",
                    time_s=found.time_s,
                    position_m=found.position_m,
                )


def _near(motion: Trajectory, bodies: list[_Body], radius_m: float) -> NDArray[np.intp]:
    """Return which bodies could be touched at all, by boxes around segments and spheres around bodies."""
    low, high = motion_of(motion).boxes_m()
    centres = np.array([pose.position_m for _, _, pose in bodies])[:, None]
    reaches = np.array([thing.shape.reach_m for _, thing, _ in bodies])
    beyond = np.maximum(np.maximum(low - centres, centres - high), 0.0)
    return np.flatnonzero(np.linalg.norm(beyond, axis=2).min(axis=1) <= reaches + radius_m)


def _over_limits(scene: Scene) -> Iterator[Conflict]:
    for driven in scene.all_of(TrajectoryObject):
        motion = scene.world_trajectory(driven.id)
        if driven.agent is None or motion is None:
            continue
        agent: AgentObject = scene.of_kind(driven.agent, AgentObject)
        held = scene.held_by(driven.id)
        for found in limit_violations(motion, agent.limits):
            yield Conflict(
                kind=ConflictKind.LIMIT,
                objects=(agent.id, driven.id, held[found.segment]),
                text=f"{agent.name}: {found.quantity.value} {found.value:.3f} {_when(found.time_s)}; "
                f"allowed: {found.limit:g}",
                time_s=found.time_s,
                position_m=found.position_m,
            )


def _outside(scene: Scene) -> Iterator[Conflict]:
    zones = [z for z in scene.all_of(ZoneObject) if z.rule is ZoneRule.INSIDE]
    places = [(zone.shape, scene.world_pose(zone.id).inverse()) for zone in zones]
    for waypoint in scene.all_of(WaypointObject) if zones else ():
        position = scene.world_pose(waypoint.id).position_m
        gaps = [
            float(shape.distances_m(np.array([inverse.apply(position)]))[0])
            for shape, inverse in places
        ]
        if min(gaps) > 0.0:
            nearest = zones[gaps.index(min(gaps))].name
            name = scene.get(waypoint.parent).name
            yield Conflict(
                kind=ConflictKind.OUTSIDE,
                objects=(waypoint.parent, waypoint.id),
                text=f"{name}: waypoint {waypoint.id} lies {min(gaps):.3f} m outside of {nearest}",
                time_s=waypoint.time_ns / NS_PER_S,
                position_m=position,
            )


def _loose_ends(scene: Scene) -> Iterator[Conflict]:
    for driven in scene.all_of(TrajectoryObject):
        if driven.agent is None:
            text = f"{driven.name}: nobody drives this trajectory"
            yield Conflict(kind=ConflictKind.NO_AGENT, objects=(driven.id,), text=text)
        if not scene.held_by(driven.id):
            text = f"{driven.name}: there is no waypoint"
            yield Conflict(kind=ConflictKind.NO_WAYPOINTS, objects=(driven.id,), text=text)


def _when(time_s: float) -> str:
    return f"at {time_s:.3f} s"


@dataclass(frozen=True, slots=True, kw_only=True)
class Ghost:
    """An agent at a time."""

    agent: int  #: Its id.
    name: str  #: Its name.
    pose: Pose  #: Where it is in the scene's frame.
    speed_m_s: float  #: How fast; 0 before its trajectory's start, after its end, and without one.
    driving: bool  #: Its trajectory covers this time.


def ghosts(scene: Scene, time_s: float) -> tuple[Ghost, ...]:
    """Return every agent at a time of the scene, standing before its trajectory, after it or without one."""
    return tuple(_ghost(scene, agent, time_s) for agent in scene.all_of(AgentObject))


def _ghost(scene: Scene, agent: AgentObject, time_s: float) -> Ghost:
    motion = scene.motion(agent.id)
    found = sample(motion, time_s)
    return Ghost(
        agent=agent.id,
        name=agent.name,
        pose=found.pose(0),
        speed_m_s=float(found.speeds_m_s[0]),
        driving=scene.driven_by(agent.id) is not None
        and motion.start_ns <= time_s * NS_PER_S <= motion.end_ns,
    )
