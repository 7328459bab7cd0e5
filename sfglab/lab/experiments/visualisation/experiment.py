"""Configuration, tables and parts of the experiment on the bridge to the Rerun viewer."""

from __future__ import annotations

import io
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from sfglab.codecs import compressed_image_fields
from sfglab.lab.bench import TableRow
from sfglab.lab.checks import CheckRow, facts_row
from sfglab.lab.experiment import Actor, Experiment, Link, Profiled
from sfglab.lab.experiments.visualisation.live import camera_and_sink, time_pictures, try_changes
from sfglab.lab.experiments.visualisation.plugin import PLUGIN, try_package
from sfglab.lab.experiments.visualisation.points import (
    NO_POINTS,
    POINTS,
    TOLERANCE_M,
    VisualisationCloudRow,
    compared,
    scene_moments,
    shown_points,
)
from sfglab.lab.testbed import free_port, held_domains
from sfglab.processes import ProcessGroup
from sfglab.view.rerunning import rerun

if TYPE_CHECKING:
    from sfglab.lab.bench import Bench

PICTURE = "picture.jpg"  #: Name of the attachment with the first image.
CLOUD = "cloud.npz"  #: Name of the attachment with the points of the first image.


@dataclass(frozen=True, slots=True, kw_only=True)
class Config(Profiled):
    """Number of depth images and of timed pictures."""

    clouds: int = 10  #: Depth images of 640 x 360 whose points are compared.
    rounds: int = 4  #: Number of rounds; each times both arms.
    pictures: int = 60  #: Pictures of an arm in one round.
    seed: int = 0  #: Seed of the pictures.


exp = Experiment(
    "visualisation",
    Config,
    where="A 4.5",
    smoke={"clouds": 1, "rounds": 1, "pictures": 5},
    paper={"clouds": 60, "rounds": 10, "pictures": 150},
    actors=(
        Actor("camera", "this host", "sends an image 30 times per second"),
        Actor("bridge", "this host", "logs received images to Rerun; baseline: logs without DDS"),
        Actor("observer", "this host", "records the bridge's subscriptions"),
        Actor("sink", "this host", "receives the logged images, in place of a viewer"),
    ),
    links=(
        Link("camera", "bridge", "images of 640 x 360"),
        Link("bridge", "observer", "its subscriptions", "DDS discovery"),
        Link("bridge", "sink", "logged images", "gRPC"),
    ),
)
exp.table("check")(CheckRow)
exp.table("cloud")(VisualisationCloudRow)


@exp.table("time")
class VisualisationTimeRow(TableRow):
    """Time that one image took."""

    #: ``bridge``: from its arrival on the bus until the sink has it. ``bare``: from the call of Rerun.
    arm: str
    taken_ms: float  #: Time until the sink had received the image, ms.


@exp.part("points")
def show_points(bench: Bench[Config]) -> None:
    """Show depth images as points, and attach the first image and its points to the log for the figure."""
    rerun()
    moments = list(scene_moments(bench.config.clouds, bench.config.seed))
    shown = shown_points(moments)
    rows = [compared(moment, shown.get(moment.stamp_ns, NO_POINTS)) for moment in moments]
    bench.write_all("cloud", rows)
    for row in rows:
        seen = f"{row.points} points, largest error {1e6 * row.largest_error_m:.2f} um"
        bench.cases[POINTS].append((seen, row.largest_error_m < TOLERANCE_M))
    bgr = np.ascontiguousarray(moments[0].rgb[..., ::-1])
    bench.attach(PICTURE, compressed_image_fields(bgr).data, "image/jpeg")
    points, colors = shown.get(moments[0].stamp_ns, NO_POINTS)
    packed = io.BytesIO()
    np.savez_compressed(packed, points=points.astype(np.float32), colors=colors)
    bench.attach(CLOUD, packed.getvalue())


@exp.part("plug-in")
def show_plugin(bench: Bench[Config]) -> None:
    """Show a message with a visualizer of another package."""
    bench.write(facts_row(PLUGIN, try_package(bench.folder("plugin"))))


@exp.part("while it runs", total=2)
async def watch_bridge(bench: Bench[Config]) -> None:
    """Change a display while a camera publishes, and measure the time of images to a sink."""
    port = free_port()
    (domain_id,) = bench.stack.enter_context(held_domains())
    async with ProcessGroup([camera_and_sink(domain_id, port)]):
        for fact, held in (await try_changes(domain_id)).items():
            bench.write(facts_row(fact, held))
        bench.advance("changes")
        count = {"rounds": bench.config.rounds, "pictures": bench.config.pictures}
        for arm, taken_ms in (await time_pictures(port, domain_id, **count)).items():
            for ms in taken_ms:
                bench.write(VisualisationTimeRow(arm=arm, taken_ms=ms))
        bench.advance("delay")
