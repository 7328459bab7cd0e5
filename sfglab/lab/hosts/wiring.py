"""The bridge, the cables and the addresses of a network of hosts, through netlink.

Runs in the hub's process and namespace. One bridge is the network; each host hangs on it by a veth pair whose
outer end is named ``p2``, ``p3`` ... and whose inner end is the host's ``eth0``. IPv6 stays unconfigured and
multicast is flooded, so that the interfaces carry nothing that no process sent.
"""

from __future__ import annotations

import contextlib
import ctypes
import fcntl
import os
import socket
import struct
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from pyroute2.iproute.linux import IPRoute

from sfglab.lab.hosts.enter import CLONE_NEWNET, setns

if TYPE_CHECKING:
    from collections.abc import Iterator


INTERFACE = "eth0"
_BRIDGE = "br0"
_SUBNET = "10.77.0."
_FIRST, _LAST = 2, 254
_LO = 1
# IN6_ADDR_GEN_MODE_NONE (linux/if_link.h): no link-local address, hence no neighbour discovery.
_NO_IPV6 = {"attrs": [("AF_INET6", {"attrs": [("IFLA_INET6_ADDR_GEN_MODE", 1)]})]}
# Frames leave one by one, as on a wire: without this TCP hands over up to 64 kB as one "packet".
_NO_OFFLOAD = 1
# linux/sockios.h, linux/ethtool.h
_SIOCETHTOOL = 0x8946
_ETHTOOL_STXCSUM = 0x17


@dataclass(frozen=True, slots=True, kw_only=True)
class Port:
    """Where a host is plugged in."""

    number: int  #: The last byte of the host's address.
    outer: str  #: Name of the cable's end at the bridge.
    outer_index: int  #: Its interface index, in the hub's namespace.
    inner_index: int  #: Index of the host's ``eth0``, in the host's namespace.
    namespace: int  #: Descriptor of the host's network namespace, which stays open.

    @property
    def address(self) -> str:
        """Return the host's IPv4 address."""
        return f"{_SUBNET}{self.number}"

    @property
    def mac(self) -> str:
        """Return the host's Ethernet address."""
        return _mac(self.number)


def _mac(number: int) -> str:
    return f"02:00:0a:4d:00:{number:02x}"


def _compute_checksums(interface: str) -> None:
    """Have the sender finish its checksums; between two cables' ends the kernel leaves that to nobody."""
    off = struct.pack("@II", _ETHTOOL_STXCSUM, 0)
    value = ctypes.create_string_buffer(off, len(off))
    request = struct.pack("@16sP", interface.encode(), ctypes.addressof(value))
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
        fcntl.ioctl(sock, _SIOCETHTOOL, request.ljust(40, b"\0"))


def _set_up(netlink: Any, index: int) -> None:
    netlink.link("set", index=index, IFLA_AF_SPEC=_NO_IPV6)
    netlink.link("set", index=index, state="up")


class Wiring:
    """The bridge and what is plugged into it; ends with the namespaces."""

    def __init__(self) -> None:
        self._own = os.open("/proc/self/ns/net", os.O_RDONLY)
        self.netlink = IPRoute()
        self.netlink.link("add", ifname=_BRIDGE, kind="bridge", br_mcast_snooping=0, br_stp_state=0)
        self._bridge = self._index(self.netlink, _BRIDGE)
        _set_up(self.netlink, self._bridge)
        self._next = _FIRST

    @staticmethod
    def _index(netlink: Any, name: str) -> int:
        return int(netlink.link_lookup(ifname=name)[0])

    @contextlib.contextmanager
    def inside(self, namespace: int) -> Iterator[Any]:
        """Open a netlink socket inside a host; the process itself is back in its own namespace.

        Args:
            namespace: Descriptor of the host's network namespace.
        """
        setns(namespace, CLONE_NEWNET)
        try:
            netlink = IPRoute()
        finally:
            setns(self._own, CLONE_NEWNET)
        with netlink:
            yield netlink

    def plug(self, pid: int) -> Port:
        """Connect the network namespace of a process to the bridge and configure it as a host.

        Args:
            pid: The process that holds the namespace.

        Raises:
            NetlinkError: The kernel refuses.
            OSError: All addresses are taken.
        """
        number = self._next
        if number > _LAST:
            raise OSError(f"a network has room for {_LAST - _FIRST + 1} hosts")
        self._next += 1
        outer = f"p{number}"
        peer = {
            "ifname": INTERFACE,
            "net_ns_pid": pid,
            "address": _mac(number),
            "IFLA_GSO_MAX_SEGS": _NO_OFFLOAD,
        }
        self.netlink.link(
            "add", ifname=outer, kind="veth", master=self._bridge, peer=peer, IFLA_GSO_MAX_SEGS=_NO_OFFLOAD
        )
        outer_index = self._index(self.netlink, outer)
        namespace = os.open(f"/proc/{pid}/ns/net", os.O_RDONLY)
        inner_index = self._configure(namespace, f"{_SUBNET}{number}")
        _set_up(self.netlink, outer_index)
        return Port(
            number=number,
            outer=outer,
            outer_index=outer_index,
            inner_index=inner_index,
            namespace=namespace,
        )

    def take_out(self, port: Port) -> None:
        """Take a host off the bridge, for a relay of frames to take its place.

        Args:
            port: Where the host is plugged in.
        """
        setns(port.namespace, CLONE_NEWNET)
        try:
            _compute_checksums(INTERFACE)
        finally:
            setns(self._own, CLONE_NEWNET)
        self.netlink.link("set", index=port.outer_index, master=0)

    def put_back(self, port: Port) -> None:
        """Put a host back on the bridge."""
        self.netlink.link("set", index=port.outer_index, master=self._bridge)

    def _configure(self, namespace: int, address: str) -> int:
        with self.inside(namespace) as netlink:
            index = self._index(netlink, INTERFACE)
            netlink.link("set", index=_LO, state="up")
            _set_up(netlink, index)
            netlink.addr("add", index=index, address=address, prefixlen=24)
            # Without it, multicast senders find no route (there is no default gateway).
            netlink.route("add", dst="224.0.0.0/4", oif=index)
        return index
