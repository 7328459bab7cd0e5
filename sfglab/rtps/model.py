"""The module `model` models RELIABLE and KEEP_LAST: flows and scenarios, and their form as the engine's arrays.

A flow is one topic's writer and reader. Hosts share a medium (`channel`). Executors that take time serve the
readers. The protocol is RTPS 2.5, clause 8.4, with the timing of a vendor (`vendors`).
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from sfglab.errors import InvalidValueError
from sfglab.fields import between, check_bounds
from sfglab.qos import DEFAULT, Durability, History, QoSProfile, Reliability
from sfglab.rtps.channel import BLOCK, Medium
from sfglab.rtps.frames import LEAST_BYTES
from sfglab.rtps.state import (
    FlowFields,
    Params,
    Sizes,
    State,
    TimingFields,
    new_state,
    record,
)
from sfglab.rtps.vendors import FAST_DDS, Vendor
from sfglab.units import NS_PER_S

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

_LONGEST_S = 1e9  # The nanoseconds of this time fit into 63 bits.

_BLOCKED_ROOM = 4096
"""Frames that fit beyond the bound of a queue that blocks: heartbeats and ACKNACKs, whose threads wait."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Flow:
    """A `Flow` is one topic with its writer and its reader.

    Raises:
        InvalidValueError: A value is out of its bounds, or the history is KEEP_ALL.
    """

    name: str  #: Name of the flow for messages and tables.
    source: str  #: Host of the writer.
    target: str  #: Host of the reader.
    size_bytes: int = between(24)  #: CDR size of a sample, bytes.
    #: Samples per second, with 1 ns or more between two samples; 0 if only a chain publishes the flow.
    rate_hz: float = between(0.0, 0, 1e9)
    phase_s: float = between(0.0, 0, _LONGEST_S)  #: Time of the first publication, seconds.
    qos: QoSProfile = DEFAULT  #: QoS of the writer. The model has no deadline and no KEEP_ALL.
    #: Depth of the reader's history; None for the depth of the writer's history.
    reader_depth: int | None = between(None, 1)
    #: Name of the executor that takes the samples, one at a time; None for an executor of this flow only.
    executor: str | None = None
    #: Time of the executor per sample, seconds.
    service_s: float = between(0.0, 0, _LONGEST_S)
    #: Time of the executor per repeated value, seconds, if cache control discards the value before processing
    #: (paper B, section 2.3); None: no cache control.
    compare_s: float | None = between(None, 0, _LONGEST_S)
    #: Mean time between changes of the value, seconds; 0 if every sample has a new value.
    change_s: float = between(0.0, 0, _LONGEST_S)
    #: Whether a local cache suppresses repeated values (paper B, section 2.2).
    cached: bool = False
    #: Name of the flow that is published, with the same value, when a sample was processed. It is later in
    #: `Scenario.flows`, and its own value does not change with time (`change_s`).
    then: str | None = None

    def __post_init__(self) -> None:
        check_bounds(self, f"flow {self.name!r}: ")
        if self.qos.history is not History.KEEP_LAST:
            place = f"flow {self.name!r}: qos.history"
            raise InvalidValueError(place, self.qos.history.value, History.KEEP_LAST.value)


@dataclass(frozen=True, slots=True, kw_only=True)
class Scenario:
    """A `Scenario` has all inputs of a run except the seed.

    Raises:
        InvalidValueError: Names are not unique, a field is out of its range, or a flow publishes none of
            those after it (`Flow.then`).
    """

    flows: tuple[Flow, ...]  #: Flows of the run.
    medium: Medium = field(default_factory=Medium)  #: Medium that carries all frames.
    vendor: Vendor = FAST_DDS  #: Timing of the protocol.
    #: Duration of publishing, seconds.
    duration_s: float = between(60.0, 0, _LONGEST_S, without=(0,))
    #: Duration of retransmissions after publishing, seconds.
    drain_s: float = between(10.0, 0, _LONGEST_S)

    def __post_init__(self) -> None:
        names = [flow.name for flow in self.flows]
        if not names or len(set(names)) != len(names):
            raise InvalidValueError("flows", names, "at least one flow, with different names")
        check_bounds(self)
        check_chains(self.flows)


def check_chains(flows: Sequence[Flow]) -> None:
    """Check that each flow's `then` names a later flow whose value does not change with time.

    Raises:
        InvalidValueError: A flow's `then` names another one.
    """
    for place, flow in enumerate(flows, 1):
        later = [other.name for other in flows[place:] if not other.change_s]
        if flow.then is not None and flow.then not in later:
            allowed = f"later flows without change_s: {', '.join(later)}"
            raise InvalidValueError(f"flow {flow.name!r}: then", flow.then, allowed)


def compile_scenario(scenario: Scenario, *, seed: int, trace: int = 0) -> tuple[Params, State]:
    """Return a scenario as the arrays of the engine.

    Args:
        scenario: Flows, medium, vendor and times.
        seed: Seed of losses, values and random turns.
        trace: Number of frames in the trace.
    """
    hosts = _numbers(host for flow in scenario.flows for host in (flow.source, flow.target))
    executors = _numbers(_executor(flow) for flow in scenario.flows)
    medium = scenario.medium
    shortest_s = medium.overhead_s + LEAST_BYTES * 8 / medium.rate_bps
    access_point = len(hosts) if medium.access_point else -1
    params = Params(
        flows=_flow_table(scenario, hosts, executors),
        timing=_timing(scenario, access_point),
    )
    sizes = Sizes(
        hosts=len(hosts) + medium.access_point,
        servers=len(executors),
        samples=most_samples(scenario),
        queue=medium.queue_frames + (_BLOCKED_ROOM if medium.rule == BLOCK else 0),
        flight=int(medium.latency_s / shortest_s) + 2,
        trace=trace,
    )
    return params, new_state(params, sizes, seed=seed)


def _numbers(names: Iterable[str]) -> dict[str, int]:
    return {name: i for i, name in enumerate(dict.fromkeys(names))}


def _executor(flow: Flow) -> str:
    return flow.executor or f"{flow.name}\0"


def _flow_table(scenario: Scenario, hosts: dict[str, int], executors: dict[str, int]) -> np.ndarray:
    numbers = _numbers(flow.name for flow in scenario.flows)
    rows = []
    for flow in scenario.flows:
        depth = flow.qos.depth
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
    timing["queue_rule"] = scenario.medium.rule
    timing["access_point"] = access_point
    timing["sent_before"] = -1 if before is None else before
    return timing


def _filled(fields: Any, *sources: object) -> np.ndarray:
    """Return one record with the fields of a record class, from the attributes of these names in the sources."""
    row = np.zeros((), record(fields))
    for name in fields._fields:
        for source in sources:
            value = getattr(source, name, None)
            if isinstance(value, int | float):
                row[name] = value
    return row


def end_ns(scenario: Scenario) -> int:
    """Return the duration of a run, ns: the time of publishing and the time of retransmissions after it."""
    return _ns(scenario.duration_s) + _ns(scenario.drain_s)


def most_samples(scenario: Scenario) -> int:
    """Return the largest number of samples that one flow can have.

    A flow that others trigger (`Flow.then`) publishes one sample per sample of theirs.
    """
    most = dict.fromkeys((flow.name for flow in scenario.flows), 0)
    for flow in scenario.flows:
        if flow.rate_hz:
            most[flow.name] += _ns(scenario.duration_s) // _ns(1 / flow.rate_hz) + 2
        if flow.then is not None:
            most[flow.then] += most[flow.name]
    return max(most.values())


def _ns(seconds: float) -> int:
    return round(seconds * NS_PER_S)
