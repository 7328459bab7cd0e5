"""A simulated agent: a point with a heading that is steered within its limits along a timed trajectory.

First order in velocity: it nears what is wanted with a time constant, and no faster than its acceleration
allows. It follows until the trajectory's time is over, settles at its end, and brakes when it is told to stop,
is too far from where it should be, or does not arrive. Refuses to know clocks and messages.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from enum import Enum
from typing import TYPE_CHECKING

import numpy as np

from sfglab.errors import InvalidValueError
from sfglab.fields import between, check_bounds
from sfglab.spatial.execution.orders import Outcome
from sfglab.spatial.poses import Pose, Vec3
from sfglab.spatial.trajectory.limits import Limits, Quantity, peaks
from sfglab.spatial.trajectory.motion import motion_of, pose_at, sample
from sfglab.units import NS_PER_S

if TYPE_CHECKING:
    from sfglab.spatial.trajectory.path import Trajectory

_ZERO: Vec3 = (0.0, 0.0, 0.0)
_STANDS_M_S = 1e-9
_WELL_DAMPED = 0.25


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
        InvalidValueError: A number is out of range, or gain times lag is above 1/4, where it overshoots.
    """

    #: Never exceeded, whatever is asked for; the yaw rate's bounds the whole turn's rate.
    limits: Limits = field(default_factory=Limits)
    lag_s: float = between(0.1, without=(math.inf,))  #: Time constant of the velocity; 0: none.
    #: How much velocity is added to a target's for every metre that is missing.
    gain_per_s: float = between(2.0, without=(0, math.inf))

    def __post_init__(self) -> None:
        check_bounds(self)
        if (product := self.lag_s * self.gain_per_s) > _WELL_DAMPED:
            raise InvalidValueError("dynamics, lag_s times gain_per_s", product, "up to 1/4")


@dataclass(frozen=True, slots=True, kw_only=True)
class Target:
    """Where to be, and how fast to be moving there."""

    pose: Pose  #: In the fixed frame.
    velocity_m_s: Vec3 = _ZERO  #: In the fixed frame.


def steered(state: AgentState, target: Target, dt_s: float, dynamics: Dynamics) -> AgentState:
    """Return an agent `dt_s` later, some hundredths of a second, after steering to where it should be then."""
    missing = _minus(target.pose.position_m, state.pose.position_m)
    wanted = _plus(
        target.velocity_m_s, _scaled(missing, _approach_per_s(math.hypot(*missing), dynamics))
    )
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
    """Return how fast to go for each missing metre: by gain, or so that half the acceleration brakes."""
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
    state: AgentState, velocity: Vec3, aim: Pose, dt_s: float, rate_rad_s: float | None
) -> AgentState:
    angle = state.pose.angle_rad(aim)
    share = 1.0 if rate_rad_s is None or angle <= rate_rad_s * dt_s else rate_rad_s * dt_s / angle
    turned = state.pose.interpolate(aim, share)
    pose = Pose(
        position_m=_plus(state.pose.position_m, _scaled(velocity, dt_s)), quat_xyzw=turned.quat_xyzw
    )
    yaw_rate = _yaw_rate(state.pose, aim, share / dt_s)
    return AgentState(pose=pose, velocity_m_s=velocity, yaw_rate_rad_s=yaw_rate)


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


def falls_behind_m(trajectory: Trajectory, dynamics: Dynamics, *, period_s: float = 0.02) -> float:
    """Return how far an agent falls behind at most that stands at the start and catches up before each jump.

    While it accelerates by A, a jump of v in the plan's velocity costs v^2 / (2 (A - a)), with a the plan's own
    acceleration, and A lag^2 / 2 until it steers again; without A it costs v lag. Then a costs lag a / gain,
    and steps of `period_s` cost v each. Metres; infinite where the plan accelerates as hard as the agent can.
    """
    motion, rest = motion_of(trajectory), np.zeros((1, 3))
    segments = np.arange(len(motion))
    leaving, arriving = (
        motion.rates(segments, t)[1] for t in (np.zeros(len(motion)), motion.durations_s)
    )
    jump_m_s = float(
        np.linalg.norm(np.vstack([leaving, rest]) - np.vstack([rest, arriving]), axis=1).max()
    )
    bend_m_s2 = float(peaks(trajectory, Quantity.ACCELERATION).values.max(initial=0.0))
    behind_m = bend_m_s2 * dynamics.lag_s / dynamics.gain_per_s + jump_m_s * period_s
    most = dynamics.limits.acceleration_m_s2
    if most is None:
        return behind_m + jump_m_s * dynamics.lag_s
    if bend_m_s2 >= most:
        return math.inf
    return behind_m + jump_m_s**2 / (2.0 * (most - bend_m_s2)) + most * dynamics.lag_s**2 / 2.0


_SUBSTEP_NS = 20_000_000
_LONGEST_NS = 10 * NS_PER_S  #: A clock that leaps moves nobody for longer than this.


