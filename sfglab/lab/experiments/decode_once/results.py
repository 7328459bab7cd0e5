"""Loads per cell, slopes, the cost model of Eq. 2 and 3, claims, figures and the explorer."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, Annotated, Literal

import numpy as np
import pandas as pd

from sfglab.fields import Bounds
from sfglab.lab import pictures
from sfglab.lab.claims import Finding, How
from sfglab.lab.experiments.decode_once.experiment import HANDED_ON, Config, exp
from sfglab.lab.figures import PAPER_STYLE, note, series
from sfglab.lab.paper import paper
from sfglab.lab.paths import find_project
from sfglab.lab.runs import Run, derived, lines_of
from sfglab.lab.stats import (
    Estimate,
    Floats,
    LackOfFit,
    bootstrap,
    lack_of_fit,
    line_slope,
    median_of,
)
from sfglab.messages import ns_from_stamp
from sfglab.units import BITS_PER_BYTE, BITS_PER_MBIT, NS_PER_S

if TYPE_CHECKING:
    from collections.abc import Sequence

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

PAPERS = "dds"  #: The decoder's mode in the paper.
LABELS = {
    "standard": "standard: each decodes",
    "dds": "decode once, DDS (paper)",
    "proxy": "decode once, shared memory",
}
NAMES = {**LABELS, "network": "receive only, no decoding"}
"""Name for readers by mode."""
WAYS = {"standard": "standard", "dds": "over DDS", "proxy": "over shared memory"}
"""Transport of the pictures to the subscribers, by mode."""
STYLES = {"standard": series("standard"), "dds": series("third"), "proxy": series("proxy")}
UNITS = {"cpu": "% of one core per subscriber", "rx": "Mbit/s per subscriber"}
"""Units of slopes, by load."""
THROUGH = "% of one core per subscriber, through the decoder"  #: Key of the paper's 1.8 %.


# --- Loads ------------------------------------------------------------------------------------


@derived
def readings(run: Run[Config]) -> pd.DataFrame:
    """Return one row per meter reading, with the columns of its cell."""
    return run["load"].merge(run["cell"], on="cell")


@derived
def cells(run: Run[Config]) -> pd.DataFrame:
    """Return one row per cell with medians of its readings at the consumer host: `cpu`, `paced`, `rx`.

    The column `paced` is the CPU load at a constant speed of the machine. Each reading is divided by the CPU load of
    the camera in the same window, relative to the median of that load, because the camera's work is always the same.
    """
    table = readings(run)
    window = table.groupby(["cell", "label"]).cumcount()
    cpu = table.assign(window=window).pivot_table("cpu_percent", ["cell", "window"], "label")
    paced = cpu["consumer"] / (cpu["edge"] / cpu["edge"].median())
    consumer = table[table["label"] == "consumer"].groupby("cell")
    medians = consumer.agg(cpu=("cpu_percent", "median"), rx=("rx_mbit_s", "median"))
    medians["paced"] = paced.groupby("cell").median()
    return run["cell"].merge(medians, left_on="cell", right_index=True)


def points(run: Run[Config], mode: str, column: str) -> Floats:
    """Return the number of subscribers and a load of each cell of a mode, shape (cells, 2)."""
    table = cells(run)
    chosen = table[table["mode"] == mode]
    return chosen[["subscribers", column]].to_numpy(dtype=np.float64)


def slope_of(values: Floats) -> float:
    """Return the load per subscriber: the slope of the line through the rows of `points`, shape (cells, 2)."""
    return line_slope(values[:, 0], values[:, 1])


@derived
def slope(run: Run[Config], mode: str, load: str) -> Estimate:
    """Estimate how a load, ``cpu`` or ``rx``, grows per subscriber; the interval resamples cells."""
    measured = points(run, mode, load)
    return bootstrap([measured], lambda drawn: slope_of(drawn[0]), unit=UNITS[load])


@derived
def reduction(run: Run[Config], mode: str) -> Estimate:
    """Estimate the reduction of the CPU load per subscriber in a mode, relative to standard."""

    def less(drawn: Sequence[Floats]) -> float:
        return 100 * (1 - slope_of(drawn[1]) / slope_of(drawn[0]))

    both = [points(run, "standard", "cpu"), points(run, mode, "cpu")]
    return bootstrap(both, less, unit="% less CPU per subscriber")


def slopes(run: Run[Config]) -> pd.DataFrame:
    """Return CPU load and received data per subscriber, and the CPU that is saved, by mode."""
    rows = []
    for mode, label in LABELS.items():
        less = str(reduction(run, mode)) if mode in HANDED_ON else ""
        rx = slope(run, mode, "rx")
        # The slope of a mode with a decoder is close to 0.
        received = f"{rx.value:.4f} {rx.unit} [{rx.low:.4f}, {rx.high:.4f}]"
        rows.append((label, str(slope(run, mode, "cpu")), received, less))
    columns = ["mode", "CPU load", "received over the network", "CPU saved"]
    return pd.DataFrame(rows, columns=columns)


def frame_checks(run: Run[Config]) -> pd.DataFrame:
    """Return sums of the subscribers' counts of frames by mode, and median ages with the fewest and the most."""
    views = run["view"].merge(run["cell"], on="cell")
    counts = ["frames", "unreadable", "missed", "disordered", "broken"]
    ages = views.pivot_table("age_ms", "mode", "subscribers", aggfunc="median").iloc[:, [0, -1]]
    table = views.groupby("mode", sort=False)[counts].sum()
    names = {count: f"latency with {count} subscriber(s) (ms)" for count in ages}
    return table.join(ages.rename(columns=names)).reset_index()


