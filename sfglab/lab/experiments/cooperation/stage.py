"""The runs that are drawn, and the live drive: the same nodes on four hosts, over DDS and a lossy radio.

Drawn runs stand in the log as ROS messages too: ``/<run>/<robot>/pose``, ``/scan``, and walls as markers. Live,
physics runs in real time beside the nodes. On real Fast DDS physics and cores run here, and what one hears of
another goes from a ROS 2 node on its host to one on the other's.
"""

from __future__ import annotations

import asyncio
import heapq
import math
import time
from contextlib import suppress
from dataclasses import asdict, replace
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from sfglab.arp import hallway
from sfglab.arp.hallway.course import scan
from sfglab.arp.hallway.simulation import (
    LAP_DEPTHS,
    OPTIMUM,
    ROBOTS,
    LapSettings,
    SimulatedLap,
    rate_and_depth,
    scenario_of,
)
from sfglab.arp.robots import METHODS, RATES_HZ
from sfglab.bus.address import BusAddress
from sfglab.lab.baselines import PART, REAL, declare
from sfglab.lab.experiments.cooperation.experiment import (
    Config,
    CourseRow,
    TrackRow,
    course_row,
    driven,
    exp,
    points_of,
    settings_of,
    track_rows,
)
from sfglab.lab.hosts import Host, Network, RadioCounters
from sfglab.lab.live_flows import LiveHosts, cells_part, play_missing, slowed
from sfglab.lab.workers.hallway import STATION, HallwayConfig
from sfglab.messages import default_message, message_type
from sfglab.processes import Member, ProcessFailedError, ProcessGroup
from sfglab.rtps.session import Delivery
from sfglab.spatial import Pose, StampedTransform
from sfglab.spatial.poses import header_msg
from sfglab.units import NS_PER_S

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from sfglab.component import Report
    from sfglab.lab.bench import Bench
    from sfglab.record import LogWriter
    from sfglab.rtps import Scenario

# --- Runs that are drawn --------------------------------------------------------------------------------------


def examples_of(rows: Sequence[CourseRow]) -> dict[str, CourseRow]:
    """Return the runs that are drawn: the first in the sweep's order that the paper's Fig. 17 and 18 speak of.

    A success with optimisation and local cache, else with any method; a failure without either, else of any.
    """
    examples = {}
    for name, method in (("success", "OPT+LC"), ("failure", "none")):
        ended = [
            row for row in rows if (row.end == hallway.End.SUCCESS.value) == (name == "success")
        ]
        if ended:
            examples[name] = next((row for row in ended if row.method == method), ended[0])
    return examples


@exp.part("drawn runs")
def drive_again(bench: Bench[Config]) -> None:
    """Drive the runs that are drawn again, and write their tracks and messages."""
    examples = examples_of(bench.rows["course"])
    bench.metadata("examples", {name: asdict(row) for name, row in examples.items()})
    for name, row in examples.items():
        lap, again = driven(settings_of(row, bench.config), row.seed)
        # Written out, because a NaN is not equal to itself.
        assert repr(again) == repr(row), "the same point and seed are the same run"
        tracks = track_rows(name, lap.snapshots)
        _write_tracks(bench, tracks)
        _write_messages(bench.log, tracks)


def _write_tracks(bench: Bench[Config], tracks: Sequence[TrackRow]) -> None:
    for track in tracks:
        bench.write("track", track, at_ns=round(track.t_s * NS_PER_S))


# --- Their messages -------------------------------------------------------------------------------------------

AREA_SHIFT_M = 7.0  #: How far apart areas are drawn, to the right.
_BY_ROBOT = {area.robot: (AREA_SHIFT_M * number, area) for number, area in enumerate(hallway.AREAS)}


def scan_at(area: hallway.Area, x: float, y: float, heading: float) -> NDArray[np.float64]:
    """Return what a robot's LIDAR measures at a pose, metres, infinity without an echo, shape (beams,)."""
    ranges = np.empty(len(hallway.BEAMS_DEG))
    scan(area.segments, np.array((x, y, heading)), np.radians(hallway.BEAMS_DEG), ranges)
    return np.array(
        [hallway.range_from_step(hallway.step_from_range(range_m)) for range_m in ranges]
    )


