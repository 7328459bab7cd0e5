"""Captures of a motion capture system, and which sights are believed: a state machine in one table.

Cameras lose objects, confuse their markers and turn symmetric patterns around. A pose that no object of the
kind could have reached is not published until it stays for a while, because then it was the last one that was
wrong. One that comes back flipped cannot be told from one that turned as far, so both are doubted that long.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import Enum
from typing import TYPE_CHECKING, Protocol

from sfglab.errors import SfglabError
from sfglab.fields import between
from sfglab.spatial.poses import Pose
from sfglab.units import NS_PER_S

if TYPE_CHECKING:
    from collections.abc import AsyncGenerator, Mapping


class MocapError(SfglabError):
    """Motion capture that cannot be had, or cannot be used."""


class Lapse(Enum):
    """Why there is no pose."""

    OCCLUDED = "occluded"  #: Too few of the object's markers were seen.
    INVALID = "invalid"  #: The numbers are no pose: not finite, or a quaternion of length zero.


Sight = Pose | Lapse  #: An object's pose in the capture system's world, or why there is none.


@dataclass(frozen=True, slots=True, kw_only=True)
class Capture:
    """All objects at one time."""

    number: int | None  #: The system's frame number; None when it has none.
    capture_ns: int  #: When the cameras saw it, by this host's clock.
    receipt_ns: int  #: When it arrived here, by the same clock.
    sights: Mapping[str, Sight]  #: What is known of each object, by its id in the capture system.


class MocapSource(Protocol):
    """Anything that captures come from."""

    def captures(self) -> AsyncGenerator[Capture, None]:
        """Open the source with the first one that is asked for; closing the generator closes it."""


class TrackState(Enum):
    """What is known of an object."""

    ABSENT = "absent"  #: It was never seen.
    TRACKED = "tracked"  #: Its last pose is believed.
    HIDDEN = "hidden"  #: It is known where it was, but not seen now.
    SUSPECT = "suspect"  #: It is seen where it cannot be.


class Verdict(Enum):
    """What a sight is."""

    SOUND = "sound"  #: It can be there.
    JUMPED = "jumped"  #: It is further away than it can have gone.
    FLIPPED = "flipped"  #: It is where it can be, but turned further than it can have turned.
    CONFIRMED = "confirmed"  #: It was seen there long enough, so it is there.
    OCCLUDED = "occluded"  #: It is not seen.
    INVALID = "invalid"  #: The numbers are no pose.
    STALE = "stale"  #: It is not newer than the one before.

    @property
    def believed(self) -> bool:
        """Whether a sight of this kind is published."""
        return self in {Verdict.SOUND, Verdict.CONFIRMED}


TRANSITIONS: dict[tuple[TrackState, Verdict], TrackState] = {
    (TrackState.ABSENT, Verdict.SOUND): TrackState.TRACKED,
    (TrackState.ABSENT, Verdict.OCCLUDED): TrackState.ABSENT,
    (TrackState.ABSENT, Verdict.INVALID): TrackState.ABSENT,
    (TrackState.ABSENT, Verdict.STALE): TrackState.ABSENT,
    (TrackState.TRACKED, Verdict.SOUND): TrackState.TRACKED,
    (TrackState.TRACKED, Verdict.JUMPED): TrackState.SUSPECT,
    (TrackState.TRACKED, Verdict.FLIPPED): TrackState.SUSPECT,
    (TrackState.TRACKED, Verdict.OCCLUDED): TrackState.HIDDEN,
    (TrackState.TRACKED, Verdict.INVALID): TrackState.HIDDEN,
    (TrackState.TRACKED, Verdict.STALE): TrackState.TRACKED,
    (TrackState.HIDDEN, Verdict.SOUND): TrackState.TRACKED,
    (TrackState.HIDDEN, Verdict.JUMPED): TrackState.SUSPECT,
    (TrackState.HIDDEN, Verdict.FLIPPED): TrackState.SUSPECT,
    (TrackState.HIDDEN, Verdict.OCCLUDED): TrackState.HIDDEN,
    (TrackState.HIDDEN, Verdict.INVALID): TrackState.HIDDEN,
    (TrackState.HIDDEN, Verdict.STALE): TrackState.HIDDEN,
    (TrackState.SUSPECT, Verdict.SOUND): TrackState.TRACKED,
    (TrackState.SUSPECT, Verdict.CONFIRMED): TrackState.TRACKED,
    (TrackState.SUSPECT, Verdict.JUMPED): TrackState.SUSPECT,
    (TrackState.SUSPECT, Verdict.FLIPPED): TrackState.SUSPECT,
    (TrackState.SUSPECT, Verdict.OCCLUDED): TrackState.HIDDEN,
    (TrackState.SUSPECT, Verdict.INVALID): TrackState.HIDDEN,
    (TrackState.SUSPECT, Verdict.STALE): TrackState.SUSPECT,
}
"""The state after a verdict; pairs that are missing cannot happen."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Limits:
    """What no object outdoes, and how long an impossible place must be held to be believed."""

    speed_m_s: float = between(10.0, without=(0,))  #: The highest speed.
    turn_rad_s: float = between(12.0, without=(0,))  #: The highest rate of turn.
    #: How far apart two poses may always be, for noise.
    slack_m: float = between(0.02, without=(0,))
    #: By how much two poses may always differ in orientation.
    slack_rad: float = between(0.2, without=(0,))
    #: The largest turn that is believed at once, however long the object was hidden: symmetric markers may be
    #: taken for themselves turned by half a turn.
    turn_rad: float = between(2.7, without=(0,))
    #: After how long at an impossible place the object is believed to be there.
    believe_after_s: float = between(0.5, without=(0,))


