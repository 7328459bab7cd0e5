"""The gateway of paper C, section 3, as hardware in Amaranth (ReconROS' 64-bit template). Needs the extra `rtl`.

- `core`: the gateway, and its control, which is generated from the core's table (`sfglab.soc.gateway`).
- `mover`: the gateway's data path. `topic`: the hardware-mapped topic. `memory_port`: the memory interface.
- `bench`: test benches of the gateway, and of nodes that read or write without one.
- `cycles`: simulated cycles of a message on each path.
- `synthesis`: Verilog, by Yosys.

The test benches are hardware as well, so that no Python runs in each simulated cycle.
"""

from sfglab.soc.rtl.bench import Delays
from sfglab.soc.rtl.cycles import MemoryPath, cycle_model, simulated_cycles
from sfglab.soc.rtl.synthesis import gateway_verilog

__all__ = [
    "Delays",
    "MemoryPath",
    "cycle_model",
    "gateway_verilog",
    "simulated_cycles",
]
