"""The module `scene` renders camera images of a town with ground, traffic lights and the camera's noise.

The ground is an image from above with grass, asphalt and lines. The scene uses the town and the true pose of the
car. The nodes receive only the images of the scene.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import cv2
import numpy as np

from sfglab.soc.driving.town import LANE_M, LINE_M, Town

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from sfglab.soc.driving.car import Camera, CarState
    from sfglab.soc.driving.pose import Pose

    Bgr = tuple[int, int, int]
    Image = NDArray[np.uint8]
    Floats = NDArray[np.float64]

_GRASS = (66, 96, 74)
_ASPHALT = (92, 90, 88)
_WHITE = (225, 228, 230)
_YELLOW = (40, 190, 225)
_SKY = (214, 190, 168)
_PIXEL_M = 0.0125  #: Side length of a pixel of the ground.
_EDGE_M = 9.0  #: Distance from the middle of the ground to its edges.
_SHIFT = 4  #: Fractional bits of the coordinates that OpenCV draws with.


_SCALE = 1 / _PIXEL_M
_MIDDLE = _EDGE_M / _PIXEL_M - 0.5
_PIXELS_FROM_TOWN = np.array([[_SCALE, 0.0, _MIDDLE], [0.0, _SCALE, _MIDDLE], [0.0, 0.0, 1.0]])
"""The matrix maps points (x, y, 1) of the town, m, to pixels (u, v, 1) of the ground."""


def ground_image(town: Town, rng: np.random.Generator) -> Image:
    """Return the image of a town's ground from above, BGR; rows go from south to north, columns from west to east."""
    side = round(2 * _EDGE_M / _PIXEL_M)
    grass = np.full((side, side, 3), _GRASS, np.uint8)
    _draw_line(grass, town.road.points_xy, _ASPHALT, 2 * LANE_M + 0.24)
    ground = _textured(grass, rng)
    _draw_line(ground, town.road.points_xy, _YELLOW, LINE_M)
    _draw_line(ground, town.road.beside(-LANE_M), _WHITE, LINE_M)
    _draw_line(ground, town.road.beside(LANE_M), _WHITE, LINE_M)
    for light in town.lights:
        right = town.lane.at(light.stop_m, -0.4 * LANE_M)
        left = town.lane.at(light.stop_m, 0.4 * LANE_M)
        _draw_line(
            ground,
            np.array([[right.x_m, right.y_m], [left.x_m, left.y_m]]),
            _WHITE,
            LINE_M,
            closed=False,
        )
    return ground


def _draw_line(
    image: Image,
    points_xy: Floats,
    bgr: Bgr,
    width_m: float,
    *,
    closed: bool = True,
) -> None:
    pixels = (points_xy + _EDGE_M) / _PIXEL_M - 0.5
    fixed = np.rint(pixels * (1 << _SHIFT)).astype(np.int32)
    cv2.polylines(image, [fixed], closed, bgr, round(width_m / _PIXEL_M), cv2.LINE_AA, _SHIFT)


