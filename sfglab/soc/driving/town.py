"""A town drawn by a seed: a road that closes, buildings along it, and traffic lights with their programmes.

Knows where things stand and when a light is red; refuses to know how they look and who drives. Frame: x east, y
north, metres. The road runs anticlockwise and has two lanes with a yellow line between them and white ones
outside; the car's is the right, outer one.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

#: Between the lines' middles, and a line's width: about a tenth of a town's road.
LANE_M, LINE_M = 0.5, 0.05

_SPACING_M = 0.05
_PERIOD_S, _RED_S = 12.0, 6.0
_LOOP_M = 3.0  #: How far before its stop line a light notices a car.

_RESTING, _CLOCKED = 3, 2
_CLEAR_M = 1.0  #: How far buildings stay from the road's middle.


@dataclass(frozen=True, slots=True, kw_only=True)
class Place:
    """A position seen from a lane: metres along it, metres to the left of its middle."""

    along_m: float
    left_m: float


class Road:
    """A closed line by points (n, 2) at equal distances in the direction of travel, the first not repeated."""

    def __init__(self, points_xy: NDArray[np.float64]) -> None:
        closed = np.vstack([points_xy, points_xy[:1]])
        along = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(closed, axis=0).T))])
        self.length_m = float(along[-1])
        at = (
            np.arange(round(self.length_m / _SPACING_M))
            / round(self.length_m / _SPACING_M)
            * self.length_m
        )
        self.points_xy = np.column_stack([np.interp(at, along, closed[:, axis]) for axis in (0, 1)])
        ahead = np.roll(self.points_xy, -1, axis=0) - np.roll(self.points_xy, 1, axis=0)
        self.tangents_xy = ahead / np.hypot(*ahead.T)[:, None]

    def beside(self, left_m: float) -> NDArray[np.float64]:
        """Return the points of the parallel line at a distance to the left."""
        normals = self.tangents_xy @ np.array([[0.0, 1.0], [-1.0, 0.0]])
        return np.asarray(self.points_xy + left_m * normals, np.float64)

    def at(self, along_m: float, left_m: float = 0.0) -> tuple[float, float, float]:
        """Return x, y and heading of a place."""
        i = round(along_m / self.length_m * len(self.points_xy)) % len(self.points_xy)
        (x, y), (tx, ty) = self.points_xy[i], self.tangents_xy[i]
        return float(x - left_m * ty), float(y + left_m * tx), math.atan2(ty, tx)

    def place(self, x_m: float, y_m: float) -> Place:
        """Return the place of a point, by the nearest point of the line and its tangent."""
        away = np.array([x_m, y_m]) - self.points_xy
        i = int(np.argmin((away * away).sum(axis=1)))
        (tx, ty), (dx, dy) = self.tangents_xy[i], away[i]
        along = i / len(self.points_xy) * self.length_m + dx * tx + dy * ty
        return Place(along_m=float(along % self.length_m), left_m=float(tx * dy - ty * dx))


@dataclass(frozen=True, slots=True, kw_only=True)
class Building:
    """A box: middle and heading of its footprint, its size, and its walls' colour (BGR)."""

    x_m: float
    y_m: float
    yaw_rad: float
    length_m: float
    width_m: float
    height_m: float
    bgr: tuple[int, int, int]

    @property
    def radius_m(self) -> float:
        """Of the circle around its footprint."""
        return math.hypot(self.length_m, self.width_m) / 2


@dataclass(frozen=True, slots=True, kw_only=True)
class Light:
    """A traffic light on the right of the lane."""

    stop_m: float  #: Its stop line, along the car's lane.
    #: A light that rests in red, as those with an induction loop do, turns green so long after a car came near,
    #: and stays so; None for one that changes by the clock.
    wait_s: float | None = None
    offset_s: float = 0.0  #: When the clock's first red begins.

    def red_since_s(self, now_s: float, arrived_s: float | None) -> float | None:
        """Return since when it has been red, None while green, by the town's clock now and at an arrival."""
        if self.wait_s is not None:
            return -math.inf if arrived_s is None or now_s < arrived_s + self.wait_s else None
        passed = (now_s - self.offset_s) % _PERIOD_S
        return now_s - passed if passed < _RED_S else None


