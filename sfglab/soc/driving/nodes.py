"""Nodes of the driving application, but for odometry (paper C, section 6): from an image to a command.

Compensation and Gaussian blur make the image steady. The lane planner masks yellow and white by ranges of HSV
and has the bird's view; polyfit fits a parabola by least squares to the mask's pixels. A red light found stops
the robot and activates the detection of green, a green one lets it drive and activates that of red; each says
something only when it found its light, and sleeps then. Lane control is pure pursuit (Coulter, 1992): the arc
through the lane's middle a lookahead away. Without a lane the car makes for the last point, by odometry, and
halts there.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from enum import Enum
from typing import TYPE_CHECKING

import cv2
import numpy as np

from sfglab.soc.driving.car import Camera, Drive

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from sfglab.soc.driving.odometry import Pose

_OUTLIER = 48
"""Levels by which a pixel differs from the median around it when it is noise, in every case but a lamp's
edge."""

_TAIL = 0.005  #: Share of darkest and of brightest pixels that the histogram is not stretched for.


def compensate(bgr: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Remove outlier pixels, then stretch the histogram over all levels (paper C, section 6: Compensation).

    The paper names no method: an outlier here is a pixel far from the median of its 3 x 3 neighbourhood, which
    replaces it, and the stretch is linear and the same for all channels. Shape (height, width, 3), BGR.
    """
    median = cv2.medianBlur(bgr, 3)
    outlier = cv2.inRange(cv2.absdiff(bgr, median), (0, 0, 0), (_OUTLIER, _OUTLIER, _OUTLIER)) == 0
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
        return np.array(
            [[0.0, -step, far], [-step, 0.0, (self.width / 2 - 0.5) * step], [0.0, 0.0, 1.0]]
        )

    def warp(self, image: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """Return what an image of one channel shows of the ground, levels unmixed."""
        matrix = self.camera.image_from_ground @ self.ground_from_bird
        flags = cv2.INTER_NEAREST | cv2.WARP_INVERSE_MAP
        return np.asarray(
            cv2.warpPerspective(image, matrix, (self.width, self.height), flags=flags), np.uint8
        )

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
    return np.asarray(
        cv2.bitwise_or(np.asarray(yellow, np.uint8) & np.uint8(YELLOW), white), np.uint8
    )


def lane_mask(bgr: NDArray[np.uint8], view: BirdView) -> NDArray[np.uint8]:
    """Return the combined mask of an image in the bird's view."""
    return view.warp(marking_mask(bgr))


_FEWEST = 60  #: Pixels without which a line is not believed.

_GATE_M = 0.10  #: How far a pixel may lie from where its line is expected.


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
    """Fit the middle between a yellow line on the left and a white one on the right, `lane_m` apart.

    The mask is a bird's view of levels `YELLOW` and `WHITE`. Both lines' pixels, moved by half a lane, are one
    parabola's, of three unknowns. A first fit over one colour says which pixels belong to the lane (there are
    white lines beyond and across); the second is over both. None where neither line shows enough pixels.
    """
    middle = np.array([0.0, lane_m / 2])
    yellow = view.points(mask == YELLOW) - middle
    white = view.points(mask == WHITE) + middle
    # By the yellow line, or by what is white about where the right line should be.
    lane = _parabola(yellow) or _parabola(white[np.abs(white[:, 1]) < lane_m / 2])
    for _ in range(2):
        if lane is None:
            return None
        lane = _parabola(np.vstack([_near(yellow, lane), _near(white, lane)]))
    return lane


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
    fit = np.linalg.lstsq(np.vander(x, degree + 1, increasing=True), y, rcond=None)[0]
    return Lane(
        offset_m=float(fit[0]),
        slope=float(fit[1]),
        bend_per_m=float(fit[2]) if degree == 2 else 0.0,
    )


class Colour(Enum):
    """A light's colour; its value is the hues (of 180) from which to which, wrapping at 180."""

    RED = (172, 8)
    GREEN = (45, 85)


_SATURATION, _VALUE = 130, 150
#: Least share of its enclosing circle that a lamp's blob covers; 1 for a disc, 0.64 for a square.
_ROUND = 0.6

_RADII = {Colour.RED: (0.024, 0.045), Colour.GREEN: (0.014, 0.1)}
"""Radii, over the image's width, between which a lamp concerns the car.

Red: from where it has to brake (1.95 m with a lamp of 6 cm) to where stopping would leave the lamp out of sight
(1.04 m). Green: whatever is near and in sight.
"""


@dataclass(frozen=True, slots=True, kw_only=True)
class Lamp:
    """A round blob of a light's colour, in pixels."""

    u: float
    v: float
    radius: float


def find_lamps(bgr: NDArray[np.uint8], colour: Colour) -> list[Lamp]:
    """Return the lit lamps of a colour in an image, however small, in no order."""
    hsv = cv2.cvtColor(bgr, cv2.COLOR_BGR2HSV)
    first, last = colour.value
    spans = [(first, last)] if first <= last else [(first, 179), (0, last)]
    masks = [cv2.inRange(hsv, (a, _SATURATION, _VALUE), (b, 255, 255)) for a, b in spans]
    mask, lamps = np.asarray(masks[0] if len(masks) == 1 else cv2.bitwise_or(*masks), np.uint8), []
    for contour in cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_SIMPLE)[0]:
        (u, v), radius = cv2.minEnclosingCircle(contour)
        if radius >= 2 and cv2.contourArea(contour) > _ROUND * math.pi * radius * radius:
            lamps.append(Lamp(u=float(u), v=float(v), radius=float(radius)))
    return lamps


