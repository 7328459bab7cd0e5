"""What happens in a world, event by event, and its digest: two runs are equal exactly if their digests are."""

from __future__ import annotations

import hashlib
import struct
from dataclasses import dataclass


@dataclass(frozen=True, slots=True, kw_only=True)
class TraceEvent:
    """Something that happened."""

    time_ns: int  #: When, virtual nanoseconds since the start.
    what: str  #: "join", "leave", "crash", "open", "close", "send", "take", "part" or "heal".
    gid: bytes  #: Of the endpoint or participant; empty for what happens to the network.
    data: bytes  #: The sample's CDR, the topic of what is opened, the name of who joins.


class TraceDigest:
    """Hashes events as they happen.

    Attributes:
        count: How many there were.
    """

    def __init__(self) -> None:
        self.count = 0
        self._hash = hashlib.blake2b(digest_size=16)

    def __call__(self, event: TraceEvent) -> None:
        """Take one event."""
        self.count += 1
        for part in (event.what.encode(), event.gid, event.data):
            self._hash.update(struct.pack("<qI", event.time_ns, len(part)) + part)

    def hexdigest(self) -> str:
        """Return the digest of all events so far."""
        return self._hash.hexdigest()
