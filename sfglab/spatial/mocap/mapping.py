"""Objects of the capture system and the frames they stand for: read strictly, placed through a proxy frame.

Paper A, section 4.5, limitation (1): the official receiver "rigidly maps Vicon tracked object IDs to ROS 2 TF
frame IDs". Eq. 4: ``T_map_base = T_map_markers * T_markers_base``. Who publishes the markers gives the robot's
tree a second root. So the frame that is published is the root of that tree, and the proxy, which stands
somewhere within it, is where the cameras see it. Pure.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Annotated

from sfglab.documents import ByName, Document, ReadAs
from sfglab.errors import InvalidValueError, KeyPath, key_text
from sfglab.spatial.mocap.tracking import Capture, Limits, MocapError
from sfglab.spatial.poses import Pose, PoseError, PoseKeys, StampedTransform

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from sfglab.spatial.frames.buffer import FrameBuffer


def _frame(value: str) -> str:
    if value != value.strip() or value.startswith("/"):
        raise InvalidValueError((), value, "the name of a frame, without leading slash")
    return value


def _offset(keys: PoseKeys) -> Pose:
    try:
        return Pose(position_m=keys.position_m, quat_xyzw=keys.quat_xyzw)
    except PoseError as error:
        raise InvalidValueError("quat_xyzw", error.given, error.allowed) from error


Frame = Annotated[str, ReadAs(str, _frame)]


@dataclass(frozen=True, slots=True, kw_only=True)
class MappedObject:
    """One object of the capture system."""

    id: str  #: Its name there.
    #: The proxy: the frame of the agent's tree that the object stands for, as "agent_x/markers".
    via: Frame
    #: The frame that is published, as "agent_x/base"; empty for whatever is the root of the agent's tree.
    frame: Frame = ""
    #: Where `via` is in the object's own frame (``object_from_via``), as measured; the same place by default.
    offset: Annotated[Pose, ReadAs(PoseKeys, _offset)] = field(default_factory=Pose)


@dataclass(frozen=True, slots=True, kw_only=True)
class MocapMapping:
    """All objects, and what they can physically do.

    Raises:
        InvalidValueError: There is no object, two stand for one frame, or a frame is the world.
    """

    world: Frame  #: The frame in which the capture system measures.
    objects: Annotated[dict[str, MappedObject], ByName("id")]  #: The objects, by their ids.
    limits: Limits = field(default_factory=Limits)  #: What no object outdoes.

    def __post_init__(self) -> None:
        if not self.objects:
            raise InvalidValueError(
                "objects", self.objects, "a mapping of object ids, at least one"
            )
        taken: dict[str, KeyPath] = {self.world: ("world",)}
        for id_, mapped in self.objects.items():
            places = {"via": mapped.via} | ({"frame": mapped.frame} if mapped.frame else {})
            for key, frame in places.items():
                path: KeyPath = ("objects", id_, key)
                before = taken.setdefault(frame, path)
                if before[:2] != path[:2]:
                    raise _taken(path, frame, before)


def _taken(path: KeyPath, frame: str, before: KeyPath) -> InvalidValueError:
    return InvalidValueError(path, frame, f"a frame of its own; {key_text(before)} has that one")


def load_mapping(path: Path | str) -> MocapMapping:
    """Read a mapping's YAML file, as ``data/mocap/two_agents.yaml``; DocumentError says where it is wrong."""
    return Document.of_file(path).read(MocapMapping)


def read_mapping(text: str, *, file: str = "mapping.yaml") -> MocapMapping:
    """Read a mapping from a YAML file's text, its name for messages; DocumentError as of `load_mapping`."""
    return Document(text, file).read(MocapMapping)


class PlacingError(MocapError):
    """A frame that must not be published, because the tree would break."""

    def __init__(self, frame: str, why: str) -> None:
        super().__init__(f"frame {frame!r} is not published: {why}")


def place_via_proxy(
    buffer: FrameBuffer, mapped: MappedObject, seen: StampedTransform, *, reach_ns: int = 0
) -> StampedTransform:
    """Return the transform from the world to the root of an agent's tree, Eq. 4, at the capture time.

    The agent's own transforms may be continued by `reach_ns` where they lag behind the cameras.

    Raises:
        UnknownFrameError: The agent has not spoken of the proxy.
        NotConnectedError: The proxy does not stand in the tree of the frame to be published.
        ExtrapolationError: The agent's transforms are not known for that time.
        PlacingError: The frame has another parent already, or it is the world.
    """
    world = seen.parent
    frame = mapped.frame or root_below(buffer, mapped.via, world)
    if frame == world:
        raise PlacingError(
            frame, f"{mapped.via!r} stands directly in the world, as a robot's root only should"
        )
    if frame in buffer and (parent := buffer.parent_of(frame)) not in {None, world}:
        root = root_below(buffer, frame, world)
        raise PlacingError(
            frame, f"it stands in {parent!r} already; publish the root of its tree, {root!r}"
        )
    world_from_via = seen.pose @ mapped.offset
    via_from_frame = Pose()
    if frame != mapped.via:
        via_from_frame = buffer.look_up(mapped.via, frame, seen.stamp_ns, extrapolate_ns=reach_ns)
    pose = world_from_via @ via_from_frame
    return StampedTransform(parent=world, child=frame, stamp_ns=seen.stamp_ns, pose=pose)


def root_below(buffer: FrameBuffer, frame: str, world: str) -> str:
    """Return the highest frame above one that is not the world, whose place in it may be known already.

    Raises:
        UnknownFrameError: Nobody speaks of the frame.
    """
    while (parent := buffer.parent_of(frame)) not in {None, world}:
        assert parent is not None
        frame = parent
    return frame


def direct_name(object_id: str) -> str:
    """Return what the direct receiver calls an object: ``<subject>_<segment>``, whatever the robot calls it.

    Args:
        object_id: ``subject/segment``, or ``subject`` alone where the segment has the same name.
    """
    subject, _, segment = object_id.partition("/")
    return f"{subject}_{segment or subject}"


def direct_transforms(capture: Capture, *, world: str) -> Iterator[StampedTransform]:
    """Yield what the Vicon Receiver for ROS 2, 1.0.x, publishes, stamped at receipt: Fig. 6, left."""
    for object_id, sight in capture.sights.items():
        if isinstance(sight, Pose):
            yield StampedTransform(
                parent=world, child=direct_name(object_id), stamp_ns=capture.receipt_ns, pose=sight
            )