# --- Cost model -------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True, kw_only=True)
class CostModel:
    """Eq. 2 and 3 fitted to the cells, in per cent of one core."""

    net: Estimate  #: c_net: receiving the compressed stream once.
    dec: Estimate  #: c_dec: decoding it once and reading the pixels.
    #: c_ipc: passing decoded pictures to one local subscriber, which reads the pixels.
    ipc: Estimate
    explained: float  #: Share of the variance of the loads that the equations explain.
    residual: Estimate  #: Root mean square of the residuals relative to the mean load, per cent.
    #: Test for lack of fit, with errors relative to the load; None without repetitions.
    lack: LackOfFit | None
    #: One row per cell: mode, subscribers, and ``above``, by how much the load is above the fitted one, %.
    residuals: pd.DataFrame


def design(mode: str, count: float) -> tuple[float, float, float]:
    """Return the factors of (c_net, c_dec, c_ipc): Eq. 2 (standard), Eq. 3 (decoder), or receiving."""
    if mode == "standard":
        return count, count, 0.0
    if mode == "network":
        return count, 0.0, 0.0
    return 1.0, 1.0, count


def fit_terms(rows: Floats) -> Floats:
    """Return (c_net, c_dec, c_ipc), % of one core, by least squares.

    The rows have shape (cells, 4): the three factors of `design`, and the load, % of one core.
    """
    solution, *_ = np.linalg.lstsq(rows[:, :3], rows[:, 3], rcond=None)
    return np.asarray(solution)


def errors_of(rows: Floats) -> Floats:
    """Return the residuals of `fit_terms`, % of one core, shape (cells,): measured minus fitted load."""
    return np.asarray(rows[:, 3] - rows[:, :3] @ fit_terms(rows))


def residual_percent(rows: Floats) -> float:
    """Return the root mean square of the residuals of `fit_terms`, relative to the mean load, per cent."""
    return float(100 * np.sqrt(np.mean(errors_of(rows) ** 2)) / np.mean(rows[:, 3]))


def cost_cells(run: Run[Config], way: str) -> pd.DataFrame:
    """Return the cells that Eq. 2 and 3 describe, with one mode `way` of the decoder."""
    table = cells(run)
    return table[table["mode"].isin(["standard", "network", way])]


def cost_rows(table: pd.DataFrame) -> Floats:
    """Return the factors of `design` and the load of cells, shape (cells, 4)."""
    rows = [(*design(cell.mode, cell.subscribers), cell.paced) for cell in lines_of(table)]
    return np.array(rows)


def residual_table(run: Run[Config]) -> pd.DataFrame:
    """Return the mean deviation of the measured loads from the fitted loads over repetitions, % of the fitted loads."""
    wide = cost_model(run).residuals.pivot_table("above", "subscribers", "mode")
    return wide.round(1).rename(columns=NAMES).reset_index()


