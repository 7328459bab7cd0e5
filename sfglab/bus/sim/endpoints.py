"""Writers and readers of a simulated domain."""

from __future__ import annotations

from collections import deque
from typing import TYPE_CHECKING, Any

from sfglab.bus.api import EndpointKind
from sfglab.bus.sim.domain import Endpoint
from sfglab.bus.sim.loop import START_NS
from sfglab.bus.sim.settings import HISTORY_NS, STACK_NS, ns_from_s
from sfglab.messages import serialize

if TYPE_CHECKING:
    from collections.abc import Iterable

    from sfglab.bus.endpoints import Inbox
    from sfglab.bus.sim.domain import Participant

#: Sample in transit: sequence number from 1, CDR, source time stamp (ns).
Item = tuple[int, bytes, int]


class Reader(Endpoint):
    """Reader that hands samples of known writers to an inbox, each writer's in order, and counts losses."""

    kind = EndpointKind.SUBSCRIPTION

    def __init__(self, *options: Any, inbox: Inbox) -> None:
        super().__init__(*options)
        self.lost = 0  #: Number of samples known to be missing between those that arrived.
        self._inbox = inbox
        self._early: dict[Endpoint, list[Item]] = {}

    def learn(self, endpoint: Writer) -> None:
        """Take a writer's samples from now on, first those that arrived too early."""
        if not self.is_open or endpoint in self.peers:
            return
        self.peers[endpoint] = 0
        for item in self._early.pop(endpoint, ()):
            self.take(endpoint, item)
        self._inbox.on_life(endpoint.gid, True)
        self._notify()

    def forget(self, endpoint: Endpoint) -> None:
        """Stop accepting samples of a writer, and report its loss to the inbox."""
        if endpoint in self.peers:
            self._inbox.on_life(endpoint.gid, False)
        super().forget(endpoint)

    def take(self, writer: Writer, item: Item) -> None:
        """Put an arrived sample of a matching writer into the inbox, and count the samples missing before it."""
        if not self.is_open:
            return
        sequence, cdr, stamp_ns = item
        latest = self.peers.get(writer)
        if latest is None:
            # A reliable writer retransmits to a reader that has not discovered it yet; other writers do not.
            if self.reliable and writer.reliable and writer.is_open:
                self._early.setdefault(writer, []).append(item)
            return
        if sequence <= latest:
            return
        if latest:
            self.lost += sequence - latest - 1
        self.peers[writer] = sequence
        self._inbox.push((cdr, stamp_ns, START_NS + self._loop.now_ns, writer.gid))

    def receive(self, writer: Writer, item: Item) -> None:
        """Take a sample that has arrived, as soon as the process has time for it."""
        domain = self.participant.domain
        message_ns = ns_from_s(domain.costs.message_s)
        if not message_ns:
            self.take(writer, item)
            return
        start_ns = max(self._loop.now_ns, domain.backlog.free_ns)
        done_ns = self.participant.process.occupy(start_ns, message_ns)
        self._loop.at(done_ns, self.take, writer, item)

    def silence(self) -> None:
        """Stop receiving without notice to others, and drop the samples of undiscovered writers."""
        super().silence()
        self._early.clear()


class Writer(Endpoint):
    """Writer that sends CDR to every known reader; a late TRANSIENT_LOCAL reader receives the history first."""

    kind = EndpointKind.PUBLISHER

    def __init__(self, *options: Any) -> None:
        super().__init__(*options)
        self.sequence = 0  #: Sequence number of the latest sample.
        # Samples for late TRANSIENT_LOCAL readers, or those that a disconnected reader has missed.
        self._kept: deque[Item] = deque(maxlen=self.depth if self.reliable or self.latched else 0)
        self._late: dict[Reader, list[Item]] = {}

    def write_message(self, message: Any) -> None:
        """Serialize a ROS message to CDR and send it."""
        self.write(serialize(message))

    def learn(self, endpoint: Reader) -> None:
        """Send samples to a reader from now on, after the history if the reader is TRANSIENT_LOCAL."""
        if not self.is_open or endpoint in self.peers:
            return
        self.peers[endpoint] = self.sequence
        if self._kept and endpoint.latched:
            self._late[endpoint] = list(self._kept)
            delay_ns = self._delay_ns(endpoint) + HISTORY_NS
            self._loop.at(self._loop.now_ns + delay_ns, self._catch_up, endpoint)
        self._notify()

    def forget(self, endpoint: Endpoint) -> None:
        """Stop sending samples to a reader."""
        super().forget(endpoint)
        self._late.pop(endpoint, None)  # type: ignore[call-overload]  # harmless for a writer

    def silence(self) -> None:
        """Stop sending without notice to others, also the history to late readers."""
        super().silence()
        self._late.clear()

    def repair(self, participant: Participant) -> None:
        """Send kept samples to a participant's reliable readers, from the first that was not sent to them."""
        for reader, latest in self.peers.items():
            if reader.participant is participant and self._retransmits_to(reader):
                time_ns = self._loop.now_ns + self._delay_ns(reader)
                for item in self._kept:
                    if item[0] > latest:
                        self._loop.at(time_ns, reader.receive, self, item)
                self.peers[reader] = self.sequence

    def write(self, cdr: Any, source_timestamp_ns: int | None = None) -> None:
        """Send serialized bytes, which are not checked; see `Publisher.publish_raw`."""
        now_ns = self._loop.now_ns
        stamp_ns = START_NS + now_ns if source_timestamp_ns is None else source_timestamp_ns
        self.sequence += 1
        item = (self.sequence, bytes(cdr), stamp_ns)
        host = self.participant.host
        groups: dict[int, list[Reader]] = {}
        is_needed = self.latched
        for reader in self.peers:
            if reader in self._late:
                self._late[reader].append(item)
            elif host.can_reach(reader.participant.host):
                groups.setdefault(self._delay_ns(reader), []).append(reader)
            else:
                is_needed |= self._retransmits_to(reader)
                continue
            self.peers[reader] = self.sequence
        if is_needed:
            self._kept.append(item)
        else:
            self._kept.clear()
        for delay_ns, readers in groups.items():
            self._loop.at(now_ns + delay_ns, self._deliver, readers, item)

    def _retransmits_to(self, reader: Reader) -> bool:
        return self.reliable and reader.reliable

    def _delay_ns(self, reader: Reader) -> int:
        return self.participant.host.delay_ns(reader.participant.host, STACK_NS)

    def _catch_up(self, reader: Reader) -> None:
        for item in self._late.pop(reader, ()):
            reader.take(self, item)

    def _deliver(self, readers: Iterable[Reader], item: Item) -> None:
        for reader in readers:
            reader.receive(self, item)
