"""What every host's interface has received, as a curve that can be asked for any instant."""

from __future__ import annotations

import asyncio
import time
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Sequence

    from sfglab.lab.testbed import CountsBytes


_PERIOD_S = 0.02


class Ingress:
    """Reads the counters of some interfaces again and again.

    On a machine that is busy readings come late; each has its own stamp, so only the curve gets coarser.

    Args:
        meters: Whose interfaces.
    """

    def __init__(self, meters: Sequence[CountsBytes]) -> None:
        self._meters = meters
        self._readings: list[list[tuple[int, int, int]]] = [[] for _ in meters]

    def read(self) -> None:
        """Read all counters once."""
        for meter, readings in zip(self._meters, self._readings, strict=True):
            counted = meter.interface_bytes()
            readings.append((time.time_ns(), counted.rx_bytes, counted.rx_packets))

    async def run(self) -> None:
        """Read until cancelled."""
        while True:
            self.read()
            await asyncio.sleep(_PERIOD_S)

    def between(self, host: int, start_ns: int, end_ns: int) -> tuple[float, float]:
        """Return the bytes and frames that a host received, interpolated between readings.

        Args:
            host: Its place among the meters.
            start_ns: Unix time, nanoseconds.
            end_ns: The same.
        """
        table = np.array(self._readings[host], dtype=np.int64)
        times_s = (table[:, 0] - start_ns) / 1e9
        ends_s = (0.0, (end_ns - start_ns) / 1e9)
        received, packets = (np.diff(np.interp(ends_s, times_s, table[:, i] - table[0, i])) for i in (1, 2))
        return float(received[0]), float(packets[0])
