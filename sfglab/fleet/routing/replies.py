"""Which requests wait at the border, because the way of their replies is not open yet.

Discovery tells of a client's request writer and of its reply reader in two messages, in either order. A request
that is let through between them is answered before anybody knows where the answer goes, and the client waits
in vain. So a client's requests are held until its reply reader is known, and not for ever: who listens to no
replies wants none. Pure. Knows endpoints of services; refuses to know what a path needs (`paths`).
"""

from __future__ import annotations

from functools import lru_cache
from itertools import takewhile
from typing import TYPE_CHECKING, NamedTuple

from sfglab.bus.api import entries
from sfglab.names import DdsRole, ros_name_from_dds

if TYPE_CHECKING:
    from sfglab.bus.api import EndpointInfo
    from sfglab.fleet.routing.paths import Path


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
        """Return whether a new publisher's samples have to wait; then `opened` or `overdue` tells their end.

        Args:
            path: The way of its samples, of requests or of anything else.
            writer: The publisher.
            now_ns: The caller's clock, nanoseconds, which never goes back.
        """
        asker = _asker(path, writer, DdsRole.REQUEST)
        if asker is None or asker in self._listening:
            return False
        self._since.pop(writer.gid, None)
        self._waiting.setdefault(asker, set()).add(writer.gid)
        self._since[writer.gid] = (now_ns + PATIENCE_NS, asker, path)
        return True

    def opened(self, path: Path, reader: EndpointInfo) -> list[tuple[Path, bytes]]:
        """Take a new subscription, of replies or of anything else; return what need not wait any more.

        Returns:
            Of each the path and the publisher's gid.
        """
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
