"""The module `cooperation.experiment` has configuration, tables and the sweep of simulated laps.

The same settings and seed give the same lap to the bit.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import product
from typing import TYPE_CHECKING, Any, Literal, get_args

from sfglab.arp.hallway import ROBOTS
from sfglab.arp.hallway.simulation import (
    LAP_DEPTHS,
    OPTIMUM,
    LapResult,
    LapSettings,
    SimulatedLap,
    Snapshot,
    rate_and_depth,
)
from sfglab.arp.robots import METHODS, RATES_HZ, Depth, MethodName, Rate
from sfglab.fields import between
from sfglab.lab.bench import TableRow
from sfglab.lab.experiment import Actor, Experiment, Link, Profiled
from sfglab.rtps import Medium
from sfglab.units import NS_PER_S

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

NONE = "none"  #: Name of a lap without any method.

_MEDIUM = Medium()
_CHANNEL = "lossy wireless channel"


@dataclass(frozen=True, slots=True, kw_only=True)
class Config(Profiled):
    """The `Config` has the settings of a run."""

    methods: tuple[MethodName, ...] = get_args(MethodName)  #: Methods of section 2.
    rates_hz: tuple[Rate, ...] = RATES_HZ  #: Values of Rmax, Hz.
    depths: tuple[Depth, ...] = LAP_DEPTHS  #: Values of DEPTH without OPT.
    loss: float = between(_MEDIUM.loss, 0.0, 0.3)  #: Share of frames that the channel loses.
    #: DDS implementation whose timing the protocol has; the paper used Fast DDS.
    vendor: Literal["fast_dds", "cyclone_dds"] = "fast_dds"
    seeds: int = 6  #: Number of laps with each method, rate and depth.
    live_s: float = 90.0  #: Largest duration of the live lap, s; 0: no live lap.
    seed: int = 0  #: Seed of the first lap.


exp = Experiment(
    "cooperation",
    Config,
    where="B 3.2",
    smoke={"rates_hz": (100,), "seeds": 1, "live_s": 0.0},
    paper={"seeds": 120},
    actors=(
        *(Actor(robot, robot, "sensing and actuation nodes, physics") for robot in ROBOTS),
        Actor("station", "station", "localisation and planning nodes"),
    ),
    links=(
        *(Link(robot, "station", "eight LIDAR beams", boundary=_CHANNEL) for robot in ROBOTS),
        *(Link("station", robot, "commands", boundary=_CHANNEL) for robot in ROBOTS),
    ),
)


@exp.table("course")
class CourseRow(TableRow):
    """A `CourseRow` is one simulated lap."""

    method: str  #: Name of a method in `METHODS`.
    rate_max_hz: int  #: Rmax, Hz.
    depth: int  #: DEPTH of Table 2; 0 for the depth of Eq. 6.
    vendor: str  #: Name of the preset that times the protocol.
    loss: float  #: Share of frames that the channel lost.
    seed: int  #: Seed of physics and channel.
    rate_hz: float  #: Rate at which each topic was sent, Hz.
    depth_used: int  #: Depth of the writers' histories.
    end: str  #: End of the lap, a value of `End`.
    #: Robot that failed, ``robot1`` to ``robot3``; empty if no robot or no single robot failed.
    robot: str
    ended_s: float  #: Time at which the lap ended, s.
    airtime: float  #: Share of the time that the channel was in use.


@exp.table("track")
class TrackRow(TableRow):
    """A `TrackRow` is the pose of a robot in a lap that a figure shows."""

    #: ``success``, ``failure``, ``live``, or ``simulated`` for the simulated lap beside the live lap.
    run: str
    robot: str  #: Name of the robot.
    t_s: float  #: Time since the start of the lap, s.
    x_m: float  #: Position on the x axis, to the right, m.
    y_m: float  #: Position on the y axis, upwards, m.
    heading_rad: float  #: Heading from x towards y, rad.
    manoeuvre: str  #: Manoeuvre that the station had released.


def settings_of(config: Config) -> list[LapSettings]:
    """Return the settings of Fig. 16, method by method."""
    medium = replace(_MEDIUM, loss=config.loss)
    settings = []
    for method in config.methods:
        depths = (OPTIMUM,) if METHODS[method].optimised else config.depths
        for rate_hz, depth in product(config.rates_hz, depths):
            point = LapSettings(
                method=method,
                rate_max_hz=rate_hz,
                depth=depth,
                vendor=config.vendor,
                medium=medium,
            )
            settings.append(point)
    return settings


def settings_of_row(row: Any) -> LapSettings:
    """Return the settings in a `CourseRow`, or in a line of the table of these rows."""
    return LapSettings(
        method=row.method,
        rate_max_hz=row.rate_max_hz,
        depth=row.depth,
        vendor=row.vendor,
        medium=Medium(loss=row.loss),
    )


def course_row(settings: LapSettings, seed: int, lap: LapResult) -> CourseRow:
    """Return the table row of a simulated lap with its settings and seed."""
    rate_hz, depth_used = rate_and_depth(settings)
    return CourseRow(
        method=settings.method,
        rate_max_hz=settings.rate_max_hz,
        depth=settings.depth,
        vendor=settings.vendor,
        loss=settings.medium.loss,
        seed=seed,
        rate_hz=rate_hz,
        depth_used=depth_used,
        end=lap.end.value,
        robot=lap.robot,
        ended_s=lap.ended_ns / NS_PER_S,
        airtime=lap.outcome.counts["airtime_ns"] / lap.ended_ns,
    )


def track_row(name: str, robot: str, t_s: float, pose: Sequence[float], manoeuvre: str) -> TrackRow:
    """Return the row of a robot's pose, x (m), y (m) and heading (rad), in the lap with a name."""
    x_m, y_m, heading_rad = pose
    return TrackRow(
        run=name,
        robot=robot,
        t_s=t_s,
        x_m=x_m,
        y_m=y_m,
        heading_rad=heading_rad,
        manoeuvre=manoeuvre,
    )


def track_rows(name: str, snapshots: Iterable[Snapshot]) -> list[TrackRow]:
    """Return one row per robot and snapshot with the robot's pose; `name` is the name of the lap."""
    rows = []
    for snapshot in snapshots:
        for robot, pose in zip(ROBOTS, snapshot.poses.tolist(), strict=True):
            manoeuvre = snapshot.manoeuvre.value
            rows.append(track_row(name, robot, snapshot.time_s, pose, manoeuvre))
    return rows


@exp.sweep("course", over=settings_of)
def simulate_lap(settings: LapSettings, seed: int) -> CourseRow:
    """Simulate a lap with a seed."""
    return course_row(settings, seed, SimulatedLap(settings, seed).run())
