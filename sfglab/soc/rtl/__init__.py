"""The package `rtl` has the gateway of paper C, section 3, as hardware in Amaranth (ReconROS' 64-bit template).

The package `sfglab.soc.rtl` needs the extra `rtl`. The package has these modules:

- The module `core` has the gateway and generates the gateway's control from the core's table (`sfglab.soc.gateway`).
- The module `mover` has the gateway's data path.
- The module `topic` has the hardware-mapped topic.
- The module `memory_port` has the memory interface.
- The module `bench` has test benches of the gateway, and of nodes that read or write without a gateway.
- The module `cycles` simulates the cycles of a message on each path.
- The module `synthesis` writes Verilog with Yosys.

The test benches are hardware as well, so the simulator runs no Python code in a simulated cycle.
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
