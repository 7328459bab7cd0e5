"""Substitute for a container: a program in a network namespace that a bridge joins to this machine.

``python -m sfglab.lab.workers.container BRIDGE`` makes the bridge. With a command after it, the process enters a
network namespace whose ``eth0`` is connected to this bridge, and becomes the command. As in an ``internal``
network of Compose, nothing is forwarded to other networks. The namespace ends with the command, and the bridge
with the network namespace of the caller. A bridge has one container.
"""

from __future__ import annotations

import os
import sys

from sfglab.lab.hosts.enter import CLONE_NEWNET, unshare
from sfglab.lab.hosts.host import INTERFACE

_MACHINE = "10.88.0.1"
_INSIDE = "10.88.0.2"
_LO = 1


def make_bridge(name: str) -> None:
    """Make a bridge on this machine.

    Raises:
        NetlinkError: The kernel refuses.
    """
    from pyroute2.iproute.linux import IPRoute

    with IPRoute() as machine:
        machine.link("add", ifname=name, kind="bridge", br_mcast_snooping=0, br_stp_state=0)
        [bridge] = machine.link_lookup(ifname=name)
        machine.addr("add", index=bridge, address=_MACHINE, prefixlen=24)
        machine.link("set", index=bridge, state="up")


def enter_container(bridge: str) -> None:
    """Move this process into a network namespace of its own that is connected to a bridge of this machine.

    Raises:
        NetlinkError: The kernel refuses.
        OSError: The kernel refuses the namespace.
    """
    from pyroute2.iproute.linux import IPRoute

    outer = f"{bridge[:13]}-c"
    with IPRoute() as machine:  # stays a socket of the machine
        [master] = machine.link_lookup(ifname=bridge)
        unshare(CLONE_NEWNET)
        peer = {"ifname": INTERFACE, "net_ns_pid": os.getpid()}
        machine.link("add", ifname=outer, kind="veth", master=master, peer=peer)
        machine.link("set", index=machine.link_lookup(ifname=outer)[0], state="up")
    with IPRoute() as inside:
        [index] = inside.link_lookup(ifname=INTERFACE)
        for link in (_LO, index):
            inside.link("set", index=link, state="up")
        inside.addr("add", index=index, address=_INSIDE, prefixlen=24)
        inside.route("add", dst="224.0.0.0/4", oif=index)  # there is no other route for multicast


if __name__ == "__main__":
    if len(sys.argv) == 2:
        make_bridge(sys.argv[1])
    else:
        enter_container(sys.argv[1])
        os.execvp(sys.argv[2], sys.argv[2:])  # noqa: S606 - no shell is the point
