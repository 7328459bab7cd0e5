"""Scenarios of the reliability model on real DDS, and beside them the model: the same air, the same timing.

Each host is a namespace with one process, the air is a radio with the model's medium, the middleware is Cyclone
DDS; what comes back is an `Outcome` too. Endpoints match over a quiet medium before time begins.

Asked is a loss within three percentage points and a median latency within 30 %. Where a run did not keep to its
schedules the row says so, and the comparison says nothing about the model.
"""

from __future__ import annotations

import asyncio
import os
import tempfile
import time
from collections.abc import AsyncIterator, Awaitable, Callable, Sequence
from contextlib import asynccontextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from sfglab.arp.robots import METHODS
from sfglab.bus.address import BusAddress
from sfglab.lab import workers
from sfglab.lab.bench import Bench, as_row
from sfglab.lab.experiment import SkippedPartError, seeded
from sfglab.lab.experiments.transmission.experiment import (
    HELLO_DOWN,
    HELLO_UP,
    OPT_DEPTH,
    Config,
    Point,
    cells_of,
    exp,
    hello_latency_ms,
    scenario_of,
)
from sfglab.lab.hosts import Host, HostsUnavailableError, Network, RadioCounters
from sfglab.lab.ros2 import RosMember
from sfglab.lab.workers.flowplay import PartsConfig
from sfglab.processes import Member, ProcessGroup
from sfglab.qos import QoSProfile
from sfglab.rtps import CYCLONE_DDS, Fate, Flow, FlowOutcome, Medium, Outcome, Scenario, run
from sfglab.rtps.model import data_bytes
from sfglab.units import BITS_PER_BYTE, NS_PER_S

if TYPE_CHECKING:
    from sfglab.component import Report

Arrays = dict[str, NDArray[np.int64]]
Drive = Callable[[ProcessGroup, int], Awaitable[None]]  # of the hosts' processes, and when time begins, ns

_MODULE = "sfglab.lab.workers.flowplay"
START_S, MATCH_S, LEAD_S, SPARE_S = 90.0, 90.0, 0.15, 60.0
LONGEST_DRAIN_S = 1.5  #: Repairs that come later than this are rare, and a live second costs a second.

QUIET = Medium(rate_bps=1e9, loss=0.0, overhead_s=0.0, contention=0.0)  #: What hosts find each other over.
SETTLE_S = {True: 0.3, False: 1.5}
"""Until what was said about endpoints is acknowledged, by `Vendor.prompt`: Fast DDS asks after a second."""

PROBE_S = 2.0  #: How long a topic is published that shows the hosts' own delay.
_SELDOM = Path(workers.__file__).with_name("quiet_participants.xml")

_STAMP_SLACK_NS = 2  # RTPS counts time in units of 2**-32 s (RTPS 2.5, clause 9.3.2)

LOSS_WITHIN = 0.03
LATENCY_WITHIN = 0.30

GROUPS = ("sensors", "hello_up", "hello")
"""All sensors' topics; "Hello" to the station; "Hello" from publication to actuation."""


# --- The part of the experiment -------------------------------------------------------------------------------


@exp.table("live")
class LiveRow:
    """One group of flows of one cell, live and simulated."""

    rate_max_hz: int  #: Rmax.
    depth: str  #: DEPTH as the grid has it.
    method: str  #: The method.
    group: str  #: One of `GROUPS`.
    duration_s: float  #: How long was published, seconds.
    published: int  #: Samples, live.
    loss_live: float  #: Share of them that never arrived.
    loss_model: float  #: The same in the model, median of its seeds.
    p50_live_ms: float  #: Median latency.
    p50_model_ms: float  #: The same in the model, median of its seeds.
    frames: int  #: Frames on air, live.
    frames_lost: int  #: Those that the radio lost.
    queue_full: int  #: Frames that found their sender's queue full.
    air_share: float  #: Share of the time that the air was in use.
    kept_up: bool  #: Whether relay and processes kept to their schedules.
    late_mean_ms: float  #: How much later than due the relay delivered, on average.
    delay_ms: float  #: What the hosts need themselves, by `Played.delay_s`; the model has it too.
    loss_agrees: bool  #: Whether the losses differ by no more than `LOSS_WITHIN`.
    latency_agrees: bool  #: Whether the medians differ by no more than `LATENCY_WITHIN` of the live one.


