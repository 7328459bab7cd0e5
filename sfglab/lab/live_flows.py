"""Scenarios of the reliability model on real DDS: equal medium and timing, between real processes.

Each host is a network namespace with one process. The medium is a radio with the model's parameters. The
middleware is Cyclone DDS or the Fast DDS of a real ROS 2 node. The result is an `Outcome`, as that of the
model. Endpoints match over a quiet medium before the scenario starts.
"""

from __future__ import annotations

import asyncio
import os
import tempfile
import time
from contextlib import asynccontextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import NDArray

from sfglab.bus.address import BusAddress
from sfglab.lab import workers
from sfglab.lab.hosts import Host, Network, RadioCounters
from sfglab.lab.hosts.radio import LATE_AFTER_S
from sfglab.lab.ros2 import RosMember
from sfglab.lab.workers.scenario_player import PartsConfig
from sfglab.processes import Member, ProcessGroup
from sfglab.qos import QoSProfile
from sfglab.rtps import Fate, Flow, FlowOutcome, Medium, Outcome, Scenario
from sfglab.rtps.frames import data_bytes
from sfglab.units import BITS_PER_BYTE, NS_PER_S

if TYPE_CHECKING:
    from collections.abc import AsyncIterator

    from sfglab.component import Report

Arrays = dict[str, NDArray[np.int64]]

_MODULE = "sfglab.lab.workers.scenario_player"
START_S = 90.0  #: Time limit for processes to start, and for a scenario to be closed, s.
MATCH_S = 90.0  #: Time limit for endpoints to discover each other, s.
LEAD_S = 0.15  #: Time from the order to the start of a scenario, s.
SPARE_S = 60.0  #: Time limit for results after the end of a scenario, s.
#: Longest time for retransmissions after the last sample, s. Later ones are rare, and a live run takes real
#: time.
LONGEST_DRAIN_S = 1.5

#: Medium over which the endpoints discover each other.
QUIET = Medium(rate_bps=1e9, loss=0.0, overhead_s=0.0, contention=0.0)
SETTLE_S = {True: 0.3, False: 1.5}
"""Time until announcements of endpoints are acknowledged, s, by `Vendor.prompt`. Fast DDS requests them after 1 s."""

PROBE_S = 2.0  #: Duration of the topic that measures the hosts' own delay, s.
_SELDOM = Path(workers.__file__).with_name("quiet_participants.xml")

_STAMP_SLACK_NS = 2  # RTPS counts time in units of 2**-32 s (RTPS 2.5, clause 9.3.2)

RosMode = Literal["SYNCHRONOUS", "ASYNCHRONOUS"]
MODES: dict[str, RosMode | None] = {
    "fast_dds_sync": "SYNCHRONOUS",
    "fast_dds_async": "ASYNCHRONOUS",
    "cyclone_dds": None,
}
"""Publication mode of a real ROS 2 node for each preset; None where sfglab publishes on Cyclone DDS."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Played:
    """Result of a live run."""

    #: Scenario for a comparison with the model: the given one, with the drain of the live run. The latency
    #: of its medium includes the time that kernel, relay and DDS add to a sample's airtime between the
    #: applications. That time is measured with one topic alone on a calm medium.
    scenario: Scenario
    #: Outcome in the form of the model's. A sample that never arrived has the fate UNDERWAY, because its
    #: cause is unknown. It has no counts.
    outcome: Outcome
    radio: RadioCounters  #: Counters of the medium.
    #: 95th percentile of the delay of publication on the host with the largest one, s.
    late_p95_s: float

    @property
    def kept_up(self) -> bool:
        """Whether relay and publishers were in time: at most 1 % of frames and 5 % of samples over 2 ms late."""
        return self.radio.kept_up and self.late_p95_s <= LATE_AFTER_S


def hosts_of(scenario: Scenario) -> tuple[str, ...]:
    """Return the hosts of a scenario, in the order of the model."""
    return tuple(
        dict.fromkeys(host for flow in scenario.flows for host in (flow.source, flow.target))
    )


@asynccontextmanager
async def live_hosts(*names: str, ros: RosMode | None = None) -> AsyncIterator[LiveHosts]:
    """Provide hosts with these names on a radio, with one process each.

    With `ros` None, the processes are those of sfglab, on Cyclone DDS. Otherwise they are real ROS 2 nodes
    that publish in this mode of Fast DDS.

    Raises:
        HostsUnavailableError: This machine has no test hosts.
        RosMissingError: This machine has no ROS 2.
        ProcessFailedError: A process did not start.
    """
    with Network() as network:
        members = [_member(host, ros) for host in map(network.add_host, names)]
        network.set_radio(QUIET)
        async with ProcessGroup(members, wrap_command=network.argv, start_s=START_S) as group:
            yield LiveHosts(network, group)


def _member(host: Host, ros: RosMode | None) -> Member:
    if ros:
        environment = {
            "RMW_FASTRTPS_PUBLICATION_MODE": str(ros),
            "FASTDDS_DEFAULT_PROFILES_FILE": str(_SELDOM),  # Fast DDS 3.x
            "FASTRTPS_DEFAULT_PROFILES_FILE": str(_SELDOM),  # Fast DDS 2.x
        }
        return RosMember(
            name=host.name, host=host.name, config=(host.name,), environment=environment
        )
    address = BusAddress(domain_id=0, interface=host.interface, multicast="spdp")
    config = PartsConfig(host=host.name, address=address)
    return Member(name=host.name, host=host.name, module=_MODULE, config=config)


class LiveHosts:
    """Hosts on a radio that run one scenario after the other; their processes have the names of the hosts."""

    def __init__(self, network: Network, group: ProcessGroup) -> None:
        self._network = network
        self._group = group
        self._delays_s: dict[float, float] = {}

    async def play(self, scenario: Scenario, *, seed: int) -> Played:
        """Run a scenario in real time. Before the first one with its rate, the hosts' own delay is measured.

        The seed determines losses and values. The assignment of losses to frames depends on the machine.

        Raises:
            ProcessFailedError: A process failed or did not report.
            HostsError: The hosts are gone.
        """
        rate_hz = scenario.flows[0].rate_hz
        if rate_hz not in self._delays_s:
            probe = await self._play(_probe(scenario), delay_s=0.0, seed=seed)
            self._delays_s[rate_hz] = _delay_s(probe)
        return await self._play(scenario, delay_s=self._delays_s[rate_hz], seed=seed)

    async def _play(self, scenario: Scenario, *, delay_s: float, seed: int) -> Played:
        if scenario.vendor.prompt:
            scenario = replace(scenario, drain_s=min(scenario.drain_s, LONGEST_DRAIN_S))
        for host in self._group:
            flows = [flow for flow in scenario.flows if host in (flow.source, flow.target)]
            self._group.order([host], do="open", flows=flows, seed=seed)
        await self._group.expect("matched", timeout_s=MATCH_S)
        await asyncio.sleep(SETTLE_S[scenario.vendor.prompt])
        self._network.set_radio(scenario.medium, seed=seed)
        start_ns, arrays, reports = await self._run(scenario)
        radio = self._network.radio_counters()
        self._network.set_radio(QUIET)
        await self._group.ask("closed", timeout_s=START_S, do="close")
        latency_s = scenario.medium.latency_s + delay_s
        return Played(
            scenario=replace(scenario, medium=replace(scenario.medium, latency_s=latency_s)),
            outcome=_outcome(scenario, arrays, start_ns),
            radio=radio,
            late_p95_s=max(report["late_p95_s"] for report in reports),
        )

    async def _run(self, scenario: Scenario) -> tuple[int, dict[str, Arrays], list[Report]]:
        """Return the start time, each host's arrays, and the reports."""
        with tempfile.TemporaryDirectory(prefix="sfglab-live-") as folder:
            files = {host: Path(folder, f"{host}.npz") for host in self._group}
            times = {"duration_s": scenario.duration_s, "drain_s": scenario.drain_s}
            start_ns = time.time_ns() + round(LEAD_S * NS_PER_S)
            for host, file in files.items():
                result = os.fspath(file)
                self._group.order([host], do="play", start_ns=start_ns, result=result, **times)
            reports = await self._group.expect("done", timeout_s=sum(times.values()) + SPARE_S)
            arrays = {host: dict(np.load(file)) for host, file in files.items()}
            return start_ns, arrays, list(reports.values())


