"""RVL against PNG for depth: lossless, how fast, how small (paper A, section 4.3).

Every frame of the stereo pair's measured depth is encoded and decoded by RVL, by PNG as the transport
plug-in does by default (level 9), and by PNG at its fastest (level 1), one after the other and in random
order, so that a machine that slows down slows all. Times are CPU times of one thread.
"""

from __future__ import annotations

import time
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from sfglab.lab.claims import How, Measured
from sfglab.lab.experiments.profiles import of_profile
from sfglab.lab.figures import COLORS, house_style
from sfglab.lab.progress import progress_bar
from sfglab.lab.sources import open_source
from sfglab.lab.stats import Estimate, bootstrap
from sfglab.record import LogReader, LogWriter, run_context

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    import pandas as pd
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


NAME = "depth_codecs"
CODECS: dict[str, dict[str, Any]] = {
    "rvl": {"codec": "rvl"},
    "png": {"codec": "png", "png_level": 9},
    "png_fast": {"codec": "png", "png_level": 1},
}
"""What is compared, as `encode_depth` takes it: PNG at the transport plug-in's default, and at its fastest."""

LABELS = {"rvl": "RVL", "png": "PNG (default,\nlevel 9)", "png_fast": "PNG\n(level 1)"}


@dataclass(frozen=True, slots=True, kw_only=True)
class Config:
    """What is compared."""

    frames: int = 40  #: Depth frames, each coded by both codecs.
    source: str = "stereo"  #: Source of frames with depth.
    seed: int = 0  #: Seed of the view's path and of the codecs' order.

    @classmethod
    def of_profile(cls, profile: str, *, source: str = "stereo", seed: int = 0) -> Config:
        """Return the configuration of a profile.

        Args:
            profile: ``smoke``, ``quick`` or ``paper``.
            source: Source of frames with depth.
            seed: Seed of everything that is drawn.

        Raises:
            ConfigError: There is no such profile.
        """
        return of_profile(_PROFILES, profile, source=source, seed=seed)


_PROFILES = {
    "smoke": Config(frames=6),
    "quick": Config(frames=40),
    "paper": Config(frames=1200),
}


@dataclass(frozen=True, slots=True, kw_only=True)
class CodingRow:
    """One frame coded by one codec."""

    frame: int  #: Number of the frame.
    codec: str  #: One of `CODECS`.
    encode_ms: float  #: CPU time to encode, milliseconds.
    decode_ms: float  #: CPU time to decode, milliseconds.
    raw_bytes: int  #: Size before.
    coded_bytes: int  #: Size after.
    exact: bool  #: Whether the decoded frame equals the original in every bit.


def _code(number: int, depth: Any, codec: str) -> CodingRow:
    from sfglab.codecs import decode_depth, encode_depth

    started = time.thread_time_ns()
    depth_format, data = encode_depth(depth, **CODECS[codec])
    encoded = time.thread_time_ns()
    back, _ = decode_depth(data, depth_format)
    decoded = time.thread_time_ns()
    return CodingRow(
        frame=number,
        codec=codec,
        encode_ms=(encoded - started) / 1e6,
        decode_ms=(decoded - encoded) / 1e6,
        raw_bytes=depth.nbytes,
        coded_bytes=len(data),
        exact=bool(np.array_equal(back, depth)),
    )


def run(config: Config, path: Path) -> Path:
    """Code every frame by both codecs and write one row each.

    Args:
        config: What is compared.
        path: The log.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    rng = np.random.default_rng(config.seed)
    source = open_source(config.source, seed=config.seed)
    warm_up = source.frame().depth_mm
    for codec in CODECS:  # compiled code must not be timed cold
        _code(0, warm_up, codec)
    with LogWriter(path) as log, progress_bar(config.frames, "depth codecs") as advance:
        log.write_metadata("run", run_context())
        log.write_metadata("config", {"experiment": NAME, **asdict(config)})
        for _ in range(config.frames):
            frame = source.frame()
            for codec in rng.permutation(list(CODECS)):
                row = _code(frame.number, frame.depth_mm, str(codec))
                log.write_row("coding", row, log_time_ns=time.time_ns())
            advance(f"frame {frame.number}")
    source.close()
    return path


def load_codings(log: Path) -> pd.DataFrame:
    """Return a run's rows, one line a frame with a column group a codec."""
    with LogReader(log) as reader:
        rows = reader.table("coding").drop(columns="log_time_ns")
    return rows.pivot_table(
        index="frame",
        columns="codec",
        values=["encode_ms", "decode_ms", "raw_bytes", "coded_bytes", "exact"],
        aggfunc="first",
    )


