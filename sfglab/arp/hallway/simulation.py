"""The module `simulation` simulates a lap of three robots around the hallway: paper B, section 3.2, Fig. 12 to 18.

The class `SimulatedLap` connects the nodes and the physics of this package through the reliability model of
`sfglab.rtps`: the model decides which LIDAR values and commands arrive, and when. The same settings
and seed give the same lap to the bit.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cache
from typing import TYPE_CHECKING

import numpy as np

from sfglab.arp.balancing import Balance, BalanceInput, balance
from sfglab.arp.hallway.course import ROBOTS
from sfglab.arp.hallway.nodes import BEAMS_DEG, STOP, Command, range_from_step
from sfglab.arp.hallway.station import Manoeuvre, Station
from sfglab.arp.hallway.world import LIMIT_S, SCAN_STEPS, STEP_NS, End, Verdict, World, judge
from sfglab.arp.robots import METHODS, PLAN_S, TAKE_S, topic_qos
from sfglab.rtps import PRESETS, Flow, Medium, Outcome, Scenario, Session
from sfglab.units import NS_PER_S

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

LAP_DEPTHS = (1, 10, 1000)
"""Values of DEPTH for laps without OPT. The paper does not give the depth of Fig. 16, so the smallest value of
DEPTH, ROS 2's default and a large value count for a third each."""

OPTIMUM = 0  #: Value of `LapSettings.depth` that selects the depth of Eq. 6.

TABLE_BEAM_BYTES = 24
"""Size of a beam's value as paper B counts a float (Table 1 and section 3.2)."""

COMMAND_BYTES = 52  #: Size of a geometry_msgs/msg/Twist in CDR: six doubles and the header.

ROBOT_TOPICS = (len(BEAMS_DEG) + 1,) * len(ROBOTS)
"""T_a of Eq. 1 in the hallway: eight beams and one command per robot."""


@dataclass(frozen=True, slots=True, kw_only=True)
class LapSettings:
    """`LapSettings` has the method, the QoS and the channel of a simulated lap."""

    method: str  #: Name of the method, one of `METHODS`.
    rate_max_hz: int  #: Rmax of Table 2, Hz.
    depth: int  #: DEPTH of Table 2; `OPTIMUM` for the depth of Eq. 6, only with OPT.
    vendor: str = "fast_dds"  #: Name of the timing preset in `PRESETS`.
    medium: Medium = field(default_factory=Medium)  #: Wireless channel.


@dataclass(frozen=True, slots=True, kw_only=True)
class LapResult:
    """A `LapResult` has the end of a lap, and the delivery outcomes of the lap's messages."""

    end: End  #: End of the lap.
    robot: str  #: Name of the robot that failed; empty if no robot or no single robot failed.
    ended_ns: int  #: Time at which the lap ended, ns.
    outcome: Outcome  #: Delivery outcome per topic.


@dataclass(frozen=True, slots=True, kw_only=True)
class Snapshot:
    """A `Snapshot` is the state of a lap at one turn of the LIDARs, or at the end of the lap."""

    time_s: float  #: Time since the start, s.
    manoeuvre: Manoeuvre  #: Manoeuvre that the station released last.
    poses: NDArray[np.float64]  #: x, y (m) and heading (rad), shape (robots, 3).
    measured_m: NDArray[np.float64]  #: Ranges that the LIDARs measured, shape (robots, beams), m.
    believed_m: NDArray[np.float64]  #: Ranges that the station holds, shape (robots, beams), m.


def rate_and_depth(settings: LapSettings) -> tuple[float, int]:
    """Return the rate (Hz) and the history depth of each topic: the values of Table 2, or with OPT those of Eq. 6."""
    if not METHODS[settings.method].optimised:
        return float(settings.rate_max_hz), settings.depth
    best = _optimum(settings.rate_max_hz)
    # The solver's digits after the sixth digit are noise.
    depth = int(round(best.depth, 6)) if settings.depth == OPTIMUM else settings.depth
    return round(best.rate_hz, 6), depth


@cache
def _optimum(rate_max_hz: int) -> Balance:
    """Solve Eq. 6 once per problem: the solver takes longer than a second of a lap.

    The closed form would differ in the sixth digit, and so would each lap.
    """
    return balance(BalanceInput(topics=ROBOT_TOPICS, rate_max_hz=rate_max_hz))


def beam_flow(robot: str, beam: int) -> str:
    """Return the name of the topic of a robot's beam; the argument `beam` is the index of the beam."""
    return f"{robot}/lidar/{BEAMS_DEG[beam]}"


def command_flow(robot: str) -> str:
    """Return the name of the topic of a robot's commands."""
    return f"{robot}/command"


def scenario_of(settings: LapSettings, *, seed: int) -> Scenario:
    """Return the scenario of a lap with 27 topics on its channel; the seed selects the phase of each topic."""
    rate_hz, _ = rate_and_depth(settings)
    starts = np.random.default_rng((seed, 1)).uniform(0, 1 / rate_hz, sum(ROBOT_TOPICS))
    phases_s = iter(starts.tolist())
    beams = list(_beams(settings, phases_s))
    commands = list(_commands(settings, phases_s))
    return Scenario(
        flows=(*beams, *commands),
        medium=settings.medium,
        vendor=PRESETS[settings.vendor],
        duration_s=LIMIT_S,
        drain_s=0.0,
    )


