"""Captures of a motion-capture system, and the decision which poses of an object are published.

Cameras lose objects, confuse their markers, and detect symmetric patterns turned by half a turn. A pose
that the object cannot have reached since its last published pose is not published. If the object stays
at such a pose for some time, the pose is published, because then the former pose was wrong.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum
from typing import TYPE_CHECKING, NamedTuple, Protocol

from sfglab.errors import SfglabError
from sfglab.fields import between
from sfglab.spatial.poses import Pose
from sfglab.units import NS_PER_S

if TYPE_CHECKING:
    from collections.abc import AsyncGenerator, Mapping


class MocapError(SfglabError):
    """A motion-capture system or capture that is not available or cannot be used."""


class Lapse(Enum):
    """Reason why an object has no pose in a capture."""

    OCCLUDED = "occluded"  #: Too few markers of the object were visible.
    INVALID = "invalid"  #: The numbers are no pose: not finite, or a quaternion of length zero.


Sight = Pose | Lapse  #: Pose of an object in the world of the capture system, or why there is none.


@dataclass(frozen=True, slots=True, kw_only=True)
class Capture:
    """Poses of all detected objects at one time."""

    number: int | None  #: Frame number of the capture system; None if it has none.
    capture_ns: int  #: Time of the capture by this host's clock, ns.
    receipt_ns: int  #: Time of the capture's arrival by the same clock, ns.
    sights: Mapping[str, Sight]  #: Detected objects by their id in the capture system.


class MocapSource(Protocol):
    """A source of captures, such as a motion-capture system or a synthetic motion."""

    def captures(self) -> AsyncGenerator[Capture, None]:
        """Yield captures. The first one opens the source, and closing the generator closes it."""


class TrackState(Enum):
    """State of an object in the course of captures."""

    ABSENT = "absent"  #: The object was never detected.
    TRACKED = "tracked"  #: The latest pose of the object was published.
    HIDDEN = "hidden"  #: The object is not detected now.
    SUSPECT = "suspect"  #: The object is detected at a pose that it cannot have reached.


class Verdict(Enum):
    """Decision about the pose of an object in a capture."""

    SOUND = "sound"  #: The object can be there.
    JUMPED = "jumped"  #: The position is out of reach.
    FLIPPED = "flipped"  #: The orientation is out of reach.
    CONFIRMED = "confirmed"  #: The object stayed there long enough.
    OCCLUDED = "occluded"  #: The object is not detected.
    INVALID = "invalid"  #: The numbers are no pose.
    STALE = "stale"  #: The capture is not newer than the one before.

    @property
    def is_published(self) -> bool:
        """Whether a pose with this verdict is published."""
        return self in {Verdict.SOUND, Verdict.CONFIRMED}


@dataclass(frozen=True, slots=True, kw_only=True)
class Limits:
    """Limits of all objects' motion, and the time after which a pose beyond them is published."""

    speed_m_s: float = between(10.0, without=(0,))  #: Highest speed, m/s.
    turn_rad_s: float = between(12.0, without=(0,))  #: Highest rate of rotation, rad/s.
    #: Distance that two poses may always have, because of noise, m.
    slack_m: float = between(0.02, without=(0,))
    #: Angle that two poses may always have, because of noise, rad.
    slack_rad: float = between(0.2, without=(0,))
    #: Largest rotation that is published at once, however long the object was hidden, rad. Symmetric markers
    #: may be detected turned by half a turn.
    turn_rad: float = between(2.7, without=(0,))
    #: Time after which a pose out of reach is published, s.
    believe_after_s: float = between(0.5, without=(0,))

    def verdict(self, before: Pose, after: Pose, elapsed_ns: int) -> Verdict:
        """Return whether an object can move from a pose to another one in a time, ns: SOUND, JUMPED or FLIPPED."""
        elapsed_s = elapsed_ns / NS_PER_S
        if before.distance_m(after) > self.speed_m_s * elapsed_s + self.slack_m:
            return Verdict.JUMPED
        reach_rad = min(self.turn_rad_s * elapsed_s + self.slack_rad, self.turn_rad)
        return Verdict.FLIPPED if before.angle_rad(after) > reach_rad else Verdict.SOUND


class _Suspicion(NamedTuple):
    """A pose out of reach, at which the object may stay."""

    verdict: Verdict
    pose: Pose
    seen_ns: int  # time of the pose
    since_ns: int  # time of the first such pose


class Track:
    """State of one captured object, which judges each new pose against the latest published one."""

    def __init__(self, limits: Limits) -> None:
        self.state = TrackState.ABSENT  #: State of the object.
        self._limits = limits
        self._seen_ns = -math.inf  # newest capture
        self._pose: Pose | None = None  # latest published pose
        self._pose_ns = 0
        self._suspicion: _Suspicion | None = None

    def judge(self, sight: Sight, capture_ns: int) -> Verdict:
        """Process the object's pose in the next capture, and return the verdict on it."""
        if capture_ns <= self._seen_ns:
            return Verdict.STALE
        self._seen_ns = capture_ns
        suspicion, self._suspicion = self._suspicion, None
        if isinstance(sight, Lapse):
            if self._pose is not None:
                self.state = TrackState.HIDDEN
            return Verdict(sight.value)
        verdict = self._reach(sight, capture_ns - self._pose_ns)
        since_ns = capture_ns
        if suspicion is not None and self._stays(suspicion, sight, capture_ns):
            verdict, since_ns = suspicion.verdict, suspicion.since_ns
            if capture_ns - since_ns >= self._limits.believe_after_s * NS_PER_S:
                verdict = Verdict.CONFIRMED
        if not verdict.is_published:
            self._suspicion = _Suspicion(verdict, sight, capture_ns, since_ns)
        self.state = TrackState.TRACKED if verdict.is_published else TrackState.SUSPECT
        if verdict.is_published:
            self._pose, self._pose_ns = sight, capture_ns
        return verdict

    def _reach(self, pose: Pose, elapsed_ns: int) -> Verdict:
        """Return whether an object can have reached a pose from its last published pose in a time, ns."""
        if self._pose is None:
            return Verdict.SOUND
        return self._limits.verdict(self._pose, pose, elapsed_ns)

    def _stays(self, suspicion: _Suspicion, pose: Pose, now_ns: int) -> bool:
        """Return whether an object stays at a suspect pose, even if it could have moved there slowly by now."""
        step_ns = now_ns - suspicion.seen_ns
        is_near = self._limits.verdict(suspicion.pose, pose, step_ns) is Verdict.SOUND
        return is_near and self._reach(pose, step_ns) is not Verdict.SOUND
