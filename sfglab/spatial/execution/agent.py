"""A simulated agent: a point with a heading that follows a timed trajectory within its limits.

The agent follows the trajectory until its time is over, and settles at the end. It brakes when it is stopped, or when
it does not arrive. The module does not depend on clocks and messages.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from sfglab.spatial.execution.orders import Outcome
from sfglab.spatial.poses import Pose, Vec3
from sfglab.spatial.trajectory.motion import sample
from sfglab.units import NS_PER_S

if TYPE_CHECKING:
    from sfglab.spatial.trajectory.path import Trajectory

_ZERO: Vec3 = (0.0, 0.0, 0.0)
_GAIN_PER_S = 2.0  # velocity that is added to the planned one for each metre of error
_SUBSTEP_NS = 20_000_000
#: Distance and angle from the last pose, and speed, at which an agent may stop.
GOAL_M, GOAL_RAD, GOAL_M_S = 0.05, 0.1, 0.02
# Longest step: after a jump of the clock an agent moves for this time only
_LONGEST_NS = 10 * NS_PER_S


@dataclass(frozen=True, slots=True, kw_only=True)
class AgentState:
    """Pose and motion of an agent."""

    pose: Pose = field(default_factory=Pose)  #: Pose in the fixed frame.
    velocity_m_s: Vec3 = _ZERO  #: Velocity in the fixed frame, m/s.
    yaw_rate_rad_s: float = 0.0  #: Change of the heading in the last step, rad/s.

    @property
    def speed_m_s(self) -> float:
        """Length of the velocity, m/s."""
        return math.hypot(*self.velocity_m_s)


@dataclass(frozen=True, slots=True, kw_only=True)
class Limits:
    """Limits above zero that an agent never exceeds; None: no limit."""

    speed_m_s: float | None = None  #: Highest speed, m/s.
    acceleration_m_s2: float | None = None  #: Highest acceleration, m/s².
    yaw_rate_rad_s: float | None = None  #: Highest rate of the whole turn, rad/s.


def steered(
    state: AgentState, target: Pose, velocity_m_s: Vec3, dt_s: float, limits: Limits
) -> AgentState:
    """Return an agent after a step in which it steered to the planned motion.

    Args:
        state: Agent before the step.
        target: Planned pose at the end of the step.
        velocity_m_s: Planned velocity in the fixed frame, m/s.
        dt_s: Duration of the step, some hundredths of a second.
        limits: Limits that the agent does not exceed.
    """
    missing = _sum(target.position_m, state.pose.position_m, -1.0)
    distance_m = math.hypot(*missing)
    rate_per_s = _GAIN_PER_S
    acceleration = limits.acceleration_m_s2
    if acceleration is not None and distance_m * rate_per_s**2 > acceleration:
        # With this speed, half of the acceleration is enough for braking.
        rate_per_s = math.sqrt(acceleration / distance_m)
    wanted = _limited(_sum(velocity_m_s, missing, rate_per_s), limits.speed_m_s)
    return _moved(state, wanted, target, dt_s, limits)


def braked(state: AgentState, dt_s: float, limits: Limits) -> AgentState:
    """Return an agent after `dt_s` seconds of braking, in which it does not turn."""
    return _moved(state, _ZERO, state.pose, dt_s, limits)


def _moved(
    state: AgentState, wanted_m_s: Vec3, aim: Pose, dt_s: float, limits: Limits
) -> AgentState:
    """Return an agent after `dt_s` seconds, in which it accelerated and turned as far as its limits allow."""
    change = _sum(wanted_m_s, state.velocity_m_s, -1.0)
    if limits.acceleration_m_s2 is not None:
        change = _limited(change, limits.acceleration_m_s2 * dt_s)
    velocity = _sum(state.velocity_m_s, change)
    angle = state.pose.angle_rad(aim)
    turn = angle
    if limits.yaw_rate_rad_s is not None:
        turn = min(angle, limits.yaw_rate_rad_s * dt_s)
    turned = state.pose.interpolate(aim, turn / angle if angle else 1.0)
    position = _sum(state.pose.position_m, velocity, dt_s)
    yaw = math.remainder(turned.yaw_rad - state.pose.yaw_rad, math.tau)
    return AgentState(
        pose=Pose(position_m=position, quat_xyzw=turned.quat_xyzw),
        velocity_m_s=velocity,
        yaw_rate_rad_s=yaw / dt_s,
    )


def _sum(a: Vec3, b: Vec3, factor: float = 1.0) -> Vec3:
    """Return the sum of a vector and a multiple of another."""
    return (a[0] + factor * b[0], a[1] + factor * b[1], a[2] + factor * b[2])


def _limited(vector: Vec3, limit: float | None) -> Vec3:
    """Return a vector, shortened to a limit of its length."""
    length = math.hypot(*vector)
    if limit is None or length <= limit:
        return vector
    return _sum(_ZERO, vector, limit / length)


class Follower:
    """Follower: moves an agent along a trajectory, whose time 0 is `start_ns` on the caller's clock.

    The trajectory is in the agent's fixed frame. An agent that has not arrived `settle_s` seconds after the
    trajectory's end brakes.
    """

    def __init__(  # noqa: PLR0913  # all that belongs to an execution
        self,
        trajectory: Trajectory,
        *,
        state: AgentState,
        now_ns: int,
        start_ns: int,
        limits: Limits,
        settle_s: float = 10.0,
    ) -> None:
        self.state = state  #: State of the agent.
        self.error_m = 0.0  #: Distance from the planned position, m.
        self.outcome: Outcome | None = None  #: Outcome; None before the end.
        self._trajectory = trajectory
        self._now_ns = now_ns
        self._start_ns = start_ns
        self._limits = limits
        self._settle_ns = settle_s * NS_PER_S
        self._stopped: Outcome | None = None  # outcome once the agent stands

    @property
    def time_ns(self) -> int:
        """Time since the trajectory's time 0, ns; negative before it."""
        return self._now_ns - self._start_ns

    @property
    def share(self) -> float:
        """Share of the trajectory's duration that is over, 0 to 1."""
        begin_ns, end_ns = self._trajectory.start_ns, self._trajectory.end_ns
        if begin_ns == end_ns:
            return float(self.time_ns >= end_ns)
        share = (self.time_ns - begin_ns) / (end_ns - begin_ns)
        return min(max(share, 0.0), 1.0)

    def stop(self, outcome: Outcome) -> None:
        """Brake, and end with an outcome; without effect if the agent already brakes."""
        self._stopped = self._stopped or outcome

    def step(self, now_ns: int) -> None:
        """Simulate the agent until a later time, ns; an earlier time has no effect."""
        if now_ns <= self._now_ns:
            return
        self._now_ns = max(self._now_ns, now_ns - _LONGEST_NS)
        times_ns = [*range(self._now_ns + _SUBSTEP_NS, now_ns, _SUBSTEP_NS), now_ns]
        times_s = [(time_ns - self._start_ns) / NS_PER_S for time_ns in times_ns]
        found = sample(self._trajectory, times_s)
        for index, time_ns in enumerate(times_ns):
            dt_s = (time_ns - self._now_ns) / NS_PER_S
            self._now_ns = time_ns
            if self.outcome is None:
                vx, vy, vz = found.velocities_m_s[index].tolist()
                self._move(found.pose(index), (vx, vy, vz), dt_s)

    def _move(self, target: Pose, velocity_m_s: Vec3, dt_s: float) -> None:
        if self._stopped is not None:
            self.state = braked(self.state, dt_s, self._limits)
        else:
            self.state = steered(self.state, target, velocity_m_s, dt_s, self._limits)
        self.error_m = self.state.pose.distance_m(target)
        late_ns = self.time_ns - self._trajectory.end_ns
        if self._stopped is not None:
            if self.state.speed_m_s == 0.0:
                self.outcome = self._stopped
        elif late_ns >= 0 and self._has_arrived(target):
            self.outcome = Outcome.SUCCEEDED
        elif late_ns > self._settle_ns:
            self.stop(Outcome.GOAL_MISSED)

    def _has_arrived(self, target: Pose) -> bool:
        is_near = self.error_m <= GOAL_M and self.state.speed_m_s <= GOAL_M_S
        return is_near and self.state.pose.angle_rad(target) <= GOAL_RAD
