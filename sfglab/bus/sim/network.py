"""A simulated network at work: readers, channels between hosts, links with queues, jitter and loss, repair."""

from __future__ import annotations

from collections import deque
from typing import TYPE_CHECKING, Any

from sfglab.bus.sim.loop import START_NS, VirtualLoop
from sfglab.bus.sim.model import Domain, Endpoint, Host, Item, Participant
from sfglab.bus.sim.settings import (
    ENDPOINT_NS,
    REPAIR_NS,
    SAME_HOST_NS,
    SAME_NODE_NS,
    STACK_NS,
    ns_from_s,
)
from sfglab.units import BITS_PER_BYTE

if TYPE_CHECKING:
    from collections.abc import Callable
    from random import Random

    from sfglab.bus.endpoints import Sample
    from sfglab.bus.sim.accounts import Accounts
    from sfglab.bus.sim.settings import Costs, LinkModel

# Behind the 4 bytes of encapsulation: the client's GUID and the request's number (`frame_service`).
_FRAME_HEADER = slice(4, 20)


class Reader(Endpoint):
    """Hands samples of known writers to `push`, each writer's in order, and counts those that were lost."""

    __slots__ = ("_early", "_push", "lost")

    is_writer = False

    def __init__(self, *options: Any, push: Callable[[Sample], None], **more: Any) -> None:
        super().__init__(*options, **more)
        self.lost = 0  #: Samples known to be missing between those that arrived.
        self._push = push
        self._early: dict[Endpoint, list[Item]] | None = None

    def learn(self, endpoint: Endpoint) -> None:
        """Take a writer's samples from now on, those first that were too early."""
        if not self.is_open or endpoint in self.peers:
            return
        self.peers[endpoint] = 0
        if self._early:
            for item in self._early.pop(endpoint, ()):
                self.take(endpoint, item)
        self._notify()

    def take(self, writer: Endpoint, item: Item) -> None:
        """Take a sample that has arrived."""
        if not self.is_open:
            return
        sequence, cdr, stamp_ns = item
        latest = self.peers.get(writer)
        if latest is None:
            # A reliable writer repeats to a reader that has yet to hear of it; the others do not.
            if self.reliable and writer.reliable and writer.is_open:
                self._early = self._early or {}
                self._early.setdefault(writer, []).append(item)
            return
        if sequence <= latest:
            return
        if latest and sequence > latest + 1:
            self.lost += sequence - latest - 1
        self.peers[writer] = sequence
        now_ns = START_NS + self._loop.now_ns
        if writer.lifespan_ns is not None and now_ns - stamp_ns > writer.lifespan_ns:
            return
        if self._environment.trace is not None:
            self._environment.trace("take", self.gid, cdr)
        self._push((cdr, stamp_ns, now_ns, writer.gid))

    def silence(self) -> None:
        """Let it take nothing more."""
        super().silence()
        self._early = None


class _Entry:
    """A sample that a reliable channel has not delivered yet: arrived, or given up, or still on its way."""

    __slots__ = ("item", "readers", "state")

    def __init__(self, item: Item, readers: tuple[Reader, ...]) -> None:
        self.item = item
        self.readers = readers
        self.state: bool | None = None


class Channel:
    """The way of a writer's samples to one participant elsewhere, in order; reliable ones are repeated."""

    def __init__(
        self, writer: Endpoint, target: Participant, accounts: Accounts, *, reliable: bool
    ) -> None:
        self.writer = writer
        self.target = target
        self.accounts = accounts
        self.reliable = reliable
        self.readers: tuple[Reader, ...] = ()  #: The writer's readers there.
        self.latest_ns = 0  #: When the latest sample so far arrives: none overtakes it.
        self.ended = False  #: Whether it is over.
        self._entries: deque[_Entry] = deque()

    def add(self, item: Item) -> _Entry:
        """Let a sample take its place behind those that are on their way."""
        entry = _Entry(item, self.readers)
        self._entries.append(entry)
        return entry

    def evicted(self, item: Item) -> bool:
        """Return whether the writer cannot repeat a sample any more."""
        depth = self.writer.depth
        is_pushed_out = depth is not None and self.writer.sequence - item[0] >= depth
        return self.ended or not self.writer.is_open or is_pushed_out

    def end(self) -> None:
        """Give up what is on its way: the readers are not known any more."""
        self._entries.clear()
        self.ended = True

    def settle(self, entry: _Entry, *, arrived: bool) -> list[_Entry]:
        """Take note of a sample's fate; return the samples that can be delivered now."""
        if self.ended:
            return []
        entry.state = arrived
        ready = []
        while self._entries and self._entries[0].state is not None:
            done = self._entries.popleft()
            if done.state:
                ready.append(done)
        return ready


