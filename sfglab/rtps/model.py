"""RELIABLE and KEEP_LAST as a model: vendors' timing, flows, the medium with its rules, scenarios.

A flow is one topic's writer and its one reader; hosts share a medium; readers are served by executors that take
time. The protocol is RTPS 2.5, clause 8.4, timed as a vendor does: times are the vendors' defaults, with their
sources; what a default does in the protocol stands in `writer` and `reader`. Here is everything that a run is
given, and it becomes the arrays that the engine takes.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from sfglab.errors import InvalidValueError
from sfglab.qos import DEFAULT, Durability, History, QoSProfile, Reliability
from sfglab.rtps.state import FlowColumn, Frame, Params, Sizes, State, TimingColumn, new_state
from sfglab.units import NS_PER_MS, NS_PER_S

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence


_NOT_NEGATIVE = (
    *("rate_hz", "phase_s", "size_bytes", "reader_depth"),
    *("service_s", "compare_s", "change_s", "max_silence_s"),
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Vendor:
    """How one DDS implementation times its reliability protocol (RTPS 2.5, clause 8.4)."""

    name: str  #: Of the implementation.
    heartbeat_ns: int  #: Period of heartbeats while something is unacknowledged.
    #: The period doubles with each heartbeat that brings no progress, up to this; equal to `heartbeat_ns` where
    #: it does not.
    heartbeat_max_ns: int
    #: A heartbeat travels with each sample while the writer's history is full: of samples that are
    #: unacknowledged, and with TRANSIENT_LOCAL durability of any.
    piggyback_when_full: bool
    nack_delay_ns: int  #: From the first heartbeat that shows a gap to the reader's request.
    ack_delay_ns: int  #: From a heartbeat that shows no gap to the reader's acknowledgement.
    nack_response_ns: int  #: From a request to the writer's repair.
    #: Samples that one request can ask for: a bitmap has 256 bits (RTPS 2.5, clause 9.4.2.6).
    nack_most: int = 256
    #: A heartbeat travels with every sample. The reader answers each at once: with a request if it lacks
    #: something that it has not asked for yet, with an acknowledgement only if it is asked. `nack_delay_ns` is
    #: then how long it waits before it asks for the same again, `ack_delay_ns` before it acknowledges the same
    #: again. The writer's repairs end with a heartbeat to which the reader may ask again at once, and it sends
    #: a periodic one only if it has sent no other for a period, which does not grow.
    prompt: bool = False
    #: A heartbeat that travels with a sample asks for no answer (it is FINAL) when the sample before is younger
    #: than this; 0: it always asks.
    final_within_ns: int = 0
    #: Samples that wait behind a gap, apart from the reader's history; beyond that the newest is dropped. 0:
    #: they wait in the reader's history.
    reorder_most: int = 0
    burst_bytes: int = 0  #: RTPS message in which repairs travel together; 0: each has a frame of its own.

    def __post_init__(self) -> None:
        if not 0 < self.heartbeat_ns <= self.heartbeat_max_ns:
            raise InvalidValueError(
                f"{self.name}: heartbeat_ns, heartbeat_max_ns",
                (self.heartbeat_ns, self.heartbeat_max_ns),
                "0 < heartbeat_ns <= heartbeat_max_ns",
            )
        delays_ns = self.nack_delay_ns, self.ack_delay_ns, self.nack_response_ns
        if min(delays_ns) < 0:
            raise InvalidValueError(f"{self.name}: delays", delays_ns, "0 and more")
        if not 1 <= self.nack_most <= 256:
            raise InvalidValueError(f"{self.name}: nack_most", self.nack_most, "1 to 256")


FAST_DDS = Vendor(
    name="Fast DDS",
    # fastdds/rtps/attributes/WriterAttributes.hpp: heartbeatPeriod 3 s, nackResponseDelay 5 ms;
    # ReaderAttributes.hpp: heartbeatResponseDelay 5 ms, for requests and acknowledgements alike;
    # StatefulWriter.cpp: a heartbeat is sent along when the history is full; DataWriterImpl.cpp (2.x, 3.x) and
    # PublisherImpl.cpp (before): a VOLATILE writer's sample leaves the history once all have acknowledged it.
    heartbeat_ns=3 * NS_PER_S,
    heartbeat_max_ns=3 * NS_PER_S,
    piggyback_when_full=True,
    nack_delay_ns=5 * NS_PER_MS,
    ack_delay_ns=5 * NS_PER_MS,
    nack_response_ns=5 * NS_PER_MS,
)

CYCLONE_DDS = Vendor(
    name="Cyclone DDS",
    # docs/manual/options.md: HeartbeatInterval 100 ms (min 5 ms, minsched 20 ms, max 8 s), NackDelay 100 ms,
    # AckDelay 10 ms, PrimaryReorderMaxSamples 128, MaxRexmitMessageSize 1456 B. ddsi_hbcontrol.c: a heartbeat
    # travels with every sample and asks for an answer when 4/5 of the interval have passed since the sample
    # before; the interval grows after five heartbeats in vain, which is left out. ddsi_acknack.c: what is new
    # is asked for at once. ddsi_radmin.c: no more is asked for than can wait.
    heartbeat_ns=100 * NS_PER_MS,
    heartbeat_max_ns=8 * NS_PER_S,
    piggyback_when_full=False,
    nack_delay_ns=100 * NS_PER_MS,
    ack_delay_ns=10 * NS_PER_MS,
    nack_response_ns=0,
    nack_most=128,
    prompt=True,
    final_within_ns=80 * NS_PER_MS,
    reorder_most=128,
    burst_bytes=1456,
)

PRESETS = {"fast_dds": FAST_DDS, "cyclone_dds": CYCLONE_DDS}


# --- The rules of the medium, plain Python: `medium` compiles them, the test hosts' radio calls them ----------

NETWORK_BYTES = 14 + 20 + 8
"""Ethernet, IPv4 and UDP headers of a frame."""

BURST_ROOM = 512
"""More than the samples of one BURST: its second argument is their number, and this times the newest sample of
all where a heartbeat rides along."""

_BASE_BYTES = NETWORK_BYTES + 20
_INFO_DST_BYTES, _HEARTBEAT_BYTES = 16, 32


def frame_bytes(kind: int, size_bytes: int, riding: int) -> int:
    """Return the size of a frame on the medium, given its `Frame` and the CDR size of the flow's samples.

    Headers of the network and of RTPS (20 bytes); submessages INFO_DST 16, INFO_TS 12, DATA 24 and the payload,
    padded as CDR is, HEARTBEAT 32, ACKNACK 28 and a bitmap of 32, GAP 32 (RTPS 2.5, clause 9.4). `riding` is,
    of DATA, not 0 if a heartbeat rides along; of BURST, see `BURST_ROOM`.
    """
    sample = 12 + 24 + (size_bytes + 3) // 4 * 4
    if kind == Frame.DATA:
        return _BASE_BYTES + sample + (_HEARTBEAT_BYTES if riding else 0)
    if kind == Frame.BURST:
        heartbeat = _HEARTBEAT_BYTES if riding >= BURST_ROOM else 0
        return _BASE_BYTES + _INFO_DST_BYTES + heartbeat + riding % BURST_ROOM * sample
    return _BASE_BYTES + _INFO_DST_BYTES + (28 + 32 if kind == Frame.ACKNACK else 32)


def data_bytes(size_bytes: int, *, with_heartbeat: bool) -> int:
    """Return the size of a sample's frame; `size_bytes` is the sample's in CDR."""
    return frame_bytes(Frame.DATA, size_bytes, int(with_heartbeat))


ACKNACK_BYTES = frame_bytes(Frame.ACKNACK, 0, 0)
"""Size of an acknowledgement's frame."""


