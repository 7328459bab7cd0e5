"""Where everybody is at a time: what a time slider shows."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from sfglab.spatial.scene.objects import AgentObject
from sfglab.spatial.trajectory import motion_of, sample

if TYPE_CHECKING:
    from sfglab.spatial.poses import Pose
    from sfglab.spatial.scene.tree import Scene


@dataclass(frozen=True, slots=True, kw_only=True)
class Ghost:
    """An agent at a time."""

    agent: int  #: Its id.
    name: str  #: Its name.
    pose: Pose  #: Where it is in the scene's frame.
    speed_m_s: float  #: How fast; 0 before its trajectory's start, after its end, and without one.
    driving: bool  #: Its trajectory covers this time.


def ghosts(scene: Scene, time_s: float) -> tuple[Ghost, ...]:
    """Return every agent at a time, in the tree's order.

    Args:
        scene: Whose agents.
        time_s: Seconds since the scene's time 0. Before its start and after its end an agent stands at its
            trajectory's ends; one without trajectory stands where its own pose is.
    """
    return tuple(_ghost(scene, agent, time_s) for agent in scene.all_of(AgentObject))


def time_span_s(scene: Scene) -> tuple[float, float]:
    """Return the earliest and the latest time of any agent's waypoint, 0 and 0 where nobody moves."""
    times = [motion_of(scene.motion(a.id)).times_s for a in scene.all_of(AgentObject) if scene.driven_by(a.id)]
    return (min(float(t[0]) for t in times), max(float(t[-1]) for t in times)) if times else (0.0, 0.0)


def _ghost(scene: Scene, agent: AgentObject, time_s: float) -> Ghost:
    motion = scene.motion(agent.id)
    found = sample(motion, time_s)
    return Ghost(
        agent=agent.id,
        name=agent.name,
        pose=found.pose(0),
        speed_m_s=float(found.speeds_m_s[0]),
        driving=scene.driven_by(agent.id) is not None and motion.start_ns <= time_s * 1e9 <= motion.end_ns,
    )
