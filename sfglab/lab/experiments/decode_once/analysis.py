"""Loads per cell, slopes, the cost model of Eq. 2 and 3, and the claims."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from sfglab.lab.claims import Finding, How
from sfglab.lab.experiments.decode_once.experiment import Config, exp
from sfglab.lab.runs import Run, derived
from sfglab.lab.stats import Estimate, bootstrap, line_fit, median_of

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    Floats = NDArray[np.float64]


@derived
def readings(run: Run[Config]) -> pd.DataFrame:
    """Return one line a reading, with its host's label and its cell's columns."""
    return run["load"].merge(run["cell"], on="cell")


def codecs(run: Run[Config]) -> tuple[str, ...]:
    """Return the codecs that were measured, in the order of the run."""
    return tuple(run["cell"]["codec"].unique())


@derived
def cells(run: Run[Config]) -> pd.DataFrame:
    """Return one line a cell, with the medians and deviations of its readings.

    At the consumer ``cpu``, ``cpu_sd``, ``rx``, ``rx_sd``, and ``other`` for the rest of the machine; at the
    edge ``edge_cpu``.
    """
    at = {label: group.groupby("cell") for label, group in readings(run).groupby("label")}
    columns = pd.DataFrame(
        {
            "cpu": at["consumer"]["cpu_percent"].median(),
            "cpu_sd": at["consumer"]["cpu_percent"].std(),
            "rx": at["consumer"]["rx_mbit_s"].median(),
            "rx_sd": at["consumer"]["rx_mbit_s"].std(),
            "edge_cpu": at["edge"]["cpu_percent"].median(),
            "other": at["consumer"]["machine_percent"].median(),
        }
    )
    return run["cell"].merge(columns, left_on="cell", right_index=True)


def _points(run: Run[Config], codec: str, mode: str, column: str) -> Floats:
    """Return (subscribers, figure) of every cell of a mode, shape (cells, 2)."""
    chosen = cells(run)[(cells(run)["codec"] == codec) & (cells(run)["mode"] == mode)]
    return chosen[["subscribers", column]].to_numpy(dtype=np.float64)


def _slope(points: Floats) -> float:
    return line_fit(points[:, 0], points[:, 1])[0]


@dataclass(frozen=True, slots=True, kw_only=True)
class Slopes:
    """How the consumer's load grows with every further subscriber."""

    cpu_standard: Estimate  #: Per cent of one core per subscriber, each decoding for itself.
    cpu_proxy: Estimate  #: The same through the decoder.
    reduction: Estimate  #: How much less that is, per cent.
    net_standard: Estimate  #: Mbit/s per subscriber at the consumer's interface, standard.
    net_proxy: Estimate  #: The same through the decoder.


