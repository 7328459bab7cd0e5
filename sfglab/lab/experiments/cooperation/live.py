"""The module `cooperation.live` drives a lap live: nodes in processes on four hosts, over DDS and a lossy radio.

Each robot's process runs the physics of its robot in real time, with the seed of the simulated lap.
"""

from __future__ import annotations

import asyncio
from contextlib import suppress
from typing import TYPE_CHECKING, Any

from sfglab.arp import hallway
from sfglab.arp.hallway import ROBOTS
from sfglab.arp.hallway.simulation import (
    OPTIMUM,
    LapSettings,
    SimulatedLap,
    rate_and_depth,
)
from sfglab.arp.robots import BEST
from sfglab.bus.address import BusAddress
from sfglab.lab.experiment import SkippedPartError
from sfglab.lab.experiments.cooperation.drawn import write_tracks
from sfglab.lab.experiments.cooperation.experiment import (
    Config,
    TrackRow,
    exp,
    track_row,
    track_rows,
)
from sfglab.lab.hosts import Host, HostsError, Network, RadioCounters
from sfglab.lab.workers.hallway import STATION, HallwayConfig
from sfglab.processes import Member, ProcessFailedError, ProcessGroup

if TYPE_CHECKING:
    from sfglab.component import Report
    from sfglab.lab.bench import Bench

LIVE, SIMULATED = "live", "simulated"  #: Names of the two laps in the table ``track``.
LIVE_SETTINGS = LapSettings(method=BEST, rate_max_hz=100, depth=OPTIMUM, vendor="cyclone_dds")
"""Settings of the live lap, and of the simulated lap beside the live lap. The live bus is Cyclone DDS."""
DOMAIN = 47  #: DDS domain of the live lap.
#: End of a lap that neither succeeded nor failed within the time limit.
GIVEN_UP = "the time was over"
_POLL_S = 0.1
_TRIES = 2  # The experiment tries the live lap this many times.
_MODULE = "sfglab.lab.workers.hallway"


@exp.part("live")
async def drive_and_simulate(bench: Bench[Config]) -> None:
    """Drive a lap live and simulate the same lap; the metadata ``live`` has the ends of both laps."""
    config = bench.config
    capability = Network.available()
    if not config.live_s or bench.options.separate is False:
        raise SkippedPartError("no live lap was asked for")
    if not capability.ok:
        raise SkippedPartError(f"no live lap: {capability.reason}")
    live, radio = await drive_again_if_failed(config.seed, limit_s=config.live_s)
    simulated = SimulatedLap(LIVE_SETTINGS, config.seed, record=True)
    simulated.drive(config.live_s)
    verdict = simulated.verdict
    write_tracks(bench, live.tracks)
    write_tracks(bench, track_rows(SIMULATED, simulated.snapshots))
    values = {
        "hosts": f"separate hosts: network namespaces ({capability.how})",
        "end": live.verdict.end.value if live.verdict else GIVEN_UP,
        "lasted_s": live.lasted_s,
        "radio": radio.said(),
        "kept_up": radio.kept_up,
        "simulated_end": verdict.end.value if verdict else GIVEN_UP,
    }
    bench.metadata("live", values)


class LiveLap:
    """A `LiveLap` is the state of a live lap, from the reports of the lap's processes."""

    def __init__(self) -> None:
        self.tracks: list[TrackRow] = []  #: Pose of every robot at each turn of the robot's LIDAR.
        #: End of the lap; None before the end, and if the time limit ended the lap.
        self.verdict: hallway.Verdict | None = None
        self._last: dict[str, Report] = {}
        self._stopped_by: int | None = None
        self._manoeuvre = hallway.Manoeuvre.STOP.value

    def take(self, name: str, report: Report) -> None:
        """Store a report of a process: a stop, a new manoeuvre, or a robot's pose."""
        if report["is"] == "stopped":
            self._stopped_by = report["robot"]
        elif report["is"] == "released":
            self._manoeuvre = report["manoeuvre"]
        elif report["is"] == "pose":
            self._last[name] = report
            pose = report["pose"]
            self.tracks.append(track_row(LIVE, name, report["t_s"], pose, self._manoeuvre))

    def has_ended(self) -> bool:
        """Judge the lap, and return whether the lap has ended."""
        if len(self._last) == len(ROBOTS):
            clearances_m = [self._last[robot]["clearance_m"] for robot in ROBOTS]
            angles_rad = [self._last[robot]["wound_rad"] for robot in ROBOTS]
            self.verdict = hallway.judge(clearances_m, angles_rad, stopped_by=self._stopped_by)
        return self.verdict is not None

    @property
    def lasted_s(self) -> float:
        """Time of the latest pose since the start of the lap, s; 0 before the first pose."""
        return max((report["t_s"] for report in self._last.values()), default=0.0)


async def drive_again_if_failed(seed: int, *, limit_s: float) -> tuple[LiveLap, RadioCounters]:
    """Drive a lap as `drive_live` does; if processes or hosts fail, drive the lap once more with new ones.

    Raises:
        SkippedPartError: The lap failed twice.
    """
    errors = []
    for _ in range(_TRIES):
        try:
            return await drive_live(seed, limit_s=limit_s)
        except (ProcessFailedError, HostsError, TimeoutError) as error:
            errors.append(str(error))
    raise SkippedPartError(f"the live lap failed {len(errors)} times: {errors[-1]}")


async def drive_live(seed: int, *, limit_s: float) -> tuple[LiveLap, RadioCounters]:
    """Drive a lap with `LIVE_SETTINGS` on its own hosts, until the lap ends or a time limit, s, is reached.

    Returns:
        The lap, and the radio's counters.

    Raises:
        HostsUnavailableError: This machine has no network namespaces.
        ProcessFailedError: A process failed.
    """
    live = LiveLap()
    with Network() as network:
        hosts = [network.add_host(name) for name in (*ROBOTS, STATION)]
        members = [_member(host, seed) for host in hosts]
        async with ProcessGroup(members, wrap_command=network.argv, on_report=live.take) as group:
            # The lap does not test discovery, so discovery happens before the radio loses frames.
            network.set_radio(LIVE_SETTINGS.medium, seed=seed)
            group.order(do="start")
            with suppress(TimeoutError):
                async with asyncio.timeout(limit_s):
                    while not live.has_ended():
                        group.check()
                        await asyncio.sleep(_POLL_S)
            return live, network.radio_counters()


def _member(host: Host, seed: int) -> Member:
    rate_hz, depth = rate_and_depth(LIVE_SETTINGS)
    address: Any = BusAddress(domain_id=DOMAIN, interface=host.interface, multicast="spdp")
    config = HallwayConfig(
        role=host.name,
        address=address,
        rate_hz=rate_hz,
        depth=depth,
        seed=seed,
    )
    return Member(name=host.name, host=host.name, module=_MODULE, config=config)
