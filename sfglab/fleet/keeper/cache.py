"""The packets of a video stream since its last key frame: all that a decoder needs to be up to date.

Pure. Knows packet numbers, key frames and sizes; refuses to know messages, topics and clocks.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Generic, TypeVar

from sfglab.errors import SfglabError

M = TypeVar("M")


class LimitsError(SfglabError, ValueError):
    """Limits within which no group of pictures fits."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Limits:
    """How much of one stream is kept."""

    packets: int = 256  #: The longest group of pictures, in packets.
    size_bytes: int = 8_000_000  #: The largest one. The default is two seconds of 32 Mbit/s.

    def __post_init__(self) -> None:
        for name in ("packets", "size_bytes"):
            if getattr(self, name) < 1:
                raise LimitsError(
                    f"group of pictures: given {name}={getattr(self, name)}, allowed is 1 or more"
                )


class GopCache(Generic[M]):
    """Keeps the group of pictures that is under way.

    After a packet that went missing, or when a group outgrows the limits, nothing is kept until the next key
    frame: the part of a group that lacks its end is of no use to a decoder that joins.

    Args:
        limits: How much is kept at most.

    Attributes:
        size_bytes: Size of what is kept.
        gaps: How often packets went missing.
        overflows: How often a group outgrew the limits.
    """

    def __init__(self, limits: Limits | None = None) -> None:
        self.size_bytes = 0
        self.gaps = 0
        self.overflows = 0
        self._limits = limits or Limits()
        self._packets: list[M] = []
        self._next_pts = 0

    def __len__(self) -> int:
        return len(self._packets)

    @property
    def packets(self) -> tuple[M, ...]:
        """The packets that are kept, the key frame first."""
        return tuple(self._packets)

    def add(self, packet: M, *, pts: int, is_key: bool, size_bytes: int) -> bool:
        """Take the next packet of the stream.

        Args:
            packet: Whatever stands for it.
            pts: Its number; a stream's packets are numbered without gaps.
            is_key: Whether a decoder may start here.
            size_bytes: Its size.

        Returns:
            Whether it is kept, so that what is kept now ends with it.
        """
        if is_key:
            self._clear()
        elif not self._packets:
            return False
        elif pts != self._next_pts:
            self.gaps += 1
            self._clear()
            return False
        if len(self._packets) >= self._limits.packets or self.size_bytes + size_bytes > self._limits.size_bytes:
            self.overflows += 1
            self._clear()
            return False
        self._packets.append(packet)
        self.size_bytes += size_bytes
        self._next_pts = pts + 1
        return True

    def _clear(self) -> None:
        self._packets.clear()
        self.size_bytes = 0