def live_cells(config: Config) -> list[Point]:
    """Return the cells that are run live as well; an optimised method has the depth ``opt`` in addition.

    Live endpoints are those of Cyclone DDS, whose timing the model then has, whatever the run's vendor.
    """
    if not config.live_s:
        return []
    cell = cells_of(config)
    return [
        cell(rate_max_hz=rate, depth=depth, method=method, duration_s=config.live_s)
        for rate in config.live_rates_hz
        for method in config.live_methods
        for depth in (*config.live_depths, *((OPT_DEPTH,) if METHODS[method].optimised else ()))
    ]


@exp.part("live", total=lambda config: len(live_cells(config)), skips=(HostsUnavailableError,), timed=False)
async def play_cells(bench: Bench[Config]) -> None:
    """Play cells live, one after the other, each beside the model with all seeds."""
    config = bench.config
    scenarios = {cell: scenario_of(cell, seed=config.seed, vendor=CYCLONE_DDS) for cell in live_cells(config)}
    if not scenarios:
        raise SkippedPartError("not asked for")
    async with live_hosts(*hosts_of(next(iter(scenarios.values())))) as hosts:
        for cell, scenario in scenarios.items():
            played = await hosts.play(scenario, seed=config.seed)
            models = [run(played.scenario, seed=seed) for seed in seeded(config, config.seeds)]
            bench.write_all("live", compare(cell, played, models))
            bench.advance(f"{cell.method}, {cell.rate_max_hz} Hz, depth {cell.depth}")
    bench.metadata("live", {"hindrance": ""})


# --- Live -----------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True, kw_only=True)
class Played:
    """What a live run came to."""

    #: What the model has to run beside it: as asked, with the drain that it had, and with `delay_s` as latency
    #: of the medium.
    scenario: Scenario
    #: What kernel, relay and DDS add to a sample's airtime between the applications, measured with one topic
    #: alone on a calm medium.
    delay_s: float
    #: As the model's; a sample that never came has the fate UNDERWAY, as nobody saw why. Counts are those that
    #: can be seen: ``lost``, ``queue_full``, ``bytes``, ``airtime_ns``, ``processed``, ``held``,
    #: ``compared``, and ``missed`` for what was due while a process of rclpy was not let run.
    outcome: Outcome
    radio: RadioCounters  #: The medium's own counters.
    late_p95_s: float  #: How late a host's process published, 95th percentile, of the latest host, seconds.
    refused: int  #: Samples that DDS refused.

    @property
    def kept_up(self) -> bool:
        """Whether relay and publishers kept within 2 ms, but for 1 % of the frames and 5 % of the samples."""
        return self.radio.kept_up and self.late_p95_s <= self.radio.late_after_s


def hosts_of(scenario: Scenario) -> tuple[str, ...]:
    """Return the hosts of a scenario, in the order of the model."""
    return tuple(dict.fromkeys(host for flow in scenario.flows for host in (flow.source, flow.target)))


RosMode = Literal["SYNCHRONOUS", "ASYNCHRONOUS"]


@asynccontextmanager
async def live_hosts(*names: str, ros: RosMode | None = None) -> AsyncIterator[LiveHosts]:
    """Provide hosts of these names on a radio, with a process each.

    None: of our own, on Cyclone DDS; else a real ROS 2 node that publishes in this mode of Fast DDS.

    Raises:
        HostsUnavailableError: This machine has no test hosts.
        RosMissingError: This machine has no ROS 2.
        ProcessFailedError: A process did not start.
    """
    with Network() as network:
        members = [_member(host, ros) for host in map(network.add_host, names)]
        network.set_radio(QUIET)
        async with ProcessGroup(network.argv, members, start_s=START_S) as group:
            yield LiveHosts(network, group)


def _member(host: Host, ros: RosMode | None) -> Member:
    if ros:
        profiles = (f"{library}_DEFAULT_PROFILES_FILE" for library in ("FASTDDS", "FASTRTPS"))  # 3.x, 2.x
        environment = (("RMW_FASTRTPS_PUBLICATION_MODE", str(ros)), *((n, str(_SELDOM)) for n in profiles))
        return RosMember(name=host.name, host=host.name, config=(host.name,), environment=environment)
    address = BusAddress(domain_id=0, interface=host.interface, multicast="spdp")
    config = PartsConfig(host=host.name, address=address)
    return Member(name=host.name, host=host.name, module=_MODULE, config=config)