@derived
def cost_model(run: Run[Config], way: str = PAPERS) -> CostModel:
    """Fit Eq. 2 and 3 of paper A to the cells, with the paper's terms only.

    Args:
        run: The run.
        way: Mode of the decoder. Each has its own c_ipc, and is fitted alone.
    """
    table = cost_cells(run, way)
    rows = cost_rows(table)

    def term(place: int) -> Estimate:
        return bootstrap([rows], lambda drawn: fit_terms(drawn[0])[place], unit="% of one core")

    fitted = rows[:, :3] @ fit_terms(rows)
    errors = errors_of(rows)
    # Repetitions differ in proportion to their load.
    relative = errors_of(rows / fitted[:, None])
    setting = table.groupby(["mode", "subscribers"]).ngroup().to_numpy()
    return CostModel(
        net=term(0),
        dec=term(1),
        ipc=term(2),
        explained=float(1 - np.mean(errors**2) / np.var(rows[:, 3])),
        residual=bootstrap([rows], lambda drawn: residual_percent(drawn[0]), unit="%"),
        lack=lack_of_fit(relative, setting, parameters=3),
        residuals=table[["mode", "subscribers"]].assign(above=100 * errors / fitted),
    )


# --- Claims -----------------------------------------------------------------------------------


@exp.claim("A-CPU-BASE", how=How.LIVE)
def base_cost(run: Run[Config]) -> Finding:
    """Return the CPU load of each subscriber that decodes the stream for itself."""
    return Finding(estimate=slope(run, "standard", "cpu"))


@exp.claim("A-CPU-SFG", how=How.LIVE)
def reduction_by_dds(run: Run[Config]) -> Finding:
    """Return the CPU load that an additional subscriber saves if it gets decoded images over DDS."""
    return reduction_by(run, PAPERS)


@exp.claim("A-CPU-OURS", how=How.LIVE)
def reduction_by_shared_memory(run: Run[Config]) -> Finding:
    """Return the CPU load that an additional subscriber saves if it gets decoded images over shared memory."""
    return reduction_by(run, "proxy")


def reduction_by(run: Run[Config], way: str) -> Finding:
    """Return the finding on the CPU load that a mode of the decoder saves."""
    costs = []
    for mode, number in (("standard", paper("A-CPU-BASE")), (way, paper("A-CPU-SFG", THROUGH))):
        cost = slope(run, mode, "cpu").value
        costs.append(f"{cost:.2f} % {WAYS[mode]} (paper {number:g})")
    checks = frame_checks(run).set_index("mode")
    arrived = checks["frames"] / (checks["frames"] + checks["missed"])
    least = float(min(arrived["standard"], arrived[way]))
    return Finding(
        estimate=reduction(run, way),
        reason=f"of a core, a subscriber costs {', '.join(costs)}",
        ends={"share of pictures that arrive, least of both modes": least},
    )


@exp.claim("A-BW", how=How.LIVE)
def bandwidth(run: Run[Config]) -> Finding:
    """Return the data rate that the consumer receives with the decoder and the most subscribers, and both slopes."""
    table = readings(run).query("label == 'consumer' and mode == @PAPERS")
    most = table["subscribers"].max()
    received = table[table["subscribers"] == most]["rx_mbit_s"].to_numpy(dtype=np.float64)
    standard = points(run, "standard", "rx")
    through = slope(run, PAPERS, "rx")
    ends = {
        "Mbit/s per further subscriber, standard": slope_of(standard),
        "share of variance on a line, standard": float(np.corrcoef(*standard.T).flat[1] ** 2),
        "Mbit/s per further subscriber, through the decoder by DDS": through.value,
    }
    return Finding(estimate=median_of(received, unit="Mbit/s"), ends=ends)


@exp.claim("A-COST", how=How.LIVE)
def fit_residual(run: Run[Config]) -> Finding | None:
    """Return the fit's residual and its test for lack of fit; None without repetitions."""
    fit = cost_model(run)
    if fit.lack is None:
        return None
    off = fit.residuals.groupby("subscribers")["above"].mean()
    return Finding(
        estimate=fit.residual,
        details={"c_net": str(fit.net), "c_dec": str(fit.dec), "c_ipc over DDS": str(fit.ipc)},
        reason=f"the measured loads are {beside(off.iloc[0])} the fitted loads with the fewest subscribers and "
        f"{beside(off.iloc[-1])} them with the most. The equations explain {100 * fit.explained:.1f} % of the "
        "variance, but the F test finds a lack of fit",
        ends={"p of the F test for lack of fit": fit.lack.p},
    )


