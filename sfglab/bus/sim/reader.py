"""The simulated bus's readers: samples in the order of each writer, and what was lost on the way."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from sfglab.bus.sim.endpoint import Endpoint, Item
from sfglab.bus.sim.loop import START_NS
from sfglab.qos import Durability, Reliability

if TYPE_CHECKING:
    from collections.abc import Callable

    from sfglab.bus.queue import Sample
    from sfglab.bus.sim.writer import Writer


class Reader(Endpoint):
    """Takes samples from the writers that it knows.

    Args:
        options: As for `Endpoint`.
        push: Given each sample.

    Attributes:
        lost: Samples known to be missing between those that arrived.
    """

    __slots__ = ("_early", "_push", "latched", "lost", "reliable")

    is_writer = False

    def __init__(self, *options: Any, push: Callable[[Sample], None], **more: Any) -> None:
        super().__init__(*options, **more)
        self.lost = 0
        self.reliable = self.info.qos.reliability is Reliability.RELIABLE
        self.latched = self.info.qos.durability is Durability.TRANSIENT_LOCAL
        self._push = push
        self._early: dict[Writer, list[Item]] | None = None

    def learn(self, endpoint: Endpoint) -> None:
        """Take a writer's samples from now on, those first that were too early."""
        if not self.is_open or endpoint in self.peers:
            return
        self.peers[endpoint] = 0
        if self._early:
            for item in self._early.pop(endpoint, ()):  # type: ignore[call-overload]  # it is a writer
                self.take(endpoint, item)  # type: ignore[arg-type]
        self._notify()

    def take(self, writer: Writer, item: Item) -> None:
        """Take a sample that has arrived."""
        if not self.is_open:
            return
        sequence, cdr, stamp_ns = item
        latest = self.peers.get(writer)
        if latest is None:
            # A reliable writer repeats to a reader that has yet to hear of it; the others do not.
            if self.reliable and writer.reliable and writer.is_open:
                self._early = self._early or {}
                self._early.setdefault(writer, []).append(item)
            return
        if sequence <= latest:
            return
        if latest and sequence > latest + 1:
            self.lost += sequence - latest - 1
        self.peers[writer] = sequence
        now_ns = START_NS + self._loop.now_ns
        if writer.lifespan_ns is not None and now_ns - stamp_ns > writer.lifespan_ns:
            return
        if self._world.trace is not None:
            self._world.trace("take", self.gid, cdr)
        self._push((cdr, stamp_ns, now_ns, writer.gid))

    def silence(self) -> None:
        """Let it take nothing more."""
        super().silence()
        self._early = None
