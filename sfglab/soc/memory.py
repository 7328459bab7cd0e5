"""The memory model: how long messages take between software and hardware that share one memory interface.

ReconROS' memory interface (MEMIF) moves chunks of 256 bytes over 64 bits at 100 MHz, one after another without
overlap, and serves requesting nodes in turn (paper C, sections 2.2 and 3; controller and arbiter of ReconROS'
reference design). Of the other costs there are two sets, one for each way in which a gateway core may pass
chunks on; each was fitted once to the paper values of section 4 (`sfglab.soc.paper_values`).

The paths are those of section 4, Fig. 5. A software-mapped topic (SMT) lies in main memory: its publisher pays
for the publication, then one delivery a reader; a hardware reader is woken by its delegate and reads the
message over the shared interface. A hardware-mapped topic (HMT) is a stream. A gateway is both, its core one
reader of the SMT and one port of the HMT. Every order of serving readers, which the paper leaves open, is
equally likely. Left out: that processors and hardware share the memory chips, and that deliveries may run on
several processors. The paper's rule (section 5) knows no sizes: hence break-even sizes. Refuses to know graphs.
"""

from __future__ import annotations

from bisect import bisect_left
from dataclasses import dataclass, fields, replace
from enum import Enum
from typing import TYPE_CHECKING, Any

from sfglab.errors import InvalidValueError
from sfglab.fields import between, check_bounds

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence


class Forwarding(Enum):
    """What a gateway core does with a chunk on its way between memory and stream."""

    STORED = "stored"  #: Fills its chunk buffer, then empties it: the cycles of both sides add up.
    CUT_THROUGH = "cut-through"  #: Passes beats on as they come: the slower side counts.


