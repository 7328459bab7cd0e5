"""The trees of paper A's Fig. 6: what the direct receiver makes of a robot's, and what the bridge."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from sfglab.spatial.frames import FrameBuffer
from sfglab.spatial.mocap.core import BridgeCore
from sfglab.spatial.mocap.placing import direct_name, direct_transforms
from sfglab.spatial.poses import StampedTransform

if TYPE_CHECKING:
    from collections.abc import Sequence

    from sfglab.spatial.mocap.capture import Capture
    from sfglab.spatial.mocap.mapping import MocapMapping


_ROBOT, _CAMERAS = "robot", "mocap"


@dataclass(frozen=True, slots=True, kw_only=True)
class MocapTrees:
    """One robot's tree with motion capture joined to it in three ways; see `lint_frames` for what is wrong."""

    direct: FrameBuffer  #: With the direct receiver's transforms: Fig. 6, left.
    #: With the same under the right names, as if the receiver could be told: "even if this naming conflict were
    #: resolved".
    renamed: FrameBuffer
    proxy: FrameBuffer  #: With the bridge's: Fig. 6, right.


def mocap_trees(
    description: Sequence[StampedTransform], mapping: MocapMapping, captures: Sequence[Capture]
) -> MocapTrees:
    """Join captures to a robot's tree in three ways.

    Args:
        description: The robot's own frames, all static.
        mapping: Which object stands for which frame.
        captures: What the cameras say.
    """
    direct, renamed, proxy = (_described(description) for _ in range(3))
    right = {direct_name(id_): mapped.via for id_, mapped in mapping.objects.items()}
    core = BridgeCore(mapping, proxy)
    for capture in captures:
        for transform in direct_transforms(capture, world=mapping.world):
            direct.insert(transform, authority=_CAMERAS)
            renamed.insert(_under(transform, right.get(transform.child, transform.child)), authority=_CAMERAS)
        for transform in core.take(capture, capture.receipt_ns):
            proxy.insert(transform, authority=_CAMERAS)
    return MocapTrees(direct=direct, renamed=renamed, proxy=proxy)


def _described(description: Sequence[StampedTransform]) -> FrameBuffer:
    buffer = FrameBuffer()
    for transform in description:
        buffer.insert(transform, static=True, authority=_ROBOT)
    return buffer


def _under(transform: StampedTransform, child: str) -> StampedTransform:
    return StampedTransform(
        parent=transform.parent, child=child, stamp_ns=transform.stamp_ns, pose=transform.pose
    )
