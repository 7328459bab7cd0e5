"""A scenario of the reliability model on real DDS: each host a namespace, the air a radio, a process a host.

The flows are those that the model runs, over Cyclone DDS, and the radio is the model's medium; what comes back
is an `Outcome` too, so that everything that reads one reads the other. Hosts find each other, and all endpoints
match, over a quiet medium before time begins; then the medium is set.
"""

from __future__ import annotations

import asyncio
import os
import sys
import tempfile
import time
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from sfglab.lab.hosts import Network
from sfglab.lab.staging import Staged
from sfglab.lab.workers.flowplay import PartFlow
from sfglab.lab.workers.robotparts import PartsConfig
from sfglab.processes import LineProcess
from sfglab.qos import History, QoSProfile, Reliability
from sfglab.rtps import Fate, Flow, FlowOutcome, Medium, Outcome
from sfglab.rtps.sizes import data_bytes

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from sfglab.lab.hosts import RadioCounters
    from sfglab.rtps import Scenario


START_S = 30.0
MATCH_S = 30.0
SETTLE_S = 0.3
LEAD_S = 0.15
SPARE_S = 15.0
LONGEST_DRAIN_S = 1.5
"""Repairs that come later than this are rare, and a live second costs a second."""

QUIET = Medium(rate_bps=1e9, loss=0.0, overhead_s=0.0, contention=0.0)
"""What hosts find each other over."""

PROBE_S, PROBE_HZ = 1.0, 100.0
"""How long and how often a topic is published that shows the hosts' own delay."""

_STAMP_SLACK_NS = 2  # RTPS counts time in units of 2**-32 s (RTPS 2.5, clause 9.3.2)
_S = 1_000_000_000


@dataclass(frozen=True, slots=True, kw_only=True)
class Played:
    """What a live run came to."""

    #: What the model has to run beside it: as asked, with the drain that it had, and with `delay_s` as latency
    #: of the medium.
    scenario: Scenario
    #: What kernel, relay and DDS add to a sample's airtime between the applications, measured with one topic
    #: alone on the same medium without losses.
    delay_s: float
    #: As the model's; a sample that never came has the fate UNDERWAY, as nobody saw why. Counts are those that
    #: can be seen: ``lost``, ``queue_full``, ``bytes``, ``airtime_ns``, ``held``, ``compared``.
    outcome: Outcome
    radio: RadioCounters  #: The medium's own counters.
    busy: dict[str, float]  #: Share of a core that each host's process used.
    late_p95_s: dict[str, float]  #: How late each host's process published, 95th percentile, seconds.
    take_s: dict[str, float]  #: What one sample cost the receiving process, by host, seconds.
    refused: int  #: Samples that DDS refused.

    @property
    def kept_up(self) -> bool:
        """Whether relay and publishers kept within 2 ms, but for 1 % of the frames and 5 % of the samples."""
        return self.radio.kept_up and max(self.late_p95_s.values()) <= self.radio.late_after_s


def hosts_of(scenario: Scenario) -> tuple[str, ...]:
    """Return the hosts of a scenario, in the order of the model."""
    return tuple(dict.fromkeys(host for flow in scenario.flows for host in (flow.source, flow.target)))


class LiveStage(Staged):
    """Hosts on a radio with a process each, for one scenario after the other; an async context manager.

    Args:
        hosts: Their names; every scenario's hosts are among them.

    Raises:
        HostsUnavailableError: On entering: this machine has no test hosts.
    """

    def __init__(self, *hosts: str) -> None:
        super().__init__()
        self._names = hosts
        self._network = Network()
        self._parts: dict[str, LineProcess] = {}
        self._delay_s: float | None = None

    async def play(self, scenario: Scenario, *, seed: int) -> Played:
        """Play a scenario, in real time; before the first one, the hosts' own delay is measured.

        Args:
            scenario: What.
            seed: Of the medium's losses and the values; which frame meets which loss depends on the machine.

        Raises:
            ProcessFailedError: A process failed or was silent.
            HostsError: The hosts are gone.
        """
        if self._delay_s is None:
            probe = await self._play(_probe(scenario), delay_s=0.0, seed=seed)
            self._delay_s = _delay_s(probe)
        return await self._play(scenario, delay_s=self._delay_s, seed=seed)

    async def _play(self, scenario: Scenario, *, delay_s: float, seed: int) -> Played:
        scenario = replace(scenario, drain_s=min(scenario.drain_s, LONGEST_DRAIN_S))
        for host, process in self._parts.items():
            process.order(do="open", flows=[asdict(part) for part in _parts(scenario, host)], seed=seed)
        await self._all("matched", timeout_s=MATCH_S)
        await asyncio.sleep(SETTLE_S)  # the last acknowledgements of what was said about the endpoints
        self._network.set_radio(scenario.medium, seed=seed)
        with tempfile.TemporaryDirectory(prefix="sfglab-live-") as folder:
            start_ns, reports = await self._run(scenario, Path(folder))
            arrays = {host: _read(Path(folder, f"{host}.npz")) for host in self._parts}
        radio = self._network.radio_counters()
        self._network.set_radio(QUIET)
        for process in self._parts.values():
            process.order(do="close")
        await self._all("closed", timeout_s=START_S)
        outcome = _outcome(scenario, arrays, reports, radio=radio, start_ns=start_ns)
        length_s = scenario.duration_s + scenario.drain_s
        latency_s = scenario.medium.latency_s + delay_s
        return Played(
            scenario=replace(scenario, medium=replace(scenario.medium, latency_s=latency_s)),
            delay_s=delay_s,
            outcome=outcome,
            radio=radio,
            busy={host: report["busy_s"] / length_s for host, report in reports.items()},
            late_p95_s={host: report["late_p95_s"] for host, report in reports.items()},
            take_s={host: report["take_s"] for host, report in reports.items()},
            refused=sum(report["refused"] for report in reports.values()),
        )

    async def _start(self) -> None:
        self._stack.enter_context(self._network)
        for name in self._names:
            self._network.add_host(name)
        self._network.set_radio(QUIET)
        for name in self._names:
            await self._launch(name)
        await self._all("ready", timeout_s=START_S)

    async def _launch(self, name: str) -> None:
        host = self._network.hosts[name]
        config = PartsConfig(host=name, interface=host.interface, domain_id=0)
        command = (sys.executable, "-m", "sfglab.lab.workers.robotparts", config.to_json())
        process = self._parts[name] = await LineProcess.start(name, host.argv(command))
        self._stack.push_async_callback(process.close)

    async def _all(self, kind: str, *, timeout_s: float) -> dict[str, dict[str, Any]]:
        """Wait until every process has reported something."""
        reports = await asyncio.gather(*(p.expect(kind, timeout_s=timeout_s) for p in self._parts.values()))
        return dict(zip(self._parts, reports, strict=True))

    async def _run(self, scenario: Scenario, folder: Path) -> tuple[int, dict[str, dict[str, Any]]]:
        start_ns = time.time_ns() + round(LEAD_S * _S)
        for host, process in self._parts.items():
            process.order(
                do="play",
                start_ns=start_ns,
                duration_s=scenario.duration_s,
                drain_s=scenario.drain_s,
                result=os.fspath(folder / f"{host}.npz"),
            )
        length_s = scenario.duration_s + scenario.drain_s
        return start_ns, await self._all("done", timeout_s=length_s + SPARE_S)


