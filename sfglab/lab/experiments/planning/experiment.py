"""Runs of planning: the checks, the drawn example, and a scene's agents on their way over the action."""

from __future__ import annotations

import asyncio
from dataclasses import dataclass, replace
from functools import partial
from itertools import product
from typing import TYPE_CHECKING, Any

import numpy as np

from sfglab.bus import Node
from sfglab.bus.sim import World, run_simulated
from sfglab.fields import between
from sfglab.lab.checks import CheckRow, editing, exchange, trajectories
from sfglab.lab.experiment import Actor, Experiment, Link, Profiled
from sfglab.lab.experiments.planning.driving import Driven, MakeNode, drive_scene, try_goals
from sfglab.lab.paths import find_project
from sfglab.spatial import Pose
from sfglab.spatial.scene.files import load_scene, scene_text
from sfglab.spatial.trajectory.exchange import path_from_trajectory
from sfglab.spatial.trajectory.limits import Limits, Quantity, peaks, retimed
from sfglab.spatial.trajectory.motion import resampled, sample
from sfglab.spatial.trajectory.path import Interpolation, Trajectory
from sfglab.units import NS_PER_S

if TYPE_CHECKING:
    from collections.abc import Iterator

    from sfglab.lab.bench import Bench
    from sfglab.spatial.scene.tree import Scene

EXAMPLE_M = ((0.0, 0.0), (1.2, 0.3), (1.5, 1.5), (3.0, 1.5), (3.3, 1.3), (5.0, 0.0))
"""Where the waypoints lie; some far from each other and some close."""
_SAMPLES = 160
_PATH_STEP_NS = 200_000_000
_SIMULATED_LIMIT_S = 3600.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Config(Profiled):
    """The whole run."""

    cases: int = 100  #: Random cases of each property of trajectories and exchange.
    edit_cases: int = 40  #: Random sequences of edits of each property of editing.
    kills: int = 4  #: Writers of a file that are killed.
    #: Whether the action runs over DDS, on the loopback interface; else on the simulated bus.
    live: bool = True
    domain: int = 57  #: Which DDS domain.
    #: The scene whose agents are sent along, in the data folder.
    scene_file: str = "scenes/hall.yaml"
    #: From one waypoint of the example to the next, as drawn.
    segment_s: float = between(1.0, 0.3, 4.0)
    #: Highest speed that the example is re-timed to [m/s].
    speed_m_s: float = between(1.0, 0.2, 4.0)
    #: Highest acceleration that it is re-timed to [m/s²].
    acceleration_m_s2: float = between(1.0, 0.2, 8.0)
    seed: int = 0  #: Of all cases.


exp = Experiment(
    "planning",
    Config,
    where="A 4.5",
    smoke={"cases": 8, "edit_cases": 4, "kills": 1, "live": False},
    paper={"cases": 2000, "edit_cases": 500, "kills": 30},
    actors=(
        Actor("planner", "station", "sends every agent its trajectory"),
        Actor("agent", "robot", "drives along it", count="as the scene has"),
        Actor("viewer", "station", "listens to poses"),
    ),
    links=(
        Link("planner", "agent", "goals, cancels"),
        Link("agent", "planner", "feedback, results"),
        Link("agent", "viewer", "poses"),
    ),
)
exp.table("geometry", "contrast", "exchange", "editing", "disk")(CheckRow)


@exp.table("fault")
class PlanningFaultRow:
    """One kind of broken file."""

    fault: str  #: What is broken.
    said: str  #: The error.
    names_the_line: bool  #: Whether it begins with file and line.
    one_line: bool  #: Whether it is one sentence.
    file_kept: bool  #: Whether the file is as it was.
    scene_kept: bool  #: Whether the editor still has the scene that it had.


@exp.table("goal")
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


@exp.table("track")
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


@exp.table("sample")
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


@exp.part("trajectories", timed=False)
def check_trajectories(bench: Bench[Config]) -> None:
    """Check trajectories and their exchange; the contrast shows what the check for loops can see."""
    config = bench.config
    bench.write_all("geometry", trajectories.checks.rows(config.cases, config.seed))
    bench.write_all("contrast", trajectories.contrast.rows(10 * config.cases, config.seed))
    bench.write_all("exchange", exchange.checks.rows(config.cases, config.seed))


