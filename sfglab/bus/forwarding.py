"""Samples from one node to another as they are: what a router between two domains stands on.

Samples of a source wait until the forward's owner decides where they go. Live nodes forward inside the
middleware (`sfglab.bus.dds.forwarder`), all other pairs of nodes, also of different backends, by
`sfglab.bus.backend.RawForwarder`. `GuardedWriter` has the rules that both share.
"""

from __future__ import annotations

import logging
import time
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Any, Generic, Protocol, TypeVar

from sfglab.bus.loop import nothing
from sfglab.qos import Durability, History, Liveliness

if TYPE_CHECKING:
    from sfglab.bus.api import RawEndpoint
    from sfglab.qos import QoSProfile

_log = logging.getLogger("sfglab.bus")

Transform = Callable[[bytes], bytes | None]
"""Changes a sample on its way: CDR in, CDR out, None drops it. The same object back means: as it was."""

#: Most samples that are held for a source without a decision; the oldest are dropped first.
HELD_SAMPLES = 256

MAX_BACKLOG_BYTES = 64 << 20
"""Bound of a volatile writer's history for a reader without acknowledgements, beside the samples of a second."""
STANDS_STILL_S = 1.0  #: Time without acknowledgements after which the history is made shallower, s.

_Sample = TypeVar("_Sample")
_Destination = TypeVar("_Destination")
_Writer = TypeVar("_Writer")


class RawWriter(Protocol):
    """A writer of samples as they are, in the target's domain of a forwarder."""

    @property
    def gid(self) -> bytes:
        """Its 16-byte GUID, as the graph shows it."""

    def close(self) -> None:
        """End it; again is harmless."""


