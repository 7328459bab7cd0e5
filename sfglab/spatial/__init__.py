"""Space: poses, TF frames with time, motion capture, trajectories and scenes (paper A, section 4.5).

All decisions are made without I/O, and take the time as a value; listeners and bridges are I/O wrappers on the bus.
"""

from sfglab.spatial.poses import Pose, PoseError, StampedTransform

__all__ = ["Pose", "PoseError", "StampedTransform"]
