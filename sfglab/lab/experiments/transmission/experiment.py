"""The grid of paper B, Table 2, over the flows of Fig. 9, each cell simulated, and the ways beyond the grid.

Robot 1's sensing node publishes "Hello" to its localisation in the station; when that and robot 3's
localisation have had it, the station publishes it to robot 1's actuation node. A topic's rate is Rmax, or R of
Eq. 6; the topics of an agent are those flows that begin or end there (Eq. 1).

Beyond the grid: which rates and depths serve the station better, by the share of time in which it has the value
that a sensor has now, over the same air, seeds and sensors.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache, partial
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from sfglab.arp.hello import (
    HELLO_UP,
    HELLOS,
    OPT_DEPTH,
    STATION,
    GridCell,
    Sizes,
    hello_latency_ms,
    rate_and_depth,
    scenario_of,
)
from sfglab.arp.programme import plan
from sfglab.arp.robots import (
    DEPTHS,
    METHODS,
    RATES_HZ,
    ROBOTS,
    Depth,
    Rate,
)
from sfglab.arp.topics import Topic
from sfglab.fields import between
from sfglab.lab.experiment import Actor, Experiment, Link, Profiled, seeded
from sfglab.lab.sweep import Workers
from sfglab.rtps import (
    Drop,
    Fate,
    Flow,
    FlowOutcome,
    Medium,
    Outcome,
    Scenario,
    run,
)
from sfglab.rtps.session import up_to_date
from sfglab.units import NS_PER_S

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from sfglab.arp.plan import Plan

THREADS = Workers(threads=True)  #: Sweeps run in threads: the time is spent in compiled code.


@dataclass(frozen=True, slots=True, kw_only=True)
class Config(Profiled):
    """The whole run."""

    seeds: int = 6  #: How many seeds each cell is run with.
    duration_s: float = 60.0  #: Simulated seconds of a cell.
    rates_hz: tuple[Rate, ...] = RATES_HZ  #: Values of Rmax.
    #: Values of DEPTH beside the optimum.
    depths: tuple[Depth, ...] = DEPTHS
    methods: tuple[str, ...] = tuple(METHODS)  #: Names of methods.
    loss: float = between(Medium().loss, 0.0, 0.3)  #: Share of frames that the air loses.
    #: Size of sensors' values, of the paper's.
    size_factor: float = between(1.0, 0.1, 10.0, log=True)
    #: Whose timing; the paper used Fast DDS.
    vendor: Literal["fast_dds", "cyclone_dds"] = "fast_dds"
    hop: bool = False  #: Whether "Hello" goes by robot 3's machine, as Fig. 9 has it.
    sizes: Sizes = "table"  #: Sizes of sensors' values: those of Table 1, or CDR's.
    slower: float = between(1.0, 0.1, 100.0, log=True)  #: How slow the station's computer is.
    live_s: float = 8.0  #: How long each live cell is, seconds; 0: none is run.
    live_rates_hz: tuple[int, ...] = (100, 200)  #: Rmax of the live cells.
    #: Their DEPTH; optimised methods have ``opt`` as well.
    live_depths: tuple[str, ...] = ("1", "10", "1000")
    live_methods: tuple[str, ...] = ("none", "OPT+LC")  #: Methods of the live cells.
    validation_s: float = 30.0  #: How long each cell of the validation is, seconds.
    validation_repeats: int = 0  #: How often it is played at most, an odd number; 0: not.
    #: How long each cell on real Fast DDS is, seconds; methods and depths as above.
    ros2_s: float = 8.0
    ros2_repeats: int = 1  #: How often it is played; 0: not.
    ros2_rates_hz: tuple[int, ...] = (1000,)  #: Rmax of these cells.
    seed: int = 0  #: The first seed.


exp = Experiment(
    "transmission",
    Config,
    where="B 3.1",
    smoke={
        "seeds": 1,
        "duration_s": 2.0,
        "live_s": 2.0,
        "live_rates_hz": (100,),
        "live_depths": ("10",),
        "live_methods": ("none",),
        "ros2_repeats": 0,
    },
    paper={
        "seeds": 30,
        "live_s": 20.0,
        "live_methods": ("none", "LC", "OPT", "OPT+LC"),
        "validation_repeats": 5,
        "ros2_repeats": 5,
        "ros2_rates_hz": RATES_HZ,
    },
    actors=(
        *(Actor(robot, host=robot, does="sensing nodes, a process") for robot in ROBOTS),
        Actor(STATION, host=STATION, does="localisation and planning, a process"),
    ),
    links=(
        *(
            Link(robot, STATION, f"{len(sensors)} sensors' values", boundary="a lossy air")
            for robot, sensors in ROBOTS.items()
        ),
        Link("robot1", STATION, '"Hello"', boundary="a lossy air"),
        Link(STATION, "robot1", '"Hello", back', boundary="a lossy air"),
    ),
)


def cells_of(config: Config, *, loss: float | None = None) -> Callable[..., GridCell]:
    """Return what makes cells over the run's air, or over one that loses another share."""
    return partial(
        GridCell,
        loss=config.loss if loss is None else loss,
        size_factor=config.size_factor,
        vendor=config.vendor,
        hop=config.hop,
        sizes=config.sizes,
        slower=config.slower,
    )


