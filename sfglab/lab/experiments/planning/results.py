"""The claim A-PLAN, figures of the scene and of both interpolations, and the explorer."""

from __future__ import annotations

from dataclasses import asdict
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import pandas as pd

from sfglab.fields import Bounds
from sfglab.lab import pictures
from sfglab.lab.checks import check_row, fact_rows, lowest_share
from sfglab.lab.claims import Finding, How
from sfglab.lab.experiments.planning.experiment import OWN_GOAL, Config, exp
from sfglab.lab.experiments.planning.facts import FACTS
from sfglab.lab.figures import COLORS, note
from sfglab.lab.runs import Run, derived, lines_of
from sfglab.spatial import Pose
from sfglab.spatial.scene.files import read_scene
from sfglab.spatial.scene.model import (
    AgentObject,
    Box,
    ObstacleObject,
    Shape,
    ZoneObject,
    ZoneRule,
)
from sfglab.spatial.trajectory.motion import Samples, sample
from sfglab.spatial.trajectory.path import Interpolation, Trajectory
from sfglab.units import NS_PER_S

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from sfglab.lab.stats import Floats
    from sfglab.spatial.scene.tree import Scene

FORMER_TABLES = ("geometry", "editing")
"""Tables of earlier logs that hold the facts, among further checks that are tests now."""
CARRIED_OUT = "a goal is carried out by an action server"
_SUCCEEDED = "succeeded"

EXAMPLE_M = ((0.0, 0.0), (1.2, 0.3), (1.5, 1.5), (3.0, 1.5), (3.3, 1.3), (5.0, 0.0))
"""Waypoints of the example in both interpolations, x and y, m; some are far apart and some close."""
WAYS = {
    Interpolation.POLYLINE: ("polyline (paper)", COLORS["network"]),
    Interpolation.CATMULL_ROM: ("Catmull-Rom (sfglab)", COLORS["proxy"]),
}
_BODIES: dict[ZoneRule | None, dict[str, Any]] = {
    None: {"facecolor": "0.8", "edgecolor": "0.4"},
    ZoneRule.FORBIDDEN: {"facecolor": "#f3d6c8", "edgecolor": COLORS["standard"], "hatch": "//"},
    ZoneRule.INSIDE: {"fill": False, "edgecolor": "0.5", "linewidth": 1.6},
}
"""Styles of zones by their rule, and of obstacles."""
_AGENT_COLORS = (COLORS["standard"], COLORS["proxy"], COLORS["third"])
_SAMPLES = 160


def how_of(run: Run[Config]) -> How:
    """Return how goals were sent: over DDS, or on the simulated bus."""
    return How.LIVE if run.config.live else How.SIMULATED


@derived
def scene_of(run: Run[Config]) -> Scene:
    """Return the scene whose agents were sent along their trajectories."""
    return read_scene(str(run.metadata("scene")["text"]))


@derived
def facts_of(run: Run[Config]) -> pd.DataFrame:
    """Return the facts of section 4.5, one row for each, with the columns of `CheckRow`."""
    tried = run["check"]
    if tried.empty:
        tried = pd.concat([run[table] for table in FORMER_TABLES])
    goals = lines_of(run["goal"][run["goal"]["case"] == OWN_GOAL])
    cases = [(f"{goal.agent}: {goal.outcome}", goal.outcome == _SUCCEEDED) for goal in goals]
    carried_out = pd.DataFrame([asdict(check_row(CARRIED_OUT, cases))])
    of_cases = fact_rows(tried, dict.fromkeys(FACTS, ()))
    return pd.concat([of_cases, carried_out], ignore_index=True)


@exp.claim("A-PLAN", how=how_of)
def share_that_holds(run: Run[Config]) -> Finding:
    """Return the share of cases that hold, of the fact where it is lowest."""
    table = facts_of(run)
    share = lowest_share(table, "check")
    held = int((table["held"] == table["checked"]).sum())
    details = {
        "facts": f"{held} of {len(FACTS) + 1}",
        **share.groups,
        "actions": "over DDS, all nodes in one process"
        if run.config.live
        else "on the simulated bus",
        "beyond the paper": "splines, its future work",
    }
    count = f"lowest of {len(FACTS) + 1} facts"
    return Finding(estimate=share.estimate, details=details, reason=share.reason, count=count)


# --- Figures ----------------------------------------------------------------------------------


@exp.figure("planning_scene", size=(10, 4.9))
def draw_scene(figure: Figure, run: Run[Config]) -> None:
    """Draw the scene from above with the plans and the driven tracks, and the tracking errors over time."""
    above, errors = figure.subplots(1, 2, width_ratios=(1.55, 1.0))
    draw_from_above(above, scene_of(run))
    tracks = run["track"].groupby("agent")
    for color, (name, track) in zip(_AGENT_COLORS, tracks, strict=False):
        above.plot(track["x_m"], track["y_m"], color=color, lw=3)
        errors.plot(track["t_s"], track["error_m"], color=color, label=name)
    errors.set(
        ylim=(0, None),
        xlabel="time since the start of both plans (s)",
        ylabel="error (m)",
        title="Tracking error",
    )
    errors.legend()
    largest = ", ".join(f"{name} {error:.2f} m" for name, error in tracks["error_m"].max().items())
    figure.suptitle(f"Agents of a scene carry out their plans; largest error: {largest}")
    bus = "live, over DDS on one host" if run.config.live else "on the simulated bus"
    note(figure, f"dashed: planned; {bus}; simulated agents; the paper states no values")


