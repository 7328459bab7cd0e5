"""The tables of the visualisation experiment."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True, kw_only=True)
class VisualisationCheckRow:
    """How often one property was checked and how often it held."""

    group: str  #: What it belongs to, such as ``visualizers`` or ``synchronisation``.
    check: str  #: The property.
    checked: int  #: Cases it was checked on.
    held: int  #: Cases in which it held.
    example: str  #: A case in which it did not; else what was seen.


@dataclass(frozen=True, slots=True, kw_only=True)
class VisualisationCloudRow:
    """The points of one depth image, beside an independent back-projection."""

    stamp_ns: int  #: Of the depth image.
    points: int  #: How many the recording holds.
    expected: int  #: How many the reference has.
    largest_error_m: float  #: Largest distance between a point and its reference.
    wrong_colors: int  #: Points whose colour differs from the reference's.


@dataclass(frozen=True, slots=True, kw_only=True)
class VisualisationTimeRow:
    """How long one picture took."""

    #: ``bridge``, from its arrival on the bus until the sink has it; ``bare``, from the call of Rerun.
    arm: str
    round: int  #: Which round.
    number: int  #: Of the picture in its round.
    taken_ms: float  #: Time until the sink had it.


@dataclass(frozen=True, slots=True, kw_only=True)
class VisualisationMemoryRow:
    """A moment with a sink that stands still for a while."""

    at_s: float  #: Time since the beginning.
    stopped: bool  #: Whether the sink stands still.
    queued_bytes: int  #: Messages that wait for their turn, and drawn ones that the sink has not taken.
    resident_bytes: int  #: Memory of the bridge's process.
    received: int  #: Pictures that arrived up to now.
    shown: int  #: Pictures drawn up to now.
    dropped: int  #: Pictures passed over up to now.