class LiveHosts:
    """Hosts on a radio that play one scenario after the other; their processes are named like them."""

    def __init__(self, network: Network, group: ProcessGroup) -> None:
        self._network = network
        self._group = group
        self._delays_s: dict[float, float] = {}

    async def play(self, scenario: Scenario, *, seed: int, drive: Drive | None = None) -> Played:
        """Play a scenario, in real time; before the first one at its rate, the hosts' own delay is measured.

        The seed is that of losses and values; which frame meets which loss depends on the machine. With a
        `Drive`, only on real ROS 2, that says what flows carry, and it is over when that returns.

        Raises:
            ProcessFailedError: A process failed or was silent.
            HostsError: The hosts are gone.
        """
        rate_hz = scenario.flows[0].rate_hz
        if rate_hz not in self._delays_s:
            probe = await self._play(_probe(scenario), delay_s=0.0, seed=seed, drive=None)
            self._delays_s[rate_hz] = _delay_s(probe)
        return await self._play(scenario, delay_s=self._delays_s[rate_hz], seed=seed, drive=drive)

    async def _play(self, scenario: Scenario, *, delay_s: float, seed: int, drive: Drive | None) -> Played:
        if scenario.vendor.prompt:
            scenario = replace(scenario, drain_s=min(scenario.drain_s, LONGEST_DRAIN_S))
        for host in self._group:
            flows = [flow for flow in scenario.flows if host in (flow.source, flow.target)]
            self._group.order([host], do="open", flows=flows, seed=seed)
        await self._group.expect("matched", timeout_s=MATCH_S)
        await asyncio.sleep(SETTLE_S[scenario.vendor.prompt])
        self._network.set_radio(scenario.medium, seed=seed)
        start_ns, arrays, reports = await self._run(scenario, drive)
        radio = self._network.radio_counters()
        self._network.set_radio(QUIET)
        await self._group.ask("closed", timeout_s=START_S, do="close")
        latency_s = scenario.medium.latency_s + delay_s
        return Played(
            scenario=replace(scenario, medium=replace(scenario.medium, latency_s=latency_s)),
            delay_s=delay_s,
            outcome=_outcome(scenario, arrays, reports, radio=radio, start_ns=start_ns),
            radio=radio,
            late_p95_s=max(report["late_p95_s"] for report in reports),
            refused=sum(report["refused"] for report in reports),
        )

    async def _run(
        self, scenario: Scenario, drive: Drive | None
    ) -> tuple[int, dict[str, Arrays], list[Report]]:
        """Return when it started, and each host's arrays and report."""
        with tempfile.TemporaryDirectory(prefix="sfglab-live-") as folder:
            files = {host: Path(folder, f"{host}.npz") for host in self._group}
            times = {"duration_s": scenario.duration_s, "drain_s": scenario.drain_s}
            start_ns, do = time.time_ns() + round(LEAD_S * NS_PER_S), "drive" if drive else "play"
            for host, file in files.items():
                self._group.order([host], do=do, start_ns=start_ns, result=os.fspath(file), **times)
            if drive:
                await drive(self._group, start_ns)
                self._group.order(do="halt")
            reports = await self._group.expect("done", timeout_s=sum(times.values()) + SPARE_S)
            return start_ns, {host: dict(np.load(file)) for host, file in files.items()}, list(reports.values())


def _probe(scenario: Scenario) -> Scenario:
    """Return a scenario of one topic at the first one's rate, since who wakes often wakes faster."""
    flow, medium, qos = scenario.flows[0], Medium(loss=0.0), QoSProfile(depth=10)
    probe = Flow(name="probe", source=flow.source, target=flow.target, rate_hz=flow.rate_hz, qos=qos)
    return replace(scenario, flows=(probe,), medium=medium, duration_s=PROBE_S, drain_s=LEAD_S)


def _delay_s(probe: Played) -> float:
    """Return what the median sample took beyond its airtime; never less than nothing."""
    medium, (flow,) = probe.scenario.medium, probe.scenario.flows
    bits = data_bytes(flow.size_bytes, with_heartbeat=True) * BITS_PER_BYTE
    airtime_s = medium.overhead_s + bits / medium.rate_bps + medium.latency_s
    return max(0.0, float(np.median(probe.outcome.flows[flow.name].latency_ns)) / NS_PER_S - airtime_s)


