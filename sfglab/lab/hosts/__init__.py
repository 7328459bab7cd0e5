"""Test hosts: several hosts on one machine, with addresses and processes of their own.

    with Network() as network:
        edge, station = network.add_host("edge"), network.add_host("station")
        network.set_radio(Medium(rate_bps=10e6, loss=0.05))
        process = edge.popen([sys.executable, "-m", "..."])

The end of the block removes everything, also after an exception or a kill of the creating process.
"""

from sfglab.lab.hosts.host import (
    Host,
    HostsError,
    HostsUnavailableError,
    InterfaceBytes,
)
from sfglab.lab.hosts.network import Capability, Network
from sfglab.lab.hosts.radio import RadioCounters

__all__ = [
    "Capability",
    "Host",
    "HostsError",
    "HostsUnavailableError",
    "InterfaceBytes",
    "Network",
    "RadioCounters",
]
