"""The gateway of paper C as hardware, in Amaranth (paper C, section 3; ReconROS' 64-bit template).

Bottom up: `control` (generated from the core's table), `memif` (master of the memory interface), `topic` (turns
and broadcast), `mover` (chunk buffer and data path), `core` (the gateway); around it `bench` (clocked
surroundings), `law` (cycles of messages), `synthesis` (Verilog, LUT and FF), `proof` (properties). Beside it
what it spares: `arbiter` (turns at the memory interface), `readers` (nodes that all read), `shared` (their
cycles); `check` has the laws of both beside the memory model, as rows.
Needs the extra `rtl`; nothing else of sfglab imports it.
"""

from __future__ import annotations

from sfglab.soc.rtl.check import LawCheck, MemoryPath, PathCycles, check_law, path_cycles, path_law
from sfglab.soc.rtl.core import Answer, Call, Control, Gateway, drive_code, input_code, state_code
from sfglab.soc.rtl.cycles import (
    Bench,
    CycleLaw,
    Delays,
    HardwareError,
    Transfer,
    TransferCycles,
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
    ARBITER_PROPERTIES,
    PROPERTIES,
    ArbiterArea,
    GatewayArea,
    YosysError,
    arbiter_area,
    arbiter_is_fair,
    control_is_safe,
    gateway_area,
    gateway_verilog,
    yosys_is_there,
)

__all__ = [
    "ARBITER_PROPERTIES",
    "PROPERTIES",
    "Answer",
    "Arbiter",
    "ArbiterArea",
    "Bench",
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
    "TransferCycles",
    "YosysError",
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
    "path_law",
    "simulate_readers",
    "simulate_transfer",
    "state_code",
    "yosys_is_there",
]
