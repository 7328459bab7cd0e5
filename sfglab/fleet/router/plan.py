"""Actions of a router when endpoints come and go: what it opens and closes.

Pure: takes what the graphs of both domains say and the time, returns actions. What has to be open stands in
`sfglab.fleet.policy`. What goes away counts for a while longer, so that a restart does not tear its path down.
Routers that meet do not loop: in the local domain no router's endpoint counts, and in the global domain none of
our own pair of domains does. A client's requests wait for the way of their replies (`Replies`).
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


PATIENCE_NS = 2_000_000_000
"""How long requests wait for a reply reader, nanoseconds: several repairs of a lost discovery message."""

# rmw_cyclonedds names the client on both halves, for one participant may have several clients of a service.
_CLIENT_KEY = "clientid"


class _Asker(NamedTuple):
    """Who asks which service; its writer and its reader are in the same domain, so on paths of either way."""

    service: str
    outward: bool
    client: str


class Replies:
    """The clients whose reply readers are known, and the requests that wait for one."""

    def __init__(self) -> None:
        self._listening: dict[_Asker, set[bytes]] = {}
        self._waiting: dict[_Asker, set[bytes]] = {}
        self._since: dict[bytes, tuple[int, _Asker, Path]] = {}

    @property
    def deadline_ns(self) -> int | None:
        """When `overdue` has something to tell, on the caller's clock; None while nothing waits."""
        return next((deadline_ns for deadline_ns, _, _ in self._since.values()), None)

    def holds(self, path: Path, writer: EndpointInfo, *, now_ns: int) -> bool:
        """Return whether a new publisher's samples have to wait; then `opened` or `overdue` tells their end."""
        asker = _asker(path, writer, DdsRole.REQUEST)
        if asker is None or asker in self._listening:
            return False
        self._since.pop(writer.gid, None)
        self._waiting.setdefault(asker, set()).add(writer.gid)
        self._since[writer.gid] = (now_ns + PATIENCE_NS, asker, path)
        return True

    def opened(self, path: Path, reader: EndpointInfo) -> list[tuple[Path, bytes]]:
        """Take a new subscription; return the path and gid of each publisher that need not wait any more."""
        asker = _asker(path, reader, DdsRole.REPLY)
        if asker is None:
            return []
        self._listening.setdefault(asker, set()).add(reader.gid)
        return [self._released(gid) for gid in sorted(self._waiting.get(asker, ()))]

    def closed(self, path: Path, endpoint: EndpointInfo) -> None:
        """Take it that an endpoint has gone; harmless for one that is not known."""
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
        """Return what has waited long enough, as `opened` does."""
        # In the order of their deadlines, since all wait equally long.
        due = list(takewhile(lambda item: item[1][0] <= now_ns, self._since.items()))
        return [self._released(gid) for gid, _ in due]

    def _released(self, gid: bytes) -> tuple[Path, bytes]:
        _, asker, path = self._since.pop(gid)
        self._waiting[asker].discard(gid)
        if not self._waiting[asker]:
            del self._waiting[asker]
        return path, gid


