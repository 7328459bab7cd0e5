"""The pictures of the car's camera: the ground warped, boxes and lights stood on it, a camera's noise over all.

The ground is one picture from above: grass, asphalt, lines. Knows the town and the car's true pose, and turns
them into pixels, which are all that the nodes get.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import cv2
import numpy as np

from sfglab.soc.driving.town import LANE_M, LINE_M, Building, Town

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from sfglab.soc.driving.car import Camera, CarState

GRASS_BGR = (66, 96, 74)
_ASPHALT, _WHITE, _YELLOW = (92, 90, 88), (225, 228, 230), (40, 190, 225)
_PIXEL_M = 0.0125
_EDGE_M = 9.0
_SHIFT = 4  #: Binary places of a pixel that lines are drawn with.


@dataclass(frozen=True, slots=True, kw_only=True)
class Ground:
    """A picture of the ground."""

    bgr: NDArray[np.uint8]  #: Rows from south to north, columns from west to east.
    #: Matrix from (x, y, 1) in metres to its pixels (u, v, 1).
    picture_from_town: NDArray[np.float64]


def draw_ground(town: Town, rng: np.random.Generator) -> Ground:
    """Draw a town's ground: road, stop lines, and texture, without which odometry would see nothing."""
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
    cv2.polylines(
        picture, [np.rint(pixels).astype(np.int32)], closed, bgr, width, cv2.LINE_AA, _SHIFT
    )


def _textured(picture: NDArray[np.uint8], rng: np.random.Generator) -> NDArray[np.uint8]:
    """Return the picture with stains of 10 cm and 5 cm and grain of 2.5 cm."""
    size = picture.shape[0]
    texture = np.zeros((size, size), np.float32)
    for cell, strength in ((8, 8.0), (4, 12.0), (2, 9.0)):
        coarse = rng.normal(0, strength, (size // cell, size // cell)).astype(np.float32)
        texture += cv2.resize(coarse, (size, size), interpolation=cv2.INTER_LINEAR)
    return np.asarray(np.clip(picture + texture[..., None], 0, 255), np.uint8)


_NEAR_M, _FAR_M = 0.12, 14.0
_SKY_BGR = (214, 190, 168)
_POLE_AHEAD_M, _POLE_RIGHT_M = 1.1, LANE_M / 2 + 0.15
"""A light stands so far behind its stop line and to the right of the lane's middle."""

_LAMP_M = 0.06
_RED_Z_M, _GREEN_Z_M = 0.56, 0.42
_LIT = {True: (45, 45, 250), False: (70, 235, 60)}
_DARK_BGR, _HEAD_BGR, _POLE_BGR = (45, 45, 45), (28, 28, 28), (110, 110, 112)
_NOISES = 8
_UP = np.array([0.0, 0.0, 1.0])
_GRAIN, _HOT_SHARE = 3.0, 0.001
"""Standard deviation of the noise in levels, and the share of pixels that are stuck at black or white."""


@dataclass(frozen=True, slots=True, kw_only=True)
class _Wall:
    """A wall: its corners and then its windows' (1 + n, 4, 3), outward normal, middle and colour."""

    quads: NDArray[np.float64]
    normal: NDArray[np.float64]
    middle: NDArray[np.float64]
    bgr: tuple[int, int, int]


class Scene:
    """A town before a camera; `rng` draws textures and the camera's noise."""

    def __init__(self, town: Town, camera: Camera, rng: np.random.Generator) -> None:
        self._town, self._camera = town, camera
        self._ground = draw_ground(town, rng)
        self._walls = [wall for building in town.buildings for wall in _walls(building)]
        self._middles = np.array([wall.middle for wall in self._walls]).reshape(-1, 3)
        self._normals = np.array([wall.normal for wall in self._walls]).reshape(-1, 3)
        self._poles = [
            town.lane.at(light.stop_m + _POLE_AHEAD_M, -_POLE_RIGHT_M) for light in town.lights
        ]
        shape = (camera.height, camera.width, 3)
        self._noises = [rng.normal(0, _GRAIN, shape).astype(np.float32) for _ in range(_NOISES)]
        self._rng = rng
        self._gain_phase = float(rng.uniform(0, math.tau))

    def render(self, car: CarState, red: Sequence[bool], *, now_s: float) -> NDArray[np.uint8]:
        """Return the image (height, width, 3) BGR from a car; `red` by light; exposure drifts with `now_s`."""
        image = self._ground_image(car)
        view = _View(car, self._camera)
        shown = [self._walls[i] for i in np.flatnonzero(view.sees(self._middles, self._normals))]
        things: list[tuple[float, _Wall | int]] = [
            *zip(
                view.distances(np.array([w.middle for w in shown]).reshape(-1, 3)),
                shown,
                strict=True,
            ),
            *zip(view.distances(np.array(self._poles)), range(len(self._poles)), strict=True),
        ]
        for _, thing in sorted(things, key=lambda pair: -pair[0]):
            if isinstance(thing, _Wall):
                _draw_wall(image, view, thing)
            else:
                _draw_light(image, view, self._poles[thing], red=red[thing])
        return self._exposed(image, now_s)

    def _ground_image(self, car: CarState) -> NDArray[np.uint8]:
        """Return the sky, and below the horizon the ground by one perspective warp."""
        camera, top = self._camera, self._camera.horizon_row
        image = np.full((camera.height, camera.width, 3), _SKY_BGR, np.uint8)
        cos, sin = math.cos(car.yaw_rad), math.sin(car.yaw_rad)
        town_from_vehicle = np.array([[cos, -sin, car.x_m], [sin, cos, car.y_m], [0.0, 0.0, 1.0]])
        below = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, top], [0.0, 0.0, 1.0]])
        matrix = (
            self._ground.picture_from_town @ town_from_vehicle @ camera.ground_from_image @ below
        )
        image[top:] = cv2.warpPerspective(
            self._ground.bgr,
            matrix,
            (camera.width, camera.height - top),
            flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP,
            borderMode=cv2.BORDER_CONSTANT,
            borderValue=GRASS_BGR,
        )
        return image

    def _exposed(self, image: NDArray[np.uint8], now_s: float) -> NDArray[np.uint8]:
        gain = 0.9 + 0.1 * math.sin(0.3 * now_s + self._gain_phase)
        noisy = cv2.scaleAdd(
            image.astype(np.float32), gain, self._noises[self._rng.integers(_NOISES)]
        )
        exposed = np.clip(noisy, 0, 255).astype(np.uint8)
        hot = self._rng.integers(
            0, image.shape[0] * image.shape[1], round(_HOT_SHARE * image[..., 0].size)
        )
        exposed.reshape(-1, 3)[hot] = 255 * self._rng.integers(0, 2, (len(hot), 1), dtype=np.uint8)
        return exposed


