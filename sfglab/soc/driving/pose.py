"""The module `pose` has planar poses for the car, the traffic lights and the odometry."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

T = TypeVar("T", float, NDArray[np.float64])


@dataclass(frozen=True, slots=True, kw_only=True)
class Pose:
    """A `Pose` is a planar pose relative to a parent frame."""

    x_m: float = 0.0  #: Position along the parent's x axis, m.
    y_m: float = 0.0  #: Position along the parent's y axis, m.
    yaw_rad: float = 0.0  #: Heading relative to the parent, rad.

    def to_parent(self, x_m: T, y_m: T) -> tuple[T, T]:
        """Return the coordinates in the parent frame of a point, or of points, of the pose's frame."""
        cos = math.cos(self.yaw_rad)
        sin = math.sin(self.yaw_rad)
        return self.x_m + cos * x_m - sin * y_m, self.y_m + sin * x_m + cos * y_m

    def from_parent(self, x_m: T, y_m: T) -> tuple[T, T]:
        """Return the coordinates in the pose's frame of a point, or of points, of the parent frame."""
        cos = math.cos(self.yaw_rad)
        sin = math.sin(self.yaw_rad)
        x = x_m - self.x_m
        y = y_m - self.y_m
        return cos * x + sin * y, cos * y - sin * x

    def then(self, motion: Pose) -> Pose:
        """Return the pose after a motion; the motion is relative to the pose before."""
        x_m, y_m = self.to_parent(motion.x_m, motion.y_m)
        yaw_rad = math.remainder(self.yaw_rad + motion.yaw_rad, math.tau)
        return Pose(x_m=x_m, y_m=y_m, yaw_rad=yaw_rad)
