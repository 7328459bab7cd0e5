"""Space: poses, frames with time, motion capture; trajectories and scenes beside them.

Everything that decides is pure and takes time as a value; listeners and bridges are thin shells on the bus.
Trajectories and scenes are `sfglab.spatial.trajectory` and `sfglab.spatial.scene`.
"""

from sfglab.spatial.poses import Pose, PoseError, StampedTransform

__all__ = ["Pose", "PoseError", "StampedTransform"]
