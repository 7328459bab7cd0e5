"""A simulated agent: a point with a heading that follows a timed trajectory within its limits.

It is of first order in velocity: it approaches the wanted velocity with a time constant, and within its
acceleration. It follows until the trajectory's time is over, settles at the end, and brakes when it is
stopped, is too far from the plan, or does not arrive. It knows neither clocks nor messages.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from enum import Enum
from typing import TYPE_CHECKING

from sfglab.errors import InvalidValueError
from sfglab.fields import between, check_bounds
from sfglab.spatial.execution.orders import Outcome
from sfglab.spatial.poses import Pose, Vec3
from sfglab.spatial.trajectory.motion import pose_at, sample
from sfglab.units import NS_PER_S

if TYPE_CHECKING:
    from sfglab.spatial.trajectory.path import Trajectory

_ZERO: Vec3 = (0.0, 0.0, 0.0)
_STANDS_M_S = 1e-9
_WELL_DAMPED = 0.25
_SUBSTEP_NS = 20_000_000
_LONGEST_NS = 10 * NS_PER_S  # a clock that leaps moves no agent for longer than this


@dataclass(frozen=True, slots=True, kw_only=True)
class AgentState:
    """Pose and motion of an agent."""

    pose: Pose = field(default_factory=Pose)  #: Pose in the fixed frame.
    velocity_m_s: Vec3 = _ZERO  #: Velocity in the fixed frame, m/s.
    yaw_rate_rad_s: float = (
        0.0  #: Angular velocity about the fixed z axis, of the last step, rad/s.
    )

    @property
    def speed_m_s(self) -> float:
        """Length of the velocity, m/s."""
        return math.hypot(*self.velocity_m_s)


@dataclass(frozen=True, slots=True, kw_only=True)
class Limits:
    """Limits of an agent; None: no limit.

    Raises:
        InvalidValueError: A limit is no finite number above zero.
    """

    speed_m_s: float | None = between(None, without=(0, math.inf))  #: Highest speed, m/s.
    #: Highest acceleration, m/s².
    acceleration_m_s2: float | None = between(None, without=(0, math.inf))
    #: Highest rate of the whole turn, rad/s.
    yaw_rate_rad_s: float | None = between(None, without=(0, math.inf))

    def __post_init__(self) -> None:
        check_bounds(self, "limits, ")


@dataclass(frozen=True, slots=True, kw_only=True)
class Dynamics:
    """Reaction of an agent to a plan.

    Raises:
        InvalidValueError: A number is out of range, or gain times lag is above 1/4, where it overshoots.
    """

    limits: Limits = field(default_factory=Limits)  #: Limits, which are never exceeded.
    lag_s: float = between(0.1, without=(math.inf,))  #: Time constant of the velocity, s; 0: none.
    #: Velocity that is added to the planned one for each metre of error, 1/s.
    gain_per_s: float = between(2.0, without=(0, math.inf))

    def __post_init__(self) -> None:
        check_bounds(self)
        if (product := self.lag_s * self.gain_per_s) > _WELL_DAMPED:
            raise InvalidValueError("dynamics, lag_s times gain_per_s", product, "up to 1/4")


@dataclass(frozen=True, slots=True, kw_only=True)
class Target:
    """A planned pose and velocity."""

    pose: Pose  #: Pose in the fixed frame.
    velocity_m_s: Vec3 = _ZERO  #: Velocity in the fixed frame, m/s.


def steered(state: AgentState, target: Target, dt_s: float, dynamics: Dynamics) -> AgentState:
    """Return an agent after `dt_s`, some hundredths of a second, in which it steered to the target."""
    missing = _sum(target.pose.position_m, state.pose.position_m, -1.0)
    distance_m = math.hypot(*missing)
    rate_per_s = dynamics.gain_per_s
    acceleration = dynamics.limits.acceleration_m_s2
    if acceleration is not None and distance_m * rate_per_s**2 > acceleration:
        # So that half of the acceleration is enough for braking.
        rate_per_s = math.sqrt(acceleration / distance_m)
    wanted = _sum(target.velocity_m_s, missing, rate_per_s)
    velocity = _towards(state, _limited(wanted, dynamics.limits.speed_m_s), dt_s, dynamics)
    return _moved(state, velocity, target.pose, dt_s, dynamics.limits.yaw_rate_rad_s)


def braked(state: AgentState, dt_s: float, dynamics: Dynamics) -> AgentState:
    """Return an agent after `dt_s` of braking, in which it does not turn."""
    velocity = _towards(state, _ZERO, dt_s, replace(dynamics, lag_s=0.0))
    if math.hypot(*velocity) < _STANDS_M_S:
        velocity = _ZERO
    return _moved(state, velocity, state.pose, dt_s, None)


def _towards(state: AgentState, wanted: Vec3, dt_s: float, dynamics: Dynamics) -> Vec3:
    """Return the velocity after `dt_s` of acceleration towards the wanted one."""
    share = -math.expm1(-dt_s / dynamics.lag_s) if dynamics.lag_s else 1.0
    limit = dynamics.limits.acceleration_m_s2
    difference = _sum(wanted, state.velocity_m_s, -1.0)
    change = _sum(_ZERO, difference, share)
    return _sum(state.velocity_m_s, _limited(change, None if limit is None else limit * dt_s))


def _moved(
    state: AgentState, velocity: Vec3, aim: Pose, dt_s: float, rate_rad_s: float | None
) -> AgentState:
    angle = state.pose.angle_rad(aim)
    share = 1.0
    if rate_rad_s is not None and angle > rate_rad_s * dt_s:
        share = rate_rad_s * dt_s / angle
    turned = state.pose.interpolate(aim, share)
    position = _sum(state.pose.position_m, velocity, dt_s)
    turn: Pose = turned @ state.pose.inverse()
    x, y, z, w = turn.quat_xyzw
    sine = math.hypot(x, y, z)
    yaw_rate = 0.0
    if sine:
        angle = 2.0 * math.atan2(sine, abs(w))
        yaw_rate = math.copysign(angle * z / sine, w * z) / dt_s
    return AgentState(
        pose=Pose(position_m=position, quat_xyzw=turned.quat_xyzw),
        velocity_m_s=velocity,
        yaw_rate_rad_s=yaw_rate,
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


class Phase(Enum):
    """Phase of an execution."""

    DRIVING = "driving"
    SETTLING = "settling"
    BRAKING = "braking"
    ENDED = "ended"


class FollowerEvent(Enum):
    """Event of an execution."""

    TIME_OVER = "the trajectory's time is over"
    ARRIVED = "the agent stands at the end"
    TOO_LATE = "the agent does not arrive"
    PATH_LEFT = "the agent is too far from the plan"
    STOP = "the execution is stopped"
    STANDS = "the agent stands"


TRANSITIONS: dict[Phase, dict[FollowerEvent, Phase]] = {
    Phase.DRIVING: {
        FollowerEvent.TIME_OVER: Phase.SETTLING,
        FollowerEvent.PATH_LEFT: Phase.BRAKING,
        FollowerEvent.STOP: Phase.BRAKING,
    },
    Phase.SETTLING: {
        FollowerEvent.ARRIVED: Phase.ENDED,
        FollowerEvent.TOO_LATE: Phase.BRAKING,
        FollowerEvent.PATH_LEFT: Phase.BRAKING,
        FollowerEvent.STOP: Phase.BRAKING,
    },
    Phase.BRAKING: {FollowerEvent.STANDS: Phase.ENDED},
    Phase.ENDED: {},
}
"""Next phases by event; other events change nothing."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Tolerances:
    """Required accuracy of an agent."""

    start_m: float = 0.5  #: Distance from the trajectory up to which a goal is accepted, m.
    #: Largest distance from the planned position, m; None: any. A plan may leave its first waypoint at
    #: full speed, which an agent at rest reaches only v²/(2 a) later.
    path_m: float | None = 1.0
    goal_m: float = 0.05  #: Distance from the last pose at which it may stop, m.
    goal_rad: float = 0.1  #: Angle from the last pose at which it may stop, rad.
    goal_m_s: float = 0.02  #: Highest speed at the last pose, m/s.
    settle_s: float = 10.0  #: Longest time from the trajectory's end to the arrival, s.