def _beams(settings: LapSettings, phases_s: Iterator[float]) -> Iterator[Flow]:
    """Yield the topics from the robots to the station."""
    method = METHODS[settings.method]
    rate_hz, depth = rate_and_depth(settings)
    for robot in ROBOTS:
        for beam in range(len(BEAMS_DEG)):
            yield Flow(
                name=beam_flow(robot, beam),
                source=robot,
                target="station",
                size_bytes=TABLE_BEAM_BYTES,
                rate_hz=rate_hz,
                phase_s=next(phases_s),
                qos=topic_qos(rate_hz, depth),
                executor=f"{robot}/localisation",
                service_s=TAKE_S + PLAN_S,
                compare_s=TAKE_S if method.cache_control else None,
                cached=method.local_cache,
            )


def _commands(settings: LapSettings, phases_s: Iterator[float]) -> Iterator[Flow]:
    """Yield the topics from the station to the robots."""
    rate_hz, depth = rate_and_depth(settings)
    for robot in ROBOTS:
        yield Flow(
            name=command_flow(robot),
            source="station",
            target=robot,
            size_bytes=COMMAND_BYTES,
            rate_hz=rate_hz,
            phase_s=next(phases_s),
            qos=topic_qos(rate_hz, depth),
            executor=robot,
            service_s=TAKE_S,
        )


class SimulatedLap:
    """A `SimulatedLap` is a lap of three robots whose messages travel in the reliability model.

    Args:
        settings: Method, QoS and channel.
        seed: Seed of the physics, of the channel and of the topics' phases.
        record: Whether the lap keeps `snapshots`.
    """

    def __init__(self, settings: LapSettings, seed: int, *, record: bool = False) -> None:
        self._world = World(seed=seed)
        self._station = Station()
        self._measured: list[list[int]] = []  # of each robot's LIDAR, in its last turn
        self._executed = [STOP] * len(ROBOTS)  # last command that each robot received
        #: Index of robot and beam by topic.
        self._beams = {
            beam_flow(name, beam): (robot, beam)
            for robot, name in enumerate(ROBOTS)
            for beam in range(len(BEAMS_DEG))
        }
        #: Index of the robot by the name of its command topic.
        self._commands = {command_flow(name): robot for robot, name in enumerate(ROBOTS)}
        self._session = Session(scenario_of(settings, seed=seed), seed=seed)
        self._publish_commands()
        self._steps = 0
        self.verdict: Verdict | None = None  #: End of the lap; None before the end.
        self._record = record
        #: Snapshots of the lap: one per turn of the LIDARs and one at the end.
        self.snapshots: list[Snapshot] = []

    @property
    def time_s(self) -> float:
        """Time since the start, s."""
        return self._steps * STEP_NS / NS_PER_S

    def run(self) -> LapResult:
        """Drive until the lap ends, at `LIMIT_S` at the latest, and return its result."""
        self.drive(LIMIT_S)
        return self.result()

    def drive(self, until_s: float) -> bool:
        """Drive on until a time, s, and return whether the lap has ended by then; a later call continues."""
        while self.verdict is None and self.time_s < until_s:
            self._step()
        return self.verdict is not None

    def result(self) -> LapResult:
        """Return the result of a lap that has ended."""
        assert self.verdict is not None, "the lap has ended"
        robot = self.verdict.robot
        return LapResult(
            end=self.verdict.end,
            robot="" if robot < 0 else ROBOTS[robot],
            ended_ns=self._steps * STEP_NS,
            outcome=self._session.outcome(),
        )

    def _step(self) -> None:
        """Drive for `STEP_NS`."""
        if self._steps % SCAN_STEPS == 0:
            self._scan()
        self._steps += 1
        self._exchange(self._steps * STEP_NS)
        self._world.step(self._executed)
        self.verdict = judge(
            self._world.clearance_m.tolist(),
            self._world.wound_rad(),
            stopped_by=self._station.stopped_by,
        )
        if self.verdict is None and self.time_s >= LIMIT_S:
            self.verdict = Verdict(end=End.TIMEOUT)
        if self.verdict is not None:
            self._scan()

    def _scan(self) -> None:
        """Measure with the LIDARs, and set the new value of each beam's topic."""
        self._measured = [self._world.scan(robot) for robot in range(len(ROBOTS))]
        for flow, (robot, beam) in self._beams.items():
            self._session.set_value(flow, self._measured[robot][beam])
        if self._record:
            self._take_snapshot()

    def _exchange(self, until_ns: int) -> None:
        """Simulate the messages until a time, and give arriving messages to their readers."""
        while (delivery := self._session.advance(until_ns)) is not None:
            beam = self._beams.get(delivery.flow)
            if beam is None:
                robot = self._commands[delivery.flow]
                self._executed[robot] = Command.from_number(delivery.value)
            elif self._station.hear(*beam, delivery.value):
                self._publish_commands()

    def _publish_commands(self) -> None:
        for flow, command in zip(self._commands, self._station.commands, strict=True):
            self._session.set_value(flow, command.number)

    def _take_snapshot(self) -> None:
        measured_m = [[range_from_step(step) for step in steps] for steps in self._measured]
        believed_m = [node.ranges_m for node in self._station.localisations]
        self.snapshots.append(
            Snapshot(
                time_s=self.time_s,
                manoeuvre=self._station.manoeuvre,
                poses=self._world.poses.copy(),
                measured_m=np.array(measured_m),
                believed_m=np.array(believed_m),
            )
        )
