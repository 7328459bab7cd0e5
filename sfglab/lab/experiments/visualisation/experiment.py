"""Configuration, tables and parts of the experiment on the bridge to the Rerun viewer."""

from __future__ import annotations

import io
from contextlib import closing
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from sfglab.codecs import compressed_image_fields
from sfglab.lab.bench import TableRow
from sfglab.lab.browser import free_port
from sfglab.lab.checks import CheckRow, facts_row
from sfglab.lab.experiment import Actor, Experiment, Link, Profiled
from sfglab.lab.experiments.visualisation.live import (
    member,
    sink_canvas,
    time_pictures,
    try_changes,
)
from sfglab.lab.experiments.visualisation.plugin import try_package
from sfglab.lab.experiments.visualisation.points import show_clouds
from sfglab.lab.experiments.visualisation.scene import scene_moments
from sfglab.lab.testbed import held_domains
from sfglab.processes import ProcessGroup
from sfglab.view.rerunning import rerun

if TYPE_CHECKING:
    from sfglab.lab.bench import Bench

PICTURE = "picture.jpg"  #: Attachment: the first picture.
CLOUD = "cloud.npz"  #: Attachment: its points.
TOLERANCE_M = 1e-5  #: Largest distance of a point from its closed form, m.

PLUGIN = "a plug-in of another package"
DISPLAY = "a visualizer added and removed while the bridge runs"
PARAMETER = "a parameter changed at run time"
QOS = "a QoS profile changed at run time"
POINTS = "a synchronised pair back-projected as in closed form"


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
    removed={
        "moments": {"smoke": 10, "quick": 10, "paper": 10},
        "streams": {"smoke": 2, "quick": 200, "paper": 2000},
        "stopped_s": {"smoke": 0.4, "quick": 4.0, "paper": 8.0},
        "observed_s": {"smoke": 0.8, "quick": 1.5, "paper": 1.5},
    },
    actors=(
        Actor("camera", "this host", "sends a picture 30 times a second"),
        Actor("bridge", "this host", "draws what it receives"),
        Actor("observer", "this host", "sees what is subscribed to"),
        Actor("sink", "this host", "receives what is drawn, as a viewer does"),
    ),
    links=(
        Link("camera", "bridge", "pictures of 640 x 360"),
        Link("bridge", "observer", "its subscriptions", "DDS discovery"),
        Link("bridge", "sink", "what is drawn", "gRPC"),
    ),
)
exp.table("check")(CheckRow)


@exp.table("cloud")
class VisualisationCloudRow(TableRow):
    """The points of one depth image, beside their closed form."""

    stamp_ns: int  #: Stamp of the depth image.
    points: int  #: Number of points in the recording.
    expected: int  #: Number of points of the closed form.
    largest_error_m: float  #: Largest distance between a point and its closed form, m.
    wrong_colors: int  #: Points whose colour differs from the picture's.


@exp.table("time")
class VisualisationTimeRow(TableRow):
    """How long one picture took."""

    #: ``bridge``: from its arrival on the bus until the sink has it. ``bare``: from the call of Rerun.
    arm: str
    round: int  #: Number of the round.
    number: int  #: Number of the picture in its round.
    taken_ms: float  #: Time until the sink had it, ms.


@exp.part("points")
def show_points(bench: Bench[Config]) -> None:
    """Show depth as points, and keep the first cloud for the figure."""
    rerun()
    moments = scene_moments(bench.config.clouds, bench.config.seed)
    clouds = show_clouds(moments, bench.folder("points") / "clouds.rrd")
    held, largest_m = 0, 0.0
    for cloud in clouds:
        errors_m = cloud.errors_m
        row = VisualisationCloudRow(
            stamp_ns=cloud.moment.stamp_ns,
            points=len(cloud.shown),
            expected=len(cloud.expected),
            largest_error_m=float(errors_m.max()) if len(errors_m) else float("inf"),
            wrong_colors=cloud.wrong_colors,
        )
        bench.write(row)
        is_whole = row.points == row.expected > 0 and row.wrong_colors == 0
        held += is_whole and row.largest_error_m <= TOLERANCE_M
        largest_m = max(largest_m, row.largest_error_m)
    seen = f"{sum(len(cloud.shown) for cloud in clouds)} points, largest error {1e6 * largest_m:.2f} um"
    bench.write(CheckRow(check=POINTS, checked=len(clouds), held=held, example=seen))
    bench.attach(PICTURE, compressed_image_fields(moments[0].bgr, "jpeg").data, "image/jpeg")
    packed, first = io.BytesIO(), clouds[0]
    points, errors = first.shown.astype(np.float32), first.errors_m.astype(np.float32)
    np.savez_compressed(packed, points=points, colors=first.colors, errors_m=errors)
    bench.attach(CLOUD, packed.getvalue())


@exp.part("plug-in")
def show_plugin(bench: Bench[Config]) -> None:
    """Show a message with a visualizer of another package."""
    bench.write(facts_row(PLUGIN, try_package(bench.folder("plugin"))))


@exp.part("while it runs", total=2)
async def watch_bridge(bench: Bench[Config]) -> None:
    """Change a display while a camera sends, and time pictures on their way to a sink."""
    port = free_port()
    (domain_id,) = bench.stack.enter_context(held_domains())
    members = [member("camera", domain_id=domain_id), member("sink", port=port)]
    async with ProcessGroup(members):
        changes = await try_changes(domain_id)
        bench.write(facts_row(DISPLAY, changes["display"]))
        bench.write(facts_row(PARAMETER, changes["parameter"]))
        bench.write(facts_row(QOS, changes["qos"]))
        bench.advance("changes")
        count = {"rounds": bench.config.rounds, "pictures": bench.config.pictures}
        with closing(sink_canvas(port)) as canvas:
            bench.write_all("time", await time_pictures(canvas, domain_id, **count))
        bench.advance("delay")