def _probe(scenario: Scenario) -> Scenario:
    flow = scenario.flows[0]
    probe = Flow(
        name="probe", source=flow.source, target=flow.target, rate_hz=PROBE_HZ, qos=QoSProfile(depth=10)
    )
    medium = replace(scenario.medium, loss=0.0)
    return replace(scenario, flows=(probe,), medium=medium, duration_s=PROBE_S, drain_s=LEAD_S)


def _delay_s(probe: Played) -> float:
    """Return what the median sample took beyond its airtime; never less than nothing."""
    medium, (flow,) = probe.scenario.medium, probe.scenario.flows
    size_bytes = data_bytes(flow.size_bytes, with_heartbeat=True)
    airtime_s = medium.overhead_s + size_bytes * 8 / medium.rate_bps + medium.latency_s
    latency_s = float(np.median(probe.outcome.flows[flow.name].latency_ns)) / _S
    return max(0.0, latency_s - airtime_s)


# --- A host's part --------------------------------------------------------------------------------------------


def _parts(scenario: Scenario, host: str) -> tuple[PartFlow, ...]:
    return tuple(_part(flow, host) for flow in scenario.flows if host in (flow.source, flow.target))


def _part(flow: Flow, host: str) -> PartFlow:
    depth = _depth(flow.qos)
    return PartFlow(
        name=flow.name,
        writes=flow.source == host,
        reads=flow.target == host,
        size_bytes=flow.size_bytes,
        rate_hz=flow.rate_hz,
        phase_s=flow.phase_s,
        depth=depth,
        reader_depth=depth if flow.reader_depth is None else flow.reader_depth,
        reliable=flow.qos.reliability is Reliability.RELIABLE,
        deadline_ns=flow.qos.deadline_ns,
        executor=flow.executor or "",
        service_s=flow.service_s,
        compare_s=flow.compare_s,
        change_s=flow.change_s,
        cached=flow.cached,
        max_silence_s=flow.max_silence_s,
        then=flow.then,
    )


def _depth(qos: QoSProfile) -> int:
    return 0 if qos.history is History.KEEP_ALL else qos.depth


# --- What came of it ------------------------------------------------------------------------------------------


def _read(path: Path) -> dict[str, NDArray[np.int64]]:
    with np.load(path) as file:
        return dict(file)


def _outcome(
    scenario: Scenario,
    arrays: dict[str, dict[str, NDArray[np.int64]]],
    reports: dict[str, dict[str, Any]],
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
        "airtime_ns": round(sum(host.airtime_s for host in radio.hosts.values()) * _S),
        "held": sum(report["held"] for report in reports.values()),
        "compared": sum(report["compared"] for report in reports.values()),
    }
    return Outcome(flows=flows, counts=counts)


def _flow_outcome(
    flow: Flow, source: dict[str, NDArray[np.int64]], target: dict[str, NDArray[np.int64]], start_ns: int
) -> FlowOutcome:
    sent_ns = source[f"{flow.name} written sent_ns"]
    heard_ns, done_ns = (target[f"{flow.name} received {column}"] for column in ("sent_ns", "done_ns"))
    received_ns = np.zeros(len(sent_ns), np.int64)
    place = np.searchsorted(sent_ns, heard_ns - _STAMP_SLACK_NS)
    received_ns[place] = done_ns - start_ns
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
