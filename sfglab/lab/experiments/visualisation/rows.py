"""The tables of the visualisation experiment."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["VisualisationCheckRow", "VisualisationCloudRow", "VisualisationMemoryRow", "VisualisationTimeRow"]


@dataclass(frozen=True, slots=True, kw_only=True)
class VisualisationCheckRow:
    """How often one property was checked and how often it held.

    Attributes:
        group: What it belongs to, such as ``visualizers`` or ``synchronisation``.
        check: The property.
        checked: Cases it was checked on.
        held: Cases in which it held.
        example: A case in which it did not; else what was seen.
    """

    group: str
    check: str
    checked: int
    held: int
    example: str


@dataclass(frozen=True, slots=True, kw_only=True)
class VisualisationCloudRow:
    """The points of one depth image, beside an independent back-projection.

    Attributes:
        stamp_ns: Of the depth image.
        points: How many the recording holds.
        expected: How many the reference has.
        largest_error_m: Largest distance between a point and its reference.
        wrong_colors: Points whose colour differs from the reference's.
    """

    stamp_ns: int
    points: int
    expected: int
    largest_error_m: float
    wrong_colors: int


@dataclass(frozen=True, slots=True, kw_only=True)
class VisualisationTimeRow:
    """How long one picture took.

    Attributes:
        arm: ``bridge``, from its arrival on the bus until the sink has it; ``bare``, from the call of Rerun.
        round: Which round.
        number: Of the picture in its round.
        taken_ms: Time until the sink had it.
    """

    arm: str
    round: int
    number: int
    taken_ms: float


@dataclass(frozen=True, slots=True, kw_only=True)
class VisualisationMemoryRow:
    """A moment with a sink that stands still for a while.

    Attributes:
        at_s: Time since the beginning.
        stopped: Whether the sink stands still.
        queued_bytes: Messages that wait for their turn, and drawn ones that the sink has not taken.
        resident_bytes: Memory of the bridge's process.
        received: Pictures that arrived up to now.
        shown: Pictures drawn up to now.
        dropped: Pictures passed over up to now.
    """

    at_s: float
    stopped: bool
    queued_bytes: int
    resident_bytes: int
    received: int
    shown: int
    dropped: int
