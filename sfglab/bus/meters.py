"""Rate and bandwidth of a topic over a window of its messages, in the words of ROS 2's tools."""

from __future__ import annotations

import math
from collections import deque
from typing import Any

from sfglab.units import NS_PER_S


class Rate:
    """The rate over the latest messages."""

    def __init__(self, window: int) -> None:
        self._gaps_ns: deque[int] = deque(maxlen=window)
        self._last_ns: int | None = None

    def add(self, received_ns: int, size_bytes: int = 0) -> None:
        """Count a message that was received at a time [ns]."""
        del size_bytes
        if self._last_ns is not None:
            self._gaps_ns.append(received_ns - self._last_ns)
        self._last_ns = received_ns

    def values(self) -> dict[str, Any] | None:
        """Return rate [Hz], and least, most and standard deviation of gaps [s]; None: too few messages."""
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


class Bandwidth:
    """The bytes a second of the latest messages, their CDR's."""

    def __init__(self, window: int) -> None:
        self._seen: deque[tuple[int, int]] = deque(maxlen=window)

    def add(self, received_ns: int, size_bytes: int) -> None:
        """Count a message of a size that was received at a time [ns]."""
        self._seen.append((received_ns, size_bytes))

    def values(self) -> dict[str, Any] | None:
        """Return bandwidth, and the sizes' mean, least and most [bytes]; None: too few messages."""
        if len(self._seen) < 2 or not (span_ns := self._seen[-1][0] - self._seen[0][0]):
            return None
        sizes = [size for _, size in self._seen]
        sent = sum(sizes[1:])  # since the first message, which is where the time begins
        return {
            "bytes_per_s": sent * NS_PER_S / span_ns,
            "window": len(sizes),
            "mean_bytes": sum(sizes) / len(sizes),
            "min_bytes": min(sizes),
            "max_bytes": max(sizes),
        }

    @staticmethod
    def text(values: dict[str, Any]) -> str:
        """Return values as `ros2 topic bw` prints them."""
        power = min(2, sum(values["bytes_per_s"] >= 1000**p for p in (1, 2)))
        unit, digits = ("B", "KB", "MB")[power], (0, 2, 2)[power]

        def shown(name: str) -> str:
            return f"{values[name] / 1000**power:.{digits}f} {unit}"

        sizes = f"mean: {shown('mean_bytes')} min: {shown('min_bytes')} max: {shown('max_bytes')}"
        return f"{shown('bytes_per_s')}/s from {values['window']} messages\n\tMessage size {sizes}"
