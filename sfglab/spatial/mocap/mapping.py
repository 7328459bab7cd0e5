"""Which object of the capture system stands for which frame: a YAML file, read strictly.

Paper A, section 4.5, limitation (1): the official receiver "rigidly maps Vicon tracked object IDs to ROS 2 TF
frame IDs". Knows keys and values, and says for every refusal file, key, what was given and what is allowed.
"""

from __future__ import annotations

import difflib
from dataclasses import dataclass, field, fields
from typing import TYPE_CHECKING, Any

from sfglab.spatial.mocap.capture import MocapError
from sfglab.spatial.mocap.tracking import Limits
from sfglab.spatial.poses import Pose, PoseError

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping
    from pathlib import Path

    import yaml

__all__ = ["MappedObject", "MappingError", "MocapMapping", "load_mapping", "read_mapping"]


class MappingError(MocapError, ValueError):
    """A mapping that does not say what it must.

    Attributes:
        place: File and key.
        given: What stands there; None where nothing does.
        allowed: What is allowed in its place.
    """

    def __init__(self, place: str, given: object, allowed: str) -> None:
        self.place = place
        self.given = given
        self.allowed = allowed
        said = "nothing is given" if given is None else f"given {given!r}"
        super().__init__(f"{place}: {said}, allowed: {allowed}")


@dataclass(frozen=True, slots=True, kw_only=True)
class MappedObject:
    """One object of the capture system.

    Attributes:
        id: Its name there.
        via: The proxy: the frame of the agent's tree that the object stands for, as "agent_x/markers".
        frame: The frame that is published, as "agent_x/base"; empty for whatever is the root of the agent's
            tree.
        offset: Where `via` is in the object's own frame (``object_from_via``); the same place by default, else
            as `estimate_offset` finds it.
    """

    id: str
    via: str
    frame: str = ""
    offset: Pose = field(default_factory=Pose)


@dataclass(frozen=True, slots=True, kw_only=True)
class MocapMapping:
    """All objects, and what they can physically do.

    Attributes:
        world: The frame in which the capture system measures.
        objects: The objects, by their ids.
        limits: What no object outdoes.

    Raises:
        MappingError: Two objects stand for one frame, or a frame is the world.
    """

    world: str
    objects: Mapping[str, MappedObject]
    limits: Limits = field(default_factory=Limits)

    def __post_init__(self) -> None:
        _check_apart(self.world, self.objects, "mapping")


def load_mapping(path: Path) -> MocapMapping:
    """Read a mapping from a file.

    Args:
        path: A YAML file, such as ``data/mocap/two_agents.yaml``.

    Raises:
        MappingError: It cannot be read, or does not say what it must; says where.
    """
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise MappingError(path.name, str(path), f"a readable text file ({error})") from error
    return read_mapping(text, file=path.name)


def read_mapping(text: str, *, file: str = "mapping.yaml") -> MocapMapping:
    """Read a mapping from the text of a YAML file.

    Args:
        text: What stands in the file.
        file: Its name, for messages.

    Raises:
        MappingError: It does not say what it must; says where.
    """
    top = _section(_parsed(text, file), file, required=("world", "objects"), optional=("limits",))
    objects = top["objects"]
    if not isinstance(objects, dict) or not objects:
        raise MappingError(f"{file}: objects", objects, "a mapping of object ids, at least one")
    world = _frame(top["world"], f"{file}: world")
    mapped = {id_: _object(id_, value, f"{file}: objects.{id_}") for id_, value in objects.items()}
    _check_apart(world, mapped, file)
    return MocapMapping(world=world, objects=mapped, limits=_limits(top.get("limits", {}), f"{file}: limits"))


def _object(id_: str, value: Any, place: str) -> MappedObject:
    section = _section(value, place, required=("via",), optional=("frame", "offset"))
    frame = _frame(section["frame"], f"{place}.frame") if "frame" in section else ""
    offset = _offset(section["offset"], f"{place}.offset") if "offset" in section else Pose()
    return MappedObject(id=id_, via=_frame(section["via"], f"{place}.via"), frame=frame, offset=offset)


