"""Lane planner: yellow and white pixels of an image, seen from above; knows no curve and no control.

Paper C, section 6: HSV, a mask each for yellow and for white by ranges, both combined, then the bird's view.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import cv2
import numpy as np

from sfglab.soc.driving.optics import Camera
from sfglab.soc.driving.ports import Ports

if TYPE_CHECKING:
    from numpy.typing import NDArray


PORTS = Ports(node="lane_planner", subscribes=("/blurred",), publishes=("/lane_mask",))

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