def airtime_ns(size_bytes: int, contenders: int, overhead_ns: int, rate_bps: float, contention: float) -> int:
    """Return how long a frame is on air while so many hosts want to send, ns; the rest as `Medium` has it."""
    stretch = 1.0 + contention * (contenders - 1)
    return int((overhead_ns + size_bytes * 8e9 / rate_bps) * stretch)


def next_sender(waiting: Sequence[Any], turn: int) -> tuple[int, int]:
    """Return whose turn it is, -1 for nobody's, and how many want to send: those that are `waiting`.

    The host `turn` is asked first; the others follow.
    """
    hosts = len(waiting)
    chosen, contenders = -1, 0
    host = turn - 1
    for _ in range(hosts):
        host += 1
        if host == hosts:
            host = 0
        if waiting[host]:
            contenders += 1
            if chosen < 0:
                chosen = host
    return chosen, contenders


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

    @property
    def overhead_ns(self) -> int:
        """`overhead_s` in nanoseconds."""
        return _ns(self.overhead_s)

    @property
    def latency_ns(self) -> int:
        """`latency_s` in nanoseconds."""
        return _ns(self.latency_s)

    def airtime_ns(self, size_bytes: int, contenders: int) -> int:
        """Return how long a frame is on air while so many hosts want to send, nanoseconds."""
        return airtime_ns(size_bytes, contenders, self.overhead_ns, self.rate_bps, self.contention)


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
            raise InvalidValueError("flows", names, "different names, one at least")
        for flow in self.flows:
            _check_flow(flow, names)
        medium = self.medium
        if not 0 <= medium.loss < 1 or medium.rate_bps <= 0 or medium.queue_frames < 1:
            raise InvalidValueError("medium", medium, "0 <= loss < 1, rate_bps > 0, queue_frames >= 1")
        if min(medium.overhead_s, medium.contention, medium.latency_s) < 0:
            raise InvalidValueError("medium", medium, "overhead_s, contention and latency_s from 0")
        if not self.duration_s > 0 or self.drain_s < 0:
            raise InvalidValueError("duration_s, drain_s", (self.duration_s, self.drain_s), "> 0, >= 0")


