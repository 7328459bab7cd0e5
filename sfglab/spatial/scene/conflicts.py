"""Warnings about a plan, and the poses of the agents at a time.

Distances and speeds are computed from samples: at each waypoint and every 50 ms. Warnings do not prevent an edit,
because an unfinished plan may have conflicts.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from itertools import combinations
from typing import TYPE_CHECKING

import numpy as np

from sfglab.spatial.scene.model import (
    AgentObject,
    ObstacleObject,
    TrajectoryObject,
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

PERIOD_S = 0.05  #: Time between samples, s.
_MOST_SAMPLES = 20_000  # a longer plan has a longer period
_ROUNDING = 1e-4  # share by which a speed may exceed its limit


class ConflictKind(Enum):
    """Kind of a warning about a plan."""

    AGENTS = "agents"  #: Two agents are closer than their radii and the scene's margin.
    OBSTACLE = "obstacle"  #: An agent touches an obstacle.
    ZONE = "zone"  #: An agent touches a forbidden zone.
    LIMIT = "limit"  #: A trajectory is faster than its agent can drive.
    OUTSIDE = "outside"  #: The centre of an agent is outside of the zones that it must be in.
    NO_AGENT = "no agent"  #: No agent follows a trajectory.
    NO_WAYPOINTS = "no waypoints"  #: A trajectory has no waypoint.


@dataclass(frozen=True, slots=True, kw_only=True)
class Conflict:
    """A warning about a plan."""

    kind: ConflictKind  #: Kind of the warning.
    objects: tuple[int, ...]  #: Ids of the objects concerned.
    text: str  #: Sentence with the value and the allowed value.
    time_s: float | None = None  #: Time of the worst sample, s; None: it does not depend on time.
    #: Place at that time, in the scene's frame, m; None: it has no place.
    position_m: Vec3 | None = None


def conflicts(scene: Scene) -> tuple[Conflict, ...]:
    """Return the warnings of a scene, by kind and in the order of the tree."""
    found: list[Conflict] = []
    if any(scene.all_of(AgentObject)):
        plan = _Plan(scene)
        for check in (_meetings, _touches, _too_fast, _outside):
            found += check(plan)
    return (*found, *_loose_ends(scene))


class _Plan:
    """The agents of a scene, with their positions at the same times."""

    def __init__(self, scene: Scene) -> None:
        self.scene = scene
        self.agents = list(scene.all_of(AgentObject))
        motions = [motion_of(scene.motion(agent.id)) for agent in self.agents]
        waypoints_s = np.concatenate([motion.times_s for motion in motions])
        first_s, last_s = float(waypoints_s.min()), float(waypoints_s.max())
        count = min(round((last_s - first_s) / PERIOD_S) + 1, _MOST_SAMPLES)
        # Rounded, because speeds between two times that are nearly the same are not exact.
        between_s = np.linspace(first_s, last_s, count).round(3)
        self.times_s = np.union1d(between_s, waypoints_s)
        positions = [motion.positions(self.times_s) for motion in motions]
        self.positions_m = np.array(positions)  # shape (agents, times, 3)

    def zones(self, rule: ZoneRule) -> list[ZoneObject]:
        """Return the zones with a rule."""
        return [zone for zone in self.scene.all_of(ZoneObject) if zone.rule is rule]

    def gaps_m(self, body: ObstacleObject | ZoneObject) -> Floats:
        """Return the distances of the agents' centres to a body, m, shape (agents, times); negative inside."""
        pose = self.scene.world_pose(body.id)
        local = (self.positions_m - pose.position_m) @ pose.matrix()[:3, :3]
        gaps = body.shape.distances_m(local.reshape(-1, 3))
        return gaps.reshape(local.shape[:2])

    def worst(  # noqa: PLR0913, PLR0917  # all parts of a warning
        self,
        kind: ConflictKind,
        index: int,
        other: int,
        excess: Floats,
        before: str,
        after: str,
        shown: Floats | None = None,
    ) -> Iterator[Conflict]:
        """Yield the warning about an agent's largest excess over what is allowed, if it is positive.

        The excess has one value per time. The text has the excess, or the value of `shown` at the same time.
        """
        at = int(excess.argmax())
        if excess[at] > 0.0:
            agent = self.agents[index]
            time_s = float(self.times_s[at])
            value = (excess if shown is None else shown)[at]
            x, y, z = self.positions_m[index, at].tolist()
            yield Conflict(
                kind=kind,
                objects=(agent.id, other),
                text=f"{agent.name} {before} {value:.3f} m{after} at {time_s:.3f} s",
                time_s=time_s,
                position_m=(x, y, z),
            )


def _meetings(plan: _Plan) -> Iterator[Conflict]:
    margin_m = plan.scene.margin_m
    for first, second in combinations(range(len(plan.agents)), 2):
        agent, other = plan.agents[first], plan.agents[second]
        apart_m = np.linalg.norm(plan.positions_m[second] - plan.positions_m[first], axis=1)
        least_m = agent.radius_m + other.radius_m + margin_m
        before = f"and {other.name}: centres are"
        after = f" apart (radii and margin: {least_m:.3f} m)"
        kind, excess = ConflictKind.AGENTS, least_m - apart_m
        yield from plan.worst(kind, first, other.id, excess, before, after, apart_m)


def _touches(plan: _Plan) -> Iterator[Conflict]:
    bodies: list[ObstacleObject | ZoneObject] = list(plan.scene.all_of(ObstacleObject))
    bodies += plan.zones(ZoneRule.FORBIDDEN)
    for body in bodies:
        is_zone = isinstance(body, ZoneObject)
        kind = ConflictKind.ZONE if is_zone else ConflictKind.OBSTACLE
        for index, gaps_m in enumerate(plan.gaps_m(body)):
            excess = plan.agents[index].radius_m - gaps_m
            yield from plan.worst(kind, index, body.id, excess, "is", f" inside {body.name}")


def _outside(plan: _Plan) -> Iterator[Conflict]:
    zones = plan.zones(ZoneRule.INSIDE)
    if zones:
        names = ", ".join(zone.name for zone in zones)
        gaps_m = np.min([plan.gaps_m(zone) for zone in zones], axis=0)
        for index, excess in enumerate(gaps_m):
            after = f" outside of {names}"
            yield from plan.worst(ConflictKind.OUTSIDE, index, zones[0].id, excess, "is", after)


def _too_fast(plan: _Plan) -> Iterator[Conflict]:
    ways_m = np.linalg.norm(np.diff(plan.positions_m, axis=1), axis=2)
    speeds_m_s = ways_m / np.diff(plan.times_s)
    for index, agent in enumerate(plan.agents):
        driven = plan.scene.driven_by(agent.id)
        if driven is not None and agent.speed_m_s is not None:
            limit_m_s = agent.speed_m_s * (1.0 + _ROUNDING)
            excess = np.append(speeds_m_s[index] - limit_m_s, -np.inf)
            after = f"/s faster than its limit of {agent.speed_m_s:g} m/s"
            yield from plan.worst(ConflictKind.LIMIT, index, driven.id, excess, "drives", after)


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
    """Planned pose and speed of an agent at one time."""

    agent: int  #: Id of the agent.
    name: str  #: Name of the agent.
    pose: Pose  #: Pose in the scene's frame.
    speed_m_s: float  #: Speed, m/s; 0 before the start, after the end and without a trajectory.
    driving: bool  #: Whether the agent's trajectory covers this time.


def ghosts(scene: Scene, time_s: float) -> tuple[Ghost, ...]:
    """Return the pose of each agent at a time, s; agents stand before and after their trajectory, and without one."""
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
