"""Scenes from text, read strictly: whatever is not understood is refused, with file and line.

Refuses to know defaults (`objects`) and what objects may be to each other (`tree`).
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

from sfglab.documents import Document, DocumentError, suggestion
from sfglab.spatial.poses import Pose, PoseError
from sfglab.spatial.scene.errors import SceneError
from sfglab.spatial.scene.objects import KINDS, ROOT, SceneObject, TrajectoryObject, WaypointObject
from sfglab.spatial.scene.tree import SCENE_PROPERTIES, Draft, Scene
from sfglab.spatial.scene.writing import FORMAT
from sfglab.spatial.trajectory import LATEST_NS

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from sfglab.documents import Section
    from sfglab.spatial.scene.properties import Property


_NS_PER_S = 1_000_000_000
_LATEST_S = LATEST_NS // _NS_PER_S


def read_scene(text: str, *, file: str = "scene.yaml") -> Scene:
    """Return the scene of a YAML text.

    Aligned waypoints look along their segments afterwards, also where somebody edited the text by hand.

    Args:
        text: What stands in the file.
        file: Its name, for messages.

    Raises:
        SceneError: It is not YAML, holds a key that is unknown or stands there twice, lacks one, or says what a
            scene cannot be: an id given twice, a parent inside its child, a time that another waypoint has or
            that runs backwards, a number that is not finite, a quaternion of length zero.
    """
    try:
        return _scene(Document(text, file).section())
    except DocumentError as error:
        raise SceneError.of_document(error) from error


def _scene(top: Section) -> Scene:
    version = top.get("sfglab_scene")
    if version is True or version != FORMAT:
        raise top.refusal("sfglab_scene", version, f"{FORMAT}, the version that is read here")
    values = _properties(top, SCENE_PROPERTIES)
    next_id = top.whole("next_id", low=1)
    objects = [thing for section in top.items("objects") for thing in _objects(section)]
    top.close()
    draft = Draft(Scene(**values))
    _insert_all(draft, objects)
    scene = draft.scene()
    if next_id < scene.next_id:
        raise top.refusal("next_id", next_id, f"a number above every id, from {scene.next_id}")
    return replace(scene, next_id=next_id)


Placed = tuple[str, SceneObject]
"""Where in the file, and what."""


def _objects(section: Section) -> Iterator[Placed]:
    """Yield an object and, for a trajectory, its waypoints, each with where it stands."""
    kind = _kind(section)
    pose = Pose()
    if section.has("pose"):
        inner = section.section("pose")
        pose = _pose(inner)
        inner.close()
    thing = kind(
        id=section.whole("id", low=1),
        name=section.get("name"),
        parent=section.whole("parent", ROOT, low=ROOT),
        pose=pose,
        **_properties(section, kind.properties),
    )
    yield str(section.here), thing
    if kind is TrajectoryObject:
        yield from _waypoints(section, thing.id)
    section.close()


def _kind(section: Section) -> type[SceneObject]:
    word = section.get("kind")
    known = [name for name, kind in KINDS.items() if kind is not WaypointObject]
    if word not in known:
        raise section.refusal("kind", word, " or ".join(known) + suggestion(word, known))
    return KINDS[word]


def _waypoints(section: Section, parent: int) -> Iterator[Placed]:
    before_ns = -1
    for line in section.items("waypoints"):
        time_ns = _time_ns(line, before_ns)
        waypoint = WaypointObject(
            id=line.whole("id", low=1),
            name=line.get("name", ""),
            parent=parent,
            pose=_pose(line),
            time_ns=time_ns,
            **_properties(line, WaypointObject.properties),
        )
        line.close()
        yield str(line.here), waypoint
        before_ns = time_ns


def _time_ns(section: Section, before_ns: int) -> int:
    seconds = section.get("time_s")
    if isinstance(seconds, bool) or not isinstance(seconds, int | float) or not 0 <= seconds <= _LATEST_S:
        raise section.refusal("time_s", seconds, f"seconds from 0 to {_LATEST_S}")
    time_ns = round(seconds * _NS_PER_S)
    if time_ns <= before_ns:
        allowed = f"a time above the previous waypoint's, {before_ns / _NS_PER_S}"
        raise section.refusal("time_s", seconds, allowed)
    return time_ns


def _pose(section: Section) -> Pose:
    position = section.numbers("xyz_m", 3)
    quat = section.numbers("quat_xyzw", 4, (0.0, 0.0, 0.0, 1.0))
    try:
        return Pose.at(position, quat)
    except PoseError as error:  # the numbers are finite, so it is the quaternion's length
        raise section.refusal("quat_xyzw", list(quat), "a quaternion of length 1") from error


def _properties(section: Section, properties: Iterable[Property]) -> dict[str, Any]:
    return {
        prop.name: prop.typed(section.get(prop.name), str(section.place_of(prop.name)))
        for prop in properties
        if section.has(prop.name)
    }


def _insert_all(draft: Draft, objects: list[Placed]) -> None:
    """Put objects into a draft: parents before children, agents before trajectories, siblings in order."""
    by_id: dict[int, Placed] = {}
    for place, thing in objects:
        if thing.id in by_id:
            raise SceneError(place, f"id {thing.id}", f"an id of its own; {by_id[thing.id][0]} has this one")
        by_id[thing.id] = (place, thing)
    held: dict[int, list[int]] = {}
    for _, thing in objects:
        held.setdefault(thing.parent, []).append(thing.id)
    pending = [ROOT]
    while pending:
        for id_ in held.pop(pending.pop(), ()):
            _insert(draft, *by_id[id_])
            pending.append(id_)
    for lost in (id_ for ids in held.values() for id_ in ids):
        _refuse_loop(by_id, lost)
        _insert(draft, *by_id[lost])  # which says that there is no such parent
    _give_agents(draft, by_id)


def _refuse_loop(by_id: dict[int, Placed], start: int) -> None:
    chain: list[int] = []
    above = start
    while above in by_id:
        if above in chain:
            loop = " in ".join(map(str, [*chain[chain.index(above) :], above]))
            raise SceneError(f"{by_id[above][0]}, parent", f"a loop, {loop}", "a tree")
        chain.append(above)
        above = by_id[above][1].parent


def _insert(draft: Draft, place: str, thing: SceneObject) -> None:
    if isinstance(thing, TrajectoryObject):
        thing = replace(thing, agent=None)  # agents may stand further down
    try:
        draft.insert(thing)
    except SceneError as error:
        raise SceneError(f"{place}: {error.place}", error.given, error.allowed) from error


def _give_agents(draft: Draft, by_id: dict[int, Placed]) -> None:
    for place, thing in by_id.values():
        if not isinstance(thing, TrajectoryObject) or thing.agent is None:
            continue
        try:
            draft.put(thing)
        except SceneError as error:
            raise SceneError(f"{place}: {error.place}", error.given, error.allowed) from error