def draw_from_above(axes: Axes, scene: Scene) -> None:
    """Draw a scene's zones and obstacles, and its agents' trajectories with their waypoints."""
    bodies: list[ZoneObject | ObstacleObject] = [*scene.all_of(ZoneObject)]
    bodies += scene.all_of(ObstacleObject)
    for thing in bodies:
        corners = _outline(thing.shape, scene.world_pose(thing.id))
        axes.fill(*corners.T, **_BODIES[thing.rule if isinstance(thing, ZoneObject) else None])
        axes.annotate(thing.name, corners[0], (4, 4), textcoords="offset points", fontsize=8)
    for agent in scene.all_of(AgentObject):
        _draw_plan(axes, agent.name, scene.motion(agent.id))
    axes.set(aspect="equal", xlabel="x (m)", ylabel="y (m)", title="Scene from above")


def _outline(shape: Shape, pose: Pose) -> Floats:
    """Return the corners of a body from above, shape (n, 2); a round one is a polygon of many."""
    turns = np.linspace(0.0, 2.0 * np.pi, 49)
    if isinstance(shape, Box):
        local = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)]) * np.array(shape.size_m[:2]) / 2
    else:
        local = shape.radius_m * np.column_stack([np.cos(turns), np.sin(turns)])
    return np.array([pose.apply((x, y, 0.0))[:2] for x, y in local.tolist()])


def _draw_plan(axes: Axes, name: str, planned: Trajectory) -> None:
    """Draw a trajectory, dashed, with an arrow along the x axis of each waypoint."""
    times_s = np.linspace(planned.start_ns, planned.end_ns, 300) / NS_PER_S
    x, y, _ = sample(planned, times_s).positions_m.T
    axes.plot(x, y, "k--", lw=1.2, zorder=4)
    points = np.array([waypoint.pose.position_m for waypoint in planned.waypoints])
    tips = np.array([waypoint.pose.apply((0.45, 0, 0)) for waypoint in planned.waypoints])
    x, y, _ = points.T
    along_x, along_y, _ = (tips - points).T
    to_scale: dict[str, Any] = {"angles": "xy", "scale_units": "xy", "scale": 1}
    axes.quiver(x, y, along_x, along_y, width=0.003, zorder=5, **to_scale)
    axes.plot(x, y, "k.", zorder=5)
    axes.annotate(name, (x[0], y[0]), (8, -14), textcoords="offset points", weight="bold")


@exp.figure("planning_interpolation", size=(10, 4.2), measured=False)
def draw_interpolation(figure: Figure, run: Run[Config]) -> None:  # noqa: ARG001  # computed
    """Draw path and speed of the example, as a polyline and as a spline."""
    shown = interpolation()
    for axes, panel in zip(figure.subplots(1, 2), shown.panels, strict=True):
        for one in panel.series:
            form = "." if one.kind == "dot" else "-"
            axes.plot(one.x, one.y, form, color=one.color, label=one.name)
        axes.set(xlabel=panel.x.label, ylabel=panel.y.label, title=panel.title)
    path, speed = figure.axes
    path.set_aspect("equal")
    path.legend(fontsize=8)
    speed.set_ylim(0, None)
    figure.suptitle("The speed of a spline changes continuously; that of a polyline jumps")
    note(figure, "six waypoints, 1 s apart; splines are the paper's future work")


_X = pictures.Axis("x", "m", -0.5, 5.5)
_Y = pictures.Axis("y", "m", -2.0, 4.0)
_TIME = pictures.Axis("time", "s", 0, 10)
_SPEED = pictures.Axis("speed", "m/s", 0, 6)
Seconds = Annotated[float, Bounds(0.5, 2.0)]


@exp.explorer
def interpolation(*, segment_s: Seconds = 1.0) -> pictures.Picture:
    """Return path and speed of the example, as a polyline and as a spline.

    Args:
        segment_s: Time from each waypoint to the next [s].
    """
    paths, speeds, fastest = [], [], []
    for way, (name, color) in WAYS.items():
        found = _moments(way, segment_s)
        x, y, _ = found.positions_m.T.tolist()
        paths.append(pictures.Series(name=name, color=color, kind="path", x=x, y=y))
        times, values = found.times_s.tolist(), found.speeds_m_s.tolist()
        speeds.append(pictures.Series(name=name, color=color, x=times, y=values))
        fastest.append(f"{name} {max(values):.2f} m/s")
    x, y = zip(*EXAMPLE_M, strict=True)
    paths.append(pictures.Series(name="waypoint", color="#000000", kind="dot", x=x, y=y))
    path = pictures.Panel(title="Path", x=_X, y=_Y, series=tuple(paths))
    speed = pictures.Panel(title="Speed", x=_TIME, y=_SPEED, series=tuple(speeds))
    said = f"Path and speed with {segment_s:g} s per segment. Highest speed: {', '.join(fastest)}."
    return pictures.Picture(said=said, panels=(path, speed))


def _moments(interpolation: Interpolation, segment_s: float) -> Samples:
    """Return the example with equal times between waypoints, at equal times."""
    times_s = np.arange(len(EXAMPLE_M)) * segment_s
    timed = []
    for time_s, (x, y) in zip(times_s, EXAMPLE_M, strict=True):
        timed.append((round(time_s * NS_PER_S), Pose.at((x, y, 0.0))))
    example = Trajectory.of(timed, interpolation)
    return sample(example, np.linspace(0.0, times_s[-1], _SAMPLES))
