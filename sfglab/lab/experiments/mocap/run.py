"""Run the mocap experiment into one log: trees, faults, offsets, and the live rounds."""

from __future__ import annotations

import time
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

import numpy as np

from sfglab.lab.experiments.mocap.calibration import offset_rows
from sfglab.lab.experiments.mocap.faults import fault_rows
from sfglab.lab.experiments.mocap.live import HOSTS, LiveStage, live_rows, live_tree
from sfglab.lab.experiments.mocap.robot import OBJECT
from sfglab.lab.experiments.mocap.trees import edge_rows, figure_6, tree_checks
from sfglab.lab.progress import progress_bar
from sfglab.lab.testbed import Testbed
from sfglab.record import LogWriter, run_context
from sfglab.spatial import Pose
from sfglab.spatial.mocap import Capture, mocap_trees

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator
    from pathlib import Path

    from sfglab.lab.experiments.mocap.config import Config


async def run(config: Config, path: Path, *, separate: bool | None = None) -> Path:
    """Run the experiment.

    Args:
        config: What to run.
        path: The log.
        separate: False insists on one host; None takes separate hosts where the machine can.

    Returns:
        The log's path.

    Raises:
        ProcessFailedError: A process of the experiment failed; what was measured before is in the log.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    with (
        Testbed(*HOSTS.values(), separate=separate) as testbed,
        LogWriter(path) as log,
        progress_bar(3 + len(config.rounds), "mocap") as advance,
    ):
        log.write_metadata("run", run_context())
        log.write_metadata("config", {"experiment": "mocap", **asdict(config)})
        log.write_metadata("hosts", {"description": testbed.description, "separate": testbed.separate})
        _write(log, _trees(config))
        advance("trees")
        confusion, checks = fault_rows(config)
        _write(log, [*(("confusion", row) for row in confusion), *(("check", check) for check in checks)])
        advance("faults")
        _write(log, (("offset", row) for row in offset_rows(config)))
        advance("offsets")
        async with LiveStage(config, testbed) as stage:
            for name in config.rounds:
                start_ns, reports = await stage.play(name)
                _write(log, live_rows(name, config, start_ns, reports))
                if name == config.rounds[0]:
                    for topic, message, time_ns in live_tree(start_ns, reports):
                        log.write(topic, message, log_time_ns=time_ns)
                advance(name)
    return path


def _trees(config: Config) -> Iterator[tuple[str, Any]]:
    robot, mapping = figure_6()
    captures = [
        Capture(number=i, capture_ns=t, receipt_ns=t, sights={OBJECT: Pose()})
        for i, t in enumerate((10_000_000, 20_000_000))
    ]
    yield from (("edge", row) for row in edge_rows("figure 6", mocap_trees(robot, mapping, captures)))
    rng = np.random.default_rng([config.seed, 0])
    yield from (("check", check) for check in tree_checks(config.trees, rng))


def _write(log: LogWriter, rows: Iterable[tuple[str, Any]]) -> None:
    for table, row in rows:
        log.write_row(table, row, log_time_ns=time.time_ns())
