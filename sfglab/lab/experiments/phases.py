"""Phases: in which mode of publication, over which air and by which queue paper B's conclusions hold.

In each condition `transmission`'s scenario, with the hop over robot 3's machine, is run with every method and
depth that the criteria of B-LAT and B-LOSS compare (``data/claims.yaml``), and `cooperation`'s hallway driven.
Near the borders between unlike answers more conditions follow.
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, fields
from itertools import pairwise, product
from typing import TYPE_CHECKING, Any, cast

import numpy as np
import pandas as pd

from sfglab.arp.hallway import End
from sfglab.arp.robots import DEPTHS, RATES_HZ
from sfglab.fields import between
from sfglab.lab.bench import rows_of
from sfglab.lab.claims import load_claims
from sfglab.lab.experiment import Actor, Experiment, Link, Profiled, seeded
from sfglab.lab.experiments.cooperation.experiment import DEPTHS as COURSE_DEPTHS
from sfglab.lab.experiments.cooperation.experiment import OPTIMUM, SimulatedRun
from sfglab.lab.experiments.cooperation.experiment import Point as CoursePoint
from sfglab.lab.experiments.transmission.analysis import BEST, SMALL_DEPTH, TIE
from sfglab.lab.experiments.transmission.experiment import HELLO_UP, OPT_DEPTH, Point, scenario_of
from sfglab.lab.experiments.transmission.experiment import hello_latency_ms as latency_of
from sfglab.lab.experiments.transmission.figures import draw_panel
from sfglab.lab.experiments.transmission.freshness import age_ms
from sfglab.lab.figures import COLORS
from sfglab.lab.paths import find_project
from sfglab.lab.runs import Run, derived
from sfglab.lab.stats import share_of
from sfglab.lab.sweep import Workers, sweep
from sfglab.rtps import Medium, run

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from sfglab.lab.bench import Bench
    from sfglab.lab.claims import Criterion
    from sfglab.rtps.model import QueueRule

MODES = ("fast_dds_sync", "fast_dds_async", "fast_dds_foxy", "cyclone_dds")
QUEUE_FRAMES = 277
"""Small frames that fit into Linux's default socket buffer, 212,992 B: each takes 768 B there (an skb)."""
STALL_EVERY_S = 1.0
"""How often the air stalls where it does: assumed; the criterion gives for how long."""
DEEP = 100
"""A depth from this on is deep, as the criteria have it."""
LOSS_POINT = 0.01
"""By how much OPT+LC may lose more than the lowest and still agree: a point."""
CELLS = (
    *((method, str(depth)) for method in ("none", "CC") for depth in DEPTHS),
    ("OPT+CC", OPT_DEPTH),
    (BEST, OPT_DEPTH),
)
"""Method and depth of everything that the criteria compare."""
COURSES = (*(("none", depth) for depth in COURSE_DEPTHS), (BEST, OPTIMUM))


@dataclass(frozen=True, slots=True, kw_only=True)
class Place:
    """Where on the map something is."""

    preset: str  #: One of `MODES`.
    loss: float  #: Share of frames lost on each crossing; there are two, as an access point is between.
    frame_us: float  #: Cost of a frame on air on each crossing beside its bits, microseconds.
    queue_rule: str = "block"  #: What a full queue of a host does.
    stall_ms: float = 0.0  #: For how long nothing is sent once in `STALL_EVERY_S`.
    rate_max_hz: int  #: Rmax.


PLACE = [f.name for f in fields(Place)]


