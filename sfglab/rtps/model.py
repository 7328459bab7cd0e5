"""RELIABLE and KEEP_LAST as a model: flows, the medium with its rules, scenarios.

A flow is one topic's writer and its one reader; hosts share a medium; readers are served by executors that take
time. The protocol is RTPS 2.5, clause 8.4, timed as a vendor does (`vendors`).
"""

from __future__ import annotations

import math
from collections.abc import Mapping  # noqa: TC003 - a dataclass's fields are typed at run time
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Literal, get_args

import numpy as np

from sfglab.errors import InvalidValueError
from sfglab.qos import DEFAULT, Durability, History, QoSProfile, Reliability
from sfglab.rtps.state import FlowColumn, Frame, Params, Sizes, State, TimingColumn, new_state
from sfglab.rtps.vendors import FAST_DDS, Vendor
from sfglab.units import NS_PER_S

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

_NOT_NEGATIVE = (
    *("rate_hz", "phase_s", "size_bytes", "reader_depth"),
    *("service_s", "compare_s", "change_s", "max_silence_s"),
)

# --- The rules of the medium, plain Python: `medium` compiles them, the test hosts' radio calls them ----------

NETWORK_BYTES = 14 + 20 + 8  #: Ethernet, IPv4 and UDP headers of a frame.

BURST_ROOM = 512
"""More than the samples of one BURST: its second argument is their number, this times the heartbeats among
them, and the square of this times the newest sample of all where there are any."""

_BASE_BYTES = NETWORK_BYTES + 20
INFO_DST_BYTES, _HEARTBEAT_BYTES = 16, 32
_AROUND_BYTES, _CUT_BYTES = (
    14 + 20,
    1480,
)  # Ethernet's and IP's headers, and what a frame carries behind them


def frame_bytes(kind: int, size_bytes: int, riding: int) -> int:
    """Return the size of a frame on the medium, given its `Frame` and the CDR size of the flow's samples.

    Headers of the network and of RTPS (20 bytes); submessages INFO_DST 16, INFO_TS 12, DATA 24 and the payload,
    padded as CDR is, HEARTBEAT 32, ACKNACK 28 and a bitmap of 32, GAP 32 (RTPS 2.5, clause 9.4). `riding` is,
    of DATA, not 0 if a heartbeat rides along; of BURST, see `BURST_ROOM`.
    """
    sample = 12 + 24 + (size_bytes + 3) // 4 * 4
    if kind == Frame.DATA:
        return _BASE_BYTES + sample + (_HEARTBEAT_BYTES if riding else 0)
    if kind == Frame.FRAGMENT:
        return _AROUND_BYTES + _CUT_BYTES
    if kind == Frame.BURST:
        heartbeats = riding // BURST_ROOM % BURST_ROOM * _HEARTBEAT_BYTES
        whole = _BASE_BYTES + INFO_DST_BYTES + heartbeats + riding % BURST_ROOM * sample
        return _AROUND_BYTES + (whole - _AROUND_BYTES - 1) % _CUT_BYTES + 1
    return _BASE_BYTES + INFO_DST_BYTES + (28 + 32 if kind == Frame.ACKNACK else 32)


