"""RVL against PNG for depth: lossless, how fast, how small (paper A, section 4.3).

Every frame of the stereo pair's depth is coded by RVL, by PNG at level 9, the transport plug-in's default, and
at level 1, in random order, so that a machine that slows down slows all. Times are CPU times of one thread.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from sfglab.fields import between
from sfglab.lab.claims import Finding, How
from sfglab.lab.experiment import Experiment, Look
from sfglab.lab.figures import COLORS, note
from sfglab.lab.runs import Run, derived
from sfglab.lab.sources import open_source
from sfglab.lab.stats import Estimate, exactly, ratio_of
from sfglab.tables import Shown

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from sfglab.lab.bench import Bench

CODECS: dict[str, dict[str, Any]] = {
    "rvl": {"codec": "rvl"},
    "png": {"codec": "png"},
    "png_fast": {"codec": "png", "png_level": 1},
}
"""What is compared, as `encode_depth` takes it: PNG at a level of the configuration's, and at its fastest."""

_DEFAULT_LEVEL = 9


@dataclass(frozen=True, slots=True, kw_only=True)
class Config(Shown):
    """What is compared."""

    frames: int = between(40, 1, 1200, log=True)  #: Depth frames, each coded by all codecs.
    #: Level of PNG beside its fastest, 1; the transport plug-in's is 9.
    png_level: int = between(9, 0, 9)
    #: Standard deviation of noise that is added to depth [mm].
    noise_mm: float = between(0.0, 0.0, 50.0)
    source: str = "stereo"  #: Source of frames with depth.
    seed: int = 0  #: Seed of the view's path and of the codecs' order.


exp = Experiment("depth_codecs", Config, where="A 4.3", smoke={"frames": 6}, paper={"frames": 1200})


@exp.table("coding")
class CodingRow:
    """One frame coded by one codec."""

    frame: int  #: Number of the frame.
    codec: str  #: One of `CODECS`.
    encode_ms: float  #: CPU time to encode, milliseconds.
    decode_ms: float  #: CPU time to decode, milliseconds.
    raw_bytes: int  #: Size before.
    coded_bytes: int  #: Size after.
    exact: bool  #: Whether the decoded frame equals the original in every bit.


def _code(depth: Any, codec: str, png_level: int) -> dict[str, Any]:
    from sfglab.codecs import decode_depth, encode_depth

    given = {"png_level": png_level} | CODECS[codec]
    started = time.thread_time_ns()
    depth_format, data = encode_depth(depth, **given)
    encoded = time.thread_time_ns()
    back, _ = decode_depth(data, depth_format)
    decoded = time.thread_time_ns()
    return {
        "codec": codec,
        "encode_ms": (encoded - started) / 1e6,
        "decode_ms": (decoded - encoded) / 1e6,
        "raw_bytes": depth.nbytes,
        "coded_bytes": len(data),
        "exact": bool(np.array_equal(back, depth)),
    }


def _noisy(depth_mm: Any, noise_mm: float, rng: np.random.Generator) -> Any:
    """Return depth with noise where it is known, shape (H, W), uint16, in mm."""
    if not noise_mm:
        return depth_mm
    noisy = np.rint(depth_mm + rng.normal(0.0, noise_mm, depth_mm.shape)).clip(1, 65535)
    return np.where(depth_mm > 0, noisy, 0).astype(np.uint16)


@exp.part("frames", total=lambda config: config.frames)
def code_frames(bench: Bench[Config]) -> None:
    """Code every frame by every codec and write one row each."""
    config = bench.config
    rng, noise = np.random.default_rng(config.seed), np.random.default_rng((config.seed, 1))
    source = open_source(config.source, seed=config.seed)
    corner: Any = source.frame().depth_mm  # the whole takes its time at level 9
    warm_up = np.ascontiguousarray(corner[:32, :32])
    for codec in CODECS:  # compiled code must not be timed cold
        _code(warm_up, codec, config.png_level)
    for _ in range(config.frames):
        frame = source.frame()
        depth = _noisy(frame.depth_mm, config.noise_mm, noise)
        for codec in rng.permutation(list(CODECS)):
            bench.write(
                "coding", {"frame": frame.number, **_code(depth, str(codec), config.png_level)}
            )
        bench.advance(f"frame {frame.number}")
    source.close()


@derived
def codings(run: Run[Config]) -> pd.DataFrame:
    """Return a run's rows, one line a frame with a column group a codec."""
    values = ["encode_ms", "decode_ms", "raw_bytes", "coded_bytes", "exact"]
    return run["coding"].pivot_table(index="frame", columns="codec", values=values, aggfunc="first")


