"""Every check of a run and how far apart its agents were, the claim A-PLAN, and the figures."""

from __future__ import annotations

from dataclasses import asdict, replace
from itertools import combinations
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from sfglab.lab.checks import (
    CheckRow,
    check_row,
    lowest_share,
)
from sfglab.lab.claims import Finding, How
from sfglab.lab.experiment import Look
from sfglab.lab.experiments.planning.experiment import EXAMPLE_M, Config, example_limits, exp
from sfglab.lab.figures import COLORS, note
from sfglab.lab.runs import Run, derived
from sfglab.spatial.execution.agent import Dynamics, Tolerances, falls_behind_m
from sfglab.spatial.execution.server import AgentSetup
from sfglab.spatial.scene.files import read_scene
from sfglab.spatial.scene.objects import AgentObject, ObstacleObject, ZoneObject, ZoneRule
from sfglab.spatial.trajectory.clearance import Box, Shape
from sfglab.spatial.trajectory.motion import motion_of
from sfglab.spatial.trajectory.path import Interpolation, Trajectory

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from sfglab.lab.stats import Floats
    from sfglab.spatial import Pose
    from sfglab.spatial.scene.tree import Scene
    from sfglab.spatial.trajectory.limits import Limits

    Holds = Callable[[Any], bool]

_EXACT_TABLES = ("geometry", "exchange", "editing", "disk")
_GROUPS = {"disk": "editing", "fault": "editing"}
_SUCCEEDED, _CANCELED = "succeeded", "canceled"
_TOLERANCES = Tolerances()

_GRID_S = 0.05


def how_of(run: Run[Config]) -> How:
    """Return how goals were sent: over DDS, or on the simulated bus."""
    return How.LIVE if run.config.live else How.SIMULATED


@derived
def scene_of(run: Run[Config]) -> Scene:
    """Return the scene that was driven."""
    return read_scene(str(run.metadata("scene")["text"]))


@derived
def checks(run: Run[Config]) -> pd.DataFrame:
    """Return every check: its group, how it was made, and what `CheckRow` says of it."""
    tables = [run[name].assign(group=_GROUPS.get(name, name)) for name in _EXACT_TABLES]
    tables.append(
        pd.DataFrame(map(asdict, _of_faults(run["fault"]))).assign(group=_GROUPS["fault"])
    )
    exact = pd.concat(tables, ignore_index=True).assign(how=How.EXACT.value)
    goals = pd.DataFrame(map(asdict, _of_goals(run))).assign(
        group="execution", how=how_of(run).value
    )
    return pd.concat([exact, goals], ignore_index=True)[
        ["check", "group", "how", "checked", "held", "example"]
    ]


def _of_faults(faults: pd.DataFrame) -> Iterator[CheckRow]:
    columns = {
        "a broken file is refused with file and line": "names_the_line",
        "a broken file is refused in one sentence": "one_line",
        "a broken file stays as it is on disk": "file_kept",
        "after a broken file the editor has the scene that it had": "scene_kept",
    }
    for name, column in columns.items():
        yield check_row(
            name, [(str(row.fault), bool(getattr(row, column))) for row in faults.itertuples()]
        )


def _of_goals(run: Run[Config]) -> Iterator[CheckRow]:
    goals = list(run["goal"].itertuples())
    said = [g for g in goals if g.feedbacks]
    done = [g for g in goals if g.outcome == _SUCCEEDED]
    stopped = [g for g in goals if g.outcome == _CANCELED]
    slow = "after success the agent is no faster than it may be there"
    ends: tuple[tuple[str, list[Any], Holds], ...] = (
        ("a goal ends as it must", goals, lambda g: g.outcome == g.expected),
        ("what a goal's feedback says is over never goes back", said, lambda g: bool(g.steady)),
        ("after success everything is over", done, lambda g: g.share == 1.0),
        (
            "after success the agent is at the last pose",
            done,
            lambda g: g.left_m <= _TOLERANCES.goal_m,
        ),
        (slow, done, lambda g: g.end_speed_m_s <= _TOLERANCES.goal_m_s),
        ("a canceled goal ends when the agent stands", stopped, lambda g: g.end_speed_m_s == 0.0),
    )
    for name, rows, holds in ends:
        yield check_row(name, [(f"{g.case}: {g.outcome}", holds(g)) for g in rows])
    yield from _of_tracks(run)


