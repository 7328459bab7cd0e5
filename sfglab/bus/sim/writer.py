"""The simulated bus's writers: CDR in, and on its way to each reader that the writer knows."""

from __future__ import annotations

from collections import deque
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, cast

from sfglab.bus.errors import check_size, not_cdr_error
from sfglab.bus.sim.loop import START_NS
from sfglab.bus.sim.model import Endpoint, Item, Participant
from sfglab.bus.sim.network import Channel, Network, Reader, Services
from sfglab.bus.sim.settings import HISTORY_NS
from sfglab.bus.sim.wire import ACKNACK_BYTES, Load, data_bytes
from sfglab.messages import CdrError, serialize

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from sfglab.bus.sim.accounts import Accounts

# A reader acknowledges at once what comes after so long a silence, and a burst once.
_QUIET_NS = 100_000_000


class Audience:
    """The readers that a writer knows, by participant, and the ACKNACKs that they owe to the accounts.

    Those are accounted with the readers' hosts only when somebody asks or they leave, at a cost per host.
    """

    __slots__ = ("_owing", "_owner", "_readers", "_rounds", "remote")

    def __init__(self, owner: Participant) -> None:
        #: The participants on other hosts that have readers of it.
        self.remote: dict[Participant, None] = {}
        self._owner = owner
        self._readers: dict[Participant, list[Reader]] = {}
        self._owing: dict[Participant, int] = {}
        self._rounds = 0

    def add(self, reader: Reader, *, acknowledges: bool) -> None:
        """Take in a reader."""
        participant = reader.participant
        self._readers.setdefault(participant, []).append(reader)
        if participant.host is not self._owner.host:
            self.remote[participant] = None
            if acknowledges:
                self._owing.setdefault(participant, self._rounds)

    def remove(self, reader: Reader) -> None:
        """Let a reader go."""
        participant = reader.participant
        readers = self._readers[participant]
        readers.remove(reader)
        if not readers:
            del self._readers[participant]
            self.remote.pop(participant, None)
            self._pay(participant)
            self._owing.pop(participant, None)

    def readers_of(self, participant: Participant) -> tuple[Reader, ...]:
        """Return a participant's readers."""
        return tuple(self._readers.get(participant, ()))

    def acknowledge(self) -> None:
        """Account one ACKNACK from each reliable remote reader."""
        self._rounds += 1
        self._owner.host.rx[Load.ACKS] += ACKNACK_BYTES * len(self._owing)

    def settle(self) -> None:
        """Account with the readers' hosts what they have sent."""
        for participant in self._owing:
            self._pay(participant)

    def _pay(self, participant: Participant) -> None:
        since = self._owing.get(participant)
        if since is not None:
            participant.host.tx[Load.ACKS] += ACKNACK_BYTES * (self._rounds - since)
            self._owing[participant] = self._rounds


