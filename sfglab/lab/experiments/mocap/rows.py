"""Rows of the mocap experiment's log."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["ConfusionRow", "MocapEdgeRow", "MocapHeardRow", "MocapLookRow", "OffsetRow", "SpellRow", "TryRow"]


@dataclass(frozen=True, slots=True, kw_only=True)
class MocapEdgeRow:
    """One edge of a tree; the fields are those of `sfglab.spatial.frames.Edge`.

    Attributes:
        where: ``figure 6`` or the live round.
        way: ``direct``, ``renamed`` or ``proxy``.
        child: The frame that is placed.
        parent: The frame in which it is placed.
        static: Whether it is static.
        authority: Who published it.
        count: How many transforms came.
        first_ns: The stamp of the first one.
        last_ns: The stamp of the last one.
        backwards: How often a stamp was older than the one before.
        back_ns: The largest step back.
    """

    where: str
    way: str
    child: str
    parent: str
    static: bool
    authority: str
    count: int
    first_ns: int
    last_ns: int
    backwards: int
    back_ns: int


@dataclass(frozen=True, slots=True, kw_only=True)
class MocapLookRow:
    """One live look from the world to the robot's camera, in the bridge's tree.

    Attributes:
        round: The live round.
        at_s: When it was asked and for which time, from the round's start.
        wait_ms: How long until the tree knew that time; NaN: it never did.
        error_mm: How far the answer for that time is from the truth.
        error_mrad: By how much it is turned.
        age_ms: How old the newest known time was when it was asked; NaN: there was none.
        latest_mm: How far the pose at the newest time is from where the camera was when it was asked.
        latest_mrad: By how much it is turned.
    """

    round: str
    at_s: float
    wait_ms: float
    error_mm: float
    error_mrad: float
    age_ms: float
    latest_mm: float
    latest_mrad: float


@dataclass(frozen=True, slots=True, kw_only=True)
class TryRow:
    """How live looks from the world to the robot's camera ended in one tree.

    Attributes:
        round: The live round.
        way: ``direct``, ``renamed`` or ``proxy``.
        outcome: ``found``, or the error's name.
        count: How many ended so.
    """

    round: str
    way: str
    outcome: str
    count: int


@dataclass(frozen=True, slots=True, kw_only=True)
class MocapHeardRow:
    """One transform of the bridge as a listener got it; times since its capture.

    Attributes:
        round: The live round.
        at_s: Its capture, from the round's start.
        receipt_ms: Until the bridge had the capture.
        publication_ms: Until the bridge published, by the sample's source time stamp.
        heard_ms: Until the listener had it.
    """

    round: str
    at_s: float
    receipt_ms: float
    publication_ms: float
    heard_ms: float


@dataclass(frozen=True, slots=True, kw_only=True)
class SpellRow:
    """A time in which the cameras of a live round were wrong.

    Attributes:
        round: The live round.
        kind: ``occluded``, ``flipped`` or ``dropped``.
        begin_s: From the first capture of that kind.
        end_s: To the last one.
    """

    round: str
    kind: str
    begin_s: float
    end_s: float


@dataclass(frozen=True, slots=True, kw_only=True)
class ConfusionRow:
    """How often sights of one kind got one verdict.

    Attributes:
        truth: ``seen``, ``flipped`` or ``occluded``.
        verdict: `Verdict.value`.
        count: How often.
    """

    truth: str
    verdict: str
    count: int


@dataclass(frozen=True, slots=True, kw_only=True)
class OffsetRow:
    """One estimate of the offset from a recorded motion, and what it is worth.

    Attributes:
        length_s: Length of the motion.
        drifts: Whether the odometry drifted.
        modelled: Whether the estimate allowed for that.
        pairs: Moments that were used.
        error_mm: How far the estimated position is from the true one.
        error_mrad: By how much the orientation is turned.
        sigma_mm: The stated standard deviation of the position, root of the sum of squares.
        sigma_mrad: The same of the orientation.
        covered: How many of the six numbers the 95 % intervals hold.
        before_mm: Median error of the base in another motion through the bridge, with no offset.
        after_mm: The same with the estimate.
        before_mrad: Median error of its orientation, with no offset.
        after_mrad: The same with the estimate.
    """

    length_s: float
    drifts: bool
    modelled: bool
    pairs: int
    error_mm: float
    error_mrad: float
    sigma_mm: float
    sigma_mrad: float
    covered: int
    before_mm: float
    after_mm: float
    before_mrad: float
    after_mrad: float
