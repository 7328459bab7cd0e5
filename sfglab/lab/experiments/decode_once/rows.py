"""The rows that the decode-once experiment writes into its log, one class a table."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True, kw_only=True)
class CellRow:
    """One cell: a number of subscribers in one mode, measured once."""

    cell: int  #: Counter from 0.
    codec: str  #: The stream's codec.
    mode: str  #: ``standard``, ``proxy`` or ``network``.
    subscribers: int  #: Local subscribers.
    repeat: int  #: Which repetition.
    first_frame_s: float  #: From the order to look until every subscriber had a frame, seconds.


@dataclass(frozen=True, slots=True, kw_only=True)
class LoadRow:
    """One meter reading in a cell."""

    cell: int  #: The cell.
    label: str  #: ``consumer`` or ``edge``.
    cpu_percent: float  #: CPU of the host's processes, per cent of one core.
    rx_mbit_s: float  #: Received at the host's interface, Mbit/s.
    tx_mbit_s: float  #: Sent at the host's interface, Mbit/s.
    window_s: float  #: Length of the reading's window, seconds.
    machine_percent: float  #: Everything else that ran on the machine, per cent of one core.
    steal_percent: float  #: Time the hypervisor took, per cent of one core.


@dataclass(frozen=True, slots=True, kw_only=True)
class ViewRow:
    """What one subscriber saw in a cell."""

    cell: int  #: The cell.
    viewer: int  #: Which subscriber.
    frames: int  #: Pictures (messages, in mode ``network``).
    unreadable: int  #: Pictures whose visible number could not be read.
    missed: int  #: Numbers skipped.
    disordered: int  #: Pictures that were not newer than the one before.
    broken: int  #: Messages that could not be decoded.
    checksum: str  #: Exclusive or over all pixels read, hexadecimal.
    age_ms: float  #: Median time from capture stamp to picture in hand, milliseconds; NaN in mode ``network``.


@dataclass(frozen=True, slots=True, kw_only=True)
class PairRow:
    """A picture that a subscriber held: the number in its pixels and the stamp in its header."""

    cell: int  #: The cell.
    viewer: int  #: Which subscriber.
    number: int  #: Read from the pixels.
    stamp_ns: int  #: Capture stamp.


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraRow:
    """A frame that the camera sent."""

    codec: str  #: The stream's codec.
    number: int  #: Drawn into its pixels.
    stamp_ns: int  #: Capture stamp.
    size_bytes: int  #: Compressed size.
