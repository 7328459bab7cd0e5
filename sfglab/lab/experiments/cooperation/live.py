"""The same nodes live: four processes on four hosts, their messages over DDS and a radio with the model's loss.

Robots' physics runs in real time beside their nodes. Knows processes and their reports; the cores decide.
"""

from __future__ import annotations

import asyncio
import sys
from contextlib import AsyncExitStack
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from sfglab.arp.hallway import AREAS, Manoeuvre, Verdict, judge
from sfglab.arp.robots import METHODS
from sfglab.fleet.address import BusAddress
from sfglab.lab.experiments.cooperation.config import setting_of
from sfglab.lab.experiments.cooperation.rows import TrackRow
from sfglab.lab.hosts import Network
from sfglab.lab.workers.hallway import STATION, HallwayConfig
from sfglab.processes import LineProcess

if TYPE_CHECKING:
    from sfglab.lab.experiments.cooperation.config import Point
    from sfglab.lab.hosts import Host, RadioCounters


LIVE = "live"
DOMAIN = 47
ROBOTS = tuple(area.robot for area in AREAS)
_START_S = 60.0
_POLL_S = 0.1


@dataclass(kw_only=True)
class LiveDrive:
    """What came of a live drive."""

    tracks: list[TrackRow] = field(default_factory=list)  #: Where every robot was at each turn of its LIDAR.
    verdict: Verdict | None = None  #: How it ended; None: the time was over.
    lasted_s: float = 0.0  #: How long it was driven.
    held: float = 0.0  #: Share of values that the local caches held back.
    radio: RadioCounters | None = None  #: What the radio did.


class _Reports:
    """What the processes have said so far."""

    def __init__(self) -> None:
        self.tracks: list[TrackRow] = []
        self.last: dict[str, dict[str, Any]] = {}
        self.stopped_by: int | None = None
        self._manoeuvre = Manoeuvre.STOP.value

    def note(self, name: str, report: dict[str, Any]) -> None:
        """Take a report."""
        if report["is"] == "stopped":
            self.stopped_by = report["robot"]
        elif report["is"] == "released":
            self._manoeuvre = report["manoeuvre"]
        elif report["is"] == "pose":
            self.last[name] = report
            x, y, heading = report["pose"]
            self.tracks.append(
                TrackRow(
                    run=LIVE,
                    robot=name,
                    t_s=report["t_s"],
                    x_m=x,
                    y_m=y,
                    heading_rad=heading,
                    manoeuvre=self._manoeuvre,
                )
            )

    def verdict(self) -> Verdict | None:
        """Return how it has ended, None while it goes on."""
        if len(self.last) < len(ROBOTS):
            return None
        return judge(
            [self.last[robot]["clearance_m"] for robot in ROBOTS],
            [self.last[robot]["wound_rad"] for robot in ROBOTS],
            stopped_by=self.stopped_by,
            now_s=0.0,
        )

    def held(self) -> float:
        """Return the share of values that the caches held back."""
        offered = sum(report["offered"] for report in self.last.values())
        return sum(report["held"] for report in self.last.values()) / offered if offered else 0.0


async def drive_live(point: Point, seed: int, *, seconds: float) -> LiveDrive:
    """Drive live, on hosts of their own.

    Args:
        point: Method, rate and medium; the protocol is timed by the DDS that is there, not by its vendor.
        seed: Of physics and medium.
        seconds: How long at most.

    Raises:
        HostsUnavailableError: This machine has no network namespaces.
        ProcessFailedError: A process failed.
    """
    with Network() as network:
        for name in (*ROBOTS, STATION):
            network.add_host(name)
        async with AsyncExitStack() as stack:
            reports = _Reports()
            processes = [
                await _launch(stack, reports, host, _config(host, point, seed))
                for host in network.hosts.values()
            ]
            for process in processes:
                await process.expect("ready", timeout_s=_START_S)
            # Discovery is not what is asked here: it has an Ethernet, and then all begin to move on the radio.
            network.set_radio(point.medium, seed=seed)
            for process in processes:
                process.order(do="start")
            drive = await _watch(processes, reports, seconds)
            drive.radio = network.radio_counters()
        return drive


def _config(host: Host, point: Point, seed: int) -> HallwayConfig:
    method, setting = METHODS[point.method], setting_of(point)
    return HallwayConfig(
        role=host.name,
        address=BusAddress(domain_id=DOMAIN, interface=host.interface, multicast="spdp"),
        rate_hz=setting.rate_hz,
        depth=setting.depth,
        local_cache=method.local_cache,
        cache_control=method.cache_control,
        seed=seed,
    )


async def _launch(stack: AsyncExitStack, reports: _Reports, host: Host, config: HallwayConfig) -> LineProcess:
    argv = host.argv([sys.executable, "-m", "sfglab.lab.workers.hallway", config.to_json()])

    def note(report: dict[str, Any]) -> None:
        reports.note(config.role, report)

    process = await LineProcess.start(config.role, argv, on_report=note)
    stack.push_async_callback(process.close)
    return process


async def _watch(processes: list[LineProcess], reports: _Reports, seconds: float) -> LiveDrive:
    try:
        async with asyncio.timeout(seconds):
            while (verdict := reports.verdict()) is None:
                for process in processes:
                    process.check()
                await asyncio.sleep(_POLL_S)
    except TimeoutError:
        verdict = None
    lasted_s = max((report["t_s"] for report in reports.last.values()), default=0.0)
    return LiveDrive(tracks=list(reports.tracks), verdict=verdict, lasted_s=lasted_s, held=reports.held())
