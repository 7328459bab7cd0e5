"""RVL against our own format, Zstandard, PNG and plain scalar RVL, in one run on the same depth frames.

Prints the median over interleaved rounds, so that a busy machine slows all rows alike, and the ratios to
RVL. Depth comes from the ground-truth disparities of Middlebury's motorcycle, which scikit-image carries,
scaled to 640 x 360: as it is, and with the noise of a stereo camera; and from the elevations, in metres, of a
mountain ridge, which Matplotlib carries: no camera's, but surveyed. Run: python benchmarks/depth_codecs.py
"""

from __future__ import annotations

import importlib
import statistics
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import cv2
import numba
import numpy as np
import zstandard
from matplotlib import cbook
from skimage import data

from sfglab.codecs import med, rvl
from sfglab.codecs.depth import PNG_LEVEL
from sfglab.codecs.still import decode_still, encode_png

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

sys.path.append(str(Path(__file__).parents[1] / "tests" / "codecs"))
rvl_reference = importlib.import_module("rvl_reference")  # the tests' plain implementation

ROUNDS = 21
FOCAL_PX, BASELINE_MM, OFFSET_PX = (
    994.978,
    193.001,
    31.086,
)  # from the docstring of stereo_motorcycle
NOISE_PX = 0.06  # disparity noise of a small stereo camera


def depth_frames() -> dict[str, NDArray[np.uint16]]:
    """Return depth images by name: of shape (360, 640) in millimetres, and a surveyed ridge, (344, 403)."""
    disparity = data.stereo_motorcycle()[2]
    disparity = cv2.resize(disparity, (640, 360), interpolation=cv2.INTER_NEAREST)
    noise = np.random.default_rng(0).normal(0, NOISE_PX, disparity.shape)

    def millimetres(disparity_px: NDArray[Any]) -> NDArray[np.uint16]:
        seen = np.isfinite(disparity)
        depth = FOCAL_PX * BASELINE_MM / (np.where(seen, disparity_px, 1) + OFFSET_PX)
        return np.where(seen, depth.round(), 0).astype(np.uint16)

    with cbook.get_sample_data("jacksboro_fault_dem.npz") as survey:
        ridge = survey["elevation"].astype(np.uint16)
    return {
        "ground truth": millimetres(disparity),
        "with noise": millimetres(disparity + noise),
        "ridge": np.ascontiguousarray(ridge),
    }


def scalar_functions() -> tuple[Callable[..., Any], Callable[..., Any]]:
    """Return the reference implementation, compiled; without packing words, which is in its favour."""
    encode: Any = numba.njit(rvl_reference.encode_nibbles)
    decode: Any = numba.njit(rvl_reference.decode_nibbles)
    pixels, nibbles = np.ones(9, np.uint16), np.zeros(80, np.uint8)
    encode(pixels, nibbles)
    decode(nibbles, pixels)
    return encode, decode


def contenders(
    depth: NDArray[np.uint16],
) -> dict[str, tuple[Callable[[], Any], Callable[[], Any], int]]:
    """Return for each codec how to encode and how to decode the frame, and its size in bytes."""
    scalar_encode, scalar_decode = scalar_functions()
    flat, nibbles = depth.reshape(-1), np.zeros(8 * depth.size + 8, np.uint8)
    out = np.empty_like(depth)
    words = rvl.encode(depth)
    count = scalar_encode(flat, nibbles)
    frame, raw = med.encode(depth), depth.tobytes()
    zstd, unzstd = zstandard.ZstdCompressor(level=1), zstandard.ZstdDecompressor()
    packed = zstd.compress(raw)
    rows: dict[str, tuple[Callable[[], Any], Callable[[], Any], int]] = {
        "RVL": (
            lambda: rvl.encode(depth),
            lambda: rvl.decode(words, depth.shape, out=out),
            len(words),
        ),
        "ours: predicted, then Zstandard": (
            lambda: med.encode(depth),
            lambda: med.decode(frame, depth.shape),
            len(frame),
        ),
        "Zstandard level 1": (
            lambda: zstd.compress(raw),
            lambda: unzstd.decompress(packed),
            len(packed),
        ),
        "RVL, plain scalar, compiled": (
            lambda: scalar_encode(flat, nibbles),
            lambda: scalar_decode(nibbles, out.reshape(-1)),
            (count + 7) // 8 * 4,
        ),
    }
    for level in (1, 6, PNG_LEVEL):
        png = encode_png(depth, level=level)
        name = f"PNG level {level}" + (", the ROS plugin's default" if level == PNG_LEVEL else "")
        rows[name] = (
            lambda level=level: encode_png(depth, level=level),  # type: ignore[misc]
            lambda png=png: decode_still(png),  # type: ignore[misc]
            len(png),
        )
    return rows


def elapsed_ms(call: Callable[[], Any]) -> float:
    """Return the processor time of one call in milliseconds."""
    start = time.process_time_ns()
    call()
    return (time.process_time_ns() - start) / 1e6


def python_scalar_ms(depth: NDArray[np.uint16]) -> float:
    """Return the time of the reference implementation as plain Python, once."""
    nibbles = np.zeros(8 * depth.size + 8, np.uint8)
    return elapsed_ms(lambda: rvl_reference.encode_nibbles(depth.reshape(-1), nibbles))


def report(name: str, depth: NDArray[np.uint16]) -> None:
    """Measure one frame and print its table."""
    rows = contenders(depth)
    encode_ms: dict[str, list[float]] = {row: [] for row in rows}
    decode_ms: dict[str, list[float]] = {row: [] for row in rows}
    for _ in range(ROUNDS):
        for row, (encode, decode, _size) in rows.items():
            encode_ms[row].append(elapsed_ms(encode))
            decode_ms[row].append(elapsed_ms(decode))
    holes = np.mean(depth == 0)
    print(
        f"\n{name}: {depth.shape[1]} x {depth.shape[0]}, {holes:.1%} holes, {len(np.unique(depth))} values"
    )
    print(f"{'':36}{'encode':>16}{'decode':>16}{'raw/coded':>11}")
    medians = {
        row: (statistics.median(encode_ms[row]), statistics.median(decode_ms[row])) for row in rows
    }
    base = medians["RVL"]
    for row, (_, _, size) in rows.items():
        columns = "".join(
            f"{ms:8.2f} ms {ms / of:4.1f}x" for ms, of in zip(medians[row], base, strict=True)
        )
        print(f"{row:36}{columns}{depth.nbytes / size:11.2f}")
    python_ms = python_scalar_ms(depth)
    print(f"{'RVL, plain scalar, Python (once)':36}{python_ms:8.0f} ms {python_ms / base[0]:4.0f}x")


def main() -> None:
    """Print a table for each frame."""
    cv2.setNumThreads(1)
    print(f"processor time, median of {ROUNDS} interleaved rounds; x: times RVL's")
    for name, depth in depth_frames().items():
        report(name, depth)


if __name__ == "__main__":
    main()
