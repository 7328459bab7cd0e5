"""Actions of a router when endpoints come and go: what it opens and closes.

The module is pure: it takes events of the graphs of both domains and the time, and returns actions.
`sfglab.fleet.policy` decides what has to be open. An endpoint that has gone counts for a while longer, so
that a restart does not close its path. Routers do not loop: in the agent's domain no router's endpoints
count, and in the global domain none of routers of the same agent's domain. A client's requests wait for the
path of their replies (`Replies`).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from itertools import takewhile
from typing import TYPE_CHECKING, NamedTuple

from sfglab.bus.api import EndpointAdded, EndpointEvent, EndpointInfo, EndpointKind, entries
from sfglab.fleet.policy import (
    Held,
    Path,
    PathState,
    Policy,
    ReaderSpec,
    Setup,
    Side,
    WriterSpec,
    wanted,
)
from sfglab.names import DdsRole, ros_name_from_dds

if TYPE_CHECKING:
    from collections.abc import Iterable


REPLY_READER_TIMEOUT_NS = 2_000_000_000
"""Longest wait of requests for a reply reader, ns; it covers several retransmissions of a lost discovery
message."""

# rmw_cyclonedds names the client on both endpoints: a participant may have several clients of a service.
_CLIENT_KEY = "clientid"


class _Asker(NamedTuple):
    """A client of a service. Its writer and its reader are in the same domain, so on paths of both directions."""

    service: str
    outward: bool
    client: str


class Replies:
    """Clients whose reply readers are known, and request writers that wait for one."""

    def __init__(self) -> None:
        self._listening: dict[_Asker, set[bytes]] = {}
        self._waiting: dict[_Asker, set[bytes]] = {}
        self._since: dict[bytes, tuple[int, _Asker, Path]] = {}

    @property
    def deadline_ns(self) -> int | None:
        """Time at which `overdue` returns something, ns on the caller's clock; None while nothing waits."""
        return next((deadline_ns for deadline_ns, _, _ in self._since.values()), None)

    def must_wait_for_reply_reader(self, path: Path, writer: EndpointInfo, *, now_ns: int) -> bool:
        """Return whether a new publisher's samples have to wait, until `opened` or `overdue` returns it."""
        asker = _asker(path, writer, DdsRole.REQUEST)
        if asker is None or asker in self._listening:
            return False
        self._since.pop(writer.gid, None)
        self._waiting.setdefault(asker, set()).add(writer.gid)
        self._since[writer.gid] = (now_ns + REPLY_READER_TIMEOUT_NS, asker, path)
        return True

    def opened(self, path: Path, reader: EndpointInfo) -> list[tuple[Path, bytes]]:
        """Process a new subscription; return the path and GID of each publisher that no longer has to wait."""
        asker = _asker(path, reader, DdsRole.REPLY)
        if asker is None:
            return []
        self._listening.setdefault(asker, set()).add(reader.gid)
        return [self._released(gid) for gid in sorted(self._waiting.get(asker, ()))]

    def closed(self, path: Path, endpoint: EndpointInfo) -> None:
        """Forget an endpoint that has gone; unknown endpoints are ignored."""
        if endpoint.gid in self._since:
            self._released(endpoint.gid)
            return
        asker = _asker(path, endpoint, DdsRole.REPLY)
        if asker is None or asker not in self._listening:
            return
        self._listening[asker].discard(endpoint.gid)
        if not self._listening[asker]:
            del self._listening[asker]

    def overdue(self, now_ns: int) -> list[tuple[Path, bytes]]:
        """Return the path and GID of each publisher that has waited long enough."""
        # They are in the order of their deadlines: all wait equally long.
        due = list(takewhile(lambda item: item[1][0] <= now_ns, self._since.items()))
        return [self._released(gid) for gid, _ in due]

    def _released(self, gid: bytes) -> tuple[Path, bytes]:
        _, asker, path = self._since.pop(gid)
        self._waiting[asker].discard(gid)
        if not self._waiting[asker]:
            del self._waiting[asker]
        return path, gid


