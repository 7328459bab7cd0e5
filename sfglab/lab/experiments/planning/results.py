"""Values of the claim A-PLAN, and figures of the scene and of both interpolations."""

from __future__ import annotations

from dataclasses import asdict
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from sfglab.lab.checks import check_row, fact_rows, lowest_share, shown_checks
from sfglab.lab.claims import Finding, How
from sfglab.lab.experiments.planning.experiment import Config, exp, pose_topic
from sfglab.lab.experiments.planning.facts import FACTS
from sfglab.lab.figures import COLORS, note
from sfglab.lab.runs import Run, derived, lines_of
from sfglab.spatial import Pose
from sfglab.spatial.scene.files import read_scene
from sfglab.spatial.scene.model import AgentObject, Box, ObstacleObject, ZoneObject, ZoneRule
from sfglab.spatial.trajectory.motion import pose_at, sample
from sfglab.spatial.trajectory.path import Interpolation, Trajectory
from sfglab.units import NS_PER_S

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from sfglab.spatial.scene.tree import Scene

CARRIED_OUT = "a goal is carried out by an action server"
STATEMENTS = {
    "aligned to the previous waypoint, x looks along the segment that arrives, without roll": (
        "A pose aligned to the previous waypoint has its x axis along the segment before it, and no roll."
    ),
    "aligned to the next waypoint, x looks along the segment that leaves, without roll": (
        "A pose aligned to the next waypoint has its x axis along the segment after it, and no roll."
    ),
    "a polyline is linear in position and SLERP in orientation": (
        "A polyline is interpolated linearly in position and with SLERP in orientation."
    ),
    "a spline is Barry and Goldman's pyramid with centripetal knots": (
        "A spline agrees with Barry and Goldman's construction with centripetal knots."
    ),
    "any edits, undone and done again, give the same bytes at every step": (
        "After edits in random order, each undo and redo restores the scene file byte by byte."
    ),
    "a saved scene is the file that is loaded": "A scene that is saved and loaded is equal.",
    CARRIED_OUT: "An action server executes the trajectory of a goal, and the goal succeeds.",
}
"""Sentence that each fact states, by its name in the log."""
_SUCCEEDED = "succeeded"

EXAMPLE_M = ((0.0, 0.0), (1.2, 0.3), (1.5, 1.5), (3.0, 1.5), (3.3, 1.3), (5.0, 0.0))
"""Waypoints of the example in both interpolations, x and y, m; some are far apart and some close."""
WAYS = {
    Interpolation.POLYLINE: ("polyline (paper)", COLORS["network"]),
    Interpolation.CATMULL_ROM: ("Catmull-Rom (sfglab)", COLORS["proxy"]),
}
_ZONES: dict[ZoneRule, dict[str, Any]] = {
    ZoneRule.FORBIDDEN: {"facecolor": "#f3d6c8", "edgecolor": COLORS["standard"], "hatch": "//"},
    ZoneRule.INSIDE: {"fill": False, "edgecolor": "0.5", "linewidth": 1.6},
}
"""Styles of zones by their rule."""
_SAMPLES = 160
_ARROW_M = 0.45
_AGENT_COLORS = (COLORS["standard"], COLORS["proxy"], COLORS["third"])


@derived
def scene_of(run: Run[Config]) -> Scene:
    """Return the scene whose agents were sent along their trajectories."""
    return read_scene(str(run.metadata("scene")["text"]))


def goals_of(run: Run[Config]) -> pd.DataFrame:
    """Return the goals that carry out the scene's trajectories, one row for each agent."""
    return run["goal"]


@derived
def track_of(run: Run[Config], agent: str) -> pd.DataFrame:
    """Return the poses of an agent: ``t_s`` since the scene's time 0, ``x_m``, ``y_m``, and ``error_m`` from the plan."""
    scene = scene_of(run)
    [id_] = [one.id for one in scene.all_of(AgentObject) if one.name == agent]
    rows = []
    for entry in run.messages(pose_topic(agent)):
        t_s = entry.log_time_ns / NS_PER_S
        pose = Pose.from_msg(entry.message.pose)
        x_m, y_m, _ = pose.position_m
        rows.append((t_s, x_m, y_m, pose.distance_m(pose_at(scene.motion(id_), t_s))))
    return pd.DataFrame(rows, columns=["t_s", "x_m", "y_m", "error_m"])


@derived
def facts_of(run: Run[Config]) -> pd.DataFrame:
    """Return the facts of section 4.5, one row for each, with the columns of `CheckRow`."""
    goals = lines_of(goals_of(run))
    cases = [(f"{goal.agent}: {goal.outcome}", goal.outcome == _SUCCEEDED) for goal in goals]
    carried_out = pd.DataFrame([asdict(check_row(CARRIED_OUT, cases))])
    of_cases = fact_rows(run["check"], FACTS)
    return pd.concat([of_cases, carried_out], ignore_index=True)


def fact_table(run: Run[Config]) -> pd.DataFrame:
    """Return the facts with the sentence that each states."""
    return shown_checks(facts_of(run).drop(columns="example"), STATEMENTS)


@exp.claim("A-PLAN", how=How.LIVE, also=How.EXACT)
def share_that_holds(run: Run[Config]) -> Finding:
    """Return the share of cases that hold, of the fact where it is lowest."""
    table = facts_of(run)
    share = lowest_share(table, "check")
    held = int((table["held"] == table["checked"]).sum())
    details = {
        "facts": f"{held} of {len(FACTS) + 1}",
        **share.groups,
        "actions": "over DDS, all nodes in one process",
        "beyond the paper": "splines, its future work",
    }
    count = f"lowest of {len(FACTS) + 1} facts"
    return Finding(estimate=share.estimate, details=details, reason=share.reason, count=count)