def _asker(path: Path, endpoint: EndpointInfo, role: DdsRole) -> _Asker | None:
    """Return whose half of a call an endpoint is; None when it is no client's half of this role."""
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
"""USER_DATA of a router's endpoints says under this key which pair of domains it serves."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Open:
    """Open a reader or writer."""

    what: ReaderSpec | WriterSpec  #: Which.


@dataclass(frozen=True, slots=True, kw_only=True)
class Close:
    """Close a reader or writer."""

    what: ReaderSpec | WriterSpec  #: Which.


@dataclass(frozen=True, slots=True, kw_only=True)
class Judge:
    """Say where the samples go that a reader gets from a source."""

    reader: ReaderSpec  #: An open reader.
    source: EndpointInfo  #: The publisher.
    writer: WriterSpec | None  #: An open writer; None: they are dropped.


@dataclass(frozen=True, slots=True, kw_only=True)
class Forget:
    """Forget a source that has gone."""

    reader: ReaderSpec  #: An open reader.
    source: bytes  #: The publisher's gid.


Action = Open | Close | Judge | Forget


class Plan:
    """What is open, what has to be, and the actions in between.

    Args:
        policy: What may cross.
        participants: GUIDs of the router's own participants; their endpoints never count.
        pair: Which pair of domains the router serves, as USER_DATA says under `ROUTER_KEY`.
        linger_ns: How long an endpoint that has gone still counts.
        offers: Whether topics that nobody wants have their writers already.
    """

    def __init__(
        self,
        policy: Policy,
        *,
        participants: frozenset[bytes],
        pair: str,
        linger_ns: int = 1_000_000_000,
        offers: bool = False,
    ) -> None:
        self.paths: dict[Path, PathState] = {}
        self._policy = policy
        self._participants = participants
        self._pair = pair
        self._linger_ns = linger_ns
        self._offers = offers
        self._leaving: dict[tuple[Path, bytes], int] = {}
        self._replies = Replies()

    @property
    def deadline_ns(self) -> int | None:
        """When `feed` is due, events or not, on the caller's clock; None while nothing lingers or waits."""
        deadlines = (next(iter(self._leaving.values()), None), self._replies.deadline_ns)
        return min((deadline for deadline in deadlines if deadline is not None), default=None)

    def feed(self, events: Iterable[tuple[Side, EndpointEvent]], *, now_ns: int) -> list[Action]:
        """Take events of both graphs, let go of what has waited long enough, and return what to do, in order.

        Each path that they touch is looked at once, because a look costs what a path has of endpoints.
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
            # In the order of their deadlines, since all linger equally long.
            self._leaving[path, endpoint.gid] = now_ns + self._linger_ns
            self._replies.closed(path, endpoint)
        return []

    def _let_go(self, now_ns: int) -> dict[Path, None]:
        """Forget what has lingered long enough; return the paths that this changes."""
        due = list(takewhile(lambda item: item[1] <= now_ns, self._leaving.items()))
        for (path, gid), _ in due:
            del self._leaving[path, gid]
            self.paths[path].discard(gid)
        return dict.fromkeys(path for (path, _), _ in due)

    def _path_of(self, side: Side, endpoint: EndpointInfo) -> Path | None:
        """Return the path that an endpoint is part of; None for what may not cross or is nobody's business."""
        if endpoint.transport == "shm" or endpoint.participant in self._participants:
            return None
        outward = (endpoint.kind is EndpointKind.PUBLISHER) is (side is Side.LOCAL)
        path = Path(dds_topic=endpoint.dds_topic, type=endpoint.type, outward=outward)
        return path if self._policy.crosses(path.dds_topic, path.direction) else None

    def _add(self, path: Path, side: Side, endpoint: EndpointInfo, now_ns: int) -> list[Path]:
        """Take an endpoint in; return the paths on which others need not wait for it any more."""
        state = self.paths.setdefault(path, PathState())
        if endpoint.kind is EndpointKind.PUBLISHER and endpoint.gid not in state:
            state.doubt(endpoint)
        doubted = {gid: doubt for gid, doubt in state.doubted.items() if gid == endpoint.gid}
        state.discard(endpoint.gid)
        state.doubted |= doubted  # it is what it was, and more is known of it
        counts = self._counts(side, endpoint)
        if endpoint.kind is EndpointKind.PUBLISHER:
            (state.sources if counts else state.barred)[endpoint.gid] = endpoint
            if counts and self._replies.holds(path, endpoint, now_ns=now_ns):
                state.held.add(endpoint.gid)
        elif counts:
            state.sinks[endpoint.gid] = endpoint
            return self._released(self._replies.opened(path, endpoint))
        return []

    def _released(self, sources: list[tuple[Path, bytes]]) -> list[Path]:
        """Let samples pass that had to wait; return their paths."""
        for path, gid in sources:
            self.paths[path].held.discard(gid)
        return [path for path, _ in sources]

    def _counts(self, side: Side, endpoint: EndpointInfo) -> bool:
        """Return whether an endpoint is a source or sink, and not another router's that would make a loop."""
        pair = entries(endpoint.user_data).get(ROUTER_KEY)
        return pair is None if side is Side.LOCAL else pair != self._pair

    def _refresh(self, path: Path) -> list[Action]:
        state = self.paths[path]
        before, state.setup = state.setup, wanted(path, state, offers=self._offers)
        if not state:
            del self.paths[path]
        return _actions(before, state)


def _actions(before: Setup, state: PathState) -> list[Action]:
    """Return what leads from one setup to the next.

    Readers close before others open, so no sample is read twice; writers open first and close last.
    """
    after = state.setup
    publishers = state.sources | state.barred
    kept = [reader for reader in before.readers if reader in after.readers]
    actions: list[Action] = [Close(what=reader) for reader in before.readers if reader not in kept]
    actions += [Open(what=writer) for writer in after.writers if writer not in before.writers]
    actions += [Open(what=reader) for reader in after.readers if reader not in kept]
    for reader, verdicts in after.judged.items():
        known = before.judged[reader] if reader in kept else {}
        actions += [
            Judge(reader=reader, source=publishers[gid], writer=verdict)
            for gid, verdict in verdicts.items()
            if not isinstance(verdict, Held) and known.get(gid, Held.HELD) != verdict
        ]
    for reader in kept:
        gone = before.judged[reader].keys() - after.judged[reader].keys()
        actions += [Forget(reader=reader, source=gid) for gid in sorted(gone)]
    return actions + [
        Close(what=writer) for writer in before.writers if writer not in after.writers
    ]
