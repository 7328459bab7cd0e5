"""Lane control: drive commands from the lane, the lights and the odometry; knows no image.

Pure pursuit (Coulter, 1992): the arc through the lane's middle a lookahead away. A red light stops the car
until a green one. Where no lane is seen the car makes for the last point it was shown, by odometry, and halts
there.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

from sfglab.soc.driving.car import Drive
from sfglab.soc.driving.ports import Ports

if TYPE_CHECKING:
    from sfglab.soc.driving.odometry import Pose
    from sfglab.soc.driving.polyfit import Lane


PORTS = Ports(
    node="lane_control",
    subscribes=("/lane", "/red_light", "/green_light", "/pose"),
    publishes=("/cmd_vel",),
)


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