def _textured(image: Image, rng: np.random.Generator) -> Image:
    """Return the image with stains of 10, 5 and 2.5 cm, which give the ground ORB features."""
    side = image.shape[0]
    texture = np.zeros((side, side), np.float32)
    for cell, strength in ((8, 8.0), (4, 12.0), (2, 9.0)):
        coarse = rng.normal(0, strength, (side // cell, side // cell)).astype(np.float32)
        texture += cv2.resize(coarse, (side, side), interpolation=cv2.INTER_LINEAR)
    return np.asarray(np.clip(image + texture[..., None], 0, 255), np.uint8)


_NEAR_M = 0.12  #: Depth below which the scene draws nothing.
_POLE_AHEAD_M = 1.1  #: Distance of a traffic light behind its stop line.
_POLE_RIGHT_M = LANE_M / 2 + 0.15  #: Distance of a traffic light to the right of the lane's middle.
_RED_Z_M = 0.56
_GREEN_Z_M = 0.42
_LAMP_M = 0.06  #: Radius of a lamp.
_RED_LIT = (45, 45, 250)
_GREEN_LIT = (70, 235, 60)
_UNLIT = (45, 45, 45)
#: Half width, lower edge and upper edge of a traffic light's pole and head, m, with the colour of each.
_BOXES = ((0.02, 0.0, 0.34, (110, 110, 112)), (0.09, 0.33, 0.65, (28, 28, 28)))

_NOISES = 8  #: Number of noise images; the scene adds one of them to each frame.
_NOISE_LEVELS = 3.0  #: Standard deviation of the noise.
_STUCK_SHARE = 0.001  #: Share of the pixels that are always black or white.


class Scene:
    """A `Scene` is a town in front of a camera; `rng` samples the ground's texture and the camera's noise."""

    def __init__(self, town: Town, camera: Camera, rng: np.random.Generator) -> None:
        self._camera = camera
        self._ground = ground_image(town, rng)
        self._lights = [
            town.lane.at(light.stop_m + _POLE_AHEAD_M, -_POLE_RIGHT_M) for light in town.lights
        ]
        shape = (camera.height, camera.width, 3)
        self._noises = [
            rng.normal(0, _NOISE_LEVELS, shape).astype(np.float32) for _ in range(_NOISES)
        ]
        self._rng = rng
        self._gain_phase = float(rng.uniform(0, math.tau))

    def render(self, car: CarState, red: Sequence[bool], *, now_s: float) -> Image:
        """Return the camera's image (height, width, 3), BGR.

        Args:
            car: True state of the car.
            red: Whether each of the town's lights is red.
            now_s: Time on the town's clock; the exposure drifts with time.
        """
        image = self._ground_image(car)
        distances_m = [
            math.dist((light.x_m, light.y_m), (car.x_m, car.y_m)) for light in self._lights
        ]
        for i in np.argsort(distances_m)[::-1]:  # nearer lights hide lights behind them
            self._draw_light(image, car, self._lights[i], red=red[i])
        return self._exposed(image, now_s)

    def _ground_image(self, car: CarState) -> Image:
        """Return an image with the sky above the horizon and the ground below the horizon."""
        camera = self._camera
        top = camera.horizon_row
        image = np.full((camera.height, camera.width, 3), _SKY, np.uint8)
        cos = math.cos(car.yaw_rad)
        sin = math.sin(car.yaw_rad)
        town_from_vehicle = np.array([[cos, -sin, car.x_m], [sin, cos, car.y_m], [0.0, 0.0, 1.0]])
        image_from_below = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, top], [0.0, 0.0, 1.0]])
        town_from_below = town_from_vehicle @ camera.ground_from_image @ image_from_below
        image[top:] = cv2.warpPerspective(
            self._ground,
            _PIXELS_FROM_TOWN @ town_from_below,
            (camera.width, camera.height - top),
            flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP,
            borderMode=cv2.BORDER_CONSTANT,
            borderValue=_GRASS,
        )
        return image

    def _draw_light(self, image: Image, car: CarState, light: Pose, *, red: bool) -> None:
        """Draw a traffic light; the light shows its lamps only to the traffic of its lane."""
        for half, bottom, top, bgr in _BOXES:
            corners = [(half, bottom), (-half, bottom), (-half, top), (half, top)]
            pixels, depths = self._projected(car, light, corners)
            if depths.min() > _NEAR_M:
                cv2.fillConvexPoly(image, np.rint(pixels).astype(np.int32), bgr)
        ahead_m, _ = light.from_parent(car.x_m, car.y_m)
        if ahead_m >= 0:
            return  # the car is behind the light
        pixels, depths = self._projected(car, light, [(0.0, _RED_Z_M), (0.0, _GREEN_Z_M)])
        colors = (_RED_LIT, _UNLIT) if red else (_UNLIT, _GREEN_LIT)
        fixed = np.rint(pixels).astype(int) << _SHIFT
        for middle, depth, bgr in zip(fixed.tolist(), depths, colors, strict=True):
            if depth > _NEAR_M:
                radius = round(self._camera.focal_px * _LAMP_M / depth * (1 << _SHIFT))
                cv2.circle(image, middle, radius, bgr, cv2.FILLED, cv2.LINE_AA, _SHIFT)

    def _projected(
        self, car: CarState, light: Pose, points: Sequence[tuple[float, float]]
    ) -> tuple[Floats, Floats]:
        """Return pixels (n, 2) and depths (n,), m, of points that lie left of a light and above the ground, m."""
        left, up = np.transpose(points)
        from_car = car.from_parent(*light.to_parent(np.zeros_like(left), left))
        pixels, depths = self._camera.project(np.column_stack([*from_car, up]))
        return np.clip(pixels, -8000, 8000), depths  # OpenCV draws with coordinates of 16 bits

    def _exposed(self, image: Image, now_s: float) -> Image:
        """Return the image as the camera exposes the image: with a drifting gain, noise and stuck pixels."""
        gain = 0.9 + 0.1 * math.sin(0.3 * now_s + self._gain_phase)
        noise = self._noises[self._rng.integers(_NOISES)]
        noisy = cv2.scaleAdd(image.astype(np.float32), gain, noise)
        exposed = np.clip(noisy, 0, 255).astype(np.uint8)
        pixels = exposed.reshape(-1, 3)
        stuck = self._rng.integers(0, len(pixels), round(_STUCK_SHARE * len(pixels)))
        pixels[stuck] = 255 * self._rng.integers(0, 2, (len(stuck), 1), dtype=np.uint8)
        return exposed