def grid(config: Config, *, loss: float | None = None) -> list[GridCell]:
    """Return every cell: Rmax by DEPTH by method, over the run's air or one that loses another share."""
    cell = cells_of(config, loss=loss)
    return [
        cell(rate_max_hz=rate, depth=depth, method=method, duration_s=config.duration_s)
        for rate in config.rates_hz
        for depth in (*map(str, config.depths), OPT_DEPTH)
        for method in config.methods
    ]


# --- A cell, simulated ----------------------------------------------------------------------------------------


@exp.table("cell", "lossless")
class TransmissionRow:
    """One cell of the grid with one seed, simulated.

    "Hello" goes up to the station and down to the robot; what is lost is counted where it was lost.
    """

    rate_max_hz: int  #: Rmax.
    depth: str  #: DEPTH as the grid has it.
    method: str  #: The method.
    seed: int  #: The seed.
    rate_hz: float  #: At which each topic was published.
    history_depth: int  #: Samples of each history.
    published: int  #: "Hello"s that were published.
    arrived: int  #: Those that reached the actuation node.
    #: Median time from publication to actuation of those; NaN when none arrived.
    latency_p50_ms: float
    latency_mean_ms: float  #: Mean of it.
    latency_p95_ms: float  #: 95th percentile of it.
    #: Lost on air, and overwritten in the writer's history before it was repaired.
    lost_medium: int
    lost_queue: int  #: Dropped by a sender's full queue, and overwritten before it was repaired.
    lost_late: int  #: Arrived, and pushed out of the reader's history before the node took it.
    lost_underway: int  #: Neither there nor given up when time was over.
    deadlines_missed: int  #: How often the station waited beyond the deadline for the next "Hello".
    sensor_values: int  #: Values that the sensing nodes read.
    sensor_held: int  #: Those that local caches held back.
    sensor_published: int  #: Those that were published.
    sensor_delivered: int  #: Those that planning nodes had.
    planned: int  #: Messages that cost the station its full time.
    compared: int  #: Messages that cache control discarded.
    data: int  #: DATA frames, repairs included.
    heartbeats: int  #: HEARTBEAT frames.
    acknacks: int  #: ACKNACK frames.
    repeated: int  #: DATA frames that repair.
    queue_full: int  #: Frames that found their sender's queue full.
    air_share: float  #: Share of the time that the air was in use while messages were published.


@exp.sweep(
    "lossless", over=lambda c: grid(c, loss=0.0), seeds=lambda c: seeded(c, 1), workers=THREADS
)
@exp.sweep("cell", over=grid, workers=THREADS)
def simulate_cell(point: GridCell, seed: int) -> dict[str, Any]:
    """Run one cell with one seed."""
    scenario = scenario_of(point, seed=seed)
    outcome = run(scenario, seed=seed)
    rate_hz, depth = rate_and_depth(point)
    counts = outcome.counts
    sensors = [f for name, f in outcome.flows.items() if name not in HELLOS]
    published = sum(len(f.fate) for f in sensors)
    return {
        "rate_hz": rate_hz,
        "history_depth": depth,
        **_hello_columns(outcome),
        "sensor_values": published + counts["held"],
        "sensor_held": counts["held"],
        "sensor_published": published,
        "sensor_delivered": sum(int(f.delivered.sum()) for f in sensors),
        "planned": counts["processed"],
        "heartbeats": counts["heartbeat"],
        "acknacks": counts["acknack"],
        **{name: counts[name] for name in ("compared", "data", "repeated", "queue_full")},
        "air_share": air_share(scenario, outcome),
    }


def _hello_columns(outcome: Outcome) -> dict[str, Any]:
    latency, up = hello_latency_ms(outcome), outcome.flows[HELLO_UP]
    return {
        "published": len(up.fate),
        "arrived": len(latency),
        "latency_mean_ms": float(np.mean(latency)) if len(latency) else float("nan"),
        **latency_columns(latency),
        **hello_losses(outcome),
        "deadlines_missed": up.deadlines_missed(),
    }


def air_share(scenario: Scenario, outcome: Outcome) -> float:
    """Return the share of the time that the air was in use."""
    return outcome.counts["airtime_ns"] / ((scenario.duration_s + scenario.drain_s) * NS_PER_S)


def latency_columns(latency_ms: NDArray[np.float64]) -> dict[str, float]:
    """Return median and 95th percentile by their columns; NaN of nothing."""
    some = latency_ms if len(latency_ms) else np.array([np.nan])
    return {
        "latency_p50_ms": float(np.median(some)),
        "latency_p95_ms": float(np.percentile(some, 95)),
    }


