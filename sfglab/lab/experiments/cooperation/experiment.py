"""Rounds of three robots, simulated: the world, the nodes' cores, and the reliability model between them.

Deterministic: the same point and seed give the same run to the bit.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Literal, get_args

import numpy as np

from sfglab.arp import hallway
from sfglab.arp.hallway.simulation import (
    CDR_BEAM_BYTES,
    LAP_DEPTHS,
    OPTIMUM,
    ROBOT_TOPICS,
    ROBOTS,
    TABLE_BEAM_BYTES,
    LapResult,
    LapSettings,
    SimulatedLap,
    Snapshot,
    beam_flow,
    command_flow,
    rate_and_depth,
)
from sfglab.arp.robots import METHODS, RATES_HZ, Depth, Rate
from sfglab.fields import between
from sfglab.lab.bench import as_row
from sfglab.lab.experiment import Actor, Experiment, Link, Profiled, seeded
from sfglab.qos import DEFAULT
from sfglab.rtps import Medium, Outcome
from sfglab.units import NS_PER_S

if TYPE_CHECKING:
    from collections.abc import Iterable

    from numpy.typing import NDArray

Sizes = Literal["table", "cdr"]
BEAM_BYTES: dict[Sizes, int] = {"table": TABLE_BEAM_BYTES, "cdr": CDR_BEAM_BYTES}
"""A float, as paper B counts it (Table 1 and section 3.2), and in CDR with its header."""

_CONTRASTED = ("none", "LC", "OPT", "OPT+LC")
_MEDIUM = Medium()

MethodName = Literal["none", "OPT", "CC", "LC", "OPT+CC", "OPT+LC", "OPT+LC+CC"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Config(Profiled):
    """The whole run."""

    methods: tuple[MethodName, ...] = get_args(MethodName)  #: Names of methods.
    rates_hz: tuple[Rate, ...] = RATES_HZ  #: The values of Rmax.
    depths: tuple[Depth, ...] = LAP_DEPTHS  #: Depths without optimisation.
    loss: float = between(_MEDIUM.loss, 0.0, 0.3)  #: Share of frames that the air loses.
    #: Whose timing; the paper used Fast DDS.
    vendor: Literal["fast_dds", "cyclone_dds"] = "fast_dds"
    hop: bool = False  #: Whether commands go by robot 3's machine, as "Hello" does in Fig. 9.
    topics: tuple[int, ...] = ROBOT_TOPICS  #: T_a of Eq. 1, a robot each; section 3.1 has 8, 5, 5.
    sizes: Sizes = "table"  #: Sizes of beams' values: that of Table 1, Python's, or CDR's.
    slower: float = between(1.0, 0.1, 100.0, log=True)  #: How slow the station's computer is.
    seeds: int = 6  #: How many runs of each point.
    #: How many of each point of the contrasts: no loss, another vendor's timing, and the rate of Eq. 6 without
    #: its depth.
    contrast_seeds: int = 2
    live_s: float = 90.0  #: How long the live robots drive, seconds; 0: none is run.
    #: How long they drive on real Fast DDS, in each cell; the first corner comes before.
    ros2_s: float = 14.0
    ros2_repeats: int = 1  #: How often each of these cells is driven; 0: not.
    seed: int = 0  #: The first seed.


exp = Experiment(
    "cooperation",
    Config,
    where="B 3.2",
    smoke={"rates_hz": (100,), "seeds": 1, "contrast_seeds": 0, "live_s": 0.0, "ros2_repeats": 0},
    paper={"seeds": 120, "contrast_seeds": 30, "ros2_s": hallway.LIMIT_S, "ros2_repeats": 5},
    actors=(
        *(
            Actor(robot, host=robot, does="sensing and actuation nodes, its physics")
            for robot in ROBOTS
        ),
        Actor("station", host="station", does="localisation and planning"),
    ),
    links=tuple(
        link
        for robot in ROBOTS
        for link in (
            Link(robot, "station", "eight LIDAR beams", boundary="a lossy air"),
            Link("station", robot, "commands", boundary="a lossy air"),
        )
    ),
)


def points_of(config: Config) -> list[LapSettings]:
    """Return the points of Fig. 16, method by method."""
    of = {"vendor": config.vendor, "medium": replace(_MEDIUM, loss=config.loss), **_printed(config)}
    return [
        LapSettings(method=name, rate_max_hz=rate, depth=depth, **of)
        for name in config.methods
        for rate in config.rates_hz
        for depth in ((OPTIMUM,) if METHODS[name].optimised else config.depths)
    ]


def _printed(config: Config) -> dict[str, Any]:
    """Return those fields of `LapSettings` that say how much the scenario is that of the paper's words."""
    return {
        "relay_via_robot3": config.hop,
        "topics": config.topics,
        "beam_bytes": BEAM_BYTES[config.sizes],
        "compute_scale": config.slower,
    }