def _of_tracks(run: Run[Config]) -> Iterator[CheckRow]:
    allowed, worst = allowed_m(run), run["track"].groupby("agent")["error_m"].max()
    off = [(str(agent), error, allowed[str(agent)]) for agent, error in worst.items()]
    near = [
        (f"{agent}: {error:.3f} of {most:.3f} m", bool(error <= most)) for agent, error, most in off
    ]
    yield check_row("an agent is never further from its plan than its dynamics explain", near)
    pairs = []
    for a, b, needed in _pairs(run):
        _, _, driven = apart_m(run, a, b)
        pairs.append((f"{a} and {b}: {driven.min():.3f} m", bool(driven.min() >= needed)))
    yield check_row("driven, agents stay as far apart as the scene demands", pairs)


def allowed_m(run: Run[Config]) -> dict[str, float]:
    """Return by agent how far its dynamics let it fall behind its plan, at the rate of its server."""
    scene, period_s = scene_of(run), AgentSetup().period_s
    return {
        agent.name: falls_behind_m(
            scene.motion(agent.id), Dynamics(limits=agent.limits), period_s=period_s
        )
        for agent in scene.all_of(AgentObject)
    }


def _pairs(run: Run[Config]) -> Iterator[tuple[str, str, float]]:
    """Yield any two agents of the scene, and how far apart it demands their centres."""
    for a, b in combinations(
        sorted(scene_of(run).all_of(AgentObject), key=lambda agent: agent.name), 2
    ):
        yield a.name, b.name, a.radius_m + b.radius_m + scene_of(run).margin_m


def apart_m(run: Run[Config], a: str, b: str) -> tuple[Floats, Floats, Floats]:
    """Return times, and how far apart the centres of two agents are then, as planned and as driven.

    Poses of the two came at times of their own; between them they are interpolated.
    """
    tracks = {name: run["track"][run["track"]["agent"] == name] for name in (a, b)}
    start = max(track["t_s"].min() for track in tracks.values())
    end = min(track["t_s"].max() for track in tracks.values())
    times = np.arange(start, end, _GRID_S)
    found = []
    for prefix in ("planned_", ""):
        one, other = (
            np.column_stack([np.interp(times, t["t_s"], t[f"{prefix}{axis}_m"]) for axis in "xyz"])
            for t in tracks.values()
        )
        found.append(np.linalg.norm(one - other, axis=1))
    return times, found[0], found[1]


@exp.claim("A-PLAN", how=how_of)
def share_that_holds(run: Run[Config]) -> Finding:
    """Return the share of checks that hold.

    Of the groups whichever share is lowest: many random cases of one would hide the few of another.
    """
    table = checks(run)
    share, allowed = lowest_share(table, "group"), allowed_m(run)
    contrast, worst = run["contrast"].iloc[0], run["track"].groupby("agent")["error_m"].max()
    loops = contrast["checked"] - contrast["held"]
    details = {
        **{f"{group} checks": held for group, held in share.groups.items()},
        "kinds of checks": str(len(table)),
        "actions": "over DDS, all nodes in one process"
        if run.config.live
        else "on the simulated bus",
        **{
            f"largest error, {agent}": f"{error:.3f} m; its dynamics explain {allowed[str(agent)]:.3f} m"
            for agent, error in worst.items()
        },
        "loops, had the spline evenly spaced knots": f"{loops} of {contrast['checked']} curves",
        "beyond the paper": "splines, its future work; limits, re-timing and clearance",
    }
    return Finding(estimate=share.estimate, details=details, reason=share.reason)


_LINES = {Interpolation.POLYLINE: COLORS["network"], Interpolation.CATMULL_ROM: COLORS["proxy"]}
_WAYS = {
    Interpolation.POLYLINE: "polyline (paper)",
    Interpolation.CATMULL_ROM: "Catmull-Rom (ours)",
}
_AGENTS = (COLORS["standard"], COLORS["proxy"], COLORS["third"])