class LightDetector:
    """The detection node of a colour. The red one starts active, the green one asleep."""

    def __init__(self, colour: Colour) -> None:
        self.colour = colour
        self.active = colour is Colour.RED

    def see(self, bgr: NDArray[np.uint8]) -> bool:
        """Look at an image of topic A; return whether the node says that it found its light, and sleeps."""
        if not self.active:
            return False
        low, high = (share * bgr.shape[1] for share in _RADII[self.colour])
        found = any(low <= lamp.radius <= high for lamp in find_lamps(bgr, self.colour))
        self.active = not found
        return found

    def hear_other(self) -> None:
        """Take the other detector's message: it found its light, so this one wakes."""
        self.active = True


# Constants of the controller, all chosen here (the paper gives none).
_SPEED_MPS = 0.9  #: On a straight lane.
_LOOKAHEAD_M = 0.9  #: How far ahead the car aims.
_LATERAL_MPS2 = 0.35  #: Highest lateral acceleration; bends are taken slower for it.
_ARRIVED_M = 0.3  #: How near a remembered point is not aimed at any more.


class LaneControl:
    """The lane-control node: remembers whether a red light holds the car, and the last point it aimed at."""

    def __init__(self) -> None:
        self.held = False
        self._aim_odometry: tuple[float, float] | None = None

    def hear_red(self) -> None:
        """Take a message of the red light's detection: stop."""
        self.held = True

    def hear_green(self) -> None:
        """Take a message of the green light's detection: drive."""
        self.held = False

    def step(self, lane: Lane | None, pose: Pose) -> Drive:
        """Return the command for a frame, given what `fit_lane` found in it and the odometry at that frame."""
        if lane is not None:
            self._aim_odometry = pose.outwards(_LOOKAHEAD_M, lane.y_m(_LOOKAHEAD_M))
        if self.held or self._aim_odometry is None:
            return Drive()
        return self._towards(*pose.inwards(*self._aim_odometry))

    @staticmethod
    def _towards(x_m: float, y_m: float) -> Drive:
        """Return the command along the arc through a point of the vehicle frame."""
        if x_m < _ARRIVED_M:
            return Drive()
        curvature = 2 * y_m / (x_m * x_m + y_m * y_m)
        speed = min(_SPEED_MPS, math.sqrt(_LATERAL_MPS2 / max(abs(curvature), 1e-6)))
        return Drive(speed_mps=speed, yaw_rate_rps=speed * curvature)
