"""RVL against PNG for depth: lossless, how fast, how small (paper A, section 4.3).

Every frame of the stereo pair's depth is coded with RVL, with PNG at level 9, the default of the
transport plug-in, and with PNG at level 1. The order is random, so that a machine that slows down slows
all codecs. Times are CPU times of one thread.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from sfglab.codecs import decode_depth, encode_depth
from sfglab.fields import between
from sfglab.lab.bench import TableRow
from sfglab.lab.claims import Finding, How
from sfglab.lab.experiment import Experiment
from sfglab.lab.figures import COLORS, note
from sfglab.lab.runs import Run, derived
from sfglab.lab.sources import open_source
from sfglab.lab.stats import Estimate, exactly, ratio_of, rounded
from sfglab.tables import Shown

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from numpy.typing import NDArray

    from sfglab.lab.bench import Bench

CODECS = {"rvl": "proxy", "png": "standard", "png_fast": "network"}
"""Codecs that are compared, with their colours: PNG at the configured level and at its fastest one."""
_FASTEST = 1  # level of PNG


@dataclass(frozen=True, slots=True, kw_only=True)
class Config(Shown):
    """Frames and level of PNG of the run."""

    frames: int = between(40, 1, 1200)  #: Depth frames, each coded by all codecs.
    #: Level of PNG beside its fastest, 1; the transport plug-in's is 9.
    png_level: int = between(9, 0, 9)
    source: str = "stereo"  #: Source of frames with depth.
    seed: int = 0  #: Seed of the view's path and of the codecs' order.


exp = Experiment(
    "depth_codecs",
    Config,
    where="A 4.3",
    smoke={"frames": 6},
    paper={"frames": 1200},
)


@exp.table("coding")
class CodingRow(TableRow):
    """One frame, encoded and decoded with one codec."""

    frame: int  #: Number of the frame.
    codec: str  #: One of `CODECS`.
    encode_ms: float  #: CPU time to encode, ms.
    decode_ms: float  #: CPU time to decode, ms.
    raw_bytes: int  #: Size of the frame before compression, bytes.
    coded_bytes: int  #: Size of the frame after compression, bytes.
    exact: bool  #: Whether the decoded frame equals the original in every bit.


def code(frame: int, depth_mm: NDArray[np.uint16], codec: str, png_level: int) -> CodingRow:
    """Encode and decode a depth frame, shape (H, W), uint16, mm, with one of `CODECS`, and return its row."""
    level = _FASTEST if codec == "png_fast" else png_level
    started_ns = time.thread_time_ns()
    depth_format, data = encode_depth(depth_mm, codec=codec.partition("_")[0], png_level=level)
    encoded_ns = time.thread_time_ns()
    back, _ = decode_depth(data, depth_format)
    decoded_ns = time.thread_time_ns()
    return CodingRow(
        frame=frame,
        codec=codec,
        encode_ms=(encoded_ns - started_ns) / 1e6,
        decode_ms=(decoded_ns - encoded_ns) / 1e6,
        raw_bytes=depth_mm.nbytes,
        coded_bytes=len(data),
        exact=bool(np.array_equal(back, depth_mm)),
    )


@exp.part("frames", total=lambda config: config.frames)
def code_frames(bench: Bench[Config]) -> None:
    """Encode each frame with each codec, and write one row per frame and codec."""
    config = bench.config
    rng = np.random.default_rng(config.seed)
    source = open_source(config.source, seed=config.seed)
    # The first call of compiled code must not be timed. A corner of the image is sufficient, because level 9 takes
    # long for a whole image.
    first: Any = source.frame().depth_mm
    for codec in CODECS:
        code(0, np.ascontiguousarray(first[:32, :32]), codec, config.png_level)
    for number in range(1, config.frames + 1):
        depth_mm: Any = source.frame().depth_mm
        for codec in rng.permutation(list(CODECS)):
            bench.write(code(number, depth_mm, str(codec), config.png_level))
        bench.advance(f"frame {number}")
    source.close()


@derived
def codings(run: Run[Config], column: str) -> pd.DataFrame:
    """Return a column of the table, one row per frame and one column per codec."""
    rows = run["coding"].astype({column: float})
    return rows.pivot_table(column, "frame", "codec")[list(CODECS)]


@derived
def ratio(run: Run[Config], column: str, against: str) -> Estimate:
    """Estimate the median time of a PNG relative to that of RVL, resampling frames."""
    pairs = codings(run, column)[[against, "rvl"]].to_numpy()
    return ratio_of(pairs, np.median, unit="times as fast as PNG")


def codec_names(png_level: int) -> dict[str, str]:
    """Return the names of the codecs for readers, with the levels of PNG."""
    return {"rvl": "RVL", "png": f"PNG, level {png_level}", "png_fast": f"PNG, level {_FASTEST}"}


def codec_table(run: Run[Config]) -> pd.DataFrame:
    """Return medians by codec: times and compression ratio; and the share of exact frames."""
    sizes = codings(run, "raw_bytes") / codings(run, "coded_bytes")
    columns = {
        "encode (ms)": codings(run, "encode_ms").median(),
        "decode (ms)": codings(run, "decode_ms").median(),
        "compression ratio": sizes.median(),
        "share of frames equal after decoding": codings(run, "exact").mean(),
    }
    table = pd.DataFrame(columns).round(2)
    return table.rename(codec_names(run.config.png_level)).reset_index(names="codec")


@exp.claim("A-RVL", how=How.LIVE)
def encoding_speed(run: Run[Config]) -> Finding:
    """Return encoding speed against PNG's fastest level, the hardest to beat, if all is exact."""
    speed = ratio(run, "encode_ms", "png_fast")
    if codings(run, "exact")["rvl"].mean() < 1:
        reason = "not every frame came back exactly"
        return Finding(estimate=exactly(0.0, speed.unit), reason=reason)
    return Finding(estimate=speed)