def _check_flow(flow: Flow, names: list[str]) -> None:
    if flow.then is not None and flow.then not in names:
        raise InvalidValueError(f"flow {flow.name!r}: then", flow.then, ", ".join(names))
    for field in _NOT_NEGATIVE:
        if (getattr(flow, field) or 0) < 0:
            raise InvalidValueError(f"flow {flow.name!r}: {field}", getattr(flow, field), "0 and more")
    if flow.rate_hz > 1e9:
        raise InvalidValueError(f"flow {flow.name!r}: rate_hz", flow.rate_hz, "up to 1e9")


def compile_scenario(scenario: Scenario, *, samples: int, seed: int, trace: int = 0) -> tuple[Params, State]:
    """Return a scenario as the arrays that the engine takes.

    There is room for so many samples of each flow, and for a trace of so many frames.
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
        trace=trace,
    )
    return params, new_state(params, sizes, seed=seed)


def _numbers(names: Iterable[str]) -> dict[str, int]:
    return {name: i for i, name in enumerate(dict.fromkeys(names))}


def _depth(qos: QoSProfile) -> int:
    return 0 if qos.history is History.KEEP_ALL else qos.depth


def _flow_table(scenario: Scenario, hosts: dict[str, int], executors: dict[str, int]) -> np.ndarray:
    numbers = {flow.name: i for i, flow in enumerate(scenario.flows)}
    table = np.zeros((len(numbers), len(FlowColumn)), np.int64)
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
            FlowColumn.CHAIN: -1 if flow.then is None else numbers[flow.then],
            FlowColumn.CHANGE_NS: _ns(flow.change_s),
            FlowColumn.CACHED: int(flow.cached),
            FlowColumn.SILENCE_NS: _ns(flow.max_silence_s or 0.0),
            FlowColumn.SERVICE_NS: _ns(flow.service_s),
            FlowColumn.KEEPS_ACKED: int(flow.qos.durability is Durability.TRANSIENT_LOCAL),
            FlowColumn.COMPARE_NS: -1 if flow.compare_s is None else _ns(flow.compare_s),
        }
        table[i] = [row[column] for column in FlowColumn]
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
        TimingColumn.LATENCY_NS: medium.latency_ns,
        TimingColumn.OVERHEAD_NS: medium.overhead_ns,
        TimingColumn.DURATION_NS: _ns(scenario.duration_s),
        TimingColumn.UNACKED_MOST: scenario.unacked_most,
        TimingColumn.DRAIN_NS: _ns(scenario.drain_s),
        TimingColumn.PROMPT: int(vendor.prompt),
        TimingColumn.FINAL_NS: vendor.final_within_ns,
        TimingColumn.REORDER_MOST: vendor.reorder_most,
        TimingColumn.BURST_BYTES: vendor.burst_bytes,
    }
    return np.array([values[column] for column in TimingColumn], np.int64)


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


def _most_under_way(medium: Medium) -> int:
    shortest_s = medium.overhead_s + _BASE_BYTES * 8 / medium.rate_bps
    return int(medium.latency_s / shortest_s) + 2


def _ns(seconds: float) -> int:
    return round(seconds * NS_PER_S)
