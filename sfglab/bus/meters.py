"""Rate of a topic over a window of its messages, as ``ros2 topic hz`` prints it."""

from __future__ import annotations

from collections import deque
from typing import Any

import numpy as np

from sfglab.units import NS_PER_S


class Rate:
    """Rate of a topic's messages over the latest `window` intervals between them."""

    def __init__(self, window: int) -> None:
        self._gaps_ns: deque[int] = deque(maxlen=window)
        self._last_ns: int | None = None

    def add(self, received_ns: int) -> None:
        """Count a message that was received at `received_ns`, ns."""
        if self._last_ns is not None:
            self._gaps_ns.append(received_ns - self._last_ns)
        self._last_ns = received_ns

    def values(self) -> dict[str, Any] | None:
        """Return rate (Hz), and minimum, maximum and standard deviation of gaps (s); None without gaps."""
        gaps_s = np.array(self._gaps_ns) / NS_PER_S
        if not gaps_s.any():
            return None
        return {
            "rate_hz": 1.0 / float(gaps_s.mean()),
            "min_s": float(gaps_s.min()),
            "max_s": float(gaps_s.max()),
            "std_dev_s": float(gaps_s.std()),
            "window": len(gaps_s),
        }

    @staticmethod
    def text(values: dict[str, Any]) -> str:
        """Return values as `ros2 topic hz` prints them."""
        gaps = "min: {min_s:.3f}s max: {max_s:.3f}s std dev: {std_dev_s:.5f}s window: {window}"
        return f"average rate: {values['rate_hz']:.3f}\n\t{gaps.format_map(values)}"
