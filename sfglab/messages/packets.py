"""Order of the packets of a video stream, by the `pts` of FFMPEGPacket."""

from __future__ import annotations

#: Largest step of `pts` that counts as lost packets: the longest group of pictures.
MOST_LOST = 256
#: Smallest step of `pts` that counts as a time: milliseconds between frames at 100 Hz.
LEAST_TIME = 10


class PacketOrder:
    """Detector of missing packets of one stream.

    ffmpeg_image_transport numbers packets, so each step but 1 means that packets are missing. Other drivers
    write a time (nanoseconds, 90 kHz, milliseconds) or always 0. A loss in such a stream cannot be
    detected. A stream in milliseconds is recognised by two successive steps of `LEAST_TIME` or more before
    any step of 1.
    """

    def __init__(self) -> None:
        #: Whether the latest difference of two `pts` is that of a time or of a constant.
        self.is_time = False
        #: Whether the latest packet has a smaller `pts`, as before a B frame.
        self.is_reordered = False
        self._last: int | None = None
        self._is_number = False
        self._time_steps = 0

    def missing(self, pts: int) -> bool:
        """Process the next packet's `pts`, and return whether packets before it are missing."""
        last, self._last = self._last, pts
        if last is None:
            return False
        step = pts - last
        self._is_number |= step == 1
        is_time_step = step == 0 or step >= LEAST_TIME
        self._time_steps = self._time_steps + 1 if is_time_step else 0
        is_far = abs(step) > MOST_LOST
        self.is_time = not self._is_number and (is_far or self._time_steps > 1)
        self.is_reordered = step < 0
        if self._is_number:
            return step != 1
        return step != 0 and not self.is_time