class _View:
    """The camera at a pose of the car: town points to pixels."""

    def __init__(self, car: CarState, camera: Camera) -> None:
        self._camera = camera
        cos, sin = math.cos(car.yaw_rad), math.sin(car.yaw_rad)
        self._vehicle_from_town = np.array([[cos, sin, 0.0], [-sin, cos, 0.0], [0.0, 0.0, 1.0]])
        self._eye = np.array([car.x_m, car.y_m, camera.mount_m])
        self._base = np.array([car.x_m, car.y_m, 0.0])

    def distances(self, points: NDArray[np.float64]) -> list[float]:
        """Return the distances over ground of points (n, 2 or more)."""
        return [float(distance) for distance in np.hypot(*(points[:, :2] - self._eye[:2]).T)]

    def sees(self, middles: NDArray[np.float64], normals: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Return which faces (n, 3) look at the camera, are near enough and not far behind it."""
        away = self._eye - middles
        ahead = -(away @ self._vehicle_from_town[0])
        faces = (away * normals).sum(axis=1) > 0
        return np.asarray(faces & (ahead > -1.0) & (ahead < _FAR_M), np.bool_)

    def vehicle(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.asarray((points - self._base) @ self._vehicle_from_town.T, np.float64)

    def polygon(self, corners: NDArray[np.float64]) -> NDArray[np.int32] | None:
        """Return the pixels of a polygon cut off before the camera; None where nothing is left."""
        points = self.vehicle(corners)
        pixels, depths = self._camera.project(points)
        if depths.min() < _NEAR_M:
            points = _clipped(points, depths - _NEAR_M)
            pixels = self._camera.project(points)[0]
        return None if len(points) < 3 else _pixels(pixels)

    def project(self, quads: NDArray[np.float64]) -> tuple[NDArray[np.int32], NDArray[np.bool_]]:
        """Return the pixels of many quads (n, 4, 3), and which of them lie wholly before the camera."""
        pixels, depth = self._camera.project(self.vehicle(quads))
        return _pixels(pixels), np.asarray((depth > _NEAR_M).all(axis=1), np.bool_)

    def disc(
        self, middle: NDArray[np.float64], radius_m: float
    ) -> tuple[tuple[int, int], int] | None:
        """Return middle and radius, in sixteenths of a pixel, of a disc that faces the camera."""
        pixel, depth = self._camera.project(self.vehicle(middle))
        if depth < _NEAR_M:
            return None
        u, v = (int(c) for c in _pixels(pixel) * 16)
        return (u, v), round(16 * self._camera.focal_px * radius_m / float(depth))


def _pixels(pixels: NDArray[np.float64]) -> NDArray[np.int32]:
    return np.rint(np.clip(pixels, -8000, 8000)).astype(np.int32)


def _clipped(points: NDArray[np.float64], inside: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return a polygon's part on the inner side of a plane, given distances to it (Sutherland and Hodgman)."""
    kept = []
    for i, (a, before) in enumerate(zip(inside, np.roll(inside, 1), strict=True)):
        if (a >= 0) != (before >= 0):
            kept.append(points[i] + (points[i - 1] - points[i]) * (a / (a - before)))
        if a >= 0:
            kept.append(points[i])
    return np.array(kept).reshape(-1, points.shape[-1])


def _draw_wall(image: NDArray[np.uint8], view: _View, wall: _Wall) -> None:
    """Draw a wall and its windows, if any of it lies between the image's sides."""
    pixels, before = view.project(wall.quads)
    polygon = pixels[0] if before[0] else view.polygon(wall.quads[0])
    if polygon is None or polygon[:, 0].max() < 0 or polygon[:, 0].min() >= image.shape[1]:
        return
    cv2.fillConvexPoly(image, polygon, wall.bgr)
    cv2.fillPoly(image, list(pixels[1:][before[1:]]), tuple(c // 2 for c in wall.bgr))


def _draw_light(
    image: NDArray[np.uint8], view: _View, pole: tuple[float, float, float], *, red: bool
) -> None:
    """Draw a light that faces the traffic of its lane; from behind it shows no lamp."""
    x, y, heading = pole
    facing = -np.array([math.cos(heading), math.sin(heading), 0.0])
    side = np.array([facing[1], -facing[0], 0.0])
    foot = np.array([x, y, 0.0])
    for half, bottom, top, bgr in ((0.02, 0.0, 0.34, _POLE_BGR), (0.09, 0.33, 0.65, _HEAD_BGR)):
        corners = [(-half, bottom), (half, bottom), (half, top), (-half, top)]
        polygon = view.polygon(np.array([foot + across * side + z * _UP for across, z in corners]))
        if polygon is not None:
            cv2.fillConvexPoly(image, polygon, bgr)
    if not view.sees(foot[None], facing[None])[0]:
        return
    for z, lit in ((_RED_Z_M, red), (_GREEN_Z_M, not red)):
        disc = view.disc(foot + z * _UP, _LAMP_M)
        if disc is not None:
            cv2.circle(image, *disc, _LIT[red] if lit else _DARK_BGR, cv2.FILLED, cv2.LINE_AA, 4)


def _walls(building: Building) -> list[_Wall]:
    """Return a building's four walls with their windows."""
    cos, sin = math.cos(building.yaw_rad), math.sin(building.yaw_rad)
    half = np.array([building.length_m, building.width_m]) / 2
    signs = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)])
    feet = signs * half @ np.array([[cos, sin], [-sin, cos]]) + (building.x_m, building.y_m)
    pairs = zip(feet, np.roll(feet, -1, axis=0), strict=True)
    return [_wall(a, b, building, 0.8 + 0.1 * i) for i, (a, b) in enumerate(pairs)]


def _wall(
    a: NDArray[np.float64], b: NDArray[np.float64], building: Building, shade: float
) -> _Wall:
    """Return the wall over the line from a to b, outside on its right."""
    along, high = np.append(b - a, 0.0), np.array([0.0, 0.0, building.height_m])
    foot = np.append(a, 0.0)
    columns, rows = max(int(np.hypot(*(b - a)) / 0.25), 1), max(int(building.height_m / 0.3), 1)
    corners = [(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)]
    windows = [
        [
            foot + along * (c + 0.25 + 0.5 * u) / columns + high * (r + 0.3 + 0.5 * v) / rows
            for u, v in corners
        ]
        for c in range(columns)
        for r in range(rows)
    ]
    blue, green, red = (int(shade * level) for level in building.bgr)
    normal = np.array([along[1], -along[0], 0.0])
    return _Wall(
        quads=np.array([[foot + along * u + high * v for u, v in corners], *windows]),
        normal=normal / np.hypot(*normal[:2]),
        middle=foot + along / 2,
        bgr=(blue, green, red),
    )
