"""Objects of a capture system, the frames of their agents, and the transforms that place them.

According to paper A, section 4.5, the official receiver "rigidly maps Vicon tracked object IDs to ROS 2 TF frame
IDs". If the receiver publishes the frame of the markers, the robot's tree has a second root. Therefore the bridge
publishes the root of the robot's tree instead (Eq. 4, ``T_map_base = T_map_markers * T_markers_base``). The frame of
the markers, the proxy frame, may be anywhere in the tree, and then is at the place where the cameras detect it.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Annotated

from sfglab.documents import ByName, Document, ReadAs
from sfglab.errors import InvalidValueError
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

    id: str  #: Name in the capture system.
    #: Proxy frame: the frame of the agent's tree that is at the object, e.g. "agent_x/markers".
    via: Frame
    #: Frame that is published, e.g. "agent_x/base"; empty: the root of the agent's tree.
    frame: Frame = ""
    #: Pose of `via` in the object's own frame (``object_from_via``), as measured; the same by default.
    offset: Annotated[Pose, ReadAs(PoseKeys, _offset)] = field(default_factory=Pose)


@dataclass(frozen=True, slots=True, kw_only=True)
class MocapMapping:
    """Objects of a capture system with their frames, and the limits of their motion.

    Raises:
        InvalidValueError: There is no object, two objects have one frame, or a frame is the world.
    """

    world: Frame  #: Frame in which the capture system measures.
    objects: Annotated[dict[str, MappedObject], ByName("id")]  #: Objects by id.
    limits: Limits = field(default_factory=Limits)  #: Limits of the objects' motion.

    def __post_init__(self) -> None:
        if not self.objects:
            raise InvalidValueError(
                "objects", self.objects, "a mapping of object ids, at least one"
            )
        owners = {self.world: "the world"}
        for id_, mapped in self.objects.items():
            for key, frame in (("via", mapped.via), ("frame", mapped.frame)):
                owner = owners.setdefault(frame, id_) if frame else id_
                if owner != id_:
                    allowed = f"a frame of its own; this one belongs to {owner}"
                    raise InvalidValueError(("objects", id_, key), frame, allowed)


def load_mapping(path: Path | str) -> MocapMapping:
    """Return the mapping of a YAML file such as ``data/mocap/two_agents.yaml``.

    Raises:
        DocumentError: The file cannot be read, or is no mapping; the error names the line.
    """
    return Document.of_file(path).read(MocapMapping)


class PlacingError(MocapError):
    """A frame that must not be published, because the agent's frames would no longer form one tree."""

    def __init__(self, frame: str, why: str) -> None:
        super().__init__(f"frame {frame!r} is not published: {why}")


class SettlingError(PlacingError):
    """A root that may still change, because the agent's transforms are still arriving."""


def place_via_proxy(
    buffer: FrameBuffer, mapped: MappedObject, seen: StampedTransform, *, reach_ns: int = 0
) -> StampedTransform:
    """Return the transform from the world to the root of an agent's tree at the capture time: Eq. 4.

    Args:
        buffer: Transforms of the agent.
        mapped: The object.
        seen: Pose of the object in the world.
        reach_ns: Time by which the agent's transforms are extrapolated if they are older than the
            capture, ns.

    Raises:
        UnknownFrameError: No transform has the proxy frame.
        NotConnectedError: The proxy frame is not in the tree of the frame that is to be published.
        ExtrapolationError: The agent's transforms are not known at that time.
        PlacingError: The frame already has another parent, or is the world.
    """
    world = seen.parent
    frame = mapped.frame or root_below(buffer, mapped.via, world)
    if frame == world:
        why = f"{mapped.via!r} is directly below the world; give a frame inside the robot's tree as via"
        raise PlacingError(frame, why)
    parent = buffer.parent_of(frame) if frame in buffer else None
    if parent not in {None, world}:
        root = root_below(buffer, frame, world)
        why = f"its parent is already {parent!r}; publish the root of its tree, {root!r}"
        raise PlacingError(frame, why)
    pose = seen.pose @ mapped.offset
    if frame != mapped.via:
        pose @= buffer.look_up(mapped.via, frame, seen.stamp_ns, extrapolate_ns=reach_ns)
    return StampedTransform(parent=world, child=frame, stamp_ns=seen.stamp_ns, pose=pose)


def root_below(buffer: FrameBuffer, frame: str, world: str) -> str:
    """Return the highest frame above a frame that is not the world.

    Raises:
        UnknownFrameError: No transform has the frame.
    """
    while (parent := buffer.parent_of(frame)) is not None and parent != world:
        frame = parent
    return frame


def direct_name(object_id: str) -> str:
    """Return the frame that the direct receiver publishes for an object: ``<subject>_<segment>``.

    Args:
        object_id: ``subject/segment``, or ``subject`` if both have the same name.
    """
    subject, _, segment = object_id.partition("/")
    return f"{subject}_{segment or subject}"


def direct_transforms(capture: Capture, *, world: str) -> Iterator[StampedTransform]:
    """Yield the transforms that the Vicon Receiver for ROS 2, 1.0.x, publishes, stamped at receipt.

    Paper A, Fig. 6, left, shows the resulting TF tree.
    """
    for object_id, sight in capture.sights.items():
        if isinstance(sight, Pose):
            yield StampedTransform(
                parent=world, child=direct_name(object_id), stamp_ns=capture.receipt_ns, pose=sight
            )