def _asker(path: Path, endpoint: EndpointInfo, role: DdsRole) -> _Asker | None:
    """Return the client of an endpoint; None if the endpoint is no client's endpoint of this role."""
    service = _service_of(path.dds_topic, role)
    if service is None:
        return None
    client = entries(endpoint.user_data).get(_CLIENT_KEY) or endpoint.participant.hex()
    return _Asker(service, path.outward == (role is DdsRole.REQUEST), client)


@lru_cache(maxsize=4096)
def _service_of(dds_topic: str, role: DdsRole) -> str | None:
    name = ros_name_from_dds(dds_topic)
    return name.name if name is not None and name.role is role else None


ROUTER_KEY = "sfglab.router"
"""Key in USER_DATA of a router's endpoints, whose value names the agent's domain."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Open:
    """Action of a router: open a reader or a writer."""

    what: ReaderSpec | WriterSpec  #: The reader or writer.


@dataclass(frozen=True, slots=True, kw_only=True)
class Close:
    """Action of a router: close a reader or a writer."""

    what: ReaderSpec | WriterSpec  #: The reader or writer.


@dataclass(frozen=True, slots=True, kw_only=True)
class AssignRoute:
    """Action of a router: set the writer of the samples that a reader receives from a source."""

    reader: ReaderSpec  #: An open reader.
    source: EndpointInfo  #: Publisher whose samples the route is for.
    writer: WriterSpec | None  #: An open writer; None to drop the samples.


@dataclass(frozen=True, slots=True, kw_only=True)
class RemoveSource:
    """Action of a router: remove a source whose publisher has gone, and drop its held samples."""

    reader: ReaderSpec  #: An open reader.
    source: bytes  #: GID of the publisher.


Action = Open | Close | AssignRoute | RemoveSource


class Plan:
    """Paths that are open and paths that must be open, and the actions that lead from the former to the latter.

    Args:
        policy: Forwarding rules.
        participants: GUIDs of the router's own participants; their endpoints never count.
        tag: Name of the agent's domain, as in USER_DATA under `ROUTER_KEY`.
        linger_ns: Time that an endpoint counts after it has gone, ns.
        advertise_unused_topics: Whether topics without a subscription have writers.
    """

    def __init__(
        self,
        policy: Policy,
        *,
        participants: frozenset[bytes],
        tag: str,
        linger_ns: int = 1_000_000_000,
        advertise_unused_topics: bool = False,
    ) -> None:
        self.paths: dict[Path, PathState] = {}
        self._policy = policy
        self._participants = participants
        self._tag = tag
        self._linger_ns = linger_ns
        self._advertises = advertise_unused_topics
        self._leaving: dict[tuple[Path, bytes], int] = {}
        self._replies = Replies()

    @property
    def deadline_ns(self) -> int | None:
        """Time, ns on the caller's clock, at which `feed` must be called even without events; None for no time."""
        deadlines = (next(iter(self._leaving.values()), None), self._replies.deadline_ns)
        return min((deadline for deadline in deadlines if deadline is not None), default=None)

    def feed(self, events: Iterable[tuple[Side, EndpointEvent]], *, now_ns: int) -> list[Action]:
        """Process events of both graphs at a time, ns; return the actions in their order.

        Each path that changes is planned once, because that takes time per endpoint of the path.
        """
        touched: dict[Path, None] = {}
        for side, event in events:
            touched |= dict.fromkeys(self._note(side, event, now_ns))
        touched |= dict.fromkeys(self._released(self._replies.overdue(now_ns)))
        touched |= self._let_go(now_ns)
        return [action for path in touched for action in self._refresh(path)]

    def _note(self, side: Side, event: EndpointEvent, now_ns: int) -> list[Path]:
        """Take note of an event; return the paths that it changes."""
        endpoint = event.endpoint
        path = self._path_of(side, endpoint)
        if path is None:
            return []
        self._leaving.pop((path, endpoint.gid), None)
        if isinstance(event, EndpointAdded):
            return [path, *self._add(path, side, endpoint, now_ns)]
        if endpoint.gid in self.paths.get(path, PathState()):
            # They are in the order of their deadlines: all linger equally long.
            self._leaving[path, endpoint.gid] = now_ns + self._linger_ns
            self._replies.closed(path, endpoint)
        return []

    def _let_go(self, now_ns: int) -> dict[Path, None]:
        """Forget endpoints that have lingered long enough; return the paths that this changes."""
        due = list(takewhile(lambda item: item[1] <= now_ns, self._leaving.items()))
        for (path, gid), _ in due:
            del self._leaving[path, gid]
            self.paths[path].discard(gid)
        return dict.fromkeys(path for (path, _), _ in due)

    def _path_of(self, side: Side, endpoint: EndpointInfo) -> Path | None:
        """Return the path that an endpoint belongs to; None if it does not cross or does not matter."""
        if endpoint.transport == "shm" or endpoint.participant in self._participants:
            return None
        outward = (endpoint.kind is EndpointKind.PUBLISHER) is (side is Side.LOCAL)
        path = Path(dds_topic=endpoint.dds_topic, type=endpoint.type, outward=outward)
        return path if self._policy.crosses(path.dds_topic, path.direction) else None

    def _add(self, path: Path, side: Side, endpoint: EndpointInfo, now_ns: int) -> list[Path]:
        """Add an endpoint; return the paths on which publishers no longer wait for it."""
        state = self.paths.setdefault(path, PathState())
        if endpoint.kind is EndpointKind.PUBLISHER and endpoint.gid not in state:
            state.mark_possibly_stale(endpoint)
        stale_since = state.possibly_stale.get(endpoint.gid)
        state.discard(endpoint.gid)
        if stale_since is not None:  # it is the same endpoint, of which more is known
            state.possibly_stale[endpoint.gid] = stale_since
        counts = self._counts(side, endpoint)
        if endpoint.kind is EndpointKind.PUBLISHER:
            (state.sources if counts else state.blocked_publishers)[endpoint.gid] = endpoint
            if counts and self._replies.must_wait_for_reply_reader(path, endpoint, now_ns=now_ns):
                state.held.add(endpoint.gid)
        elif counts:
            state.sinks[endpoint.gid] = endpoint
            return self._released(self._replies.opened(path, endpoint))
        return []

    def _released(self, sources: list[tuple[Path, bytes]]) -> list[Path]:
        """Let samples of waiting publishers pass; return their paths."""
        for path, gid in sources:
            self.paths[path].held.discard(gid)
        return [path for path, _ in sources]

    def _counts(self, side: Side, endpoint: EndpointInfo) -> bool:
        """Return whether an endpoint counts, and is not another router's that would make a loop."""
        tag = entries(endpoint.user_data).get(ROUTER_KEY)
        return tag is None if side is Side.LOCAL else tag != self._tag

    def _refresh(self, path: Path) -> list[Action]:
        state = self.paths[path]
        before = state.setup
        state.setup = wanted(path, state, advertise_unused=self._advertises)
        if not state:
            del self.paths[path]
        return _actions(before, state)


def _actions(before: Setup, state: PathState) -> list[Action]:
    """Return the actions that lead from one setup to the next.

    Readers close before others open, so that no sample is read twice; writers open first and close last.
    """
    after = state.setup
    publishers = state.sources | state.blocked_publishers
    kept = [reader for reader in before.readers if reader in after.readers]
    actions: list[Action] = [Close(what=reader) for reader in before.readers if reader not in kept]
    actions += [Open(what=writer) for writer in after.writers if writer not in before.writers]
    actions += [Open(what=reader) for reader in after.readers if reader not in kept]
    for reader, destinations in after.routes.items():
        known = before.routes[reader] if reader in kept else {}
        actions += [
            AssignRoute(reader=reader, source=publishers[gid], writer=destination)
            for gid, destination in destinations.items()
            if not isinstance(destination, Held) and known.get(gid, Held.HELD) != destination
        ]
    for reader in kept:
        gone = before.routes[reader].keys() - after.routes[reader].keys()
        actions += [RemoveSource(reader=reader, source=gid) for gid in sorted(gone)]
    return actions + [
        Close(what=writer) for writer in before.writers if writer not in after.writers
    ]