@derived
def slopes(run: Run[Config], codec: str = "h264") -> Slopes:
    """Fit the slopes of one codec's stream; intervals resample cells."""
    standard, proxy = (_points(run, codec, mode, "cpu") for mode in ("standard", "proxy"))
    per_core, per_net = "% of one core per subscriber", "Mbit/s per subscriber"

    def slope(mode: str, column: str, unit: str) -> Estimate:
        return bootstrap([_points(run, codec, mode, column)], lambda g: _slope(g[0]), unit=unit)

    def reduction(groups: Sequence[Floats]) -> float:
        return 100 * (1 - _slope(groups[1]) / _slope(groups[0]))

    return Slopes(
        cpu_standard=slope("standard", "cpu", per_core),
        cpu_proxy=slope("proxy", "cpu", per_core),
        reduction=bootstrap([standard, proxy], reduction, unit="% less CPU per subscriber"),
        net_standard=slope("standard", "rx", per_net),
        net_proxy=slope("proxy", "rx", per_net),
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class CostModel:
    """Eq. 2 and 3 fitted to the cells of one stream, in per cent of one core."""

    net: Estimate  #: c_net, receiving the compressed stream once.
    dec: Estimate  #: c_dec, decoding it once (and looking at the pixels).
    ipc: Estimate  #: c_ipc, handing decoded pictures to one local subscriber (and its look at the pixels).
    explained: Estimate  #: Share of the loads' variance that the equations explain, 1 at most.
    residual: Estimate  #: Root mean square of the residuals relative to the mean load, per cent.
    residuals: pd.DataFrame  #: One line a cell: mode, subscribers, measured, fitted.


def design(mode: str, count: float) -> tuple[float, float, float]:
    """Return the factors of (net, dec, ipc) in Eq. 2 (standard), Eq. 3 (proxy), or receiving alone."""
    return {"standard": (count, count, 0.0), "proxy": (1.0, 1.0, count), "network": (count, 0.0, 0.0)}[mode]


def _fit_costs(rows: Floats) -> Floats:
    """Return (net, dec, ipc) by least squares; rows are the design's three factors and the load."""
    solution, *_ = np.linalg.lstsq(rows[:, :3], rows[:, 3], rcond=None)
    return np.asarray(solution)


def _errors(rows: Floats) -> Floats:
    return np.asarray(rows[:, 3] - rows[:, :3] @ _fit_costs(rows))


@derived
def cost_model(run: Run[Config], codec: str = "h264") -> CostModel:
    """Fit Eq. 2 and 3 to the cells of one codec's stream, without any term that the paper does not have."""
    chosen = cells(run)[cells(run)["codec"] == codec]
    rows = np.array([(*design(m, n), c) for m, n, c in chosen[["mode", "subscribers", "cpu"]].to_numpy()])

    def relative_residual(groups: Sequence[Floats]) -> float:
        error = _errors(groups[0])
        return float(100 * np.sqrt(np.mean(error**2)) / np.mean(groups[0][:, 3]))

    def explained(groups: Sequence[Floats]) -> float:
        spread = np.var(groups[0][:, 3])
        return float(1 - np.mean(_errors(groups[0]) ** 2) / spread) if spread else float("nan")

    def part(index: int) -> Estimate:
        return bootstrap([rows], lambda g: float(_fit_costs(g[0])[index]), unit="% of one core")

    table = chosen[["mode", "subscribers"]].assign(measured=rows[:, 3], fitted=rows[:, :3] @ _fit_costs(rows))
    return CostModel(
        net=part(0),
        dec=part(1),
        ipc=part(2),
        explained=bootstrap([rows], explained, unit="of the variance"),
        residual=bootstrap([rows], relative_residual, unit="%"),
        residuals=table.reset_index(drop=True),
    )


def frame_checks(run: Run[Config]) -> pd.DataFrame:
    """Return, per stream and mode, what proves that subscribers saw the right frames.

    A pair of number (from the pixels) and stamp (from the header) is verified when the camera sent that
    number with that stamp.
    """
    of = cells(run)[["cell", "codec", "mode"]]
    views = run["view"].merge(of, on="cell")
    sums = ["frames", "unreadable", "missed", "disordered", "broken"]
    table = views.groupby(["codec", "mode"], sort=False)[sums].sum()
    table["age_ms"] = views.groupby(["codec", "mode"], sort=False)["age_ms"].median()
    pairs = run["pair"].merge(of, on="cell")
    sent = set(map(tuple, run["camera"][["codec", "number", "stamp_ns"]].to_numpy().tolist()))
    known = [tuple(p) in sent for p in pairs[["codec", "number", "stamp_ns"]].to_numpy().tolist()]
    by_mode = pairs.assign(verified=known).groupby(["codec", "mode"], sort=False)["verified"]
    table["pairs"], table["verified"] = by_mode.size(), by_mode.sum()
    return table.reset_index().fillna({"pairs": 0, "verified": 0})


@dataclass(frozen=True, slots=True, kw_only=True)
class StreamFacts:
    """What the recorded H.264 messages say of the stream (paper A, Table 2)."""

    bitrate: Estimate  #: Mbit/s of the payload.
    width: int  #: Pixels.
    height: int  #: Pixels.
    fps: float  #: Frames a second, by the capture stamps.
    gop: int  #: Frames from key frame to key frame; 0 with fewer than two key frames.
    encoder: str  #: FFmpeg's name.

    def __str__(self) -> str:
        size = f"{self.width} x {self.height}, {self.fps:.2f} fps, GOP {self.gop}"
        return f"{size}, {self.bitrate}, encoded by {self.encoder}"


def stream_facts(run: Run[Config]) -> StreamFacts:
    """Measure the stream from the raw messages in the log."""
    from sfglab.messages import ns_from_stamp

    topic = run.metadata("stream_h264")["topic"]
    packets = [entry.message for entry in run.messages(topic)]
    stamps = np.array([ns_from_stamp(p.header.stamp) for p in packets])
    fps = float((len(stamps) - 1) * 1e9 / (stamps[-1] - stamps[0]))
    keys = [p.pts for p in packets if p.flags & 1]
    gaps = set(np.diff(keys).tolist())
    sizes = np.array([len(p.data) for p in packets], dtype=np.float64)
    rate = bootstrap([sizes], lambda g: float(np.mean(g[0])) * 8 * fps / 1e6, unit="Mbit/s")
    return StreamFacts(
        bitrate=rate,
        width=packets[0].width,
        height=packets[0].height,
        fps=fps,
        gop=int(gaps.pop()) if len(gaps) == 1 else 0,
        encoder=str(run.metadata("stream_h264")["encoder"]),
    )


def _hosts(run: Run[Config]) -> dict[str, str]:
    return {"hosts": str(run.metadata("hosts")["description"])}


@exp.claim("A-CPU-BASE", how=How.LIVE)
def base_cost(run: Run[Config]) -> Finding:
    """Return the CPU of each subscriber that decodes for itself."""
    return Finding(estimate=slopes(run).cpu_standard, details=_hosts(run))


@exp.claim("A-CPU-SFG", how=How.LIVE)
def reduction(run: Run[Config]) -> Finding:
    """Return how much less CPU a subscriber of the decoder costs."""
    details = {**_hosts(run), "slope through the decoder": str(slopes(run).cpu_proxy)}
    return Finding(estimate=slopes(run).reduction, details=details)


@exp.claim("A-BW", how=How.LIVE)
def bandwidth(run: Run[Config]) -> Finding:
    """Return what the consumer receives through the decoder with the most subscribers."""
    most = int(cells(run).loc[cells(run)["codec"] == "h264", "subscribers"].max())
    details = {
        **_hosts(run),
        "slope standard": str(slopes(run).net_standard),
        "slope through the decoder": str(slopes(run).net_proxy),
        "subscribers": str(most),
        "multicast": run.config.multicast,
    }
    return Finding(estimate=_rate_at(run, "proxy", most), details=details)


@exp.claim("A-COST", how=How.LIVE)
def fit_residual(run: Run[Config]) -> Finding:
    """Return the fit's residual; what it is made of is the reason where it is large."""
    fit = cost_model(run)
    means = fit.residuals.assign(error=fit.residuals["measured"] - fit.residuals["fitted"])
    by_mode = means.groupby("mode")["error"].agg(["mean", "std"])
    spread = ", ".join(f"{mode} {row['mean']:+.2f} +- {row['std']:.2f}" for mode, row in by_mode.iterrows())
    details = {
        "c_net": str(fit.net),
        "c_dec": str(fit.dec),
        "c_ipc": str(fit.ipc),
        "variance explained": f"{100 * fit.explained.value:.1f} %",
    }
    reason = (
        f"the equations explain {100 * fit.explained.value:.1f} % of the variance and have no term for how "
        f"cells differ at the same count; errors by mode, in % of one core: {spread}"
    )
    return Finding(estimate=fit.residual, details=details, reason=reason)


def _rate_at(run: Run[Config], mode: str, count: int) -> Estimate:
    r = readings(run)
    chosen = r[
        (r["label"] == "consumer") & (r["codec"] == "h264") & (r["mode"] == mode) & (r["subscribers"] == count)
    ]
    return median_of(chosen["rx_mbit_s"].to_numpy(dtype=np.float64), unit="Mbit/s")


@exp.claim("A-H264", how=How.LIVE)
def stream_of_table_two(run: Run[Config]) -> Finding:
    """Return the stream's bit rate; its other figures are those of Table 2, or that is the reason."""
    facts = stream_facts(run)
    expected = (facts.width, facts.height, facts.gop) == (640, 360, 30) and abs(facts.fps - 30) < 0.3
    details = {
        "size": f"{facts.width} x {facts.height}",
        "frame rate": f"{facts.fps:.2f} fps",
        "GOP": str(facts.gop),
        "encoder": facts.encoder,
    }
    reason = "" if expected else "the stream is not the one of Table 2"
    return Finding(estimate=facts.bitrate, details=details, reason=reason)