def _probe(scenario: Scenario) -> Scenario:
    """Return a scenario of one topic at the first topic's rate, because a busier process wakes up faster."""
    flow, medium, qos = scenario.flows[0], Medium(loss=0.0), QoSProfile(depth=10)
    probe = Flow(
        name="probe", source=flow.source, target=flow.target, rate_hz=flow.rate_hz, qos=qos
    )
    return replace(scenario, flows=(probe,), medium=medium, duration_s=PROBE_S, drain_s=LEAD_S)


def _delay_s(probe: Played) -> float:
    """Return the median time that a sample took beyond its airtime, s; at least 0."""
    medium = probe.scenario.medium
    [flow] = probe.scenario.flows
    bits = data_bytes(flow.size_bytes, with_heartbeat=True) * BITS_PER_BYTE
    airtime_s = medium.overhead_s + bits / medium.rate_bps + medium.latency_s
    latency_s = float(np.median(probe.outcome.flows[flow.name].latency_ns)) / NS_PER_S
    return max(0.0, latency_s - airtime_s)


def _outcome(scenario: Scenario, arrays: dict[str, Arrays], start_ns: int) -> Outcome:
    flows = {}
    for flow in scenario.flows:
        source, target = arrays[flow.source], arrays[flow.target]
        flows[flow.name] = _flow_outcome(flow, source, target, start_ns)
    return Outcome(flows=flows, counts={})


def _flow_outcome(flow: Flow, source: Arrays, target: Arrays, start_ns: int) -> FlowOutcome:
    sent_ns = source[f"{flow.name} written sent_ns"]
    received_ns = np.zeros(len(sent_ns), np.int64)
    stamps = f"{flow.name} received sent_ns"
    if stamps in target:
        place = np.searchsorted(sent_ns, target[stamps] - _STAMP_SLACK_NS)
    else:  # Fast DDS sets its own source time stamps
        place = np.searchsorted(
            source[f"{flow.name} written value"], target[f"{flow.name} received value"]
        )
    received_ns[place] = target[f"{flow.name} received done_ns"] - start_ns
    fate = np.full(len(sent_ns), Fate.UNDERWAY, np.int8)
    fate[place] = Fate.DELIVERED
    return FlowOutcome(
        published_ns=sent_ns - start_ns,
        received_ns=received_ns,
        value=source[f"{flow.name} written value"].astype(np.int32),
        fate=fate,
    )


def slowed(scenario: Scenario, factor: float) -> Scenario:
    """Return a scenario whose flows and medium are slower by a factor; its duration stays the same."""
    flows = []
    for flow in scenario.flows:
        slow_flow = replace(
            flow,
            rate_hz=flow.rate_hz / factor,
            phase_s=flow.phase_s * factor,
            service_s=flow.service_s * factor,
            change_s=flow.change_s * factor,
        )
        flows.append(slow_flow)
    medium = scenario.medium
    slow = replace(medium, rate_bps=medium.rate_bps / factor, overhead_s=medium.overhead_s * factor)
    return replace(scenario, flows=tuple(flows), medium=slow)
