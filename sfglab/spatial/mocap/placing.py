"""From where an object is to the transform that is published: directly, or through a proxy frame.

Paper A, section 4.5, Eq. 4: ``T_map_base = T_map_markers * T_markers_base``. The tree of a robot is rooted at
its base (or its odometry), not at its markers; who publishes the markers gives the tree a second root. So the
frame that is published is the root of the agent's tree, and the proxy, which stands somewhere within it, is
where the cameras see it. Pure: takes poses and a buffer of the agent's transforms.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from sfglab.spatial.mocap.capture import MocapError
from sfglab.spatial.poses import Pose, StampedTransform

if TYPE_CHECKING:
    from collections.abc import Iterator

    from sfglab.spatial.frames import FrameBuffer
    from sfglab.spatial.mocap.capture import Capture
    from sfglab.spatial.mocap.mapping import MappedObject


class PlacingError(MocapError, ValueError):
    """A frame that must not be published, because the tree would break.

    Attributes:
        frame: The frame.
    """

    def __init__(self, frame: str, why: str) -> None:
        self.frame = frame
        super().__init__(f"frame {frame!r} is not published: {why}")


def place_via_proxy(
    buffer: FrameBuffer, mapped: MappedObject, seen: StampedTransform, *, reach_ns: int = 0
) -> StampedTransform:
    """Return the transform from the world to the root of an agent's tree, Eq. 4.

    Args:
        buffer: The agent's own transforms.
        mapped: Which frame the object stands for and which one is published.
        seen: Where the object was in the world when the cameras saw it; the agent's transforms are taken for
            that time.
        reach_ns: How far the agent's transforms may be continued when they lag behind the cameras.

    Returns:
        The transform, stamped with the capture time.

    Raises:
        UnknownFrameError: The agent has not spoken of the proxy.
        NotConnectedError: The proxy does not stand in the tree of the frame to be published.
        ExtrapolationError: The agent's transforms are not known for that time.
        PlacingError: The frame has another parent already, or it is the world.
    """
    world = seen.parent
    frame = mapped.frame or root_below(buffer, mapped.via, world)
    if frame == world:
        raise PlacingError(frame, f"{mapped.via!r} stands directly in the world, as a robot's root only should")
    if frame in buffer and (parent := buffer.parent_of(frame)) not in {None, world}:
        root = root_below(buffer, frame, world)
        raise PlacingError(frame, f"it stands in {parent!r} already; publish the root of its tree, {root!r}")
    world_from_via = seen.pose @ mapped.offset
    via_from_frame = (
        Pose()
        if frame == mapped.via
        else buffer.look_up(mapped.via, frame, seen.stamp_ns, extrapolate_ns=reach_ns)
    )
    return StampedTransform(
        parent=world, child=frame, stamp_ns=seen.stamp_ns, pose=world_from_via @ via_from_frame
    )


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
    """Yield what the direct receiver publishes: every object under its own name, stamped with the receipt.

    The baseline of paper A's Fig. 6, left: as the Vicon Receiver for ROS 2, 1.0.x, does.

    Args:
        capture: All objects at one time.
        world: The frame in which the capture system measures.
    """
    for object_id, sight in capture.sights.items():
        if isinstance(sight, Pose):
            yield StampedTransform(
                parent=world, child=direct_name(object_id), stamp_ns=capture.receipt_ns, pose=sight
            )
