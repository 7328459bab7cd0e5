"""Substitute for a container: a program in a network namespace that a bridge joins to this machine.

``python -m sfglab.lab.workers.container BRIDGE COMMAND...`` makes the bridge if it is missing, and a network
namespace whose ``eth0`` is connected to it. As in an ``internal`` network of Compose, nothing is forwarded to
other networks. The process then becomes the command inside. Without a command it makes only the bridge. The
namespace ends with the command, and the bridge with the network namespace of the caller.
"""

from __future__ import annotations

import os
import sys
from typing import TYPE_CHECKING, Any

from sfglab.lab.hosts.enter import CLONE_NEWNET, unshare
from sfglab.lab.hosts.host import INTERFACE

if TYPE_CHECKING:
    from collections.abc import Sequence

_SUBNET = "10.88.0."
_MACHINE, _FIRST = 1, 2
_LO = 1


def enter_container(bridge: str, *, only_bridge: bool = False) -> None:
    """Move this process into a network namespace of its own that is connected to a bridge of this machine.

    With `only_bridge` the bridge is made and the process stays where it is.

    Raises:
        NetlinkError: The kernel refuses.
        OSError: It refuses the namespace.
    """
    from pyroute2.iproute.linux import IPRoute

    with IPRoute() as machine:  # stays a socket of the machine
        index = _bridge(machine, bridge)
        if only_bridge:
            return
        outer = f"{bridge[:10]}-{os.getpid() % 10_000}"
        unshare(CLONE_NEWNET)
        peer = {"ifname": INTERFACE, "net_ns_pid": os.getpid()}
        machine.link("add", ifname=outer, kind="veth", master=index, peer=peer)
        machine.link("set", index=machine.link_lookup(ifname=outer)[0], state="up")
        number = _FIRST + len(machine.get_links(master=index)) - 1
    with IPRoute() as inside:
        index = inside.link_lookup(ifname=INTERFACE)[0]
        for link in (_LO, index):
            inside.link("set", index=link, state="up")
        inside.addr("add", index=index, address=f"{_SUBNET}{number}", prefixlen=24)
        inside.route("add", dst="224.0.0.0/4", oif=index)  # there is no other route for multicast


def _bridge(machine: Any, name: str) -> int:
    found = machine.link_lookup(ifname=name)
    if not found:
        machine.link("add", ifname=name, kind="bridge", br_mcast_snooping=0, br_stp_state=0)
        found = machine.link_lookup(ifname=name)
        machine.addr("add", index=found[0], address=f"{_SUBNET}{_MACHINE}", prefixlen=24)
        machine.link("set", index=found[0], state="up")
    return int(found[0])


def main(bridge: str, command: Sequence[str]) -> None:
    """Enter the container and become the command, if there is one."""
    enter_container(bridge, only_bridge=not command)
    if command:
        os.execvp(command[0], list(command))  # noqa: S606 - no shell is the point


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2:])
