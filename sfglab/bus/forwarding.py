"""Forwarding of serialized samples from one node to another: the base of a router between two domains.

Samples of a source are held until the owner of the forward admits or refuses the source. Live nodes forward
inside the middleware (`sfglab.bus.dds.forwarder`). All other pairs of nodes, also of different backends, use
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
"""Change of a sample: CDR in, CDR out. None drops the sample; the same object leaves it unchanged."""

#: Largest number of samples held for a source without a decision; the oldest are dropped first.
HELD_SAMPLES = 256

MAX_BACKLOG_BYTES = 64 << 20
"""Largest history of a volatile writer for a stalled reader, bytes; samples of one more second may be added."""
#: Time without acknowledgements after which the depth of the history is reduced, s.
STANDS_STILL_S = 1.0

_Sample = TypeVar("_Sample")
_Destination = TypeVar("_Destination")
_Writer = TypeVar("_Writer")


class GuardedWriter(ABC):
    """Writer of serialized samples in the target domain of a forwarder, with two rules.

    One rule bounds its history, the other follows the liveliness of its source.
    With AUTOMATIC liveliness this process would keep the writer alive after the end of its source. A VOLATILE
    writer is therefore deleted while its source is not alive. A TRANSIENT_LOCAL writer stays because its
    history would be lost. The writer counts the bytes of its samples. If they are too many and a reader
    acknowledges nothing, a writer with a smaller depth replaces it.
    """

    gid: bytes  #: 16-byte GUID of the writer, as the graph shows it.

    def __init__(self, qos: QoSProfile) -> None:
        self.closed = False  #: Whether the writer is closed.
        self._qos = qos
        self._is_there = True
        is_volatile = qos.durability is Durability.VOLATILE
        self._bounded = is_volatile and qos.history is History.KEEP_LAST
        has_lease = qos.lease_ns is not None and qos.liveliness is Liveliness.AUTOMATIC
        self._vanishes = is_volatile and has_lease
        self._backlog_bytes = 0  # upper bound of the bytes since all samples were acknowledged
        self._behind_since_s: float | None = None

    def show_life(self, *, alive: bool) -> None:
        """Create the writer if its source is alive, otherwise delete it; repeated calls are harmless."""
        if self.closed or not self._vanishes or alive is self._is_there:
            return
        self._is_there = alive
        if alive:
            self._create(self._qos)
        else:
            self._delete()

    def bound_backlog(self, size_bytes: int) -> None:
        """Bound the unacknowledged samples; to be called before a sample of `size_bytes` is sent.

        A later call would find this sample unacknowledged even if the reader is fast.
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
    def close(self) -> None:
        """Close the writer; repeated calls are harmless."""

    @abstractmethod
    def _create(self, qos: QoSProfile) -> None:
        """Create the middleware's writer."""

    @abstractmethod
    def _delete(self) -> None:
        """Send waiting samples, and delete the middleware's writer."""

    @abstractmethod
    def _has_all_acknowledged(self) -> bool:
        """Return whether all reliable readers have acknowledged all samples."""


@dataclass(slots=True)
class ForwardCounts:
    """Counters of a forward since it was opened."""

    forwarded: int = 0  #: Number of samples handed to a raw writer.
    #: Number of samples that were refused, also by a transform or the middleware, or dropped while held.
    dropped: int = 0
    bytes: int = 0  #: Size of the forwarded CDR, bytes.


class SourceGate(Generic[_Sample, _Destination]):
    """Decisions about sources, and held samples of undecided sources; it works with samples of any type."""

    def __init__(
        self, send: Callable[[_Destination, _Sample], None], drop: Callable[[_Sample], None]
    ) -> None:
        self._send = send
        self._drop = drop
        self._destinations: dict[bytes, _Destination | None] = {}
        self._held: dict[bytes, deque[_Sample]] = {}

    def take(self, source: bytes, sample: _Sample) -> None:
        """Send a sample to its source's destination, drop it without one, or hold it while that is undecided."""
        if source not in self._destinations:
            self._hold(source, sample)
        elif (destination := self._destinations[source]) is None:
            self._drop(sample)
        else:
            self._send(destination, sample)

    def set_destination(self, source: bytes, destination: _Destination | None) -> None:
        """Set where the samples of a source go, None for nowhere; its held samples go first."""
        self._destinations[source] = destination
        for sample in self._held.pop(source, ()):
            self.take(source, sample)

    def destination_of(self, source: bytes) -> _Destination | None:
        """Return where the samples of a source go; None if they are dropped or the source is undecided."""
        return self._destinations.get(source)

    def forget(self, source: bytes) -> None:
        """Forget the decision about a source, and drop its held samples."""
        self._destinations.pop(source, None)
        self._drop_held(source)

    def close(self) -> None:
        """Drop held samples, and forget all sources and both callbacks.

        The gate refers to methods of its forward. Without these references the forward is freed at once
        instead of by the garbage collector.
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
    """Forward of one topic: a raw reader, whose samples are sent on by source; made by `Forwarder.open`."""

    def __init__(self) -> None:
        self.counts = ForwardCounts()
        self._gate: SourceGate[_Sample, tuple[_Writer, Transform | None]] = SourceGate(
            self._send, self._drop
        )

    def admit(self, source: bytes, writer: _Writer, transform: Transform | None = None) -> None:
        """Forward the samples of a source, given by its 16-byte GUID, to a raw writer; held samples go first.

        On live nodes the transform runs in the reading thread and must not use objects of the loop.
        """
        self._order(partial(self._gate.set_destination, source, (writer, transform)))

    def refuse(self, source: bytes) -> None:
        """Drop the samples of a source from now on, including held ones."""
        self._order(partial(self._gate.set_destination, source, None))

    def forget(self, source: bytes) -> None:
        """Forget the decision about a source; its samples are held, within bounds, until the next decision."""
        self._order(partial(self._gate.forget, source))

    @abstractmethod
    def close(self) -> None:
        """Stop forwarding at once; raw writers stay open. Repeated calls are harmless."""

    def _order(self, order: Callable[[], None]) -> None:
        """Call a function in the thread through which samples pass."""
        order()

    @abstractmethod
    def _send(self, destination: tuple[_Writer, Transform | None], sample: _Sample) -> None: ...

    @abstractmethod
    def _drop(self, sample: _Sample) -> None: ...


class Forwarder(Protocol):
    """Factory of forwards from one node and of raw writers on another; made by `Node.open_forwarder`."""

    def open(self, endpoint: RawEndpoint) -> Forward[Any, Any]:
        """Read a topic in the source domain; samples of a source are held until it is admitted or refused."""

    def open_writer(self, endpoint: RawEndpoint) -> GuardedWriter:
        """Write to a topic in the target domain; to be closed when no source uses the writer any more."""
