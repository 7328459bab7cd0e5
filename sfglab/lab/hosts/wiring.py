"""Bridge, cables and addresses of a network of hosts.

The module runs in the hub's process and namespace. One bridge is the network. Each host is connected to it
with a veth pair, whose outer end is named ``p2``, ``p3`` ... and whose inner end is the host's ``eth0``.
IPv6 is not configured, multicast is flooded, and hosts know each other's addresses. Therefore the
interfaces carry only frames that a process sent.
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
from sfglab.lab.hosts.host import INTERFACE

if TYPE_CHECKING:
    from collections.abc import Iterator

_BRIDGE = "br0"
_SUBNET = "10.77.0."
_FIRST = 2
_LO = 1
# IN6_ADDR_GEN_MODE_NONE (linux/if_link.h): no link-local address, and thus no neighbour discovery.
_NO_IPV6 = {"attrs": [("AF_INET6", {"attrs": [("IFLA_INET6_ADDR_GEN_MODE", 1)]})]}
# Frames leave one by one, as on a real cable. Without this, TCP passes up to 64 kB as one "packet".
_NO_OFFLOAD = 1
# linux/sockios.h, linux/ethtool.h
_SIOCETHTOOL = 0x8946
_ETHTOOL_STXCSUM = 0x17


@dataclass(frozen=True, slots=True, kw_only=True)
class Port:
    """Virtual Ethernet cable between a host's network namespace and the bridge in the hub's namespace."""

    number: int  #: Last byte of the host's address.
    outer: str  #: Name of the cable's end at the bridge.
    outer_index: int  #: Index of this interface in the hub's namespace.
    inner_index: int  #: Index of the host's ``eth0`` in the host's namespace.
    namespace: int  #: Descriptor of the host's network namespace, which stays open.

    @property
    def address(self) -> str:
        """Return the host's IPv4 address, in dotted form."""
        return f"{_SUBNET}{self.number}"

    @property
    def mac(self) -> str:
        """Return the host's Ethernet address."""
        return _mac(self.number)


def _mac(number: int) -> str:
    return f"02:00:0a:4d:00:{number:02x}"


def _compute_checksums(interface: str) -> None:
    """Make the sender compute its checksums, which the kernel omits between the ends of a virtual cable."""
    off = struct.pack("@II", _ETHTOOL_STXCSUM, 0)
    value = ctypes.create_string_buffer(off, len(off))
    request = struct.pack("@16sP", interface.encode(), ctypes.addressof(value))
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
        fcntl.ioctl(sock, _SIOCETHTOOL, request.ljust(40, b"\0"))


def _set_up(netlink: Any, index: int) -> None:
    netlink.link("set", index=index, IFLA_AF_SPEC=_NO_IPV6)
    netlink.link("set", index=index, state="up")


class Wiring:
    """The bridge and its connections; they end with the namespaces."""

    def __init__(self) -> None:
        self._own = os.open("/proc/self/ns/net", os.O_RDONLY)
        self.netlink = IPRoute()
        self.netlink.link("add", ifname=_BRIDGE, kind="bridge", br_mcast_snooping=0, br_stp_state=0)
        self._bridge = self._index(self.netlink, _BRIDGE)
        _set_up(self.netlink, self._bridge)
        self._next = _FIRST
        self._ports: list[Port] = []

    @staticmethod
    def _index(netlink: Any, name: str) -> int:
        return int(netlink.link_lookup(ifname=name)[0])

    @contextlib.contextmanager
    def _standing_in(self, namespace: int) -> Iterator[None]:
        setns(namespace, CLONE_NEWNET)
        try:
            yield
        finally:
            setns(self._own, CLONE_NEWNET)

    def inside(self, namespace: int) -> Any:
        """Return a netlink socket inside a host, from its namespace's descriptor; the process stays outside."""
        with self._standing_in(namespace):
            return IPRoute()

    def plug(self, pid: int) -> Port:
        """Connect a process's network namespace to the bridge and configure it as a host.

        Raises:
            NetlinkError: The kernel refuses.
        """
        number = self._next
        self._next += 1
        outer = f"p{number}"
        single = {"IFLA_GSO_MAX_SEGS": _NO_OFFLOAD}
        peer = {"ifname": INTERFACE, "net_ns_pid": pid, "address": _mac(number), **single}
        self.netlink.link(
            "add", ifname=outer, kind="veth", master=self._bridge, peer=peer, **single
        )
        outer_index = self._index(self.netlink, outer)
        namespace = os.open(f"/proc/{pid}/ns/net", os.O_RDONLY)
        inner_index = self._configure(namespace, f"{_SUBNET}{number}")
        _set_up(self.netlink, outer_index)
        port = Port(
            number=number,
            outer=outer,
            outer_index=outer_index,
            inner_index=inner_index,
            namespace=namespace,
        )
        for other in self._ports:
            self._introduce(port, other)
            self._introduce(other, port)
        self._ports.append(port)
        return port

    def _introduce(self, port: Port, other: Port) -> None:
        """Give a host the Ethernet address of another one, so that it sends no ARP request."""
        with self.inside(port.namespace) as netlink:
            known = {"dst": other.address, "lladdr": other.mac, "nud": "permanent"}
            netlink.neigh("replace", ifindex=port.inner_index, **known)

    def set_connected(self, port: Port, *, connected: bool) -> None:
        """Connect a host to the bridge, or disconnect it."""
        bridge = self._bridge if connected else 0
        self.netlink.link("set", index=port.outer_index, master=bridge)

    def take_over(self, port: Port) -> None:
        """Disconnect a host from the bridge, which a relay of frames replaces."""
        with self._standing_in(port.namespace):
            _compute_checksums(INTERFACE)
        self.set_connected(port, connected=False)

    def _configure(self, namespace: int, address: str) -> int:
        with self.inside(namespace) as netlink:
            index = self._index(netlink, INTERFACE)
            netlink.link("set", index=_LO, state="up")
            _set_up(netlink, index)
            netlink.addr("add", index=index, address=address, prefixlen=24)
            # Without this route, multicast senders find none (there is no default gateway).
            netlink.route("add", dst="224.0.0.0/4", oif=index)
        return index