class Network:
    """Delivers samples; chance decides what is lost and what is late."""

    def __init__(self, loop: VirtualLoop, costs: Costs, random: Random) -> None:
        #: Whether two packets may fare differently, so that each has to be looked at.
        self.varies = False
        self.latency_ns = 0  #: Of the slowest link so far.
        #: What a sample costs the process that takes it.
        self.message_cost_ns = ns_from_s(costs.message_s)
        self._loop = loop
        self._random = random

    def note(self, link: LinkModel) -> None:
        """Take note that there is such a link."""
        self.varies |= link.varies
        self.latency_ns = max(self.latency_ns, ns_from_s(link.latency_s))

    def delay_ns(self, writer: Endpoint, reader: Endpoint) -> int:
        """Return how long a sample takes where nothing varies."""
        source, target = writer.participant, reader.participant
        if source is target:
            return SAME_NODE_NS
        if source.host is target.host:
            return SAME_HOST_NS
        return source.host.latency_ns + target.host.latency_ns + STACK_NS

    @property
    def slowest_ns(self) -> int:
        """How long news take at most, all but certainly."""
        lossy = 20 * REPAIR_NS if self.varies else 0
        return 2 * self.latency_ns + ENDPOINT_NS + SAME_HOST_NS + lossy

    def deliver(self, writer: Endpoint, readers: tuple[Reader, ...], item: Item) -> None:
        """Hand an arrived sample to readers, as soon as their processes have time for it."""
        cost_ns = self.message_cost_ns
        if not cost_ns:
            for reader in readers:
                reader.take(writer, item)
            return
        for reader in readers:
            process, crowd = reader.participant.process, reader.participant.domain.crowd
            process.occupy(max(self._loop.now_ns, crowd.free_ns), cost_ns)
            self._loop.at(process.free_ns, reader.take, writer, item)

    def send(self, writer: Endpoint, channels: list[Channel], item: Item, size: int) -> None:
        """Send one packet to all channels, or one to each where there is no multicast."""
        source = writer.participant.host
        sent_ns = self._depart(source, size)
        lost = self._loses(source)
        for channel in channels:
            entry = channel.add(item) if channel.reliable else None
            self._carry(channel, item, entry, sent_ns if not lost else None, size)

    def _carry(
        self, channel: Channel, item: Item, entry: _Entry | None, sent_ns: int | None, size: int
    ) -> None:
        """Let a packet arrive, or be lost and, of a reliable channel, be repeated."""
        source, target = channel.writer.participant.host, channel.target.host
        if sent_ns is None or source.side != target.side or self._loses(target):
            if entry is not None:
                self._loop.at(self._loop.now_ns + REPAIR_NS, self._repeat, channel, entry, size)
            return
        delay_ns = source.latency_ns + target.latency_ns + STACK_NS
        arrived_ns = sent_ns + delay_ns + self._jitter_ns(source) + self._jitter_ns(target)
        channel.latest_ns = max(channel.latest_ns, self._arrive(target, arrived_ns, size))
        if entry is None:
            self._loop.at(channel.latest_ns, self.deliver, channel.writer, channel.readers, item)
        else:
            self._loop.at(channel.latest_ns, self._settle, channel, entry, True)

    def _repeat(self, channel: Channel, entry: _Entry, size: int) -> None:
        if channel.evicted(entry.item):
            self._settle(channel, entry, False)
            return
        sender = channel.writer.participant
        sent_ns = self._depart(sender.host, size)
        channel.accounts.sample(sender, {channel.target: None}, size)
        self._carry(channel, entry.item, entry, None if self._loses(sender.host) else sent_ns, size)

    def _settle(self, channel: Channel, entry: _Entry, arrived: bool) -> None:  # noqa: FBT001 - scheduled so
        for ready in channel.settle(entry, arrived=arrived):
            self.deliver(channel.writer, ready.readers, ready.item)

    def _depart(self, host: Host, size: int) -> int:
        """Return when a packet has left its host."""
        now_ns = self._loop.now_ns
        if host.link.rate_bps is None:
            return now_ns
        host.tx_free_ns = max(host.tx_free_ns, now_ns) + ns_from_s(
            BITS_PER_BYTE * size / host.link.rate_bps
        )
        return host.tx_free_ns

    def _arrive(self, host: Host, time_ns: int, size: int) -> int:
        """Return when a packet that reaches a host's link at `time_ns` has come in."""
        if host.link.rate_bps is None:
            return time_ns
        host.rx_free_ns = max(host.rx_free_ns, time_ns) + ns_from_s(
            BITS_PER_BYTE * size / host.link.rate_bps
        )
        return host.rx_free_ns

    def _loses(self, host: Host) -> bool:
        return host.link.loss > 0 and self._random.random() < host.link.loss

    def _jitter_ns(self, host: Host) -> int:
        return ns_from_s(self._random.random() * host.link.jitter_s) if host.link.jitter_s else 0


class Services:
    """Remembers who sent which request, to hand the reply only to the participant that waits for it.

    DDS gives replies to all n clients of each of n services: n**3 deliveries, which nobody needs to simulate.
    """

    def __init__(self) -> None:
        self._askers: dict[tuple[Domain, bytes], Participant] = {}

    def asker(self, writer: Endpoint, cdr: bytes) -> Participant | None:
        """Take note of a request, or return whose a reply is; None: it is a sample for all."""
        domain, topic = writer.participant.domain, writer.info.dds_topic
        if topic.startswith("rq/"):
            self._askers[domain, cdr[_FRAME_HEADER]] = writer.participant
        elif topic.startswith("rr/"):
            return self._askers.pop((domain, cdr[_FRAME_HEADER]), None)
        return None
