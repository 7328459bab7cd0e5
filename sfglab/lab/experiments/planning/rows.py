"""The rows that the planning experiment writes into its log, one class a table."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["PlanningFaultRow", "PlanningGoalRow", "PlanningSampleRow", "PlanningTrackRow"]


@dataclass(frozen=True, slots=True, kw_only=True)
class PlanningFaultRow:
    """One kind of broken file.

    Attributes:
        fault: What is broken.
        said: The error.
        names_the_line: Whether it begins with file and line.
        one_line: Whether it is one sentence.
        file_kept: Whether the file is as it was.
        scene_kept: Whether the editor still has the scene that it had.
    """

    fault: str
    said: str
    names_the_line: bool
    one_line: bool
    file_kept: bool
    scene_kept: bool


@dataclass(frozen=True, slots=True, kw_only=True)
class PlanningGoalRow:
    """One goal that was sent to an action's server.

    Attributes:
        case: Why it was sent.
        agent: Who was to move.
        expected: The outcome that it must have.
        outcome: The outcome it had.
        said: What the server said.
        feedbacks: How often it said how it got on.
        steady: Whether what it said never went back.
        share: The last it said: how much was over, 0 to 1.
        left_m: From where the agent ended to the last pose; NaN where it does not count.
        end_speed_m_s: How fast the agent was when its goal had ended.
        seconds: From sending to the end.
    """

    case: str
    agent: str
    expected: str
    outcome: str
    said: str
    feedbacks: int
    steady: bool
    share: float
    left_m: float
    end_speed_m_s: float
    seconds: float


@dataclass(frozen=True, slots=True, kw_only=True)
class PlanningTrackRow:
    """Where an agent of the scene was, and where it should have been.

    Attributes:
        agent: Its name.
        t_s: Since the scene's time 0.
        x_m: Where it was.
        y_m: The same.
        z_m: The same.
        speed_m_s: How fast it was.
        planned_x_m: Where it should have been.
        planned_y_m: The same.
        planned_z_m: The same.
        error_m: From one to the other.
    """

    agent: str
    t_s: float
    x_m: float
    y_m: float
    z_m: float
    speed_m_s: float
    planned_x_m: float
    planned_y_m: float
    planned_z_m: float
    error_m: float


@dataclass(frozen=True, slots=True, kw_only=True)
class PlanningSampleRow:
    """A moment of the example that is drawn in every way.

    Attributes:
        interpolation: Polyline or spline.
        retimed: Whether it keeps to the limits.
        t_s: When.
        x_m: Where.
        y_m: The same.
        speed_m_s: How fast.
        acceleration_m_s2: Length of the acceleration; 0 inside a polyline's segments.
        waypoint: Whether it is a waypoint's moment.
        jump_m_s2: At a polyline's corners what `limits` takes for the acceleration; else 0.
    """

    interpolation: str
    retimed: bool
    t_s: float
    x_m: float
    y_m: float
    speed_m_s: float
    acceleration_m_s2: float
    waypoint: bool
    jump_m_s2: float
