"""The module `nodes` has the nodes of the driving application, except the odometry (paper C, section 6).

Compensation and Gaussian blur reduce the noise of an image. The lane planner masks yellow and white pixels and
transforms the mask into a bird's-eye view. Polyfit fits a parabola to the mask by least squares. If the red-light
detection finds a light, the car stops and the green-light detection becomes active. If the green-light detection
finds a light, the car drives and the red-light detection becomes active. Lane control is pure pursuit
(Coulter, 1992).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum
from typing import TYPE_CHECKING

import cv2
import numpy as np

from sfglab.soc.driving.car import Drive
from sfglab.soc.driving.town import LANE_M

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from sfglab.soc.driving.car import Camera
    from sfglab.soc.driving.pose import Pose, T

    Image = NDArray[np.uint8]
    Floats = NDArray[np.float64]

#: Smallest difference of an outlier pixel from the median of its neighbours, in levels. The pixels of markings
#: have smaller differences.
_OUTLIER = 48

_TAIL = 0.005  #: Share of the darkest and of the brightest pixels that saturate.


def compensate(bgr: Image) -> Image:
    """Remove outlier pixels of an image, then stretch the image's histogram (paper C, section 6: Compensation).

    The paper names no method for the compensation. Our node replaces a pixel by the median of 3 x 3 pixels if the
    pixel differs from the median by more than 48 levels. The stretch of the histogram is linear and the same for all
    channels.

    Args:
        bgr: Image (height, width, 3).
    """
    median = cv2.medianBlur(bgr, 3)
    kept = cv2.inRange(cv2.absdiff(bgr, median), (0, 0, 0), (_OUTLIER, _OUTLIER, _OUTLIER))
    clean = np.where(kept[..., None] == 0, median, bgr)
    return np.asarray(cv2.LUT(clean, _stretch(clean)), np.uint8)


def _stretch(bgr: Image) -> Image:
    """Return the table of 256 levels that stretches an image's grey histogram to the range from 0 to 255."""
    grey = cv2.cvtColor(bgr, cv2.COLOR_BGR2GRAY)
    histogram = cv2.calcHist([grey], [0], None, [256], [0, 256]).ravel()
    shares = np.cumsum(histogram) / grey.size
    low, high = np.searchsorted(shares, [_TAIL, 1 - _TAIL])
    scale = 255.0 / max(int(high) - int(low), 1)
    levels = np.rint((np.arange(256) - low) * scale)
    return np.asarray(np.clip(levels, 0, 255), np.uint8)


def blur(bgr: Image) -> Image:
    """Return the image after a Gaussian filter of 5 x 5 pixels with sigma 1; both sizes are assumed."""
    return np.asarray(cv2.GaussianBlur(bgr, (5, 5), 1.0), np.uint8)


#: Level of yellow pixels in the mask. The paper does not say whether its lane planner separates colours.
YELLOW = 128
WHITE = 255  #: Level of white pixels in the mask.

_YELLOW_HSV = ((18, 90, 110), (36, 255, 255))
_WHITE_HSV = ((0, 0, 175), (179, 60, 255))


_BIRD_SIZE = (320, 240)  #: Columns and rows of the bird's-eye view.
_BIRD_PIXEL_M = 0.01  #: Side of a pixel of the bird's-eye view.
_BIRD_NEAR_M = 0.58  #: Distance of the lower edge of the bird's-eye view from the car.
_BIRD_LEFT_M = (_BIRD_SIZE[0] / 2 - 0.5) * _BIRD_PIXEL_M
_BIRD_FAR_M = _BIRD_NEAR_M + (_BIRD_SIZE[1] - 0.5) * _BIRD_PIXEL_M
_GROUND_FROM_BIRD = np.array(
    [[0.0, -_BIRD_PIXEL_M, _BIRD_FAR_M], [-_BIRD_PIXEL_M, 0.0, _BIRD_LEFT_M], [0.0, 0.0, 1.0]]
)
"""The matrix maps bird's-eye pixels (column, row, 1) to points (x, y, 1) of the vehicle frame, m; up is forward."""


