"""RELIABLE and KEEP_LAST as a model: flows and scenarios, and how they become the engine's arrays.

A flow is one topic's writer and its one reader; hosts share a medium (`channel`); readers are served by
executors that take time. The protocol is RTPS 2.5, clause 8.4, timed as a vendor does (`vendors`).
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from sfglab.errors import InvalidValueError
from sfglab.qos import DEFAULT, Durability, History, QoSProfile, Reliability
from sfglab.rtps.channel import BLOCK, Medium
from sfglab.rtps.frames import LEAST_BYTES
from sfglab.rtps.state import (
    FlowFields,
    Params,
    Rates,
    Sizes,
    State,
    TimingFields,
    new_state,
    record,
)
from sfglab.rtps.vendors import FAST_DDS, Vendor
from sfglab.units import NS_PER_S

if TYPE_CHECKING:
    from collections.abc import Iterable

_FROM_ZERO = (
    "rate_hz",
    "phase_s",
    "size_bytes",
    "reader_depth",
    "service_s",
    "compare_s",
    "change_s",
    "max_silence_s",
)
_RATE_MOST_HZ = 1e9  # a period of one nanosecond

_BLOCKED_ROOM = 4096
"""Room of a queue that blocks beyond its bound, frames: for heartbeats and ACKNACKs, whose threads wait."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Flow:
    """One topic with its writer and its reader."""

    name: str  #: Name for messages and tables.
    source: str  #: Host of the writer.
    target: str  #: Host of the reader.
    size_bytes: int = 24  #: CDR size of a sample.
    rate_hz: float = 0.0  #: Samples per second; 0: published only when a chain publishes it.
    phase_s: float = 0.0  #: Time of the first publication, seconds.
    qos: QoSProfile = DEFAULT  #: QoS of the writer. The model has no deadline.
    reader_depth: int | None = None  #: History of the reader; 0: KEEP_ALL; None: as the writer's.
    #: Name of the executor that takes the samples, one at a time; None: one for this flow only.
    executor: str | None = None
    service_s: float = 0.0  #: Time of the executor that one sample costs, seconds.
    #: Time that a repeated value costs instead, seconds, where cache control discards it before it is
    #: processed (paper B, section 2.3); None: no cache control.
    compare_s: float | None = None
    #: Mean time between changes of the value, seconds; 0: every sample differs.
    change_s: float = 0.0
    #: Whether a local cache suppresses repeated values (paper B, section 2.2).
    cached: bool = False
    max_silence_s: float | None = None  #: Maximum silence of the local cache, seconds; None: none.
    #: Name of the flow that is published, with the same value, when a sample was processed.
    then: str | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Scenario:
    """Everything that a run needs but the seed.

    Raises:
        InvalidValueError: Names are not unique, or a field is out of its range.
    """

    flows: tuple[Flow, ...]  #: The topics.
    medium: Medium = field(default_factory=Medium)  #: The medium.
    vendor: Vendor = FAST_DDS  #: Timing of the protocol.
    duration_s: float = 60.0  #: Time of publishing, seconds.
    drain_s: float = 10.0  #: Time of retransmissions afterwards, seconds.
    unacked_most: int = 5000  #: Unacknowledged samples at which a KEEP_ALL writer refuses more.

    def __post_init__(self) -> None:
        names = [flow.name for flow in self.flows]
        if not names or len(set(names)) != len(names):
            raise InvalidValueError("flows", names, "different names, one at least")
        for flow in self.flows:
            _check_flow(flow, names)
        if not self.duration_s > 0 or self.drain_s < 0:
            times_s = self.duration_s, self.drain_s
            raise InvalidValueError("duration_s, drain_s", times_s, "> 0, >= 0")


def _check_flow(flow: Flow, names: list[str]) -> None:
    place = f"flow {flow.name!r}"
    if flow.then is not None and flow.then not in names:
        raise InvalidValueError(f"{place}: then", flow.then, ", ".join(names))
    for name in _FROM_ZERO:
        value = getattr(flow, name)
        if value is not None and value < 0:
            raise InvalidValueError(f"{place}: {name}", value, "0 and more")
    if flow.rate_hz > _RATE_MOST_HZ:
        raise InvalidValueError(f"{place}: rate_hz", flow.rate_hz, "up to 1e9")


