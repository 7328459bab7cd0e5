"""The bounded queue between a transport and a subscription's reader.

Pure: knows samples and limits, no thread, no clock and no loop. What does not fit pushes out the oldest,
and is counted, so a slow subscription costs memory and time up to its own limit and stalls nobody.
"""

from __future__ import annotations

import threading
from collections import deque
from typing import TYPE_CHECKING

from sfglab.qos import History, QoSProfile

if TYPE_CHECKING:
    from collections.abc import Iterable


KEEP_ALL_LIMIT_BYTES = 256 * 2**20
"""How much a KEEP_ALL subscription may queue; beyond it even KEEP_ALL drops the oldest, and counts."""

Sample = tuple[bytes | memoryview, int, int, bytes]
"""CDR, source time stamp (ns), reception time stamp (ns), publisher's gid: a plain tuple, for it is made
for every message."""

# Bookkeeping of a queued sample in CPython, so that a flood of empty messages is bounded too.
_OVERHEAD_BYTES = 256


class SampleQueue:
    """A first-in-first-out queue bounded as a QoS history says.

    Args:
        qos: KEEP_LAST holds `depth` samples, KEEP_ALL `limit_bytes`.
        limit_bytes: The bound of KEEP_ALL, in bytes.

    Attributes:
        dropped: Samples pushed out before they were read.
    """

    def __init__(self, qos: QoSProfile, *, limit_bytes: int = KEEP_ALL_LIMIT_BYTES) -> None:
        self.dropped = 0
        self._depth = qos.depth if qos.history is History.KEEP_LAST else None
        self._limit_bytes = limit_bytes
        self._bytes = 0
        self._samples: deque[Sample] = deque()
        self._lock = threading.Lock()  # pushed by the transport's thread, popped by the loop's

    def __len__(self) -> int:
        return len(self._samples)

    def push(self, samples: Iterable[Sample]) -> None:
        """Append samples, oldest first."""
        with self._lock:
            for sample in samples:
                self._samples.append(sample)
                self._bytes += len(sample[0]) + _OVERHEAD_BYTES
                while self._over():
                    self._bytes -= len(self._samples.popleft()[0]) + _OVERHEAD_BYTES
                    self.dropped += 1

    def pop(self) -> Sample | None:
        """Remove and return the oldest sample, None when empty."""
        with self._lock:
            if not self._samples:
                return None
            sample = self._samples.popleft()
            self._bytes -= len(sample[0]) + _OVERHEAD_BYTES
            return sample

    def clear(self) -> None:
        """Forget all samples, uncounted."""
        with self._lock:
            self._samples.clear()
            self._bytes = 0

    def _over(self) -> bool:
        if self._depth is not None:
            return len(self._samples) > self._depth
        return self._bytes > self._limit_bytes and len(self._samples) > 1
