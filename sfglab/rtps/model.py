"""RELIABLE and KEEP_LAST as a model: flows over a lossy medium in, the fate of every sample out.

A *simulation*, with a virtual clock and a seed. A flow is one topic's writer and its one reader; hosts share a
medium; readers are served by executors that take time. The protocol is RTPS 2.5, clause 8.4, timed as a vendor
does (`presets`); it runs compiled (`engine`).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from sfglab.errors import SfglabError
from sfglab.qos import DEFAULT, Durability, History, QoSProfile, Reliability
from sfglab.rtps.outcome import Outcome, outcome_of
from sfglab.rtps.presets import FAST_DDS, Vendor
from sfglab.rtps.state import FlowColumn, Params, Sizes, State, TimingColumn, new_state

if TYPE_CHECKING:
    from collections.abc import Iterable


_S = 1_000_000_000
_SMALLEST_FRAME_BYTES = 62
_NOT_NEGATIVE = (
    *("rate_hz", "phase_s", "size_bytes", "reader_depth"),
    *("service_s", "compare_s", "change_s", "max_silence_s"),
)


class ModelError(SfglabError, ValueError):
    """A scenario that cannot be simulated."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Flow:
    """One topic with its writer and its reader."""

    name: str  #: For messages and tables.
    source: str  #: Host of the writer.
    target: str  #: Host of the reader.
    size_bytes: int = 24  #: CDR size of a sample.
    rate_hz: float = 0.0  #: How often a sample is published; 0: only when a chain publishes it.
    phase_s: float = 0.0  #: When the first one is published, seconds.
    qos: QoSProfile = DEFAULT  #: Of the writer; its deadline is watched, not enforced.
    reader_depth: int | None = None  #: History of the reader; 0: KEEP_ALL; None: as the writer's.
    executor: str | None = None  #: Whose time it costs when a sample is taken; None: one of its own.
    service_s: float = 0.0  #: How much, seconds.
    #: What a repeated value costs instead, seconds, where cache control discards it before it is processed
    #: (paper B, section 2.3); None: no cache control.
    compare_s: float | None = None
    change_s: float = 0.0  #: Mean time between changes of the value, seconds; 0: every sample differs.
    cached: bool = False  #: Whether a local cache holds repeated values back (paper B, section 2.2).
    max_silence_s: float | None = None  #: The local cache's longest silence, seconds; None: none.
    #: Name of the flow that is published, with the same value, when a sample was processed.
    then: str | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Medium:
    """What carries the frames."""

    rate_bps: float = 20e6  #: Bits a second.
    loss: float = 0.01  #: Share of frames that are lost, after whatever the medium itself repeats.
    shared: bool = True  #: One half-duplex medium for all hosts (Wi-Fi); else each host sends independently.
    overhead_s: float = 300e-6  #: Airtime of a frame beside its bits: preamble, gaps, acknowledgement.
    contention: float = 0.15  #: By which share each further host that wants to send stretches a frame.
    latency_s: float = 0.0  #: From the end of sending to arrival.
    queue_frames: int = 500  #: Frames that a host's queue holds; more are dropped.


@dataclass(frozen=True, slots=True, kw_only=True)
class Scenario:
    """Everything that a run needs but the seed."""

    flows: tuple[Flow, ...]  #: The topics.
    medium: Medium = Medium()  #: The medium.
    vendor: Vendor = FAST_DDS  #: Timing of the protocol.
    duration_s: float = 60.0  #: How long is published, seconds.
    drain_s: float = 10.0  #: How long repairs go on afterwards, seconds.
    unacked_most: int = 5000  #: Unacknowledged samples at which a KEEP_ALL writer refuses more.

    def __post_init__(self) -> None:
        names = [flow.name for flow in self.flows]
        if not names or len(set(names)) != len(names):
            raise ModelError(f"flows: given {names}, needed are different names, one at least")
        for flow in self.flows:
            _check_flow(flow, names)
        medium = self.medium
        if not 0 <= medium.loss < 1 or medium.rate_bps <= 0 or medium.queue_frames < 1:
            raise ModelError(
                f"medium: given {medium}; allowed are 0 <= loss < 1, rate_bps > 0, queue_frames >= 1"
            )
        if min(medium.overhead_s, medium.contention, medium.latency_s) < 0:
            raise ModelError(
                f"medium: given {medium}; overhead_s, contention and latency_s must not be negative"
            )
        if not self.duration_s > 0 or self.drain_s < 0:
            raise ModelError(
                f"duration_s, drain_s: given {self.duration_s}, {self.drain_s}; needed is > 0, >= 0"
            )


def _check_flow(flow: Flow, names: list[str]) -> None:
    if flow.then is not None and flow.then not in names:
        raise ModelError(f"flow {flow.name!r}: then: given {flow.then!r}, allowed are {', '.join(names)}")
    for field in _NOT_NEGATIVE:
        if (getattr(flow, field) or 0) < 0:
            raise ModelError(f"flow {flow.name!r}: {field}: given {getattr(flow, field)}, must not be negative")
    if flow.rate_hz > 0 and flow.rate_hz > 1e9:
        raise ModelError(f"flow {flow.name!r}: rate_hz: given {flow.rate_hz:g}, allowed are up to 1e9")


def run(scenario: Scenario, *, seed: int) -> Outcome:
    """Simulate a scenario.

    Args:
        scenario: What.
        seed: Of losses and values; the same seed gives the same outcome to the bit.
    """
    from sfglab.rtps.engine import simulate

    params, state = compile_scenario(scenario, samples=_most_samples(scenario), seed=seed)
    simulate(params, state)
    return outcome_of(scenario.flows, params, state)


