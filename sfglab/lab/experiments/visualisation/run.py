"""Run the visualisation experiment into one log."""

from __future__ import annotations

import io
import time
from dataclasses import asdict
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

import numpy as np

from sfglab.codecs import compressed_image_fields
from sfglab.fleet.fleet_file import load_fleet
from sfglab.lab.experiments.visualisation.handling import check_handling
from sfglab.lab.experiments.visualisation.matching import check_clouds, check_matching, show_clouds
from sfglab.lab.experiments.visualisation.moments import scene_moments
from sfglab.lab.experiments.visualisation.plugins import check_plugins
from sfglab.lab.experiments.visualisation.scene import make_parts
from sfglab.lab.experiments.visualisation.showing import (
    check_fleet,
    check_sources,
    check_visualizers,
    process,
    show_live,
    show_log,
    write_scene,
)
from sfglab.lab.experiments.visualisation.timing import sink_process, time_pictures, watch_memory
from sfglab.lab.paths import find_project
from sfglab.lab.progress import progress_bar
from sfglab.lab.testbed import held_domains
from sfglab.record import LogWriter, run_context
from sfglab.view.rerunning import rerun

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from sfglab.lab.experiments.visualisation.config import Config
    from sfglab.lab.experiments.visualisation.matching import Cloud
    from sfglab.lab.experiments.visualisation.moments import Moment


FLEET_FILE = "fleets/lab.yaml"
"""Whose layout is checked, in the data folder."""

PICTURE, CLOUD = "picture.jpg", "cloud.npz"
"""Attachments: the first picture, and its points."""

_STEPS = 6
_READY_S = 15.0


async def run(config: Config, path: Path) -> Path:
    """Run the experiment.

    Args:
        config: What to run.
        path: The log.

    Returns:
        The log's path.

    Raises:
        MissingExtraError: Rerun is not installed.
        ProcessFailedError: A process of the experiment failed; what was measured before is in the log.
    """
    rerun()
    path.parent.mkdir(parents=True, exist_ok=True)
    with (
        held_domains() as (domain_id,),
        TemporaryDirectory(prefix="sfglab-visualisation-") as folder,
        LogWriter(path) as log,
        progress_bar(_STEPS, "visualisation") as advance,
    ):
        log.write_metadata("run", run_context())
        log.write_metadata("config", {"experiment": "visualisation", **asdict(config)})
        moments = scene_moments(max(config.moments, config.clouds), config.seed)
        await _scene(moments[: config.moments], Path(folder), domain_id, log)
        advance("scene")
        _points(moments[: config.clouds], Path(folder), log)
        advance("points")
        _write(log, "check", [check_plugins(_new(Path(folder) / "plugin"))])
        _write(log, "check", check_matching(config.streams, config.seed))
        advance("plugins and synchronisation")
        await _live(config, domain_id, log, advance)
    return path


def _new(folder: Path) -> Path:
    folder.mkdir()
    return folder


def _write(log: LogWriter, table: str, rows: Iterable[Any]) -> None:
    for row in rows:
        log.write_row(table, row, log_time_ns=time.time_ns())


async def _scene(moments: list[Moment], folder: Path, domain_id: int, log: LogWriter) -> None:
    """Show everything that a fleet can say, from a log and from the bus."""
    parts = make_parts(moments)
    fleet = find_project().data / FLEET_FILE
    scene, recorded = folder / "scene.mcap", folder / "log.rrd"
    write_scene(parts, scene)
    logged = show_log(scene, recorded, fleet)
    _write(log, "check", check_visualizers(parts, logged))
    _write(log, "check", check_fleet(load_fleet(fleet), recorded))
    live = await show_live(parts, scene, folder / "live.rrd", domain_id)
    _write(log, "check", check_sources(parts, logged, live))


def _points(moments: list[Moment], folder: Path, log: LogWriter) -> None:
    """Show depth as points, and keep the first cloud for the figure."""
    clouds = show_clouds(moments, folder / "clouds.rrd")
    rows = [cloud.row for cloud in clouds]
    _write(log, "cloud", rows)
    _write(log, "check", [check_clouds(rows)])
    bgr = np.ascontiguousarray(clouds[0].moment.rgb[..., ::-1])
    log.attach(PICTURE, compressed_image_fields(bgr, "jpeg").data, "image/jpeg")
    log.attach(CLOUD, _packed(clouds[0]), "application/octet-stream")


def _packed(cloud: Cloud) -> bytes:
    buffer = io.BytesIO()
    points, errors = cloud.shown.astype(np.float32), cloud.errors_m.astype(np.float32)
    np.savez_compressed(buffer, points=points, colors=cloud.colors, errors_m=errors)
    return buffer.getvalue()


async def _live(config: Config, domain_id: int, log: LogWriter, advance: Callable[[str], None]) -> None:
    """Everything that needs time to pass: changes at run time, latency, and a sink that stands still."""
    async with process("camera", str(domain_id)) as camera, sink_process() as (canvas, sink_pid):
        await camera.expect("ready", timeout_s=_READY_S)
        _write(log, "check", await check_handling(domain_id, observed_s=config.observed_s))
        advance("run time")
        times = await time_pictures(canvas, domain_id, rounds=config.rounds, pictures=config.pictures)
        _write(log, "time", times)
        advance("latency")
        memory = await watch_memory(canvas, sink_pid, domain_id, stopped_s=config.stopped_s)
        _write(log, "memory", memory)
        advance("memory")