@dataclass(frozen=True, slots=True, kw_only=True)
class Town:
    """All that stands in it."""

    road: Road  #: The yellow line.
    lane: Road  #: The middle of the car's lane.
    buildings: tuple[Building, ...]  #: In no order.
    lights: tuple[Light, ...]  #: In the order of the lane.


class Signals:
    """The lights of a town while a car drives: notes when it came near each."""

    def __init__(self, town: Town) -> None:
        self._town = town
        self._arrived_s: list[float | None] = [None] * len(town.lights)

    def red_since_s(self, now_s: float, car: Place) -> list[float | None]:
        """Return for each light since when it has been red, None for green, with the car where it is now."""
        for i, light in enumerate(self._town.lights):
            if self._arrived_s[i] is None and 0 <= light.stop_m - car.along_m <= _LOOP_M:
                self._arrived_s[i] = now_s
        pairs = zip(self._town.lights, self._arrived_s, strict=True)
        return [light.red_since_s(now_s, arrived) for light, arrived in pairs]


def make_town(rng: np.random.Generator) -> Town:
    """Draw a town: a loop of about 40 m, five lights, three at rest in red, buildings where there is room."""
    road = Road(_loop(rng))
    lane = Road(road.beside(-LANE_M / 2))
    return Town(road=road, lane=lane, buildings=_buildings(road, rng), lights=_lights(lane, rng))


def _loop(rng: np.random.Generator) -> NDArray[np.float64]:
    """Return a circle of 6 m with two waves on it; no bend is tighter than about 3 m."""
    angle = np.linspace(0, math.tau, 2000, endpoint=False)
    second = rng.uniform(0.04, 0.12) * np.cos(2 * angle + rng.uniform(0, math.tau))
    third = rng.uniform(0.0, 0.05) * np.cos(3 * angle + rng.uniform(0, math.tau))
    radius = 6.0 * (1 + second + third)
    return np.column_stack([radius * np.cos(angle), radius * np.sin(angle)])


def _lights(lane: Road, rng: np.random.Generator) -> tuple[Light, ...]:
    count = _RESTING + _CLOCKED
    stops = (np.arange(count) + 0.5 + rng.uniform(-0.12, 0.12, count)) / count * lane.length_m
    resting = set(rng.permutation(count)[:_RESTING].tolist())
    return tuple(
        Light(stop_m=float(stop), wait_s=float(rng.uniform(5, 8)))
        if i in resting
        else Light(stop_m=float(stop), offset_s=float(rng.uniform(0, _PERIOD_S)))
        for i, stop in enumerate(stops)
    )


def _buildings(road: Road, rng: np.random.Generator) -> tuple[Building, ...]:
    """Return boxes along both sides, none on the road or in another."""
    built: list[Building] = []
    for along in np.arange(0, road.length_m, 0.8):
        for side in (-1, 1):
            x, y, heading = road.at(float(along), side * rng.uniform(1.7, 3.2))
            candidate = _building(x, y, heading, rng)
            away = np.hypot(*(road.points_xy - (x, y)).T).min() - candidate.radius_m
            apart = [
                math.hypot(b.x_m - x, b.y_m - y) - b.radius_m - candidate.radius_m for b in built
            ]
            if away > _CLEAR_M and min(apart, default=1.0) > 0:
                built.append(candidate)
    return tuple(built)


def _building(x_m: float, y_m: float, heading: float, rng: np.random.Generator) -> Building:
    """Return a box of plain walls: pale or brick, none as vivid as a lamp or a lane's line."""
    blue, green, red = rng.uniform(80, 170) + rng.uniform(-25, 25, 3)
    return Building(
        x_m=x_m,
        y_m=y_m,
        yaw_rad=heading + float(rng.uniform(-0.3, 0.3)),
        length_m=float(rng.uniform(0.7, 1.4)),
        width_m=float(rng.uniform(0.6, 1.1)),
        height_m=float(rng.uniform(0.7, 2.0)),
        bgr=(int(blue), int(green), int(red)),
    )
