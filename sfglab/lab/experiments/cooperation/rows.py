"""The rows that the cooperation experiment writes into its log, one class a table."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["CourseRow", "TrackRow"]


@dataclass(frozen=True, slots=True, kw_only=True)
class CourseRow:
    """One simulated run: how it ended, and how its messages did.

    Attributes:
        method: One of `METHODS`.
        rate_max_hz: Rmax.
        depth: Option of Table 2; 0: the optimum.
        vendor: Name of the preset that times the protocol.
        loss: Share of frames that the medium lost.
        seed: Of physics and medium.
        rate_hz: At which each topic was sent.
        depth_used: Depth of the writers' history.
        end: An `End`.
        robot: Who failed, ``robot1`` to ``robot3``; empty: nobody, or nobody alone.
        ended_s: When.
        wound: Rounds that the slowest robot had come by then.
        airtime: Share of the time that the medium was taken.
        beams_sent: Beams' samples that were published.
        held: Values that local caches held back.
        compared: Values that cache control discarded.
        processed: Values that planning and actuation worked on.
        queue_full: Frames dropped because a host's queue was full.
        beams_lost: Share of the beams' samples that the station never had, or not by the end.
        beam_p50_ms: Median time from a beam's publication until it was processed; NaN: nothing arrived.
        beam_p99_ms: The same, of which one in a hundred is longer.
        command_p50_ms: Median time from a command's publication until it was executed.
        command_p99_ms: The same, of which one in a hundred is longer.
        stale_s: Longest time that something sent was newer than what its reader had.
        stale_flow: Topic that it was on.
    """

    method: str
    rate_max_hz: int
    depth: int
    vendor: str
    loss: float
    seed: int
    rate_hz: float
    depth_used: int
    end: str
    robot: str
    ended_s: float
    wound: float
    airtime: float
    beams_sent: int
    held: int
    compared: int
    processed: int
    queue_full: int
    beams_lost: float
    beam_p50_ms: float
    beam_p99_ms: float
    command_p50_ms: float
    command_p99_ms: float
    stale_s: float
    stale_flow: str


@dataclass(frozen=True, slots=True, kw_only=True)
class TrackRow:
    """Where a robot was, in one of the runs that are drawn.

    Attributes:
        run: ``success``, ``failure``, ``live`` or ``simulated`` (live's twin).
        robot: Its name.
        t_s: Since the start.
        x_m: To the right.
        y_m: Up.
        heading_rad: From x to y.
        manoeuvre: What the station had released.
    """

    run: str
    robot: str
    t_s: float
    x_m: float
    y_m: float
    heading_rad: float
    manoeuvre: str
