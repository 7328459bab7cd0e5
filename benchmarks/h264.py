"""H.264 at table 2 of paper A: what encoding, decoding and each way to BGR pixels cost.

Prints processor time per frame, median over interleaved rounds, all threads counted. The picture is a pan
over Middlebury's motorcycle, which scikit-image carries. Run: python benchmarks/h264.py
"""

from __future__ import annotations

import statistics
import time
from functools import partial
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
from av.video.reformatter import Interpolation, VideoReformatter
from skimage import data

from sfglab.codecs import TABLE_2, H264Decoder, H264Encoder

if TYPE_CHECKING:
    from collections.abc import Callable

    import av
    from numpy.typing import NDArray

ROUNDS = 7
FRAMES = 90


def pan() -> list[NDArray[np.uint8]]:
    """Return frames of shape (360, 640, 3), BGR, that move three pixels right and one down each time."""
    picture = cv2.cvtColor(data.stereo_motorcycle()[0], cv2.COLOR_RGB2BGR)
    height, width = picture.shape[0] - 360, picture.shape[1] - 640
    corners = [(index % height, 3 * index % width) for index in range(FRAMES)]
    return [
        np.ascontiguousarray(picture[top : top + 360, left : left + 640]) for top, left in corners
    ]


def frame_ms(work: Callable[[], Any]) -> float:
    """Return the processor time per frame in milliseconds."""
    start = time.process_time_ns()
    work()
    return (time.process_time_ns() - start) / 1e6 / FRAMES


def i420(frame: av.VideoFrame) -> NDArray[Any]:
    """Convert by OpenCV, which knows BT.601 in limited range only."""
    return cv2.cvtColor(frame.to_ndarray(), cv2.COLOR_YUV2BGR_I420)


def conversions() -> dict[str, Callable[[av.VideoFrame], Any]]:
    """Return the ways from a decoded frame to pixels."""
    ways: dict[str, Callable[[av.VideoFrame], Any]] = {
        "planes only": lambda _: None,
        "cv2.cvtColor(I420)": i420,
        "frame.to_ndarray(format='bgr24')": lambda frame: frame.to_ndarray(format="bgr24"),
    }
    for name, flags, threads in (
        ("bilinear", Interpolation.BILINEAR, 1),
        ("point", Interpolation.POINT, 1),
        ("bilinear, accurate rounding", Interpolation.BILINEAR | Interpolation.ACCURATE_RND, 1),
        ("bilinear, a thread per processor", Interpolation.BILINEAR, 0),
    ):
        ways[f"kept VideoReformatter, {name}"] = partial(
            VideoReformatter().reformat, format="bgr24", interpolation=flags, threads=threads
        )
    return ways


def workloads(
    pictures: list[NDArray[np.uint8]], packets: list[bytes]
) -> dict[str, Callable[[], Any]]:
    """Return what is measured, by name; each opens its own encoder or decoder."""

    def encode() -> None:
        encoder = H264Encoder(TABLE_2)
        for picture in pictures:
            encoder.encode(picture)

    def decode(way: Callable[[av.VideoFrame], Any]) -> None:
        decoder = H264Decoder()
        for packet in packets:
            for frame in decoder.decode(packet):
                way(frame)

    def decode_bgr(out: NDArray[np.uint8] | None) -> None:
        decoder = H264Decoder()
        for packet in packets:
            decoder.decode_bgr(packet, out)

    rows: dict[str, Callable[[], Any]] = {"encode, BGR to packet": encode}
    for name, way in conversions().items():
        rows[f"decode, {name}"] = partial(decode, way)
    rows["decode_bgr"] = partial(decode_bgr, None)
    rows["decode_bgr into an array"] = partial(decode_bgr, np.empty((360, 640, 3), np.uint8))
    return rows


def main() -> None:
    """Measure everything in turn and print it."""
    cv2.setNumThreads(1)
    pictures = pan()
    encoder = H264Encoder(TABLE_2)
    packets = [frame.data for picture in pictures for frame in encoder.encode(picture)]
    rate_bps = sum(map(len, packets)) * 8 * TABLE_2.fps / FRAMES
    print(
        f"{encoder.encoder_name}, {rate_bps / 1e6:.3f} Mbit/s, {FRAMES} frames, median of {ROUNDS} rounds"
    )
    rows = workloads(pictures, packets)
    times: dict[str, list[float]] = {name: [] for name in rows}
    for _ in range(ROUNDS):
        for name, work in rows.items():
            times[name].append(frame_ms(work))
    planes = statistics.median(times["decode, planes only"])
    for name, measured in times.items():
        median = statistics.median(measured)
        extra = f"{median - planes:+8.2f} ms" if name.startswith("decode") else ""
        print(f"{name:66}{median:7.2f} ms{extra:>12}{median * TABLE_2.fps / 10:8.1f} % of a core")


if __name__ == "__main__":
    main()
