"""Simulated network: hosts with their links, which delay and lose packets."""

from __future__ import annotations

import hashlib
import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from sfglab.bus.sim.settings import STACK_NS, Costs, LinkModel, ns_from_s
from sfglab.units import BITS_PER_BYTE

if TYPE_CHECKING:
    from collections.abc import Callable
    from random import Random

    from sfglab.bus.sim.loop import VirtualLoop

_FRAME_BYTES = 14 + 20  # Headers of Ethernet and IP per frame.
_FRAME_PAYLOAD = 1480  # Payload of an IP fragment: 1500 - 20.
_SAMPLE_BYTES = 8 + 20 + 12 + 24  # Header of UDP; header, INFO_TS and DATA of RTPS.
_HEARTBEAT_BYTES = 32


@dataclass(eq=False, slots=True)
class Server:
    """Resource that serves arrivals one after the other: a process, or one direction of a link."""

    free_ns: int = 0  #: Time at which all arrivals so far are served, ns.

    def occupy(self, time_ns: int, duration_ns: int) -> int:
        """Serve an arrival at `time_ns` behind earlier ones; return the time at which it is served."""
        self.free_ns = max(self.free_ns, time_ns) + duration_ns
        return self.free_ns


@dataclass(eq=False, slots=True)
class Host:
    """Host of the world, with a link to the network that can be disconnected."""

    name: str  #: Name of the host.
    id: str  #: 16 hexadecimal digits, as `EndpointInfo.host` shows them.
    link: LinkModel  #: Link to the network; a change applies to packets sent from then on.
    #: Function that is called when the host is disconnected or connected.
    on_cable: Callable[[], None]
    incoming: Server = field(default_factory=Server)  #: The link's direction to the host.
    outgoing: Server = field(default_factory=Server)  #: The link's direction to the network.
    _is_connected: bool = True

    @property
    def is_connected(self) -> bool:
        """Whether the host is connected; otherwise it exchanges no packets with other hosts."""
        return self._is_connected

    @is_connected.setter
    def is_connected(self, connected: bool) -> None:
        if connected != self._is_connected:
            self._is_connected = connected
            self.on_cable()

    @property
    def latency_ns(self) -> int:
        """Latency of the link, ns."""
        return ns_from_s(self.link.latency_s)

    def transfer_ns(self, size_bytes: int) -> int:
        """Return the time, ns, for which frames of a size occupy the link."""
        rate_bps = self.link.rate_bps
        return 0 if rate_bps is None else ns_from_s(BITS_PER_BYTE * size_bytes / rate_bps)

    def can_reach(self, other: Host) -> bool:
        """Return whether packets reach a host from here."""
        return self is other or (self.is_connected and other.is_connected)


def host_id(seed: int, name: str) -> str:
    """Return the id of a host, which follows from the world's seed and the host's name."""
    return hashlib.blake2b(f"{seed} {name}".encode(), digest_size=8).hexdigest()


def frame_bytes(cdr_bytes: int, *, reliable: bool) -> int:
    """Return the size of a sample in Ethernet frames, within 1 % of Cyclone DDS's up to 100 kB."""
    payload = _SAMPLE_BYTES + cdr_bytes + (_HEARTBEAT_BYTES if reliable else 0)
    return payload + -(-payload // _FRAME_PAYLOAD) * _FRAME_BYTES


class Network:
    """Network that carries packets between hosts, and loses some at random."""

    def __init__(self, loop: VirtualLoop, costs: Costs, random: Random) -> None:
        self.loop = loop
        self.costs = costs
        self.random = random

    def depart(self, host: Host, size_bytes: int) -> int | None:
        """Return the time at which a packet sent now has left its host, None if the host's link loses it."""
        sent_ns = host.outgoing.occupy(self.loop.now_ns, host.transfer_ns(size_bytes))
        return None if self._loses(host) else sent_ns

    def arrive(
        self, sent_ns: int | None, source: Host, target: Host, size_bytes: int
    ) -> int | None:
        """Return the time at which a packet has arrived at another host, None if it is lost."""
        if sent_ns is None or not source.can_reach(target) or self._loses(target):
            return None
        reached_ns = sent_ns + source.latency_ns + target.latency_ns + STACK_NS
        return target.incoming.occupy(reached_ns, target.transfer_ns(size_bytes))

    def losses(self, one: Host, other: Host) -> int:
        """Draw the number of losses between two hosts before a packet arrives."""
        first, second = one.link.loss, other.link.loss
        loss = first + second - first * second
        if one is other or not loss:
            return 0
        return int(math.log(1 - self.random.random()) / math.log(loss))

    def _loses(self, host: Host) -> bool:
        return host.link.loss > 0 and self.random.random() < host.link.loss