def fragments(size_bytes: int, riding: int) -> int:
    """Return how many full frames precede the last one of a BURST that IP cuts; arguments of `frame_bytes`."""
    payload = riding % BURST_ROOM * (12 + 24 + (size_bytes + 3) // 4 * 4)
    heartbeats = riding // BURST_ROOM % BURST_ROOM * _HEARTBEAT_BYTES
    whole = _BASE_BYTES + INFO_DST_BYTES + heartbeats + payload
    return (whole - _AROUND_BYTES - 1) // _CUT_BYTES


def data_bytes(size_bytes: int, *, with_heartbeat: bool) -> int:
    """Return the size of a sample's frame; `size_bytes` is the sample's in CDR."""
    return frame_bytes(Frame.DATA, size_bytes, int(with_heartbeat))


ACKNACK_BYTES = frame_bytes(Frame.ACKNACK, 0, 0)  #: Size of an acknowledgement's frame.


def airtime_ns(
    size_bytes: int, contenders: int, overhead_ns: int, rate_bps: float, contention: float
) -> int:
    """Return how long a frame is on air while so many hosts want to send, ns; the rest as `Medium` has it."""
    stretch = 1.0 + contention * (contenders - 1)
    return int((overhead_ns + size_bytes * 8e9 / rate_bps) * stretch)


def next_sender(waiting: Sequence[Any], turn: int) -> tuple[int, int]:
    """Return whose turn it is of the `waiting`, from host `turn` on, -1 for nobody's, and how many they are."""
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


def after_stall_ns(now_ns: int, every_ns: int, stall_ns: int) -> int:
    """Return when a frame can begin that is ready now: not while the medium stalls, as each period begins."""
    if stall_ns == 0 or now_ns % every_ns >= stall_ns:
        return now_ns
    return now_ns + stall_ns - now_ns % every_ns


def is_lost(bad: bool, draw: float, loss: float, burst_frames: float) -> bool:  # noqa: FBT001 - compiled
    """Return whether a frame is lost, given whether the sender's one before was and a number of [0, 1).

    Losses come in bursts of so many frames in the mean (E. N. Gilbert, Capacity of a Burst-Noise Channel, 1960,
    with every frame lost in the bad state); below 1 each is drawn by itself.
    """
    if burst_frames < 1:
        return draw < loss
    return draw >= 1 / burst_frames if bad else draw < loss / ((1 - loss) * burst_frames)


_MCS_BPS = (65.0, 58.5, 52.0, 39.0, 26.0, 19.5, 13.0, 6.5)
_MCS_LACKING_DB = (0, 1, 2, 6, 10, 13, 15, 18)


def rate_share(distance_m: float) -> float:
    """Return the share of the highest rate that is left at a distance from the access point, metres.

    The rates of 802.11n, 20 MHz, one stream (IEEE 802.11-2016, table 19-27), chosen by the sensitivity that
    each needs (table 19-23). Assumed: the highest up to 10 m, and ten times as far costs 35 dB indoors.
    """
    lacking_db = 35 * math.log10(max(distance_m, 10.0) / 10)
    place = max((i for i, db in enumerate(_MCS_LACKING_DB) if db <= lacking_db), default=0)
    return _MCS_BPS[place] / _MCS_BPS[0]


QueueRule = Literal["tail", "head", "block"]
QUEUE_RULES: tuple[QueueRule, ...] = get_args(QueueRule)


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
    #: Whose time it costs when a sample is taken; None: one of its own.
    executor: str | None = None
    service_s: float = 0.0  #: How much, seconds.
    #: What a repeated value costs instead, seconds, where cache control discards it before it is processed
    #: (paper B, section 2.3); None: no cache control.
    compare_s: float | None = None
    #: Mean time between changes of the value, seconds; 0: every sample differs.
    change_s: float = 0.0
    #: Whether a local cache holds repeated values back (paper B, section 2.2).
    cached: bool = False
    max_silence_s: float | None = None  #: The local cache's longest silence, seconds; None: none.
    #: Name of the flow that is published, with the same value, when a sample was processed.
    then: str | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Medium:
    """What carries the frames."""

    rate_bps: float = 20e6  #: Bits a second.
    loss: float = 0.01  #: Share of frames that are lost, after whatever the medium itself repeats.
    #: One half-duplex medium for all hosts (Wi-Fi); else each host sends independently.
    shared: bool = True
    #: Airtime of a frame beside its bits: preamble, gaps, acknowledgement.
    overhead_s: float = 300e-6
    #: By which share each further host that wants to send stretches a frame.
    contention: float = 0.15
    latency_s: float = 0.0  #: From the end of sending to arrival.
    queue_frames: int = 500  #: Frames that a host's queue holds.
    #: What a full one does: drops what comes last, as a driver's or an access point's; drops what came first,
    #: as CoDel does, the default of Ubuntu; blocks who sends, as Linux does where the socket's buffer is
    #: smaller. A test host's radio blocks where hosts share nothing.
    queue_rule: QueueRule = "tail"
    #: Whether frames go by an access point, a host more that contends: on air twice.
    access_point: bool = False
    #: Whether chance says who of those that wait sends next, as Wi-Fi's backoff does; else they take turns. In
    #: turns the same host wins each free place in a full access point's queue, and all others nothing.
    random_turns: bool = False
    #: Mean length of a burst of losses, frames; below 1: each is lost by itself.
    burst_frames: float = 0.0
    stall_every_s: float = 0.0  #: How often the medium stalls: scans, power saving, neighbours.
    stall_s: float = 0.0  #: For how long nothing begins to be sent then.
    #: How far hosts are from the access point, by name; see `rate_share`. Others are near.
    distances_m: Mapping[str, float] = field(default_factory=dict, hash=False)

    def __post_init__(self) -> None:
        if not 0 <= self.loss < 1 or self.rate_bps <= 0 or self.queue_frames < 1:
            raise InvalidValueError(
                "medium", self, "0 <= loss < 1, rate_bps > 0, queue_frames >= 1"
            )
        if (
            min(self.overhead_s, self.contention, self.latency_s, self.burst_frames, self.stall_s)
            < 0
        ):
            allowed = "overhead_s, contention, burst_frames, stall_s and latency_s from 0"
            raise InvalidValueError("medium", self, allowed)
        if self.queue_rule not in QUEUE_RULES:
            raise InvalidValueError("medium: queue_rule", self.queue_rule, ", ".join(QUEUE_RULES))
        if self.access_point and not self.shared:
            raise InvalidValueError(
                "medium: access_point", self.access_point, "only on a shared medium"
            )
        if self.stall_s and self.stall_s >= self.stall_every_s:
            given = self.stall_s, self.stall_every_s
            raise InvalidValueError(
                "medium: stall_s, stall_every_s", given, "stall_s < stall_every_s"
            )

    def rate_of(self, host: str) -> float:
        """Return the bits a second of frames to and from a host."""
        return self.rate_bps * rate_share(self.distances_m.get(host, 0.0))

    def begin_ns(self, now_ns: int) -> int:
        """Return when a frame can begin that is ready now, nanoseconds."""
        return after_stall_ns(now_ns, _ns(self.stall_every_s), _ns(self.stall_s))

    @property
    def overhead_ns(self) -> int:
        """`overhead_s` in nanoseconds."""
        return _ns(self.overhead_s)

    @property
    def latency_ns(self) -> int:
        """`latency_s` in nanoseconds."""
        return _ns(self.latency_s)

    def airtime_ns(self, size_bytes: int, contenders: int, rate_bps: float | None = None) -> int:
        """Return how long a frame is on air while so many hosts want to send, ns; None: of a near host."""
        return airtime_ns(
            size_bytes, contenders, self.overhead_ns, rate_bps or self.rate_bps, self.contention
        )


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
        if not self.duration_s > 0 or self.drain_s < 0:
            raise InvalidValueError(
                "duration_s, drain_s", (self.duration_s, self.drain_s), "> 0, >= 0"
            )


def _check_flow(flow: Flow, names: list[str]) -> None:
    if flow.then is not None and flow.then not in names:
        raise InvalidValueError(f"flow {flow.name!r}: then", flow.then, ", ".join(names))
    for name in _NOT_NEGATIVE:
        if (getattr(flow, name) or 0) < 0:
            raise InvalidValueError(
                f"flow {flow.name!r}: {name}", getattr(flow, name), "0 and more"
            )
    if flow.rate_hz > 1e9:
        raise InvalidValueError(f"flow {flow.name!r}: rate_hz", flow.rate_hz, "up to 1e9")


def compile_scenario(
    scenario: Scenario, *, samples: int, seed: int, trace: int = 0
) -> tuple[Params, State]:
    """Return a scenario as the engine's arrays, with room for so many samples a flow and frames of a trace."""
    hosts = _numbers(h for flow in scenario.flows for h in (flow.source, flow.target))
    executors = _numbers(flow.executor or f"{flow.name}\0" for flow in scenario.flows)
    medium = scenario.medium
    access_point = len(hosts) if medium.access_point else -1
    shortest_s = medium.overhead_s + _BASE_BYTES * 8 / medium.rate_bps
    params = Params(
        flows=_flow_table(scenario, hosts, executors),
        timing=_timing(scenario, access_point),
        rates=np.array([medium.loss, medium.contention, medium.burst_frames]),
        host_bps=np.array([medium.rate_of(host) for host in hosts]),
    )
    sizes = Sizes(
        hosts=len(hosts) + medium.access_point,
        servers=len(executors),
        samples=samples,
        queue=medium.queue_frames + (_BEYOND if medium.queue_rule == "block" else 0),
        flight=int(medium.latency_s / shortest_s) + 2,
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
            FlowColumn.READER_DEPTH: _depth(flow.qos)
            if flow.reader_depth is None
            else flow.reader_depth,
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


_BEYOND = 4096
"""Frames for which a queue that blocks has room beyond its bound: heartbeats, answers, whose threads wait."""


def _timing(scenario: Scenario, access_point: int) -> np.ndarray:
    vendor, medium = scenario.vendor, scenario.medium
    values: dict[TimingColumn, int] = {
        TimingColumn.DURATION_NS: _ns(scenario.duration_s),
        TimingColumn.DRAIN_NS: _ns(scenario.drain_s),
        TimingColumn.FINAL_NS: vendor.final_within_ns,
        TimingColumn.SENT_BEFORE: -1
        if vendor.sent_before_bytes is None
        else vendor.sent_before_bytes,
        TimingColumn.QUEUES: int(vendor.asynchronous),
        TimingColumn.GAPS: int(vendor.gap_for_gone),
        TimingColumn.QUEUE_RULE: QUEUE_RULES.index(medium.queue_rule),
        TimingColumn.ACCESS_POINT: access_point,
        TimingColumn.STALL_EVERY_NS: _ns(medium.stall_every_s),
        TimingColumn.STALL_NS: _ns(medium.stall_s),
    }

    def of_field(name: str) -> int:
        return int(
            next(getattr(one, name) for one in (vendor, medium, scenario) if hasattr(one, name))
        )

    # Other columns bear the names of fields.
    named = (values[c] if c in values else of_field(c.name.lower()) for c in TimingColumn)
    return np.fromiter(named, np.int64)


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
