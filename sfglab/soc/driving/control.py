"""Light detection and lane control: drive commands from the lane, the lights and the odometry.

Paper C, section 6: a red light found stops the robot and activates the detection of green; a green one found
lets it drive and activates the detection of red. Both hear each other's topic; each says something only when
it found its light, and sleeps then. Control is pure pursuit (Coulter, 1992): the arc through the lane's middle
a lookahead away. Where no lane is seen the car makes for the last point it was shown, by odometry, and halts
there.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum
from typing import TYPE_CHECKING

import cv2
import numpy as np

from sfglab.soc.driving.car import Drive

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from sfglab.soc.driving.lane import Lane
    from sfglab.soc.driving.odometry import Pose


class Colour(Enum):
    """A light's colour; its value is the hues (of 180) from which to which, wrapping at 180."""

    RED = (172, 8)
    GREEN = (45, 85)


_SATURATION, _VALUE = 130, 150
_ROUND = 0.6
"""Least share of its enclosing circle that a lamp's blob covers; 1 for a disc, 0.64 for a square."""

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
    mask = _colour_mask(bgr, colour)
    contours = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_SIMPLE)[0]
    lamps = []
    for contour in contours:
        (u, v), radius = cv2.minEnclosingCircle(contour)
        if radius >= 2 and cv2.contourArea(contour) > _ROUND * math.pi * radius * radius:
            lamps.append(Lamp(u=float(u), v=float(v), radius=float(radius)))
    return lamps


def _colour_mask(bgr: NDArray[np.uint8], colour: Colour) -> NDArray[np.uint8]:
    hsv = cv2.cvtColor(bgr, cv2.COLOR_BGR2HSV)
    first, last = colour.value
    spans = [(first, last)] if first <= last else [(first, 179), (0, last)]
    masks = [cv2.inRange(hsv, (a, _SATURATION, _VALUE), (b, 255, 255)) for a, b in spans]
    return np.asarray(masks[0] if len(masks) == 1 else cv2.bitwise_or(*masks), np.uint8)


class LightDetector:
    """One of the two detection nodes.

    Args:
        colour: What it looks for. The red one starts active, the green one asleep.
    """

    def __init__(self, colour: Colour) -> None:
        self.colour = colour
        self.active = colour is Colour.RED

    def see(self, bgr: NDArray[np.uint8]) -> bool:
        """Look at an image of topic A.

        Returns:
            Whether the node publishes that it found its light; it sleeps from then on.
        """
        if not self.active:
            return False
        low, high = (share * bgr.shape[1] for share in _RADII[self.colour])
        found = any(low <= lamp.radius <= high for lamp in find_lamps(bgr, self.colour))
        self.active = not found
        return found

    def hear_other(self) -> None:
        """Take the other detector's message: it found its light, so this one wakes."""
        self.active = True


@dataclass(frozen=True, slots=True, kw_only=True)
class Control:
    """Constants of the controller, all chosen here (the paper gives none)."""

    speed_mps: float = 0.9  #: On a straight lane.
    lookahead_m: float = 0.9  #: How far ahead the car aims.
    lateral_mps2: float = 0.35  #: Highest lateral acceleration; bends are taken slower for it.
    arrived_m: float = 0.3  #: How near a remembered point is not aimed at any more.


class LaneControl:
    """The lane-control node: remembers whether a red light holds the car, and the last point it aimed at.

    Args:
        control: Its constants.
    """

    def __init__(self, control: Control | None = None) -> None:
        self.control = control or Control()
        self.held = False
        self._aim_odometry: tuple[float, float] | None = None

    def hear_red(self) -> None:
        """Take a message of the red light's detection: stop."""
        self.held = True

    def hear_green(self) -> None:
        """Take a message of the green light's detection: drive."""
        self.held = False

    def step(self, lane: Lane | None, pose: Pose) -> Drive:
        """Return the command for a frame.

        Args:
            lane: What `fit_lane` found in it.
            pose: Odometry at that frame.
        """
        if lane is not None:
            x = self.control.lookahead_m
            self._aim_odometry = pose.outwards(x, lane.y_m(x))
        if self.held or self._aim_odometry is None:
            return Drive()
        return self._towards(*pose.inwards(*self._aim_odometry))

    def _towards(self, x_m: float, y_m: float) -> Drive:
        """Return the command along the arc through a point of the vehicle frame."""
        if x_m < self.control.arrived_m:
            return Drive()
        curvature = 2 * y_m / (x_m * x_m + y_m * y_m)
        limit = math.sqrt(self.control.lateral_mps2 / max(abs(curvature), 1e-6))
        speed = min(self.control.speed_mps, limit)
        return Drive(speed_mps=speed, yaw_rate_rps=speed * curvature)
