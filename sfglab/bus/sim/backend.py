"""Backend of a simulated node, with its clock."""

from __future__ import annotations

from typing import TYPE_CHECKING

from sfglab.bus.backend import Backend, Clock
from sfglab.bus.sim.endpoints import Reader, Writer
from sfglab.bus.sim.loop import START_NS, VirtualLoop

if TYPE_CHECKING:
    from collections.abc import Callable
    from random import Random

    from sfglab.bus.api import RawEndpoint
    from sfglab.bus.endpoints import Inbox
    from sfglab.bus.sim.domain import Participant


class SimClock(Clock):
    """Virtual clock of a simulated world, which advances only when all tasks wait."""

    def __init__(self, loop: VirtualLoop) -> None:
        self._loop = loop

    def now_ns(self) -> int:
        """Return the current virtual time, in nanoseconds since the Unix epoch."""
        return START_NS + self._loop.now_ns


class SimBackend(Backend):
    """Backend with a participant of a simulated domain, which it has joined."""

    kind = "simulated"

    def __init__(self, participant: Participant, random: Random) -> None:
        super().__init__()
        self.participant = participant
        self.guid = participant.guid
        self.graph = participant.graph
        self.clock = SimClock(participant.domain.loop)
        self._random = random

    def open_writer(self, endpoint: RawEndpoint, notify: Callable[[], None]) -> Writer:
        """Return a new writer of the participant; see `Backend.open_writer`."""
        writer = Writer(self.participant, endpoint, notify)
        self.participant.open(writer)
        return writer

    def open_reader(
        self, endpoint: RawEndpoint, notify: Callable[[], None], inbox: Inbox
    ) -> Reader:
        """Return a new reader of the participant; see `Backend.open_reader`."""
        reader = Reader(self.participant, endpoint, notify, inbox=inbox)
        self.participant.open(reader)
        return reader

    def random_bytes(self, count: int) -> bytes:
        """Return bytes that are unique among nodes, and the same in every run of the world."""
        return self._random.randbytes(count)

    def leave(self) -> None:
        """Leave the simulated domain with all endpoints of the participant."""
        self.participant.domain.leave(self.participant)
