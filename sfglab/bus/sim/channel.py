"""How samples travel between hosts: queues before links of limited rate, jitter, loss and repair."""

from __future__ import annotations

from collections import deque
from typing import TYPE_CHECKING

from sfglab.bus.sim.clockwork import ns_from_s

if TYPE_CHECKING:
    from random import Random

    from sfglab.bus.sim.clockwork import Clockwork
    from sfglab.bus.sim.endpoint import Item
    from sfglab.bus.sim.link import LinkModel
    from sfglab.bus.sim.loop import VirtualLoop
    from sfglab.bus.sim.participant import Host, Participant
    from sfglab.bus.sim.reader import Reader
    from sfglab.bus.sim.writer import Writer


class _Entry:
    """A sample that a reliable channel has not delivered yet: arrived, or given up, or still on its way."""

    __slots__ = ("item", "readers", "state")

    def __init__(self, item: Item, readers: tuple[Reader, ...]) -> None:
        self.item = item
        self.readers = readers
        self.state: bool | None = None


class Channel:
    """The way of one writer's samples to one participant on another host, in their order.

    Args:
        writer: Where samples come from.
        target: Where they go to.
        reliable: Whether what is lost is repeated, for as long as the writer's history holds it.

    Attributes:
        readers: The writer's readers there.
        latest_ns: When the latest sample so far arrives: none overtakes it.
        ended: Whether it is over.
    """

    def __init__(self, writer: Writer, target: Participant, *, reliable: bool) -> None:
        self.writer = writer
        self.target = target
        self.reliable = reliable
        self.readers: tuple[Reader, ...] = ()
        self.latest_ns = 0
        self.ended = False
        self._entries: deque[_Entry] = deque()

    @property
    def waiting(self) -> bool:
        """Whether something is on its way."""
        return bool(self._entries)

    def add(self, item: Item) -> _Entry:
        """Let a sample take its place behind those that are on their way."""
        entry = _Entry(item, self.readers)
        self._entries.append(entry)
        return entry

    def evicted(self, item: Item) -> bool:
        """Return whether the writer cannot repeat a sample any more."""
        depth = self.writer.depth
        return (
            self.ended
            or not self.writer.is_open
            or (depth is not None and self.writer.sequence - item[0] >= depth)
        )

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
    """Delivers samples.

    Args:
        loop: Whose time it is.
        clockwork: How long what takes.
        random: Decides what is lost and what is late.

    Attributes:
        varies: Whether two packets may fare differently, so that each has to be looked at.
        message_cost_ns: What a sample costs the process that takes it.
        latency_ns: Of the slowest link so far.
    """

    def __init__(self, loop: VirtualLoop, clockwork: Clockwork, random: Random) -> None:
        self.varies = False
        self._loop = loop
        self._clockwork = clockwork
        self._random = random
        self.latency_ns = 0
        self.message_cost_ns = clockwork.message_cost_ns

    def note(self, link: LinkModel) -> None:
        """Take note that there is such a link."""
        self.varies |= link.varies
        self.latency_ns = max(self.latency_ns, ns_from_s(link.latency_s))

    def delay_ns(self, writer: Writer, reader: Reader) -> int:
        """Return how long a sample takes where nothing varies."""
        source, target = writer.participant, reader.participant
        if source is target:
            return self._clockwork.same_node_ns
        if source.host is target.host:
            return self._clockwork.same_host_ns
        return source.host.latency_ns + target.host.latency_ns + self._clockwork.stack_ns

    @property
    def slowest_ns(self) -> int:
        """How long news take at most, all but certainly."""
        lossy = 20 * self._clockwork.repair_ns if self.varies else 0
        return 2 * self.latency_ns + self._clockwork.endpoint_ns + self._clockwork.same_host_ns + lossy

    def deliver(self, writer: Writer, readers: tuple[Reader, ...], item: Item) -> None:
        """Hand an arrived sample to readers, as soon as their processes have time for it."""
        cost_ns = self.message_cost_ns
        if not cost_ns:
            for reader in readers:
                reader.take(writer, item)
            return
        for reader in readers:
            participant = reader.participant
            process, crowd = participant.process, participant.domain.crowd
            process.occupy(max(self._loop.now_ns, crowd.free_ns), cost_ns)
            self._loop.at(process.free_ns, reader.take, writer, item)

    def send(self, writer: Writer, channels: list[Channel], item: Item, size: int) -> None:
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
                again_ns = self._loop.now_ns + self._clockwork.repair_ns
                self._loop.at(again_ns, self._repeat, channel, entry, size)
            return
        delay_ns = source.latency_ns + target.latency_ns + self._clockwork.stack_ns
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
        writer = channel.writer
        source = writer.participant.host
        sent_ns = self._depart(source, size)
        writer.participant.domain.accounts.sample(writer.participant, {channel.target: None}, size)
        self._carry(channel, entry.item, entry, None if self._loses(source) else sent_ns, size)

    def _settle(self, channel: Channel, entry: _Entry, arrived: bool) -> None:  # noqa: FBT001 - scheduled so
        for ready in channel.settle(entry, arrived=arrived):
            self.deliver(channel.writer, ready.readers, ready.item)

    def _depart(self, host: Host, size: int) -> int:
        """Return when a packet has left its host."""
        now_ns = self._loop.now_ns
        if host.link.rate_bps is None:
            return now_ns
        host.tx_free_ns = max(host.tx_free_ns, now_ns) + ns_from_s(8 * size / host.link.rate_bps)
        return host.tx_free_ns

    def _arrive(self, host: Host, time_ns: int, size: int) -> int:
        """Return when a packet that reaches a host's link at `time_ns` has come in."""
        if host.link.rate_bps is None:
            return time_ns
        host.rx_free_ns = max(host.rx_free_ns, time_ns) + ns_from_s(8 * size / host.link.rate_bps)
        return host.rx_free_ns

    def _loses(self, host: Host) -> bool:
        return host.link.loss > 0 and self._random.random() < host.link.loss

    def _jitter_ns(self, host: Host) -> int:
        return ns_from_s(self._random.random() * host.link.jitter_s) if host.link.jitter_s else 0
