"""The readers that a writer knows, by participant, and the acknowledgements that they owe to the books."""

from __future__ import annotations

from typing import TYPE_CHECKING

from sfglab.bus.sim.traffic import Load
from sfglab.bus.sim.wire import (
    ACKNACK_BYTES,
)

if TYPE_CHECKING:
    from sfglab.bus.sim.participant import Participant
    from sfglab.bus.sim.reader import Reader


class Audience:
    """Who hears a writer.

    Each acknowledgement is booked at once with the writer, and with the readers' hosts only when somebody asks
    or they leave: so it costs the same however many readers there are.

    Args:
        owner: Whose writer it is.

    Attributes:
        remote: The participants on other hosts that have readers of it.
    """

    __slots__ = ("_owing", "_owner", "_readers", "_rounds", "remote")

    def __init__(self, owner: Participant) -> None:
        self.remote: dict[Participant, None] = {}
        self._owner = owner
        self._readers: dict[Participant, list[Reader]] = {}
        self._owing: dict[Participant, int] = {}
        self._rounds = 0

    def add(self, reader: Reader, *, acknowledges: bool) -> None:
        """Take in a reader."""
        participant = reader.participant
        self._readers.setdefault(participant, []).append(reader)
        if participant.host is not self._owner.host:
            self.remote[participant] = None
            if acknowledges:
                self._owing.setdefault(participant, self._rounds)

    def remove(self, reader: Reader) -> None:
        """Let a reader go."""
        participant = reader.participant
        readers = self._readers[participant]
        readers.remove(reader)
        if not readers:
            del self._readers[participant]
            self.remote.pop(participant, None)
            self._pay(participant)
            self._owing.pop(participant, None)

    def readers_of(self, participant: Participant) -> tuple[Reader, ...]:
        """Return a participant's readers."""
        return tuple(self._readers.get(participant, ()))

    def acknowledge(self) -> None:
        """Book that all who do acknowledge what they have heard."""
        self._rounds += 1
        self._owner.host.rx[Load.ACKS] += ACKNACK_BYTES * len(self._owing)

    def settle(self) -> None:
        """Book with the readers' hosts what they have sent."""
        for participant in self._owing:
            self._pay(participant)

    def _pay(self, participant: Participant) -> None:
        since = self._owing.get(participant)
        if since is not None:
            participant.host.tx[Load.ACKS] += ACKNACK_BYTES * (self._rounds - since)
            self._owing[participant] = self._rounds
