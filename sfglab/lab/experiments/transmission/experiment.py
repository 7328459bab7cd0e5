"""The module `transmission.experiment` simulates the grid of paper B, Table 2, over the flows of Fig. 9."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product
from typing import Any, Literal, get_args

import numpy as np

from sfglab.arp.hello import (
    HELLO_UP,
    OPT_DEPTH,
    STATION,
    GridCell,
    hello_latency_ms,
    rate_and_depth,
    scenario_of,
)
from sfglab.arp.robots import DEPTHS, RATES_HZ, ROBOTS, Depth, MethodName, Rate
from sfglab.fields import between
from sfglab.lab.bench import TableRow
from sfglab.lab.experiment import Actor, Experiment, Link, Profiled
from sfglab.lab.sweep import Workers
from sfglab.rtps import Medium, run
from sfglab.units import NS_PER_S


@dataclass(frozen=True, slots=True, kw_only=True)
class Config(Profiled):
    """The `Config` has the grid of the simulation, the live cells and the validation."""

    seeds: int = 6  #: Number of seeds of each cell.
    duration_s: float = 60.0  #: Duration of a simulated cell, seconds.
    rates_hz: tuple[Rate, ...] = RATES_HZ  #: Values of Rmax, Hz.
    depths: tuple[Depth, ...] = DEPTHS  #: Values of DEPTH in addition to the depth of Eq. 6.
    methods: tuple[MethodName, ...] = get_args(MethodName)  #: Names of methods.
    loss: float = between(Medium().loss, 0.0, 0.3)  #: Share of frames that the channel loses.
    #: DDS implementation whose timing the model has; the paper used Fast DDS.
    vendor: Literal["fast_dds", "cyclone_dds"] = "fast_dds"
    live_s: float = 8.0  #: Duration of a live cell, seconds; 0: no live cells.
    live_rates_hz: tuple[int, ...] = (100, 200)  #: Values of Rmax of live cells, Hz.
    #: Values of DEPTH of live cells; optimised methods also have the depth of Eq. 6.
    live_depths: tuple[str, ...] = ("1", "10", "1000")
    live_methods: tuple[MethodName, ...] = ("none", "OPT+LC")  #: Methods of live cells.
    validation_s: float = 30.0  #: Duration of a cell of the validation, seconds.
    validation_repeats: int = 0  #: Number of repetitions of the validation; 0: no validation.
    seed: int = 0  #: First seed.


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
    },
    paper={
        "seeds": 30,
        "live_s": 20.0,
        "live_methods": ("none", "LC", "OPT", "OPT+LC"),
        "validation_repeats": 5,
    },
    actors=(
        *(Actor(robot, host=robot, does="sensing nodes, a process") for robot in ROBOTS),
        Actor(STATION, host=STATION, does="localisation and planning, a process"),
    ),
    links=(
        *(
            Link(robot, STATION, f"{len(sensors)} sensors' values", boundary="a lossy channel")
            for robot, sensors in ROBOTS.items()
        ),
        Link("robot1", STATION, '"Hello"', boundary="a lossy channel"),
        Link(STATION, "robot1", '"Hello", back', boundary="a lossy channel"),
    ),
    removed={
        "hop": {"paper": False},
        "size_factor": {"paper": 1.0},
        "sizes": {"paper": "table"},
        "slower": {"paper": 1.0},
        "ros2_s": {"paper": 8.0},
        "ros2_repeats": {"paper": 5},
        "ros2_rates_hz": {"paper": list(RATES_HZ)},
    },
)


def cell_of(
    config: Config, rate_max_hz: int, depth: str, method: str, duration_s: float
) -> GridCell:
    """Return a cell of the grid with the frame loss and vendor of the configuration."""
    return GridCell(
        rate_max_hz=rate_max_hz,
        depth=depth,
        method=method,
        duration_s=duration_s,
        loss=config.loss,
        vendor=config.vendor,
    )


def grid(config: Config) -> list[GridCell]:
    """Return every cell: Rmax by DEPTH by method."""
    depths = [*map(str, config.depths), OPT_DEPTH]
    cells = []
    for rate, depth, method in product(config.rates_hz, depths, config.methods):
        cells.append(cell_of(config, rate, depth, method, config.duration_s))
    return cells


@exp.table("cell")
class TransmissionRow(TableRow):
    """A `TransmissionRow` is one cell of the grid with one seed, simulated.

    "Hello" goes from the robot to the station and back to the robot.
    """

    rate_max_hz: int  #: Rmax, the highest rate of a topic, Hz.
    depth: str  #: DEPTH as in the grid.
    method: str  #: Name of the method.
    seed: int  #: Seed of the run.
    rate_hz: float  #: Publishing rate of each topic, Hz.
    history_depth: int  #: Depth of each history, samples.
    published: int  #: Number of "Hello"s that were published.
    arrived: int  #: Number of "Hello"s that reached the actuation node.
    #: Median time from publication to actuation of the "Hello"s that arrived, ms; NaN if none arrived.
    latency_p50_ms: float
    data: int  #: Number of DATA frames, retransmissions included.
    heartbeats: int  #: Number of HEARTBEAT frames.
    acknacks: int  #: Number of ACKNACK frames.
    repeated: int  #: Number of DATA frames that are retransmissions.
    queue_full: int  #: Number of frames that were dropped by a full queue of their sender.
    air_share: float  #: Channel utilisation while messages were published.


@exp.sweep("cell", over=grid, workers=Workers(threads=True))
def simulate_cell(cell: GridCell, seed: int) -> dict[str, Any]:
    """Run one cell with one seed; threads are sufficient, because the run spends its time in compiled code."""
    scenario = scenario_of(cell, seed=seed)
    outcome = run(scenario, seed=seed)
    rate_hz, depth = rate_and_depth(cell)
    latency_ms = hello_latency_ms(outcome)
    counts = outcome.counts
    simulated_ns = (scenario.duration_s + scenario.drain_s) * NS_PER_S
    return {
        "rate_hz": rate_hz,
        "history_depth": depth,
        "published": len(outcome.flows[HELLO_UP].fate),
        "arrived": len(latency_ms),
        "latency_p50_ms": float(np.median(latency_ms)) if len(latency_ms) else float("nan"),
        "data": counts["data"],
        "heartbeats": counts["heartbeat"],
        "acknacks": counts["acknack"],
        "repeated": counts["repeated"],
        "queue_full": counts["queue_full"],
        "air_share": counts["airtime_ns"] / simulated_ns,
    }