@dataclass(frozen=True, slots=True, kw_only=True)
class Progress:
    """State of an execution at a time."""

    phase: Phase  #: Phase of the execution.
    share: float  #: Share of the trajectory's duration that is over, 0 to 1.
    time_ns: int  #: Time since the trajectory's time 0, ns; negative before it.
    state: AgentState  #: State of the agent.
    target: Pose  #: Planned pose.
    error_m: float  #: Distance between both, m.
    largest_error_m: float  #: Largest distance so far, m.
    outcome: Outcome | None  #: Outcome; None before the end.


class Follower:
    """Moves an agent along a trajectory in its frame, whose time 0 is `start_ns` on the caller's clock."""

    def __init__(  # noqa: PLR0913  # all that belongs to an execution
        self,
        trajectory: Trajectory,
        *,
        state: AgentState,
        now_ns: int,
        start_ns: int,
        dynamics: Dynamics,
        tolerances: Tolerances,
    ) -> None:
        self._trajectory = trajectory
        self._start_ns = start_ns
        self._dynamics = dynamics
        self._tolerances = tolerances
        self._state, self._last_ns = state, now_ns
        self._phase = Phase.DRIVING
        self._outcome: Outcome | None = None
        self._error_m = self._largest_m = 0.0

    def stop(self, outcome: Outcome) -> None:
        """Brake, and end with an outcome; nothing changes if the agent brakes already."""
        self._handle(FollowerEvent.STOP, outcome)

    def step(self, now_ns: int) -> Progress:
        """Move the agent to a later time and return the progress; an earlier time changes nothing."""
        begin_ns = max(self._last_ns, now_ns - _LONGEST_NS)
        self._last_ns = max(self._last_ns, now_ns)
        count = math.ceil(max(0, now_ns - begin_ns) / _SUBSTEP_NS)
        times_ns = [begin_ns + (now_ns - begin_ns) * i // count for i in range(1, count + 1)]
        if times_ns:
            self._move(begin_ns, times_ns)
        return self.progress

    @property
    def progress(self) -> Progress:
        """Progress after the last step."""
        points = self._trajectory
        time_ns = self._last_ns - self._start_ns
        span_ns = points.end_ns - points.start_ns
        share = float(time_ns >= points.start_ns)
        if span_ns:
            share = (time_ns - points.start_ns) / span_ns
        return Progress(
            phase=self._phase,
            share=min(max(share, 0.0), 1.0),
            time_ns=time_ns,
            state=self._state,
            target=pose_at(points, time_ns / NS_PER_S),
            error_m=self._error_m,
            largest_error_m=self._largest_m,
            outcome=self._outcome if self._phase is Phase.ENDED else None,
        )

    def _move(self, begin_ns: int, times_ns: list[int]) -> None:
        found = sample(self._trajectory, [(t - self._start_ns) / NS_PER_S for t in times_ns])
        for index, time_ns in enumerate(times_ns):
            if self._phase is Phase.ENDED:
                return
            vx, vy, vz = found.velocities_m_s[index].tolist()
            target = Target(pose=found.pose(index), velocity_m_s=(vx, vy, vz))
            if time_ns > begin_ns:
                self._substep(target, (time_ns - begin_ns) / NS_PER_S)
                self._judge(target.pose, time_ns - self._start_ns)
            begin_ns = time_ns

    def _substep(self, target: Target, dt_s: float) -> None:
        is_braking = self._phase is Phase.BRAKING
        if is_braking:
            self._state = braked(self._state, dt_s, self._dynamics)
        else:
            self._state = steered(self._state, target, dt_s, self._dynamics)
        self._error_m = self._state.pose.distance_m(target.pose)
        if not is_braking:
            self._largest_m = max(self._largest_m, self._error_m)

    def _judge(self, target: Pose, time_ns: int) -> None:
        allowed = self._tolerances
        if self._state.speed_m_s == 0.0:
            self._handle(FollowerEvent.STANDS)
        if allowed.path_m is not None and self._error_m > allowed.path_m:
            self._handle(FollowerEvent.PATH_LEFT, Outcome.PATH_LEFT)
        if time_ns >= self._trajectory.end_ns:
            self._handle(FollowerEvent.TIME_OVER)
            if self._has_arrived(target):
                self._handle(FollowerEvent.ARRIVED, Outcome.SUCCEEDED)
        if time_ns > self._trajectory.end_ns + allowed.settle_s * NS_PER_S:
            self._handle(FollowerEvent.TOO_LATE, Outcome.GOAL_MISSED)

    def _has_arrived(self, target: Pose) -> bool:
        state, allowed = self._state, self._tolerances
        is_near = self._error_m <= allowed.goal_m and state.speed_m_s <= allowed.goal_m_s
        return is_near and state.pose.angle_rad(target) <= allowed.goal_rad

    def _handle(self, event: FollowerEvent, outcome: Outcome | None = None) -> None:
        following = TRANSITIONS[self._phase].get(event)
        if following is not None:
            self._phase = following
            self._outcome = outcome or self._outcome
