"""Which object of the capture system stands for which frame: a YAML file, read strictly.

Paper A, section 4.5, limitation (1): the official receiver "rigidly maps Vicon tracked object IDs to ROS 2 TF
frame IDs". Knows keys and values, and says for every refusal file, key, what was given and what is allowed.
"""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from typing import TYPE_CHECKING

from sfglab.documents import Document, DocumentError, Place
from sfglab.spatial.mocap.capture import MocapError
from sfglab.spatial.mocap.tracking import Limits
from sfglab.spatial.poses import Pose, PoseError

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping
    from pathlib import Path

    from sfglab.documents import KeyPath, Section


_ABSENT = object()


class MappingError(DocumentError, MocapError):
    """A mapping that does not say what it must; see `DocumentError` for what it knows."""


@dataclass(frozen=True, slots=True, kw_only=True)
class MappedObject:
    """One object of the capture system."""

    id: str  #: Its name there.
    via: str  #: The proxy: the frame of the agent's tree that the object stands for, as "agent_x/markers".
    #: The frame that is published, as "agent_x/base"; empty for whatever is the root of the agent's tree.
    frame: str = ""
    #: Where `via` is in the object's own frame (``object_from_via``); the same place by default, else as
    #: `estimate_offset` finds it.
    offset: Pose = field(default_factory=Pose)


@dataclass(frozen=True, slots=True, kw_only=True)
class MocapMapping:
    """All objects, and what they can physically do.

    Raises:
        MappingError: Two objects stand for one frame, or a frame is the world.
    """

    world: str  #: The frame in which the capture system measures.
    objects: Mapping[str, MappedObject]  #: The objects, by their ids.
    limits: Limits = field(default_factory=Limits)  #: What no object outdoes.

    def __post_init__(self) -> None:
        def refusal(path: KeyPath, frame: str, allowed: str) -> DocumentError:
            return MappingError(Place(file="mapping", key=".".join(map(str, path))), frame, allowed)

        _check_apart(self.world, self.objects, refusal)


def load_mapping(path: Path) -> MocapMapping:
    """Read a mapping from a file.

    Args:
        path: A YAML file, such as ``data/mocap/two_agents.yaml``.

    Raises:
        MappingError: It cannot be read, or does not say what it must; says where.
    """
    try:
        return _mapping(Document.of_file(path))
    except DocumentError as error:
        raise MappingError(error.place, error.given, error.allowed) from error


def read_mapping(text: str, *, file: str = "mapping.yaml") -> MocapMapping:
    """Read a mapping from the text of a YAML file.

    Args:
        text: What stands in the file.
        file: Its name, for messages.

    Raises:
        MappingError: It does not say what it must; says where.
    """
    try:
        return _mapping(Document(text, file))
    except DocumentError as error:
        raise MappingError(error.place, error.given, error.allowed) from error


def _mapping(document: Document) -> MocapMapping:
    top = document.section()
    world = _frame(top, "world")
    if not top.get("objects"):
        raise top.refusal("objects", top.get("objects"), "a mapping of object ids, at least one")
    objects = {id_: _object(id_, section) for id_, section in top.members("objects")}
    limits = _limits(top.section("limits"))
    top.close()

    def refusal(path: KeyPath, frame: str, allowed: str) -> DocumentError:
        return DocumentError(document.place(path), frame, allowed)

    _check_apart(world, objects, refusal)
    return MocapMapping(world=world, objects=objects, limits=limits)


def _object(id_: str, section: Section) -> MappedObject:
    via = _frame(section, "via")
    frame = _frame(section, "frame", default="")
    offset = Pose() if section.get("offset", _ABSENT) is _ABSENT else _offset(section.section("offset"))
    section.close()
    return MappedObject(id=id_, via=via, frame=frame, offset=offset)


def _offset(section: Section) -> Pose:
    position, quat = section.numbers("position_m", 3), section.numbers("quat_xyzw", 4, Pose().quat_xyzw)
    section.close()
    try:
        return Pose(position_m=position, quat_xyzw=quat)
    except PoseError as error:
        raise section.refusal("quat_xyzw", error.given, error.allowed) from error


def _limits(section: Section) -> Limits:
    limits = Limits(**{f.name: section.positive(f.name, f.default) for f in fields(Limits)})
    section.close()
    return limits


def _frame(section: Section, key: str, default: str | None = None) -> str:
    value = section.get(key) if default is None else section.get(key, _ABSENT)
    if value is _ABSENT and default is not None:
        return default
    if not isinstance(value, str) or not value or value != value.strip() or value.startswith("/"):
        raise section.refusal(key, value, "the name of a frame, without leading slash")
    return value


def _check_apart(
    world: str, objects: Mapping[str, MappedObject], refusal: Callable[[KeyPath, str, str], DocumentError]
) -> None:
    """Refuse frames that two objects would move."""
    taken: dict[str, KeyPath] = {world: ("world",)}
    for id_, mapped in objects.items():
        places = {"via": mapped.via} | ({"frame": mapped.frame} if mapped.frame else {})
        for key, frame in places.items():
            path: KeyPath = ("objects", id_, key)
            before = taken.setdefault(frame, path)
            if before[:2] != path[:2]:
                holder = ".".join(map(str, before))
                raise refusal(path, frame, f"a frame of its own; {holder} has that one")
