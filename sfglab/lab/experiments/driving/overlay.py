"""What was seen, drawn over what it was seen in: the lane over the camera's image, and the bird's view."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import cv2
import numpy as np

from sfglab.lab.experiments.driving.replay import lane_points
from sfglab.soc.driving import Camera
from sfglab.soc.driving.lanes import WHITE, YELLOW, BirdView

if TYPE_CHECKING:
    from numpy.typing import NDArray


_LANE_BGR = (230, 140, 20)
_SHIFT = 4
"""Binary places of a pixel that lines are drawn with."""


def draw_lane(bgr: NDArray[np.uint8], row: Any, *, width: int) -> NDArray[np.uint8]:
    """Return an image at another width with the lane's middle in it.

    Args:
        bgr: The image, of the default camera's shape.
        row: A line of the table ``track``.
        width: In pixels.
    """
    camera = Camera()
    height = width * camera.height // camera.width
    image = cv2.resize(bgr, (width, height), interpolation=cv2.INTER_CUBIC)
    points = lane_points(row)
    if points:
        ground = np.array([(x, y, 0.0) for x, y in points])
        pixels = camera.project(ground)[0] * (width / camera.width)
        _line(image, pixels, _LANE_BGR, 3)
    return np.asarray(image, np.uint8)


def draw_bird(mask: NDArray[np.uint8], row: Any) -> NDArray[np.uint8]:
    """Return the bird's view in its colours with the lane's middle in it.

    Args:
        mask: The lane planner's.
        row: A line of the table ``track``.
    """
    image = np.full((*mask.shape, 3), 50, np.uint8)
    image[mask == YELLOW] = (40, 190, 225)
    image[mask == WHITE] = (235, 235, 235)
    points = lane_points(row)
    if points:
        inverse = np.linalg.inv(BirdView().ground_from_bird)
        pixels = np.array([(x, y, 1.0) for x, y in points]) @ inverse.T
        _line(image, pixels[:, :2], _LANE_BGR, 2)
    return image


def _line(image: Any, pixels: NDArray[np.float64], bgr: tuple[int, int, int], width: int) -> None:
    points = np.rint(pixels * (1 << _SHIFT)).astype(np.int32)
    cv2.polylines(image, [points], False, bgr, width, cv2.LINE_AA, _SHIFT)
