"""One simulated run: the world, the nodes' cores, and the reliability model that carries their messages.

The only coupling between control and communication is what the model delivers and when. Deterministic: the same
point and seed give the same run to the bit.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from sfglab.arp.hallway import (
    AREAS,
    BEAMS_DEG,
    LIMIT_S,
    SCAN_HZ,
    STEP_NS,
    STOP,
    ActuationNode,
    Command,
    SensingNode,
    Station,
    Verdict,
    World,
    judge,
)
from sfglab.arp.robots import METHODS, PLAN_S, TAKE_S
from sfglab.lab.experiments.cooperation.config import setting_of
from sfglab.lab.experiments.cooperation.rows import CourseRow, TrackRow
from sfglab.qos import QoSProfile
from sfglab.rtps import PRESETS, Flow, Scenario, Session

if TYPE_CHECKING:
    from sfglab.lab.experiments.cooperation.config import Point
    from sfglab.rtps import Outcome


ROBOTS = tuple(area.robot for area in AREAS)
BEAM_BYTES = 24
"""A float, as paper B counts it (Table 1 and section 3.2)."""

COMMAND_BYTES = 52
"""A geometry_msgs/msg/Twist in CDR: six doubles and the header."""

_SCAN_STEPS = round(1e9 / SCAN_HZ / STEP_NS)
_S = 1e9


def beam_flow(robot: str, beam: int) -> str:
    """Return the name of a beam's topic."""
    return f"{robot}/lidar/{BEAMS_DEG[beam]}"


def command_flow(robot: str) -> str:
    """Return the name of the topic of a robot's commands."""
    return f"{robot}/command"


def scenario_of(point: Point, *, seed: int) -> Scenario:
    """Return a point's topics over its medium.

    Args:
        point: The point.
        seed: Of when in its period each topic begins: nobody starts 27 nodes in step.
    """
    method, setting = METHODS[point.method], setting_of(point)
    deadline_ns = round(_S / setting.rate_hz)
    qos = QoSProfile(depth=setting.depth, deadline_ns=deadline_ns)
    phases = iter(np.random.default_rng((seed, 1)).uniform(0, 1 / setting.rate_hz, 9 * len(ROBOTS)).tolist())
    beams = [
        Flow(
            name=beam_flow(robot, beam),
            source=robot,
            target="station",
            size_bytes=BEAM_BYTES,
            rate_hz=setting.rate_hz,
            phase_s=next(phases),
            qos=qos,
            executor=f"{robot}/localisation",
            service_s=TAKE_S + PLAN_S,
            compare_s=TAKE_S if method.cache_control else None,
            cached=method.local_cache,
        )
        for robot in ROBOTS
        for beam in range(len(BEAMS_DEG))
    ]
    commands = [
        Flow(
            name=command_flow(robot),
            source="station",
            target=robot,
            size_bytes=COMMAND_BYTES,
            rate_hz=setting.rate_hz,
            phase_s=next(phases),
            qos=qos,
            executor=robot,
            service_s=TAKE_S,
        )
        for robot in ROBOTS
    ]
    return Scenario(
        flows=(*beams, *commands),
        medium=point.medium,
        vendor=PRESETS[point.vendor],
        duration_s=LIMIT_S,
        drain_s=0.0,
    )


@dataclass(frozen=True, slots=True)
class _Scans:
    """Sensing of one robot."""

    node: SensingNode
    flows: tuple[str, ...]


