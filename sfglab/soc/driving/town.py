"""The module `town` samples a town from a seed: a closed road, and traffic lights with their schedules.

The frame of the town has x east and y north, in metres. The road runs anticlockwise. The road has two lanes with a
yellow line between the lanes and a white line on each outer side. The car drives in the right lane, which is the
outer lane. The module `town` does not contain the look of the town and the place of the car.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from sfglab.soc.driving.pose import Pose

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]

#: Width of a lane, between the middles of its lines; about a tenth of a real lane's width.
LANE_M = 0.5
LINE_M = 0.05  #: Width of a line.

_SPACING_M = 0.05
_PERIOD_S = 12.0
_RED_S = 6.0
_LOOP_M = 3.0  #: Distance before a light's stop line at which the light detects the car.
_RESTING = 3
_CLOCKED = 2


@dataclass(frozen=True, slots=True, kw_only=True)
class Place:
    """A `Place` is a position relative to a lane."""

    along_m: float  #: Distance along the lane's middle from its first point, m.
    left_m: float  #: Distance to the left of the lane's middle, m.


class Road:
    """A `Road` is a closed line with equally spaced points in the direction of travel.

    Args:
        points_xy: Corners (n, 2), m. The last corner joins the first corner.
    """

    def __init__(self, points_xy: Floats) -> None:
        closed = np.vstack([points_xy, points_xy[:1]])
        steps_m = np.hypot(*np.diff(closed, axis=0).T)
        along_m = np.concatenate([[0.0], np.cumsum(steps_m)])
        self.length_m = float(along_m[-1])
        count = round(self.length_m / _SPACING_M)
        spaced_m = np.arange(count) / count * self.length_m
        x = np.interp(spaced_m, along_m, closed[:, 0])
        y = np.interp(spaced_m, along_m, closed[:, 1])
        self.points_xy = np.column_stack([x, y])
        ahead = np.roll(self.points_xy, -1, axis=0) - np.roll(self.points_xy, 1, axis=0)
        self.tangents_xy = ahead / np.hypot(*ahead.T)[:, None]

    def beside(self, left_m: float) -> Floats:
        """Return the points (n, 2), m, of the parallel line at a distance to the left, m."""
        normals_xy = np.column_stack([-self.tangents_xy[:, 1], self.tangents_xy[:, 0]])
        return np.asarray(self.points_xy + left_m * normals_xy, np.float64)

    def at(self, along_m: float, left_m: float = 0.0) -> Pose:
        """Return the pose at `along_m` on the line and `left_m` to its left, in the direction of travel."""
        i = round(along_m / self.length_m * len(self.points_xy)) % len(self.points_xy)
        x, y = self.points_xy[i]
        tangent_x, tangent_y = self.tangents_xy[i]
        return Pose(
            x_m=float(x - left_m * tangent_y),
            y_m=float(y + left_m * tangent_x),
            yaw_rad=math.atan2(tangent_y, tangent_x),
        )

    def place(self, x_m: float, y_m: float) -> Place:
        """Return the place of a point, m in the town's frame, relative to the tangent at the line's nearest point."""
        away_xy = np.array([x_m, y_m]) - self.points_xy
        i = int(np.argmin((away_xy * away_xy).sum(axis=1)))
        tangent_x, tangent_y = self.tangents_xy[i]
        away_x, away_y = away_xy[i]
        nearest_m = i / len(self.points_xy) * self.length_m
        along_m = nearest_m + away_x * tangent_x + away_y * tangent_y
        left_m = tangent_x * away_y - tangent_y * away_x
        return Place(along_m=float(along_m % self.length_m), left_m=float(left_m))


@dataclass(frozen=True, slots=True, kw_only=True)
class Light:
    """A `Light` is a traffic light on the right of the lane."""

    stop_m: float  #: Position of the light's stop line along the car's lane, m.
    #: Time from the detection of a car to green, s. A light with `wait_s` is red until this time, as with an
    #: induction loop, and green afterwards. A light with None follows the clock.
    wait_s: float | None = None
    offset_s: float = 0.0  #: Begin of the first red phase of a light that follows the clock, s.

    def red_since_s(self, now_s: float, detected_s: float | None) -> float | None:
        """Return the time at which the light turned red, s, or None while the light is green.

        The argument `detected_s` is the time at which the light detected the car; None before the detection.
        """
        if self.wait_s is not None:
            turned_green = detected_s is not None and now_s >= detected_s + self.wait_s
            return None if turned_green else -math.inf
        elapsed_s = (now_s - self.offset_s) % _PERIOD_S
        return now_s - elapsed_s if elapsed_s < _RED_S else None


@dataclass(frozen=True, slots=True, kw_only=True)
class Town:
    """A `Town` has a road, the car's lane and traffic lights."""

    road: Road  #: Middle line of the road, which is yellow.
    lane: Road  #: Middle of the car's lane.
    lights: tuple[Light, ...]  #: Traffic lights in the order of the lane.


class Signals:
    """`Signals` keeps the state of a town's traffic lights during one drive."""

    def __init__(self, town: Town) -> None:
        self._lights = town.lights
        self._detected_s: list[float | None] = [None] * len(town.lights)

    def red_since_s(self, now_s: float, car: Place) -> list[float | None]:
        """Detect the car at the lights, and return when each light turned red, s in the town; None for a green one."""
        found = []
        for i, light in enumerate(self._lights):
            if self._detected_s[i] is None and 0 <= light.stop_m - car.along_m <= _LOOP_M:
                self._detected_s[i] = now_s
            found.append(light.red_since_s(now_s, self._detected_s[i]))
        return found


def make_town(rng: np.random.Generator) -> Town:
    """Sample a town with a loop of about 40 m and five lights; three lights are red until a car comes."""
    road = Road(_loop(rng))
    lane = Road(road.beside(-LANE_M / 2))
    return Town(road=road, lane=lane, lights=_lights(lane, rng))


def _loop(rng: np.random.Generator) -> Floats:
    """Return the corners of a circle of radius 6 m with two waves; all bends have a radius of about 3 m or more."""
    angle = np.linspace(0, math.tau, 2000, endpoint=False)
    second = rng.uniform(0.04, 0.12) * np.cos(2 * angle + rng.uniform(0, math.tau))
    third = rng.uniform(0.0, 0.05) * np.cos(3 * angle + rng.uniform(0, math.tau))
    radius = 6.0 * (1 + second + third)
    return np.column_stack([radius * np.cos(angle), radius * np.sin(angle)])


def _lights(lane: Road, rng: np.random.Generator) -> tuple[Light, ...]:
    count = _RESTING + _CLOCKED
    shares = (np.arange(count) + 0.5 + rng.uniform(-0.12, 0.12, count)) / count
    stops_m = shares * lane.length_m
    resting = rng.permutation(count)[:_RESTING]
    lights = []
    for i, stop_m in enumerate(stops_m.tolist()):
        if i in resting:
            light = Light(stop_m=stop_m, wait_s=rng.uniform(5, 8))
        else:
            light = Light(stop_m=stop_m, offset_s=rng.uniform(0, _PERIOD_S))
        lights.append(light)
    return tuple(lights)
