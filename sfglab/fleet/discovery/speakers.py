"""Sources of the heartbeats of one agent: each publisher with each incarnation that it claims.

Any participant can send heartbeats with any name. Therefore a source is trusted only after the agent has
answered a query with the incarnation that the source claims. If one of several sources falls silent, the
others must prove again that the agent is present. A false period therefore neither hides the loss of an
agent nor simulates one. Two sources that send in turn are two agents with one name, or one of them is
spoofed. The module imports neither message types nor the life cycle.
"""

from __future__ import annotations

from dataclasses import dataclass

_Key = tuple[bytes, int]  # GID of the publisher, claimed incarnation

#: Maximum number of sources per name. The untrusted source that was silent longest is replaced.
MAX_SOURCES = 8
_MIN_MIXED = 2  # heartbeats of other sources between those of each source; one is a restart


@dataclass(slots=True)
class Source:
    """Claim of one publisher to be one incarnation of the agent."""

    #: Time at which the source counts as silent, after the announced period, ns.
    silent_ns: int = 0
    revision: int = 0  #: Announced revision of the description.
    #: Whether the source is trusted. None: not queried yet. False: the agent answered otherwise.
    trust: bool | None = None
    heard_ns: int = 0  #: Time of the last heartbeat, ns.
    beats: int = 0  #: Number of heartbeats.
    place: int = 0  #: Index of the last heartbeat among all heartbeats of the name.
    mixed: int = 0  #: Number of gaps in which another source sent a heartbeat.


class Speakers:
    """All sources of one agent name, at most `MAX_SOURCES`."""

    def __init__(self) -> None:
        self._sources: dict[_Key, Source] = {}
        self._beats = 0

    def record(self, key: _Key, *, now_ns: int, silent_ns: int, revision: int) -> Source:
        """Record a heartbeat of a source, given as the publisher's GID and the claimed incarnation."""
        source = self._sources.setdefault(key, Source())
        self._beats += 1
        source.mixed += bool(source.beats) and self._beats > source.place + 1
        source.beats += 1
        source.place = self._beats
        source.heard_ns, source.silent_ns, source.revision = now_ns, silent_ns, revision
        if len(self._sources) > MAX_SOURCES:
            others = [k for k, s in self._sources.items() if not s.trust and k != key]
            del self._sources[min(others or self._sources, key=lambda k: self._sources[k].place)]
        return source

    def conflicting_sources(self) -> list[_Key]:
        """Return the sources that send in turn; an empty list if there are fewer than two."""
        mixed = sorted(key for key, source in self._sources.items() if source.mixed >= _MIN_MIXED)
        return mixed if len(mixed) > 1 else []

    def is_claimed(self, incarnation: int, revision: int) -> bool:
        """Return whether a source claims this incarnation, and no later revision of it."""
        return any(
            claimed == incarnation and source.revision <= revision
            for (_, claimed), source in self._sources.items()
        )

    def confirm(self, incarnation: int, revision: int) -> None:
        """Trust the sources that claim the incarnation that answered, and distrust all others."""
        for (_, claimed), source in self._sources.items():
            if claimed != incarnation:
                source.trust = False
            elif source.revision <= revision:
                source.trust = True

    def any_trusted(self) -> bool:
        """Return whether at least one source of the agent's heartbeats is trusted."""
        return any(source.trust for source in self._sources.values())

    def silent_ns(self, held: int | None, *, doubted: bool) -> int:
        """Return the time at which the agent counts as silent, ns.

        If the incarnation `held` is present, this is the first deadline of its trusted or repeated claims.
        Otherwise it is the last deadline of the sources that may still be confirmed. If queries have failed
        repeatedly (`doubted`), only trusted sources count.
        """
        present: list[int] = []
        possible: list[int] = []
        for (_, claimed), source in self._sources.items():
            if not source.trust and (doubted or source.trust is False):
                continue
            possible.append(source.silent_ns)
            if claimed == held and (source.trust or source.beats > 1):
                present.append(source.silent_ns)
        return min(present, default=max(possible, default=0))

    def drop_silent(self, now_ns: int) -> bool:
        """Drop silent and distrusted sources, and withdraw the trust in the others.

        Returns:
            Whether there are others. If there are none, nothing changes.
        """
        left = {
            key: source
            for key, source in self._sources.items()
            if source.silent_ns > now_ns and source.trust is not False
        }
        if left:
            self._sources = left
            for source in left.values():
                source.trust = None
        return bool(left)

    def compensate_pause(self, since_ns: int, now_ns: int) -> None:
        """Extend all deadlines by the time during which the discoverer itself was paused."""
        for source in self._sources.values():
            left_ns = source.silent_ns - max(source.heard_ns, since_ns)
            source.silent_ns = max(source.silent_ns, now_ns + left_ns)