def _outcome(
    scenario: Scenario,
    arrays: dict[str, Arrays],
    reports: Sequence[Report],
    *,
    radio: RadioCounters,
    start_ns: int,
) -> Outcome:
    flows = {
        flow.name: _flow_outcome(flow, arrays[flow.source], arrays[flow.target], start_ns)
        for flow in scenario.flows
    }
    counts = {
        "lost": radio.lost,
        "queue_full": radio.queue_full,
        "bytes": sum(host.bytes_ for host in radio.hosts.values()),
        "airtime_ns": round(sum(host.airtime_s for host in radio.hosts.values()) * NS_PER_S),
        **{name: sum(report.get(name, 0) for report in reports) for name in ("held", "compared", "missed")},
        "processed": sum(int(flow.delivered.sum()) for flow in flows.values()),
    }
    return Outcome(flows=flows, counts=counts)


def _flow_outcome(flow: Flow, source: Arrays, target: Arrays, start_ns: int) -> FlowOutcome:
    sent_ns = source[f"{flow.name} written sent_ns"]
    received_ns = np.zeros(len(sent_ns), np.int64)
    if (stamps := f"{flow.name} received sent_ns") in target:
        place = np.searchsorted(sent_ns, target[stamps] - _STAMP_SLACK_NS)
    else:  # Fast DDS's stamps are its own
        place = np.searchsorted(source[f"{flow.name} written value"], target[f"{flow.name} received value"])
    received_ns[place] = target[f"{flow.name} received done_ns"] - start_ns
    fate = np.full(len(sent_ns), Fate.UNDERWAY, np.int8)
    fate[place] = Fate.DELIVERED
    return FlowOutcome(
        name=flow.name,
        published_ns=sent_ns - start_ns,
        received_ns=received_ns,
        value=source[f"{flow.name} written value"].astype(np.int32),
        fate=fate,
        dropped=np.zeros(len(sent_ns), np.int8),
        deadline_ns=flow.qos.deadline_ns,
    )


# --- Live against simulated -----------------------------------------------------------------------------------


def measure(outcome: Outcome, group: str) -> dict[str, Any]:
    """Return what one of `GROUPS` came to.

    Returns:
        ``published`` samples, the ``loss`` among them, and the median latency ``p50_ms`` of those that arrived;
        NaN where there is nothing to say it of.
    """
    names = [HELLO_UP]
    if group == "sensors":
        names = [name for name in outcome.flows if name not in (HELLO_UP, HELLO_DOWN)]
    flows = [outcome.flows[name] for name in names]
    if group == "hello":
        latency_ms = hello_latency_ms(outcome)
    else:
        latency_ms = np.concatenate([flow.latency_ns for flow in flows]) / 1e6
    published = sum(len(flow.fate) for flow in flows)
    return {
        "published": published,
        "loss": 1 - len(latency_ms) / published if published else float("nan"),
        "p50_ms": float(np.median(latency_ms)) if len(latency_ms) else float("nan"),
    }


def compare(point: Point, played: Played, models: Sequence[Outcome]) -> list[LiveRow]:
    """Return a live cell beside the model's runs of `played.scenario`, a row for each of `GROUPS`."""
    radio, hosts = played.radio, played.radio.hosts.values()
    shared = {
        "duration_s": played.scenario.duration_s,
        "frames": sum(host.frames for host in hosts),
        "frames_lost": radio.lost,
        "queue_full": radio.queue_full,
        "air_share": sum(host.airtime_s for host in hosts) / radio.elapsed_s if radio.elapsed_s else 0.0,
        "kept_up": played.kept_up,
        "late_mean_ms": radio.late_mean_s * 1e3,
        "delay_ms": played.delay_s * 1e3,
    }
    groups = ({**shared, "group": group, **compared(played, models, group)} for group in GROUPS)
    return [as_row(LiveRow, row, point) for row in groups]


def compared(played: Played, models: Sequence[Outcome], group: str) -> dict[str, Any]:
    """Return what one of `GROUPS` came to, live and in the model's median run, and whether that agrees."""
    live, runs = measure(played.outcome, group), [measure(model, group) for model in models]
    loss, p50_ms = (float(np.median([run[name] for run in runs])) for name in ("loss", "p50_ms"))
    return {
        "published": live["published"],
        "loss_live": live["loss"],
        "loss_model": loss,
        "p50_live_ms": live["p50_ms"],
        "p50_model_ms": p50_ms,
        "loss_agrees": abs(live["loss"] - loss) <= LOSS_WITHIN,
        "latency_agrees": abs(live["p50_ms"] - p50_ms) <= LATENCY_WITHIN * live["p50_ms"],
    }
