"""Whether an agent may be sent along a trajectory: judged before it moves, with the reason."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from sfglab.errors import SfglabError
from sfglab.spatial.execution.outcomes import Outcome
from sfglab.spatial.trajectory import Limits, limit_violations, pose_at

if TYPE_CHECKING:
    from sfglab.spatial.poses import Pose
    from sfglab.spatial.trajectory import Trajectory


_NS_PER_S = 1e9


class ExecutionError(SfglabError, RuntimeError):
    """A trajectory that cannot be executed."""


class RefusalError(ExecutionError, ValueError):
    """An order that an agent does not take.

    Attributes:
        outcome: Why, as a code.
        text: Why, in words.
    """

    def __init__(self, outcome: Outcome, text: str) -> None:
        self.outcome = outcome
        self.text = text
        super().__init__(outcome, text)  # all arguments, so that the error survives pickling

    def __str__(self) -> str:
        return f"{self.outcome.value}: {self.text}"


@dataclass(frozen=True, slots=True, kw_only=True)
class Order:
    """A trajectory and who is to move along it."""

    agent: str  #: Its name.
    trajectory: Trajectory  #: Where to be when.
    frame_id: str = "map"  #: The frame of its poses.
    start_ns: int = 0  #: Its time 0, in nanoseconds since the epoch; 0: when the server takes it.


@dataclass(frozen=True, slots=True, kw_only=True)
class Rules:
    """What an agent takes."""

    agent: str  #: Its name.
    frame_id: str  #: The frame it is moved in.
    limits: Limits  #: What it can do.
    start_m: float  #: How far it may be from where the trajectory is.
    slack: float = 1e-3  #: By which share a trajectory may exceed the limits: what rounding does.


def judge(order: Order, rules: Rules, pose: Pose, now_ns: int) -> None:
    """Return if an agent takes an order.

    Args:
        order: What it is asked.
        rules: What it takes.
        pose: Where it is.
        now_ns: Now, by the clock of the order's start.

    Raises:
        RefusalError: It does not; with the first reason.
    """
    _check_addressee(order, rules)
    trajectory = order.trajectory
    for violation in limit_violations(trajectory, _widened(rules.limits, 1.0 + rules.slack)):
        raise RefusalError(Outcome.LIMITS_EXCEEDED, str(violation))
    time_s = (now_ns - order.start_ns) / _NS_PER_S if order.start_ns else 0.0
    if time_s * _NS_PER_S > trajectory.end_ns:
        given = f"given one that was over {time_s - trajectory.end_ns / _NS_PER_S:.3f} s ago"
        raise RefusalError(Outcome.INVALID_TRAJECTORY, f"start: {given}, allowed: one that goes on")
    distance_m = pose.distance_m(pose_at(trajectory, time_s))
    if distance_m > rules.start_m:
        text = f"given a trajectory {distance_m:.3f} m away, allowed: {rules.start_m:g} m"
        raise RefusalError(Outcome.START_TOO_FAR, text)


def _check_addressee(order: Order, rules: Rules) -> None:
    if order.agent != rules.agent:
        raise RefusalError(Outcome.UNKNOWN_AGENT, f"agent: given {order.agent!r}, allowed: {rules.agent!r}")
    if order.frame_id.removeprefix("/") != rules.frame_id:
        text = f"frame: given {order.frame_id!r}, allowed: {rules.frame_id!r}"
        raise RefusalError(Outcome.UNKNOWN_FRAME, text)


def _widened(limits: Limits, by: float) -> Limits:
    speed, acceleration, yaw_rate = (
        None if value is None else value * by
        for value in (limits.speed_m_s, limits.acceleration_m_s2, limits.yaw_rate_rad_s)
    )
    return Limits(speed_m_s=speed, acceleration_m_s2=acceleration, yaw_rate_rad_s=yaw_rate)