def _write_messages(log: LogWriter, tracks: Sequence[TrackRow]) -> None:
    """Write a run's tracks as poses, scans and transforms, and its walls."""
    for area in hallway.AREAS if tracks else ():
        log.write(f"/{tracks[0].run}/{area.robot}/walls", _walls(area), log_time_ns=0)
    stamped, transforms = (
        message_type("geometry_msgs/msg/PoseStamped"),
        message_type("tf2_msgs/msg/TFMessage"),
    )
    for track in tracks:
        now_ns, frame = round(track.t_s * NS_PER_S), f"{track.run}/{track.robot}"
        pose = Pose.from_yaw(
            (track.x_m + _BY_ROBOT[track.robot][0], track.y_m, 0.0), track.heading_rad
        )
        at = StampedTransform(parent="map", child=frame, stamp_ns=now_ns, pose=pose)
        posed = stamped(header=header_msg("map", now_ns), pose=pose.to_pose_msg())
        log.write(f"/{frame}/pose", posed, log_time_ns=now_ns)
        log.write(f"/{frame}/scan", _scan(track, frame, now_ns), log_time_ns=now_ns)
        log.write("/tf", transforms(transforms=[at.to_msg()]), log_time_ns=now_ns)


def _scan(track: TrackRow, frame: str, now_ns: int) -> Any:
    return default_message(
        "sensor_msgs/msg/LaserScan",
        header=header_msg(frame, now_ns),
        angle_max=np.float32(math.radians(hallway.BEAMS_DEG[-1])),
        angle_increment=np.float32(math.radians(hallway.BEAMS_DEG[1])),
        scan_time=np.float32(0.1),
        range_min=np.float32(0.15),
        range_max=np.float32(12.0),
        ranges=scan_at(_BY_ROBOT[track.robot][1], track.x_m, track.y_m, track.heading_rad).astype(
            np.float32
        ),
    )


def _walls(area: hallway.Area) -> Any:
    """Return both ends of every wall, one after the other, where the area is drawn."""
    kind = message_type("visualization_msgs/msg/Marker")
    message = default_message(kind, header=header_msg("map", 0), ns=area.robot, type=kind.LINE_LIST)
    message.scale.x = 0.02
    message.color.r = message.color.g = message.color.b = np.float32(0.6)
    message.color.a = np.float32(1.0)
    shift, point = _BY_ROBOT[area.robot][0], message_type("geometry_msgs/msg/Point")
    message.points = [
        point(x=x + shift, y=y, z=0.0) for x, y in area.segments.reshape(-1, 2).tolist()
    ]
    return message


# --- Live -----------------------------------------------------------------------------------------------------

LIVE_POINT = LapSettings(method="OPT+LC", rate_max_hz=100, depth=OPTIMUM, vendor="cyclone_dds")
"""What is driven live, and simulated beside it: the live bus is Cyclone DDS."""
DOMAIN = 47
_POLL_S = 0.1
_NO_END = "the time was over"


@exp.part("live")
async def drive(bench: Bench[Config]) -> None:
    """Drive live and simulate the same; the metadata ``live`` says what came of it."""
    config, capability = bench.config, Network.available()
    if not config.live_s or bench.options.separate is False:
        return bench.metadata("live", {"hosts": "no live drive was asked for"})
    if not capability.ok:
        return bench.metadata("live", {"hosts": f"no live drive: {capability.reason}"})
    live = await drive_live(LIVE_POINT, config.seed, seconds=config.live_s)
    twin = SimulatedLap(LIVE_POINT, config.seed, record=True)
    row = course_row(LIVE_POINT, config.seed, twin.run(limit_s=config.live_s))
    _write_tracks(bench, live.tracks)
    _write_tracks(bench, track_rows("simulated", twin.snapshots))
    assert live.radio is not None, "the live drive was on the radio"
    said = {
        "hosts": f"separate hosts: network namespaces ({capability.how})",
        "end": live.verdict.end.value if live.verdict else _NO_END,
        "lasted_s": live.lasted_s,
        "held": live.held,
        "radio": live.radio.said(),
        "kept_up": live.radio.kept_up,
        "simulated_end": _NO_END if row.end == hallway.End.TIMEOUT.value else row.end,
        "simulated_held": row.held / (row.held + row.beams_sent),
    }
    return bench.metadata("live", said)


