"""Writers and readers of a simulated domain, and the retransmission of lost samples."""

from __future__ import annotations

from collections import deque
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from sfglab.bus.errors import check_size, not_cdr_error
from sfglab.bus.sim.domain import Endpoint
from sfglab.bus.sim.loop import START_NS
from sfglab.bus.sim.network import frame_bytes
from sfglab.bus.sim.settings import HISTORY_NS, LOOPBACK_NS, REPAIR_NS, STACK_NS, ns_from_s
from sfglab.messages import CdrError, serialize

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator

    from sfglab.bus.endpoints import Inbox
    from sfglab.bus.sim.domain import Participant

#: Sample in transit: sequence number from 1, CDR, source time stamp (ns).
Item = tuple[int, bytes, int]


class Reader(Endpoint):
    """Reader that hands samples of known writers to an inbox, each writer's in order, and counts losses."""

    is_writer = False

    def __init__(self, *options: Any, inbox: Inbox, **more: Any) -> None:
        super().__init__(*options, **more)
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
        """Stop taking samples of a writer."""
        if endpoint in self.peers:
            self._inbox.on_life(endpoint.gid, False)
        super().forget(endpoint)

    def take(self, writer: Writer, item: Item) -> None:
        """Take a sample that has arrived."""
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
        now_ns = START_NS + self._loop.now_ns
        lifespan_ns = writer.info.qos.lifespan_ns
        if lifespan_ns is None or now_ns - stamp_ns <= lifespan_ns:
            self._inbox.push((cdr, stamp_ns, now_ns, writer.gid))

    def receive(self, writer: Writer, item: Item) -> None:
        """Take a sample that has arrived as soon as the process has time for it."""
        message_ns = ns_from_s(self._network.costs.message_s)
        if not message_ns:
            self.take(writer, item)
            return
        start_ns = max(self._loop.now_ns, self.participant.domain.backlog.free_ns)
        done_ns = self.participant.process.occupy(start_ns, message_ns)
        self._loop.at(done_ns, self.take, writer, item)

    def silence(self) -> None:
        """Stop taking samples, and drop early ones."""
        super().silence()
        self._early.clear()


@dataclass(eq=False, slots=True)
class _Pending:
    """Sample that a channel has not delivered yet."""

    item: Item
    readers: list[Reader]
    size_bytes: int
    #: None while the sample is in transit, True once it arrived, False once it was given up.
    has_arrived: bool | None = None


class Channel:
    """Path of a reliable writer's samples to a participant on another host: in order, with retransmission."""

    def __init__(self, writer: Writer, target: Participant) -> None:
        self.pending: deque[_Pending] = deque()  #: Lost samples, and samples that wait behind them.
        self._writer = writer
        self._target = target
        self._network = writer.participant.domain.network
        self._loop = self._network.loop

    def add(self, sample: _Pending, arrival_ns: int | None) -> None:
        """Deliver a sample behind earlier ones; without an arrival time it is lost."""
        self.pending.append(sample)
        self._follow(sample, arrival_ns)

    def _follow(self, sample: _Pending, arrival_ns: int | None) -> None:
        if arrival_ns is None:
            self._loop.at(self._loop.now_ns + REPAIR_NS, self._repeat, sample)
        else:
            self._loop.at(arrival_ns, self._settle, sample, True)

    def _repeat(self, sample: _Pending) -> None:
        writer = self._writer
        is_evicted = writer.depth is not None and writer.sequence - sample.item[0] >= writer.depth
        if is_evicted or not writer.is_open:
            self._settle(sample, False)
        elif sample in self.pending:
            source, size_bytes = writer.participant.host, sample.size_bytes
            sent_ns = self._network.depart(source, size_bytes)
            arrival_ns = self._network.arrive(sent_ns, source, self._target.host, size_bytes)
            self._follow(sample, arrival_ns)

    def _settle(self, sample: _Pending, has_arrived: bool) -> None:  # noqa: FBT001 - the loop passes it so
        sample.has_arrived = has_arrived
        while self.pending and self.pending[0].has_arrived is not None:
            first = self.pending.popleft()
            if first.has_arrived:
                _deliver(self._writer, first.readers, first.item)