@exp.figure("planning_scene", size=(10, 4.9))
def draw_scene(figure: Figure, run: Run[Config]) -> dict[str, Any]:
    """Draw the scene from above, planned and driven, and how far apart and off their plans agents were."""
    axes = figure.subplot_mosaic([["hall", "apart"], ["hall", "errors"]], width_ratios=(1.55, 1.0))
    _draw_hall(axes["hall"], run)
    shown = _draw_apart(axes["apart"], run) | _draw_errors(axes["errors"], run)
    how = "live, over DDS on one host" if run.config.live else "simulated bus"
    worst, allowed = shown["largest error (m)"], allowed_m(run)
    off = ", ".join(
        f"{name} by {error:.2f} m of {allowed[name]:.2f} m" for name, error in worst.items()
    )
    figure.suptitle(
        f"Agents leave their plan by no more than their dynamics explain: {off}", fontsize=11
    )
    note(figure, f"{how}; simulated agents, one run; the paper states no figures")
    return shown


def _draw_hall(axes: Axes, run: Run[Config]) -> None:
    from matplotlib.collections import LineCollection

    scene = scene_of(run)
    draw_from_above(axes, scene)
    fastest = float(run["track"]["speed_m_s"].max())
    drawn = LineCollection([])
    for agent in scene.all_of(AgentObject):
        track = run["track"][run["track"]["agent"] == agent.name]
        places = track[["x_m", "y_m"]].to_numpy()
        segments = np.stack([places[:-1], places[1:]], axis=1)
        drawn = LineCollection(list(segments), cmap="viridis", linewidths=5.0, zorder=3)
        drawn.set_array(track["speed_m_s"].to_numpy()[1:])
        drawn.set_clim(0.0, fastest)
        axes.add_collection(drawn)
        axes.annotate(agent.name, places[0], (2, -15), textcoords="offset points", weight="bold")
    _mark_closest(axes, run)
    axes.figure.colorbar(drawn, ax=axes, label="speed, driven (m/s)", shrink=0.75, pad=0.01)
    axes.set_title("From above")
    axes.legend(loc="upper left", bbox_to_anchor=(0.05, 0.945), fontsize=8)


def draw_from_above(axes: Axes, scene: Scene) -> None:
    """Draw a scene's zones and obstacles, and the ways of its agents with their waypoints."""
    for thing in (*scene.all_of(ZoneObject), *scene.all_of(ObstacleObject)):
        _draw_body(axes, thing, scene.world_pose(thing.id))
    for number, agent in enumerate(scene.all_of(AgentObject)):
        _draw_plan(axes, scene.motion(agent.id), label=number == 0)
    axes.set(aspect="equal", xlabel="x (m)", ylabel="y (m)")


def _draw_body(axes: Axes, thing: ZoneObject | ObstacleObject, pose: Pose) -> None:
    from matplotlib.patches import Polygon

    corners = _outline(thing.shape, pose)
    inside = isinstance(thing, ZoneObject) and thing.rule is ZoneRule.INSIDE
    style: dict[str, Any] = {"facecolor": "0.8", "edgecolor": "0.4"}
    if inside:
        style = {"fill": False, "edgecolor": "0.5", "linewidth": 1.6}
    elif isinstance(thing, ZoneObject):
        style = {
            "facecolor": "#f3d6c8",
            "edgecolor": COLORS["standard"],
            "hatch": "//",
            "alpha": 0.6,
        }
    axes.add_patch(Polygon(corners, **style))
    where = corners[corners.sum(axis=1).argmin()] + (0.15, 0.15) if inside else corners.mean(axis=0)
    ha = "left" if inside else "center"
    behind = {"boxstyle": "square,pad=0.1", "facecolor": "white", "edgecolor": "none", "alpha": 0.8}
    axes.text(
        where[0], where[1], thing.name, fontsize=8, color="0.15", ha=ha, va="center", bbox=behind
    )


