"""The one memory interface of all hardware nodes, and what a transfer costs beside it: each constant's origin.

ReconROS' memory interface (MEMIF) moves chunks of 256 bytes over 64 bits at 100 MHz, one after another without
overlap, and serves requesting nodes in turn (paper C, sections 2.2 and 3; controller and arbiter of ReconROS'
reference design). Of the other costs there are two sets, one for each way in which a gateway core may pass
chunks on; each was fitted once (`fit`) to the numbers that paper C states, and `fit` finds them again. Refuses
to know messages, topics, and how the costs add up.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from enum import Enum
from typing import TYPE_CHECKING

from sfglab.errors import SfglabError

if TYPE_CHECKING:
    from collections.abc import Sequence


class MemoryInterfaceError(SfglabError, ValueError):
    """A number that no memory interface or transfer can have."""


class Forwarding(Enum):
    """What a gateway core does with a chunk on its way between memory and stream."""

    STORED = "stored"
    """Fills its chunk buffer, then empties it: the cycles of both sides add up."""
    CUT_THROUGH = "cut-through"
    """Passes beats on as they come: the slower side counts."""


@dataclass(frozen=True, slots=True, kw_only=True)
class MemoryInterface:
    """Cycles of the MEMIF and of a stream beside it."""

    width_bytes: int = 8  #: Bytes a cycle, of MEMIF and streams alike.
    clock_hz: float = 100e6  #: The system clock.
    chunk_bytes: int = 256  #: Bytes of one request.
    control_cycles: float = 4.0  #: Cycles of a request in which neither address nor data are under way.
    read_latency_cycles: float = 30.0  #: From a read request to its first word.
    write_latency_cycles: float = 9.0  #: From a write's last word to its response.
    forwarding: Forwarding = Forwarding.STORED  #: How a gateway core passes chunks on.

    def __post_init__(self) -> None:
        """Refuse widths, clocks and cycles that make no sense."""
        if min(self.width_bytes, self.clock_hz, self.chunk_bytes) <= 0:
            raise MemoryInterfaceError(
                f"memory interface: width {self.width_bytes} B, clock {self.clock_hz} Hz and chunk "
                f"{self.chunk_bytes} B must be above 0"
            )
        if min(self.control_cycles, self.read_latency_cycles, self.write_latency_cycles) < 0:
            raise MemoryInterfaceError("memory interface: control and latency cycles must be 0 or more")

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
        """Return the seconds in which a gateway core brings a message from a stream to memory.

        The stream's other subscribers get it no faster: a broadcast is as slow as its slowest port.
        """
        return self._seconds(message_bytes, self._forwarded(self.write_cycles))

    def _forwarded(self, memory_cycles: float) -> float:
        """Return the cycles of a chunk through the core; cut through, the words already pass as they come."""
        return memory_cycles + (self.data_cycles if self.forwarding is Forwarding.STORED else 0.0)

    def _seconds(self, message_bytes: float, cycles: float) -> float:
        return self.chunks(message_bytes) * cycles / self.clock_hz


def shared_s(releases_s: Sequence[float], work_s: float) -> float:
    """Return when the last of several nodes has read its message.

    Turns do not lose time: while anybody waits, the interface works. So the last node ends with the busy period
    that it ends in, max over j of (release j + work of all released from j on), whatever the turns' size.

    Args:
        releases_s: When each node starts to read.
        work_s: What one node alone would need.
    """
    ordered = sorted(releases_s)
    return max(release + (len(ordered) - j) * work_s for j, release in enumerate(ordered))


def round_robin_s(releases_s: Sequence[float], chunks: int, chunk_s: float) -> list[float]:
    """Return when each of several nodes has read its message, chunk by chunk in turn.

    The reference for `shared_s`: slow, and exact.

    Args:
        releases_s: When each node starts to read.
        chunks: Of each node's message.
        chunk_s: Of one chunk, in seconds.
    """
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
    #: A hardware node's call to its delegate thread and the answer (OSIF round trip).
    delegate_s: float = 80e-6
    publish_s: float = 80e-6  #: A publication on a software-mapped topic: fixed part.
    publish_s_per_byte: float  #: The same: for each byte of the message.
    #: Its delivery to one reader, which follow one another: fixed part, with the reader's wake-up.
    deliver_s: float
    deliver_s_per_byte: float  #: The same: for each byte of the message.
    #: What a hardware node spends on a message before it sends or after it has received, whatever the topic;
    #: also the gateway core, when it forwards.
    endpoint_s: float
    cancel_s: float  #: A gateway core's cancel: interrupting the blocked delegate, and its answer.

    def __post_init__(self) -> None:
        """Refuse negative costs."""
        for item in fields(self)[1:]:
            if (value := getattr(self, item.name)) < 0:
                raise MemoryInterfaceError(f"costs: {item.name} is {value}, must be 0 or more")


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

FITTED_NAMES = (
    "write_latency_cycles",
    "publish_s_per_byte",
    "deliver_s",
    "deliver_s_per_byte",
    "endpoint_s",
    "cancel_s",
)
"""The constants that are fitted; all others stand."""

_TEMPLATE = "ReconROS, 64-bit template for the ZCU104"
_ORIGINS: dict[str, tuple[str, Origin, str]] = {
    "width_bytes": ("B/cycle", Origin.REFERENCE, f"{_TEMPLATE}: MEMIF, OSIF and topic streams of 64 bit"),
    "clock_hz": ("Hz", Origin.REFERENCE, f"{_TEMPLATE}: system clock and build.cfg"),
    "chunk_bytes": ("B", Origin.REFERENCE, f"{_TEMPLATE}: requests of 32 words"),
    "control_cycles": ("cycles", Origin.REFERENCE, "four states of the memory controller, no request overlaps"),
    "read_latency_cycles": ("cycles", Origin.ASSUMED, "300 ns from AXI request to DDR data; gives 388 MB/s"),
    "write_latency_cycles": ("cycles", Origin.FITTED, "the write's response; a posted write beats a read"),
    "delegate_s": ("s", Origin.ASSUMED, "two thread switches on a Cortex-A53; no number is stated"),
    "publish_s": ("s", Origin.ASSUMED, "as one delegate round trip; only sums with it matter"),
    "publish_s_per_byte": ("s/B", Origin.FITTED, "copying a message into the middleware"),
    "deliver_s": ("s", Origin.FITTED, "waking one reader"),
    "deliver_s_per_byte": ("s/B", Origin.FITTED, "copying a message for one reader"),
    "endpoint_s": ("s", Origin.FITTED, "common to both kinds of topic, so it pulls small messages towards 1"),
    "cancel_s": ("s", Origin.FITTED, "the hardware publisher's overhead with a gateway"),
}


def constants(costs: Costs = STORED) -> list[Constant]:
    """Return every constant with its unit and origin, for a table."""
    found = []
    for name, (unit, origin, reason) in _ORIGINS.items():
        value = float(getattr(costs.memory if hasattr(costs.memory, name) else costs, name))
        found.append(Constant(name=name, value=value, unit=unit, origin=origin, reason=reason))
    return found
