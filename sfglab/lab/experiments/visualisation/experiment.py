"""The experiment: a scene shown, points, plugins, synchronisation, and the bridge while it runs.

The claim A-VIZ is the share of checks that hold. The figures: what the bridge adds, what waits, and points.
"""

from __future__ import annotations

import io
from contextlib import closing
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from sfglab.codecs import compressed_image_fields
from sfglab.fleet.fleet_file import load_fleet
from sfglab.lab.browser import free_port
from sfglab.lab.checks import (
    CheckRow,
    facts_row,
    handling,
    lowest_share,
    recordings,
    synchronisation,
)
from sfglab.lab.checks.fleet_scene import make_parts, scene_moments
from sfglab.lab.claims import Finding, How
from sfglab.lab.experiment import Actor, Experiment, Link, Profiled
from sfglab.lab.experiments.visualisation.stage import (
    ADDED_MS,
    BOUND_BYTES,
    member,
    processes,
    show_live,
    time_pictures,
    watch_memory,
    write_scene,
)
from sfglab.lab.figures import COLORS, PAPER_STYLE, note
from sfglab.lab.paths import find_project
from sfglab.lab.runs import Run, derived
from sfglab.lab.stats import Estimate, bootstrap
from sfglab.lab.testbed import held_domains
from sfglab.view.app import ViewOptions, view_log
from sfglab.view.rerunning import open_canvas, rerun

if TYPE_CHECKING:
    from collections.abc import Sequence

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from numpy.typing import NDArray

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
    smoke={
        "clouds": 1,
        "streams": 2,
        "rounds": 1,
        "pictures": 5,
        "stopped_s": 0.4,
        "observed_s": 0.8,
    },
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
class VisualisationCheckRow(CheckRow):
    """How often one property was checked and how often it held."""

    group: str  #: What it belongs to, such as ``visualizers`` or ``synchronisation``.
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
    #: Messages that wait for their turn, and drawn ones that the sink has not taken.
    queued_bytes: int
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
            _write(
                bench,
                "run time",
                *await handling.check_handling(domain_id, observed_s=config.observed_s),
            )
            bench.advance("run time")
            pictures = {"rounds": config.rounds, "pictures": config.pictures}
            bench.write_all("time", await time_pictures(canvas, domain_id, **pictures))
            bench.advance("latency")
            pid, stopped_s = group["sink"].pid, config.stopped_s
            bench.write_all(
                "memory", await watch_memory(canvas, pid, domain_id, stopped_s=stopped_s)
            )
            bench.advance("memory")


MIB = 2**20


@derived
def checks(run: Run[Config]) -> pd.DataFrame:
    """Return every check: those made while it ran, and that of what was measured."""
    measured = {"memory": check_memory(run["memory"]), "latency": check_latency(run)}
    rows = pd.DataFrame([{"group": group, **asdict(row)} for group, row in measured.items()])
    return pd.concat([run["check"], rows], ignore_index=True)


def check_latency(run: Run[Config]) -> CheckRow:
    """Return whether the bridge adds no more than is asked, at the median and in the tail."""
    table = latency_table(run)
    arms = (table.loc[arm, ["median", "99 %"]].to_numpy(float) for arm in ("bridge", "bare"))
    added = dict(zip(("median", "99 %"), np.subtract(*arms), strict=True))
    facts = {
        f"{name}: {ms:.1f} of {ADDED_MS:g} ms": bool(ms < ADDED_MS) for name, ms in added.items()
    }
    return facts_row("what the bridge adds to a picture's way", facts)


def check_memory(memory: pd.DataFrame) -> CheckRow:
    """Return whether what waits is bounded, nothing is unaccounted for, and pictures flow again afterwards."""
    end, stopped = memory.iloc[-1], memory[memory["stopped"]]
    waiting, most = end["received"] - end["shown"] - end["dropped"], memory["queued_bytes"].max()
    facts = {
        f"at most {most / MIB:.1f} of {BOUND_BYTES / MIB:.1f} MiB wait": bool(most <= BOUND_BYTES),
        f"{waiting} pictures are neither shown nor counted as dropped nor wait": bool(
            0 <= waiting <= 1
        ),
        "pictures flow again": bool(end["shown"] > stopped["shown"].max() + 1),
    }
    return facts_row("a sink that stands still costs pictures, and bounded memory", facts)


