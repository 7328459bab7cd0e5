"""Rate and loss of a host's link: a token bucket at both ends of the cable, drops at the bridge.

Frames to the host queue at the bridge, frames from the host queue at its own ``eth0``, as before a real radio.
Losses are drawn by nftables where frames enter the bridge from the host (once for all receivers, as on air) and
where they leave it for the host (before the queue). The kernel's random numbers take no seed: single drops are
not reproducible, their rate is.
"""

from __future__ import annotations

import struct
from typing import TYPE_CHECKING, Any

from pyroute2.netlink.nfnetlink.nftsocket import Cmp, Meta, Regs
from pyroute2.netlink.rtnl import TC_H_ROOT
from pyroute2.nftables.expressions import genex, verdict
from pyroute2.nftables.main import NFTables

from sfglab.lab.hosts.link import Link, LinkCounters

if TYPE_CHECKING:
    from sfglab.lab.hosts.wiring import Port, Wiring


_NFPROTO_BRIDGE = 7  # linux/netfilter.h
_NAME_BYTES = 16  # IFNAMSIZ, linux/if.h
_RANDOM = 1  # NFT_NG_RANDOM, linux/netfilter/nf_tables.h
_HTON = 1  # NFT_BYTEORDER_HTON
_DROP, _ACCEPT = 0, 1  # linux/netfilter.h
_MILLION = 1_000_000
_HANDLE = 0x10000  # 1: in tc's notation
# chain: (hook, which interface the frame is compared with)
_CHAINS = {"up": ("prerouting", Meta.NFT_META_IIFNAME), "down": ("forward", Meta.NFT_META_OIFNAME)}


def _value(data: bytes) -> dict[str, Any]:
    return {"attrs": [("NFTA_DATA_VALUE", data)]}


def _compare(operation: Cmp, data: bytes) -> Any:
    return genex("cmp", {"sreg": Regs.NFT_REG_1, "op": operation, "data": _value(data)})


def _numgen() -> dict[str, Any]:
    """Draw a random number below a million; pyroute2's `genex` does not know this attribute prefix."""
    attributes = [
        ("NFTA_NG_DREG", Regs.NFT_REG_1),
        ("NFTA_NG_MODULUS", _MILLION),
        ("NFTA_NG_TYPE", _RANDOM),
        ("NFTA_NG_OFFSET", 0),
    ]
    return {"attrs": [("NFTA_EXPR_NAME", "numgen"), ("NFTA_EXPR_DATA", {"attrs": attributes})]}


def _lossy(interface: str, key: Meta, per_million: int) -> list[Any]:
    """Compile ``iifname|oifname X numgen random mod 1000000 < P counter drop``."""
    register = Regs.NFT_REG_1
    swap = {"sreg": register, "dreg": register, "op": _HTON, "len": 4, "size": 4}
    return [
        genex("meta", {"key": key, "dreg": register}),
        _compare(Cmp.NFT_CMP_EQ, interface.encode().ljust(_NAME_BYTES, b"\0")),
        _numgen(),
        # Comparison is bytewise, the random number is in the machine's order.
        genex("byteorder", swap),
        _compare(Cmp.NFT_CMP_LT, struct.pack(">I", per_million)),
        genex("counter", {"bytes": 0, "packets": 0}),
        *verdict(_DROP),
    ]


def _set_rate(netlink: Any, index: int, link: Link) -> None:
    if any(message.get_attr("TCA_KIND") == "tbf" for message in netlink.get_qdiscs(index=index)):
        netlink.tc("del", index=index, handle=_HANDLE, parent=TC_H_ROOT)
    if link.rate_bps is not None:
        netlink.tc(
            "add",
            "tbf",
            index=index,
            handle=_HANDLE,
            rate=round(link.rate_bps / 8),
            burst=link.burst_bytes,
            limit=link.limit_bytes,
        )


def _overflow(netlink: Any, index: int) -> int:
    for message in netlink.get_qdiscs(index=index):
        if message.get_attr("TCA_KIND") == "tbf":
            return int(message.get_attr("TCA_STATS")["drop"])
    return 0


def _drops(rule: Any) -> tuple[int, int]:
    for expression in rule.get_attr("NFTA_RULE_EXPRESSIONS"):
        if expression.get_attr("NFTA_EXPR_NAME") == "counter":
            data = expression.get_attr("NFTA_EXPR_DATA")
            return data.get_attr("NFTA_COUNTER_PACKETS"), data.get_attr("NFTA_COUNTER_BYTES")
    return 0, 0


class Shaping:
    """Sets and reads the links of a network; lives in the hub."""

    def __init__(self, wiring: Wiring) -> None:
        self._wiring = wiring
        self._lossy: set[str] = set()
        self._nft: Any = None

    def set_link(self, port: Port, link: Link) -> None:
        """Replace everything that was set at a port.

        Args:
            port: Where the host is plugged in.
            link: The new properties.

        Raises:
            NetlinkError: The kernel refuses, for want of a module or of permission.
        """
        _set_rate(self._wiring.netlink, port.outer_index, link)
        with self._wiring.inside(port.namespace) as netlink:
            _set_rate(netlink, port.inner_index, link)
        self._set_loss(port.outer, link.loss_per_million)

    def _set_loss(self, table: str, per_million: int) -> None:
        if table in self._lossy:
            self._nft.table("del", name=table)
            self._lossy.remove(table)
        if not per_million:
            return
        # Opened on first use: a kernel without nftables still gives hosts and rates.
        self._nft = self._nft or NFTables(nfgen_family=_NFPROTO_BRIDGE)
        self._nft.table("add", name=table)
        self._lossy.add(table)
        for chain, (hook, key) in _CHAINS.items():
            self._nft.chain("add", table=table, name=chain, hook=hook, type="filter", policy=_ACCEPT)
            self._nft.rule("add", table=table, chain=chain, expressions=[_lossy(table, key, per_million)])

    def counters(self, port: Port) -> LinkCounters:
        """Read what a port has lost since its link was set.

        Args:
            port: Where the host is plugged in.
        """
        lost = {"up": (0, 0), "down": (0, 0)}
        for rule in self._nft.get_rules() if port.outer in self._lossy else ():
            if rule.get_attr("NFTA_RULE_TABLE") == port.outer:
                lost[rule.get_attr("NFTA_RULE_CHAIN")] = _drops(rule)
        with self._wiring.inside(port.namespace) as netlink:
            overflow_up = _overflow(netlink, port.inner_index)
        return LinkCounters(
            lost_up_packets=lost["up"][0],
            lost_up_bytes=lost["up"][1],
            lost_down_packets=lost["down"][0],
            lost_down_bytes=lost["down"][1],
            overflow_up_packets=overflow_up,
            overflow_down_packets=_overflow(self._wiring.netlink, port.outer_index),
        )
