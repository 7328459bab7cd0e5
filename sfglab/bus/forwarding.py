"""Samples from one node to another as they are: what a router between two domains stands on.

Refuses to know policies: whoever opens a forward says which sources pass; what others send waits until then.
Live nodes forward inside the middleware (`sfglab.bus.dds.forwarder`), without the bytes ever being Python's;
`RawForwarder` serves every other backend, all on the loop.
"""

from __future__ import annotations

from collections import deque
from dataclasses import replace
from typing import TYPE_CHECKING, Generic, TypeVar, cast

from sfglab.bus.backend import Backend, ForwardCounts, RawWriter, Transform
from sfglab.bus.endpoints import Inbox, Sample, Writer

if TYPE_CHECKING:
    from collections.abc import Callable

    from sfglab.bus.api import RawEndpoint

HELD_SAMPLES = 256
"""How many samples of a source that nobody judged yet are kept; the oldest go first."""

_Sample = TypeVar("_Sample")
_Exit = TypeVar("_Exit")


class SourceGate(Generic[_Sample, _Exit]):
    """The judgements of sources, and the samples of those that nobody has judged yet.

    Pure: samples and exits are whatever the forward at hand works with.

    Args:
        send: Given an exit and a sample that goes there.
        drop: Given a sample that goes nowhere.
    """

    def __init__(self, send: Callable[[_Exit, _Sample], None], drop: Callable[[_Sample], None]) -> None:
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

    def forget(self, source: bytes) -> None:
        """Take a source for one that was never judged."""
        self._exits.pop(source, None)
        self._drop_held(source)

    def clear(self) -> None:
        """Drop everything held and forget all sources."""
        self._exits.clear()
        for source in tuple(self._held):
            self._drop_held(source)

    def _hold(self, source: bytes, sample: _Sample) -> None:
        held = self._held.setdefault(source, deque())
        held.append(sample)
        if len(held) > HELD_SAMPLES:
            self._drop(held.popleft())

    def _drop_held(self, source: bytes) -> None:
        for sample in self._held.pop(source, ()):
            self._drop(sample)


class RawForwarder:
    """Forwards between two nodes by readers and writers of theirs.

    Args:
        source: Where samples come from.
        target: Where they go to.
    """

    def __init__(self, source: Backend, target: Backend) -> None:
        self._source = source
        self._target = target

    def open(self, endpoint: RawEndpoint) -> LoopForward:
        """Read a topic in the source's domain; until its sources are judged their samples are held."""
        return LoopForward(self._source, replace(endpoint, forwards=True))

    def open_writer(self, endpoint: RawEndpoint) -> LoopWriter:
        """Write to a topic in the target's domain."""
        return LoopWriter(self._target, replace(endpoint, forwards=True))


class LoopWriter:
    """A raw writer that is written to on the loop, and ignores what comes after its end."""

    def __init__(self, backend: Backend, endpoint: RawEndpoint) -> None:
        self._backend = backend
        self._writer: Writer | None = backend.open_writer(endpoint, _ignore)
        self.gid = self._writer.gid
        backend.register(self._writer)

    def write(self, cdr: bytes, source_timestamp_ns: int) -> None:
        """Send one sample with the time stamp that its first publisher gave it."""
        if self._writer is not None and not self._backend.closed:
            self._writer.write(cdr, source_timestamp_ns)

    def close(self) -> None:
        """End it; again is harmless."""
        if self._writer is not None:
            self._backend.end(self._writer)
            self._writer = None


_LoopExit = tuple[LoopWriter, Transform | None]


class LoopForward:
    """One reader whose samples go on by their source, all on the loop."""

    def __init__(self, backend: Backend, endpoint: RawEndpoint) -> None:
        self.counts = ForwardCounts()
        self._backend = backend
        self._gate: SourceGate[Sample, _LoopExit] = SourceGate(self._send, self._drop)
        calls = backend.calls(f"raw reader {endpoint.dds_topic!r}")
        inbox = Inbox(backend.bridge, endpoint.qos, decode=_whole, callback=self._take, calls=calls)
        self._reader = backend.open_reader(endpoint, _ignore, inbox)
        self.gid = self._reader.gid
        backend.register(self._reader)

    def admit(self, source: bytes, writer: RawWriter, transform: Transform | None = None) -> None:
        """Send a source's samples to a raw writer from now on, those held for it first."""
        self._gate.judge(source, (cast("LoopWriter", writer), transform))

    def refuse(self, source: bytes) -> None:
        """Drop a source's samples from now on, and those held."""
        self._gate.judge(source, None)

    def forget(self, source: bytes) -> None:
        """Take a source for one that was never judged."""
        self._gate.forget(source)

    def close(self) -> None:
        """End it at once; again is harmless."""
        self._backend.end(self._reader)
        self._gate.clear()

    def _take(self, sample: Sample) -> None:
        self._gate.take(sample[3], sample)

    def _send(self, exit_: _LoopExit, sample: Sample) -> None:
        writer, transform = exit_
        cdr = bytes(sample[0])
        changed = cdr if transform is None else transform(cdr)
        if changed is None:
            self._drop(sample)
            return
        writer.write(changed, sample[1])
        self.counts.forwarded += 1
        self.counts.bytes += len(changed)

    def _drop(self, _: Sample) -> None:
        self.counts.dropped += 1


def _whole(sample: Sample) -> Sample:
    return sample


def _ignore() -> None:
    """Take no notice of a change of what matches."""