@dataclass(frozen=True, slots=True, kw_only=True)
class MemoryInterface:
    """Cycles of the MEMIF and of a stream beside it."""

    width_bytes: int = between(8, 0, without=(0,))  #: Bytes a cycle, of MEMIF and streams alike.
    clock_hz: float = between(100e6, 0, without=(0,))  #: The system clock.
    chunk_bytes: int = between(256, 0, without=(0,))  #: Bytes of one request.
    #: Cycles of a request with neither address nor data under way.
    control_cycles: float = between(4.0)
    read_latency_cycles: float = between(30.0)  #: From a read request to its first word.
    write_latency_cycles: float = between(9.0)  #: From a write's last word to its response.
    forwarding: Forwarding = Forwarding.STORED  #: How a gateway core passes chunks on.

    def __post_init__(self) -> None:
        check_bounds(self)

    def chunks(self, message_bytes: float) -> int:
        """Return the requests that a message takes."""
        return int(-(-message_bytes // self.chunk_bytes))

    @property
    def data_cycles(self) -> float:
        """Cycles in which a chunk's words pass, on the MEMIF or on a stream."""
        return self.chunk_bytes / self.width_bytes

    @property
    def read_cycles(self) -> float:
        """Cycles of one chunk read from memory."""
        return self.control_cycles + self.read_latency_cycles + self.data_cycles

    @property
    def write_cycles(self) -> float:
        """Cycles of one chunk written to memory."""
        return self.control_cycles + self.write_latency_cycles + self.data_cycles

    def read_s(self, message_bytes: float) -> float:
        """Return the seconds in which one node alone reads a message."""
        return self._seconds(message_bytes, self.read_cycles)

    def write_s(self, message_bytes: float) -> float:
        """Return the seconds in which one node alone writes a message."""
        return self._seconds(message_bytes, self.write_cycles)

    def stream_s(self, message_bytes: float) -> float:
        """Return the seconds that a message takes on a stream nobody holds up."""
        return -(-message_bytes // self.width_bytes) / self.clock_hz

    def memory_to_stream_s(self, message_bytes: float) -> float:
        """Return the seconds in which a gateway core brings a message from memory to a stream."""
        return self._seconds(message_bytes, self._forwarded(self.read_cycles))

    def stream_to_memory_s(self, message_bytes: float) -> float:
        """Return the seconds that a gateway core, and so all of the stream, takes to store a message."""
        return self._seconds(message_bytes, self._forwarded(self.write_cycles))

    def _forwarded(self, memory_cycles: float) -> float:
        """Return the cycles of a chunk through the core; cut through, the words already pass as they come."""
        return memory_cycles + (self.data_cycles if self.forwarding is Forwarding.STORED else 0.0)

    def _seconds(self, message_bytes: float, cycles: float) -> float:
        return self.chunks(message_bytes) * cycles / self.clock_hz


def shared_s(releases_s: Sequence[float], work_s: float) -> float:
    """Return when the last of several nodes has read its message, by when each starts and what it needs alone.

    Turns lose no time, so the last ends with the busy period that it ends in, whatever the turns' size: max
    over j of (release j + work of all released from j on).
    """
    ordered = sorted(releases_s)
    return max(release + (len(ordered) - j) * work_s for j, release in enumerate(ordered))


def round_robin_s(releases_s: Sequence[float], chunks: int, chunk_s: float) -> list[float]:
    """Return when each node has read `chunks` chunks of `chunk_s` s in turn; slow, exact, for `shared_s`."""
    left = [chunks] * len(releases_s)
    finished_s = list(releases_s)
    now_s, turn = min(releases_s), -1
    while any(left):
        ready = [i for i, n in enumerate(left) if n and releases_s[i] <= now_s]
        if not ready:
            now_s = min(releases_s[i] for i, n in enumerate(left) if n)
            continue
        turn = next((i for i in ready if i > turn), ready[0])
        now_s += chunk_s
        left[turn] -= 1
        finished_s[turn] = now_s
    return finished_s


class Origin(Enum):
    """Where a constant comes from."""

    REFERENCE = "reference design"
    ASSUMED = "assumed"
    FITTED = "fitted"


@dataclass(frozen=True, slots=True, kw_only=True)
class Constant:
    """A constant of the model, for a table."""

    name: str  #: Of the field of `Costs` or `MemoryInterface`.
    value: float  #: In its unit.
    unit: str  #: As text.
    origin: Origin  #: Where it comes from.
    reason: str  #: Why this value, or what it stands for.


@dataclass(frozen=True, slots=True, kw_only=True)
class Costs:
    """The model's constants."""

    memory: MemoryInterface  #: The memory interface.
    #: A hardware node's call to its delegate thread and back (OSIF round trip).
    delegate_s: float = 80e-6
    publish_s: float = 80e-6  #: A publication on a software-mapped topic: fixed part.
    publish_s_per_byte: float  #: The same: for each byte of the message.
    #: Its delivery to one reader, one after another: fixed part, with the reader's wake-up.
    deliver_s: float
    deliver_s_per_byte: float  #: The same: for each byte of the message.
    #: What a hardware node spends on a message before it sends or after it has received, whatever the topic;
    #: also the gateway core, when it forwards.
    endpoint_s: float
    cancel_s: float  #: A gateway core's cancel: interrupting the blocked delegate, and its answer.

    def __post_init__(self) -> None:
        for item in fields(self)[1:]:
            if (value := getattr(self, item.name)) < 0:
                raise InvalidValueError(f"costs: {item.name}", value, "from 0")

    def published_s(self, message_bytes: float) -> float:
        """Return the seconds of a message's publication on a software-mapped topic."""
        return self.publish_s + self.publish_s_per_byte * message_bytes

    def delivery_s(self, message_bytes: float) -> float:
        """Return the seconds of a message's delivery to one reader."""
        return self.deliver_s + self.deliver_s_per_byte * message_bytes


STORED = Costs(
    memory=MemoryInterface(write_latency_cycles=8.758),
    publish_s_per_byte=1.5527e-9,
    deliver_s=48.434e-6,
    deliver_s_per_byte=0.3598e-9,
    endpoint_s=373.57e-6,
    cancel_s=310.43e-6,
)
"""Fitted with a gateway core that stores a chunk before it passes it on: the better fit, and the default."""

CUT_THROUGH = Costs(
    memory=MemoryInterface(write_latency_cycles=51.554, forwarding=Forwarding.CUT_THROUGH),
    publish_s_per_byte=3.6766e-9,
    deliver_s=63.289e-6,
    deliver_s_per_byte=0.0477e-9,
    endpoint_s=445.43e-6,
    cancel_s=391.71e-6,
)
"""Fitted with a gateway core that passes beats on as they come."""

_TEMPLATE = "ReconROS, 64-bit template for the ZCU104"
_ORIGINS: dict[str, tuple[str, Origin, str]] = {
    "width_bytes": (
        "B/cycle",
        Origin.REFERENCE,
        f"{_TEMPLATE}: MEMIF, OSIF and topic streams of 64 bit",
    ),
    "clock_hz": ("Hz", Origin.REFERENCE, f"{_TEMPLATE}: system clock and build.cfg"),
    "chunk_bytes": ("B", Origin.REFERENCE, f"{_TEMPLATE}: requests of 32 words"),
    "control_cycles": (
        "cycles",
        Origin.REFERENCE,
        "four states of the memory controller, no request overlaps",
    ),
    "read_latency_cycles": (
        "cycles",
        Origin.ASSUMED,
        "300 ns from AXI request to DDR data; gives 388 MB/s",
    ),
    "write_latency_cycles": (
        "cycles",
        Origin.FITTED,
        "the write's response; a posted write beats a read",
    ),
    "delegate_s": ("s", Origin.ASSUMED, "two thread switches on a Cortex-A53; no number is stated"),
    "publish_s": ("s", Origin.ASSUMED, "as one delegate round trip; only sums with it matter"),
    "publish_s_per_byte": ("s/B", Origin.FITTED, "copying a message into the middleware"),
    "deliver_s": ("s", Origin.FITTED, "waking one reader"),
    "deliver_s_per_byte": ("s/B", Origin.FITTED, "copying a message for one reader"),
    "endpoint_s": (
        "s",
        Origin.FITTED,
        "common to both kinds of topic, so it pulls small messages towards 1",
    ),
    "cancel_s": ("s", Origin.FITTED, "the hardware publisher's overhead with a gateway"),
}


def constants(costs: Costs = STORED) -> list[Constant]:
    """Return every constant with its unit and origin, for a table."""
    found = []
    for name, (unit, origin, reason) in _ORIGINS.items():
        value = float(getattr(costs.memory if hasattr(costs.memory, name) else costs, name))
        found.append(Constant(name=name, value=value, unit=unit, origin=origin, reason=reason))
    return found


def fitted_values(costs: Costs) -> dict[str, float]:
    """Return the constants that are fitted, by name; all others stand."""
    return {item.name: item.value for item in constants(costs) if item.origin is Origin.FITTED}


def with_values(costs: Costs, values: Mapping[str, float]) -> Costs:
    """Return the costs with other values of constants, by their names, the memory interface's among them."""
    of_memory: dict[str, Any] = {
        name: value for name, value in values.items() if hasattr(costs.memory, name)
    }
    others = {name: value for name, value in values.items() if name not in of_memory}
    return replace(costs, memory=replace(costs.memory, **of_memory), **others)


class Side(Enum):
    """Where a node runs."""

    SOFTWARE = "software"
    HARDWARE = "hardware"


class Transport(Enum):
    """What a topic is mapped to."""

    SMT = "software-mapped topic"
    HMT = "hardware-mapped topic"
    GATEWAY = "gateway"


@dataclass(frozen=True, slots=True, kw_only=True)
class Setup:
    """One publisher, its topic and its subscribers (paper C, Fig. 5)."""

    publisher: Side  #: Where the publisher runs.
    transport: Transport  #: What the topic is mapped to.
    message_bytes: int  #: Size of the message.
    hardware: int  #: Subscribing hardware nodes.
    software: int = 1  #: Subscribing software nodes; the paper has one.

    def __post_init__(self) -> None:
        if self.message_bytes <= 0 or min(self.hardware, self.software) < 0:
            raise InvalidValueError(
                "setup", self, "a message and no negative number of subscribers"
            )
        if self.transport is Transport.HMT and (self.publisher is Side.SOFTWARE or self.software):
            raise InvalidValueError("setup", self, "only hardware nodes on a hardware-mapped topic")


@dataclass(frozen=True, slots=True, kw_only=True)
class Times:
    """Transfer times from the start of the publication, in seconds."""

    #: Until the last hardware subscriber has the message; None: there is none.
    hardware_s: float | None
    #: Until a software subscriber has it, mean over the order of deliveries; None: there is none.
    software_s: float | None


def transfer_times(setup: Setup, costs: Costs = STORED) -> Times:
    """Return how long one message takes."""
    hardware_s, software_s = _PATHS[setup.transport](setup, costs)
    return Times(
        hardware_s=hardware_s if setup.hardware else None,
        software_s=software_s if setup.software else None,
    )


def _over_smt(setup: Setup, costs: Costs) -> tuple[float, float]:
    """Return times over main memory alone."""
    x, readers = setup.message_bytes, setup.hardware + setup.software
    start_s = costs.published_s(x)
    if setup.publisher is Side.HARDWARE:
        start_s += costs.endpoint_s + costs.memory.write_s(x) + costs.delegate_s
    read_s = start_s + _all_read_s(setup.hardware, readers, x, costs) + costs.endpoint_s
    return read_s, start_s + _delivered_s(readers, x, costs)


def _over_hmt(setup: Setup, costs: Costs) -> tuple[float, float]:
    """Return the time on a stream nobody holds up; software has no part in it."""
    return 2 * costs.endpoint_s + costs.memory.stream_s(setup.message_bytes), 0.0


def _over_gateway(setup: Setup, costs: Costs) -> tuple[float, float]:
    """Return times through a gateway; the readers of its SMT are the software nodes and the core."""
    x, memory = setup.message_bytes, costs.memory
    smt_s = costs.published_s(x) + _delivered_s(setup.software + 1, x, costs)
    if setup.publisher is Side.SOFTWARE:
        forward_s = costs.delegate_s + costs.endpoint_s + memory.memory_to_stream_s(x)
        return smt_s + forward_s + costs.endpoint_s, smt_s
    sent_s = costs.endpoint_s + memory.stream_to_memory_s(x)
    forward_s = costs.endpoint_s + costs.cancel_s + costs.delegate_s
    return sent_s + costs.endpoint_s, sent_s + forward_s + smt_s


_PATHS = {Transport.SMT: _over_smt, Transport.HMT: _over_hmt, Transport.GATEWAY: _over_gateway}


def _delivered_s(readers: int, message_bytes: int, costs: Costs) -> float:
    """Return the mean delay of one reader among several: its place is (readers + 1) / 2."""
    return (readers + 1) / 2 * costs.delivery_s(message_bytes)


def _all_read_s(hardware: int, readers: int, message_bytes: int, costs: Costs) -> float:
    """Return the delay until the last hardware reader has read over the shared interface.

    Either the interface is the bottleneck, or the deliveries are, and the last reader finds it free. The mean
    place of the first of h among r readers is (r + 1)/(h + 1), and h times that of the last.
    """
    place = (readers + 1) / (hardware + 1) * costs.delivery_s(message_bytes)
    read_s = costs.memory.read_s(message_bytes)
    return costs.delegate_s + max(place + hardware * read_s, hardware * place + read_s)


LARGEST_BYTES = 1 << 30  #: Where the search for a break-even ends.


class Judge(Enum):
    """Whose transfer time counts."""

    HARDWARE = "the last hardware subscriber"
    SOFTWARE = "a software subscriber"
    LAST = "whoever is last"
    MEAN = "all subscribers, in the mean, hardware nodes each counted as the last of them"


def judged_s(times: Times, setup: Setup, judge: Judge) -> float:
    """Return the setup's time that counts for a judge, in seconds; 0 if nobody's does."""
    hardware_s, software_s = times.hardware_s or 0.0, times.software_s or 0.0
    if judge is Judge.HARDWARE:
        return hardware_s
    if judge is Judge.SOFTWARE:
        return software_s
    if judge is Judge.LAST:
        return max(hardware_s, software_s)
    nodes = setup.hardware + setup.software
    return (setup.hardware * hardware_s + setup.software * software_s) / nodes if nodes else 0.0


def faster_transport(setup: Setup, judge: Judge = Judge.LAST, costs: Costs = STORED) -> Transport:
    """Return what is faster for a judge, whatever the setup's own; the software-mapped topic if equal."""
    smt, gateway = (replace(setup, transport=kind) for kind in (Transport.SMT, Transport.GATEWAY))
    smt_s, gateway_s = (
        judged_s(transfer_times(item, costs), item, judge) for item in (smt, gateway)
    )
    return Transport.GATEWAY if gateway_s < smt_s else Transport.SMT


def break_even_bytes(setup: Setup, judge: Judge = Judge.LAST, costs: Costs = STORED) -> int | None:
    """Return the size from which on a gateway is faster; None: not up to `LARGEST_BYTES`.

    The setup's own transport and size do not matter; the judge says whose time counts. Times grow in steps of
    a chunk, so the answer is exact to one chunk; one chunk says: at any size.
    """

    def faster_by_gateway(chunks: int) -> bool:
        sized = replace(setup, message_bytes=chunks * chunk_bytes)
        return faster_transport(sized, judge, costs) is Transport.GATEWAY

    chunk_bytes = costs.memory.chunk_bytes
    all_chunks = range(1, LARGEST_BYTES // chunk_bytes + 1)
    first = bisect_left(all_chunks, True, key=faster_by_gateway)
    return all_chunks[first] * chunk_bytes if first < len(all_chunks) else None
