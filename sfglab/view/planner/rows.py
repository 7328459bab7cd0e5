"""The hierarchy as rows: what stands in the list of objects, in which order, and what is open. Pure."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from sfglab.spatial.scene import ROOT, SceneObject, TrajectoryObject, WaypointObject

if TYPE_CHECKING:
    from sfglab.spatial.scene import Scene


MOST_ROWS = 300
"""A browser shows so many buttons at once with ease."""


@dataclass(frozen=True, slots=True, kw_only=True)
class TreeRow:
    """One object in the list."""

    id: int  #: Its id.
    kind: str  #: Its kind's word.
    depth: int  #: How many parents it has.
    text: str  #: What people read.
    selected: bool  #: Whether it is selected.


def rows_of(scene: Scene, selection: tuple[int, ...]) -> tuple[TreeRow, ...]:
    """Return the rows of a scene in the tree's order, `MOST_ROWS` at most.

    Waypoints are many: only those of the trajectory that is selected, or holds what is selected, are shown.
    """
    opened = open_trajectory(scene, selection)
    rows = []
    for thing in scene.walk():
        if isinstance(thing, WaypointObject) and thing.parent != opened:
            continue
        rows.append(
            TreeRow(
                id=thing.id,
                kind=thing.kind,
                depth=_depth(scene, thing),
                text=title_of(thing),
                selected=thing.id in selection,
            )
        )
        if len(rows) == MOST_ROWS:
            break
    return tuple(rows)


def open_trajectory(scene: Scene, selection: tuple[int, ...]) -> int | None:
    """Return the trajectory that is worked on: the last one that is selected, itself or by a waypoint."""
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
        return f"{thing.time_ns / 1e9:.2f} s {thing.name}".rstrip() + f"  #{thing.id}"
    return f"{thing.name}  #{thing.id}"


def _depth(scene: Scene, thing: SceneObject) -> int:
    depth = 0
    while thing.parent != ROOT:
        thing, depth = scene.get(thing.parent), depth + 1
    return depth
