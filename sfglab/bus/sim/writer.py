"""The simulated bus's writers: CDR in, and on its way to each reader that the writer knows."""

from __future__ import annotations

from collections import deque
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from sfglab.bus.errors import InvalidMessageError, MessageTooLargeError
from sfglab.bus.sim.audience import Audience
from sfglab.bus.sim.channel import Channel
from sfglab.bus.sim.endpoint import Endpoint, Item
from sfglab.bus.sim.loop import START_NS
from sfglab.bus.sim.wire import (
    data_bytes,
)
from sfglab.messages import CdrError, serialize
from sfglab.qos import Durability, History, Reliability

if TYPE_CHECKING:
    from collections.abc import Iterator

    from sfglab.bus.sim.participant import Participant
    from sfglab.bus.sim.reader import Reader


# A reader acknowledges at once what comes after so long a silence, and a burst once.
_QUIET_NS = 100_000_000


class Writer(Endpoint):
    """Sends samples to the readers that it knows.

    Args:
        options: As for `Endpoint`.
        limit_bytes: The longest sample over shared memory.

    Attributes:
        audience: The readers that it knows.
        reliable: Whether lost samples are repeated.
        depth: How many samples can be repeated; None is all.
        sequence: The number of the latest sample.
        lifespan_ns: After how long samples expire; None is never.
    """

    __slots__ = (
        "_acked_ns",
        "_channels",
        "_in_burst",
        "_kept",
        "_late",
        "_limit_bytes",
        "_routes",
        "_sent_ns",
        "audience",
        "depth",
        "lifespan_ns",
        "reliable",
        "sequence",
    )

    is_writer = True

    def __init__(self, *options: Any, limit_bytes: int | None = None, **more: Any) -> None:
        super().__init__(*options, **more)
        qos = self.info.qos
        self.audience = Audience(self.participant)
        self.reliable = qos.reliability is Reliability.RELIABLE
        self.depth = qos.depth if qos.history is History.KEEP_LAST else None
        self.lifespan_ns = qos.lifespan_ns
        self.sequence = 0
        self._limit_bytes = limit_bytes
        latched = qos.durability is Durability.TRANSIENT_LOCAL
        self._kept: deque[Item] | None = deque(maxlen=self.depth) if latched else None
        self._late: dict[Reader, list[Item]] = {}
        # By delay, the readers that samples reach so late; None when that has to be found out again.
        self._routes: dict[int, tuple[Reader, ...]] | None = {}
        self._channels: dict[tuple[Participant, bool], Channel] = {}
        self._sent_ns = -_QUIET_NS
        self._acked_ns = 0
        self._in_burst = False

    def write_message(self, message: Any) -> None:
        """Serialize and send."""
        self.forward(serialize(message))

    def write(self, cdr: Any, source_timestamp_ns: int | None = None) -> None:
        """Send serialized bytes.

        Raises:
            InvalidMessageError: They are no message of the topic's type; shared memory does not look.
            MessageTooLargeError: They are above the limit of a shared-memory publisher.
        """
        data = cdr if isinstance(cdr, bytes) else bytes(cdr)
        if self.info.transport == "dds":
            try:
                self._world.decoder(self.info.type)(data)
            except CdrError as error:
                raise InvalidMessageError(
                    self.info.topic, self.info.type, size_bytes=len(data), reason=error.reason
                ) from error
        self.forward(data, source_timestamp_ns)

    def forward(self, cdr: bytes, source_timestamp_ns: int | None = None) -> None:
        """Send bytes that are known to be a message.

        Raises:
            MessageTooLargeError: They are above the limit of a shared-memory publisher.
        """
        if self._limit_bytes is not None:
            self._check_size(len(cdr))
        now_ns = self._loop.now_ns
        self.sequence += 1
        item = (self.sequence, cdr, START_NS + now_ns if source_timestamp_ns is None else source_timestamp_ns)
        self.participant.last_sent_ns = now_ns
        if self._world.trace is not None:
            self._world.trace("send", self.gid, cdr)
        if self._kept is not None:
            self._kept.append(item)
        if self._late:
            for late in self._late.values():
                late.append(item)
        if self._routes is None:
            self._routes = self._find_routes()
        routes = self._routes if self._world.services is None else self._world.services.routes(self, cdr)
        for delay_ns, readers in (self._routes if routes is None else routes).items():
            self._loop.at(now_ns + delay_ns, self._world.network.deliver, self, readers, item)
            self._acked_ns = max(self._acked_ns, now_ns + 2 * delay_ns)
        if self.audience.remote and self.info.transport == "dds":
            self._transmit(item, now_ns)

    def wait_for_acks(self, _timeout_s: float) -> bool:
        """Return whether all reliable readers have everything; nothing can block here."""
        waiting = any(channel.reliable and channel.waiting for channel in self._channels.values())
        return not waiting and not self._late and self._loop.now_ns >= self._acked_ns

    @contextmanager
    def loan(self, size_bytes: int) -> Iterator[memoryview]:
        """Lend memory for a sample over shared memory; leaving sends it, an exception does not.

        Raises:
            TypeError: It does not go over shared memory.
            MessageTooLargeError: Above the limit.
        """
        if self._limit_bytes is None:
            raise TypeError(f"topic {self.info.topic!r}: only a publisher with transport='shm' lends memory")
        self._check_size(size_bytes)
        memory = bytearray(size_bytes)
        yield memoryview(memory)
        self.forward(bytes(memory))

    def learn(self, endpoint: Endpoint) -> None:
        """Send to a reader from now on; a late joiner hears the history first."""
        if not self.is_open or endpoint in self.peers:
            return
        reader: Reader = endpoint  # type: ignore[assignment]  # nothing else is on the other side
        self.peers[reader] = 0
        acknowledges = self.reliable and reader.reliable
        self.audience.add(reader, acknowledges=acknowledges)
        accounts = self.participant.domain.accounts
        if acknowledges and self.info.transport == "dds":
            accounts.matched(self.participant, reader.participant)
        if self._kept and reader.latched:
            self._late[reader] = list(self._kept)
            for _, cdr, _ in self._kept:
                accounts.history(self.participant, reader.participant, len(cdr))
            delay_ns = self._world.network.delay_ns(self, reader) + self._world.clockwork.history_ns
            self._loop.at(self._loop.now_ns + delay_ns, self._catch_up, reader)
        else:
            self._add_route(reader)
        self._notify()

    def forget(self, endpoint: Endpoint) -> None:
        """Send to a reader no more."""
        if endpoint in self.peers:
            self.audience.remove(endpoint)  # type: ignore[arg-type]  # it is a reader
            self._late.pop(endpoint, None)  # type: ignore[call-overload]
            self._routes = None
            if not self.audience.readers_of(endpoint.participant):
                for key in [key for key in self._channels if key[0] is endpoint.participant]:
                    self._channels.pop(key).end()
        super().forget(endpoint)

    def reroute(self) -> None:
        """Look again how samples get to the readers."""
        self._routes = None if self.is_open else {}

    def silence(self) -> None:
        """Let it send nothing more."""
        self.audience.settle()
        self.audience = Audience(self.participant)
        self._routes = {}
        self._late.clear()
        self._channels.clear()
        super().silence()

    def _catch_up(self, reader: Reader) -> None:
        items = self._late.pop(reader, None)
        if items is not None:
            self._add_route(reader)
            for item in items:
                reader.take(self, item)

    def _check_size(self, size_bytes: int) -> None:
        assert self._limit_bytes is not None
        if size_bytes > self._limit_bytes:
            raise MessageTooLargeError(self.info.topic, size_bytes=size_bytes, limit_bytes=self._limit_bytes)

    def _add_route(self, reader: Reader) -> None:
        network = self._world.network
        if self._routes is None or (network.varies and self._is_away(reader)):
            self._routes = None
        else:
            # A new tuple: what is on its way already is not for this reader.
            delay_ns = network.delay_ns(self, reader)
            self._routes[delay_ns] = (*self._routes.get(delay_ns, ()), reader)

    def _find_routes(self) -> dict[int, tuple[Reader, ...]]:
        """Group the readers by how long samples take to them; those on links that vary get channels."""
        network = self._world.network
        groups: dict[int, list[Reader]] = {}
        channels: dict[tuple[Participant, bool], Channel] = {}
        for reader in self.peers:
            if reader in self._late:
                continue
            if not (network.varies and self._is_away(reader)):
                groups.setdefault(network.delay_ns(self, reader), []).append(reader)
                continue
            key = (reader.participant, self.reliable and reader.reliable)
            if key not in channels:
                channels[key] = self._channels.get(key) or Channel(self, key[0], reliable=key[1])
                channels[key].readers = ()
            channels[key].readers += (reader,)
        self._channels = channels
        return {delay_ns: tuple(readers) for delay_ns, readers in groups.items()}

    def _is_away(self, reader: Reader) -> bool:
        return reader.participant.host is not self.participant.host

    def _transmit(self, item: Item, now_ns: int) -> None:
        """Put a sample on the network: into the books, and into the channels if links vary."""
        accounts = self.participant.domain.accounts
        size = data_bytes(len(item[1]), reliable=self.reliable)
        accounts.sample(self.participant, self.audience.remote, size)
        if self.reliable:
            quiet = now_ns - self._sent_ns >= _QUIET_NS
            if quiet or not self._in_burst:
                self.audience.acknowledge()
            self._in_burst = not quiet
            self._sent_ns = now_ns
        if self._channels:
            self._world.network.send(self, list(self._channels.values()), item, size)