def compile_scenario(scenario: Scenario, *, samples: int, seed: int) -> tuple[Params, State]:
    """Return a scenario as the arrays that the engine takes.

    Args:
        scenario: What.
        samples: Most samples of one flow.
        seed: Of losses and values.
    """
    hosts = _numbers(h for flow in scenario.flows for h in (flow.source, flow.target))
    executors = _numbers(flow.executor or f"{flow.name}\0" for flow in scenario.flows)
    params = Params(
        flows=_flow_table(scenario, hosts, executors),
        timing=_timing(scenario),
        rates=np.array([scenario.medium.loss, scenario.medium.rate_bps, scenario.medium.contention]),
    )
    sizes = Sizes(
        hosts=len(hosts),
        servers=len(executors),
        samples=samples,
        queue=scenario.medium.queue_frames,
        flight=_most_under_way(scenario.medium),
    )
    return params, new_state(params, sizes, seed=seed)


def _numbers(names: Iterable[str]) -> dict[str, int]:
    return {name: i for i, name in enumerate(dict.fromkeys(names))}


def _depth(qos: QoSProfile) -> int:
    return 0 if qos.history is History.KEEP_ALL else qos.depth


def _flow_table(scenario: Scenario, hosts: dict[str, int], executors: dict[str, int]) -> np.ndarray:
    column = {flow.name: i for i, flow in enumerate(scenario.flows)}
    table = np.zeros((len(column), len(FlowColumn)), np.int64)
    for i, flow in enumerate(scenario.flows):
        row: dict[FlowColumn, int] = {
            FlowColumn.SOURCE: hosts[flow.source],
            FlowColumn.TARGET: hosts[flow.target],
            FlowColumn.SERVER: executors[flow.executor or f"{flow.name}\0"],
            FlowColumn.PERIOD_NS: _ns(1 / flow.rate_hz) if flow.rate_hz else 0,
            FlowColumn.PHASE_NS: _ns(flow.phase_s),
            FlowColumn.SIZE_BYTES: flow.size_bytes,
            FlowColumn.DEPTH: _depth(flow.qos),
            FlowColumn.READER_DEPTH: _depth(flow.qos) if flow.reader_depth is None else flow.reader_depth,
            FlowColumn.RELIABLE: int(flow.qos.reliability is Reliability.RELIABLE),
            FlowColumn.CHAIN: -1 if flow.then is None else column[flow.then],
            FlowColumn.CHANGE_NS: _ns(flow.change_s),
            FlowColumn.CACHED: int(flow.cached),
            FlowColumn.SILENCE_NS: _ns(flow.max_silence_s or 0.0),
            FlowColumn.SERVICE_NS: _ns(flow.service_s),
            FlowColumn.KEEPS_ACKED: int(flow.qos.durability is Durability.TRANSIENT_LOCAL),
            FlowColumn.COMPARE_NS: -1 if flow.compare_s is None else _ns(flow.compare_s),
        }
        for key, value in row.items():
            table[i, key] = value
    return table


def _timing(scenario: Scenario) -> np.ndarray:
    vendor, medium = scenario.vendor, scenario.medium
    values: dict[TimingColumn, int] = {
        TimingColumn.HEARTBEAT_NS: vendor.heartbeat_ns,
        TimingColumn.HEARTBEAT_MAX_NS: vendor.heartbeat_max_ns,
        TimingColumn.PIGGYBACK_WHEN_FULL: int(vendor.piggyback_when_full),
        TimingColumn.NACK_DELAY_NS: vendor.nack_delay_ns,
        TimingColumn.ACK_DELAY_NS: vendor.ack_delay_ns,
        TimingColumn.NACK_RESPONSE_NS: vendor.nack_response_ns,
        TimingColumn.NACK_MOST: vendor.nack_most,
        TimingColumn.SHARED: int(medium.shared),
        TimingColumn.LATENCY_NS: _ns(medium.latency_s),
        TimingColumn.OVERHEAD_NS: _ns(medium.overhead_s),
        TimingColumn.DURATION_NS: _ns(scenario.duration_s),
        TimingColumn.UNACKED_MOST: scenario.unacked_most,
        TimingColumn.DRAIN_NS: _ns(scenario.drain_s),
        TimingColumn.PROMPT: int(vendor.prompt),
        TimingColumn.FINAL_NS: vendor.final_within_ns,
        TimingColumn.REORDER_MOST: vendor.reorder_most,
        TimingColumn.BURST_BYTES: vendor.burst_bytes,
    }
    return np.array([values[column] for column in TimingColumn], np.int64)


def _most_samples(scenario: Scenario) -> int:
    """Return how many samples one flow can have at most; a chain publishes once for each that it follows."""
    own = {flow.name: scheduled_samples(scenario, flow) for flow in scenario.flows}
    most = own
    for _ in scenario.flows:  # a chain is as long as there are flows, at most; a ring has no end
        before, most = most, dict(own)
        for flow in scenario.flows:
            if flow.then:
                most[flow.then] += before[flow.name]
        if most == before:
            return max(most.values())
    return max(sum(own.values()), *most.values())


def scheduled_samples(scenario: Scenario, flow: Flow) -> int:
    """Return how many samples a flow publishes by itself at most."""
    return _ns(scenario.duration_s) // _ns(1 / flow.rate_hz) + 2 if flow.rate_hz else 0


def _most_under_way(medium: Medium) -> int:
    shortest_s = medium.overhead_s + _SMALLEST_FRAME_BYTES * 8 / medium.rate_bps
    return int(medium.latency_s / shortest_s) + 2


def _ns(seconds: float) -> int:
    return round(seconds * _S)
