"""Hosts and participants: who takes part in a simulated network, and what each has sent and received."""

from __future__ import annotations

import hashlib
from typing import TYPE_CHECKING

from sfglab.bus.sim.clockwork import ns_from_s
from sfglab.bus.sim.knowledge import NEVER_NS

if TYPE_CHECKING:
    from sfglab.bus.sim.domain import Domain
    from sfglab.bus.sim.endpoint import Endpoint
    from sfglab.bus.sim.link import LinkModel


_KINDS = 4  # of `traffic.Load`


class Host:
    """A host of the world: a link to the network, and counters.

    Attributes:
        name: What it is called.
        id: 16 hexadecimal digits, as `EndpointInfo.host` shows them.
        link: Its link.
        latency_ns: The link's latency.
        side: Hosts of different sides do not hear each other.
        rx: Bytes received, by `Load`; what an account has not settled yet is missing.
        tx: Bytes sent.
        rx_free_ns: Until when the link is busy with what comes in.
        tx_free_ns: The same for what goes out.
    """

    __slots__ = ("id", "latency_ns", "link", "name", "rx", "rx_free_ns", "side", "tx", "tx_free_ns")

    def __init__(self, name: str, link: LinkModel, seed: int) -> None:
        self.name = name
        self.id = hashlib.blake2b(f"{seed} {name}".encode(), digest_size=8).hexdigest()
        self.set_link(link)
        self.side = 0
        self.rx = [0] * _KINDS
        self.tx = [0] * _KINDS
        self.rx_free_ns = 0
        self.tx_free_ns = 0

    def set_link(self, link: LinkModel) -> None:
        """Change the link."""
        self.link = link
        self.latency_ns = ns_from_s(link.latency_s)


class Process:
    """What does one thing after the other.

    Attributes:
        free_ns: When it is done with all that it has heard so far.
        spent_ns: What it has spent in all.
    """

    __slots__ = ("free_ns", "spent_ns")

    def __init__(self) -> None:
        self.free_ns = 0
        self.spent_ns = 0

    def occupy(self, now_ns: int, cost_ns: int) -> None:
        """Let it spend time on something that it hears now, behind what it has heard before."""
        self.free_ns = max(self.free_ns, now_ns) + cost_ns
        self.spent_ns += cost_ns


class Participant:
    """A node's place in a domain.

    Attributes:
        guid: Its 16-byte GUID.
        name: The node's full name.
        user_data: Its USER_DATA.
        presence: Whether ROS 2's tools shall see its node, which takes one more writer.
        born_ns: When it joined.
        crashed_ns: When it fell silent without a word; None otherwise.
        left_ns: When it left; None otherwise.
        last_sent_ns: When it last sent a sample, as a sign of life.
        lease_ns: How long the others believe that it lives without a sign of it.
        interval_ns: Of its periodic announcements.
        latency_ns: Of its host's link, when it joined; what discovery takes is settled by it.
        loss: The same.
        endpoints: What it has.
        process: Who does its work.
        crowd_ns: What the domain's announcements had cost everybody when it joined.
        ticked_ns: Until when its periodic announcements are booked.
        heartbeat_until_ns: Until when a heartbeat of its built-in writers covers what is new: of readers, of
            writers.
    """

    __slots__ = (
        "born_ns",
        "crashed_ns",
        "crowd_ns",
        "domain",
        "endpoints",
        "guid",
        "heartbeat_until_ns",
        "host",
        "interval_ns",
        "last_sent_ns",
        "latency_ns",
        "lease_ns",
        "left_ns",
        "loss",
        "name",
        "number",
        "presence",
        "process",
        "serial",
        "ticked_ns",
        "user_data",
    )

    def __init__(self, domain: Domain, host: Host, process: Process, *, name: str, number: int) -> None:
        self.domain = domain
        self.host = host
        self.process = process
        self.name = name
        self.number = number
        prefix = hashlib.blake2b(f"{host.id} {number} {name}".encode(), digest_size=12).digest()
        self.guid = prefix + b"\x00\x00\x01\xc1"  # RTPS 2.5, table 9.1: ENTITYID_PARTICIPANT
        self.serial = 0
        self.user_data = b""
        self.presence = True
        self.lease_ns = self.interval_ns = 0
        self.latency_ns = host.latency_ns
        self.loss = host.link.loss
        self.born_ns = 0
        self.ticked_ns = 0
        self.crowd_ns = 0
        self.crashed_ns: int | None = None
        self.left_ns: int | None = None
        self.last_sent_ns = 0
        self.endpoints: dict[Endpoint, None] = {}
        self.heartbeat_until_ns = [0, 0]  # of readers, of writers

    @property
    def alive(self) -> bool:
        """Whether it still takes part."""
        return self.crashed_ns is None and self.left_ns is None

    def new_gid(self, *, writer: bool) -> bytes:
        """Return the GUID of the next endpoint (RTPS 2.5, clause 9.3.1.2: user-defined, without a key)."""
        self.serial += 1
        return self.guid[:12] + self.serial.to_bytes(3, "big") + (b"\x03" if writer else b"\x04")


class Partition:
    """A time in which the network falls into sides that do not hear each other.

    Args:
        start_ns: From when on.
        sides: The number of each host's side.

    Attributes:
        end_ns: Until when; `NEVER_NS` while it lasts.
    """

    def __init__(self, start_ns: int, sides: dict[Host, int]) -> None:
        self.start_ns = start_ns
        self.end_ns = NEVER_NS
        self._sides = sides

    @property
    def lasts(self) -> bool:
        """Whether it has not ended."""
        return self.end_ns == NEVER_NS

    def separates(self, one: Participant, other: Participant) -> bool:
        """Return whether two participants are on different sides."""
        return self._sides.get(one.host, 0) != self._sides.get(other.host, 0)
