"""How long a message takes from its publisher to its subscribers, over a topic in software, hardware or both.

The paths of paper C, section 4, Fig. 5. A software-mapped topic (SMT) lies in main memory: its publisher pays
for the publication, then one delivery a reader; a hardware reader is woken by its delegate and reads the
message over the shared memory interface. A hardware-mapped topic (HMT) is a stream. A gateway is both, with a
core that is one reader of the SMT and one port of the HMT. In which order readers are served is not stated, so
every order is taken as equally likely. Left out: that processors and hardware nodes share the memory chips, and
that deliveries may run on several processors. Knows paths; refuses to know which topic is worth which.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

from sfglab.soc.memory.costs import STORED, Costs
from sfglab.soc.memory.memif import MemoryInterfaceError


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
