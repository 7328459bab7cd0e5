"""Edits of trajectories in time and heading, as values. Refuses to know how re-timing works (`trajectory`)."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from sfglab.spatial.scene.errors import SceneError
from sfglab.spatial.scene.objects import AgentObject, TrajectoryObject, WaypointObject, place_of
from sfglab.spatial.scene.tree import Draft, Scene
from sfglab.spatial.trajectory import Align, Limits, Trajectory, TrajectoryError, retimed, stretched

if TYPE_CHECKING:
    from collections.abc import Callable


@dataclass(frozen=True, slots=True, kw_only=True)
class SetTime:
    """Give a waypoint another time; where that is beyond a neighbour's, their order changes."""

    id: int  #: Which waypoint.
    time_ns: int  #: Its time, which no other waypoint of the trajectory has.

    @property
    def label(self) -> str:
        """What the edit does."""
        return "Change time"

    def apply(self, scene: Scene) -> Scene:
        """Return the scene with the waypoint at its new time."""
        draft = Draft(scene)
        draft.put(replace(scene.of_kind(self.id, WaypointObject), time_ns=self.time_ns))
        return draft.scene()


@dataclass(frozen=True, slots=True, kw_only=True)
class AlignWaypoints:
    """Let all waypoints of a trajectory look along a neighbouring segment, or none. Paper A, section 4.5."""

    id: int  #: The trajectory.
    align: Align  #: Along which segment.

    @property
    def label(self) -> str:
        """What the edit does."""
        return "Align waypoints"

    def apply(self, scene: Scene) -> Scene:
        """Return the scene with every waypoint aligned."""
        thing = scene.of_kind(self.id, TrajectoryObject)
        if not isinstance(self.align, Align):
            raise SceneError(f"{place_of(thing)}, align", self.align, " or ".join(a.value for a in Align))
        draft = Draft(scene)
        for id_ in scene.held_by(self.id):
            waypoint = scene.of_kind(id_, WaypointObject)
            draft.put(replace(waypoint, align=self.align))
        return draft.scene()


@dataclass(frozen=True, slots=True, kw_only=True)
class Retime:
    """Slow a trajectory down along its path until limits hold."""

    id: int  #: The trajectory.
    limits: Limits | None = None  #: What must hold; its agent's where it is None.

    @property
    def label(self) -> str:
        """What the edit does."""
        return "Keep to limits"

    def apply(self, scene: Scene) -> Scene:
        """Return the scene with the trajectory slowed down."""
        thing = scene.of_kind(self.id, TrajectoryObject)
        limits = self.limits
        if limits is None:
            if thing.agent is None:
                raise SceneError(f"{place_of(thing)}, limits", None, "limits, or an agent that drives it")
            limits = scene.of_kind(thing.agent, AgentObject).limits
        given = limits
        return _retimed(scene, thing, lambda trajectory: retimed(trajectory, given))


@dataclass(frozen=True, slots=True, kw_only=True)
class Stretch:
    """Let a trajectory take longer, or less long, from its first waypoint's time on."""

    id: int  #: The trajectory.
    factor: float  #: By how much every duration grows.

    @property
    def label(self) -> str:
        """What the edit does."""
        return "Stretch in time"

    def apply(self, scene: Scene) -> Scene:
        """Return the scene with the trajectory stretched."""
        thing = scene.of_kind(self.id, TrajectoryObject)
        return _retimed(scene, thing, lambda trajectory: stretched(trajectory, self.factor))


def _retimed(scene: Scene, thing: TrajectoryObject, change: Callable[[Trajectory], Trajectory]) -> Scene:
    trajectory = scene.trajectory(thing.id)
    if trajectory is None:
        raise SceneError(place_of(thing), "no waypoints", "a trajectory with waypoints")
    try:
        times_ns = [w.time_ns for w in change(trajectory).waypoints]
    except TrajectoryError as error:
        raise SceneError(f"{place_of(thing)}, times", str(error), "times that a trajectory may have") from error
    draft = Draft(scene)
    draft.put_times(thing.id, times_ns)
    return draft.scene()
