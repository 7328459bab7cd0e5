"""Rate of a topic over a window of its messages, as ``ros2 topic hz`` prints it."""

from __future__ import annotations

import math
from collections import deque
from typing import Any

from sfglab.units import NS_PER_S


class Rate:
    """Rate over the latest messages."""

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
        gaps = self._gaps_ns
        if not gaps or not (mean := sum(gaps) / len(gaps)):
            return None
        deviation = math.sqrt(sum((gap - mean) ** 2 for gap in gaps) / len(gaps))
        times = {"min_s": min(gaps), "max_s": max(gaps), "std_dev_s": deviation}
        return {
            "rate_hz": NS_PER_S / mean,
            **{k: v / NS_PER_S for k, v in times.items()},
            "window": len(gaps),
        }

    @staticmethod
    def text(values: dict[str, Any]) -> str:
        """Return values as `ros2 topic hz` prints them."""
        gaps = "min: {min_s:.3f}s max: {max_s:.3f}s std dev: {std_dev_s:.5f}s window: {window}"
        return f"average rate: {values['rate_hz']:.3f}\n\t{gaps.format_map(values)}"
