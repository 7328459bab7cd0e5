"""What of one topic's way across the border has to be open: paper A, section 4.1, on demand.

Pure. Knows the endpoints on both sides of one path; refuses to know which of them count and what is open now.

A reader is opened in the source's domain when somebody subscribes in the target's; outward only if there is a
source too, so that nothing but what is in use is announced in the global domain. Inward the reader is opened at
once: it is how another agent's router learns that somebody here wants the topic, and if all routers waited for
each other nothing would ever flow. A writer is opened when there is a source as well, also for one whose
samples have to wait.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import Enum
from typing import TYPE_CHECKING

from sfglab.fleet.routing.merge import announced_qos, offered_qos, requested_qos
from sfglab.fleet.routing.policy import Direction
from sfglab.qos import Durability, QoSProfile

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from sfglab.bus.api import EndpointInfo


@dataclass(frozen=True, slots=True, kw_only=True, order=True)
class Path:
    """The way of one topic across the border."""

    dds_topic: str  #: The topic on the wire.
    type: str  #: As `EndpointInfo.type` names it; endpoints of another type are another path.
    outward: bool  #: Whether it leads from the local domain to the global one.

    @property
    def direction(self) -> Direction:
        """Which way it leads."""
        return Direction.OUTWARD if self.outward else Direction.INWARD


@dataclass(frozen=True, slots=True, kw_only=True)
class ReaderSpec:
    """A reader of the router, in the source's domain."""

    path: Path  #: What for.
    qos: QoSProfile  #: What it requests.


@dataclass(frozen=True, slots=True, kw_only=True)
class WriterSpec:
    """A writer of the router, in the target's domain."""

    path: Path  #: What for.
    qos: QoSProfile  #: What it offers.
    #: The one source that it stands for, if that one's samples are latched: several in one writer would push
    #: each other out of its history, and stay when their source has gone. Empty: all volatile sources that
    #: offer the same.
    source: bytes = b""


class Held(Enum):
    """What is said of a source whose samples must neither pass yet nor be lost."""

    HELD = "held"


Verdict = WriterSpec | Held | None
"""Where a source's samples go; None: nowhere."""


@dataclass(frozen=True, slots=True)
class Setup:
    """What of a path is to be open: readers, writers, and which source of a reader goes to which writer."""

    readers: tuple[ReaderSpec, ...] = ()
    writers: tuple[WriterSpec, ...] = ()
    judged: Mapping[tuple[ReaderSpec, bytes], Verdict] = field(default_factory=dict)


@dataclass(slots=True)
class PathState:
    """What is known about one path."""

    #: Publishers in the source's domain whose samples may cross, by gid.
    sources: dict[bytes, EndpointInfo] = field(default_factory=dict)
    #: Subscriptions in the target's domain that count, by gid.
    sinks: dict[bytes, EndpointInfo] = field(default_factory=dict)
    #: Publishers in the source's domain whose samples may not cross, by gid.
    barred: dict[bytes, EndpointInfo] = field(default_factory=dict)
    held: set[bytes] = field(default_factory=set)  #: Those of `sources` whose samples have to wait.
    setup: Setup = field(default_factory=Setup)  #: What is open now.

    def __contains__(self, gid: bytes) -> bool:
        return any(gid in part for part in (self.sources, self.sinks, self.barred))

    def __bool__(self) -> bool:
        return bool(self.sources or self.sinks or self.barred)

    def discard(self, gid: bytes) -> None:
        """Forget an endpoint; harmless for one that is not known."""
        for part in (self.sources, self.sinks, self.barred):
            part.pop(gid, None)
        self.held.discard(gid)


def wanted(path: Path, state: PathState) -> Setup:
    """Return what of a path has to be open: the rules of this module, as a function of what is known."""
    sinks = [sink.qos for sink in state.sinks.values()]
    if not sinks or (path.outward and not state.sources):
        return Setup()
    if not state.sources:
        readers = {ReaderSpec(path=path, qos=announced_qos(path.dds_topic, sinks)): None}
        return Setup(tuple(readers), (), _judged(readers, {}, state))
    ways = {gid: _way(path, source, sinks) for gid, source in sorted(state.sources.items())}
    readers = dict.fromkeys(reader for reader, _ in ways.values())
    writers = dict.fromkeys(writer for _, writer in ways.values())
    return Setup(tuple(readers), tuple(writers), _judged(readers, ways, state))


def _way(path: Path, source: EndpointInfo, sinks: list[QoSProfile]) -> tuple[ReaderSpec, WriterSpec]:
    reader = ReaderSpec(path=path, qos=requested_qos(path.dds_topic, source.qos, sinks))
    own = source.gid if source.qos.durability is Durability.TRANSIENT_LOCAL else b""
    return reader, WriterSpec(path=path, qos=offered_qos(source.qos), source=own)


def _judged(
    readers: Iterable[ReaderSpec], ways: Mapping[bytes, tuple[ReaderSpec, WriterSpec]], state: PathState
) -> dict[tuple[ReaderSpec, bytes], Verdict]:
    """Say for every reader where each publisher's samples go: each source is heard by one reader alone."""
    judged: dict[tuple[ReaderSpec, bytes], Verdict] = {}
    for reader in readers:
        judged |= {(reader, gid): None for gid in state.barred}
        for gid, (own, writer) in ways.items():
            here = Held.HELD if gid in state.held else writer
            judged[reader, gid] = here if own == reader else None
    return judged
