"""Runs a program in a container's place: in a network of its own that only a bridge joins to this machine.

``python -m sfglab.lab.workers.container BRIDGE COMMAND...`` makes the bridge where it is not there yet and a
network namespace whose ``eth0`` hangs on it, as Compose does for an ``internal`` network (no way out, no
forwarding), and becomes the command inside. The namespace ends with the command, the bridge with the machine's.
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


def enter_container(bridge: str) -> None:
    """Move this process into a network of its own that hangs on a bridge, given its interface on the machine.

    Raises:
        NetlinkError: The kernel refuses.
        OSError: It refuses the namespace.
    """
    from pyroute2.iproute.linux import IPRoute

    with IPRoute() as machine:  # stays a socket of the machine
        index = _bridge(machine, bridge)
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
    """Enter the container and become the command."""
    enter_container(bridge)
    os.execvp(command[0], list(command))  # noqa: S606 - no shell is the point


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2:])
