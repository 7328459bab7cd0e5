"""The rows that the latency experiment writes into its log, one class a table."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True, kw_only=True)
class LookRow:
    """One subscription: from the order to subscribe to the order to stop."""

    look: int  #: Counter from 0.
    repeat: int  #: Which repetition.
    path: str  #: One of `PATHS`.
    phase: float  #: When the order was to be given, as a share of the group of pictures, 0 at its key frame.
    ordered_ns: int  #: When the viewer had the order to subscribe (Unix time).
    first_ns: int  #: When it had its first picture in hand (Unix time).
    pictures: int  #: Pictures it saw.
    unreadable: int  #: Pictures whose visible number could not be read.
    missed: int  #: Numbers skipped between two pictures.
    disordered: int  #: Pictures that were not newer than the one before.
    broken: int  #: Messages that the viewer could not decode.
    replay_packets: int  #: Packets in the keepers' bursts for this look; 0 without a replay.
    replay_bytes: int  #: Their size.


@dataclass(frozen=True, slots=True, kw_only=True)
class SightRow:
    """A picture in the viewer's hands."""

    look: int  #: The look.
    number: int  #: Read from its pixels.
    seen_ns: int  #: When it was in hand (Unix time).


@dataclass(frozen=True, slots=True, kw_only=True)
class ShotRow:
    """A frame that the camera sent."""

    number: int  #: Drawn into its pixels.
    stamp_ns: int  #: Capture stamp (Unix time).
    size_bytes: int  #: Compressed size.


@dataclass(frozen=True, slots=True, kw_only=True)
class IdleRow:
    """What something costs on the camera's host while nobody looks, in one window."""

    label: str  #: ``camera``, ``keeper`` or ``router``; ``keeper`` is the one in the agent's own domain.
    cpu_percent: float  #: CPU of its process, per cent of one core.
    tx_mbit_s: float  #: Sent at the host's interface by everybody, Mbit/s.
    loopback_mbit_s: float  #: Carried by the host's loopback for everybody, Mbit/s.
    window_s: float  #: Length of the window, seconds.