@dataclass(frozen=True, slots=True, kw_only=True)
class Doubt:
    """A place where an object is seen although it cannot be there."""

    pose: Pose  #: Where it was seen last.
    seen_ns: int  #: The capture time of that.
    since_ns: int  #: Since when it is seen there.
    verdict: Verdict  #: Why it cannot be there.


@dataclass(frozen=True, slots=True, kw_only=True)
class Track:
    """What is remembered of one object."""

    state: TrackState = TrackState.ABSENT  #: What is known of it.
    seen_ns: int | None = None  #: The newest capture time.
    pose: Pose | None = None  #: The last pose that was believed; None before the first.
    pose_ns: int = 0  #: Its capture time.
    #: Where it is seen although it cannot be there; None when it is not.
    doubt: Doubt | None = None


def judge(track: Track, sight: Sight, capture_ns: int, limits: Limits) -> tuple[Track, Verdict]:
    """Judge a pose, or why there is none; return what to remember, and the verdict: whether to publish it."""
    if track.seen_ns is not None and capture_ns <= track.seen_ns:
        return track, Verdict.STALE
    if isinstance(sight, Lapse):
        verdict = Verdict.OCCLUDED if sight is Lapse.OCCLUDED else Verdict.INVALID
        state = TRANSITIONS[track.state, verdict]
        return replace(track, state=state, seen_ns=capture_ns, doubt=None), verdict
    verdict = _verdict(track, sight, capture_ns, limits)
    state = TRANSITIONS[track.state, verdict]
    if verdict.believed:
        return Track(state=state, seen_ns=capture_ns, pose=sight, pose_ns=capture_ns), verdict
    same = _still_doubtful(track, sight, capture_ns, limits)
    doubt = Doubt(
        pose=sight,
        seen_ns=capture_ns,
        since_ns=track.doubt.since_ns if track.doubt and same else capture_ns,
        verdict=verdict,
    )
    return replace(track, state=state, seen_ns=capture_ns, doubt=doubt), verdict


def _verdict(track: Track, pose: Pose, now_ns: int, limits: Limits) -> Verdict:
    if track.pose is None:
        return Verdict.SOUND
    if track.doubt is not None and _still_doubtful(track, pose, now_ns, limits):
        held = now_ns - track.doubt.since_ns >= limits.believe_after_s * NS_PER_S
        return Verdict.CONFIRMED if held else track.doubt.verdict
    return _fault(track.pose, pose, now_ns - track.pose_ns, limits) or Verdict.SOUND


def _still_doubtful(track: Track, pose: Pose, now_ns: int, limits: Limits) -> bool:
    """Tell whether an object is where it was in doubt, also when by now it could have gone there slowly."""
    if track.doubt is None or track.pose is None:
        return False
    step_ns = now_ns - track.doubt.seen_ns
    near = _fault(track.doubt.pose, pose, step_ns, limits) is None
    return near and _fault(track.pose, pose, step_ns, limits) is not None


def _fault(before: Pose, after: Pose, elapsed_ns: int, limits: Limits) -> Verdict | None:
    elapsed_s = elapsed_ns / NS_PER_S
    if before.distance_m(after) > limits.speed_m_s * elapsed_s + limits.slack_m:
        return Verdict.JUMPED
    if before.angle_rad(after) > min(
        limits.turn_rad_s * elapsed_s + limits.slack_rad, limits.turn_rad
    ):
        return Verdict.FLIPPED
    return None