def _outline(shape: Shape, pose: Pose) -> np.ndarray[Any, np.dtype[np.float64]]:
    if isinstance(shape, Box):
        x, y = shape.size_m[0] / 2, shape.size_m[1] / 2
        local = [(-x, -y), (x, -y), (x, y), (-x, y)]
    else:
        turns = np.linspace(0.0, 2.0 * np.pi, 48)
        local = [
            (shape.radius_m * float(np.cos(a)), shape.radius_m * float(np.sin(a))) for a in turns
        ]
    return np.array([pose.apply((x, y, 0.0))[:2] for x, y in local])


def _draw_plan(axes: Axes, planned: Trajectory, *, label: bool) -> None:
    for kind, color in _LINES.items():
        motion = motion_of(replace(planned, interpolation=kind))
        places = motion.positions(np.linspace(motion.times_s[0], motion.times_s[-1], 300))
        chosen = planned.interpolation is kind
        style: dict[str, Any] = {
            "linewidth": 1.3,
            "linestyle": "-" if chosen else (0, (3, 2)),
            "zorder": 4,
        }
        axes.plot(
            places[:, 0], places[:, 1], color=color, label=_WAYS[kind] if label else None, **style
        )
    points = np.array([w.pose.position_m for w in planned.waypoints])
    axes.plot(
        points[:, 0],
        points[:, 1],
        "k.",
        markersize=6,
        zorder=5,
        label="waypoint" if label else None,
    )
    for waypoint in planned.waypoints:
        heading = waypoint.pose.apply((0.45, 0.0, 0.0))
        tip = {"arrowstyle": "->", "color": "black", "linewidth": 0.9}
        axes.annotate("", heading[:2], waypoint.pose.position_m[:2], arrowprops=tip, zorder=5)


def _mark_closest(axes: Axes, run: Run[Config]) -> None:
    for a, b, _ in _pairs(run):
        times, _, driven = apart_m(run, a, b)
        at_s, ends = float(times[driven.argmin()]), []
        for name in (a, b):
            track = run["track"][run["track"]["agent"] == name]
            ends.append([np.interp(at_s, track["t_s"], track[axis]) for axis in ("x_m", "y_m")])
        (x1, y1), (x2, y2) = ends
        text = f"closest, driven: {driven.min():.2f} m at {at_s:.1f} s"
        axes.plot(
            [x1, x2],
            [y1, y2],
            "o-",
            color="crimson",
            markersize=5,
            linewidth=1.6,
            zorder=6,
            label=text,
        )


def _draw_apart(axes: Axes, run: Run[Config]) -> dict[str, Any]:
    shown: dict[str, Any] = {}
    for a, b, needed in _pairs(run):
        times, planned, driven = apart_m(run, a, b)
        axes.plot(times, planned, color=COLORS["network"], label="planned")
        axes.plot(times, driven, color=COLORS["proxy"], label="driven")
        axes.axhline(
            needed,
            color="crimson",
            linestyle=":",
            label=f"needed: radii and margin, {needed:.2f} m",
        )
        axes.plot(times[driven.argmin()], driven.min(), "o", color="crimson", markersize=5)
        shown["closest, planned and driven (m)"] = [float(planned.min()), float(driven.min())]
    axes.margins(y=0.6)  # room for the legend
    axes.set(
        ylim=(0, None), xlabel="time (s)", ylabel="distance (m)", title="How far apart they are"
    )
    axes.legend(fontsize=8)
    return shown


def _draw_errors(axes: Axes, run: Run[Config]) -> dict[str, Any]:
    worst, ids = {}, {agent.name: agent.id for agent in scene_of(run).all_of(AgentObject)}
    for color, (agent, track) in zip(_AGENTS, run["track"].groupby("agent"), strict=False):
        axes.plot(track["t_s"], track["error_m"], color=color, label=str(agent))
        end = scene_of(run).motion(ids[str(agent)]).end_ns / 1e9
        axes.axvline(end, color=color, linestyle=":", linewidth=1.0)
        axes.axhline(allowed_m(run)[str(agent)], color=color, linestyle="--", linewidth=1.0)
        worst[str(agent)] = float(track["error_m"].max())
    axes.set(ylim=(0, 1.4 * max(allowed_m(run).values())), xlabel="time (s)", ylabel="error (m)")
    axes.set_title("Off the plan\n(dotted: its end, dashed: explained)", fontsize=10)
    axes.legend(fontsize=8, loc="upper right", ncols=2)
    return {"largest error (m)": worst}


