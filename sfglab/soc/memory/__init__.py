"""How long messages take between software and hardware that share one memory interface (paper C, section 4).

Bottom up: `memif` (chunks and turns), `costs` (constants and where each comes from), `transfer` (paths over
topics in software, in hardware and over gateways), `stated` (what the paper states, and residuals), `fit`,
`break_even` (from which size on a gateway is worth it).
"""

from __future__ import annotations

from sfglab.soc.memory.break_even import LARGEST_BYTES, Judge, break_even_bytes, faster_transport, judged_s
from sfglab.soc.memory.costs import CUT_THROUGH, STORED, Constant, Costs, Origin, constants
from sfglab.soc.memory.fit import Fit, FitError, Variant, fit, sensitivity
from sfglab.soc.memory.memif import (
    Forwarding,
    MemoryInterface,
    MemoryInterfaceError,
    round_robin_s,
    shared_s,
)
from sfglab.soc.memory.stated import (
    MESSAGE_BYTES,
    STATED,
    SUBSCRIBERS,
    TENDENCIES,
    Panel,
    Residual,
    SpeedUp,
    Stated,
    Tendency,
    residuals,
    speed_ups,
    tendencies,
)
from sfglab.soc.memory.transfer import Setup, Side, Times, Transport, transfer_times

__all__ = [
    "CUT_THROUGH",
    "LARGEST_BYTES",
    "MESSAGE_BYTES",
    "STATED",
    "STORED",
    "SUBSCRIBERS",
    "TENDENCIES",
    "Constant",
    "Costs",
    "Fit",
    "FitError",
    "Forwarding",
    "Judge",
    "MemoryInterface",
    "MemoryInterfaceError",
    "Origin",
    "Panel",
    "Residual",
    "Setup",
    "Side",
    "SpeedUp",
    "Stated",
    "Tendency",
    "Times",
    "Transport",
    "Variant",
    "break_even_bytes",
    "constants",
    "faster_transport",
    "fit",
    "judged_s",
    "residuals",
    "round_robin_s",
    "sensitivity",
    "shared_s",
    "speed_ups",
    "tendencies",
    "transfer_times",
]
