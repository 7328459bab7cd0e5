"""Run the planning experiment into one log: checks, faults, the drawn example, and agents on their way."""

from __future__ import annotations

import asyncio
from dataclasses import asdict, replace
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from sfglab.lab.experiments.planning.cases import checked
from sfglab.lab.experiments.planning.driving import Driven, drive_scene, try_goals
from sfglab.lab.experiments.planning.editing import EDITING, fault_rows, survives_kills
from sfglab.lab.experiments.planning.example import example_rows
from sfglab.lab.experiments.planning.exchange import EXCHANGE
from sfglab.lab.experiments.planning.geometry import GEOMETRY, uniform_has_no_loop
from sfglab.lab.paths import find_project
from sfglab.lab.progress import progress_bar
from sfglab.record import LogWriter, run_context
from sfglab.spatial.scene import load_scene, scene_text
from sfglab.spatial.trajectory import path_from_trajectory, resampled

if TYPE_CHECKING:
    from collections.abc import Iterable
    from pathlib import Path

    from sfglab.lab.experiments.planning.config import Config
    from sfglab.lab.experiments.planning.rows import PlanningGoalRow
    from sfglab.spatial.scene import Scene


_NS_PER_S = 1_000_000_000
_PATH_STEP_NS = 200_000_000
_CONTRAST = "with evenly spaced knots instead, there would be no loop"
_SIMULATED_LIMIT_S = 3600.0


async def run(config: Config, path: Path) -> Path:
    """Run the experiment.

    Args:
        config: What to run.
        path: The log.

    Returns:
        The log's path.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    scene = load_scene(find_project().data / config.scene_file)
    with LogWriter(path) as log, progress_bar(6, "planning") as advance:
        log.write_metadata("run", run_context())
        log.write_metadata("config", {"experiment": "planning", **asdict(config)})
        log.write_metadata("scene", {"text": scene_text(scene)})
        _write(log, "geometry", checked(GEOMETRY, config.cases, config.seed))
        _write(log, "contrast", checked([(_CONTRAST, uniform_has_no_loop)], 10 * config.cases, config.seed))
        advance("trajectories")
        _write(log, "exchange", checked(EXCHANGE, config.cases, config.seed))
        advance("exchange")
        _write(log, "editing", checked(EDITING, config.edit_cases, config.seed))
        _write(log, "fault", fault_rows())
        advance("edits and faults")
        _write(log, "disk", [survives_kills(np.random.default_rng(config.seed), config.kills)])
        advance("killed writers")
        _write(log, "sample", example_rows())
        driven, goals = await _executed(config, scene)
        advance("agents on their way")
        _write(log, "goal", [*driven.goals, *goals])
        _write_driven(log, driven)
        advance("log")
    return path


async def _executed(config: Config, scene: Scene) -> tuple[Driven, list[PlanningGoalRow]]:
    """Drive over DDS; or on the simulated bus, whose loop of its own needs a thread of its own."""
    if config.live:
        from sfglab.bus import Node

        node = partial(Node, domain_id=config.domain, interface="lo", lease_s=1.0)
        return await drive_scene(node, scene), await try_goals(node)
    return await asyncio.to_thread(_simulated, config.seed, scene)


def _simulated(seed: int, scene: Scene) -> tuple[Driven, list[PlanningGoalRow]]:
    from sfglab.bus.sim import World, run_simulated

    async def main(world: World) -> tuple[Driven, list[PlanningGoalRow]]:
        def node(name: str) -> Any:
            return world.node(name, host=name)

        return await drive_scene(node, scene), await try_goals(node)

    return run_simulated(main, seed=seed, limit_s=_SIMULATED_LIMIT_S)


def _write(log: LogWriter, table: str, rows: Iterable[Any]) -> None:
    for place, row in enumerate(rows):
        log.write_row(table, row, log_time_ns=place)


def _write_driven(log: LogWriter, driven: Driven) -> None:
    """Write tracks as rows and as messages, and what was planned as paths, from the scene's time 0 on."""
    for row in driven.tracks:
        log.write_row("track", row, log_time_ns=round(row.t_s * _NS_PER_S))
    for order in driven.orders:
        fine = replace(order, trajectory=resampled(order.trajectory, _PATH_STEP_NS))
        message = path_from_trajectory(fine.trajectory, frame_id=order.frame_id, start_ns=order.start_ns)
        log.write(f"/global/{order.agent}/path", message, log_time_ns=0)
    for topic, stamp_ns, message in driven.poses:
        log.write(topic, message, log_time_ns=stamp_ns - driven.start_ns)
