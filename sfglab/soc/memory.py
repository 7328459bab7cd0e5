"""The memory model: transfer times of messages between software and hardware (paper C, section 4).

All hardware nodes share one interface to main memory, the MEMIF (section 2.2). It moves a message
in chunks of 256 bytes, one request after the other without overlap, and serves the requesting nodes
in turn. `MemoryInterface` counts its cycles, as ReconROS' reference design has them.

`transfer_times` adds up what one message takes in the setup of Fig. 5: from one publisher to
hardware and software subscribers of one topic. There are three kinds of topic:

- A software-mapped topic (SMT) lies in main memory. A hardware publisher writes the message there.
  The topic delivers it to its subscribers one after the other. The delegate thread of a hardware
  subscriber then wakes its node, which reads the message over the MEMIF. So n hardware subscribers
  read n times.
- A hardware-mapped topic (HMT) is a stream of one word per cycle to all hardware subscribers.
- A gateway joins both with its core, which is one subscriber of the SMT and one port of the HMT.
  So the message crosses the MEMIF once. The core stores each chunk before it passes it on.

The paper does not state in which order an SMT serves its subscribers: all orders are equally likely.
The model leaves out that processors share the memory with the hardware, and that deliveries may
run on several processors.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import Enum
from typing import TYPE_CHECKING

from sfglab.errors import InvalidValueError
from sfglab.soc.graph import Placement, TopicMapping

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence


# --- The memory interface ---------------------------------------------------------------------


@dataclass(frozen=True, slots=True, kw_only=True)
class MemoryInterface:
    """Cycles of the MEMIF and of the streams of hardware-mapped topics."""

    #: Bytes per cycle, of MEMIF and streams. Reference design: ReconROS' 64-bit template (ZCU104).
    width_bytes: int = 8
    #: System clock, Hz. Reference design.
    clock_hz: float = 100e6
    #: Bytes of one request. Reference design: 32 words.
    chunk_bytes: int = 256
    #: Cycles of a request outside latency and data. Reference design: four states.
    control_cycles: float = 4.0
    #: Cycles from a read request to its first word. Assumed: the memory controller is not in the
    #: reference design.
    read_latency_cycles: float = 30.0
    #: Cycles from the last word of a write to its response. Fitted in `STORED`; the default is
    #: rounded for simulated hardware.
    write_latency_cycles: float = 9.0

    def chunks(self, message_bytes: float) -> int:
        """Return the number of requests for a message."""
        return int(-(-message_bytes // self.chunk_bytes))

    @property
    def data_cycles(self) -> float:
        """Cycles in which the words of a chunk pass, on the MEMIF or on a stream."""
        return self.chunk_bytes / self.width_bytes

    @property
    def read_cycles(self) -> float:
        """Cycles of one chunk that is read from memory."""
        return self.control_cycles + self.read_latency_cycles + self.data_cycles

    @property
    def write_cycles(self) -> float:
        """Cycles of one chunk that is written to memory."""
        return self.control_cycles + self.write_latency_cycles + self.data_cycles

    @property
    def memory_to_stream_cycles(self) -> float:
        """Cycles of one chunk that a gateway core reads, stores, and sends on the stream."""
        return self.read_cycles + self.data_cycles

    @property
    def stream_to_memory_cycles(self) -> float:
        """Cycles of one chunk that a gateway core receives, stores, and writes."""
        return self.write_cycles + self.data_cycles

    def read_s(self, message_bytes: float) -> float:
        """Return the time in which a node that is alone reads a message, s."""
        return self._seconds(message_bytes, self.read_cycles)

    def write_s(self, message_bytes: float) -> float:
        """Return the time in which a node that is alone writes a message, s."""
        return self._seconds(message_bytes, self.write_cycles)

    def stream_s(self, message_bytes: float) -> float:
        """Return the time of a message on a stream whose subscribers are all ready, s."""
        return -(-message_bytes // self.width_bytes) / self.clock_hz

    def memory_to_stream_s(self, message_bytes: float) -> float:
        """Return the time in which a gateway core moves a message from memory to the stream, s."""
        return self._seconds(message_bytes, self.memory_to_stream_cycles)

    def stream_to_memory_s(self, message_bytes: float) -> float:
        """Return the time in which a gateway core moves a message from the stream to memory, s.

        The stream waits for the core, so its subscribers take as long.
        """
        return self._seconds(message_bytes, self.stream_to_memory_cycles)

    def _seconds(self, message_bytes: float, chunk_cycles: float) -> float:
        return self.chunks(message_bytes) * chunk_cycles / self.clock_hz


def shared_s(releases_s: Sequence[float], work_s: float) -> float:
    """Return when the last of several nodes has read its message over the MEMIF, s.

    Args:
        releases_s: Start of each node, s.
        work_s: Time that a node needs alone, s.

    Returns:
        max over j of (release j + work of all nodes that are released from j on). Turns lose no
        time, so the last node ends with the busy period, for turns of any size. Without
        nodes: 0.
    """
    ordered = sorted(releases_s)
    ends_s = [release_s + (len(ordered) - j) * work_s for j, release_s in enumerate(ordered)]
    return max(ends_s, default=0.0)


def round_robin_s(releases_s: Sequence[float], chunks: int, chunk_s: float) -> list[float]:
    """Return when each of several nodes has read its message, chunk by chunk in turn, s.

    The last of these times is that of `shared_s`.

    Args:
        releases_s: Start of each node, s, in the order of the turns.
        chunks: Number of chunks that each node reads.
        chunk_s: Time of one chunk, s.
    """
    left = [chunks] * len(releases_s)
    ends_s = list(releases_s)
    now_s = min(releases_s)
    last = -1
    while any(left):
        unfinished = [node for node, count in enumerate(left) if count]
        waiting = [node for node in unfinished if releases_s[node] <= now_s]
        if not waiting:
            now_s = min(releases_s[node] for node in unfinished)
            continue
        last = next((node for node in waiting if node > last), waiting[0])
        now_s += chunk_s
        left[last] -= 1
        ends_s[last] = now_s
    return ends_s


# --- Constants --------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True, kw_only=True)
class Costs:
    """Constants of the model.

    Six of the constants, named in `FITTED`, were fitted to the numbers that section 4 states
    (`sfglab.soc.paper_values`). A test repeats the fit.
    """

    memory: MemoryInterface  #: Memory interface.
    #: Call of a hardware node to its delegate thread and back, s. Assumed: two thread switches.
    delegate_s: float = 80e-6
    #: Publication on a software-mapped topic, s. Assumed: like a call to the delegate.
    publish_s: float = 80e-6
    #: Further time of a publication per byte, s. Fitted.
    publish_s_per_byte: float
    #: Delivery of a message to one subscriber, with its wake-up, s. Fitted.
    deliver_s: float
    #: Further time of a delivery per byte, s. Fitted.
    deliver_s_per_byte: float
    #: Time of a hardware node for a message, before it sends or after it has received, s. The
    #: gateway core takes it too. It is equal for all kinds of topic. Fitted.
    endpoint_s: float
    #: Cancellation of a gateway core's request: the delegate is interrupted and responds, s. Fitted.
    cancel_s: float

    def published_s(self, message_bytes: float) -> float:
        """Return the time of a publication on a software-mapped topic, s."""
        return self.publish_s + self.publish_s_per_byte * message_bytes

    def delivery_s(self, message_bytes: float) -> float:
        """Return the time of the delivery to one subscriber, s."""
        return self.deliver_s + self.deliver_s_per_byte * message_bytes


STORED = Costs(
    memory=MemoryInterface(write_latency_cycles=8.758),
    publish_s_per_byte=1.5527e-9,
    deliver_s=48.434e-6,
    deliver_s_per_byte=0.3598e-9,
    endpoint_s=373.57e-6,
    cancel_s=310.43e-6,
)
"""Constants of the model. They are fitted for gateway cores that store each chunk before they pass it on."""

FITTED = (
    "write_latency_cycles",
    "publish_s_per_byte",
    "deliver_s",
    "deliver_s_per_byte",
    "endpoint_s",
    "cancel_s",
)
"""Names of the fitted constants. The others are assumed or from the reference design."""


def with_values(costs: Costs, values: Mapping[str, float]) -> Costs:
    """Return costs with other values of constants, by name, those of the memory interface too."""
    memory = {name: value for name, value in values.items() if hasattr(costs.memory, name)}
    others = {name: value for name, value in values.items() if name not in memory}
    return replace(costs, memory=replace(costs.memory, **memory), **others)  # type: ignore[arg-type]


# --- Transfer times ---------------------------------------------------------------------------


@dataclass(frozen=True, slots=True, kw_only=True)
class Setup:
    """One publisher, its topic and its subscribers (paper C, Fig. 5).

    Raises:
        InvalidValueError: A software node is on a hardware-mapped topic.
    """

    publisher: Placement  #: Side of the publisher.
    mapping: TopicMapping  #: Mapping of the topic.
    message_bytes: int  #: Size of the message.
    hardware: int  #: Number of hardware subscribers.
    software: int = 1  #: Number of software subscribers; the paper has one.

    def __post_init__(self) -> None:
        if self.mapping is TopicMapping.HARDWARE and (
            self.publisher is Placement.SOFTWARE or self.software
        ):
            raise InvalidValueError("setup", self, "only hardware nodes on a hardware-mapped topic")


@dataclass(frozen=True, slots=True, kw_only=True)
class Times:
    """Transfer times from the start of the publication."""

    #: Time from the start of the publication until the last hardware subscriber has the message, s.
    #: 0: there is none.
    hardware_s: float
    #: Mean time until a software subscriber has it, over the orders of deliveries, s. 0: there
    #: is none.
    software_s: float


def transfer_times(setup: Setup, costs: Costs = STORED) -> Times:
    """Return the transfer times of one message.

    - In software it is published, delivered to one subscriber after the other, and read by each hardware subscriber.
    - Through a gateway the core is one of the subscribers, and copies the message once for all hardware nodes.
    - In hardware it is a stream from port to port.

    A hardware node takes `endpoint_s` for its message, and `delegate_s` if its delegate calls ROS 2.
    """
    if setup.mapping is TopicMapping.SOFTWARE:
        hardware_s, software_s = _over_smt(setup, costs)
    elif setup.mapping is TopicMapping.GATEWAY:
        hardware_s, software_s = _over_gateway(setup, costs)
    else:
        hardware_s = 2 * costs.endpoint_s + costs.memory.stream_s(setup.message_bytes)
        software_s = 0.0
    return Times(
        hardware_s=hardware_s if setup.hardware else 0.0,
        software_s=software_s if setup.software else 0.0,
    )


def _over_smt(setup: Setup, costs: Costs) -> tuple[float, float]:
    """Return the times over a software-mapped topic: to the last hardware subscriber, to software."""
    size = setup.message_bytes
    subscribers = setup.hardware + setup.software
    published_s = costs.published_s(size)
    if setup.publisher is Placement.HARDWARE:
        published_s += costs.endpoint_s + costs.memory.write_s(size) + costs.delegate_s
    all_read_s = _all_read_s(setup.hardware, subscribers, size, costs)
    hardware_s = published_s + all_read_s + costs.endpoint_s
    return hardware_s, published_s + _mean_delivery_s(subscribers, size, costs)


def _over_gateway(setup: Setup, costs: Costs) -> tuple[float, float]:
    """Return the times through a gateway: to the last hardware subscriber, to software.

    The subscribers of its software-mapped topic are the software nodes and the core.
    """
    size = setup.message_bytes
    over_smt_s = costs.published_s(size) + _mean_delivery_s(setup.software + 1, size, costs)
    if setup.publisher is Placement.SOFTWARE:
        forward_s = costs.delegate_s + costs.endpoint_s + costs.memory.memory_to_stream_s(size)
        return over_smt_s + forward_s + costs.endpoint_s, over_smt_s
    in_memory_s = costs.endpoint_s + costs.memory.stream_to_memory_s(size)
    forward_s = costs.endpoint_s + costs.cancel_s + costs.delegate_s
    return in_memory_s + costs.endpoint_s, in_memory_s + forward_s + over_smt_s


def _mean_delivery_s(subscribers: int, message_bytes: int, costs: Costs) -> float:
    """Return the time until one of several subscribers is served: its mean place is (n + 1) / 2."""
    return (subscribers + 1) / 2 * costs.delivery_s(message_bytes)


def _all_read_s(hardware: int, subscribers: int, message_bytes: int, costs: Costs) -> float:
    """Return the time from a publication until all hardware subscribers have read the message.

    They are woken one after the other and share the interface. Instead of every order of
    deliveries, the model takes their mean places: with h of them among n subscribers, the mean
    place of the k-th is k (n + 1) / (h + 1). The time differs by less than 0.5 % from the mean over
    all orders.
    """
    apart_s = (subscribers + 1) / (hardware + 1) * costs.delivery_s(message_bytes)
    woken_s = [k * apart_s for k in range(1, hardware + 1)]
    return costs.delegate_s + shared_s(woken_s, costs.memory.read_s(message_bytes))


class Receiver(Enum):
    """Subscribers whose transfer time counts."""

    HARDWARE = "the last hardware subscriber"
    SOFTWARE = "a software subscriber"
    #: The later one of the last hardware subscriber and, in the mean, a software subscriber.
    LAST = "the last subscriber"


def received_s(times: Times, receiver: Receiver) -> float:
    """Return the transfer time until the receiver has the message, s; 0 without such subscribers."""
    if receiver is Receiver.HARDWARE:
        return times.hardware_s
    if receiver is Receiver.SOFTWARE:
        return times.software_s
    return max(times.hardware_s, times.software_s)