def lane_mask(bgr: Image, camera: Camera) -> Image:
    """Return the bird's-eye view of the markings with levels `YELLOW`, `WHITE` and 0 (paper C: Lane Planner).

    Args:
        bgr: Image (height, width, 3) of the camera.
        camera: Geometry of the image.
    """
    matrix = camera.image_from_ground @ _GROUND_FROM_BIRD
    nearest = cv2.INTER_NEAREST | cv2.WARP_INVERSE_MAP  # the filter must not mix levels
    mask = cv2.warpPerspective(_marking_mask(bgr), matrix, _BIRD_SIZE, flags=nearest)
    return np.asarray(mask, np.uint8)


def _marking_mask(bgr: Image) -> Image:
    """Return the level of each pixel of an image: `YELLOW` or `WHITE` for a marking, otherwise 0."""
    hsv = cv2.cvtColor(bgr, cv2.COLOR_BGR2HSV)
    mask = np.zeros(bgr.shape[:2], np.uint8)
    mask[cv2.inRange(hsv, *_YELLOW_HSV) > 0] = YELLOW
    mask[cv2.inRange(hsv, *_WHITE_HSV) > 0] = WHITE
    return mask


_MIN_PIXELS = 60  #: Smallest number of pixels that a line is fitted to.
_GATE_M = 0.10  #: Largest distance of a pixel from the expected line.


@dataclass(frozen=True, slots=True, kw_only=True)
class Lane:
    """A `Lane` is the lane's middle in the vehicle frame: y(x) = offset + slope x + bend x^2, m, left positive."""

    offset_m: float  #: Position at x = 0, m.
    slope: float  #: Slope at x = 0.
    bend_per_m: float  #: Quadratic coefficient, 1/m.

    def y_m(self, x_m: T) -> T:
        """Return the lateral position of the lane's middle, m, at one distance ahead or at several distances ahead."""
        return self.offset_m + self.slope * x_m + self.bend_per_m * x_m * x_m


def fit_lane(mask: Image) -> Lane | None:
    """Fit the middle of the lane between its yellow line (left) and white line (paper C: Polyfit).

    `fit_lane` uses the known width of the lane. The function moves the pixels of both lines by half a lane,
    so that all pixels belong to one parabola. A first fit to one colour selects the pixels of the lane, because the
    image also shows white lines beyond the lane and across the lane.

    Args:
        mask: Bird's-eye view that `lane_mask` returns.

    Returns:
        The lane, or None if neither line has enough pixels.
    """
    yellow = _points(mask == YELLOW) - (0.0, LANE_M / 2)
    white = _points(mask == WHITE) - (0.0, -LANE_M / 2)
    expected_white = white[np.abs(white[:, 1]) < LANE_M / 2]
    lane = _parabola(yellow) or _parabola(expected_white)
    for _ in range(2):
        if lane is None:
            return None
        lane = _parabola(np.vstack([_near(yellow, lane), _near(white, lane)]))
    return lane


def _points(mask: NDArray[np.bool_]) -> Floats:
    """Return the points (n, 2) of the vehicle frame, m, at which a bird's-eye mask is set."""
    rows, columns = np.nonzero(mask)
    pixels = np.stack([columns, rows, np.ones_like(rows)])
    return np.asarray((_GROUND_FROM_BIRD @ pixels)[:2].T, np.float64)


def _near(points: Floats, lane: Lane) -> Floats:
    x, y = points.T
    return np.asarray(points[np.abs(lane.y_m(x) - y) < _GATE_M], np.float64)


def _parabola(points: Floats) -> Lane | None:
    """Return the parabola through points: None for too few points, a straight line for points close together."""
    if len(points) < _MIN_PIXELS:
        return None
    x, y = points.T
    degree = 2 if np.ptp(x) > 0.6 else 1
    powers = np.vander(x, degree + 1, increasing=True)
    fit = np.linalg.lstsq(powers, y, rcond=None)[0]
    bend = float(fit[2]) if degree == 2 else 0.0
    return Lane(offset_m=float(fit[0]), slope=float(fit[1]), bend_per_m=bend)


