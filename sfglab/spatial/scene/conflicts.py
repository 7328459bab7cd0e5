"""Warnings about a plan, and the agents at a time.

Distances and speeds are computed from samples: at each waypoint and each 50 ms. Warnings refuse nothing, because
an unfinished plan may be wrong.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from functools import cached_property
from itertools import combinations
from typing import TYPE_CHECKING

import numpy as np

from sfglab.spatial.scene.model import (
    AgentObject,
    ObstacleObject,
    TrajectoryObject,
    WaypointObject,
    ZoneObject,
    ZoneRule,
)
from sfglab.spatial.trajectory.motion import motion_of, sample
from sfglab.units import NS_PER_S

if TYPE_CHECKING:
    from collections.abc import Iterator

    from sfglab.spatial.poses import Pose, Vec3
    from sfglab.spatial.scene.model import Floats
    from sfglab.spatial.scene.tree import Scene
    from sfglab.spatial.trajectory.path import Trajectory

PERIOD_S = 0.05  #: Time between samples, s.
_MOST_SAMPLES = 20_000  # a longer plan has a longer period
_ROUNDING = 1e-9


class ConflictKind(Enum):
    """Kind of a warning."""

    AGENTS = "agents"  #: Two agents are closer than their radii and the scene's margin.
    OBSTACLE = "obstacle"  #: An agent touches an obstacle.
    ZONE = "zone"  #: An agent touches a forbidden zone.
    LIMIT = "limit"  #: A trajectory is faster than its agent can drive.
    OUTSIDE = "outside"  #: A waypoint is outside of the zones that waypoints must be in.
    NO_AGENT = "no agent"  #: No agent follows a trajectory.
    NO_WAYPOINTS = "no waypoints"  #: A trajectory has no waypoint.


@dataclass(frozen=True, slots=True, kw_only=True)
class Conflict:
    """A warning."""

    kind: ConflictKind  #: Kind of the warning.
    objects: tuple[int, ...]  #: Ids of the objects concerned.
    text: str  #: Sentence with the value and the allowed value.
    time_s: float | None = None  #: Time of the worst sample, s; None: it does not depend on time.
    #: Place at that time, in the scene's frame, m; None: it has no place.
    position_m: Vec3 | None = None


def conflicts(scene: Scene) -> tuple[Conflict, ...]:
    """Return the warnings of a scene, by kind and in the order of the tree."""
    sampled = _Sampled(scene)
    return (
        *_meetings(sampled),
        *_touches(sampled),
        *_too_fast(sampled),
        *_outside(scene),
        *_loose_ends(scene),
    )


def sample_times(*trajectories: Trajectory) -> Floats:
    """Return the sorted times of all waypoints, and times each 50 ms between the first and the last, s."""
    waypoints = np.concatenate([motion_of(one).times_s for one in trajectories])
    first, last = float(waypoints.min()), float(waypoints.max())
    count = min(int((last - first) / PERIOD_S) + 1, _MOST_SAMPLES)
    period_s = max(PERIOD_S, (last - first) / _MOST_SAMPLES)
    return np.unique(np.concatenate([first + period_s * np.arange(count), waypoints]))


class _Sampled:
    """The agents of a scene, with their positions at the same times."""

    def __init__(self, scene: Scene) -> None:
        self.scene = scene
        self.agents = list(scene.all_of(AgentObject))
        self.motions = {agent.id: scene.motion(agent.id) for agent in self.agents}

    @cached_property
    def times_s(self) -> Floats:
        """Times of the samples, shape (n,), s."""
        return sample_times(*self.motions.values())

    @cached_property
    def positions_m(self) -> dict[int, Floats]:
        """Positions by agent, each of shape (n, 3), m."""
        return {id_: motion_of(one).positions(self.times_s) for id_, one in self.motions.items()}

    def when(self, index: int) -> str:
        """Return the time of a sample, in words."""
        return f"at {self.times_s[index]:.3f} s"

    def conflict(
        self, kind: ConflictKind, objects: tuple[int, ...], index: int, text: str
    ) -> Conflict:
        """Return a warning about the first of some objects at one sample."""
        x, y, z = self.positions_m[objects[0]][index].tolist()
        return Conflict(
            kind=kind,
            objects=objects,
            text=text,
            time_s=float(self.times_s[index]),
            position_m=(x, y, z),
        )


def _meetings(sampled: _Sampled) -> Iterator[Conflict]:
    margin_m = sampled.scene.margin_m
    for a, b in combinations(sampled.agents, 2):
        apart_m = np.linalg.norm(sampled.positions_m[a.id] - sampled.positions_m[b.id], axis=1)
        index = int(apart_m.argmin())
        clearance_m = float(apart_m[index]) - a.radius_m - b.radius_m
        if clearance_m >= margin_m:
            continue
        gap = f"are {clearance_m:.3f} m apart"
        if clearance_m < 0.0:
            gap = f"overlap by {-clearance_m:.3f} m"
        text = f"{a.name} and {b.name} {gap} {sampled.when(index)}; allowed: {margin_m:g} m"
        yield sampled.conflict(ConflictKind.AGENTS, (a.id, b.id), index, text)


def _touches(sampled: _Sampled) -> Iterator[Conflict]:
    scene = sampled.scene
    bodies: list[tuple[ConflictKind, ObstacleObject | ZoneObject]] = []
    bodies += [(ConflictKind.OBSTACLE, one) for one in scene.all_of(ObstacleObject)]
    for zone in scene.all_of(ZoneObject):
        if zone.rule is ZoneRule.FORBIDDEN:
            bodies.append((ConflictKind.ZONE, zone))
    for kind, body in bodies:
        pose = scene.world_pose(body.id)
        axes = pose.matrix()[:3, :3]
        for agent in sampled.agents:
            inside = (sampled.positions_m[agent.id] - pose.position_m) @ axes
            gaps_m = body.shape.distances_m(inside) - agent.radius_m
            index = int(gaps_m.argmin())
            if gaps_m[index] < 0.0:
                inside_m = f"{-gaps_m[index]:.3f} m inside {body.name}"
                text = f"{agent.name} is {inside_m} {sampled.when(index)}"
                yield sampled.conflict(kind, (agent.id, body.id), index, text)


def _too_fast(sampled: _Sampled) -> Iterator[Conflict]:
    for agent in sampled.agents:
        driven = sampled.scene.driven_by(agent.id)
        if driven is None or agent.speed_m_s is None:
            continue
        speeds = sample(sampled.motions[agent.id], sampled.times_s).speeds_m_s
        index = int(speeds.argmax())
        if speeds[index] > agent.speed_m_s * (1.0 + _ROUNDING):
            allowed = f"allowed: {agent.speed_m_s:g} m/s"
            drives = f"{agent.name} drives at {speeds[index]:.3f} m/s"
            text = f"{drives} {sampled.when(index)}; {allowed}"
            yield sampled.conflict(ConflictKind.LIMIT, (agent.id, driven.id), index, text)


def _outside(scene: Scene) -> Iterator[Conflict]:
    zones = [zone for zone in scene.all_of(ZoneObject) if zone.rule is ZoneRule.INSIDE]
    places = [(zone.shape, scene.world_pose(zone.id).inverse()) for zone in zones]
    for waypoint in scene.all_of(WaypointObject) if zones else ():
        position = scene.world_pose(waypoint.id).position_m
        gaps = []
        for shape, inverse in places:
            gaps.append(float(shape.distances_m(np.array([inverse.apply(position)]))[0]))
        if min(gaps) > 0.0:
            nearest = zones[gaps.index(min(gaps))].name
            name = scene.get(waypoint.parent).name
            yield Conflict(
                kind=ConflictKind.OUTSIDE,
                objects=(waypoint.parent, waypoint.id),
                text=f"{name}: waypoint {waypoint.id} is {min(gaps):.3f} m outside of {nearest}",
                time_s=waypoint.time_ns / NS_PER_S,
                position_m=position,
            )


def _loose_ends(scene: Scene) -> Iterator[Conflict]:
    for driven in scene.all_of(TrajectoryObject):
        if driven.agent is None:
            text = f"{driven.name}: no agent follows this trajectory"
            yield Conflict(kind=ConflictKind.NO_AGENT, objects=(driven.id,), text=text)
        if not scene.held_by(driven.id):
            text = f"{driven.name}: there is no waypoint"
            yield Conflict(kind=ConflictKind.NO_WAYPOINTS, objects=(driven.id,), text=text)


@dataclass(frozen=True, slots=True, kw_only=True)
class Ghost:
    """An agent at a time."""

    agent: int  #: Id of the agent.
    name: str  #: Name of the agent.
    pose: Pose  #: Pose in the scene's frame.
    speed_m_s: float  #: Speed, m/s; 0 before the start, after the end and without a trajectory.
    driving: bool  #: Whether its trajectory covers this time.


def ghosts(scene: Scene, time_s: float) -> tuple[Ghost, ...]:
    """Return each agent at a time; it stands before its trajectory, after it, and without one."""
    found = []
    for agent in scene.all_of(AgentObject):
        motion = scene.motion(agent.id)
        at = sample(motion, time_s)
        is_covered = motion.start_ns <= time_s * NS_PER_S <= motion.end_ns
        ghost = Ghost(
            agent=agent.id,
            name=agent.name,
            pose=at.pose(0),
            speed_m_s=float(at.speeds_m_s[0]),
            driving=is_covered and scene.driven_by(agent.id) is not None,
        )
        found.append(ghost)
    return tuple(found)
