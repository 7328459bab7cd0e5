"""Samples from one node to another as they are: what a router between two domains stands on.

Whoever opens a forward says which sources pass; what others send waits until then. Live nodes forward inside
the middleware (`sfglab.bus.dds.forwarder`), every other backend by `sfglab.bus.backend.RawForwarder`, on the
loop.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any, Generic, Protocol, TypeVar

from sfglab.bus.loop import nothing

if TYPE_CHECKING:
    from sfglab.bus.api import RawEndpoint

Transform = Callable[[bytes], bytes | None]
"""Changes a sample on its way: CDR in, CDR out, None drops it. The same object back means: as it was."""

#: How many samples of a source that nobody judged yet are kept; the oldest go first.
HELD_SAMPLES = 256

_Sample = TypeVar("_Sample")
_Exit = TypeVar("_Exit")
_Writer = TypeVar("_Writer")


class RawWriter(Protocol):
    """A writer of samples as they are, in the target's domain of a forwarder."""

    @property
    def gid(self) -> bytes:
        """Its 16-byte GUID, as the graph shows it."""

    def close(self) -> None:
        """End it; again is harmless."""


@dataclass(slots=True)
class ForwardCounts:
    """What a forward did so far."""

    forwarded: int = 0  #: Samples handed to a raw writer.
    #: Samples that were refused, by a transform or the middleware too, or pushed out.
    dropped: int = 0
    bytes: int = 0  #: Size of the CDR that was forwarded.


class SourceGate(Generic[_Sample, _Exit]):
    """The judgements of sources, and the samples of those not judged yet; pure, whatever samples are."""

    def __init__(
        self, send: Callable[[_Exit, _Sample], None], drop: Callable[[_Sample], None]
    ) -> None:
        self._send = send
        self._drop = drop
        self._exits: dict[bytes, _Exit | None] = {}
        self._held: dict[bytes, deque[_Sample]] = {}

    def take(self, source: bytes, sample: _Sample) -> None:
        """Send, drop or hold one sample."""
        if source not in self._exits:
            self._hold(source, sample)
        elif (exit_ := self._exits[source]) is None:
            self._drop(sample)
        else:
            self._send(exit_, sample)

    def judge(self, source: bytes, exit_: _Exit | None) -> None:
        """Say where a source's samples go, None is nowhere; what was held for it goes first."""
        self._exits[source] = exit_
        for sample in self._held.pop(source, ()):
            self.take(source, sample)

    def exit_of(self, source: bytes) -> _Exit | None:
        """Return where a source's samples go; None: nowhere, or nobody has said so yet."""
        return self._exits.get(source)

    def forget(self, source: bytes) -> None:
        """Take a source for one that was never judged."""
        self._exits.pop(source, None)
        self._drop_held(source)

    def close(self) -> None:
        """Drop everything held, forget all sources and whom samples are given to.

        So a forward, which has a gate that has its methods, is freed at once and not by the garbage collector.
        """
        self._exits.clear()
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
        self._order(partial(self._gate.judge, source, (writer, transform)))

    def refuse(self, source: bytes) -> None:
        """Drop a source's samples from now on, and those held."""
        self._order(partial(self._gate.judge, source, None))

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
    def _send(self, exit_: tuple[_Writer, Transform | None], sample: _Sample) -> None: ...

    @abstractmethod
    def _drop(self, sample: _Sample) -> None: ...


class Forwarder(Protocol):
    """Opens forwards from one node and raw writers on another; made by `Node.open_forwarder`."""

    def open(self, endpoint: RawEndpoint) -> Forward[Any, Any]:
        """Read a topic in the source's domain; until its sources are judged their samples are held."""

    def open_writer(self, endpoint: RawEndpoint) -> RawWriter:
        """Write to a topic in the target's domain; to be closed when no source goes there any more."""
