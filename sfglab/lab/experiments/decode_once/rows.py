"""The rows that the decode-once experiment writes into its log, one class a table."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["CameraRow", "CellRow", "LoadRow", "PairRow", "ViewRow"]


@dataclass(frozen=True, slots=True, kw_only=True)
class CellRow:
    """One cell: a number of subscribers in one mode, measured once.

    Attributes:
        cell: Counter from 0.
        codec: The stream's codec.
        mode: ``standard``, ``proxy`` or ``network``.
        subscribers: Local subscribers.
        repeat: Which repetition.
        first_frame_s: From the order to look until every subscriber had a frame, seconds.
    """

    cell: int
    codec: str
    mode: str
    subscribers: int
    repeat: int
    first_frame_s: float


@dataclass(frozen=True, slots=True, kw_only=True)
class LoadRow:
    """One meter reading in a cell.

    Attributes:
        cell: The cell.
        label: ``consumer`` or ``edge``.
        cpu_percent: CPU of the host's processes, per cent of one core.
        rx_mbit_s: Received at the host's interface, Mbit/s.
        tx_mbit_s: Sent at the host's interface, Mbit/s.
        window_s: Length of the reading's window, seconds.
        machine_percent: Everything else that ran on the machine, per cent of one core.
        steal_percent: Time the hypervisor took, per cent of one core.
    """

    cell: int
    label: str
    cpu_percent: float
    rx_mbit_s: float
    tx_mbit_s: float
    window_s: float
    machine_percent: float
    steal_percent: float


@dataclass(frozen=True, slots=True, kw_only=True)
class ViewRow:
    """What one subscriber saw in a cell.

    Attributes:
        cell: The cell.
        viewer: Which subscriber.
        frames: Pictures (messages, in mode ``network``).
        unreadable: Pictures whose visible number could not be read.
        missed: Numbers skipped.
        disordered: Pictures that were not newer than the one before.
        broken: Messages that could not be decoded.
        checksum: Exclusive or over all pixels read, hexadecimal.
        age_ms: Median time from capture stamp to picture in hand, milliseconds; NaN in mode ``network``.
    """

    cell: int
    viewer: int
    frames: int
    unreadable: int
    missed: int
    disordered: int
    broken: int
    checksum: str
    age_ms: float


@dataclass(frozen=True, slots=True, kw_only=True)
class PairRow:
    """A picture that a subscriber held: the number in its pixels and the stamp in its header.

    Attributes:
        cell: The cell.
        viewer: Which subscriber.
        number: Read from the pixels.
        stamp_ns: Capture stamp.
    """

    cell: int
    viewer: int
    number: int
    stamp_ns: int


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraRow:
    """A frame that the camera sent.

    Attributes:
        codec: The stream's codec.
        number: Drawn into its pixels.
        stamp_ns: Capture stamp.
        size_bytes: Compressed size.
    """

    codec: str
    number: int
    stamp_ns: int
    size_bytes: int
