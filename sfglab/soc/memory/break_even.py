"""From which message size on a gateway is worth it, for one publisher and its subscribers.

Paper C's rule (section 5) ignores the size, although its measurements (section 4) show small messages lose by a
gateway. Knows sizes and the faster transport; refuses to know graphs.
"""

from __future__ import annotations

from dataclasses import replace
from enum import Enum
from typing import TYPE_CHECKING

from sfglab.soc.memory.costs import STORED, Costs
from sfglab.soc.memory.transfer import Setup, Transport, transfer_times

if TYPE_CHECKING:
    from sfglab.soc.memory.transfer import Times


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
