"""Rounds of three robots, simulated: the world, the nodes' cores, and the reliability model between them.

Deterministic: the same point and seed give the same run to the bit.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Literal, get_args

import numpy as np

from sfglab.arp import hallway
from sfglab.arp.balancing import BalanceInput, balance
from sfglab.arp.robots import METHODS, PLAN_S, RATES_HZ, TAKE_S, Depth, Rate
from sfglab.fields import between
from sfglab.lab.bench import as_row
from sfglab.lab.experiment import Actor, Experiment, Link, Profiled, seeded
from sfglab.qos import DEFAULT, QoSProfile
from sfglab.rtps import PRESETS, Flow, Medium, Outcome, Scenario, Session
from sfglab.units import NS_PER_S

if TYPE_CHECKING:
    from collections.abc import Iterable

    from numpy.typing import NDArray

DEPTHS = (1, 10, 1000)
"""Of Table 2, without optimisation: the paper does not say which depth Fig. 16 had, so the smallest, ROS 2's
default and a large one count a third each."""

OPTIMUM = 0  #: Stands for the depth that Eq. 6 gives.

ROBOTS = tuple(area.robot for area in hallway.AREAS)
Sizes = Literal["table", "cdr"]
BEAM_BYTES: dict[Sizes, int] = {"table": 24, "cdr": 8}
"""A float, as paper B counts it (Table 1 and section 3.2), and in CDR with its header."""

COMMAND_BYTES = 52  #: A geometry_msgs/msg/Twist in CDR: six doubles and the header.

_TOPICS = (len(hallway.BEAMS_DEG) + 1,) * len(hallway.AREAS)  # eight beams and one command each
_RELAY = ROBOTS[2]
_CONTRASTED = ("none", "LC", "OPT", "OPT+LC")
_MEDIUM = Medium()
_SCAN_STEPS = round(NS_PER_S / hallway.SCAN_HZ / hallway.STEP_NS)

MethodName = Literal["none", "OPT", "CC", "LC", "OPT+CC", "OPT+LC", "OPT+LC+CC"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Config(Profiled):
    """The whole run."""

    methods: tuple[MethodName, ...] = get_args(MethodName)  #: Names of methods.
    rates_hz: tuple[Rate, ...] = RATES_HZ  #: The values of Rmax.
    depths: tuple[Depth, ...] = DEPTHS  #: Depths without optimisation.
    loss: float = between(_MEDIUM.loss, 0.0, 0.3)  #: Share of frames that the air loses.
    #: Whose timing; the paper used Fast DDS.
    vendor: Literal["fast_dds", "cyclone_dds"] = "fast_dds"
    hop: bool = False  #: Whether commands go by robot 3's machine, as "Hello" does in Fig. 9.
    topics: tuple[int, ...] = _TOPICS  #: T_a of Eq. 1, a robot each; section 3.1 has 8, 5, 5.
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


@dataclass(frozen=True, slots=True, kw_only=True)
class Point:
    """One cell: a method at a rate and a depth, over one medium."""

    method: str  #: One of `METHODS`.
    rate_max_hz: int  #: Rmax.
    depth: int  #: Of Table 2; `OPTIMUM`: D of Eq. 6, only with OPT.
    vendor: str = "fast_dds"  #: A name in `PRESETS`.
    medium: Medium = _MEDIUM  #: What carries the frames.
    hop: bool = False  #: Whether commands to the others go by robot 3's machine.
    topics: tuple[int, ...] = _TOPICS  #: T_a of Eq. 1, a robot each.
    sizes: Sizes = "table"  #: A key of `BEAM_BYTES`.
    #: How many times as long as `PLAN_S` and `TAKE_S` the station's computer takes.
    slower: float = 1.0


def rate_and_depth(point: Point) -> tuple[float, int]:
    """Return each topic's rate, Hz, and each history's depth: those of Table 2, or with OPT those of Eq. 6."""
    if not METHODS[point.method].optimised:
        return float(point.rate_max_hz), point.depth
    best = balance(BalanceInput(topics=point.topics, rate_max_hz=float(point.rate_max_hz)))
    # The solver's digits end somewhere; beyond the sixth they are noise.
    depth = int(round(best.depth, 6)) if point.depth == OPTIMUM else point.depth
    return round(best.rate_hz, 6), depth


def points_of(config: Config) -> list[Point]:
    """Return the points of Fig. 16, method by method."""
    of = {"vendor": config.vendor, "medium": replace(_MEDIUM, loss=config.loss), **_printed(config)}
    return [
        Point(method=name, rate_max_hz=rate, depth=depth, **of)
        for name in config.methods
        for rate in config.rates_hz
        for depth in ((OPTIMUM,) if METHODS[name].optimised else config.depths)
    ]


def _printed(config: Config) -> dict[str, Any]:
    """Return those fields of a `Point` that say how much the scenario is that of the paper's words."""
    return {name: getattr(config, name) for name in ("hop", "topics", "sizes", "slower")}


