"""The lane from an image (paper C, section 6): compensation, Gaussian blur, lane planner and polyfit.

The lane planner's colours are HSV, a mask each for yellow and for white by ranges, both combined, then the
bird's view; polyfit has the lane's middle as a parabola, by least squares over the mask's pixels. Knows no
light and no control.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import cv2
import numpy as np

from sfglab.soc.driving.car import Camera

if TYPE_CHECKING:
    from numpy.typing import NDArray

_OUTLIER = 48
"""Levels by which a pixel differs from the median around it when it is noise, in every case but a lamp's
edge."""

_TAIL = 0.005
"""Share of darkest and of brightest pixels that the histogram is not stretched for."""


def compensate(bgr: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Remove outlier pixels, then stretch the histogram over all levels (paper C, section 6: Compensation).

    The paper names the histogram and the removal of outliers and no method: an outlier here is a pixel far from
    the median of its 3 x 3 neighbourhood, which replaces it, and the stretch is linear and the same for all
    channels, so that hues stay.

    Args:
        bgr: Shape (height, width, 3).

    Returns:
        An image of the same shape.
    """
    median = cv2.medianBlur(bgr, 3)
    difference = cv2.absdiff(bgr, median)
    outlier = cv2.inRange(difference, (0, 0, 0), (_OUTLIER, _OUTLIER, _OUTLIER)) == 0
    clean = np.where(outlier[..., None], median, bgr)
    return np.asarray(cv2.LUT(clean, stretch(clean)), np.uint8)


def stretch(bgr: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return the table of 256 levels that stretches a grey histogram, without its tails, to 0 .. 255."""
    grey = cv2.cvtColor(bgr, cv2.COLOR_BGR2GRAY)
    share = np.cumsum(cv2.calcHist([grey], [0], None, [256], [0, 256]).ravel()) / grey.size
    low, high = np.searchsorted(share, [_TAIL, 1 - _TAIL])
    levels = (np.arange(256) - low) * (255.0 / max(int(high) - int(low), 1))
    return np.asarray(np.clip(np.rint(levels), 0, 255), np.uint8)


def blur(bgr: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return the image through a Gaussian of 5 x 5 pixels, sigma 1 (paper C, section 6; size assumed)."""
    return np.asarray(cv2.GaussianBlur(bgr, (5, 5), 1.0), np.uint8)


YELLOW, WHITE = 128, 255
"""Levels in the combined mask; the paper does not say whether its own keeps the colours apart."""

_YELLOW_HSV = ((18, 90, 110), (36, 255, 255))
_WHITE_HSV = ((0, 0, 175), (179, 60, 255))


@dataclass(frozen=True, slots=True, kw_only=True)
class BirdView:
    """The ground ahead from above: forward is up, the car below the middle of the lowest row."""

    camera: Camera = field(default_factory=Camera)  #: Whose images are warped.
    near_m: float = 0.58  #: Distance of the lower edge.
    pixel_m: float = 0.01  #: Side of a pixel.
    width: int = 320  #: Columns.
    height: int = 240  #: Rows.

    @property
    def ground_from_bird(self) -> NDArray[np.float64]:
        """Matrix from bird's pixels (column, row, 1) to ground points of the vehicle frame."""
        step = self.pixel_m
        far = self.near_m + (self.height - 0.5) * step
        return np.array([[0.0, -step, far], [-step, 0.0, (self.width / 2 - 0.5) * step], [0.0, 0.0, 1.0]])

    def warp(self, image: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """Return what an image of one channel shows of the ground, levels unmixed."""
        matrix = self.camera.image_from_ground @ self.ground_from_bird
        flags = cv2.INTER_NEAREST | cv2.WARP_INVERSE_MAP
        return np.asarray(cv2.warpPerspective(image, matrix, (self.width, self.height), flags=flags), np.uint8)

    def points(self, mask: NDArray[np.bool_]) -> NDArray[np.float64]:
        """Return the ground points (n, 2), x forward and y left in metres, of a bird's mask's pixels."""
        rows, columns = np.nonzero(mask)
        pixels = np.stack([columns, rows, np.ones_like(rows)])
        return np.asarray((self.ground_from_bird @ pixels)[:2].T, np.float64)


def marking_mask(bgr: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return a mask in the image's own perspective: `YELLOW`, `WHITE` or 0."""
    hsv = cv2.cvtColor(bgr, cv2.COLOR_BGR2HSV)
    yellow = cv2.inRange(hsv, *_YELLOW_HSV)
    white = cv2.inRange(hsv, *_WHITE_HSV)
    return np.asarray(cv2.bitwise_or(np.asarray(yellow, np.uint8) & np.uint8(YELLOW), white), np.uint8)


def lane_mask(bgr: NDArray[np.uint8], view: BirdView) -> NDArray[np.uint8]:
    """Return the combined mask of an image in the bird's view."""
    return view.warp(marking_mask(bgr))


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
