"""Conditions of the map, what is run in each, and where more of them are added.

Seeds of a cell are run together, as the criteria ask for the median over all of their "Hello"s.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from itertools import pairwise, product
from typing import TYPE_CHECKING, Any, cast

import numpy as np
import pandas as pd

from sfglab.arp.hallway.simulation import LAP_DEPTHS, OPTIMUM, LapSettings, SimulatedLap
from sfglab.arp.hello import BEST, HELLO_UP, OPT_DEPTH, GridCell, hello_times_ms, scenario_of
from sfglab.arp.robots import DEPTHS, RATES_HZ
from sfglab.fields import between
from sfglab.lab.bench import Bench, rows_of
from sfglab.lab.experiment import Actor, Experiment, Link, Profiled, seeded
from sfglab.lab.experiments.phases.answers import ANSWERS, PLACE, Place, answers, middle, plausible
from sfglab.lab.sweep import Workers, sweep
from sfglab.rtps import Medium, run
from sfglab.rtps.session import age_ms
from sfglab.units import NS_PER_S

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from sfglab.rtps.channel import QueueRule

MODES = ("fast_dds_sync", "fast_dds_async", "fast_dds_foxy", "cyclone_dds")
QUEUE_FRAMES = 277
"""Small frames that fit into Linux's default socket buffer, 212,992 B: each takes 768 B there (an skb)."""
#: How often the air stalls where it does: assumed; the criterion gives for how long.
STALL_EVERY_S = 1.0
CELLS = (
    *((method, str(depth)) for method in ("none", "CC") for depth in DEPTHS),
    ("OPT+CC", OPT_DEPTH),
    (BEST, OPT_DEPTH),
)
"""Method and depth of everything that the criteria compare."""
COURSES = (*(("none", depth) for depth in LAP_DEPTHS), (BEST, OPTIMUM))


@dataclass(frozen=True, slots=True, kw_only=True)
class Condition(Place):
    """A place that is run."""

    duration_s: float = 10.0  #: How long is published, simulated seconds.
    seeds: int = 1  #: With how many seeds each cell is run.

    def medium(self) -> Medium:
        """Return its air."""
        return Medium(
            loss=self.loss,
            overhead_s=self.frame_us / 1e6,
            queue_frames=QUEUE_FRAMES,
            queue_rule=cast("QueueRule", self.queue_rule),
            access_point=True,
            random_turns=True,
            stall_every_s=STALL_EVERY_S,
            stall_s=self.stall_ms / 1e3,
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class Config(Profiled):
    """The whole run."""

    presets: tuple[str, ...] = MODES  #: Modes of publication.
    losses: tuple[float, ...] = (0.0001, 0.0017, 0.03)  #: Shares of frames lost on each crossing.
    #: Costs of a frame on each crossing, microseconds.
    frames_us: tuple[float, ...] = (50.0, 250.0, 1200.0)
    queue_rules: tuple[str, ...] = ("block",)  #: What full queues do.
    rates_hz: tuple[int, ...] = (500,)  #: Values of Rmax.
    refined: int = 12  #: How many conditions are added near borders.
    #: Whether all conditions of the criteria are run, at every Rmax of Table 2.
    criterion: bool = True
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
        "criterion": False,
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
        "course_seeds": 6,
    },
    actors=(
        Actor(
            "robot1",
            host="robot1",
            does="sensing and actuation; robot2 and robot3 alike",
            count="3",
        ),
        Actor("air", host="access point", does="loses, stalls, queues"),
        Actor("station", host="station", does="localisation and planning"),
    ),
    links=(
        Link("robot1", "air", "sensors' values"),
        Link("air", "station", "the same", boundary="second crossing"),
    ),
)


# --- Conditions -----------------------------------------------------------------------------------------------


def conditions(config: Config) -> list[Condition]:
    """Return the map's conditions before any is refined, and if asked those of the criteria, each once."""
    axes = (
        config.presets,
        config.losses,
        config.frames_us,
        config.queue_rules,
        (0.0,),
        config.rates_hz,
    )
    places = dict.fromkeys([*product(*axes), *(plausible() if config.criterion else ())])
    how: dict[str, Any] = {"duration_s": config.duration_s, "seeds": config.seeds}
    return [Condition(**dict(zip(PLACE, place, strict=True)), **how) for place in places]


def midpoints(table: pd.DataFrame, config: Config, most: int) -> list[Condition]:
    """Return conditions between neighbours with unlike `ANSWERS`, the widest gaps first, none twice."""
    gaps: dict[Condition, float] = {}
    how: dict[str, Any] = {"duration_s": config.duration_s, "seeds": config.seeds}
    for axis in ("loss", "frame_us"):
        for _, line in table.groupby([name for name in PLACE if name != axis], sort=False):
            rows = line.sort_values(axis)
            unlike = rows[list(ANSWERS)].round().diff().abs().any(axis=1).to_numpy()[1:]
            for (low, high), differs in zip(pairwise(rows[axis]), unlike, strict=True):
                place: dict[str, Any] = {
                    **rows[PLACE].iloc[0],
                    axis: float(f"{middle(low, high):.3g}"),
                }
                if differs and low < place[axis] < high:
                    gaps.setdefault(Condition(**place, **how), high / low)
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
    pooled_ms: float  #: The same of all seeds together.
    age_ms: float  #: Age of the newest "Hello" that the station has, mean over time.


@exp.sweep(
    "cell", over=conditions, seeds=lambda config: [config.seed], workers=Workers(threads=True)
)
def simulate(condition: Condition, seed: int) -> tuple[dict[str, Any], ...]:
    """Run what the criteria compare in a condition, with all its seeds from this one on."""
    return tuple(row for method, depth in CELLS for row in _cell(condition, method, depth, seed))


def _cell(condition: Condition, method: str, depth: str, first: int) -> list[dict[str, Any]]:
    of: dict[str, Any] = {"rate_max_hz": condition.rate_max_hz, "vendor": condition.preset}
    of["duration_s"] = condition.duration_s
    point = GridCell(depth=depth, method=method, hop=True, **of)
    seeds, medium = range(first, first + condition.seeds), condition.medium()
    outcomes = [run(scenario_of(point, seed=seed, medium=medium), seed=seed) for seed in seeds]
    times_ms = [hello_times_ms(outcome) for outcome in outcomes]
    pooled_ms = _median(np.concatenate(times_ms))
    return [
        {
            "method": method,
            "depth": depth,
            "seed": seed,
            "published": len(times),
            "arrived": int(np.isfinite(times).sum()),
            "p50_ms": _median(times),
            "pooled_ms": pooled_ms,
            "age_ms": age_ms(outcome.flows[HELLO_UP], duration_s=condition.duration_s),
        }
        for seed, outcome, times in zip(seeds, outcomes, times_ms, strict=True)
    ]


def _median(times_ms: NDArray[np.float64]) -> float:
    return float(np.quantile(times_ms, 0.5, method="lower"))


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
    air["rate_max_hz"] = condition.rate_max_hz
    rows = []
    for method, depth in COURSES:
        lap = SimulatedLap(LapSettings(method=method, depth=depth, **air), seed).run()
        end = {"end": lap.end.value, "robot": lap.robot, "ended_s": lap.ended_ns / NS_PER_S}
        rows.append({"method": method, "depth": depth, **end})
    return tuple(rows)


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
                rows[one.table] += rows_of(
                    bench.row_classes[one.table], result, {"seed": seed}, condition
                )
                bench.write_all(one.table, rows[one.table][-len(result) :])
        left -= len(chosen)
        for _ in chosen:
            bench.advance("refined")
