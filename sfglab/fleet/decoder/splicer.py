"""Late-join splicer: joins a running video stream from its replay and continues live without a gap.

Two sources carry the same numbered packets, in any order and with gaps: the live stream, and the replay
(`sfglab.fleet.gop_cache`) that repeats the group of pictures from its key frame. The splicer makes one
chain of them, which begins with a key frame and has no gap. It also decides which frames are shown, and
when the replay is no longer needed. It ends with the live stream alone, and falls back to it. The module is
pure: it depends on numbers and key frames only.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from enum import Enum, auto
from typing import Any

from sfglab.messages.packets import PacketOrder

#: Maximum number of packets that wait for a missing one; beyond it, the missing one is given up.
MOST_AHEAD = 512


class Source(Enum):
    """Source of a packet."""

    LIVE = auto()  #: The live stream.
    REPLAY = auto()  #: The replay of a GOP cache.


class Phase(Enum):
    """Phase of joining a stream."""

    JOINING = auto()  #: Both sources are needed.
    CONNECTED = auto()  #: The live stream has reached the chain; the replay is no longer needed.
    FOLLOWING = auto()  #: Packets of the live stream pass as they arrive, gaps included.


@dataclass(frozen=True, slots=True)
class Step:
    """The next packet to decode."""

    packet: Any  #: The packet, or a value that represents it.
    #: Whether its frame is shown; otherwise it is decoded for the frames that follow.
    show: bool


@dataclass(frozen=True, slots=True)
class _Packet:
    pts: int
    is_key: bool
    shown: bool
    content: Any


class Splicer:
    """Splicer of one stream; without a replay, packets of the live stream pass as they arrive from the start.

    Subscribers may have seen frames up to the number `after`.
    """

    def __init__(self, *, replay: bool, after: int = -1) -> None:
        self.phase = Phase.JOINING if replay else Phase.FOLLOWING  #: Current phase.
        self._chain: deque[_Packet] = deque()  # contiguous, not decoded yet
        self._ahead: dict[int, _Packet] = {}  # beyond the chain's end
        self._start: int | None = None  # of the chain, decoded part included
        self._end = -1
        self._newest_live: int | None = None
        self._key_needed = False
        self._after = after
        self._shown_one = False
        self._order = PacketOrder()  # of the live stream

    @property
    def done(self) -> bool:
        """Whether nothing remains to be decided: each further packet of the live stream follows."""
        return self.phase is Phase.FOLLOWING and not self._key_needed and not self._chain

    @property
    def needs_replay(self) -> bool:
        """Whether the replay is still needed."""
        return self.phase is Phase.JOINING

    def take(
        self, packet: Any, source: Source, *, pts: int, is_key: bool, shown: bool = True
    ) -> None:
        """Process a packet of a source, numbered by `pts` without gaps; a decoder may start where `is_key`.

        A live stream whose `pts` are times instead of numbers passes as it arrives, from its next key frame
        on.
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
        """Continue without the replay, from the live stream's next key frame."""
        if self.phase is Phase.JOINING:
            self._ahead.clear()
            self._key_needed = True
            self.phase = Phase.FOLLOWING

    def next(self) -> Step | None:
        """Return the next packet to decode; None if no packet is ready.

        Until the first frame is shown, only the newest available one is worth showing, because the others
        are outdated. After the live stream has reached the chain, the last frame of the chain is current.
        Before that, a replay that another reader requested may contain seconds of the past. A further frame
        of it must therefore be as new as the live stream, and so must a first frame that may have been
        seen.
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

    def _take_joining(self, packet: _Packet, source: Source) -> None:
        beyond = self._start is None or packet.pts > self._end
        if packet.is_key and beyond:
            self._begin(packet)
            if source is Source.LIVE:
                # The live stream begins with a key frame: packets lost before it are not needed.
                self._start = None
                self._connect()
                return
        elif beyond:
            self._ahead.setdefault(packet.pts, packet)
        if source is Source.LIVE:
            self._newest_live = packet.pts
        self._extend()

    def _take_following(self, packet: _Packet) -> None:
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

    def _is_past(self, packet: _Packet) -> bool:
        # A key frame from before the chain is not outdated: the sender has restarted.
        before = self._start is not None and packet.pts < self._start
        return self._holds(packet.pts) or (before and not packet.is_key)

    def _begin(self, packet: _Packet) -> None:
        self._chain.clear()
        self._chain.append(packet)
        self._start = self._end = packet.pts
        self._ahead = {pts: p for pts, p in self._ahead.items() if pts > packet.pts}

    def _extend(self) -> None:
        """Append contiguous packets; connect when the chain contains the newest live packet."""
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