@exp.figure("depth_codecs", size=(11, 3.6))
def draw_codecs(figure: Figure, run: Run[Config]) -> None:
    """Draw times to encode and decode a depth image, and its compressed size, for RVL and two levels of PNG."""
    labels = [*codec_names(run.config.png_level).values()]
    panels = {
        "Encode (log scale)": (codings(run, "encode_ms"), "CPU time per frame (ms)", "log"),
        "Decode": (codings(run, "decode_ms"), "CPU time per frame (ms)", "linear"),
        "Compressed size": (codings(run, "coded_bytes") / 1000, "size per frame (kB)", "linear"),
    }
    all_axes = figure.subplots(1, len(panels))
    for axes, (title, (table, quantity, scale)) in zip(all_axes, panels.items(), strict=True):
        boxes = axes.boxplot(
            table.to_numpy(),
            tick_labels=labels,
            showfliers=False,
            patch_artist=True,
            widths=0.5,
            medianprops={"color": "black"},
        )
        for box, color in zip(boxes["boxes"], CODECS.values(), strict=True):
            box.set_facecolor(COLORS[color])
        for place, values in enumerate(table, 1):
            top = table[values].max()
            label = rounded(table[values].median())
            axes.annotate(label, (place, top), (0, 4), textcoords="offset points", ha="center")
        axes.set(title=title, ylabel=quantity, yscale=scale)
        low, high = table.to_numpy().min(), table.to_numpy().max()
        axes.set_ylim((0.7 * low, 3 * high) if scale == "log" else (0, 1.15 * high))
    encoding, decoding = (
        ratio(run, column, "png_fast").value for column in ("encode_ms", "decode_ms")
    )
    figure.suptitle(
        f"RVL encodes depth images {encoding:.1f} times and decodes them {decoding:.1f} times as fast as the "
        "PNG of level 1"
    )
    text = "boxes: quartiles and median (number); whiskers: up to 1.5 x IQR"
    note(figure, f"lossless, {len(codings(run, 'exact'))} frames of 640 x 360; {text}")
