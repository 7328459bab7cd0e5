"""The module `memory` computes how long a message takes between software and hardware nodes (paper C, section 4).

All hardware nodes share one interface to main memory, the MEMIF (section 2.2). The MEMIF moves a message in
chunks of 256 bytes, one request after the other without overlap, and serves the requesting nodes in turn. The
class `MemoryInterface` counts the cycles of the MEMIF as in ReconROS' reference design.

The function `transfer_times` has all formulas for the setup of Fig. 5, in which one publisher sends a message on
one topic to hardware and software subscribers. The model has three kinds of topic:

- A software-mapped topic (SMT) keeps messages in main memory. A hardware publisher writes its message to main memory.
  The SMT delivers a message to its subscribers one after the other. After a delivery the delegate thread of a hardware
  subscriber wakes the hardware subscriber, and this subscriber reads the message over the MEMIF. An SMT with n hardware
  subscribers therefore causes n reads per message.
- A hardware-mapped topic (HMT) sends one word per cycle to all hardware subscribers.
- A gateway joins an SMT and an HMT with a gateway core. The gateway core is one subscriber of the SMT and one port
  of the HMT. A message therefore crosses the MEMIF once. The gateway core stores each chunk of a message before
  the core passes the chunk on.

The paper does not state in which order an SMT serves its subscribers. The model takes all orders as equally likely.
The model leaves out that processors share the memory with the hardware, and that an SMT may use several processors.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from sfglab.errors import InvalidValueError
from sfglab.soc.graph import Placement, TopicMapping

if TYPE_CHECKING:
    from collections.abc import Sequence


# --- The memory interface ---------------------------------------------------------------------


@dataclass(frozen=True, slots=True, kw_only=True)
class MemoryInterface:
    """A `MemoryInterface` has the cycles that the MEMIF and the streams of hardware-mapped topics take."""

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
    #: Cycles from the last word of a write to its response. Fitted: 8.758. The default is 9,
    #: because simulated hardware counts whole cycles.
    write_latency_cycles: float = 9.0

    def chunks(self, message_bytes: float) -> int:
        """Return the number of requests that move a message."""
        return int(-(-message_bytes // self.chunk_bytes))

    @property
    def data_cycles(self) -> float:
        """Return the cycles that the MEMIF or a stream takes to pass the words of a chunk."""
        return self.chunk_bytes / self.width_bytes

    @property
    def read_cycles(self) -> float:
        """Return the cycles that a node takes to read one chunk from memory."""
        return self.control_cycles + self.read_latency_cycles + self.data_cycles

    @property
    def write_cycles(self) -> float:
        """Return the cycles that a node takes to write one chunk to memory."""
        return self.control_cycles + self.write_latency_cycles + self.data_cycles

    @property
    def memory_to_stream_cycles(self) -> float:
        """Return the cycles that a gateway core takes to read, store and send one chunk."""
        return self.read_cycles + self.data_cycles

    @property
    def stream_to_memory_cycles(self) -> float:
        """Return the cycles that a gateway core takes to receive, store and write one chunk."""
        return self.write_cycles + self.data_cycles

    def read_s(self, message_bytes: float) -> float:
        """Return the time that a node takes to read a message while no other node uses the MEMIF, s."""
        return self.message_s(message_bytes, self.read_cycles)

    def write_s(self, message_bytes: float) -> float:
        """Return the time that a node takes to write a message while no other node uses the MEMIF, s."""
        return self.message_s(message_bytes, self.write_cycles)

    def stream_s(self, message_bytes: float) -> float:
        """Return the time that a message takes on a stream while all subscribers of the stream are ready, s."""
        return -(-message_bytes // self.width_bytes) / self.clock_hz

    def message_s(self, message_bytes: float, chunk_cycles: float) -> float:
        """Return the time that a message takes if each chunk takes a number of cycles, s."""
        return self.chunks(message_bytes) * chunk_cycles / self.clock_hz


def shared_s(releases_s: Sequence[float], work_s: float) -> float:
    """Return when the last of several nodes has read its message over the MEMIF, s.

    Args:
        releases_s: Start of each node, s.
        work_s: Time that a node needs alone, s.

    Returns:
        The maximum over j of release j plus the work of all nodes whose releases are not before release j. The turns
        of the MEMIF lose no time, so the last node ends its read when the busy period ends, for turns of any size.
        Without nodes the function returns 0.
    """
    ordered = sorted(releases_s)
    ends_s = [release_s + (len(ordered) - j) * work_s for j, release_s in enumerate(ordered)]
    return max(ends_s, default=0.0)


def round_robin_s(releases_s: Sequence[float], chunks: int, chunk_s: float) -> list[float]:
    """Return when each of several nodes has read its message, s; the MEMIF serves one chunk per turn.

    The function `shared_s` returns the largest of the nodes' times.

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
class Costs(MemoryInterface):
    """`Costs` has the constants of the model, including those of the memory interface.

    The project fitted the six constants in `FITTED` to the numbers that section 4 of paper C states. The test
    `tests/soc/test_paper_values.py` repeats the fit of the constants.
    """

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
        """Return the time that a publication on a software-mapped topic takes, s."""
        return self.publish_s + self.publish_s_per_byte * message_bytes

    def delivery_s(self, message_bytes: float) -> float:
        """Return the time that a software-mapped topic takes to deliver a message to one subscriber, s."""
        return self.deliver_s + self.deliver_s_per_byte * message_bytes