def hello_losses(outcome: Outcome) -> dict[str, int]:
    """Return where "Hello"s were lost, up and down together, by `TransmissionRow`'s names."""
    ways = [_losses(flow) for name, flow in outcome.flows.items() if name in HELLOS]
    return {name: sum(int(lost[name].sum()) for lost in ways) for name in ways[0]}


def _losses(flow: FlowOutcome) -> dict[str, NDArray[np.bool_]]:
    overwritten = np.equal(flow.fate, Fate.OVERWRITTEN)
    return {
        "lost_medium": overwritten & np.equal(flow.dropped, Drop.MEDIUM),
        "lost_queue": overwritten & np.equal(flow.dropped, Drop.QUEUE),
        "lost_late": np.equal(flow.fate, Fate.LATE),
        "lost_underway": np.equal(flow.fate, Fate.UNDERWAY),
    }


# --- The printed problem against our own ----------------------------------------------------------------------

WAYS = {
    "none": ("none", "10"),
    "LC": ("LC", "10"),
    "OPT": ("OPT", OPT_DEPTH),
    "OPT+LC": ("OPT+LC", OPT_DEPTH),
    "own": ("none", "10"),
    "own+LC": ("LC", "10"),
}
"""Method and depth that each way begins with; ``own`` then has the rates and depths of our programme."""

HELLO_CHANGE_S = 0.1
"""How often there is something new to say hello with, for the plan: ten times a second, as the LIDAR turns."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Way:
    """A cell of the comparison."""

    way: str  #: One of `WAYS`.
    cell: GridCell  #: What it begins with.


def ways(config: Config) -> list[Way]:
    """Return every way at every Rmax."""
    cell = partial(cells_of(config), duration_s=config.duration_s)
    return [
        Way(way=way, cell=cell(rate_max_hz=rate, depth=depth, method=method))
        for rate in config.rates_hz
        for way, (method, depth) in WAYS.items()
    ]


@exp.table("beyond")
class BeyondRow:
    """One way to choose rates and depths, the printed problem's or our own, with one seed, simulated."""

    rate_max_hz: int  #: Rmax.
    way: str  #: One of `WAYS`.
    seed: int  #: The seed.
    rate_low_hz: float  #: Rate of the slowest topic.
    rate_high_hz: float  #: Rate of the fastest topic.
    depth_high: int  #: Deepest history.
    #: Median time of "Hello" from publication to actuation; NaN when none arrived.
    latency_p50_ms: float
    latency_p95_ms: float  #: 95th percentile of it.
    loss: float  #: Share of "Hello"s lost.
    #: Share of time in which the station has the value that a sensor has now, mean over sensors.
    up_to_date: float
    air_share: float  #: Share of the time that the air was in use.


@exp.sweep("beyond", over=ways, workers=THREADS)
def simulate_way(way: Way, seed: int) -> dict[str, Any]:
    """Run one way with one seed."""
    scenario = scenario_of(way.cell, seed=seed)
    if way.way.startswith("own"):
        chosen = own_plan(way.cell)
        scenario = replace(scenario, flows=tuple(_planned(flow, chosen) for flow in scenario.flows))
    outcome = run(scenario, seed=seed)
    latency = hello_latency_ms(outcome)
    rates = [f.rate_hz for f in scenario.flows if f.rate_hz]
    known = [
        up_to_date(flow, outcome.flows[flow.name], duration_s=scenario.duration_s)
        for flow in scenario.flows
        if flow.change_s
    ]
    return {
        "rate_max_hz": way.cell.rate_max_hz,
        "rate_low_hz": min(rates),
        "rate_high_hz": max(rates),
        "depth_high": max(f.qos.depth for f in scenario.flows),
        **latency_columns(latency),
        "loss": 1 - len(latency) / len(outcome.flows[HELLO_UP].fate),
        "up_to_date": float(np.mean(known)),
        "air_share": air_share(scenario, outcome),
    }


@lru_cache
def own_plan(cell: GridCell) -> Plan:
    """Return our programme's rates and depths for a cell's topics, none faster than Rmax.

    Where the cell's method has local caches, they send only changes, and rates are those of reading.
    """
    scenario = scenario_of(cell)
    topics = [
        Topic(
            name=flow.name,
            source=flow.source,
            target=flow.target,
            size_bytes=flow.size_bytes,
            cached=flow.cached,
            rate_max_hz=float(cell.rate_max_hz),
            change_s=flow.change_s or HELLO_CHANGE_S,
        )
        for flow in scenario.flows
    ]
    return plan(topics, scenario.medium, scenario.vendor)


def _planned(flow: Flow, chosen: Plan) -> Flow:
    """Give a flow its planned rate; its phase keeps its share of the period. The answer follows "Hello"."""
    qos = chosen[flow.name].qos
    if not flow.rate_hz:
        return replace(flow, qos=qos)
    rate_hz = chosen[flow.name].rate_hz
    return replace(flow, qos=qos, rate_hz=rate_hz, phase_s=flow.phase_s * flow.rate_hz / rate_hz)
