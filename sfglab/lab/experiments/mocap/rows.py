"""Rows of the mocap experiment's log."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True, kw_only=True)
class MocapEdgeRow:
    """One edge of a tree; the fields are those of `sfglab.spatial.frames.Edge`."""

    where: str  #: ``figure 6`` or the live round.
    way: str  #: ``direct``, ``renamed`` or ``proxy``.
    child: str  #: The frame that is placed.
    parent: str  #: The frame in which it is placed.
    static: bool  #: Whether it is static.
    authority: str  #: Who published it.
    count: int  #: How many transforms came.
    first_ns: int  #: The stamp of the first one.
    last_ns: int  #: The stamp of the last one.
    backwards: int  #: How often a stamp was older than the one before.
    back_ns: int  #: The largest step back.


@dataclass(frozen=True, slots=True, kw_only=True)
class MocapLookRow:
    """One live look from the world to the robot's camera, in the bridge's tree."""

    round: str  #: The live round.
    at_s: float  #: When it was asked and for which time, from the round's start.
    wait_ms: float  #: How long until the tree knew that time; NaN: it never did.
    error_mm: float  #: How far the answer for that time is from the truth.
    error_mrad: float  #: By how much it is turned.
    age_ms: float  #: How old the newest known time was when it was asked; NaN: there was none.
    latest_mm: float  #: How far the pose at the newest time is from where the camera was when it was asked.
    latest_mrad: float  #: By how much it is turned.


@dataclass(frozen=True, slots=True, kw_only=True)
class TryRow:
    """How live looks from the world to the robot's camera ended in one tree."""

    round: str  #: The live round.
    way: str  #: ``direct``, ``renamed`` or ``proxy``.
    outcome: str  #: ``found``, or the error's name.
    count: int  #: How many ended so.


@dataclass(frozen=True, slots=True, kw_only=True)
class MocapHeardRow:
    """One transform of the bridge as a listener got it; times since its capture."""

    round: str  #: The live round.
    at_s: float  #: Its capture, from the round's start.
    receipt_ms: float  #: Until the bridge had the capture.
    publication_ms: float  #: Until the bridge published, by the sample's source time stamp.
    heard_ms: float  #: Until the listener had it.


@dataclass(frozen=True, slots=True, kw_only=True)
class SpellRow:
    """A time in which the cameras of a live round were wrong."""

    round: str  #: The live round.
    kind: str  #: ``occluded``, ``flipped`` or ``dropped``.
    begin_s: float  #: From the first capture of that kind.
    end_s: float  #: To the last one.


@dataclass(frozen=True, slots=True, kw_only=True)
class ConfusionRow:
    """How often sights of one kind got one verdict."""

    truth: str  #: ``seen``, ``flipped`` or ``occluded``.
    verdict: str  #: `Verdict.value`.
    count: int  #: How often.


@dataclass(frozen=True, slots=True, kw_only=True)
class OffsetRow:
    """One estimate of the offset from a recorded motion, and what it is worth."""

    length_s: float  #: Length of the motion.
    drifts: bool  #: Whether the odometry drifted.
    modelled: bool  #: Whether the estimate allowed for that.
    pairs: int  #: Moments that were used.
    error_mm: float  #: How far the estimated position is from the true one.
    error_mrad: float  #: By how much the orientation is turned.
    sigma_mm: float  #: The stated standard deviation of the position, root of the sum of squares.
    sigma_mrad: float  #: The same of the orientation.
    covered: int  #: How many of the six numbers the 95 % intervals hold.
    before_mm: float  #: Median error of the base in another motion through the bridge, with no offset.
    after_mm: float  #: The same with the estimate.
    before_mrad: float  #: Median error of its orientation, with no offset.
    after_mrad: float  #: The same with the estimate.