class Writer(Endpoint):
    """Sends samples to the readers that it knows, replies with `services` only to who asked; see `Endpoint`.

    `check` raises `CdrError` for bytes that are no message; `limit_bytes` bounds samples over shared memory.
    """

    __slots__ = (
        "_accounts",
        "_audience",
        "_channels",
        "_check",
        "_in_burst",
        "_kept",
        "_late",
        "_limit_bytes",
        "_network",
        "_routes",
        "_sent_ns",
        "_services",
    )

    is_writer = True

    def __init__(
        self,
        *options: Any,
        network: Network,
        accounts: Accounts,
        services: Services | None,
        check: Callable[[bytes], Any] | None = None,
        limit_bytes: int | None = None,
        **more: Any,
    ) -> None:
        super().__init__(*options, **more)
        self._audience = Audience(self.participant)
        self._network = network
        self._accounts = accounts
        self._services = services
        self._check = check
        self._limit_bytes = limit_bytes
        self._kept: deque[Item] | None = deque(maxlen=self.depth) if self.latched else None
        self._late: dict[Reader, list[Item]] = {}
        # By delay, the readers that samples reach so late; None when that has to be found out again.
        self._routes: dict[int, tuple[Reader, ...]] | None = {}
        self._channels: dict[tuple[Participant, bool], Channel] = {}
        self._sent_ns = -_QUIET_NS
        self._in_burst = False

    def write_message(self, message: Any) -> None:
        """Serialize and send."""
        self._forward(serialize(message))

    def write(self, cdr: Any, source_timestamp_ns: int | None = None) -> None:
        """Send serialized bytes; see `Publisher.publish_raw`."""
        data = cdr if isinstance(cdr, bytes) else bytes(cdr)
        if self._check is not None:
            try:
                self._check(data)
            except CdrError as error:
                topic, type_ = self.info.topic, self.info.type
                raise not_cdr_error(
                    topic, type_, size_bytes=len(data), reason=error.reason
                ) from error
        self._forward(data, source_timestamp_ns)

    @contextmanager
    def loan(self, size_bytes: int) -> Iterator[memoryview]:
        """Lend memory for a sample over shared memory; see `Publisher.loan`."""
        if self._limit_bytes is None:
            raise TypeError(
                f"topic {self.info.topic!r}: only a publisher with transport='shm' lends memory"
            )
        check_size(self.info.topic, size_bytes, self._limit_bytes)
        memory = bytearray(size_bytes)
        yield memoryview(memory)
        self._forward(bytes(memory))

    def learn(self, endpoint: Endpoint) -> None:
        """Send to a reader from now on; a late joiner hears the history first."""
        if not self.is_open or endpoint in self.peers:
            return
        reader = cast("Reader", endpoint)  # nothing else is on the other side
        self.peers[reader] = 0
        acknowledges = self.reliable and reader.reliable
        self._audience.add(reader, acknowledges=acknowledges)
        if acknowledges and self.info.transport == "dds":
            self._accounts.matched(self.participant, reader.participant)
        if self._kept and reader.latched:
            self._late[reader] = list(self._kept)
            for _, cdr, _ in self._kept:
                self._accounts.history(self.participant, reader.participant, len(cdr))
            delay_ns = self._network.delay_ns(self, reader) + HISTORY_NS
            self._loop.at(self._loop.now_ns + delay_ns, self._catch_up, reader)
        else:
            self._add_route(reader)
        self._notify()

    def forget(self, endpoint: Endpoint) -> None:
        """Send to a reader no more."""
        if endpoint in self.peers:
            reader = cast("Reader", endpoint)
            self._audience.remove(reader)
            self._late.pop(reader, None)
            self._routes = None
            if not self._audience.readers_of(endpoint.participant):
                for key in [key for key in self._channels if key[0] is endpoint.participant]:
                    self._channels.pop(key).end()
        super().forget(endpoint)

    def reroute(self) -> None:
        """Look again how samples get to the readers."""
        self._routes = None if self.is_open else {}

    def settle(self) -> None:
        """Account with the readers' hosts the ACKNACKs that they have sent."""
        self._audience.settle()

    def silence(self) -> None:
        """Let it send nothing more."""
        self._audience.settle()
        self._audience = Audience(self.participant)
        self._routes = {}
        self._late.clear()
        self._channels.clear()
        super().silence()

    def _forward(self, cdr: bytes, source_timestamp_ns: int | None = None) -> None:
        """Send bytes that are known to be a message."""
        if self._limit_bytes is not None:
            check_size(self.info.topic, len(cdr), self._limit_bytes)
        now_ns = self._loop.now_ns
        self.sequence += 1
        item = (
            self.sequence,
            cdr,
            START_NS + now_ns if source_timestamp_ns is None else source_timestamp_ns,
        )
        self.participant.last_sent_ns = now_ns
        if self._environment.trace is not None:
            self._environment.trace("send", self.gid, cdr)
        if self._kept is not None:
            self._kept.append(item)
        for late in self._late.values():
            late.append(item)
        for delay_ns, readers in self._ways(cdr).items():
            self._loop.at(now_ns + delay_ns, self._network.deliver, self, readers, item)
        if self._audience.remote and self.info.transport == "dds":
            self._transmit(item, now_ns)

    def _ways(self, cdr: bytes) -> dict[int, tuple[Reader, ...]]:
        """Return the readers of a sample by its delay, apart from those that channels lead to."""
        if self._routes is None:
            self._routes = self._find_routes()
        asker = None if self._services is None else self._services.asker(self, cdr)
        if asker is None:
            return self._routes
        readers = self._audience.readers_of(asker)
        self._charge_reply()
        return {self._network.delay_ns(self, readers[0]): readers} if readers else {}

    def _charge_reply(self) -> None:
        """Let a reply cost everybody on average what it costs those who ignore it."""
        cost_ns, domain = self._network.message_cost_ns, self.participant.domain
        if cost_ns and domain.members:
            share = (self.matched - 1) / len(domain.members)
            domain.crowd.occupy(self._loop.now_ns, round(share * cost_ns))

    def _catch_up(self, reader: Reader) -> None:
        items = self._late.pop(reader, None)
        if items is not None:
            self._add_route(reader)
            for item in items:
                reader.take(self, item)

    def _add_route(self, reader: Reader) -> None:
        if self._routes is None or (self._network.varies and self._is_away(reader)):
            self._routes = None
        else:
            # A new tuple: what is on its way already is not for this reader.
            delay_ns = self._network.delay_ns(self, reader)
            self._routes[delay_ns] = (*self._routes.get(delay_ns, ()), reader)

    def _find_routes(self) -> dict[int, tuple[Reader, ...]]:
        """Group the readers by how long samples take to them; those on links that vary get channels."""
        groups: dict[int, list[Reader]] = {}
        channels: dict[tuple[Participant, bool], Channel] = {}
        for reader in self.peers:
            if reader in self._late:
                continue
            if not (self._network.varies and self._is_away(reader)):
                groups.setdefault(self._network.delay_ns(self, reader), []).append(reader)
                continue
            key = (reader.participant, self.reliable and reader.reliable)
            if key not in channels:
                known = self._channels.get(key)
                channels[key] = known or Channel(self, key[0], self._accounts, reliable=key[1])
                channels[key].readers = ()
            channels[key].readers += (reader,)
        self._channels = channels
        return {delay_ns: tuple(readers) for delay_ns, readers in groups.items()}

    def _is_away(self, reader: Reader) -> bool:
        return reader.participant.host is not self.participant.host

    def _transmit(self, item: Item, now_ns: int) -> None:
        """Put a sample on the network: into the accounts, and into the channels if links vary."""
        size = data_bytes(len(item[1]), reliable=self.reliable)
        self._accounts.sample(self.participant, self._audience.remote, size)
        if self.reliable:
            quiet = now_ns - self._sent_ns >= _QUIET_NS
            if quiet or not self._in_burst:
                self._audience.acknowledge()
            self._in_burst = not quiet
            self._sent_ns = now_ns
        if self._channels:
            self._network.send(self, list(self._channels.values()), item, size)