def contrasts_of(config: Config) -> list[LapSettings]:
    """Return the contrasts of the methods that matter, at the lowest and the highest Rmax.

    No loss; Cyclone DDS's timing; and of the optimisation only the rate, with ROS 2's default depth.
    """
    ends = {min(config.rates_hz), max(config.rates_hz)}
    points = [p for p in points_of(config) if p.method in _CONTRASTED and p.rate_max_hz in ends]
    lossless = [replace(point, medium=Medium(loss=0.0)) for point in points]
    cyclone = [replace(point, vendor="cyclone_dds") for point in points]
    return [
        *lossless,
        *cyclone,
        *(replace(p, depth=DEFAULT.depth) for p in points if p.depth == OPTIMUM),
    ]


# --- A run ----------------------------------------------------------------------------------------------------


@exp.table("course", "contrast")
@dataclass(frozen=True, slots=True, kw_only=True)
class CourseRow:
    """One simulated run: how it ended, and how its messages did."""

    method: str  #: One of `METHODS`.
    rate_max_hz: int  #: Rmax.
    depth: int  #: Option of Table 2; 0: the optimum.
    vendor: str  #: Name of the preset that times the protocol.
    loss: float  #: Share of frames that the medium lost.
    seed: int  #: Of physics and medium.
    rate_hz: float  #: At which each topic was sent.
    depth_used: int  #: Depth of the writers' history.
    end: str  #: An `End`.
    robot: str  #: Who failed, ``robot1`` to ``robot3``; empty: nobody, or nobody alone.
    ended_s: float  #: When.
    wound: float  #: Rounds that the slowest robot had come by then.
    airtime: float  #: Share of the time that the medium was taken.
    beams_sent: int  #: Beams' samples that were published.
    held: int  #: Values that local caches held back.
    compared: int  #: Values that cache control discarded.
    processed: int  #: Values that planning and actuation worked on.
    queue_full: int  #: Frames dropped because a host's queue was full.
    beams_lost: float  #: Share of the beams' samples that the station never had, or not by the end.
    #: Median time from a beam's publication until it was processed; NaN: nothing arrived.
    beam_p50_ms: float
    beam_p99_ms: float  #: The same, of which one in a hundred is longer.
    command_p50_ms: float  #: Median time from a command's publication until it was executed.
    command_p99_ms: float  #: The same, of which one in a hundred is longer.
    stale_s: float  #: Longest time that something sent was newer than what its reader had.
    stale_flow: str  #: Topic that it was on.


@exp.table("track")
@dataclass(frozen=True, slots=True)
class TrackRow:
    """Where a robot was, in one of the runs that are drawn."""

    run: str  #: ``success``, ``failure``, ``live`` or ``simulated`` (live's twin).
    robot: str  #: Its name.
    t_s: float  #: Since the start.
    x_m: float  #: To the right.
    y_m: float  #: Up.
    heading_rad: float  #: From x to y.
    manoeuvre: str  #: What the station had released.


BEAM_FLOWS = [beam_flow(robot, beam) for robot in ROBOTS for beam in range(len(hallway.BEAMS_DEG))]
COMMAND_FLOWS = [command_flow(robot) for robot in ROBOTS]