def beside(percent: float) -> str:
    """Return a signed percentage in words: 2.5 is "2.5 % above", -2.5 is "2.5 % below"."""
    return f"{abs(percent):.1f} % {'above' if percent >= 0 else 'below'}"


@derived
def packets(run: Run[Config]) -> pd.DataFrame:
    """Return one row per recorded message of the stream."""
    rows = []
    for entry in run.messages(run.metadata("stream_h264")["topic"]):
        packet = entry.message
        row = {
            "stamp_ns": ns_from_stamp(packet.header.stamp),
            "number": packet.pts,
            "is_key": bool(packet.flags & 1),
            "width": packet.width,
            "height": packet.height,
            "size_bytes": len(packet.data),
        }
        rows.append(row)
    return pd.DataFrame(rows)


@exp.claim("A-H264", how=How.LIVE)
def stream_of_table_two(run: Run[Config]) -> Finding:
    """Return the stream's bit rate, and its other values of Table 2; a varying GOP counts as 0."""
    table = packets(run)
    duration_s = (table["stamp_ns"].iloc[-1] - table["stamp_ns"].iloc[0]) / NS_PER_S
    fps = (len(table) - 1) / duration_s
    gaps = table[table["is_key"]]["number"].diff().dropna()
    ends = {
        "pixels in a row": float(table["width"].iloc[0]),
        "rows": float(table["height"].iloc[0]),
        "frames a second": float(fps),
        "frames from key frame to key frame": float(gaps.max())
        if gaps.min() == gaps.max()
        else 0.0,
    }
    mbit = table["size_bytes"].to_numpy() * BITS_PER_BYTE / BITS_PER_MBIT
    bitrate = bootstrap([mbit], lambda drawn: float(np.mean(drawn[0])) * fps, unit="Mbit/s")
    encoder = str(run.metadata("stream_h264")["encoder"])
    return Finding(estimate=bitrate, details={"encoder": encoder}, ends=ends)


# --- Figures ----------------------------------------------------------------------------------


@exp.figure("decode_once_h264", size=(10, 4.3))
def draw_colour(figure: Figure, run: Run[Config]) -> None:
    """Draw the CPU load (left) and the received data (right) of the consumer over its number of subscribers."""
    cpu, net = figure.subplots(1, 2)
    each_mbit_s = paper("A-BW")
    each_percent = {"standard": paper("A-CPU-BASE"), PAPERS: paper("A-CPU-SFG", THROUGH)}
    draw_load(cpu, run, "cpu_percent", each_percent)
    draw_load(net, run, "rx_mbit_s", {"standard": each_mbit_s, PAPERS: 0.0}, first=each_mbit_s)
    cpu.set(title="CPU load of the consumer", ylabel="CPU load (% of one core)", ylim=(0, None))
    net.set(title="Data received by the consumer", ylabel="received (Mbit/s)", ylim=(0, None))
    net.annotate("decode once: the same over DDS and shared memory", (5.5, 1.5), ha="center")
    cpu.legend(loc="upper left")
    saved = []
    for mode in HANDED_ON:
        less = reduction(run, mode)
        if less.value >= 0:
            change = f"{less.value:.0f} % [{less.low:.0f}, {less.high:.0f}] less"
        else:
            change = f"{-less.value:.0f} % [{-less.high:.0f}, {-less.low:.0f}] more"
        saved.append(f"{change} {WAYS[mode]}")
    figure.suptitle(
        f"CPU of an additional subscriber if the stream is decoded once:\n{', '.join(saved)}",
        fontsize="medium",
    )
    note(figure, "dashed: paper; bands: standard deviation", run)


def draw_load(
    axes: Axes, run: Run[Config], column: str, stated: dict[str, float], first: float | None = None
) -> None:
    """Draw a load over the number of subscribers with one standard deviation, one line per mode.

    Args:
        axes: Axes to draw into.
        run: The run.
        column: Column of the readings.
        stated: The paper's slopes by mode.
        first: The paper's load of the first subscriber; None: the paper's lines begin at our first points.
    """
    consumer = readings(run).query("label == 'consumer'")
    loads = consumer.groupby(["mode", "subscribers"])[column].agg(["mean", "std"])
    for mode, label in LABELS.items():
        load = loads.loc[mode]
        # Both modes of the decoder receive the same data rate, so one line is drawn as the outline of the other.
        size = 9 if column == "rx_mbit_s" and mode == PAPERS else 4.5
        axes.plot(load["mean"], label=label, markersize=size, **STYLES[mode])
        color = STYLES[mode]["color"]
        low, high = load["mean"] - load["std"], load["mean"] + load["std"]
        axes.fill_between(load.index, low, high, color=color, alpha=0.18, lw=0)
        if mode in stated:
            begin = load["mean"].iloc[0] if first is None else first
            line = begin + stated[mode] * (load.index - load.index[0])
            axes.plot(load.index, line, color=color, **PAPER_STYLE)
        axes.set_xticks(load.index)
    axes.set_xlabel("number of local subscribers")


