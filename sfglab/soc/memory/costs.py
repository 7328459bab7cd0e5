"""What a transfer costs beside the memory interface, each constant with its unit and where it comes from.

Two sets, one for each way in which a gateway core may pass chunks on; each was fitted once (`fit.fit`) to the
numbers that paper C states (`stated.STATED`), and `fit` finds them again. Knows constants; refuses to know how
they add up.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from enum import Enum

from sfglab.soc.memory.memif import Forwarding, MemoryInterface, MemoryInterfaceError


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