class Writer(Endpoint):
    """Writer that sends CDR to every known reader; a late TRANSIENT_LOCAL reader receives the history first."""

    is_writer = True

    def __init__(
        self,
        *options: Any,
        check: Callable[[bytes], Any] | None,
        limit_bytes: int | None,
        **more: Any,
    ) -> None:
        super().__init__(*options, **more)
        self.sequence = 0  #: Sequence number of the latest sample.
        self._check = check
        self._limit_bytes = limit_bytes
        self._kept: deque[Item] = deque(maxlen=self.depth if self.latched else 0)
        self._late: dict[Reader, list[Item]] = {}
        self._channels: dict[Participant, Channel] = {}

    def write_message(self, message: Any) -> None:
        """Serialize and send a message."""
        self._send(serialize(message))

    def write(self, cdr: Any, source_timestamp_ns: int | None = None) -> None:
        """Send serialized bytes; see `Publisher.publish_raw`."""
        data = bytes(cdr)
        if self._check is not None:
            try:
                self._check(data)
            except CdrError as error:
                topic, type_ = self.info.topic, self.info.type
                reason = error.reason
                raise not_cdr_error(topic, type_, size_bytes=len(data), reason=reason) from error
        self._send(data, source_timestamp_ns)

    @contextmanager
    def loan(self, size_bytes: int) -> Iterator[memoryview]:
        """Lend memory for a sample over shared memory; see `Publisher.loan`."""
        topic = self.info.topic
        if self._limit_bytes is None:
            raise TypeError(f"topic {topic!r}: only a publisher with transport='shm' lends memory")
        check_size(topic, size_bytes, self._limit_bytes)
        memory = bytearray(size_bytes)
        yield memoryview(memory)
        self._send(bytes(memory))

    def learn(self, endpoint: Reader) -> None:
        """Send to a reader from now on."""
        if not self.is_open or endpoint in self.peers:
            return
        self.peers[endpoint] = 0
        if self._kept and endpoint.latched:
            self._late[endpoint] = list(self._kept)
            delay_ns = self._delay_ns(endpoint) + HISTORY_NS
            self._loop.at(self._loop.now_ns + delay_ns, self._catch_up, endpoint)
        self._notify()

    def forget(self, endpoint: Endpoint) -> None:
        """Stop sending to a reader."""
        super().forget(endpoint)
        self._late.pop(endpoint, None)  # type: ignore[call-overload]  # harmless for a writer
        target = endpoint.participant
        if target in self._channels and not any(r.participant is target for r in self.peers):
            self._channels.pop(target).pending.clear()

    def silence(self) -> None:
        """Stop sending."""
        super().silence()
        self._late.clear()

    def _delay_ns(self, reader: Reader) -> int:
        source, target = self.participant.host, reader.participant.host
        if source is target:
            return LOOPBACK_NS
        return source.latency_ns + target.latency_ns + STACK_NS

    def _catch_up(self, reader: Reader) -> None:
        for item in self._late.pop(reader, ()):
            reader.take(self, item)

    def _send(self, cdr: bytes, source_timestamp_ns: int | None = None) -> None:
        """Send bytes that are known to be a message."""
        if self._limit_bytes is not None:
            check_size(self.info.topic, len(cdr), self._limit_bytes)
        now_ns = self._loop.now_ns
        stamp_ns = START_NS + now_ns if source_timestamp_ns is None else source_timestamp_ns
        self.sequence += 1
        item = (self.sequence, cdr, stamp_ns)
        self.participant.last_sent_ns = now_ns
        self._kept.append(item)
        near: list[Reader] = []
        far: dict[tuple[Participant, bool], list[Reader]] = {}
        for reader in self.peers:
            if reader in self._late:
                self._late[reader].append(item)
            elif reader.participant.host is self.participant.host:
                near.append(reader)
            else:
                reliable = self.reliable and reader.reliable
                far.setdefault((reader.participant, reliable), []).append(reader)
        if near:
            self._loop.at(now_ns + LOOPBACK_NS, _deliver, self, near, item)
        if far:
            self._send_far(item, far)

    def _send_far(self, item: Item, far: dict[tuple[Participant, bool], list[Reader]]) -> None:
        """Send one packet to all participants on other hosts; simultaneous arrivals are one event."""
        source = self.participant.host
        size_bytes = frame_bytes(len(item[1]), reliable=self.reliable)
        sent_ns = self._network.depart(source, size_bytes)
        groups: dict[int, list[Reader]] = {}
        for (target, reliable), readers in far.items():
            arrival_ns = self._network.arrive(sent_ns, source, target.host, size_bytes)
            channel = self._channels.get(target) if reliable else None
            if reliable and (arrival_ns is None or (channel and channel.pending)):
                channel = self._channels.setdefault(target, channel or Channel(self, target))
                channel.add(_Pending(item, readers, size_bytes), arrival_ns)
            elif arrival_ns is not None:
                groups.setdefault(arrival_ns, []).extend(readers)
        for arrival_ns, readers in groups.items():
            self._loop.at(arrival_ns, _deliver, self, readers, item)


def _deliver(writer: Writer, readers: Iterable[Reader], item: Item) -> None:
    for reader in readers:
        reader.receive(writer, item)