# --- Explorer ---------------------------------------------------------------------------------

Subscribers = Annotated[int, Bounds(1, 10)]
Rate = Annotated[float, Bounds(1, 120, log=True)]
Size = Literal["640 x 360", "1280 x 720", "1920 x 1080"]

COUNTS = list(range(1, 11))
_PIXELS = 640 * 360  #: Size of a picture in the reference run.
_FPS = 30.0  #: Frame rate of the reference run, 1/s.
_COUNT = pictures.Axis("local subscribers", "", 0.5, 10.5, ticks=tuple(COUNTS))
_CPU = pictures.Axis("CPU", "% of one core", 0, math.inf)
_NET = pictures.Axis("received", "Mbit/s", 0, math.inf)


@cache
def reference_terms() -> tuple[dict[str, Floats], float]:
    """Return (c_net, c_dec, c_ipc) by mode, % of one core, and the stream's Mbit/s in the reference run."""
    run = exp.load(find_project().reference_logs / f"{exp.name}.mcap")
    terms = {way: fit_terms(cost_rows(cost_cells(run, way))) for way in HANDED_ON}
    return terms, slope_of(points(run, "standard", "rx"))


@exp.explorer
def decoding_costs(
    *,
    subscribers: Subscribers = 4,
    picture_size: Size = "640 x 360",
    rate_hz: Rate = _FPS,
    hardware_decoding: bool = False,
) -> pictures.Picture:
    """Return CPU and received data of a device over its subscribers by Eq. 2 and 3.

    The terms are those of the reference run. *Assumed*: they grow with the pixels per second, at equal
    bits per pixel. With a hardware decoder, c_dec is what a subscriber takes to read a picture
    from shared memory.

    Args:
        subscribers: Number of local subscribers of the dots.
        picture_size: Width and height of a picture [pixels].
        rate_hz: Frame rate of the camera [Hz].
        hardware_decoding: Whether the device has a hardware decoder.
    """
    terms, mbit_s = reference_terms()
    width, height = map(int, picture_size.split(" x "))
    factor = width * height * rate_hz / (_PIXELS * _FPS)
    cpu = pd.DataFrame(index=[*COUNTS, subscribers])
    net = pd.DataFrame(index=cpu.index)
    costs = {}
    for mode in LABELS:
        own = terms[PAPERS if mode == "standard" else mode].copy()
        if hardware_decoding:
            own[1] = terms["proxy"][2]
        cpu[mode] = [float(factor * own @ design(mode, count)) for count in cpu.index]
        net[mode] = factor * mbit_s * (cpu.index if mode == "standard" else 1)
        costs[WAYS[mode]] = f"{cpu[mode].iloc[-1]:.1f}"
    decoder = "hardware" if hardware_decoding else "software"
    text = ", ".join(f"{percent} % {way}" for way, percent in costs.items())
    said = (
        f"CPU and network of a device with {subscribers} subscribers to a stream of {picture_size} "
        f"at {rate_hz:g} Hz and a {decoder} decoder. Of one core: {text}."
    )
    panels = (
        curves("CPU by Eq. 2 and 3", _CPU, cpu),
        curves("network", _NET, net, "decode once: both lines are equal"),
    )
    return pictures.Picture(said=said, panels=panels)


def curves(title: str, axis: pictures.Axis, table: pd.DataFrame, text: str = "") -> pictures.Panel:
    """Return a panel with a curve for each mode, and dots at the last number of subscribers."""
    drawn: list[pictures.Series] = []
    for mode, label in LABELS.items():
        color = STYLES[mode]["color"]
        drawn += pictures.curve(label, color, table.index.tolist(), table[mode].tolist())
    return pictures.Panel(title=title, x=_COUNT, y=axis, series=tuple(drawn), note=text)