def latency_table(run: Run[Config]) -> pd.DataFrame:
    """Return how long pictures took, by arm: median and percentiles, in milliseconds."""
    table = run["time"].groupby("arm")["taken_ms"].describe(percentiles=[0.05, 0.5, 0.95, 0.99])
    names = {"count": "pictures", "5%": "5 %", "50%": "median", "95%": "95 %", "99%": "99 %"}
    return table[[*names]].rename(columns=names).astype({"pictures": int})


@derived
def added_ms(run: Run[Config]) -> Estimate:
    """Estimate what the bridge adds: its median beyond that of Rerun's own call, in the same run."""
    times = run["time"]
    arms = [
        times.loc[times["arm"] == arm, "taken_ms"].to_numpy(float) for arm in ("bridge", "bare")
    ]
    return bootstrap(
        arms, lambda groups: float(np.median(groups[0]) - np.median(groups[1])), unit="ms"
    )


@exp.claim("A-VIZ", how=How.LIVE)
def share_that_holds(run: Run[Config]) -> Finding:
    """Return the share of checks that hold, in the group where it is lowest.

    What the bridge adds counts at the median and at 99 %; the paper states no latency of its bridge.
    """
    share, memory = lowest_share(checks(run), "group"), run["memory"]
    details = {
        **share.groups,
        "added by the bridge": f"{added_ms(run)}; asked is below {ADDED_MS:g} ms",
        "waiting at most, with a sink that stands still": f"{memory['queued_bytes'].max() / MIB:.1f} MiB",
        "dropped meanwhile": f"{int(memory['dropped'].max())} of {int(memory['received'].max())} pictures",
    }
    return Finding(estimate=share.estimate, details=details, reason=share.reason)


_ARMS = {"bare": ("standard", "Rerun alone"), "bridge": ("proxy", "through the bridge")}


@exp.figure("visualisation_latency", size=(10, 4.2))
def draw_latency(figure: Figure, run: Run[Config]) -> dict[str, Any]:
    """Draw what the bridge adds, and what waits and is dropped while a sink stands still."""
    parts: Any = figure.subfigures(1, 2)
    _draw_times(parts[0].subplots(), run)
    memory, panels = run["memory"], parts[1].subplots(2, 1, sharex=True)
    _draw_memory(panels, memory)
    count = run["time"].groupby("arm").size().max()
    note(
        figure,
        f"live, on this host; {count} raw pictures of 640 x 360 a curve, dots at 99 %; right: one run",
    )
    return {
        "added_ms": added_ms(run).value,
        "latency_ms": {str(arm): dict(row) for arm, row in latency_table(run).iterrows()},
        "queued_bytes": int(memory["queued_bytes"].max()),
        "dropped": int(memory["dropped"].max()),
    }


def _draw_times(axes: Axes, run: Run[Config]) -> None:
    tails = latency_table(run)["99 %"]
    for arm, (color, label) in _ARMS.items():
        taken = np.sort(run["time"].loc[run["time"]["arm"] == arm, "taken_ms"].to_numpy(float))
        share = np.arange(1, len(taken) + 1) / len(taken)
        said = f"{label}: {np.median(taken):.1f} ms\n(99 %: {tails[arm]:.1f} ms)"
        axes.step(taken, share, where="post", color=COLORS[color], label=said)
        axes.plot(tails[arm], 0.99, "o", color=COLORS[color], clip_on=False)
    bare = float(np.median(run["time"].loc[run["time"]["arm"] == "bare", "taken_ms"]))
    asked = f"asked: {ADDED_MS:g} ms\nbeyond Rerun alone"
    axes.axvline(bare + ADDED_MS, color=COLORS["network"], label=asked, **PAPER_STYLE)
    axes.set(xlabel="time until the sink has the picture (ms)", ylabel="share of pictures")
    axes.set(xlim=(0, 1.05 * max(bare + ADDED_MS, run["time"]["taken_ms"].max())), ylim=(0, 1.02))
    more, rare = added_ms(run), tails["bridge"] - tails["bare"]
    axes.set_title(f"The bridge adds {more.value:.1f} ms at the median, {rare:.1f} ms at 99 %")
    axes.legend(loc="lower right", fontsize="small", frameon=True, framealpha=1, edgecolor="none")


