"""The rows that the latency experiment writes into its log, one class a table."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["IdleRow", "LookRow", "ShotRow", "SightRow"]


@dataclass(frozen=True, slots=True, kw_only=True)
class LookRow:
    """One subscription: from the order to subscribe to the order to stop.

    Attributes:
        look: Counter from 0.
        repeat: Which repetition.
        path: One of `PATHS`.
        phase: When the order was to be given, as a share of the group of pictures, 0 at its key frame.
        ordered_ns: When the viewer had the order to subscribe (Unix time).
        first_ns: When it had its first picture in hand (Unix time).
        pictures: Pictures it saw.
        unreadable: Pictures whose visible number could not be read.
        missed: Numbers skipped between two pictures.
        disordered: Pictures that were not newer than the one before.
        broken: Messages that the viewer could not decode.
        replay_packets: Packets in the keepers' bursts for this look; 0 without a replay.
        replay_bytes: Their size.
    """

    look: int
    repeat: int
    path: str
    phase: float
    ordered_ns: int
    first_ns: int
    pictures: int
    unreadable: int
    missed: int
    disordered: int
    broken: int
    replay_packets: int
    replay_bytes: int


@dataclass(frozen=True, slots=True, kw_only=True)
class SightRow:
    """A picture in the viewer's hands.

    Attributes:
        look: The look.
        number: Read from its pixels.
        seen_ns: When it was in hand (Unix time).
    """

    look: int
    number: int
    seen_ns: int


@dataclass(frozen=True, slots=True, kw_only=True)
class ShotRow:
    """A frame that the camera sent.

    Attributes:
        number: Drawn into its pixels.
        stamp_ns: Capture stamp (Unix time).
        size_bytes: Compressed size.
    """

    number: int
    stamp_ns: int
    size_bytes: int


@dataclass(frozen=True, slots=True, kw_only=True)
class IdleRow:
    """What something costs on the camera's host while nobody looks, in one window.

    Attributes:
        label: ``camera``, ``keeper`` or ``router``; ``keeper`` is the one in the agent's own domain.
        cpu_percent: CPU of its process, per cent of one core.
        tx_mbit_s: Sent at the host's interface by everybody, Mbit/s.
        loopback_mbit_s: Carried by the host's loopback for everybody, Mbit/s.
        window_s: Length of the window, seconds.
    """

    label: str
    cpu_percent: float
    tx_mbit_s: float
    loopback_mbit_s: float
    window_s: float
