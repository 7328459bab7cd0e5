"""The gateway of paper C as hardware, in Amaranth (paper C, section 3; ReconROS' 64-bit template).

Bottom up: `control` (generated from the core's table), `memif` (master of the memory interface), `topic` (turns
and broadcast), `mover` (chunk buffer and data path), `core` (the gateway); around it `bench` (clocked
surroundings), `law` (cycles of messages), `synthesis` (Verilog, LUT and FF), `proof` (properties).
Needs the extra `rtl`; nothing else of sfglab imports it.
"""

from __future__ import annotations

from sfglab.soc.rtl.bench import Bench, Delays
from sfglab.soc.rtl.control import Control, drive_code, input_code, state_code
from sfglab.soc.rtl.core import Answer, Call, Gateway
from sfglab.soc.rtl.law import (
    CycleLaw,
    HardwareError,
    Transfer,
    TransferCycles,
    measured_law,
    model_cycles,
    simulate_transfer,
)
from sfglab.soc.rtl.proof import PROPERTIES, control_is_safe
from sfglab.soc.rtl.synthesis import GatewayArea, YosysError, gateway_area, gateway_verilog, yosys_is_there

__all__ = [
    "PROPERTIES",
    "Answer",
    "Bench",
    "Call",
    "Control",
    "CycleLaw",
    "Delays",
    "Gateway",
    "GatewayArea",
    "HardwareError",
    "Transfer",
    "TransferCycles",
    "YosysError",
    "control_is_safe",
    "drive_code",
    "gateway_area",
    "gateway_verilog",
    "input_code",
    "measured_law",
    "model_cycles",
    "simulate_transfer",
    "state_code",
    "yosys_is_there",
]
