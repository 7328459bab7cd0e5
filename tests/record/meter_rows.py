"""A table's row, in a module whose name is its own: documentation of fields is read from the module."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True, kw_only=True)
class MeterRow:
    """One reading."""

    agent: str  #: Name of the measured process.
    received: int  #: Messages, a count.
    mean_s: float  #: Mean latency, in seconds.
    lossless: bool  #: Whether all came.
