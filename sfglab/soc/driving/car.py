"""The kinematic bicycle model of the car; refuses to know lanes, lights and cameras."""

from __future__ import annotations

import math
from dataclasses import dataclass

from sfglab.soc.driving.ports import Ports

PORTS = Ports(node="car", subscribes=("/cmd_vel",), publishes=())


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
    """Drive on for a moment.

    x' = v cos(yaw), y' = v sin(yaw), yaw' = v tan(steer) / wheelbase, along the arc of the mean curvature;
    speed and steering follow the command as fast as the chassis can.

    Args:
        state: Where the car is.
        command: What it should do.
        dt_s: How long.
        chassis: What it can do.
    """
    gain = chassis.acceleration_mps2 * dt_s
    speed = state.speed_mps + _clipped(command.speed_mps - state.speed_mps, gain)
    wanted = math.atan(chassis.wheelbase_m * command.yaw_rate_rps / max(abs(command.speed_mps), 1e-3))
    turn = _clipped(_clipped(wanted, chassis.steer_rad) - state.steer_rad, chassis.steer_rate_rps * dt_s)
    steer = state.steer_rad + (turn if command.speed_mps else 0.0)
    path = (state.speed_mps + speed) / 2 * dt_s
    yaw = path * math.tan((state.steer_rad + steer) / 2 + chassis.steer_bias_rad) / chassis.wheelbase_m
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