class LiveDrive:
    """What the processes of a live drive have said so far."""

    def __init__(self) -> None:
        self.tracks: list[TrackRow] = []  #: Where every robot was at each turn of its LIDAR.
        #: How it ended; None: it did not, or the time was over.
        self.verdict: hallway.Verdict | None = None
        self.radio: RadioCounters | None = None  #: What the radio did; None before the end.
        self._last: dict[str, Report] = {}
        self._stopped_by: int | None = None
        self._manoeuvre = hallway.Manoeuvre.STOP.value

    def take(self, name: str, report: Report) -> None:
        """Take a report."""
        if report["is"] == "stopped":
            self._stopped_by = report["robot"]
        elif report["is"] == "released":
            self._manoeuvre = report["manoeuvre"]
        elif report["is"] == "pose":
            self._last[name] = report
            x_m, y_m, heading_rad = report["pose"]
            self.tracks.append(
                TrackRow("live", name, report["t_s"], x_m, y_m, heading_rad, self._manoeuvre)
            )

    def ended(self) -> bool:
        """Judge, and return whether it has ended."""
        if len(self._last) == len(ROBOTS):
            clearances, wound = (
                [self._last[r][what] for r in ROBOTS] for what in ("clearance_m", "wound_rad")
            )
            self.verdict = hallway.judge(clearances, wound, stopped_by=self._stopped_by, now_s=0.0)
        return self.verdict is not None

    @property
    def lasted_s(self) -> float:
        """How long it was driven, seconds."""
        return max((report["t_s"] for report in self._last.values()), default=0.0)

    @property
    def held(self) -> float:
        """Share of values that the local caches held back."""
        offered = sum(report["offered"] for report in self._last.values())
        return sum(report["held"] for report in self._last.values()) / offered if offered else 0.0


async def drive_live(point: LapSettings, seed: int, *, seconds: float) -> LiveDrive:
    """Drive live for so many seconds at most, on hosts of their own; the DDS that is there times the protocol.

    Raises:
        HostsUnavailableError: This machine has no network namespaces.
        ProcessFailedError: A process failed.
    """
    live = LiveDrive()
    with Network() as network:
        members = [_member(network.add_host(name), point, seed) for name in (*ROBOTS, STATION)]
        async with ProcessGroup(members, wrap_command=network.argv, on_report=live.take) as group:
            # Discovery is not what is asked here: it has an Ethernet, and then all begin to move on the radio.
            network.set_radio(point.medium, seed=seed)
            group.order(do="start")
            with suppress(TimeoutError):
                async with asyncio.timeout(seconds):
                    while not live.ended():
                        group.check()
                        await asyncio.sleep(_POLL_S)
            live.radio = network.radio_counters()
    return live


def _member(host: Host, point: LapSettings, seed: int) -> Member:
    method, (rate_hz, depth) = METHODS[point.method], rate_and_depth(point)
    address = BusAddress(domain_id=DOMAIN, interface=host.interface, multicast="spdp")
    caches = {"local_cache": method.local_cache, "cache_control": method.cache_control}
    config = HallwayConfig(
        role=host.name, address=address, rate_hz=rate_hz, depth=depth, seed=seed, **caches
    )
    return Member(
        name=host.name, host=host.name, module="sfglab.lab.workers.hallway", config=config
    )


# --- On real Fast DDS -----------------------------------------------------------------------------------------

_TITLE = "On real Fast DDS, once each, and in the model; no value where the schedule was not kept (Rmax 100 Hz)"
declare(exp, _TITLE)


class RosCell(NamedTuple):
    """A cell on real Fast DDS."""

    preset: str  #: One of `MODES`.
    #: By which factor rates, air, robots and nodes are slower; the 3 s of heartbeats are not.
    slowed: float
    point: LapSettings  #: Which cell.

    def scenario(self, seed: int, limit_s: float) -> Scenario:
        """Return its topics for so many seconds of the robots' time."""
        slow = slowed(scenario_of(self.point, seed=seed), self.slowed)
        return replace(slow, duration_s=limit_s * self.slowed)


def ros_cells(config: Config) -> list[RosCell]:
    """Return the cells of a whole round; of less, which is to the first corner, those that B-COOP compares.

    Python cannot publish every value: without local cache all is slowed, and one cell is run at both scales.
    """
    whole = config.ros2_s >= hallway.LIMIT_S
    methods: Any = ("none", "LC", "OPT", "OPT+LC") if whole else ("none", "OPT+LC")
    depths = LAP_DEPTHS if whole else LAP_DEPTHS[1:2]
    points = points_of(replace(config, methods=methods, rates_hz=RATES_HZ[:1], depths=depths))
    return [
        RosCell(mode, pace, replace(point, vendor=mode))
        for mode in (("fast_dds_sync", "fast_dds_async") if whole else ("fast_dds_async",))
        for point in points
        for pace in (1.0, 2.0)
        if (pace == 2.0) == (point.method == "none")
        or (point.method, point.depth) == ("LC", LAP_DEPTHS[1])
    ]


