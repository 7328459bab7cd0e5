"""A simulated agent: a point with a heading that is steered within its limits.

First order in velocity: it nears what is wanted with a time constant, and no faster than its acceleration
allows. Orientation turns along the shortest way. Knows nothing of trajectories (`follower`) and clocks.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

from sfglab.errors import SfglabError
from sfglab.spatial.poses import Pose
from sfglab.spatial.trajectory import Limits

if TYPE_CHECKING:
    from sfglab.spatial.poses import Vec3


_ZERO: Vec3 = (0.0, 0.0, 0.0)
_STANDS_M_S = 1e-9
_WELL_DAMPED = 0.25


class DynamicsError(SfglabError, ValueError):
    """Numbers that no agent can have."""


@dataclass(frozen=True, slots=True, kw_only=True)
class AgentState:
    """Where an agent is and how it moves."""

    pose: Pose = field(default_factory=Pose)  #: In the fixed frame.
    velocity_m_s: Vec3 = _ZERO  #: In the fixed frame.
    yaw_rate_rad_s: float = 0.0  #: About the fixed z axis, of the last step.

    @property
    def speed_m_s(self) -> float:
        """Length of the velocity."""
        return math.hypot(*self.velocity_m_s)


@dataclass(frozen=True, slots=True, kw_only=True)
class Dynamics:
    """How an agent answers.

    Raises:
        DynamicsError: A number is negative or not finite, or gain times lag is above 1/4, where it overshoots.
    """

    #: Never exceeded, whatever is asked for; the yaw rate's bounds the whole turn's rate.
    limits: Limits = field(default_factory=Limits)
    lag_s: float = 0.1  #: Time constant of the velocity; 0: only the limits hold it back.
    gain_per_s: float = 2.0  #: How much velocity is added to a target's for every metre that is missing.

    def __post_init__(self) -> None:
        if not 0.0 <= self.lag_s < math.inf or not 0.0 < self.gain_per_s < math.inf:
            given = f"lag {self.lag_s} s, gain {self.gain_per_s} / s"
            raise DynamicsError(f"dynamics: given {given}, allowed are a lag from 0 and a gain above 0")
        if self.lag_s * self.gain_per_s > _WELL_DAMPED:
            given = f"{self.lag_s} s times {self.gain_per_s} / s"
            raise DynamicsError(f"dynamics: given {given}, allowed is a product of lag and gain up to 1/4")


@dataclass(frozen=True, slots=True, kw_only=True)
class Target:
    """Where to be, and how fast to be moving there."""

    pose: Pose  #: In the fixed frame.
    velocity_m_s: Vec3 = _ZERO  #: In the fixed frame.


def steered(state: AgentState, target: Target, dt_s: float, dynamics: Dynamics) -> AgentState:
    """Return an agent a little later, after steering towards a target.

    Args:
        state: Where it is.
        target: Where it should be then.
        dt_s: How much later, above zero; some hundredths of a second.
        dynamics: How it answers.
    """
    missing = _minus(target.pose.position_m, state.pose.position_m)
    wanted = _plus(target.velocity_m_s, _scaled(missing, _approach_per_s(math.hypot(*missing), dynamics)))
    wanted = _at_most(wanted, dynamics.limits.speed_m_s)
    velocity = _towards(state.velocity_m_s, wanted, dt_s, dynamics)
    return _moved(state, velocity, target.pose, dt_s, dynamics.limits.yaw_rate_rad_s)


def braked(state: AgentState, dt_s: float, dynamics: Dynamics) -> AgentState:
    """Return an agent a little later, after braking; it does not turn meanwhile."""
    velocity = _towards(state.velocity_m_s, _ZERO, dt_s, replace(dynamics, lag_s=0.0))
    if math.hypot(*velocity) < _STANDS_M_S:
        velocity = _ZERO
    return _moved(state, velocity, state.pose, dt_s, None)


def _approach_per_s(distance_m: float, dynamics: Dynamics) -> float:
    """Return how fast to go for every metre that is missing: so fast that one can still brake.

    Proportional near the target; further away the square root of acceleration times distance, whose braking
    takes half of the acceleration, and which meets the proportional law without a step.
    """
    acceleration = dynamics.limits.acceleration_m_s2
    if acceleration is None or distance_m * dynamics.gain_per_s**2 <= acceleration:
        return dynamics.gain_per_s
    return math.sqrt(acceleration / distance_m)


def _towards(velocity: Vec3, wanted: Vec3, dt_s: float, dynamics: Dynamics) -> Vec3:
    share = -math.expm1(-dt_s / dynamics.lag_s) if dynamics.lag_s else 1.0
    limit = dynamics.limits.acceleration_m_s2
    change = _scaled(_minus(wanted, velocity), share)
    return _plus(velocity, _at_most(change, None if limit is None else limit * dt_s))


def _moved(
    state: AgentState, velocity: Vec3, towards: Pose, dt_s: float, rate_rad_s: float | None
) -> AgentState:
    angle = state.pose.angle_rad(towards)
    share = 1.0 if rate_rad_s is None or angle <= rate_rad_s * dt_s else rate_rad_s * dt_s / angle
    turned = state.pose.interpolate(towards, share)
    pose = Pose(position_m=_plus(state.pose.position_m, _scaled(velocity, dt_s)), quat_xyzw=turned.quat_xyzw)
    return AgentState(
        pose=pose, velocity_m_s=velocity, yaw_rate_rad_s=_yaw_rate(state.pose, towards, share / dt_s)
    )


def _yaw_rate(before: Pose, after: Pose, share_per_s: float) -> float:
    turn: Pose = Pose(quat_xyzw=after.quat_xyzw) @ Pose(quat_xyzw=before.quat_xyzw).inverse()
    x, y, z, w = turn.quat_xyzw
    sine = math.hypot(x, y, z)
    angle = 2.0 * math.atan2(sine, abs(w))
    return 0.0 if sine == 0.0 else math.copysign(1.0, w) * z / sine * angle * share_per_s


def _plus(a: Vec3, b: Vec3) -> Vec3:
    return (a[0] + b[0], a[1] + b[1], a[2] + b[2])


def _minus(a: Vec3, b: Vec3) -> Vec3:
    return (a[0] - b[0], a[1] - b[1], a[2] - b[2])


def _scaled(a: Vec3, by: float) -> Vec3:
    return (a[0] * by, a[1] * by, a[2] * by)


def _at_most(a: Vec3, limit: float | None) -> Vec3:
    length = math.hypot(*a)
    return a if limit is None or length <= limit else _scaled(a, limit / length)
