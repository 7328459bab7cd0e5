"""How long messages take between software and hardware that share one memory interface (paper C, section 4).

Bottom up: `memif` (chunks, turns, and constants with their origin), `transfer` (paths over topics in software,
in hardware and over gateways; break-even sizes), `paper` (paper values, residuals, and the fit).
"""

from __future__ import annotations

from sfglab.soc.memory.memif import (
    CUT_THROUGH,
    STORED,
    Costs,
    Forwarding,
    MemoryInterface,
    MemoryInterfaceError,
    Origin,
    constants,
    round_robin_s,
    shared_s,
)
from sfglab.soc.memory.paper import (
    MESSAGE_BYTES,
    STATED,
    SUBSCRIBERS,
    Fit,
    FitError,
    Panel,
    SpeedUp,
    fit,
    residuals,
    sensitivity,
    speed_ups,
    tendencies,
)
from sfglab.soc.memory.transfer import (
    LARGEST_BYTES,
    Judge,
    Setup,
    Side,
    Times,
    Transport,
    break_even_bytes,
    faster_transport,
    judged_s,
    transfer_times,
)

__all__ = [
    "CUT_THROUGH",
    "LARGEST_BYTES",
    "MESSAGE_BYTES",
    "STATED",
    "STORED",
    "SUBSCRIBERS",
    "Costs",
    "Fit",
    "FitError",
    "Forwarding",
    "Judge",
    "MemoryInterface",
    "MemoryInterfaceError",
    "Origin",
    "Panel",
    "Setup",
    "Side",
    "SpeedUp",
    "Times",
    "Transport",
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
