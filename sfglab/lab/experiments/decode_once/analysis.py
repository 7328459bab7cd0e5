"""Loads per cell, slopes, the cost model of Eq. 2 and 3, and the claims."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from sfglab.lab.claims import Finding, How
from sfglab.lab.experiments.decode_once.experiment import Config, exp
from sfglab.lab.experiments.decode_once.stage import HANDED_ON
from sfglab.lab.runs import Run, derived
from sfglab.lab.stats import (
    Estimate,
    Floats,
    LackOfFit,
    bootstrap,
    exactly,
    lack_of_fit,
    line_fit,
    median_of,
)

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    import pandas as pd

#: Per cent of one core per subscriber, standard and decoder (paper A, section 5.2).
PAPER_CPU = (6.5, 1.8)
PAPERS_WAY = HANDED_ON[0]
WAYS = {"dds": "DDS", "proxy": "shared memory"}  #: What the decoder hands pictures on by, by mode.


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
    edge ``edge_cpu``. ``paced`` is ``cpu`` at one pace of the machine: each reading over how much the camera's
    work, which is the same all the time, cost in the same window, relative to its median over the stream.
    """
    by_window = readings(run).assign(window=lambda r: r.groupby(["cell", "label"]).cumcount())
    both = by_window.pivot_table("cpu_percent", ["codec", "cell", "window"], "label")
    pace = both["edge"] / both.groupby("codec")["edge"].transform("median")
    at = {label: group.groupby("cell") for label, group in readings(run).groupby("label")}
    columns = at["consumer"].agg(
        cpu=("cpu_percent", "median"),
        cpu_sd=("cpu_percent", "std"),
        rx=("rx_mbit_s", "median"),
        rx_sd=("rx_mbit_s", "std"),
        other=("machine_percent", "median"),
    )
    paced, edge_cpu = (
        (both["consumer"] / pace).groupby("cell").median(),
        at["edge"]["cpu_percent"].median(),
    )
    return run["cell"].merge(
        columns.assign(paced=paced, edge_cpu=edge_cpu), left_on="cell", right_index=True
    )


def _points(run: Run[Config], codec: str, mode: str, column: str) -> Floats:
    """Return (subscribers, figure) of every cell of a mode, shape (cells, 2)."""
    chosen = cells(run)[(cells(run)["codec"] == codec) & (cells(run)["mode"] == mode)]
    return chosen[["subscribers", column]].to_numpy(dtype=np.float64)


def _slope(points: Floats) -> float:
    return line_fit(points[:, 0], points[:, 1])[0]


def modes_of(run: Run[Config], codec: str = "h264") -> tuple[str, ...]:
    """Return standard and the decoder's modes, of those measured with two numbers of subscribers at least."""
    numbers = cells(run)[cells(run)["codec"] == codec].groupby("mode")["subscribers"].nunique()
    return tuple(mode for mode in ("standard", *HANDED_ON) if numbers.get(mode, 0) > 1)


def papers_way(run: Run[Config]) -> str:
    """Return the decoder's mode that stands for the paper's: by DDS; in a log without it, by shared memory."""
    return PAPERS_WAY if PAPERS_WAY in modes_of(run) else "proxy"


@dataclass(frozen=True, slots=True, kw_only=True)
class Slopes:
    """How the consumer's load grows with every further subscriber, by mode; see `modes_of`."""

    cpu: Mapping[str, Estimate]  #: Per cent of one core per subscriber.
    net: Mapping[str, Estimate]  #: Mbit/s per subscriber at the consumer's interface.
    reduction: Mapping[str, Estimate]  #: How much less CPU than standard that is, per cent.

    def can_compare(self, mode: str) -> bool:
        """Return whether both loads grow with the subscribers; else a ratio has no meaning."""
        return self.cpu["standard"].value > 0 and self.cpu[mode].value > 0