@cells_part(exp, PART, total=lambda config: len(ros_cells(config)) * config.ros2_repeats)
async def drive_on_ros2(bench: Bench[Config]) -> None:
    """Drive every cell on real Fast DDS and in the model; who did not keep its schedules only says so."""
    limit_s = bench.config.ros2_s

    async def rows(hosts: LiveHosts, cell: RosCell, repeat: int) -> tuple[dict[str, Any], ...]:
        seed, mode = bench.config.seed + repeat, cell.preset.removeprefix("fast_dds_")
        live, kept_up = await drive_cell(hosts, cell, seed, limit_s)
        model = course_row(cell.point, seed, SimulatedLap(cell.point, seed).run(limit_s))
        found = [(REAL, "schedules kept", float(kept_up))]
        for kind, row in ((REAL, live), ("model", model)) if kept_up else ():
            found.append((kind, "rounds that the slowest robot came", row.wound))
            found.append((kind, "longest time out of date (s)", row.stale_s))
        depth, pace = (
            f", {cell.point.depth}" * bool(cell.point.depth),
            ", slowed" * (cell.slowed > 1),
        )
        same = {"setting": f"{cell.point.method}{depth}{pace}", "repeat": repeat}
        kinds = [
            {"quantity": what, "kind": f"{kind}, {mode}", "value": value}
            for kind, what, value in found
        ]
        return tuple(same | kind for kind in kinds)

    cells = {cell: cell.scenario(0, limit_s) for cell in ros_cells(bench.config)}
    # One mode after the other: the loop is closed in this process.
    await play_missing(
        bench, PART, cells, dict.fromkeys(cells, bench.config.ros2_repeats), rows, at_once=1
    )


async def drive_cell(
    hosts: LiveHosts, cell: RosCell, seed: int, limit_s: float
) -> tuple[CourseRow, bool]:
    """Drive a round on ROS 2 nodes; return it, in real time but for `stale_s`, and whether all were in time.

    Raises:
        ProcessFailedError: A node failed or was silent.
        HostsError: The hosts are gone.
    """
    scenario, ended = cell.scenario(seed, limit_s), list[Any]()

    async def drive(group: ProcessGroup, start_ns: int) -> None:
        carrier = RosCarrier(group, scenario, start_ns, cell.slowed)
        run = SimulatedLap(cell.point, seed, carrier=carrier)
        try:
            ended.extend((carrier, run, *await asyncio.to_thread(run.drive, limit_s)))
        finally:
            carrier.over = True

    played = await hosts.play(scenario, seed=seed, drive=drive)
    carrier, run, verdict, now_ns = ended
    lap = run.result(verdict, round(now_ns * cell.slowed), played.outcome)
    row = course_row(cell.point, seed, lap)
    kept_up = played.kept_up and bool(np.percentile(carrier.late_ns, 95) <= hallway.STEP_NS)
    return replace(row, stale_s=row.stale_s / cell.slowed), kept_up


class RosCarrier:
    """What carries a round in real time, in a thread of its own: ROS 2 nodes are told values, and tell them."""

    def __init__(
        self, group: ProcessGroup, scenario: Scenario, start_ns: int, slowed: float
    ) -> None:
        self.late_ns = [0]  #: How late what had arrived was in a core's hands, in the robots' time.
        self.over = False  #: Whether nobody wants it any more.
        self._group, self._loop = group, asyncio.get_running_loop()
        self._start_ns, self._slowed = start_ns, slowed
        self._sources = {flow.name: flow.source for flow in scenario.flows}
        self._told: dict[str, int] = {}
        self._due: list[tuple[int, str, int]] = []
        for name in group:
            group[name].on_report = self._take

    def _take(self, report: Report) -> None:
        if report["is"] == "heard":
            heapq.heappush(
                self._due, (self._time(report["done_ns"]), report["flow"], report["value"])
            )

    def _time(self, real_ns: int) -> int:
        return round((real_ns - self._start_ns) / self._slowed)

    def set_value(self, flow: str, value: int) -> None:
        """Tell a flow's node what it carries from now on."""
        if self._told.get(flow) != value:
            self._told[flow] = value
            order = partial(
                self._group.order, [self._sources[flow]], do="carry", flow=flow, value=value
            )
            self._loop.call_soon_threadsafe(order)

    def advance(self, until_ns: int) -> Delivery | None:
        """Wait for the next value that is new to its reader, or until a time."""
        while not self.over:
            self._group.check()
            now_ns = self._time(time.time_ns())
            if self._due and self._due[0][0] <= min(now_ns, until_ns):
                done_ns, flow, value = heapq.heappop(self._due)
                self.late_ns.append(now_ns - done_ns)
                return Delivery(flow, value, published_ns=0, now_ns=done_ns, repeated=False)
            if now_ns >= until_ns:
                return None
            time.sleep(1e-3)
        raise ProcessFailedError("the round is broken off")