class Phase(Enum):
    """What the agent is doing."""

    DRIVING = "driving"
    SETTLING = "settling"
    BRAKING = "braking"
    ENDED = "ended"


class FollowerEvent(Enum):
    """What happens on the way."""

    TIME_OVER = "the trajectory's time is over"
    ARRIVED = "the agent stands at the end"
    TOO_LATE = "the agent does not arrive"
    PATH_LEFT = "the agent is too far from where it should be"
    STOP = "somebody says stop"
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
"""Which phase follows which; what is not in it changes nothing."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Tolerances:
    """How well an agent has to follow."""

    start_m: float = 0.5  #: How far it may be from where the trajectory is when the goal is taken.
    #: How far it may ever be from where it should be then; None: as far as it likes. A plan may leave its first
    #: waypoint at full speed, which an agent at rest reaches only v^2 / (2 a) later.
    path_m: float | None = 1.0
    goal_m: float = 0.05  #: How far from the last pose it may stop.
    goal_rad: float = 0.1  #: The same for its orientation.
    goal_m_s: float = 0.02  #: How fast it may still be there.
    settle_s: float = 10.0  #: How long after the trajectory's end it may take to get there.


@dataclass(frozen=True, slots=True, kw_only=True)
class Progress:
    """How it stands at a time."""

    phase: Phase  #: What the agent is doing.
    share: float  #: Of the trajectory's duration that is over, 0 to 1.
    time_ns: int  #: Since the trajectory's time 0; negative before it.
    state: AgentState  #: Where the agent is.
    target: Pose  #: Where it should be.
    error_m: float  #: From one to the other.
    largest_error_m: float  #: The largest so far.
    outcome: Outcome | None  #: How it ended; None before the end.


class Follower:
    """Moves an agent along a trajectory in its frame, whose time 0 is `start_ns` by the caller's clock."""

    def __init__(  # noqa: PLR0913 - what belongs to a way is many things, and each is said by name
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
        """Brake from here on, and end with an outcome; once it brakes already, nothing changes."""
        self._happens(FollowerEvent.STOP, outcome)

    def step(self, now_ns: int) -> Progress:
        """Move the agent to a later time and return how it stands; an earlier time changes nothing."""
        begin_ns, self._last_ns = (
            max(self._last_ns, now_ns - _LONGEST_NS),
            max(self._last_ns, now_ns),
        )
        count = math.ceil(max(0, now_ns - begin_ns) / _SUBSTEP_NS)
        times_ns = (
            [begin_ns + (now_ns - begin_ns) * i // count for i in range(1, count + 1)]
            if count
            else []
        )
        if times_ns:
            self._move(begin_ns, times_ns)
        return self.progress

    @property
    def progress(self) -> Progress:
        """How it stood after the latest step."""
        points = self._trajectory
        time_ns = self._last_ns - self._start_ns
        span_ns = points.end_ns - points.start_ns
        share = (
            (time_ns - points.start_ns) / span_ns if span_ns else float(time_ns >= points.start_ns)
        )
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
            self._substep(target, time_ns, (time_ns - begin_ns) / NS_PER_S)
            begin_ns = time_ns

    def _substep(self, target: Target, time_ns: int, dt_s: float) -> None:
        if dt_s <= 0.0:
            return
        if self._phase is Phase.BRAKING:
            self._state = braked(self._state, dt_s, self._dynamics)
        else:
            self._state = steered(self._state, target, dt_s, self._dynamics)
        self._error_m = self._state.pose.distance_m(target.pose)
        if self._phase is not Phase.BRAKING:
            self._largest_m = max(self._largest_m, self._error_m)
        self._judge(target.pose, time_ns - self._start_ns)

    def _judge(self, target: Pose, time_ns: int) -> None:
        allowed = self._tolerances
        if self._state.speed_m_s == 0.0:
            self._happens(FollowerEvent.STANDS)
        if allowed.path_m is not None and self._error_m > allowed.path_m:
            self._happens(FollowerEvent.PATH_LEFT, Outcome.PATH_LEFT)
        if time_ns >= self._trajectory.end_ns:
            self._happens(FollowerEvent.TIME_OVER)
            if self._arrived(target):
                self._happens(FollowerEvent.ARRIVED, Outcome.SUCCEEDED)
        if time_ns > self._trajectory.end_ns + allowed.settle_s * NS_PER_S:
            self._happens(FollowerEvent.TOO_LATE, Outcome.GOAL_MISSED)

    def _arrived(self, target: Pose) -> bool:
        state, allowed = self._state, self._tolerances
        near = self._error_m <= allowed.goal_m and state.speed_m_s <= allowed.goal_m_s
        return near and state.pose.angle_rad(target) <= allowed.goal_rad

    def _happens(self, event: FollowerEvent, outcome: Outcome | None = None) -> None:
        following = TRANSITIONS[self._phase].get(event)
        if following is not None:
            self._phase = following
            self._outcome = outcome or self._outcome
