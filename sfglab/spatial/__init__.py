"""Space: poses, frames with time, motion capture; trajectories and scenes beside them.

What decides is pure and takes time as a value; listeners and bridges are thin shells on the bus.
"""

from sfglab.spatial.poses import Pose, PoseError, StampedTransform

__all__ = ["Pose", "PoseError", "StampedTransform"]
