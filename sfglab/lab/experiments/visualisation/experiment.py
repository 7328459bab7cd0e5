"""The experiment: a scene shown, points, plugins, synchronisation, and the bridge while it runs."""

from __future__ import annotations

import io
from contextlib import closing
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING

import numpy as np

from sfglab.codecs import compressed_image_fields
from sfglab.fleet.fleet_file import load_fleet
from sfglab.lab.browser import free_port
from sfglab.lab.checks import CheckRow, handling, recordings, synchronisation
from sfglab.lab.checks.fleet_scene import make_parts, scene_moments
from sfglab.lab.experiment import Actor, Experiment, Link, Profiled
from sfglab.lab.experiments.visualisation.stage import (
    member,
    processes,
    show_live,
    time_pictures,
    watch_memory,
    write_scene,
)
from sfglab.lab.paths import find_project
from sfglab.lab.testbed import held_domains
from sfglab.view.app import ViewOptions, view_log
from sfglab.view.rerunning import open_canvas, rerun

if TYPE_CHECKING:
    from sfglab.lab.bench import Bench


FLEET_FILE = "fleets/lab.yaml"  #: Whose layout is checked, in the data folder.
PICTURE, CLOUD = "picture.jpg", "cloud.npz"  #: Attachments: the first picture, and its points.


@dataclass(frozen=True, slots=True, kw_only=True)
class Config(Profiled):
    """The whole run."""

    moments: int = 10  #: How often every topic of the scene speaks.
    clouds: int = 10  #: Depth images of 640 x 360 whose points are compared.
    streams: int = 200  #: Random streams that are synchronised.
    rounds: int = 4  #: How often both arms of the latency are timed, in turn.
    pictures: int = 60  #: Pictures of an arm in one round.
    stopped_s: float = 4.0  #: How long the slow sink stands still.
    observed_s: float = 1.5  #: How long pictures are counted under a rate budget.
    seed: int = 0  #: Seed of the pictures and of the streams.


exp = Experiment(
    "visualisation",
    Config,
    where="A 4.5",
    smoke={"clouds": 1, "streams": 2, "rounds": 1, "pictures": 5, "stopped_s": 0.4, "observed_s": 0.8},
    paper={"clouds": 60, "streams": 2000, "rounds": 10, "pictures": 150, "stopped_s": 8.0},
    actors=(
        Actor("scene", "this host", "sends a fleet's messages, a moment an order"),
        Actor("camera", "this host", "sends a picture 30 times a second"),
        Actor("bridge", "this host", "draws what it receives"),
        Actor("observer", "this host", "sees what is subscribed to"),
        Actor("sink", "this host", "takes what is drawn, as a viewer does"),
    ),
    links=(
        Link("scene", "bridge", "everything that a visualizer shows"),
        Link("camera", "bridge", "pictures of 640 x 360"),
        Link("bridge", "observer", "its subscriptions", "DDS discovery"),
        Link("bridge", "sink", "what is drawn", "gRPC"),
    ),
)


@exp.table("check")
class VisualisationCheckRow:
    """How often one property was checked and how often it held."""

    group: str  #: What it belongs to, such as ``visualizers`` or ``synchronisation``.
    check: str  #: The property.
    checked: int  #: Cases it was checked on.
    held: int  #: Cases in which it held.
    example: str  #: A case in which it did not; else what was seen.


@exp.table("cloud")
class VisualisationCloudRow:
    """The points of one depth image, beside an independent back-projection."""

    stamp_ns: int  #: Of the depth image.
    points: int  #: How many the recording holds.
    expected: int  #: How many the reference has.
    largest_error_m: float  #: Largest distance between a point and its reference.
    wrong_colors: int  #: Points whose colour differs from the reference's.


@exp.table("time")
class VisualisationTimeRow:
    """How long one picture took."""

    #: ``bridge``, from its arrival on the bus until the sink has it; ``bare``, from the call of Rerun.
    arm: str
    round: int  #: Which round.
    number: int  #: Of the picture in its round.
    taken_ms: float  #: Time until the sink had it.