def _draw_memory(panels: Sequence[Axes], memory: pd.DataFrame) -> None:
    """Draw what waits, and below it what became of pictures; the sink stood still where it is grey."""
    stopped, (waiting, fates) = memory[memory["stopped"]]["at_s"], panels
    for axes in panels if len(stopped) else ():
        axes.axvspan(stopped.min(), stopped.max(), color=COLORS["network"], alpha=0.2, linewidth=0)
    queued = memory["queued_bytes"] / MIB
    waiting.plot(memory["at_s"], queued, color=COLORS["proxy"], label="not known to be taken")
    grown = (memory["resident_bytes"] - memory["resident_bytes"].iloc[0]) / MIB
    waiting.plot(memory["at_s"], grown, color=COLORS["third"], label="process, since the start")
    waiting.axhline(BOUND_BYTES / MIB, color=COLORS["standard"], label="bound", **PAPER_STYLE)
    said = (
        f"Sink stopped (grey): {queued.max():.0f} MiB wait, {memory['dropped'].max()} pictures drop"
    )
    waiting.set(ylabel="MiB", title=said, ylim=(0, 1.8 * BOUND_BYTES / MIB))
    waiting.legend(loc="upper left", ncols=2, fontsize="small")
    looks = (("received", "network", ":"), ("shown", "proxy", "-"), ("dropped", "standard", "--"))
    for name, color, line in looks:
        fates.plot(memory["at_s"], memory[name], color=COLORS[color], linestyle=line, label=name)
    fates.set(xlabel="time (s)", ylabel="pictures", ylim=(0, None))
    fates.legend(loc="upper left", fontsize="small")


@exp.figure("visualisation_points", size=(10, 3.7))
def draw_points(figure: Figure, run: Run[Config]) -> dict[str, Any]:
    """Draw a picture and the points that its depth became in the recording, with how far they are off."""
    import cv2

    jpeg = np.frombuffer(run.attachment(PICTURE), np.uint8)
    cloud = dict(np.load(io.BytesIO(run.attachment(CLOUD))))
    grid = figure.add_gridspec(1, 2, width_ratios=[1, 1.3])
    image: Any = cv2.imdecode(jpeg, cv2.IMREAD_COLOR)
    picture = figure.add_subplot(grid[0])
    picture.imshow(cv2.resize(image, (400, 225), interpolation=cv2.INTER_AREA)[..., ::-1])
    picture.set_axis_off()
    picture.set_title("image, registered to the depth", fontsize=10)
    _draw_cloud(figure.add_subplot(grid[1], projection="3d"), cloud["points"], cloud["colors"])
    largest = float(run["cloud"]["largest_error_m"].max())
    figure.suptitle(
        f"Points are where depth and camera put them, to {1e6 * largest:.1f} µm (its step: 1 mm)"
    )
    note(
        figure,
        f"exact, beside back-projection in double precision; largest of {len(run['cloud'])} images",
    )
    return {"images": len(run["cloud"]), "largest_error_m": largest, "points": len(cloud["points"])}


def _draw_cloud(axes: Any, points: NDArray[Any], colors: NDArray[np.uint8]) -> None:
    """Draw points as the camera sees them from a step to the side: x right, z forward, y down (REP 103)."""
    x, y, z = points.T
    axes.scatter(x, z, -y, c=colors / 255.0, s=1.2, linewidths=0, rasterized=True)
    axes.set_box_aspect([np.ptp(x), np.ptp(z), np.ptp(y)], zoom=1.25)
    axes.view_init(elev=18, azim=-68)
    axes.set_zticklabels([])
    axes.locator_params(nbins=4)
    axes.set(xlabel="x (m)", ylabel="depth (m)")
    axes.set_title(f"its {len(points)} points in the recording", fontsize=10)