@derived
def ratio(run: Run[Config], column: str, against: str = "png") -> Estimate:
    """Return how many times PNG's median time is RVL's, resampling frames (pairs stay together)."""
    pairs = codings(run)[column][[against, "rvl"]].to_numpy(dtype=np.float64)
    return ratio_of(pairs, np.median, unit="times as fast as PNG")


@derived
def summary(run: Run[Config]) -> pd.DataFrame:
    """Return medians a codec: times, compression ratio, and the share of frames that came back exactly."""
    table = codings(run)
    raw, coded = table["raw_bytes"].astype(float), table["coded_bytes"].astype(float)
    return pd.DataFrame(
        {
            "encode (ms)": table["encode_ms"].astype(float).median(),
            "decode (ms)": table["decode_ms"].astype(float).median(),
            "compression ratio": (raw / coded).median(),
            "exact frames": table["exact"].astype(float).mean(),
        }
    )


@exp.claim("A-RVL", how=How.LIVE)
def encoding_speed(run: Run[Config]) -> Finding:
    """Return encoding speed against PNG's fastest level, the hardest to beat, if all is exact."""
    medians = summary(run)
    exact = float(medians["exact frames"]["rvl"])
    ratios = medians["compression ratio"].to_dict()
    details = {
        "frames that came back exactly": f"{100 * exact:g} %",
        "decoding": str(ratio(run, "decode_ms", "png_fast")),
        "encoding against PNG as the plug-in has it by default": str(ratio(run, "encode_ms")),
        "compression ratio RVL": f"{ratios['rvl']:.2f}",
        "compression ratio PNG": f"{ratios['png']:.2f}",
    }
    speed = ratio(run, "encode_ms", "png_fast")
    if exact == 1.0:
        return Finding(estimate=speed, details=details)
    reason = "not every frame came back exactly"
    return Finding(estimate=exactly(0.0, speed.unit), details=details, reason=reason)


@exp.look(
    "codecs",
    Look(
        turn=("png_level", "noise_mm", "frames"),
        needs=("frames",),
        size=(11, 3.6),
        start={"frames": 4},
        coarse={"frames": 1},
        reference="depth_codecs",
    ),
)
@exp.figure("depth_codecs", size=(11, 3.6))
def draw_codecs(figure: Figure, run: Run[Config]) -> dict[str, Any]:
    """Draw coding times and sizes of both codecs: boxes are quartiles over frames, with their medians."""
    table = codings(run)
    encode, decode = ratio(run, "encode_ms", "png_fast"), ratio(run, "decode_ms", "png_fast")
    axes = figure.subplots(1, 3)
    shown = {"encode": "encode_ms", "decode": "decode_ms", "size": "coded_bytes"}
    for place, (title, column) in zip(axes, shown.items(), strict=True):
        _draw_spread(place, table[column], title, run.config.png_level)
    axes[0].set_ylabel("CPU time a frame (ms), log scale")
    axes[1].set_ylabel("CPU time a frame (ms)")
    axes[2].set_ylabel("compressed size (kB)")
    figure.suptitle(
        f"Depth 640 x 360, lossless: RVL encodes {encode.value:.1f} times and decodes "
        f"{decode.value:.1f} times as fast as the fastest PNG (paper: faster)"
    )
    boxes = "boxes: quartiles and median, whiskers: 1.5 times their distance"
    note(figure, f"measured on {len(table)} frames; {boxes}")
    of = {"encode": encode, "decode": decode}
    return {
        name: {"value": one.value, "low": one.low, "high": one.high} for name, one in of.items()
    }


def _draw_spread(axes: Axes, columns: Any, title: str, png_level: int) -> None:
    scale = 1e-3 if title == "size" else 1.0
    values = [columns[codec].astype(float).to_numpy() * scale for codec in CODECS]
    level = (
        f" (default,\nlevel {png_level})"
        if png_level == _DEFAULT_LEVEL
        else f"\n(level {png_level})"
    )
    labels = ["RVL", f"PNG{level}", "PNG\n(level 1)"]
    parts = axes.boxplot(
        values, tick_labels=labels, showfliers=False, patch_artist=True, widths=0.5
    )
    for patch, color in zip(parts["boxes"], ("proxy", "standard", "network"), strict=True):
        patch.set_facecolor(COLORS[color])
    for line in parts["medians"]:
        line.set_color("black")
    axes.set(yscale="log") if title == "encode" else axes.set(ylim=(0, None))
    axes.set_title(title, fontsize=9)