STORED = Costs(
    write_latency_cycles=8.758,
    publish_s_per_byte=1.5527e-9,
    deliver_s=48.434e-6,
    deliver_s_per_byte=0.3598e-9,
    endpoint_s=373.57e-6,
    cancel_s=310.43e-6,
)
"""`STORED` has the constants for gateway cores that store each chunk before the cores pass the chunk on."""

FITTED = (
    "write_latency_cycles",
    "publish_s_per_byte",
    "deliver_s",
    "deliver_s_per_byte",
    "endpoint_s",
    "cancel_s",
)
"""`FITTED` names the fitted constants; the constants without a fit are assumed or from the reference design."""


# --- Transfer times ---------------------------------------------------------------------------


@dataclass(frozen=True, slots=True, kw_only=True)
class Setup:
    """A `Setup` describes one publisher, its topic and the topic's subscribers (paper C, Fig. 5).

    Raises:
        InvalidValueError: A software node is on a hardware-mapped topic.
    """

    publisher: Placement  #: Side of the publisher.
    mapping: TopicMapping  #: Mapping of the topic.
    message_bytes: int  #: Size of the message, bytes.
    hardware_subscribers: int  #: Number of subscribers in hardware.
    software_subscribers: int = 1  #: Number of subscribers in software; the paper has one.

    def __post_init__(self) -> None:
        has_software = self.publisher is Placement.SOFTWARE or self.software_subscribers > 0
        if self.mapping is TopicMapping.HARDWARE and has_software:
            raise InvalidValueError("setup", self, "only hardware nodes on a hardware-mapped topic")


def transfer_times(setup: Setup, costs: Costs = STORED) -> dict[Placement, float]:
    """Return the transfer times of one message from the start of its publication, s.

    A hardware node takes `endpoint_s` to send or to receive a message. A call of a hardware node to ROS 2 takes
    `delegate_s`, because the node's delegate makes the call.

    Returns:
        One time per side that has subscribers. The time of the hardware side ends when the last hardware
        subscriber has the message. The time of the software side is the mean of a subscriber over all orders
        of delivery.
    """
    size_bytes = setup.message_bytes
    endpoint_s = costs.endpoint_s
    delegate_s = costs.delegate_s
    publish_s = costs.published_s(size_bytes)
    deliver_s = costs.delivery_s(size_bytes)
    counts = {
        Placement.HARDWARE: setup.hardware_subscribers,
        Placement.SOFTWARE: setup.software_subscribers,
    }
    is_from_hardware = setup.publisher is Placement.HARDWARE
    if setup.mapping is TopicMapping.HARDWARE:
        times_s = {Placement.HARDWARE: 2 * endpoint_s + costs.stream_s(size_bytes)}
    elif setup.mapping is TopicMapping.SOFTWARE:
        subscribers = setup.hardware_subscribers + setup.software_subscribers
        published_s = publish_s
        if is_from_hardware:
            published_s += endpoint_s + costs.write_s(size_bytes) + delegate_s
        # Mean places replace all orders of delivery. The mean place of the k-th of h hardware
        # subscribers among n subscribers is k (n + 1) / (h + 1). The test of this function finds
        # less than 0.5 % difference to the mean over all orders (`tests/soc/test_memory.py`).
        apart_s = (subscribers + 1) / (setup.hardware_subscribers + 1) * deliver_s
        woken_s = [place * apart_s for place in range(1, setup.hardware_subscribers + 1)]
        all_read_s = delegate_s + shared_s(woken_s, costs.read_s(size_bytes))
        times_s = {
            Placement.HARDWARE: published_s + all_read_s + endpoint_s,
            Placement.SOFTWARE: published_s + (subscribers + 1) / 2 * deliver_s,
        }
    else:
        # The n subscribers of the gateway's SMT are the software nodes and the core. The mean place
        # of a subscriber over all orders of delivery is (n + 1) / 2.
        over_smt_s = publish_s + (setup.software_subscribers + 2) / 2 * deliver_s
        if is_from_hardware:
            in_memory_s = endpoint_s + costs.message_s(size_bytes, costs.stream_to_memory_cycles)
            # The hardware subscribers take as long as the core, because the stream waits for the core.
            forward_s = endpoint_s + costs.cancel_s + delegate_s
            times_s = {
                Placement.HARDWARE: in_memory_s + endpoint_s,
                Placement.SOFTWARE: in_memory_s + forward_s + over_smt_s,
            }
        else:
            forward_s = (
                delegate_s + endpoint_s + costs.message_s(size_bytes, costs.memory_to_stream_cycles)
            )
            times_s = {
                Placement.HARDWARE: over_smt_s + forward_s + endpoint_s,
                Placement.SOFTWARE: over_smt_s,
            }
    return {side: time_s for side, time_s in times_s.items() if counts[side]}
