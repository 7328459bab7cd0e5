"""Bytes that a host's interface has carried, by what they were for.

Knows sums. Refuses to know sizes (`wire`) and who sends to whom (`domain`).
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from typing import TYPE_CHECKING, Self

if TYPE_CHECKING:
    from collections.abc import Sequence


class Load(IntEnum):
    """What bytes are for."""

    DATA = 0
    """Samples, with the heartbeats in their packets."""
    ACKS = 1
    """Heartbeats and acknowledgements of samples."""
    DISCOVERY = 2
    """Participants and endpoints that announce themselves, and liveliness."""
    DISCOVERY_ACKS = 3
    """Heartbeats and acknowledgements of discovery."""


@dataclass(frozen=True, slots=True, kw_only=True)
class KindBytes:
    """Bytes of Ethernet frames in one direction, by what they were for."""

    data: int = 0  #: Samples, with the heartbeats in their packets.
    acks: int = 0  #: Heartbeats and acknowledgements of samples.
    discovery: int = 0  #: Announcements of participants and endpoints, and of liveliness.
    discovery_acks: int = 0  #: Heartbeats and acknowledgements of discovery.

    @property
    def total(self) -> int:
        """All of them."""
        return self.data + self.acks + self.discovery + self.discovery_acks

    @classmethod
    def of(cls, counts: Sequence[int]) -> Self:
        """Return counts by `Load` as a value."""
        return cls(
            data=counts[Load.DATA],
            acks=counts[Load.ACKS],
            discovery=counts[Load.DISCOVERY],
            discovery_acks=counts[Load.DISCOVERY_ACKS],
        )

    def since(self, earlier: KindBytes) -> KindBytes:
        """Return what has come on top of an earlier count."""
        return KindBytes(
            data=self.data - earlier.data,
            acks=self.acks - earlier.acks,
            discovery=self.discovery - earlier.discovery,
            discovery_acks=self.discovery_acks - earlier.discovery_acks,
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class HostTraffic:
    """What one host's interface to the network has carried."""

    rx: KindBytes = KindBytes()  #: Into the host.
    tx: KindBytes = KindBytes()  #: Out of it.

    def since(self, earlier: HostTraffic) -> HostTraffic:
        """Return what has come on top of an earlier count."""
        return HostTraffic(rx=self.rx.since(earlier.rx), tx=self.tx.since(earlier.tx))