class GuardedWriter(ABC):
    """A raw writer under two rules: one for the memory of its history, one for the life of its source.

    A volatile writer whose source shows life by its process vanishes while the source shows none, since our
    process lives on; a latched one stays, because its history would go as well. Samples tell how many bytes
    a history has: if a reader acknowledges nothing and they are too many, a writer with a shallower history
    follows.
    """

    def __init__(self, qos: QoSProfile) -> None:
        self.closed = False  #: Whether it has ended.
        self._qos = qos
        self._is_there = True
        is_volatile = qos.durability is Durability.VOLATILE
        self._bounded = is_volatile and qos.history is History.KEEP_LAST
        has_lease = qos.lease_ns is not None and qos.liveliness is Liveliness.AUTOMATIC
        self._vanishes = is_volatile and has_lease
        self._backlog_bytes = 0  # at most, since all was acknowledged
        self._behind_since_s: float | None = None

    def show_life(self, *, alive: bool) -> None:
        """Create the writer if its source is alive, otherwise delete it; again is harmless."""
        if self.closed or not self._vanishes or alive is self._is_there:
            return
        self._is_there = alive
        if alive:
            self._create(self._qos)
        else:
            self._delete()

    def bound_backlog(self, size_bytes: int) -> None:
        """Keep what is not acknowledged below the bound, before a sample of a size is sent.

        After it, its own acknowledgement would be missing, also from a reader that keeps up.
        """
        self._backlog_bytes += size_bytes
        if not self._bounded or self._backlog_bytes <= MAX_BACKLOG_BYTES:
            return
        if self._has_all_acknowledged():
            self._backlog_bytes, self._behind_since_s = 0, None
            return
        now_s = time.monotonic()
        self._behind_since_s = self._behind_since_s or now_s
        depth = max(1, MAX_BACKLOG_BYTES // size_bytes)
        if now_s - self._behind_since_s >= STANDS_STILL_S and depth < self._qos.depth:
            said = "forwarding: a reader stands still; %d samples are kept for it from now on"
            _log.warning(said, depth)
            self._qos = replace(self._qos, depth=depth)
            self._delete()
            self._create(self._qos)

    @abstractmethod
    def _create(self, qos: QoSProfile) -> None:
        """Create the middleware's writer."""

    @abstractmethod
    def _delete(self) -> None:
        """Send what waits, and delete the middleware's writer."""

    @abstractmethod
    def _has_all_acknowledged(self) -> bool:
        """Return whether all reliable readers have all samples."""


@dataclass(slots=True)
class ForwardCounts:
    """What a forward did so far."""

    forwarded: int = 0  #: Samples handed to a raw writer.
    #: Samples that were refused, by a transform or the middleware too, or pushed out.
    dropped: int = 0
    bytes: int = 0  #: Size of the CDR that was forwarded.


class SourceGate(Generic[_Sample, _Destination]):
    """The judgements of sources, and the samples of those not judged yet; pure, whatever samples are."""

    def __init__(
        self, send: Callable[[_Destination, _Sample], None], drop: Callable[[_Sample], None]
    ) -> None:
        self._send = send
        self._drop = drop
        self._destinations: dict[bytes, _Destination | None] = {}
        self._held: dict[bytes, deque[_Sample]] = {}

    def take(self, source: bytes, sample: _Sample) -> None:
        """Send, drop or hold one sample."""
        if source not in self._destinations:
            self._hold(source, sample)
        elif (destination := self._destinations[source]) is None:
            self._drop(sample)
        else:
            self._send(destination, sample)

    def set_destination(self, source: bytes, destination: _Destination | None) -> None:
        """Say where a source's samples go, None is nowhere; what was held for it goes first."""
        self._destinations[source] = destination
        for sample in self._held.pop(source, ()):
            self.take(source, sample)

    def destination_of(self, source: bytes) -> _Destination | None:
        """Return where a source's samples go; None: nowhere, or without a decision."""
        return self._destinations.get(source)

    def forget(self, source: bytes) -> None:
        """Take a source for one that was never judged."""
        self._destinations.pop(source, None)
        self._drop_held(source)

    def close(self) -> None:
        """Drop everything held, forget all sources and whom samples are given to.

        So a forward, which has a gate that has its methods, is freed at once and not by the garbage collector.
        """
        self._destinations.clear()
        for source in tuple(self._held):
            self._drop_held(source)
        self._send = self._drop = nothing

    def _hold(self, source: bytes, sample: _Sample) -> None:
        held = self._held.setdefault(source, deque())
        held.append(sample)
        if len(held) > HELD_SAMPLES:
            self._drop(held.popleft())

    def _drop_held(self, source: bytes) -> None:
        for sample in self._held.pop(source, ()):
            self._drop(sample)


class Forward(ABC, Generic[_Sample, _Writer]):
    """One raw reader of one topic, whose samples go on by their source; made by `Forwarder.open`."""

    def __init__(self) -> None:
        self.counts = ForwardCounts()
        self._gate: SourceGate[_Sample, tuple[_Writer, Transform | None]] = SourceGate(
            self._send, self._drop
        )

    def admit(self, source: bytes, writer: _Writer, transform: Transform | None = None) -> None:
        """Send a publisher's samples, by its 16-byte GUID, to a raw writer from now on, those held first.

        On live nodes the transform runs in the thread that reads: it must not touch what belongs to the loop.
        """
        self._order(partial(self._gate.set_destination, source, (writer, transform)))

    def refuse(self, source: bytes) -> None:
        """Drop a source's samples from now on, and those held."""
        self._order(partial(self._gate.set_destination, source, None))

    def forget(self, source: bytes) -> None:
        """Take a source for one that was never judged: its samples are held, within bounds, until it is."""
        self._order(partial(self._gate.forget, source))

    @abstractmethod
    def close(self) -> None:
        """End it at once: nothing is forwarded any more; raw writers stay. Again is harmless."""

    def _order(self, order: Callable[[], None]) -> None:
        """Do something where samples pass."""
        order()

    @abstractmethod
    def _send(self, destination: tuple[_Writer, Transform | None], sample: _Sample) -> None: ...

    @abstractmethod
    def _drop(self, sample: _Sample) -> None: ...


class Forwarder(Protocol):
    """Opens forwards from one node and raw writers on another; made by `Node.open_forwarder`."""

    def open(self, endpoint: RawEndpoint) -> Forward[Any, Any]:
        """Read a topic in the source's domain; until its sources are judged their samples are held."""

    def open_writer(self, endpoint: RawEndpoint) -> RawWriter:
        """Write to a topic in the target's domain; to be closed when no source goes there any more."""