class SimulatedRun:
    """A run that can be watched.

    Args:
        point: The point.
        seed: Of physics and medium.
        tracked: Name of the run whose tracks are kept; empty: none.

    Attributes:
        tracks: Where every robot was at each turn of the LIDAR, if tracked.
    """

    def __init__(self, point: Point, seed: int, *, tracked: str = "") -> None:
        self._point, self._seed = point, seed
        self._world = World(seed=seed)
        self._station = Station(len(ROBOTS))
        self._sensing = [
            _Scans(SensingNode(), tuple(beam_flow(robot, beam) for beam in range(len(BEAMS_DEG))))
            for robot in ROBOTS
        ]
        self._actuation = [ActuationNode() for _ in ROBOTS]
        self._session = Session(scenario_of(point, seed=seed), seed=seed)
        self._beams = {
            flow: (r, beam) for r, scans in enumerate(self._sensing) for beam, flow in enumerate(scans.flows)
        }
        self._commands = {command_flow(robot): r for r, robot in enumerate(ROBOTS)}
        self._last = [STOP.number] * len(ROBOTS)
        self._tracked = tracked
        self.tracks: list[TrackRow] = []

    def run(self, limit_s: float = LIMIT_S) -> CourseRow:
        """Drive until it ends.

        Args:
            limit_s: When it is given up.
        """
        for flow in self._commands:
            self._session.set_value(flow, STOP.number)
        steps, verdict = 0, None
        while verdict is None:
            if steps % _SCAN_STEPS == 0:
                self._scan(steps * STEP_NS / _S)
            steps += 1
            self._exchange(steps * STEP_NS)
            self._world.step([node.command for node in self._actuation])
            verdict = judge(
                self._world.clearance_m.tolist(),
                self._world.wound_rad().tolist(),
                stopped_by=self._station.stopped_by,
                now_s=steps * STEP_NS / _S,
                limit_s=limit_s,
            )
        self._track(steps * STEP_NS / _S)
        return self._row(verdict, steps * STEP_NS)

    def _scan(self, now_s: float) -> None:
        for robot, scans in enumerate(self._sensing):
            scans.node.turned(self._world.scan(robot))
            for beam, flow in enumerate(scans.flows):
                value = scans.node.value(beam)
                assert value is not None, "the LIDAR has turned"
                self._session.set_value(flow, value)
        self._track(now_s)

    def _exchange(self, until_ns: int) -> None:
        """Let messages travel, and hand over what arrives."""
        session = self._session
        while (delivery := session.advance(until_ns)) is not None:
            if delivery.repeated:
                continue
            place = self._beams.get(delivery.flow)
            if place is None:
                robot = self._commands[delivery.flow]
                if delivery.value != self._last[robot]:  # unpacking costs more than comparing
                    self._last[robot] = delivery.value
                    self._actuation[robot].hear(Command.from_number(delivery.value))
            elif self._station.hear(*place, delivery.value):
                for flow, robot in self._commands.items():
                    session.set_value(flow, self._station.commands[robot].number)

    def _track(self, now_s: float) -> None:
        if not self._tracked:
            return
        manoeuvre = self._station.manoeuvre.value
        self.tracks += [
            TrackRow(
                run=self._tracked,
                robot=robot,
                t_s=now_s,
                x_m=float(x),
                y_m=float(y),
                heading_rad=float(heading),
                manoeuvre=manoeuvre,
            )
            for robot, (x, y, heading) in zip(ROBOTS, self._world.poses, strict=True)
        ]

    def _row(self, verdict: Verdict, now_ns: int) -> CourseRow:
        point, setting, outcome = self._point, setting_of(self._point), self._session.outcome()
        beams = _latencies_ms(outcome, list(self._beams))
        commands = _latencies_ms(outcome, list(self._commands))
        published = sum(len(outcome.flows[flow].fate) for flow in self._beams)
        stale_s, stale_flow = _stalest(outcome, now_ns)
        return CourseRow(
            method=point.method,
            rate_max_hz=point.rate_max_hz,
            depth=point.depth,
            vendor=point.vendor,
            loss=point.medium.loss,
            seed=self._seed,
            rate_hz=setting.rate_hz,
            depth_used=setting.depth,
            end=verdict.end.value,
            robot="" if verdict.robot < 0 else ROBOTS[verdict.robot],
            ended_s=now_ns / _S,
            wound=float(self._world.wound_rad().min() / math.tau),
            airtime=outcome.counts["airtime_ns"] / now_ns,
            beams_sent=published,
            held=outcome.counts["held"],
            compared=outcome.counts["compared"],
            processed=outcome.counts["processed"],
            queue_full=outcome.counts["queue_full"],
            beams_lost=1 - len(beams) / published if published else math.nan,
            beam_p50_ms=_percentile(beams, 50),
            beam_p99_ms=_percentile(beams, 99),
            command_p50_ms=_percentile(commands, 50),
            command_p99_ms=_percentile(commands, 99),
            stale_s=stale_s,
            stale_flow=stale_flow,
        )


def _latencies_ms(outcome: Outcome, flows: list[str]) -> np.ndarray:
    return np.concatenate([outcome.flows[flow].latency_ns for flow in flows]) / 1e6


def _percentile(samples: np.ndarray, share: float) -> float:
    return float(np.percentile(samples, share)) if len(samples) else math.nan


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
        behind = (until[known] - flow.published_ns[nexts[known]]).max(initial=0) / _S
        if behind > worst:
            worst, where = float(behind), name
    return worst, where


def run_point(point: Point, seed: int) -> CourseRow:
    """Run a point with a seed: the sweep's task."""
    return SimulatedRun(point, seed).run()
