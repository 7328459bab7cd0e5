"""Solid bodies and how far points are from them.

Every body is convex and stands in its own frame, centred; z is a cylinder's axis. Refuses to know where it is.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING

import numpy as np

from sfglab.spatial.trajectory.path import TrajectoryError

if TYPE_CHECKING:
    from numpy.typing import NDArray


class _Body:
    __slots__ = ()

    def __post_init__(self) -> None:
        for name in (f.name for f in fields(self)):  # type: ignore[arg-type]
            for size in np.atleast_1d(getattr(self, name)):
                if not 0.0 < size < math.inf:
                    raise TrajectoryError(name, getattr(self, name), "finite numbers above zero")


@dataclass(frozen=True, slots=True, kw_only=True)
class Box(_Body):
    """A box."""

    size_m: tuple[float, float, float]  #: Lengths along x, y and z.

    @property
    def reach_m(self) -> float:
        """How far its farthest point is from its centre."""
        return math.hypot(*self.size_m) / 2.0

    def distances_m(self, points_m: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return distances of points, shape (n, 3), to the surface; negative inside."""
        return _hull(np.abs(points_m) - np.array(self.size_m) / 2.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class Sphere(_Body):
    """A sphere."""

    radius_m: float  #: Its radius.

    @property
    def reach_m(self) -> float:
        """How far its farthest point is from its centre."""
        return self.radius_m

    def distances_m(self, points_m: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return distances of points, shape (n, 3), to the surface; negative inside."""
        return np.asarray(np.linalg.norm(points_m, axis=1) - self.radius_m)


@dataclass(frozen=True, slots=True, kw_only=True)
class Cylinder(_Body):
    """A cylinder, upright along z."""

    radius_m: float  #: Its radius.
    height_m: float  #: Its height, half of it below the centre.

    @property
    def reach_m(self) -> float:
        """How far its farthest point is from its centre."""
        return math.hypot(self.radius_m, self.height_m / 2.0)

    def distances_m(self, points_m: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return distances of points, shape (n, 3), to the surface; negative inside."""
        beside = np.hypot(points_m[:, 0], points_m[:, 1]) - self.radius_m
        above = np.abs(points_m[:, 2]) - self.height_m / 2.0
        return _hull(np.stack([beside, above], axis=1))


Shape = Box | Sphere | Cylinder


def _hull(beyond: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the distance to a product of intervals, given how far one is beyond each of them."""
    outside = np.linalg.norm(np.maximum(beyond, 0.0), axis=1)
    return np.asarray(outside + np.minimum(beyond.max(axis=1), 0.0))
