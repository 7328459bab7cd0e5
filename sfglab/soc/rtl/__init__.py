"""The gateway of paper C as hardware, in Amaranth (paper C, section 3; ReconROS' 64-bit template).

Bottom up: `data_path` (memory interface's master, topic, mover), `core` (control generated from the core's
table, and the gateway), `cycles` (its test bench and cycle model), `readers` (what it spares: an arbiter and
nodes that all read; cycles of both beside the memory model), `synthesis` (Verilog, area).
Needs the extra `rtl`; nothing else of sfglab imports it.
"""

from sfglab.soc.rtl.cycles import Delays
from sfglab.soc.rtl.readers import MemoryPath, cycle_model, memory_model_cycles, simulated_cycles
from sfglab.soc.rtl.synthesis import Area, gateway_area, gateway_verilog

__all__ = [
    "Area",
    "Delays",
    "MemoryPath",
    "cycle_model",
    "gateway_area",
    "gateway_verilog",
    "memory_model_cycles",
    "simulated_cycles",
]