def _ratio(table: pd.DataFrame, column: str, against: str = "png") -> Estimate:
    """Return how many times PNG's median time is RVL's, resampling frames (pairs stay together)."""
    pairs = table[column][[against, "rvl"]].to_numpy(dtype=np.float64)

    def ratio(groups: Sequence[Any]) -> float:
        png, rvl = np.median(groups[0], axis=0)
        return float(png / rvl)

    return bootstrap([pairs], ratio, unit="times as fast as PNG")


def summary(log: Path) -> pd.DataFrame:
    """Return medians a codec: times, compression ratio, and the share of frames that came back exactly."""
    import pandas as pd

    table = load_codings(log)
    raw, coded = table["raw_bytes"].astype(float), table["coded_bytes"].astype(float)
    return pd.DataFrame(
        {
            "encode (ms)": table["encode_ms"].astype(float).median(),
            "decode (ms)": table["decode_ms"].astype(float).median(),
            "compression ratio": (raw / coded).median(),
            "exact frames": table["exact"].astype(float).mean(),
        }
    )


def measure_claims(log: Path) -> dict[str, Measured]:
    """Return our figure for A-RVL: encoding speed against PNG's fastest level, if all is exact."""
    table, medians = load_codings(log), summary(log)
    exact = float(medians["exact frames"]["rvl"])
    ratios = medians["compression ratio"].to_dict()
    details = {
        "frames that came back exactly": f"{100 * exact:g} %",
        "decoding": str(_ratio(table, "decode_ms")),
        "encoding against PNG as the plug-in has it by default": str(_ratio(table, "encode_ms")),
        "compression ratio RVL": f"{ratios['rvl']:.2f}",
        "compression ratio PNG": f"{ratios['png']:.2f}",
    }
    speed = _ratio(table, "encode_ms", "png_fast")  # the level that is hardest to beat
    lossy = Estimate(value=0.0, low=0.0, high=0.0, unit=speed.unit)
    return {
        "A-RVL": Measured(
            estimate=speed if exact == 1.0 else lossy,
            how=How.LIVE,
            details=details,
            reason="" if exact == 1.0 else "not every frame came back exactly",
        )
    }


def figures(log: Path) -> dict[str, tuple[Figure, dict[str, Any]]]:
    """Draw coding times and sizes of both codecs."""
    from matplotlib.figure import Figure

    table = load_codings(log)
    encode, decode = _ratio(table, "encode_ms", "png_fast"), _ratio(table, "decode_ms", "png_fast")
    with house_style():
        figure = Figure(figsize=(11, 3.6))
        axes = figure.subplots(1, 3)
        for place, column, title in zip(
            axes, ("encode_ms", "decode_ms", "coded_bytes"), ("encode", "decode", "size"), strict=True
        ):
            _draw_spread(place, table[column], title)
        axes[0].set_ylabel("CPU time a frame (ms), log scale")
        axes[1].set_ylabel("CPU time a frame (ms), log scale")
        axes[2].set_ylabel("compressed size (kB)")
        figure.suptitle(
            f"Depth 640 x 360, lossless: RVL encodes {encode.value:.1f} times and decodes "
            f"{decode.value:.1f} times as fast as PNG at its fastest"
        )
    shown = {
        n: {"value": e.value, "low": e.low, "high": e.high} for n, e in (("encode", encode), ("decode", decode))
    }
    return {"depth_codecs": (figure, shown)}


def _draw_spread(axes: Axes, columns: Any, title: str) -> None:
    scale = 1e-3 if title == "size" else 1.0
    values = [columns[codec].astype(float).to_numpy() * scale for codec in CODECS]
    parts = axes.boxplot(
        values, tick_labels=list(LABELS.values()), showfliers=False, patch_artist=True, widths=0.5
    )
    for patch, color in zip(
        parts["boxes"], (COLORS["proxy"], COLORS["standard"], COLORS["network"]), strict=True
    ):
        patch.set_facecolor(color)
    for line in parts["medians"]:
        line.set_color("black")
    if title == "size":
        axes.set_ylim(bottom=0)
    else:
        axes.set_yscale("log")
    axes.set_title(title, fontsize=9)
