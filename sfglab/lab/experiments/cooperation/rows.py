"""The rows that the cooperation experiment writes into its log, one class a table."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True, kw_only=True)
class CourseRow:
    """One simulated run: how it ended, and how its messages did."""

    method: str  #: One of `METHODS`.
    rate_max_hz: int  #: Rmax.
    depth: int  #: Option of Table 2; 0: the optimum.
    vendor: str  #: Name of the preset that times the protocol.
    loss: float  #: Share of frames that the medium lost.
    seed: int  #: Of physics and medium.
    rate_hz: float  #: At which each topic was sent.
    depth_used: int  #: Depth of the writers' history.
    end: str  #: An `End`.
    robot: str  #: Who failed, ``robot1`` to ``robot3``; empty: nobody, or nobody alone.
    ended_s: float  #: When.
    wound: float  #: Rounds that the slowest robot had come by then.
    airtime: float  #: Share of the time that the medium was taken.
    beams_sent: int  #: Beams' samples that were published.
    held: int  #: Values that local caches held back.
    compared: int  #: Values that cache control discarded.
    processed: int  #: Values that planning and actuation worked on.
    queue_full: int  #: Frames dropped because a host's queue was full.
    beams_lost: float  #: Share of the beams' samples that the station never had, or not by the end.
    beam_p50_ms: float  #: Median time from a beam's publication until it was processed; NaN: nothing arrived.
    beam_p99_ms: float  #: The same, of which one in a hundred is longer.
    command_p50_ms: float  #: Median time from a command's publication until it was executed.
    command_p99_ms: float  #: The same, of which one in a hundred is longer.
    stale_s: float  #: Longest time that something sent was newer than what its reader had.
    stale_flow: str  #: Topic that it was on.


@dataclass(frozen=True, slots=True, kw_only=True)
class TrackRow:
    """Where a robot was, in one of the runs that are drawn."""

    run: str  #: ``success``, ``failure``, ``live`` or ``simulated`` (live's twin).
    robot: str  #: Its name.
    t_s: float  #: Since the start.
    x_m: float  #: To the right.
    y_m: float  #: Up.
    heading_rad: float  #: From x to y.
    manoeuvre: str  #: What the station had released.