def _offset(value: Any, place: str) -> Pose:
    section = _section(value, place, required=("position_m",), optional=("quat_xyzw",))
    numbers = {key: _numbers(section[key], f"{place}.{key}") for key in section}
    try:
        return Pose.at(**numbers, place=place)
    except PoseError as error:
        raise MappingError(error.place, error.given, error.allowed) from error


def _numbers(value: Any, place: str) -> list[float]:
    if not isinstance(value, list) or any(isinstance(v, bool) or not isinstance(v, int | float) for v in value):
        raise MappingError(place, value, "a list of numbers")
    return value


def _limits(value: Any, place: str) -> Limits:
    known = tuple(f.name for f in fields(Limits))
    section = _section(value, place, optional=known)
    for key, number in section.items():
        if isinstance(number, bool) or not isinstance(number, int | float) or not number > 0:
            raise MappingError(f"{place}.{key}", number, "a number above 0")
    return Limits(**{key: float(number) for key, number in section.items()})


def _frame(value: Any, place: str) -> str:
    if not isinstance(value, str) or not value or value != value.strip() or value.startswith("/"):
        raise MappingError(place, value, "the name of a frame, without leading slash")
    return value


def _section(
    value: Any, place: str, *, required: tuple[str, ...] = (), optional: tuple[str, ...] = ()
) -> dict[str, Any]:
    known = (*required, *optional)
    if not isinstance(value, dict):
        raise MappingError(place, value, f"a mapping with {', '.join(known)}")
    for key in value:
        if key not in known:
            near = difflib.get_close_matches(key, known, n=1)
            hint = f"; did you mean {near[0]!r}?" if near else ""
            raise MappingError(f"{place}.{key}", key, f"{', '.join(known)}{hint}")
    for key in required:
        if key not in value:
            raise MappingError(f"{place}.{key}", None, "this key, which is required")
    return value


def _check_apart(world: str, objects: Mapping[str, MappedObject], file: str) -> None:
    """Refuse frames that two objects would move."""
    taken: dict[str, str] = {world: "world"}
    for id_, mapped in objects.items():
        places = {"via": mapped.via} | ({"frame": mapped.frame} if mapped.frame else {})
        for key, frame in places.items():
            place = f"objects.{id_}.{key}"
            before = taken.setdefault(frame, place)
            if before != place and not before.startswith(f"objects.{id_}."):
                raise MappingError(f"{file}: {place}", frame, f"a frame of its own; {before} has that one")


def _parsed(text: str, file: str) -> Any:
    import yaml

    loader = yaml.SafeLoader(text)
    try:
        node = loader.get_single_node()
        return {} if node is None else _value(loader, node, file, "")
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        line = f":{mark.line + 1}" if mark else ""
        raise MappingError(f"{file}{line}", getattr(error, "problem", None) or str(error), "YAML") from error
    finally:
        loader.dispose()


def _value(loader: yaml.SafeLoader, node: yaml.Node, file: str, key: str) -> Any:
    import yaml

    if isinstance(node, yaml.MappingNode):
        pairs: dict[str, Any] = {}
        for name, inner in _pairs(node, file, key):
            pairs[name] = _value(loader, inner, file, f"{key}.{name}".lstrip("."))
        return pairs
    if isinstance(node, yaml.SequenceNode):
        return [_value(loader, item, file, f"{key}[{i}]") for i, item in enumerate(node.value)]
    return loader.construct_object(node)


def _pairs(node: yaml.MappingNode, file: str, key: str) -> Iterator[tuple[str, yaml.Node]]:
    seen: set[str] = set()
    for name, inner in node.value:
        place = f"{file}:{name.start_mark.line + 1}: {f'{key}.{name.value}'.lstrip('.')}"
        if name.tag != "tag:yaml.org,2002:str":
            raise MappingError(place, name.value, "a key that is text; put it in quotes")
        if name.value in seen:
            raise MappingError(place, name.value, "each key once")
        seen.add(name.value)
        yield name.value, inner
