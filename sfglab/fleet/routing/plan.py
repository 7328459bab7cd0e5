"""What a router has to open and close when endpoints come and go.

Pure: takes what the graphs of both domains say and the time, returns actions. Knows the policy and who is a
router; refuses to know nodes, sockets and clocks. What has to be open stands in `paths`.

What goes away counts for a while longer (it lingers), so that a restart does not tear its path down. Routers
that meet do not loop: in the local domain no router's endpoint counts, and in the global domain none that
serves our own pair of domains does. A client's requests wait for the way of their replies (`replies`).
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import takewhile
from typing import TYPE_CHECKING

from sfglab.bus.api import EndpointAdded, EndpointInfo, EndpointKind, entries
from sfglab.fleet.routing.paths import Held, Path, PathState, ReaderSpec, Setup, WriterSpec, wanted
from sfglab.fleet.routing.policy import Policy, Side
from sfglab.fleet.routing.replies import Replies

if TYPE_CHECKING:
    from collections.abc import Iterable

    from sfglab.bus.api import EndpointEvent


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
        participants: The 16-byte GUIDs of the router's own participants; their endpoints never count.
        pair: Which pair of domains the router serves, as its endpoints' USER_DATA says under `ROUTER_KEY`.
        linger_ns: How long an endpoint that has gone still counts, nanoseconds.
    """

    def __init__(
        self, policy: Policy, *, participants: frozenset[bytes], pair: str, linger_ns: int = 1_000_000_000
    ) -> None:
        self.paths: dict[Path, PathState] = {}
        self._policy = policy
        self._participants = participants
        self._pair = pair
        self._linger_ns = linger_ns
        self._leaving: dict[tuple[Path, bytes], int] = {}
        self._replies = Replies()

    @property
    def deadline_ns(self) -> int | None:
        """When `tick` is due, on the caller's clock; None while nothing lingers or waits."""
        deadlines = (next(iter(self._leaving.values()), None), self._replies.deadline_ns)
        return min((deadline for deadline in deadlines if deadline is not None), default=None)

    def feed(self, side: Side, event: EndpointEvent, *, now_ns: int) -> list[Action]:
        """Take one event of a domain's graph.

        Args:
            side: Whose graph.
            event: What it says.
            now_ns: The caller's clock, nanoseconds, which never goes back.

        Returns:
            What to do, in this order.
        """
        return self.feed_all([(side, event)], now_ns=now_ns)

    def feed_all(self, events: Iterable[tuple[Side, EndpointEvent]], *, now_ns: int) -> list[Action]:
        """Take events that were heard together, and look once at each path that they touch.

        In a large fleet many come at once on few paths, and a look costs what a path has of endpoints.
        """
        touched: dict[Path, None] = {}
        for side, event in events:
            touched |= dict.fromkeys(self._note(side, event, now_ns))
        touched |= dict.fromkeys(self._released(self._replies.overdue(now_ns)))
        touched |= self._let_go(now_ns)
        return [action for path in touched for action in self._refresh(path)]

    def tick(self, now_ns: int) -> list[Action]:
        """Let go of what has lingered or waited long enough; return what to do, in this order."""
        return self.feed_all((), now_ns=now_ns)

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
        if endpoint.transport != "dds" or endpoint.participant in self._participants:
            return None
        source = endpoint.kind is EndpointKind.PUBLISHER
        outward = source is (side is Side.LOCAL)
        path = Path(dds_topic=endpoint.dds_topic, type=endpoint.type, outward=outward)
        return path if self._policy.crosses(path.dds_topic, path.direction) else None

    def _add(self, path: Path, side: Side, endpoint: EndpointInfo, now_ns: int) -> list[Path]:
        """Take an endpoint in; return the paths on which others need not wait for it any more."""
        state = self.paths.setdefault(path, PathState())
        state.discard(endpoint.gid)
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
        before, state.setup = state.setup, wanted(path, state)
        if not state:
            del self.paths[path]
        return _actions(before, state)


def _actions(before: Setup, state: PathState) -> list[Action]:
    """Return what leads from one setup to the next.

    Readers are closed before others are opened, so no sample is read twice; writers before readers, so the
    first sample finds its way; writers are closed last, when nothing goes there any more.
    """
    after = state.setup
    publishers = state.sources | state.barred
    kept = [reader for reader in before.readers if reader in after.readers]
    actions: list[Action] = [Close(what=reader) for reader in before.readers if reader not in kept]
    actions += [Open(what=writer) for writer in after.writers if writer not in before.writers]
    actions += [Open(what=reader) for reader in after.readers if reader not in kept]
    actions += [
        Judge(reader=reader, source=publishers[gid], writer=verdict)
        for (reader, gid), verdict in after.judged.items()
        if not isinstance(verdict, Held)
        and (reader not in kept or before.judged.get((reader, gid), Held.HELD) != verdict)
    ]
    actions += [
        Forget(reader=reader, source=gid)
        for reader, gid in before.judged
        if reader in kept and (reader, gid) not in after.judged
    ]
    return actions + [Close(what=writer) for writer in before.writers if writer not in after.writers]
