"""The rows that the planning experiment writes into its log, one class a table."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True, kw_only=True)
class PlanningFaultRow:
    """One kind of broken file."""

    fault: str  #: What is broken.
    said: str  #: The error.
    names_the_line: bool  #: Whether it begins with file and line.
    one_line: bool  #: Whether it is one sentence.
    file_kept: bool  #: Whether the file is as it was.
    scene_kept: bool  #: Whether the editor still has the scene that it had.


@dataclass(frozen=True, slots=True, kw_only=True)
class PlanningGoalRow:
    """One goal that was sent to an action's server."""

    case: str  #: Why it was sent.
    agent: str  #: Who was to move.
    expected: str  #: The outcome that it must have.
    outcome: str  #: The outcome it had.
    said: str  #: What the server said.
    feedbacks: int  #: How often it said how it got on.
    steady: bool  #: Whether what it said never went back.
    share: float  #: The last it said: how much was over, 0 to 1.
    left_m: float  #: From where the agent ended to the last pose; NaN where it does not count.
    end_speed_m_s: float  #: How fast the agent was when its goal had ended.
    seconds: float  #: From sending to the end.


@dataclass(frozen=True, slots=True, kw_only=True)
class PlanningTrackRow:
    """Where an agent of the scene was, and where it should have been."""

    agent: str  #: Its name.
    t_s: float  #: Since the scene's time 0.
    x_m: float  #: Where it was.
    y_m: float  #: The same.
    z_m: float  #: The same.
    speed_m_s: float  #: How fast it was.
    planned_x_m: float  #: Where it should have been.
    planned_y_m: float  #: The same.
    planned_z_m: float  #: The same.
    error_m: float  #: From one to the other.


@dataclass(frozen=True, slots=True, kw_only=True)
class PlanningSampleRow:
    """A moment of the example that is drawn in every way."""

    interpolation: str  #: Polyline or spline.
    retimed: bool  #: Whether it keeps to the limits.
    t_s: float  #: When.
    x_m: float  #: Where.
    y_m: float  #: The same.
    speed_m_s: float  #: How fast.
    acceleration_m_s2: float  #: Length of the acceleration; 0 inside a polyline's segments.
    waypoint: bool  #: Whether it is a waypoint's moment.
    jump_m_s2: float  #: At a polyline's corners what `limits` takes for the acceleration; else 0.