def contrasts_of(config: Config) -> list[Point]:
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


# --- A point's topics -----------------------------------------------------------------------------------------


def scenario_of(point: Point, *, seed: int) -> Scenario:
    """Return a point's topics over its medium; the seed says when in its period each of the 27 begins."""
    method, (rate_hz, depth) = METHODS[point.method], rate_and_depth(point)
    phases = iter(
        np.random.default_rng((seed, 1)).uniform(0, 1 / rate_hz, 9 * len(ROBOTS)).tolist()
    )
    qos = QoSProfile(depth=depth, deadline_ns=round(NS_PER_S / rate_hz))
    beams = [
        Flow(
            name=beam_flow(robot, beam),
            source=robot,
            target="station",
            size_bytes=BEAM_BYTES[point.sizes],
            rate_hz=rate_hz,
            phase_s=next(phases),
            qos=qos,
            executor=f"{robot}/localisation",
            service_s=point.slower * (TAKE_S + PLAN_S),
            compare_s=point.slower * TAKE_S if method.cache_control else None,
            cached=method.local_cache,
        )
        for robot in ROBOTS
        for beam in range(len(hallway.BEAMS_DEG))
    ]
    commands = [
        Flow(
            name=command_flow(robot),
            source="station",
            target=robot,
            size_bytes=COMMAND_BYTES,
            rate_hz=rate_hz,
            phase_s=next(phases),
            qos=qos,
            executor=robot,
            service_s=TAKE_S,
        )
        for robot in ROBOTS
    ]
    return Scenario(
        flows=(*beams, *(_hopped(commands) if point.hop else commands)),
        medium=point.medium,
        vendor=PRESETS[point.vendor],
        duration_s=hallway.LIMIT_S,
        drain_s=0.0,
    )


def _hopped(commands: list[Flow]) -> list[Flow]:
    """Return commands of which those to the others go to robot 3 first, which sends each on when it has it."""
    flows = []
    for command in commands:
        if command.target == _RELAY:
            flows.append(command)
            continue
        first = replace(command, name=_to_relay(command.target), target=_RELAY, executor=_RELAY)
        flows.append(replace(first, service_s=TAKE_S + PLAN_S, then=command.name))
        flows.append(replace(command, source=_RELAY, rate_hz=0.0, phase_s=0.0))
    return flows


def _to_relay(robot: str) -> str:
    return f"{robot}/release"


def beam_flow(robot: str, beam: int) -> str:
    """Return the name of a beam's topic."""
    return f"{robot}/lidar/{hallway.BEAMS_DEG[beam]}"


def command_flow(robot: str) -> str:
    """Return the name of the topic of a robot's commands."""
    return f"{robot}/command"


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


