"""What arrived of numbered messages: how often, in which order, with which time stamps. Pure."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from sfglab.bus.api import MessageInfo


@dataclass(slots=True)
class Tally:
    """What arrived of one source under one name."""

    numbers: set[int] = field(default_factory=set)  #: Numbers that arrived.
    received: int = 0  #: Messages, repeated ones counted again.
    repeated: int = 0  #: Messages whose number had arrived before.
    disordered: int = 0  #: Messages that arrived after a later number.
    restamped: int = 0  #: Messages whose source time stamp is not the publisher's.
    misnamed: int = 0  #: Transforms without their source's prefix, or with one that they must not have.
    ages_ns: list[int] = field(default_factory=list)  #: From publishing to receiving.

    def note(self, number: int, stamp_ns: int, info: MessageInfo) -> None:
        """Count one message."""
        self.received += 1
        self.repeated += number in self.numbers
        self.disordered += bool(self.numbers) and number < max(self.numbers)
        self.restamped += info.source_timestamp_ns != stamp_ns
        self.numbers.add(number)
        self.ages_ns.append(info.received_timestamp_ns - stamp_ns)

    def report(self) -> dict[str, Any]:
        """Return the counts as JSON values."""
        span = max(self.numbers) - min(self.numbers) + 1 if self.numbers else 0
        ages = sorted(self.ages_ns)
        return {
            "received": self.received,
            "repeated": self.repeated,
            "disordered": self.disordered,
            "restamped": self.restamped,
            "missing": span - len(self.numbers),
            "misnamed": self.misnamed,
            "age_ns": ages[len(ages) // 2] if ages else None,
        }