@dataclass(frozen=True, slots=True, kw_only=True)
class Condition(Place):
    """A place that is run."""

    duration_s: float = 10.0  #: How long is published, simulated seconds.

    def medium(self) -> Medium:
        """Return its air."""
        return Medium(
            loss=self.loss,
            overhead_s=self.frame_us / 1e6,
            queue_frames=QUEUE_FRAMES,
            queue_rule=cast("QueueRule", self.queue_rule),
            access_point=True,
            stall_every_s=STALL_EVERY_S,
            stall_s=self.stall_ms / 1e3,
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class Config(Profiled):
    """The whole run."""

    presets: tuple[str, ...] = MODES  #: Modes of publication.
    losses: tuple[float, ...] = (0.0001, 0.0017, 0.03)  #: Shares of frames lost on each crossing.
    frames_us: tuple[float, ...] = (50.0, 250.0, 1200.0)  #: Costs of a frame on each crossing, microseconds.
    queue_rules: tuple[str, ...] = ("block",)  #: What full queues do.
    rates_hz: tuple[int, ...] = (500,)  #: Values of Rmax.
    refined: int = 12  #: How many conditions are added near borders.
    criterion: bool = False  #: Whether all conditions of the criteria are run, at every Rmax of Table 2.
    duration_s: float = between(10.0, 0.5, 60.0)  #: Simulated seconds of a cell.
    seeds: int = 6  #: How many seeds each cell is run with.
    course_seeds: int = 2  #: How many times each hallway is driven.
    seed: int = 0  #: The first seed.


exp = Experiment(
    "phases",
    Config,
    where="B 3",
    smoke={
        "presets": ("fast_dds_async",),
        "losses": (0.0017,),
        "frames_us": (50.0, 1200.0),
        "queue_rules": ("block",),
        "refined": 1,
        "duration_s": 1.0,
        "seeds": 1,
        "course_seeds": 1,
    },
    paper={
        "losses": (0.0001, 0.0003, 0.001, 0.003, 0.01, 0.03),
        "frames_us": (50.0, 100.0, 200.0, 350.0, 600.0, 1200.0),
        "queue_rules": ("block", "tail", "head"),
        "rates_hz": RATES_HZ,
        "refined": 0,
        "criterion": True,
        "course_seeds": 6,
    },
    actors=(
        Actor("robot1", host="robot1", does="sensing and actuation; robot2 and robot3 alike", count="3"),
        Actor("air", host="access point", does="loses, stalls, queues"),
        Actor("station", host="station", does="localisation and planning"),
    ),
    links=(
        Link("robot1", "air", "sensors' values"),
        Link("air", "station", "the same", boundary="second crossing"),
    ),
)


# --- Conditions -----------------------------------------------------------------------------------------------


def criterion() -> Criterion:
    """Return by what B-LAT is judged; its modes and its region are those of B-LOSS and B-COOP, too."""
    [claim] = (claim for claim in load_claims(find_project().claims) if claim.id == "B-LAT")
    assert claim.criterion is not None, "it has one"
    return claim.criterion


def plausible() -> list[tuple[Any, ...]]:
    """Return the places of the criteria in the order of `PLACE`, 27 for each mode and Rmax of Table 2."""
    asked = criterion()
    axes = [
        (low, round(_middle(low, high), 6), high)
        for low, high in (asked.region[name] for name in ("loss", "frame_us", "stall_ms"))
    ]
    return [
        (preset, loss, frame_us, "block", stall_ms, rate_hz)
        for preset, loss, frame_us, stall_ms, rate_hz in product(asked.modes, *axes, RATES_HZ)
    ]


def _middle(low: float, high: float) -> float:
    """Return the geometric mean, or half of the most where the least is 0."""
    return math.sqrt(low * high) if low else high / 2


def conditions(config: Config) -> list[Condition]:
    """Return the map's conditions before any is refined, and if asked those of the criteria, each once."""
    axes = (config.presets, config.losses, config.frames_us, config.queue_rules, (0.0,), config.rates_hz)
    places = dict.fromkeys([*product(*axes), *(plausible() if config.criterion else ())])
    return [Condition(**dict(zip(PLACE, place, strict=True)), duration_s=config.duration_s) for place in places]


def midpoints(table: pd.DataFrame, config: Config, most: int) -> list[Condition]:
    """Return conditions between neighbours with unlike `ANSWERS`, the widest gaps first, none twice."""
    gaps: dict[Condition, float] = {}
    for axis in ("loss", "frame_us"):
        others = [name for name in PLACE if name != axis]
        for _, line in table.groupby(others, sort=False):
            rows = line.sort_values(axis)
            unlike = rows[list(ANSWERS)].round().diff().abs().any(axis=1).to_numpy()[1:]
            for (low, high), differs in zip(pairwise(rows[axis]), unlike, strict=True):
                place: dict[str, Any] = {**rows[PLACE].iloc[0], axis: float(f"{_middle(low, high):.3g}")}
                if differs and low < place[axis] < high:
                    gaps.setdefault(Condition(**place, duration_s=config.duration_s), high / low)
    return sorted(gaps, key=lambda condition: -gaps[condition])[:most]


# --- In one condition -----------------------------------------------------------------------------------------


@exp.table("cell")
class MethodRow(Place):
    """A method at a depth in one condition with one seed, simulated."""

    method: str  #: The method.
    depth: str  #: DEPTH as Table 2 has it.
    seed: int  #: The seed.
    published: int  #: "Hello"s that were published.
    arrived: int  #: Those that reached actuation.
    p50_ms: float  #: Median time to actuation, one that never arrived counting as infinite.
    age_ms: float  #: Age of the newest "Hello" that the station has, mean over time.


@exp.sweep("cell", over=conditions, workers=Workers(threads=True))
def simulate(condition: Condition, seed: int) -> tuple[dict[str, Any], ...]:
    """Run what the criteria compare in a condition, with one seed."""
    return tuple(_cell(condition, method, depth, seed) for method, depth in CELLS)


def _cell(condition: Condition, method: str, depth: str, seed: int) -> dict[str, Any]:
    point = Point(
        rate_max_hz=condition.rate_max_hz,
        depth=depth,
        method=method,
        duration_s=condition.duration_s,
        vendor=condition.preset,
        hop=True,
    )
    outcome = run(scenario_of(point, seed=seed, medium=condition.medium()), seed=seed)
    latency, up = latency_of(outcome), outcome.flows[HELLO_UP]
    never = np.full(len(up.fate) - len(latency), np.inf)
    return {
        "method": method,
        "depth": depth,
        "published": len(up.fate),
        "arrived": len(latency),
        "p50_ms": float(np.quantile(np.append(latency, never), 0.5, method="lower")),
        "age_ms": age_ms(up, duration_s=condition.duration_s),
    }


@exp.table("course")
class HallwayRow(Place):
    """A hallway driven in one condition with one seed, simulated."""

    method: str  #: The method.
    depth: int  #: DEPTH; 0: that of Eq. 6.
    seed: int  #: The seed.
    end: str  #: An `End`.
    robot: str  #: Who met an obstacle; empty: nobody, or nobody alone.
    ended_s: float  #: When.


@exp.sweep("course", over=conditions, seeds=lambda config: seeded(config, config.course_seeds))
def drive(condition: Condition, seed: int) -> tuple[dict[str, Any], ...]:
    """Drive the hallway in a condition without any method, at three depths, and with OPT+LC."""
    air: dict[str, Any] = {"vendor": condition.preset, "medium": condition.medium()}
    rate_hz = condition.rate_max_hz
    points = [CoursePoint(method=method, depth=depth, rate_max_hz=rate_hz, **air) for method, depth in COURSES]
    rows = [asdict(SimulatedRun(point, seed).run()) for point in points]
    return tuple({name: row[name] for name in ("method", "depth", "end", "robot", "ended_s")} for row in rows)


@exp.part("refine", total=lambda config: config.refined, timed=False)
def refine(bench: Bench[Config]) -> None:
    """Add conditions between neighbours whose answers are unlike, round by round, until there are enough."""
    config, folder = bench.config, bench.folder("refined")
    rows = {table: list(bench.rows.get(table, ())) for table in ("cell", "course")}
    left = config.refined
    while left and all(rows.values()):
        tables = [pd.DataFrame(map(asdict, rows[table])) for table in ("cell", "course")]
        chosen = midpoints(answers(*tables), config, left)
        if not chosen:
            return
        for one in exp.sweeps:
            journal, workers = folder / f"{one.table}-{left}", bench.options.workers or one.workers
            seeds = one.seeds(config)
            results = sweep(one.task, chosen, seeds, journal=journal, workers=workers)
            for (condition, seed), result in zip(product(chosen, seeds), results, strict=True):
                rows[one.table] += rows_of(bench.row_classes[one.table], result, {"seed": seed}, condition)
                bench.write_all(one.table, rows[one.table][-len(result) :])
        left -= len(chosen)
        for _ in chosen:
            bench.advance("refined")


# --- Answers --------------------------------------------------------------------------------------------------

ANSWERS = {
    "lc_lowest": "OPT+LC lowest",
    "small_worst": "a small depth worst",
    "completed": "hallway, OPT+LC",
    "completed_none": "hallway, none",
}
"""What is asked of each condition, and what the maps call it."""
_BOTH = {"lc_lowest": "lowest", "small_worst": "small"}


def summary(cells: pd.DataFrame) -> pd.DataFrame:
    """Return median, lowest and highest over seeds, a line a condition, method and depth.

    Columns are ``p50_ms``, ``age_ms`` and ``lost``, each with ``_low`` and ``_high``. Six seeds' range has the
    median with 97 %; ``lost`` is the share over all seeds, with Wilson's interval.
    """
    keys = [*PLACE, "method", "depth"]
    grouped = cells.groupby(keys, sort=False)
    table = grouped[["p50_ms", "age_ms"]].agg(["median", "min", "max"])
    endings = {"median": "", "min": "_low", "max": "_high"}
    table.columns = pd.Index([f"{column[0]}{endings[column[1]]}" for column in table.columns.to_list()])
    counts = grouped[["published", "arrived"]].sum()
    lost = [share_of(n - k, n, unit="1") for n, k in counts.to_numpy().tolist()]
    table[["lost", "lost_low", "lost_high"]] = [(one.value, one.low, one.high) for one in lost]
    return table.reset_index()


def answers(cells: pd.DataFrame, courses: pd.DataFrame) -> pd.DataFrame:
    """Return what holds in each condition at each Rmax, a line each, from the two tables of a run.

    Columns are those of `PLACE`; what the criteria of B-LAT and B-LOSS ask: ``latency_lowest``,
    ``loss_lowest``, ``latency_small``, ``loss_small``; and `ANSWERS`: shares from 0 to 1.
    """
    rows = [
        dict(zip(PLACE, place, strict=True)) | _compared(part.set_index(["method", "depth"]))
        for place, part in summary(cells).groupby(PLACE, sort=False)
    ]
    done = courses.assign(done=courses["end"] == End.SUCCESS.value)
    shares = done.assign(best=done["method"] == BEST).pivot_table(index=PLACE, columns="best", values="done")
    shares = shares.rename(columns={True: "completed", False: "completed_none"}).reset_index()
    return pd.DataFrame(rows).merge(shares, on=PLACE)


def _compared(table: Any) -> dict[str, Any]:
    """Return what the criteria ask of one condition; where nothing has a median, OPT+LC has not the lowest."""
    best, others, none = table.loc[BEST, OPT_DEPTH], table.drop(index=(BEST, OPT_DEPTH)), table.loc["none"]
    small, deep = (
        none[picked] for picked in (none.index.astype(int) <= SMALL_DEPTH, none.index.astype(int) >= DEEP)
    )
    lowest_ms = others["p50_ms"].min() * (1 + TIE)
    found = {
        "latency_lowest": bool(np.isfinite(best["p50_ms"]) and best["p50_ms"] <= lowest_ms),
        "loss_lowest": bool(best["lost"] <= others["lost"].min() + LOSS_POINT),
        "latency_small": bool(small["p50_ms_low"].max() > deep["p50_ms_high"].min()),
        "loss_small": bool(small["lost_low"].max() > deep["lost_high"].min()),
    }
    both = {what: (found[f"latency_{of}"] + found[f"loss_{of}"]) / 2 for what, of in _BOTH.items()}
    return found | both


@derived
def phases(run: Run[Config]) -> pd.DataFrame:
    """Return the answers of a run's conditions."""
    return answers(run["cell"], run["course"])


@derived
def shares(run: Run[Config]) -> pd.DataFrame:
    """Return the share of conditions, by preset and queue, with each answer: of all, and inside the region."""
    table = phases(run)
    region = criterion().region
    inside = np.all([table[name].between(*bounds) for name, bounds in region.items()], axis=0)
    keys, columns = ["preset", "queue_rule"], list(ANSWERS)
    parts = {"all": table, "region": table[inside]}
    found = [part.groupby(keys, sort=False)[columns].mean().assign(of=name) for name, part in parts.items()]
    counts = [part.groupby(keys, sort=False).size() for part in parts.values()]
    return pd.concat(found).assign(conditions=pd.concat(counts).to_numpy()).reset_index()


# --- Figures --------------------------------------------------------------------------------------------------


@exp.figure("phases", size=(10.5, 9.6))
def draw_maps(figure: Figure, run: Run[Config]) -> dict[str, Any]:
    """Draw what holds where, without stalls, a row a mode of publication and what a full queue does."""
    table, keys = phases(run), ["queue_rule", "preset", "loss", "frame_us"]
    table = table[table["stall_ms"] == 0]
    rows = [
        (key, part.groupby(keys, sort=False)[[*ANSWERS]].mean().reset_index())
        for key, part in table.groupby(keys[:2], sort=False)
    ]
    figure.set_size_inches(10.5, 2.2 * len(rows) + 1.2)
    panels = figure.subplots(len(rows), len(ANSWERS), sharex=True, sharey=True, squeeze=False)
    image: Any = None
    for row, ((rule, preset), part) in zip(panels, rows, strict=True):
        for axes, answer in zip(row, ANSWERS, strict=True):
            image = _draw_map(axes, part, answer)
        row[0].set_ylabel(f"{preset}\n{rule}, loss (%)", fontsize=8)
    for axes, last, title in zip(panels[0], panels[-1], ANSWERS.values(), strict=True):
        axes.set_title(title, fontsize=9)
        last.set_xlabel("cost of a frame (us)", fontsize=8)
    figure.colorbar(image, ax=panels, shrink=0.6, label="share of answers")
    rates = ", ".join(map(str, sorted(table["rate_max_hz"].unique())))
    figure.suptitle(f"Where paper B's conclusions hold, Rmax {rates} Hz; box: the plausible region")
    return {"answers": pd.concat([part for _, part in rows])}


def _draw_map(axes: Axes, table: pd.DataFrame, answer: str) -> Any:
    """Draw an answer: each place has the colour of the condition that is nearest to it, a dot."""
    from matplotlib.patches import Rectangle

    spots = np.log10(table[["frame_us", "loss"]].to_numpy())
    (left, bottom), (right, top) = spots.min(axis=0) - 0.15, spots.max(axis=0) + 0.15
    x, y = np.linspace(left, right, 120), np.linspace(bottom, top, 120)
    places = np.stack(np.meshgrid(x, y), axis=-1)[:, :, None]
    nearest = (((places - spots) / (right - left, top - bottom)) ** 2).sum(axis=-1).argmin(axis=-1)
    colors = table[answer].to_numpy(float)[nearest]
    image = axes.pcolormesh(10**x, 100 * 10**y, colors, vmin=0, vmax=1, cmap="cividis", rasterized=True)
    axes.plot(
        table["frame_us"], 100 * table["loss"], "o", color="white", markeredgecolor="black", markersize=3.5
    )
    (low, high), (least, most) = (criterion().region[name] for name in ("loss", "frame_us"))
    box = Rectangle((least, 100 * low), most - least, 100 * (high - low), fill=False)
    box.set(edgecolor=COLORS["standard"], linewidth=1.8)
    axes.add_patch(box)
    axes.set(xscale="log", yscale="log")
    axes.grid(visible=False)
    return image


_MEASURES = {"p50_ms": "median latency (ms)", "lost": "loss", "age_ms": "age at the station (ms)"}


@exp.figure("phases_cells", size=(10.5, 7.0))
def draw_cells(figure: Figure, run: Run[Config]) -> dict[str, Any]:
    """Draw latency, loss and age by depth in the condition nearest to the middle of the plausible region."""
    table, region = summary(run["cell"]), criterion().region
    table = table[(table["queue_rule"] == "block") & (table["stall_ms"] == 0)]
    table = table[table["rate_max_hz"] == table["rate_max_hz"].max()].replace(np.inf, np.nan)
    far = sum(np.log(table[name] / _middle(*region[name])) ** 2 for name in ("loss", "frame_us"))
    nearest = table.loc[far.groupby(table["preset"]).idxmin(), PLACE]
    groups = list(table.merge(nearest, on=PLACE).groupby("preset", sort=False))
    panels = figure.subplots(len(_MEASURES), len(groups), sharex=True, sharey="row", squeeze=False)
    for row, (column, label) in zip(panels, _MEASURES.items(), strict=True):
        names = {column: "median", f"{column}_low": "min", f"{column}_high": "max"}
        for axes, (preset, part) in zip(row, groups, strict=True):
            draw_panel(axes, part.rename(columns=names))
            axes.set_title(
                f"{preset}\nloss {part['loss'].iloc[0]:.2%}, {part['frame_us'].iloc[0]:.0f} us", fontsize=8
            )
            axes.tick_params(axis="x", labelrotation=60)
        row[0].set(ylabel=label, yscale="linear" if column == "lost" else "log")
    figure.legend(*panels[0][0].get_legend_handles_labels(), loc="outside lower center", ncols=4)
    figure.suptitle(
        f'"Hello" at Rmax {table["rate_max_hz"].max()} Hz by DEPTH; no median: half or more never arrived'
    )
    return {"cells": pd.concat([part for _, part in groups])[[*PLACE, "method", "depth", *_MEASURES]]}