def course_row(settings: LapSettings, seed: int, lap: LapResult) -> CourseRow:
    """Return the row of a lap."""
    rate_hz, depth = rate_and_depth(settings)
    outcome = lap.outcome
    published = sum(len(outcome.flows[flow].fate) for flow in BEAM_FLOWS)
    beams_ms = _latencies_ms(outcome, BEAM_FLOWS)
    stale_s, stale_flow = _stalest(outcome, lap.ended_ns)
    row = {
        "loss": settings.medium.loss,
        "seed": seed,
        "rate_hz": rate_hz,
        "depth_used": depth,
        "end": lap.end.value,
        "robot": lap.robot,
        "ended_s": lap.ended_ns / NS_PER_S,
        "wound": lap.laps,
        "airtime": outcome.counts["airtime_ns"] / lap.ended_ns,
        "beams_sent": published,
        "beams_lost": 1 - len(beams_ms) / published if published else math.nan,
        **{name: outcome.counts[name] for name in ("held", "compared", "processed", "queue_full")},
        **_percentiles("beam", beams_ms),
        **_percentiles("command", _latencies_ms(outcome, COMMAND_FLOWS)),
        "stale_s": stale_s,
        "stale_flow": stale_flow,
    }
    made: CourseRow = as_row(CourseRow, row, settings)
    return made


def track_rows(name: str, snapshots: Iterable[Snapshot]) -> list[TrackRow]:
    """Return where the robots of a lap were, with the name under which it is drawn."""
    rows = []
    for snapshot in snapshots:
        time_s, manoeuvre = snapshot.time_s, snapshot.manoeuvre.value
        for robot, (x_m, y_m, heading) in zip(ROBOTS, snapshot.poses.tolist(), strict=True):
            rows.append(TrackRow(name, robot, time_s, x_m, y_m, heading, manoeuvre))
    return rows


def _latencies_ms(outcome: Outcome, flows: Iterable[str]) -> NDArray[np.float64]:
    return np.concatenate([outcome.flows[flow].latency_ns for flow in flows]) / 1e6


def _percentiles(name: str, samples_ms: NDArray[np.float64]) -> dict[str, float]:
    """Return the median and the 99th percentile by their columns; NaN of nothing."""
    found = (
        np.percentile(samples_ms, (50, 99)).tolist() if len(samples_ms) else (math.nan, math.nan)
    )
    return {f"{name}_p50_ms": found[0], f"{name}_p99_ms": found[1]}


def _stalest(outcome: Outcome, now_ns: int) -> tuple[float, str]:
    """Return the longest time that a reader was behind its writer, and on which flow.

    A reader is behind from the publication of the sample after the one that it has until it has a newer one; at
    the end, until the end.
    """
    worst, where = 0.0, ""
    for name, flow in outcome.flows.items():
        if not len(flow.fate):
            continue
        had = np.flatnonzero(flow.delivered)
        nexts = np.concatenate(([0], had + 1))
        until = np.concatenate((flow.received_ns[had], [now_ns]))
        known = nexts < len(flow.fate)
        behind = (until[known] - flow.published_ns[nexts[known]]).max(initial=0) / NS_PER_S
        if behind > worst:
            worst, where = float(behind), name
    return worst, where


def _ended_ns(row: CourseRow) -> int:
    return round(row.ended_s * NS_PER_S)


def driven(settings: LapSettings, seed: int) -> tuple[SimulatedLap, CourseRow]:
    """Drive a lap with a seed, its snapshots kept."""
    lap = SimulatedLap(settings, seed, record=True)
    return lap, course_row(settings, seed, lap.run())


def settings_of(row: Any, config: Config) -> LapSettings:
    """Return the settings of a `CourseRow` of a run, or of a line of their table."""
    names = ("method", "rate_max_hz", "depth", "vendor")
    given = {name: getattr(row, name) for name in names} | _printed(config)
    return LapSettings(**given, medium=Medium(loss=row.loss))


@exp.sweep(
    "contrast", over=contrasts_of, seeds=lambda c: seeded(c, c.contrast_seeds), at_ns=_ended_ns
)
@exp.sweep("course", over=points_of, at_ns=_ended_ns)
def run_point(settings: LapSettings, seed: int) -> CourseRow:
    """Run a lap with a seed."""
    return course_row(settings, seed, SimulatedLap(settings, seed).run())
