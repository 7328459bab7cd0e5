"""Which source's samples go where, and what waits until somebody says so.

Pure: samples and exits are whatever the forward at hand works with. Refuses to know readers and writers.
"""

from __future__ import annotations

from collections import deque
from typing import TYPE_CHECKING, Generic, TypeVar

if TYPE_CHECKING:
    from collections.abc import Callable


HELD_SAMPLES = 256
"""How many samples of a source that nobody judged yet are kept; the oldest go first."""

_Sample = TypeVar("_Sample")
_Exit = TypeVar("_Exit")


class Switch(Generic[_Sample, _Exit]):
    """The judgements of sources, and the samples of those that nobody has judged yet.

    Args:
        send: Given an exit and a sample that goes there.
        drop: Given a sample that goes nowhere.
    """

    def __init__(self, send: Callable[[_Exit, _Sample], None], drop: Callable[[_Sample], None]) -> None:
        self._send = send
        self._drop = drop
        self.exits: dict[bytes, _Exit | None] = {}
        self._held: dict[bytes, deque[_Sample]] = {}

    def take(self, source: bytes, sample: _Sample) -> None:
        """Send, drop or hold one sample."""
        if source not in self.exits:
            self._hold(source, sample)
        elif (exit_ := self.exits[source]) is None:
            self._drop(sample)
        else:
            self._send(exit_, sample)

    def judge(self, source: bytes, exit_: _Exit | None) -> None:
        """Say where a source's samples go, None is nowhere; what was held for it goes first."""
        self.exits[source] = exit_
        for sample in self._held.pop(source, ()):
            self.take(source, sample)

    def forget(self, source: bytes) -> None:
        """Take a source for one that was never judged."""
        self.exits.pop(source, None)
        self._drop_held(source)

    def clear(self) -> None:
        """Drop everything held and forget all sources."""
        self.exits.clear()
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
