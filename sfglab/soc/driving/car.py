"""The module `car` has the geometry of the car's camera and the kinematic bicycle model of the car's motion.

The origin of the vehicle frame is on the ground below the camera; the camera is mounted above the rear axle. The
vehicle frame has x forward, y left and z up, in metres. An image has u to the right and v down, in pixels. This
module does not depend on lanes and traffic lights.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np

from sfglab.soc.driving.pose import Pose

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]


_MOUNT_M = 0.35  #: Height of the camera above the ground.
_PITCH_RAD = math.radians(6.0)  #: Downward pitch of the camera.


@dataclass(frozen=True, slots=True, kw_only=True)
class Camera:
    """A `Camera` is a pinhole camera without distortion that looks down by 6 degrees."""

    width: int = 320  #: Columns of an image.
    height: int = 240  #: Rows of an image.

    @property
    def focal_px(self) -> float:
        """Return the focal length in pixels; the camera's horizontal field of view has 65 degrees."""
        return 0.78125 * self.width

    @property
    def horizon_row(self) -> int:
        """Return the first row of an image in which all pixels show the ground."""
        horizon = self.height / 2 - self.focal_px * math.tan(_PITCH_RAD)
        return math.ceil(horizon) + 1

    @property
    def image_from_ground(self) -> Floats:
        """Return the homography (3, 3) from ground points (x, y, 1) of the vehicle frame to pixels (u, v, 1)."""
        return _image_from_vehicle(self)[:, [0, 1, 3]]

    @property
    def ground_from_image(self) -> Floats:
        """Return the homography (3, 3) from pixels below the horizon to ground points of the vehicle frame."""
        return np.asarray(np.linalg.inv(self.image_from_ground), np.float64)

    def project(self, points_xyz: Floats) -> tuple[Floats, Floats]:
        """Return pixels (n, 2) and depths (n,), m, of points (n, 3) of the vehicle frame, m.

        A pixel is valid if the depth of its point is positive.
        """
        matrix = _image_from_vehicle(self)
        raw = points_xyz @ matrix[:, :3].T + matrix[:, 3]
        depths = raw[:, 2]
        divisors = np.where(np.abs(depths) < 1e-9, 1e-9, depths)
        return raw[:, :2] / divisors[:, None], depths


@lru_cache(maxsize=16)
def _image_from_vehicle(camera: Camera) -> Floats:
    """Return the projection matrix (3, 4) from the vehicle frame to pixels."""
    sin = math.sin(_PITCH_RAD)
    cos = math.cos(_PITCH_RAD)
    focal = camera.focal_px
    rotation = np.array([[0.0, -1.0, 0.0], [-sin, 0.0, -cos], [cos, 0.0, -sin]])
    translation = -rotation @ [0.0, 0.0, _MOUNT_M]
    intrinsic = np.array(
        [[focal, 0.0, camera.width / 2], [0.0, focal, camera.height / 2], [0.0, 0.0, 1.0]]
    )
    return np.asarray(intrinsic @ np.column_stack([rotation, translation]), np.float64)


@dataclass(frozen=True, slots=True, kw_only=True)
class Drive:
    """A `Drive` is a drive command, as in a Twist message."""

    speed_mps: float = 0.0  #: Forward speed.
    yaw_rate_rps: float = 0.0  #: Yaw rate, positive to the left.


@dataclass(frozen=True, slots=True, kw_only=True)
class CarState(Pose):
    """A `CarState` is the pose of the rear axle in the town's frame, with the speed and the steering angle."""

    speed_mps: float = 0.0  #: Forward speed.
    steer_rad: float = 0.0  #: Angle of the front wheels, positive to the left, rad.


# The limits of the car are assumed, as for a model car of scale 1:10.
_WHEELBASE_M = 0.26  #: Distance between the axles.
_ACCELERATION_MPS2 = 1.5  #: Largest acceleration and deceleration.
_STEER_RAD = 0.5  #: Largest steering angle.
_STEER_RATE_RPS = 3.0  #: Largest steering rate.


def drive(state: CarState, command: Drive, *, dt_s: float, steer_bias_rad: float = 0.0) -> CarState:
    """Return the state of a car that has followed a command for `dt_s` seconds.

    The kinematic bicycle model is x' = v cos(yaw), y' = v sin(yaw), yaw' = v tan(steer) / wheelbase. The car
    moves along the arc of the mean curvature. Speed and steering follow the command within the car's limits.
    The steering angle has the error `steer_bias_rad`, which the nodes do not know.
    """
    speed_change = command.speed_mps - state.speed_mps
    speed = state.speed_mps + _limited(speed_change, _ACCELERATION_MPS2 * dt_s)
    steer = state.steer_rad
    if command.speed_mps:
        curvature = command.yaw_rate_rps / max(abs(command.speed_mps), 1e-3)
        wanted = _limited(math.atan(_WHEELBASE_M * curvature), _STEER_RAD)
        steer += _limited(wanted - state.steer_rad, _STEER_RATE_RPS * dt_s)
    mean_steer = (state.steer_rad + steer) / 2 + steer_bias_rad
    path = (state.speed_mps + speed) / 2 * dt_s
    half_turn = path * math.tan(mean_steer) / _WHEELBASE_M / 2
    chord = path
    if abs(half_turn) > 1e-9:
        chord *= math.sin(half_turn) / half_turn
    return CarState(
        x_m=state.x_m + chord * math.cos(state.yaw_rad + half_turn),
        y_m=state.y_m + chord * math.sin(state.yaw_rad + half_turn),
        yaw_rad=math.remainder(state.yaw_rad + 2 * half_turn, math.tau),
        speed_mps=speed,
        steer_rad=steer,
    )


def _limited(value: float, limit: float) -> float:
    return max(-limit, min(limit, value))