class Colour(Enum):
    """A `Colour` of a traffic light has its first and its last hue as value; 180 hues form a circle."""

    RED = (172, 8)
    GREEN = (45, 85)


_SATURATION = 130
_VALUE = 150
#: Smallest share of its enclosing circle that a lamp covers: a disc covers 1, a square 0.64.
_ROUND = 0.6

_RADII = {Colour.RED: (0.024, 0.045), Colour.GREEN: (0.014, 0.1)}
"""`_RADII` has the smallest and largest radius of a lamp that concerns the car, relative to the image width.

A red lamp of 6 cm concerns the car at distances from 1.95 m to 1.04 m. At 1.95 m the car has to brake. At 1.04 m the
car can last stop with the lamp in view. A green lamp concerns the car at all near distances.
"""


def lamp_radii(bgr: Image, colour: Colour) -> Iterator[float]:
    """Yield the radii, px, of the round areas that have a colour in an image (height, width, 3), BGR."""
    hsv = cv2.cvtColor(bgr, cv2.COLOR_BGR2HSV)
    first, last = colour.value
    hsv[..., 0] = (hsv[..., 0].astype(int) - first) % 180
    span = (last - first) % 180
    mask = cv2.inRange(hsv, (0, _SATURATION, _VALUE), (span, 255, 255))
    contours, _ = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_SIMPLE)
    for contour in contours:
        _, radius = cv2.minEnclosingCircle(contour)
        circle = math.pi * radius * radius
        if radius >= 2 and cv2.contourArea(contour) > _ROUND * circle:
            yield float(radius)


class LightDetector:
    """A `LightDetector` is the detection node of one colour; red starts active, green starts inactive."""

    def __init__(self, colour: Colour) -> None:
        self.colour = colour
        #: Whether the node looks for its light; the other detection node activates this node.
        self.active = colour is Colour.RED

    def detect(self, bgr: Image) -> bool:
        """Return whether the active node finds its light; the node becomes inactive after it has found the light.

        Args:
            bgr: Image (height, width, 3) of topic A.
        """
        if not self.active:
            return False
        smallest, largest = _RADII[self.colour]
        width = bgr.shape[1]
        for radius in lamp_radii(bgr, self.colour):
            if smallest * width <= radius <= largest * width:
                self.active = False
                return True
        return False


#: Speed on a straight lane. The project chose this value and the next three values; the paper has none.
_SPEED_MPS = 0.9
_LOOKAHEAD_M = 0.9  #: Distance of the point that the car drives towards.
_LATERAL_MPS2 = 0.35  #: Largest lateral acceleration, which limits the speed in bends.
_ARRIVED_M = 0.3  #: Distance at which a remembered point counts as reached.


class LaneControl:
    """`LaneControl` is the lane control node.

    The node follows the arc through the point of the lane's middle that is 0.9 m ahead. If an image shows no lane,
    the node drives the car towards the last point and stops at this point; the odometry gives the point's position.
    """

    def __init__(self) -> None:
        #: Whether a red light holds the car; the detection nodes set this value.
        self.held = False
        # The target is a point in the frame of the odometry.
        self._target: tuple[float, float] | None = None

    def step(self, lane: Lane | None, pose: Pose) -> Drive:
        """Return the drive command for a frame.

        Args:
            lane: Result of `fit_lane`; None if the image shows no lane.
            pose: Pose of the odometry at the frame of the lane.
        """
        if lane is not None:
            self._target = pose.to_parent(_LOOKAHEAD_M, lane.y_m(_LOOKAHEAD_M))
        if self.held or self._target is None:
            return Drive()
        x, y = pose.from_parent(*self._target)
        if x < _ARRIVED_M:
            return Drive()
        curvature = 2 * y / (x * x + y * y)
        speed = min(_SPEED_MPS, math.sqrt(_LATERAL_MPS2 / max(abs(curvature), 1e-6)))
        return Drive(speed_mps=speed, yaw_rate_rps=speed * curvature)