@exp.table("memory")
class VisualisationMemoryRow:
    """A moment with a sink that stands still for a while."""

    at_s: float  #: Time since the beginning.
    stopped: bool  #: Whether the sink stands still.
    queued_bytes: int  #: Messages that wait for their turn, and drawn ones that the sink has not taken.
    resident_bytes: int  #: Memory of the bridge's process.
    received: int  #: Pictures that arrived up to now.
    shown: int  #: Pictures drawn up to now.
    dropped: int  #: Pictures passed over up to now.


def _write(bench: Bench[Config], group: str, *rows: CheckRow) -> None:
    bench.write_all("check", ({"group": group, **asdict(row)} for row in rows))


@exp.part("scene")
async def show_scene(bench: Bench[Config]) -> None:
    """Show everything that a fleet can say, from a log and from the bus."""
    rerun()
    folder, config = bench.folder("scene"), bench.config
    parts = make_parts(scene_moments(config.moments, config.seed))
    fleet = find_project().data / FLEET_FILE
    scene, recorded = folder / "scene.mcap", folder / "log.rrd"
    write_scene(parts, scene)
    view_log(scene, ViewOptions(to=(str(recorded),), fleet=fleet))
    logged = recordings.read_recording(recorded)
    _write(bench, "visualizers", *recordings.check_visualizers(parts, logged))
    _write(bench, "fleet", *recordings.check_fleet(load_fleet(fleet), recorded))
    with held_domains() as (domain_id,):
        live = await show_live(parts, scene, folder / "live.rrd", domain_id)
    _write(bench, "sources", *recordings.check_sources(parts, logged, live))


@exp.part("points")
def show_points(bench: Bench[Config]) -> None:
    """Show depth as points, and keep the first cloud for the figure."""
    moments = scene_moments(bench.config.clouds, bench.config.seed)
    clouds = synchronisation.show_clouds(moments, bench.folder("points") / "clouds.rrd")
    bench.write_all("cloud", (cloud.row for cloud in clouds))
    _write(bench, "synchronisation", synchronisation.check_clouds(clouds))
    bench.attach(PICTURE, compressed_image_fields(moments[0].bgr, "jpeg").data, "image/jpeg")
    packed, first = io.BytesIO(), clouds[0]
    points, errors = first.shown.astype(np.float32), first.errors_m.astype(np.float32)
    np.savez_compressed(packed, points=points, colors=first.colors, errors_m=errors)
    bench.attach(CLOUD, packed.getvalue())


@exp.part("plugins and synchronisation")
def check_library(bench: Bench[Config]) -> None:
    """Check somebody else's visualizers, and synchronisation on random streams."""
    config = bench.config
    _write(bench, "plugins", handling.check_plugins(bench.folder("plugin")))
    _write(bench, "synchronisation", *synchronisation.checks.rows(config.streams, config.seed))


@exp.part("while it runs", total=3)
async def watch_bridge(bench: Bench[Config]) -> None:
    """Everything that needs time to pass: changes at run time, latency, and a sink that stands still."""
    config, port = bench.config, free_port()
    (domain_id,) = bench.stack.enter_context(held_domains())
    camera, sink = member("camera", domain_id=domain_id), member("sink", port=port)
    async with processes(camera, sink) as group:
        with closing(open_canvas([f"rerun+http://127.0.0.1:{port}/proxy"])) as canvas:
            rows = await handling.check_handling(domain_id, observed_s=config.observed_s)
            _write(bench, "run time", *rows)
            bench.advance("run time")
            pictures = {"rounds": config.rounds, "pictures": config.pictures}
            bench.write_all("time", await time_pictures(canvas, domain_id, **pictures))
            bench.advance("latency")
            pid, stopped_s = group["sink"].pid, config.stopped_s
            bench.write_all("memory", await watch_memory(canvas, pid, domain_id, stopped_s=stopped_s))
            bench.advance("memory")
