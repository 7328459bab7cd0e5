"""Polyfit: the lane's middle as a parabola, by least squares over a mask's pixels; knows no colour space."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from sfglab.soc.driving.lanes import WHITE, YELLOW
from sfglab.soc.driving.ports import Ports

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from sfglab.soc.driving.lanes import BirdView


PORTS = Ports(node="polyfit", subscribes=("/lane_mask",), publishes=("/lane",))

_FEWEST = 60
"""Pixels without which a line is not believed."""

_GATE_M = 0.10
"""How far a pixel may lie from where its line is expected."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Lane:
    """The lane's middle in the vehicle frame: y(x) = offset + slope x + bend x^2, in metres, left positive."""

    offset_m: float
    slope: float
    bend_per_m: float

    def y_m(self, x_m: float) -> float:
        """Return where the lane's middle is at a distance ahead."""
        return self.offset_m + self.slope * x_m + self.bend_per_m * x_m * x_m


def fit_lane(mask: NDArray[np.uint8], view: BirdView, *, lane_m: float = 0.5) -> Lane | None:
    """Fit the middle between a yellow line on the left and a white one on the right.

    Both lines' pixels, moved by half a lane, are one parabola's: one least-squares problem with three unknowns.
    A first fit over one colour says which pixels belong to the lane (there is a white line beyond the yellow
    one, and stop lines lie across); the second is over those of both.

    Args:
        mask: Bird's view with levels `YELLOW` and `WHITE`.
        view: Its geometry.
        lane_m: Distance between the lines' middles.

    Returns:
        The lane, or None where neither line shows enough pixels.
    """
    middle = np.array([0.0, lane_m / 2])
    yellow = view.points(mask == YELLOW) - middle
    white = view.points(mask == WHITE) + middle
    lane = _first(yellow, white, lane_m)
    for _ in range(2):
        if lane is None:
            return None
        lane = _parabola(np.vstack([_near(yellow, lane), _near(white, lane)]))
    return lane


def _first(yellow: NDArray[np.float64], white: NDArray[np.float64], lane_m: float) -> Lane | None:
    """Return a lane by the yellow line, or by what is white about where the right line should be."""
    return _parabola(yellow) or _parabola(white[np.abs(white[:, 1]) < lane_m / 2])


def _near(points: NDArray[np.float64], lane: Lane) -> NDArray[np.float64]:
    x, y = points.T
    away = np.abs(lane.offset_m + lane.slope * x + lane.bend_per_m * x * x - y)
    return np.asarray(points[away < _GATE_M], np.float64)


def _parabola(points: NDArray[np.float64]) -> Lane | None:
    """Return the parabola through points, a straight line where they cover little, or None for too few."""
    if len(points) < _FEWEST:
        return None
    x, y = points.T
    degree = 2 if np.ptp(x) > 0.6 else 1
    solved = np.linalg.lstsq(np.vander(x, degree + 1, increasing=True), y, rcond=None)[0]
    return Lane(
        offset_m=float(solved[0]), slope=float(solved[1]), bend_per_m=float(solved[2]) if degree == 2 else 0.0
    )