@derived
def slopes(run: Run[Config], codec: str = "h264") -> Slopes:
    """Fit the slopes of one codec's stream; intervals resample cells."""
    modes = modes_of(run, codec)

    def by_mode(column: str, unit: str) -> dict[str, Estimate]:
        every = {mode: [_points(run, codec, mode, column)] for mode in modes}
        return {
            mode: bootstrap(points, lambda g: _slope(g[0]), unit=unit)
            for mode, points in every.items()
        }

    def reduction(groups: Sequence[Floats]) -> float:
        return 100 * (1 - _slope(groups[1]) / _slope(groups[0]))

    pairs = {m: [_points(run, codec, mode, "cpu") for mode in ("standard", m)] for m in modes[1:]}
    less = "% less CPU per subscriber"
    return Slopes(
        cpu=by_mode("cpu", "% of one core per subscriber"),
        net=by_mode("rx", "Mbit/s per subscriber"),
        reduction={mode: bootstrap(pair, reduction, unit=less) for mode, pair in pairs.items()},
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class CostModel:
    """Eq. 2 and 3 fitted to the cells of one stream, in per cent of one core."""

    net: Estimate  #: c_net, receiving the compressed stream once.
    dec: Estimate  #: c_dec, decoding it once (and looking at the pixels).
    #: c_ipc, handing decoded pictures to one local subscriber (and its look at the pixels).
    ipc: Estimate
    explained: Estimate  #: Share of the loads' variance that the equations explain, 1 at most.
    residual: Estimate  #: Root mean square of the residuals relative to the mean load, per cent.
    #: The test for lack of fit, errors relative to the load; None without replicates.
    lack: LackOfFit | None
    #: The same as if errors of small and large loads were equally large.
    lack_plain: LackOfFit | None
    residuals: pd.DataFrame  #: One line a cell: mode, subscribers, measured, fitted.


def design(mode: str, count: float) -> tuple[float, float, float]:
    """Return the factors of (net, dec, ipc) in Eq. 2 (standard), Eq. 3 (decoder), or receiving alone."""
    return {"standard": (count, count, 0.0), "network": (count, 0.0, 0.0)}.get(
        mode, (1.0, 1.0, count)
    )


def _fit_costs(rows: Floats) -> Floats:
    """Return (net, dec, ipc) by least squares; rows are the design's three factors and the load."""
    solution, *_ = np.linalg.lstsq(rows[:, :3], rows[:, 3], rcond=None)
    return np.asarray(solution)


def _errors(rows: Floats) -> Floats:
    return np.asarray(rows[:, 3] - rows[:, :3] @ _fit_costs(rows))


@derived
def cost_model(
    run: Run[Config], codec: str = "h264", way: str = "proxy", load: str = "paced"
) -> CostModel:
    """Fit Eq. 2 and 3 to the cells of one codec's stream, without any term that the paper does not have.

    Args:
        run: The run.
        codec: The stream's codec.
        way: The decoder's mode: each way of handing on has its own c_ipc, and is fitted alone.
        load: Column of `cells`: ``paced``, or ``cpu`` as it was measured.
    """
    chosen = cells(run)[
        (cells(run)["codec"] == codec) & cells(run)["mode"].isin(["standard", "network", way])
    ]
    rows = np.array(
        [(*design(m, n), c) for m, n, c in chosen[["mode", "subscribers", load]].to_numpy()]
    )

    def explained(groups: Sequence[Floats]) -> float:
        spread = np.var(groups[0][:, 3])
        return float(1 - np.mean(_errors(groups[0]) ** 2) / spread) if spread else float("nan")

    def residual(groups: Sequence[Floats]) -> float:
        return float(100 * np.sqrt(np.mean(_errors(groups[0]) ** 2)) / np.mean(groups[0][:, 3]))

    def part(index: int) -> Estimate:
        return bootstrap([rows], lambda g: float(_fit_costs(g[0])[index]), unit="% of one core")

    table = chosen[["mode", "subscribers"]].assign(
        measured=rows[:, 3], fitted=rows[:, :3] @ _fit_costs(rows)
    )
    by_load = (
        rows / (rows[:, :3] @ _fit_costs(rows))[:, None]
    )  # replicates differ in proportion to their load
    setting = chosen.groupby(["mode", "subscribers"]).ngroup().to_numpy()
    return CostModel(
        net=part(0),
        dec=part(1),
        ipc=part(2),
        explained=bootstrap([rows], explained, unit="of the variance"),
        residual=bootstrap([rows], residual, unit="%"),
        lack=lack_of_fit(_errors(by_load), setting, parameters=3),
        lack_plain=lack_of_fit(_errors(rows), setting, parameters=3),
        residuals=table.reset_index(drop=True),
    )


def frame_checks(run: Run[Config]) -> pd.DataFrame:
    """Return, per stream and mode, what proves that subscribers saw the right frames.

    A pair of number (pixels) and stamp (header) is verified when the camera sent that number with that stamp.
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
    #: Frames from key frame to key frame, 0 where that varies; None with fewer than two.
    gop: int | None
    encoder: str  #: FFmpeg's name.

    def __str__(self) -> str:
        size = f"{self.width} x {self.height}, {self.fps:.2f} fps, GOP {self.gop}"
        return f"{size}, {self.bitrate}, encoded by {self.encoder}"


def stream_facts(run: Run[Config]) -> StreamFacts:
    """Measure the stream from the raw messages in the log."""
    from sfglab.messages import ns_from_stamp

    packets = [entry.message for entry in run.messages(run.metadata("stream_h264")["topic"])]
    stamps = np.array([ns_from_stamp(p.header.stamp) for p in packets])
    fps = float((len(stamps) - 1) * 1e9 / (stamps[-1] - stamps[0]))
    gaps = [*{*np.diff([p.pts for p in packets if p.flags & 1]).tolist()}]
    sizes = np.array([len(p.data) for p in packets], dtype=np.float64)
    return StreamFacts(
        bitrate=bootstrap([sizes], lambda g: float(np.mean(g[0])) * 8 * fps / 1e6, unit="Mbit/s"),
        width=packets[0].width,
        height=packets[0].height,
        fps=fps,
        gop=(int(gaps[0]) if len(gaps) == 1 else 0) if gaps else None,
        encoder=str(run.metadata("stream_h264")["encoder"]),
    )


def _hosts(run: Run[Config]) -> dict[str, str]:
    return {"hosts": str(run.metadata("hosts")["description"])}


@exp.claim("A-CPU-BASE", how=How.LIVE)
def base_cost(run: Run[Config]) -> Finding:
    """Return the CPU of each subscriber that decodes for itself."""
    return Finding(estimate=slopes(run).cpu["standard"], details=_hosts(run))


@exp.claim("A-CPU-SFG", how=How.LIVE)
def reduction_by_dds(run: Run[Config]) -> Finding:
    """Return how much less CPU a subscriber of the decoder costs that gets its pictures by DDS."""
    return _reduction(run, PAPERS_WAY)


@exp.claim("A-CPU-OURS", how=How.LIVE)
def reduction_by_shared_memory(run: Run[Config]) -> Finding:
    """Return how much less CPU a subscriber of the decoder costs that gets its pictures by shared memory."""
    return _reduction(run, "proxy")


def _reduction(run: Run[Config], way: str) -> Finding:
    found, sums = slopes(run), run["view"].merge(cells(run), on="cell").groupby(["codec", "mode"])
    if way not in found.reduction:
        lacks = f"the log has no cells in which the decoder hands pictures on by {WAYS[way]}"
        return Finding(estimate=exactly(float("nan"), ""), reason=lacks)
    if not found.can_compare(way):
        falls = "the CPU load does not grow with the subscribers: too few readings"
        return Finding(estimate=exactly(float("nan"), ""), reason=falls)
    beside = zip(("standard", way), ("standard", WAYS[way]), PAPER_CPU, strict=True)
    costs = [
        f"{found.cpu[mode].value:.2f} % {name} (paper {paper})" for mode, name, paper in beside
    ]
    arrived = sums["frames"].sum() / (sums["frames"].sum() + sums["missed"].sum())
    details = {
        **_hosts(run),
        "slope standard": str(found.cpu["standard"]),
        f"slope through the decoder by {WAYS[way]}": str(found.cpu[way]),
    }
    return Finding(
        estimate=found.reduction[way],
        details=details,
        reason=f"of a core, a subscriber costs {', '.join(costs)}",
        ends={_ARRIVE: float(min(arrived["h264", "standard"], arrived["h264", way]))},
    )


_ARRIVE = "share of pictures that arrive, least of both modes"


@exp.claim("A-BW", how=How.LIVE)
def bandwidth(run: Run[Config]) -> Finding:
    """Return what the consumer receives through the decoder with the most subscribers, and both slopes."""
    found, points = slopes(run).net, _points(run, "h264", "standard", "rx")
    way = papers_way(run)
    chosen = cells(run)[(cells(run)["codec"] == "h264") & (cells(run)["mode"] == way)]
    most = int(chosen["subscribers"].max())
    ends = {
        "Mbit/s per further subscriber, standard": found["standard"].value,
        "share of variance on a line, standard": float(np.square(np.corrcoef(points.T).flat[1])),
    }
    if way == PAPERS_WAY:
        ends["Mbit/s per further subscriber, through the decoder by DDS"] = found[way].value
    details = {
        **_hosts(run),
        **{f"slope, {WAYS.get(mode, mode)}": str(slope) for mode, slope in found.items()},
        "subscribers": str(most),
        "multicast": run.config.multicast,
    }
    consumers = readings(run).query("label == 'consumer' and codec == 'h264' and mode == @way")
    received = consumers.loc[consumers["subscribers"] == most, "rx_mbit_s"].to_numpy(
        dtype=np.float64
    )
    return Finding(estimate=median_of(received, unit="Mbit/s"), details=details, ends=ends)


@exp.claim("A-COST", how=How.LIVE)
def fit_residual(run: Run[Config]) -> Finding:
    """Return the fit's residual and its test; what it is made of is the reason where it is large."""
    way = papers_way(run)
    fit, raw = cost_model(run, "h264", way), cost_model(run, "h264", way, "cpu")
    means = fit.residuals.assign(error=fit.residuals["measured"] - fit.residuals["fitted"])
    by_mode = means.groupby("mode")["error"].agg(["mean", "std"])
    spread = ", ".join(
        f"{mode} {row['mean']:+.2f} +- {row['std']:.2f}" for mode, row in by_mode.iterrows()
    )
    details = {
        "c_net": str(fit.net),
        "c_dec": str(fit.dec),
        f"c_ipc, {WAYS[way]}": str(fit.ipc),
        "variance explained": f"{100 * fit.explained.value:.1f} %",
        "lack of fit": str(fit.lack or "no cells were measured twice"),
        "lack of fit, as if all loads varied alike": str(fit.lack_plain),
        "as measured, at the machine's own pace": f"{raw.residual}, lack of fit {raw.lack}",
    }
    if way == PAPERS_WAY and "proxy" in modes_of(run):
        ours = cost_model(run)
        details["ours, by shared memory"] = (
            f"c_ipc {ours.ipc}, residual {ours.residual}, lack {ours.lack}"
        )
    off = 100 * (means["error"] / means["fitted"]).groupby(means["subscribers"]).mean()
    at = f"with the fewest subscribers loads are {off.iloc[0]:+.1f} % off, with the most {off.iloc[-1]:+.1f} %"
    said = f"lack of fit {fit.lack}: {at}; " if fit.lack and fit.lack.p < 0.05 else ""
    if way != PAPERS_WAY:
        said = "the log has no cells of DDS, so this is shared memory's fit; " + said
    reason = (
        f"{said}the equations explain {100 * fit.explained.value:.1f} % of the variance and have no term for "
        f"how cells differ at the same count; errors by mode, in % of one core: {spread}"
    )
    p = {"p of the F test for lack of fit": fit.lack.p} if fit.lack and way == PAPERS_WAY else {}
    return Finding(estimate=fit.residual, details=details, reason=reason, ends=p)


@exp.claim("A-H264", how=How.LIVE)
def stream_of_table_two(run: Run[Config]) -> Finding:
    """Return the stream's bit rate, and its other figures in Table 2."""
    facts = stream_facts(run)
    ends = {
        "pixels in a row": float(facts.width),
        "rows": float(facts.height),
        "frames a second": facts.fps,
    }
    if facts.gop is not None:
        ends["frames from key frame to key frame"] = float(facts.gop)
    return Finding(estimate=facts.bitrate, details={"encoder": facts.encoder}, ends=ends)
