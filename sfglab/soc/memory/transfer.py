"""How long a message takes from its publisher to its subscribers, and from which size on a gateway is worth it.

The paths of paper C, section 4, Fig. 5. A software-mapped topic (SMT) lies in main memory: its publisher pays
for the publication, then one delivery a reader; a hardware reader is woken by its delegate and reads the
message over the shared memory interface. A hardware-mapped topic (HMT) is a stream. A gateway is both, with a
core that is one reader of the SMT and one port of the HMT. In which order readers are served is not stated, so
every order is taken as equally likely. Left out: that processors and hardware nodes share the memory chips, and
that deliveries may run on several processors. The paper's rule (section 5) ignores the size, although its
measurements (section 4) show small messages lose by a gateway. Refuses to know graphs.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import Enum

from sfglab.soc.memory.memif import STORED, Costs, MemoryInterfaceError


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
        """Refuse what no topic can carry."""
        if self.message_bytes <= 0 or min(self.hardware, self.software) < 0:
            raise MemoryInterfaceError(f"{self}: needs a message and no negative number of subscribers")
        if self.transport is Transport.HMT and (self.publisher is Side.SOFTWARE or self.software):
            raise MemoryInterfaceError(f"{self}: only hardware nodes reach a hardware-mapped topic")


@dataclass(frozen=True, slots=True, kw_only=True)
class Times:
    """Transfer times from the start of the publication, in seconds."""

    hardware_s: float | None  #: Until the last hardware subscriber has the message; None: there is none.
    #: Until a software subscriber has it, mean over the order of deliveries; None: there is none.
    software_s: float | None


def transfer_times(setup: Setup, costs: Costs = STORED) -> Times:
    """Return how long one message takes.

    Args:
        setup: Publisher, topic and subscribers.
        costs: The constants.
    """
    hardware_s, software_s = _PATHS[setup.transport](setup, costs)
    return Times(
        hardware_s=hardware_s if setup.hardware else None,
        software_s=software_s if setup.software else None,
    )


def _over_smt(setup: Setup, costs: Costs) -> tuple[float, float]:
    """Return times over main memory alone."""
    x, readers = setup.message_bytes, setup.hardware + setup.software
    start_s = _published_s(x, costs)
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
    smt_s = _published_s(x, costs) + _delivered_s(setup.software + 1, x, costs)
    if setup.publisher is Side.SOFTWARE:
        forward_s = costs.delegate_s + costs.endpoint_s + memory.memory_to_stream_s(x)
        return smt_s + forward_s + costs.endpoint_s, smt_s
    sent_s = costs.endpoint_s + memory.stream_to_memory_s(x)
    forward_s = costs.endpoint_s + costs.cancel_s + costs.delegate_s
    return sent_s + costs.endpoint_s, sent_s + forward_s + smt_s


_PATHS = {Transport.SMT: _over_smt, Transport.HMT: _over_hmt, Transport.GATEWAY: _over_gateway}


def _published_s(message_bytes: int, costs: Costs) -> float:
    return costs.publish_s + costs.publish_s_per_byte * message_bytes


def _delivery_s(message_bytes: int, costs: Costs) -> float:
    return costs.deliver_s + costs.deliver_s_per_byte * message_bytes


def _delivered_s(readers: int, message_bytes: int, costs: Costs) -> float:
    """Return the mean delay of one reader among several: its place is (readers + 1) / 2."""
    return (readers + 1) / 2 * _delivery_s(message_bytes, costs)


def _all_read_s(hardware: int, readers: int, message_bytes: int, costs: Costs) -> float:
    """Return the delay until the last hardware reader has read over the shared interface.

    Either the interface is the bottleneck, busy from the first hardware reader's delivery on, or the deliveries
    are, and the last reader finds it free. The mean place of the first of h among r readers is (r + 1)/(h + 1),
    and h times that of the last.
    """
    place = (readers + 1) / (hardware + 1) * _delivery_s(message_bytes, costs)
    read_s = costs.memory.read_s(message_bytes)
    return costs.delegate_s + max(place + hardware * read_s, hardware * place + read_s)


LARGEST_BYTES = 1 << 30
"""Where the search for a break-even ends."""


class Judge(Enum):
    """Whose transfer time counts."""

    HARDWARE = "the last hardware subscriber"
    SOFTWARE = "a software subscriber"
    LAST = "whoever is last"
    MEAN = "all subscribers, in the mean, hardware nodes each counted as the last of them"


def judged_s(times: Times, setup: Setup, judge: Judge) -> float:
    """Return the time that counts, in seconds; 0 if nobody's does.

    Args:
        times: Of the setup.
        setup: Who subscribes.
        judge: Whose time counts.
    """
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
    """Return the software-mapped topic or the gateway, whichever is faster; the topic if they are equal.

    Args:
        setup: Publisher, size and subscribers; its transport does not matter.
        judge: Whose time counts.
        costs: The constants.
    """
    smt, gateway = (replace(setup, transport=kind) for kind in (Transport.SMT, Transport.GATEWAY))
    smt_s, gateway_s = (judged_s(transfer_times(item, costs), item, judge) for item in (smt, gateway))
    return Transport.GATEWAY if gateway_s < smt_s else Transport.SMT


def break_even_bytes(setup: Setup, judge: Judge = Judge.LAST, costs: Costs = STORED) -> int | None:
    """Return the size from which on a gateway is faster; None: not up to `LARGEST_BYTES`.

    Times grow in steps of a chunk, so the answer is exact to one chunk; one chunk says: at any size.

    Args:
        setup: Publisher and subscribers; its transport and size do not matter.
        judge: Whose time counts.
        costs: The constants.
    """

    def worth(message_bytes: int) -> bool:
        sized = replace(setup, message_bytes=message_bytes)
        return faster_transport(sized, judge, costs) is Transport.GATEWAY

    chunk_bytes = costs.memory.chunk_bytes
    low, high = 0, LARGEST_BYTES // chunk_bytes
    if not worth(high * chunk_bytes):
        return None
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (low, middle) if worth(middle * chunk_bytes) else (middle, high)
    return high * chunk_bytes
