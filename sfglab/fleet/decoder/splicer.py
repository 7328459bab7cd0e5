"""Late-join splicer: a video stream that is under way, from its replay first, then live, without a seam.

Two sources carry the same numbered packets, in any order and with gaps: the live stream, and the replay
(`sfglab.fleet.gop_cache`) that repeats the group of pictures from its key frame. The splicer makes one chain of
them that begins with a key frame and has no gap, says which pictures are worth showing, and when the replay can
be left. It ends in, and falls back to, the live stream alone. Pure: knows numbers and key frames.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from enum import Enum, auto
from typing import Generic, TypeVar

from sfglab.messages.packets import PacketOrder

M = TypeVar("M")

#: Packets that wait for one that is missing; beyond that it will not come any more.
MOST_AHEAD = 512


class Source(Enum):
    """Where a packet comes from."""

    LIVE = auto()
    REPLAY = auto()


class Phase(Enum):
    """How far the joining is."""

    JOINING = auto()  #: Both sources are needed.
    CONNECTED = auto()  #: The live stream has reached the chain; the replay can be left.
    FOLLOWING = auto()  #: Packets of the live stream pass as they come, gaps included.


@dataclass(frozen=True, slots=True)
class Step(Generic[M]):
    """The next packet to decode."""

    packet: M  #: The packet, or a value that represents it.
    #: Whether its picture is wanted; if not, it is decoded for the pictures that follow.
    show: bool


@dataclass(frozen=True, slots=True)
class _Packet(Generic[M]):
    pts: int
    is_key: bool
    shown: bool
    content: M


class Splicer(Generic[M]):
    """Joins one stream once; without a replay to begin with, packets of the live stream pass as they come.

    Pictures up to the number `after` may have been seen before.
    """

    def __init__(self, *, replay: bool, after: int = -1) -> None:
        self.phase = Phase.JOINING if replay else Phase.FOLLOWING  #: Current phase.
        self._chain: deque[_Packet[M]] = deque()  # contiguous, not decoded yet
        self._ahead: dict[int, _Packet[M]] = {}  # beyond the chain's end
        self._start: int | None = None  # of the chain, decoded part included
        self._end = -1
        self._newest_live: int | None = None
        self._key_needed = False
        self._after = after
        self._shown_one = False
        self._order = PacketOrder()  # of the live stream

    @property
    def done(self) -> bool:
        """Whether it has nothing to decide any more: each further packet of the live stream follows."""
        return self.phase is Phase.FOLLOWING and not self._key_needed and not self._chain

    @property
    def needs_replay(self) -> bool:
        """Whether the replay is of any more use."""
        return self.phase is Phase.JOINING

    def take(
        self, packet: M, source: Source, *, pts: int, is_key: bool, shown: bool = True
    ) -> None:
        """Take a packet of a source, numbered by `pts` without gaps; a decoder may start where `is_key`.

        A live stream whose `pts` are no numbers passes as it comes, from its next key frame on.
        """
        taken = _Packet(pts, is_key, shown, packet)
        if source is Source.LIVE:
            self._order.missing(pts)
            if self._order.is_time and (self.needs_replay or self._start is not None):
                self._ahead.clear()
                self._start, self._key_needed, self.phase = None, True, Phase.FOLLOWING
        if self.phase is Phase.JOINING:
            self._take_joining(taken, source)
        elif source is Source.LIVE:
            self._take_following(taken)

    def give_up(self) -> None:
        """Go on without the replay, from the live stream's next key frame."""
        if self.phase is Phase.JOINING:
            self._ahead.clear()
            self._key_needed = True
            self.phase = Phase.FOLLOWING

    def next(self) -> Step[M] | None:
        """Return what to decode next, of what has come so far; None: nothing is ready.

        Until the first picture is shown, only the newest one at hand is worth showing: the others are the past.
        Once the live stream has reached the chain its last picture is the present. Until then a replay that
        another asked for may run through seconds of the past: a further picture of it, and a first one that may
        have been seen, has to be as new as the live stream.
        """
        if not self._chain:
            return None
        packet = self._chain.popleft()
        unseen = not self._shown_one and packet.pts > self._after
        new = unseen if self._newest_live is None else packet.pts >= self._newest_live
        new = new or self.phase is Phase.FOLLOWING
        current = self.phase is Phase.CONNECTED or (packet.shown and new)
        show = current and (self._shown_one or not self._chain)
        self._shown_one |= show
        return Step(packet.content, show)

    def _take_joining(self, packet: _Packet[M], source: Source) -> None:
        beyond = self._start is None or packet.pts > self._end
        if packet.is_key and beyond:
            self._begin(packet)
            if source is Source.LIVE:
                # The stream itself begins here; what is missing before it does not matter any more.
                self._start = None
                self._connect()
                return
        elif beyond:
            self._ahead.setdefault(packet.pts, packet)
        if source is Source.LIVE:
            self._newest_live = packet.pts
        self._extend()

    def _take_following(self, packet: _Packet[M]) -> None:
        if self._key_needed and not packet.is_key:
            return
        if self._is_past(packet):
            return  # the replay was faster
        self._key_needed = False
        self._start = None
        self.phase = Phase.FOLLOWING
        self._chain.append(packet)

    def _holds(self, pts: int) -> bool:
        return self._start is not None and self._start <= pts <= self._end

    def _is_past(self, packet: _Packet[M]) -> bool:
        # A key frame from before the chain is not old: the sender has restarted.
        before = self._start is not None and packet.pts < self._start
        return self._holds(packet.pts) or (before and not packet.is_key)

    def _begin(self, packet: _Packet[M]) -> None:
        self._chain.clear()
        self._chain.append(packet)
        self._start = self._end = packet.pts
        self._ahead = {pts: p for pts, p in self._ahead.items() if pts > packet.pts}

    def _extend(self) -> None:
        """Append contiguous packets; connect when live is reached."""
        if self._start is not None:
            while (packet := self._ahead.pop(self._end + 1, None)) is not None:
                self._chain.append(packet)
                self._end = packet.pts
        if self._newest_live is not None and self._holds(self._newest_live):
            self._connect()
        elif len(self._ahead) > MOST_AHEAD:
            self.give_up()

    def _connect(self) -> None:
        self._ahead.clear()
        self.phase = Phase.CONNECTED
