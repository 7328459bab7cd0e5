"""Accounts of one domain: which host sends and receives how many bytes for what, as Cyclone DDS sends.

With multicast, announcements, heartbeats of discovery, and samples for more than one other host go to all hosts
in one packet; acknowledgements and the talk with a newcomer are unicast. What is the same for all is accounted
once, on the domain, and settled when somebody asks or a participant comes or goes.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from sfglab.bus.sim.wire import (
    ACKNACK_BYTES,
    DISCOVERY_INFO_BYTES,
    HEARTBEAT_BYTES,
    HELLO_ROUND_ACKS_BYTES,
    HELLO_ROUND_BYTES,
    LIVELINESS_BYTES,
    MATCH_ACKS_BYTES,
    MATCH_BYTES,
    RETRACTION_BYTES,
    Load,
    acquaintance_bytes,
    announcement_bytes,
    departure_bytes,
    history_bytes,
    presentation_bytes,
    retold_bytes,
    submessage_bytes,
)

if TYPE_CHECKING:
    from sfglab.bus.sim.model import Domain, Endpoint, Host, Participant, Topic

# One heartbeat of a writer covers what it has sent in this time: Cyclone's Internal/HeartbeatInterval.
HEARTBEAT_NS = 100_000_000

_DATA, _ACKS, _DISCOVERY, _DISCOVERY_ACKS = (
    Load.DATA,
    Load.ACKS,
    Load.DISCOVERY,
    Load.DISCOVERY_ACKS,
)


class Accounts:
    """What a domain's participants send and receive; nothing of a loopback interface.

    A multicast packet reaches all hosts of the network; without multicast it is Cyclone's AllowMulticast=spdp.
    """

    def __init__(self, domain: Domain, network: dict[str, Host], *, multicast: bool) -> None:
        self._members = domain.members
        self._network = network
        self._loop = domain.environment.loop
        self._networked = domain.networked
        self._multicast = multicast
        self._hosts: dict[Host, int] = {}
        self._count = 0
        self._sizes: dict[tuple[Topic, bool, int, int], int] = {}
        self.parted = False  #: Whether hosts of different sides do not hear each other.
        # Accounted for every host, and for every participant, and not yet settled.
        self._rx_host = [0] * len(Load)
        self._tx_each = [0] * len(Load)
        self._met_until_ns = -1
        self._ticked_ns = -1

    def others(self, participant: Participant) -> int:
        """Return how many participants live on other hosts."""
        return self._count - self._hosts.get(participant.host, 0)

    def joined(self, newcomer: Participant) -> None:
        """Account a newcomer's acquaintance with everybody; it is not yet a member."""
        if not self._networked:
            return
        self.settle()
        self._hosts.setdefault(newcomer.host, 0)
        multicast, to_newcomer, from_newcomer = acquaintance_bytes(newcomer.user_data)
        self._to_all_hosts(newcomer.host, _DISCOVERY, multicast)
        known = 0
        for other in self._members:
            if other.host is newcomer.host:
                continue
            known += 1
            retold = retold_bytes(
                [*_discovery_info(other), *map(self._submessage, other.endpoints)]
            )
            _unicast(other.host, newcomer.host, _DISCOVERY, to_newcomer + retold)
            _unicast(newcomer.host, other.host, _DISCOVERY, from_newcomer)
        if known:
            self._round()
        self._hosts[newcomer.host] += 1
        self._count += 1
        for submessage in _discovery_info(newcomer):
            self._spread(newcomer, announcement_bytes(submessage), writer=True)

    def left(self, participant: Participant) -> None:
        """Account a participant's good-bye; it is still a member."""
        if self._networked:
            if self.others(participant):
                retractions = RETRACTION_BYTES * len(_discovery_info(participant))
                self._to_all_hosts(participant.host, _DISCOVERY, retractions + departure_bytes())
            self.crashed(participant)

    def crashed(self, participant: Participant) -> None:
        """Settle with a participant that is still a member."""
        if not self._networked:
            return
        self.settle()
        host = participant.host
        self._hosts[host] -= 1
        self._count -= 1
        if not self._hosts[host]:
            del self._hosts[host]

    def announced(self, endpoint: Endpoint) -> None:
        """Account an endpoint's announcement."""
        if self._networked:
            size = announcement_bytes(self._submessage(endpoint))
            self._spread(endpoint.participant, size, writer=endpoint.is_writer)

    def retracted(self, endpoint: Endpoint) -> None:
        """Account an endpoint's retraction."""
        if self._networked:
            self._spread(endpoint.participant, RETRACTION_BYTES, writer=endpoint.is_writer)

    def matched(self, writer: Participant, reader: Participant) -> None:
        """Account what a reliable writer and a reader that it has found say to each other."""
        if self._networked and writer.host is not reader.host:
            _unicast(writer.host, reader.host, _ACKS, MATCH_BYTES)
            _unicast(reader.host, writer.host, _ACKS, MATCH_ACKS_BYTES)

    def history(self, writer: Participant, reader: Participant, cdr_bytes: int) -> None:
        """Account a latched sample's way to a late joiner."""
        if self._networked and writer.host is not reader.host:
            there, back = history_bytes(cdr_bytes)
            _unicast(writer.host, reader.host, _DATA, there)
            _unicast(reader.host, writer.host, _ACKS, back)

    def sample(self, sender: Participant, targets: dict[Participant, None], size: int) -> None:
        """Account a sample, by its size in frames, for the participants with readers on other hosts."""
        if self._multicast and len(targets) > 1:
            self._to_all_hosts(sender.host, _DATA, size)
            return
        for target in targets:
            _unicast(sender.host, target.host, _DATA, size)

    def pending_rx(self) -> int:
        """Return how many bytes every host has received that are not settled."""
        self._tick()
        return sum(self._rx_host)

    def settle(self) -> None:
        """Account on the hosts what was accounted for all."""
        if not self._networked:
            return
        self._tick()
        for participant in self._members:
            host = participant.host
            for load in Load:
                host.tx[load] += self._tx_each[load]
        for host in self._network.values():
            for load in Load:
                host.rx[load] += self._rx_host[load]
        for sums in (self._tx_each, self._rx_host):
            sums[:] = [0] * len(Load)

    def _submessage(self, endpoint: Endpoint) -> int:
        info = endpoint.info
        shape = (endpoint.topic, endpoint.is_writer, endpoint.shape, len(info.user_data))
        size = self._sizes.get(shape)
        if size is None:
            size = self._sizes[shape] = submessage_bytes(info)
        return size

    def _spread(self, participant: Participant, size: int, *, writer: bool) -> None:
        """Account a change of endpoints: a heartbeat covers those of 100 ms, and all answer it."""
        if not self.others(participant):
            return
        self._to_all(participant, _DISCOVERY, size)
        now_ns = self._loop.now_ns
        if now_ns >= participant.heartbeat_until_ns[writer]:
            participant.heartbeat_until_ns[writer] = now_ns + HEARTBEAT_NS
            self._to_all(participant, _DISCOVERY_ACKS, HEARTBEAT_BYTES)
            self._from_all(participant, ACKNACK_BYTES)

    def _round(self) -> None:
        """Account that all members greet all others, as they do when somebody is new; once in 100 ms."""
        now_ns = self._loop.now_ns
        if now_ns < self._met_until_ns:
            return
        self._met_until_ns = now_ns + HEARTBEAT_NS
        for member in self._members:
            if self.others(member):
                self._to_all_hosts(member.host, _DISCOVERY_ACKS, HELLO_ROUND_BYTES)
                self._from_all(member, HELLO_ROUND_ACKS_BYTES)

    def _tick(self) -> None:
        """Account the periodic announcements since the last settlement, when the members were the same."""
        now_ns = self._loop.now_ns
        if now_ns == self._ticked_ns:
            return
        self._ticked_ns = now_ns
        for member in self._members:
            interval_ns = member.interval_ns
            ticks = (now_ns - member.born_ns) // interval_ns
            ticks -= (member.ticked_ns - member.born_ns) // interval_ns
            member.ticked_ns = now_ns
            if ticks and self.others(member):
                periodic = presentation_bytes(member.user_data) + LIVELINESS_BYTES
                self._to_all_hosts(member.host, _DISCOVERY, ticks * periodic)
                self._from_all(member, ticks * ACKNACK_BYTES)

    def _to_all(self, sender: Participant, load: Load, size: int) -> None:
        """Account what goes to all participants of other hosts."""
        if self._multicast:
            self._to_all_hosts(sender.host, load, size)
            return
        for member in self._hearers(sender):
            _unicast(sender.host, member.host, load, size)

    def _to_all_hosts(self, sender: Host, load: Load, size: int) -> None:
        """Account one packet that every other host receives."""
        sender.tx[load] += size
        if self.parted:
            for host in self._network.values():
                host.rx[load] += size if host is not sender and host.side == sender.side else 0
        else:
            self._rx_host[load] += size
            sender.rx[load] -= size

    def _from_all(self, receiver: Participant, size: int) -> None:
        """Account the answer of every participant of another host."""
        if self.parted:
            for member in self._hearers(receiver):
                _unicast(member.host, receiver.host, _DISCOVERY_ACKS, size)
        else:
            own = self._hosts[receiver.host]
            self._tx_each[_DISCOVERY_ACKS] += size
            receiver.host.tx[_DISCOVERY_ACKS] -= size * own
            receiver.host.rx[_DISCOVERY_ACKS] += size * (self._count - own)

    def _hearers(self, participant: Participant) -> list[Participant]:
        host = participant.host
        return [m for m in self._members if m.host is not host and m.host.side == host.side]


def _discovery_info(participant: Participant) -> list[int]:
    """Return the submessages of what a node of the ROS 2 graph has besides its endpoints."""
    return [DISCOVERY_INFO_BYTES] if participant.discovery_info else []


def _unicast(sender: Host, receiver: Host, load: Load, size: int) -> None:
    sender.tx[load] += size
    receiver.rx[load] += size