def compile_scenario(
    scenario: Scenario, *, samples: int, seed: int, trace: int = 0
) -> tuple[Params, State]:
    """Return a scenario as the engine's arrays.

    Args:
        scenario: Flows, medium, vendor and times.
        samples: Most samples of one flow.
        seed: Seed of losses, values and random turns.
        trace: Frames of which a trace is kept.
    """
    hosts = _numbers(host for flow in scenario.flows for host in (flow.source, flow.target))
    executors = _numbers(_executor(flow) for flow in scenario.flows)
    medium = scenario.medium
    shortest_s = medium.overhead_s + LEAST_BYTES * 8 / medium.rate_bps
    access_point = len(hosts) if medium.access_point else -1
    params = Params(
        flows=_flow_table(scenario, hosts, executors),
        timing=_timing(scenario, access_point),
        rates=_filled(Rates, medium),
    )
    sizes = Sizes(
        hosts=len(hosts) + medium.access_point,
        servers=len(executors),
        samples=samples,
        queue=medium.queue_frames + (_BLOCKED_ROOM if medium.rule == BLOCK else 0),
        flight=int(medium.latency_s / shortest_s) + 2,
        trace=trace,
    )
    return params, new_state(params, sizes, seed=seed)


def _numbers(names: Iterable[str]) -> dict[str, int]:
    return {name: i for i, name in enumerate(dict.fromkeys(names))}


def _executor(flow: Flow) -> str:
    return flow.executor or f"{flow.name}\0"


def _depth(qos: QoSProfile) -> int:
    return 0 if qos.history is History.KEEP_ALL else qos.depth


def _flow_table(scenario: Scenario, hosts: dict[str, int], executors: dict[str, int]) -> np.ndarray:
    numbers = _numbers(flow.name for flow in scenario.flows)
    rows = []
    for flow in scenario.flows:
        depth = _depth(flow.qos)
        row = FlowFields(
            source=hosts[flow.source],
            target=hosts[flow.target],
            server=executors[_executor(flow)],
            period_ns=_ns(1 / flow.rate_hz) if flow.rate_hz else 0,
            phase_ns=_ns(flow.phase_s),
            size_bytes=flow.size_bytes,
            depth=depth,
            reader_depth=depth if flow.reader_depth is None else flow.reader_depth,
            reliable=flow.qos.reliability is Reliability.RELIABLE,
            chain=-1 if flow.then is None else numbers[flow.then],
            change_ns=_ns(flow.change_s),
            cached=flow.cached,
            silence_ns=_ns(flow.max_silence_s or 0.0),
            service_ns=_ns(flow.service_s),
            compare_ns=-1 if flow.compare_s is None else _ns(flow.compare_s),
            keeps_acked=flow.qos.durability is Durability.TRANSIENT_LOCAL,
        )
        rows.append(tuple(row))
    return np.array(rows, record(FlowFields))


def _timing(scenario: Scenario, access_point: int) -> np.ndarray:
    before = scenario.vendor.sent_before_bytes
    timing = _filled(TimingFields, scenario, scenario.medium, scenario.vendor)
    timing["duration_ns"] = _ns(scenario.duration_s)
    timing["drain_ns"] = _ns(scenario.drain_s)
    timing["queue_rule"] = scenario.medium.rule
    timing["access_point"] = access_point
    timing["sent_before"] = -1 if before is None else before
    return timing


def _filled(fields: Any, *sources: object) -> np.ndarray:
    """Return one record with the attributes of the sources that have the names of its fields."""
    row = np.zeros((), record(fields))
    for name in fields._fields:
        for source in sources:
            value = getattr(source, name, None)
            if isinstance(value, int | float):
                row[name] = value
    return row


def end_ns(scenario: Scenario) -> int:
    """Return the time at which a run ends, ns: publishing and retransmissions."""
    return _ns(scenario.duration_s) + _ns(scenario.drain_s)


def most_samples(scenario: Scenario) -> int:
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


def _ns(seconds: float) -> int:
    return round(seconds * NS_PER_S)