class SimulatedRun:
    """A run that can be watched.

    With a name in `tracked` each turn of the LIDAR is kept, in `tracks`. The carrier of messages is one like a
    `Session`, by default one of the reliability model.
    """

    def __init__(self, point: Point, seed: int, *, tracked: str = "", carrier: Any = None) -> None:
        self._point, self._seed = point, seed
        self._world = hallway.World(seed=seed)
        self._station = hallway.Station(len(ROBOTS))
        self._sensing = [hallway.SensingNode() for _ in ROBOTS]
        self._actuation = [hallway.ActuationNode() for _ in ROBOTS]
        self._beams = {
            beam_flow(name, beam): (robot, beam)
            for robot, name in enumerate(ROBOTS)
            for beam in range(len(hallway.BEAMS_DEG))
        }
        self._commands = {command_flow(name): robot for robot, name in enumerate(ROBOTS)}
        #: What the station publishes, a robot each.
        self._told = [
            _to_relay(r) if point.hop and r != _RELAY else command_flow(r) for r in ROBOTS
        ]
        # Nodes that hear the same again do nothing.
        watched = (*self._beams, *self._commands)
        scenario = scenario_of(point, seed=seed)
        self._session = carrier or Session(scenario, seed=seed, watched=watched, news_only=True)
        self._tracked = tracked
        self.tracks: list[TrackRow] = []
        #: With each turn's tracks: ranges as the LIDARs measure them, and as the station has them, metres,
        #: shape (2, robots, beams).
        self.beliefs: list[NDArray[np.float64]] = []

    def run(self, limit_s: float = hallway.LIMIT_S) -> CourseRow:
        """Drive until it ends, or is given up."""
        return self.row(*self.drive(limit_s), self._session.outcome())

    def drive(self, limit_s: float) -> tuple[hallway.Verdict, int]:
        """Drive, and return how and when it ended, or was given up."""
        for flow in self._told:
            self._session.set_value(flow, hallway.STOP.number)
        steps, verdict = 0, None
        while verdict is None:
            if steps % _SCAN_STEPS == 0:
                self._scan(steps * hallway.STEP_NS / NS_PER_S)
            steps += 1
            self._exchange(steps * hallway.STEP_NS)
            self._world.step([node.command for node in self._actuation])
            clearances, wound = self._world.clearance_m.tolist(), self._world.wound_rad()
            now_s, stopped_by = steps * hallway.STEP_NS / NS_PER_S, self._station.stopped_by
            verdict = hallway.judge(
                clearances, wound, stopped_by=stopped_by, now_s=now_s, limit_s=limit_s
            )
        self._track(steps * hallway.STEP_NS / NS_PER_S)
        return verdict, steps * hallway.STEP_NS

    def _scan(self, now_s: float) -> None:
        for robot, node in enumerate(self._sensing):
            node.turned(self._world.scan(robot))
        for flow, (robot, beam) in self._beams.items():
            value = self._sensing[robot].value(beam)
            assert value is not None, "the LIDAR has turned"
            self._session.set_value(flow, value)
        self._track(now_s)

    def _exchange(self, until_ns: int) -> None:
        """Let messages travel, and hand over what arrives."""
        session = self._session
        while (delivery := session.advance(until_ns)) is not None:
            place = self._beams.get(delivery.flow)
            if place is None:
                robot = self._commands[delivery.flow]
                self._actuation[robot].hear(hallway.Command.from_number(delivery.value))
            elif self._station.hear(*place, delivery.value):
                for robot, flow in enumerate(self._told):
                    session.set_value(flow, self._station.commands[robot].number)

    def _track(self, now_s: float) -> None:
        if not self._tracked:
            return
        manoeuvre = self._station.manoeuvre.value
        for robot, (x_m, y_m, heading_rad) in zip(ROBOTS, self._world.poses.tolist(), strict=True):
            self.tracks.append(
                TrackRow(self._tracked, robot, now_s, x_m, y_m, heading_rad, manoeuvre)
            )
        steps = [
            [node.value(beam) or 0 for beam in range(len(hallway.BEAMS_DEG))]
            for node in self._sensing
        ]
        measured = [[hallway.range_from_step(step) for step in robot] for robot in steps]
        believed = [localisation.ranges_m for localisation in self._station.localisations]
        self.beliefs.append(np.array([measured, believed]))

    def row(self, verdict: hallway.Verdict, now_ns: int, outcome: Outcome) -> CourseRow:
        """Return what a run was that ended so, and whose messages came to this."""
        rate_hz, depth = rate_and_depth(self._point)
        published = sum(len(outcome.flows[flow].fate) for flow in self._beams)
        beams_ms, commands_ms = (
            _latencies_ms(outcome, self._beams),
            _latencies_ms(outcome, self._commands),
        )
        stale_s, stale_flow = _stalest(outcome, now_ns)
        row = {
            "loss": self._point.medium.loss,
            "seed": self._seed,
            "rate_hz": rate_hz,
            "depth_used": depth,
            "end": verdict.end.value,
            "robot": "" if verdict.robot < 0 else ROBOTS[verdict.robot],
            "ended_s": now_ns / NS_PER_S,
            "wound": min(self._world.wound_rad()) / math.tau,
            "airtime": outcome.counts["airtime_ns"] / now_ns,
            "beams_sent": published,
            "beams_lost": 1 - len(beams_ms) / published if published else math.nan,
            **{
                name: outcome.counts[name]
                for name in ("held", "compared", "processed", "queue_full")
            },
            **_percentiles("beam", beams_ms),
            **_percentiles("command", commands_ms),
            "stale_s": stale_s,
            "stale_flow": stale_flow,
        }
        made: CourseRow = as_row(CourseRow, row, self._point)
        return made


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


def driven(point: Point, seed: int) -> tuple[SimulatedRun, CourseRow]:
    """Drive a point with a seed, its tracks and beliefs kept."""
    run = SimulatedRun(point, seed, tracked="driven")
    return run, run.run()


def point_of(row: Any, config: Config) -> Point:
    """Return the point of a `CourseRow` of a run, or of a line of their table."""
    names = ("method", "rate_max_hz", "depth", "vendor")
    given = {name: getattr(row, name) for name in names} | _printed(config)
    return Point(**given, medium=Medium(loss=row.loss))


@exp.sweep(
    "contrast", over=contrasts_of, seeds=lambda c: seeded(c, c.contrast_seeds), at_ns=_ended_ns
)
@exp.sweep("course", over=points_of, at_ns=_ended_ns)
def run_point(point: Point, seed: int) -> CourseRow:
    """Run a point with a seed."""
    return SimulatedRun(point, seed).run()
