"""The gateway of paper C as hardware, in Amaranth (paper C, section 3; ReconROS' 64-bit template).

Bottom up: `data_path` (memory interface's master, topic, mover), `core` (control generated from the core's
table, and the gateway), `cycles` (its bench and cycle model), `readers` (what it spares: an arbiter and nodes
that all read), `check` (both cycle models beside the memory model), `synthesis` (Verilog, area, proofs).
Needs the extra `rtl`; nothing else of sfglab imports it.
"""

from __future__ import annotations

from sfglab.soc.rtl.check import LawCheck, MemoryPath, PathCycles, check_law, path_cycles
from sfglab.soc.rtl.core import Answer, Call, Control, Gateway, drive_code, input_code, state_code
from sfglab.soc.rtl.cycles import (
    CycleLaw,
    Delays,
    HardwareError,
    Transfer,
    measured_law,
    model_cycles,
    simulate_transfer,
)
from sfglab.soc.rtl.data_path import MemoryPort
from sfglab.soc.rtl.readers import (
    Arbiter,
    Reading,
    ReadingCycles,
    measured_readers_law,
    measured_writer_law,
    model_reading_cycles,
    simulate_readers,
)
from sfglab.soc.rtl.synthesis import (
    ArbiterArea,
    GatewayArea,
    arbiter_area,
    arbiter_is_fair,
    control_is_safe,
    gateway_area,
    gateway_verilog,
)

__all__ = [
    "Answer",
    "Arbiter",
    "ArbiterArea",
    "Call",
    "Control",
    "CycleLaw",
    "Delays",
    "Gateway",
    "GatewayArea",
    "HardwareError",
    "LawCheck",
    "MemoryPath",
    "MemoryPort",
    "PathCycles",
    "Reading",
    "ReadingCycles",
    "Transfer",
    "arbiter_area",
    "arbiter_is_fair",
    "check_law",
    "control_is_safe",
    "drive_code",
    "gateway_area",
    "gateway_verilog",
    "input_code",
    "measured_law",
    "measured_readers_law",
    "measured_writer_law",
    "model_cycles",
    "model_reading_cycles",
    "path_cycles",
    "simulate_readers",
    "simulate_transfer",
    "state_code",
]
