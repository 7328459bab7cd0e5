"""The town's ground from above as one picture: grass, asphalt, lines; refuses to know cameras."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import cv2
import numpy as np

from sfglab.soc.driving.town import LANE_M, LINE_M

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from sfglab.soc.driving.town import Town


GRASS_BGR = (66, 96, 74)
_ASPHALT, _WHITE, _YELLOW = (92, 90, 88), (225, 228, 230), (40, 190, 225)
_PIXEL_M = 0.0125
_EDGE_M = 9.0
_SHIFT = 4
"""Binary places of a pixel that lines are drawn with."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Ground:
    """A picture of the ground."""

    bgr: NDArray[np.uint8]  #: Rows from south to north, columns from west to east.
    picture_from_town: NDArray[np.float64]  #: Matrix from (x, y, 1) in metres to its pixels (u, v, 1).


def draw_ground(town: Town, rng: np.random.Generator) -> Ground:
    """Draw a town's ground.

    Args:
        town: Whose road and stop lines.
        rng: For the texture, without which odometry would see nothing.
    """
    size = round(2 * _EDGE_M / _PIXEL_M)
    picture = np.full((size, size, 3), GRASS_BGR, np.uint8)
    _line(picture, town.road.points_xy, _ASPHALT, 2 * LANE_M + 0.24)
    picture = _textured(picture, rng)
    _line(picture, town.road.points_xy, _YELLOW, LINE_M)
    for side in (-1, 1):
        _line(picture, town.road.beside(side * LANE_M), _WHITE, LINE_M)
    for light in town.lights:
        ends = [town.lane.at(light.stop_m, side * LANE_M / 2)[:2] for side in (-0.8, 0.8)]
        _line(picture, np.array(ends), _WHITE, LINE_M, closed=False)
    scale, middle = 1 / _PIXEL_M, _EDGE_M / _PIXEL_M - 0.5
    matrix = np.array([[scale, 0.0, middle], [0.0, scale, middle], [0.0, 0.0, 1.0]])
    return Ground(bgr=picture, picture_from_town=matrix)


def _line(
    picture: NDArray[np.uint8],
    points_xy: NDArray[np.float64],
    bgr: tuple[int, int, int],
    width_m: float,
    *,
    closed: bool = True,
) -> None:
    pixels = ((points_xy + _EDGE_M) / _PIXEL_M - 0.5) * (1 << _SHIFT)
    width = max(round(width_m / _PIXEL_M), 1)
    cv2.polylines(picture, [np.rint(pixels).astype(np.int32)], closed, bgr, width, cv2.LINE_AA, _SHIFT)


def _textured(picture: NDArray[np.uint8], rng: np.random.Generator) -> NDArray[np.uint8]:
    """Return the picture with stains of 10 cm and 5 cm and grain of 2.5 cm."""
    size = picture.shape[0]
    texture = np.zeros((size, size), np.float32)
    for cell, strength in ((8, 8.0), (4, 12.0), (2, 9.0)):
        coarse = rng.normal(0, strength, (size // cell, size // cell)).astype(np.float32)
        texture += cv2.resize(coarse, (size, size), interpolation=cv2.INTER_LINEAR)
    return np.asarray(np.clip(picture + texture[..., None], 0, 255), np.uint8)