# --- Figures ----------------------------------------------------------------------------------


@exp.figure("planning_scene", size=(10, 4.9))
def draw_scene(figure: Figure, run: Run[Config]) -> None:
    """Draw plans and driven tracks from above (left), and the agents' tracking errors over time (right)."""
    above, errors = figure.subplots(1, 2, width_ratios=(1.55, 1.0))
    scene = scene_of(run)
    draw_from_above(above, scene)
    above.set_title("Planned (dashed) and driven (colour)")
    agents = scene.all_of(AgentObject)
    ends_s = {agent.name: scene.motion(agent.id).end_ns / NS_PER_S for agent in agents}
    largest = []
    for color, name in zip(_AGENT_COLORS, sorted(goals_of(run)["agent"]), strict=False):
        track = track_of(run, name)
        above.plot(track["x_m"], track["y_m"], color=color, lw=3)
        errors.plot(track["t_s"], track["error_m"], color=color)
        errors.axvline(ends_s[name], color=color, linestyle=":")
        place = {
            "transform": errors.get_xaxis_transform(),
            "rotation": 90,
            "ha": "right",
            "va": "center",
        }
        errors.text(ends_s[name], 0.7, f"plan of {name} ends", **place)
        largest.append(f"{name} {track['error_m'].max():.2f} m")
    errors.set(
        ylim=(0, None),
        xlabel="time since the start of both plans (s)",
        ylabel="tracking error (m)",
        title="Distance to the plan",
    )
    arrived = (goals_of(run)["outcome"] == _SUCCEEDED).sum()
    figure.suptitle(
        f"{arrived} of {len(largest)} agents reach their goals; largest tracking error: "
        f"{', '.join(largest)}"
    )
    note(
        figure,
        "live, over DDS on one host; simulated agents",
    )


def draw_from_above(axes: Axes, scene: Scene) -> None:
    """Draw a scene's zones and obstacles, and its agents' trajectories with their waypoints."""
    for zone in scene.all_of(ZoneObject):
        _draw_body(axes, scene, zone, **_ZONES[zone.rule])
    for obstacle in scene.all_of(ObstacleObject):
        _draw_body(axes, scene, obstacle, facecolor="0.8", edgecolor="0.4")
    for agent in scene.all_of(AgentObject):
        _draw_plan(axes, agent.name, scene.motion(agent.id))
    axes.set(aspect="equal", xlabel="x (m)", ylabel="y (m)", title="Scene from above")


def _draw_body(axes: Axes, scene: Scene, thing: ZoneObject | ObstacleObject, **style: Any) -> None:
    """Draw a body from above, with its name at a corner or beside it."""
    from matplotlib.patches import Circle, Rectangle

    pose = scene.world_pose(thing.id)
    x, y, _ = pose.position_m
    if isinstance(thing.shape, Box):
        width, depth, _ = thing.shape.size_m
        corner = (x - width / 2, y - depth / 2)
        turn = float(np.degrees(pose.yaw_rad))
        body: Any = Rectangle(corner, width, depth, angle=turn, rotation_point="center", **style)
    else:
        corner = (x + thing.shape.radius_m, y)
        body = Circle((x, y), thing.shape.radius_m, **style)
    axes.add_patch(body)
    axes.annotate(thing.name, corner, (4, 4), textcoords="offset points", fontsize=8)


def _draw_plan(axes: Axes, name: str, planned: Trajectory) -> None:
    """Draw a trajectory, dashed, with an arrow along the x axis of each waypoint."""
    times_s = np.linspace(planned.start_ns, planned.end_ns, 300) / NS_PER_S
    x, y, _ = sample(planned, times_s).positions_m.T
    axes.plot(x, y, "k--", lw=1.2, zorder=4)
    x, y, _ = np.transpose([waypoint.pose.position_m for waypoint in planned.waypoints])
    yaws = np.array([waypoint.pose.yaw_rad for waypoint in planned.waypoints])
    to_scale: dict[str, Any] = {"angles": "xy", "scale_units": "xy", "scale": 1 / _ARROW_M}
    axes.quiver(x, y, np.cos(yaws), np.sin(yaws), width=0.003, zorder=5, **to_scale)
    axes.plot(x, y, "k.", zorder=5)
    axes.annotate(name, (x[0], y[0]), (8, -14), textcoords="offset points", weight="bold")


@exp.figure("planning_interpolation", size=(10, 4.2), measured=False)
def draw_interpolation(figure: Figure, run: Run[Config]) -> None:  # noqa: ARG001  # computed
    """Draw path (left) and speed (right) of six waypoints, as a polyline and as a spline."""
    path, speed = figure.subplots(1, 2)
    for way, (name, color) in WAYS.items():
        timed = [(i * NS_PER_S, Pose.at((*place, 0.0))) for i, place in enumerate(EXAMPLE_M)]
        found = sample(Trajectory.of(timed, way), np.linspace(0.0, len(timed) - 1, _SAMPLES))
        x, y, _ = found.positions_m.T
        path.plot(x, y, color=color, label=name)
        speed.plot(found.times_s, found.speeds_m_s, color=color)
    path.plot(*np.transpose(EXAMPLE_M), "k.", label="waypoint")
    path.set(xlabel="x (m)", ylabel="y (m)", title="Path", aspect="equal")
    path.legend(fontsize=8)
    speed.set(xlabel="time (s)", ylabel="speed (m/s)", title="Speed", ylim=(0, None))
    figure.suptitle("The speed of a spline is continuous; that of a polyline jumps at waypoints")
    note(figure, "six waypoints, 1 s apart; splines are the paper's future work")
