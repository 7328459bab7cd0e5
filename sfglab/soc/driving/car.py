"""The car: its camera, with what that projects where, and the kinematic bicycle model of its drive.

Vehicle frame: origin on the ground below the camera, which stands over the rear axle; x forward, y left, z
up, in metres. Image: u to the right, v down, in pixels. A pinhole without distortion, pitched down. Refuses to
know lanes, lights, and what there is to see.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np

from sfglab.fields import between, check_bounds

if TYPE_CHECKING:
    from numpy.typing import NDArray


@dataclass(frozen=True, slots=True, kw_only=True)
class Camera:
    """A pinhole camera: at a width of 320 markings of 5 cm cover 4 pixels, and all scales with it."""

    width: int = between(320, 16)  #: Pixels a row.
    height: int = between(240, 16)  #: Rows.
    mount_m: float = between(0.35, without=(0,))  #: Height above the ground.
    pitch_rad: float = between(math.radians(6.0), 0, 1, without=(1,))  #: Downwards.

    def __post_init__(self) -> None:
        check_bounds(self)

    @property
    def focal_px(self) -> float:
        """Focal length; a horizontal field of view of 65 degrees."""
        return 0.78125 * self.width

    @property
    def horizon_row(self) -> int:
        """First row in which every pixel shows ground."""
        return math.ceil(self.height / 2 - self.focal_px * math.tan(self.pitch_rad)) + 1

    @property
    def image_from_ground(self) -> NDArray[np.float64]:
        """Homography from ground points (x, y, 1) of the vehicle frame to pixels (u, v, 1)."""
        return _pixels_from_vehicle(self)[:, [0, 1, 3]]

    @property
    def ground_from_image(self) -> NDArray[np.float64]:
        """Homography from pixels below the horizon to the ground."""
        return np.asarray(np.linalg.inv(self.image_from_ground), np.float64)

    def project(
        self, points_xyz: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return pixels (..., 2) of the vehicle's points (..., 3), m, good before depths (...) above 0, m."""
        matrix = _pixels_from_vehicle(self)
        raw = points_xyz @ matrix[:, :3].T + matrix[:, 3]
        depth = raw[..., 2]
        return raw[..., :2] / np.where(np.abs(depth) < 1e-9, 1e-9, depth)[..., None], depth


@lru_cache(maxsize=16)
def _pixels_from_vehicle(camera: Camera) -> NDArray[np.float64]:
    """The 3 x 4 projection matrix from vehicle frame to pixels."""
    sin, cos, f = math.sin(camera.pitch_rad), math.cos(camera.pitch_rad), camera.focal_px
    rotation = np.array([[0.0, -1.0, 0.0], [-sin, 0.0, -cos], [cos, 0.0, -sin]])
    camera_from_vehicle = np.column_stack([rotation, -rotation @ [0.0, 0.0, camera.mount_m]])
    intrinsic = np.array([[f, 0.0, camera.width / 2], [0.0, f, camera.height / 2], [0.0, 0.0, 1.0]])
    return np.asarray(intrinsic @ camera_from_vehicle, np.float64)


@dataclass(frozen=True, slots=True, kw_only=True)
class Drive:
    """A drive command, as in a Twist: wanted forward speed and yaw rate."""

    speed_mps: float = 0.0
    yaw_rate_rps: float = 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class CarState:
    """Pose of the rear axle in the town, speed, and angle of the front wheels (left is positive)."""

    x_m: float = 0.0
    y_m: float = 0.0
    yaw_rad: float = 0.0
    speed_mps: float = 0.0
    steer_rad: float = 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Chassis:
    """What the car can do: a model car of 1:10, all values assumed."""

    wheelbase_m: float = 0.26  #: Between the axles.
    width_m: float = 0.18  #: Over the wheels.
    acceleration_mps2: float = 1.5  #: Highest, also when braking.
    steer_rad: float = 0.5  #: Largest angle of the front wheels.
    steer_rate_rps: float = 3.0  #: How fast they turn.
    steer_bias_rad: float = 0.0  #: What the wheels really stand at when they should stand straight.


def drive(state: CarState, command: Drive, *, dt_s: float, chassis: Chassis) -> CarState:
    """Drive on from a state for `dt_s` seconds, following a command.

    x' = v cos(yaw), y' = v sin(yaw), yaw' = v tan(steer) / wheelbase, along the arc of the mean curvature;
    speed and steering follow the command as fast as the chassis can.
    """
    speed = state.speed_mps + _clipped(
        command.speed_mps - state.speed_mps, chassis.acceleration_mps2 * dt_s
    )
    wanted = math.atan(
        chassis.wheelbase_m * command.yaw_rate_rps / max(abs(command.speed_mps), 1e-3)
    )
    turn = _clipped(
        _clipped(wanted, chassis.steer_rad) - state.steer_rad, chassis.steer_rate_rps * dt_s
    )
    steer = state.steer_rad + (turn if command.speed_mps else 0.0)
    path = (state.speed_mps + speed) / 2 * dt_s
    yaw = (
        path
        * math.tan((state.steer_rad + steer) / 2 + chassis.steer_bias_rad)
        / chassis.wheelbase_m
    )
    chord = path * (math.sin(yaw / 2) / (yaw / 2) if abs(yaw) > 1e-9 else 1.0)
    return CarState(
        x_m=state.x_m + chord * math.cos(state.yaw_rad + yaw / 2),
        y_m=state.y_m + chord * math.sin(state.yaw_rad + yaw / 2),
        yaw_rad=math.remainder(state.yaw_rad + yaw, math.tau),
        speed_mps=speed,
        steer_rad=steer,
    )


def _clipped(value: float, limit: float) -> float:
    return max(-limit, min(limit, value))