@exp.part("edits and faults", timed=False)
def check_edits(bench: Bench[Config]) -> None:
    """Check edits, broken files, and files whose writers are killed."""
    config = bench.config
    bench.write_all("editing", editing.checks.rows(config.edit_cases, config.seed))
    bench.write_all("fault", editing.faults())
    bench.write("disk", editing.survives_kills(np.random.default_rng(config.seed), config.kills))


@exp.part("example", total=0, timed=False)
def draw_example(bench: Bench[Config]) -> None:
    """Write the example's moments in every way."""
    bench.write_all("sample", example_rows(bench.config))


@exp.part("agents on their way", timed=False)
async def drive(bench: Bench[Config]) -> None:
    """Drive the scene and try all ways in which a goal can end; write tracks as rows and as messages."""
    config = bench.config
    scene = load_scene(find_project().data / config.scene_file)
    bench.metadata("scene", {"text": scene_text(scene)})
    driven, goals = await _executed(config, scene)
    bench.write_all("goal", [*driven.goals, *goals])
    for row in driven.tracks:
        bench.write("track", row, at_ns=round(row["t_s"] * NS_PER_S))
    # What was planned, as paths, from the scene's time 0 on.
    for order in driven.orders:
        fine = replace(order, trajectory=resampled(order.trajectory, _PATH_STEP_NS))
        message = path_from_trajectory(
            fine.trajectory, frame_id=order.frame_id, start_ns=order.start_ns
        )
        bench.log.write(f"/global/{order.agent}/path", message, log_time_ns=0)
    for topic, stamp_ns, message in driven.poses:
        bench.log.write(topic, message, log_time_ns=stamp_ns - driven.start_ns)


async def _executed(config: Config, scene: Scene) -> tuple[Driven, list[dict[str, Any]]]:
    """Drive over DDS; or on the simulated bus, whose loop of its own needs a thread of its own."""

    async def with_nodes(node: MakeNode) -> tuple[Driven, list[dict[str, Any]]]:
        return await drive_scene(node, scene), await try_goals(node)

    async def main(world: World) -> tuple[Driven, list[dict[str, Any]]]:
        return await with_nodes(lambda name: world.node(name, host=name))

    if config.live:
        return await with_nodes(partial(Node, domain_id=config.domain, interface="lo", lease_s=1.0))
    return await asyncio.to_thread(
        run_simulated, main, seed=config.seed, limit_s=_SIMULATED_LIMIT_S
    )


def example_limits(config: Config) -> Limits:
    """Return what the example is re-timed to."""
    return Limits(speed_m_s=config.speed_m_s, acceleration_m_s2=config.acceleration_m_s2)


def example_rows(config: Config) -> Iterator[dict[str, Any]]:
    """Yield the example's moments, by interpolation and timing."""
    segment_ns = round(config.segment_s * NS_PER_S)
    drawn = Trajectory.of(
        (i * segment_ns, Pose.at((x, y, 0.0))) for i, (x, y) in enumerate(EXAMPLE_M)
    )
    for kind, slow in product(Interpolation, (False, True)):
        path = replace(drawn, interpolation=kind)
        yield from _rows(retimed(path, example_limits(config)) if slow else path, retimed_=slow)


def _rows(path: Trajectory, *, retimed_: bool) -> Iterator[dict[str, Any]]:
    corners = [w.time_ns / NS_PER_S for w in path.waypoints]
    times = np.unique(np.concatenate([np.linspace(corners[0], corners[-1], _SAMPLES), corners]))
    found = sample(path, times)
    top = peaks(path, Quantity.ACCELERATION)
    jumps = dict(zip(top.times_s.tolist(), top.values.tolist(), strict=True))
    polyline = path.interpolation is Interpolation.POLYLINE
    for i, time_s in enumerate(times.tolist()):
        x, y, _ = found.positions_m[i].tolist()
        yield {
            "interpolation": path.interpolation.value,
            "retimed": retimed_,
            "t_s": time_s,
            "x_m": x,
            "y_m": y,
            "speed_m_s": float(found.speeds_m_s[i]),
            "acceleration_m_s2": float(np.linalg.norm(found.accelerations_m_s2[i])),
            "waypoint": time_s in corners,
            "jump_m_s2": jumps.get(time_s, 0.0) if polyline and time_s in corners else 0.0,
        }