@exp.look(
    "interpolation",
    Look(
        turn=("segment_s", "speed_m_s", "acceleration_m_s2"),
        needs=("example",),
        size=(10, 6.2),
        reference="planning_interpolation",
    ),
)
@exp.figure("planning_interpolation", size=(10, 6.2))
def draw_interpolation(figure: Figure, run: Run[Config]) -> dict[str, Any]:
    """Draw path, speed and acceleration of both interpolations, as drawn and re-timed."""
    grid = figure.add_gridspec(2, 3, width_ratios=(1.15, 1.0, 1.0))
    _draw_paths(figure.add_subplot(grid[:, 0]), run)
    tops = {}
    for row, (slow, words) in enumerate(((False, "as drawn"), (True, "re-timed to its limits"))):
        chosen = run["sample"][run["sample"]["retimed"] == slow]
        pair = [figure.add_subplot(grid[row, 1]), figure.add_subplot(grid[row, 2])]
        tops[words] = _draw_rates(pair, chosen, words, example_limits(run.config))
    title = "A spline's speed does not jump, and re-timing brings both within their limits"
    figure.suptitle(title, fontsize=11)
    ways = "one trajectory as polyline and as centripetal Catmull-Rom spline"
    note(figure, f"exact: {ways} (the paper's future work)")
    return {"highest speed (m/s) and acceleration (m/s^2)": tops}


def _draw_paths(axes: Axes, run: Run[Config]) -> None:
    for kind in Interpolation:
        chosen = run["sample"][
            (run["sample"]["interpolation"] == kind.value) & ~run["sample"]["retimed"]
        ]
        axes.plot(
            chosen["x_m"], chosen["y_m"], color=_LINES[kind], label=_WAYS[kind], linewidth=1.8
        )
    axes.plot(*np.array(EXAMPLE_M).T, "k.", markersize=8, label="waypoint")
    for number, place in enumerate(EXAMPLE_M):
        axes.annotate(str(number), place, xytext=(5, 5), textcoords="offset points", fontsize=8)
    axes.set_aspect("equal", adjustable="datalim")
    axes.set(xlabel="x (m)", ylabel="y (m)", title="Path: the same before and after")
    axes.legend(fontsize=8, loc="upper right")


def _draw_rates(pair: list[Axes], samples: Any, words: str, most: Limits) -> dict[str, list[float]]:
    tops: dict[str, list[float]] = {}
    for kind in Interpolation:
        chosen = samples[samples["interpolation"] == kind.value]
        where = "steps-post" if kind is Interpolation.POLYLINE else "default"
        color, times = _LINES[kind], chosen["t_s"]
        pair[0].plot(times, chosen["speed_m_s"], color=color, drawstyle=where)
        jumps = chosen[chosen["jump_m_s2"] > 0.0]
        if kind is Interpolation.POLYLINE:
            pair[1].vlines(jumps["t_s"], 0.0, jumps["jump_m_s2"], color=color, linewidth=2.0)
            pair[1].plot(
                jumps["t_s"], jumps["jump_m_s2"], "o", color=color, markersize=4, label="at corners"
            )
        else:
            pair[1].plot(times, chosen["acceleration_m_s2"], color=color)
        top = max(chosen["acceleration_m_s2"].max(), chosen["jump_m_s2"].max())
        tops[kind.value] = [float(chosen["speed_m_s"].max()), float(top)]
    limits = (most.speed_m_s, most.acceleration_m_s2)
    names = (("speed (m/s)", "Speed"), ("acceleration (m/s²)", "Acceleration"))
    for axes, limit, (label, name) in zip(pair, limits, names, strict=True):
        axes.axhline(limit or 0.0, color="crimson", linestyle=":", label="limit")
        axes.set(ylim=(0, 1.25 * axes.get_ylim()[1]), xlabel="time (s)", ylabel=label)
        axes.set_title(f"{name}, {words}", fontsize=10)
        axes.legend(fontsize=8, loc="upper right", ncols=2)
    return tops
