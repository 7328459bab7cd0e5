"""The module `transmission.results` has claims and figures of latency and loss of "Hello", and the explorer."""

from __future__ import annotations

from collections.abc import Iterator  # noqa: TC003 - an explorer's form reads the annotations
from concurrent.futures import ThreadPoolExecutor
from dataclasses import fields
from itertools import repeat
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
import pandas as pd

from sfglab.arp.hello import (
    OPT_DEPTH,
    SMALL_DEPTH,
    TIE,
    GridCell,
    rate_and_depth,
    scenario_of,
)
from sfglab.arp.robots import BEST, DEPTHS, METHODS, RATES_HZ
from sfglab.fields import Bounds
from sfglab.lab import pictures
from sfglab.lab.cells import failed_plays
from sfglab.lab.claims import Finding, How
from sfglab.lab.experiments.transmission.experiment import Config, exp, grid, simulate_cell
from sfglab.lab.experiments.transmission.live import (
    GRID,
    HELLO,
    HELLO_TO_STATION,
    SENSORS,
    Cell,
)
from sfglab.lab.figures import COLORS, METHOD_COLORS, note, series
from sfglab.lab.live_flows import MODES
from sfglab.lab.paths import find_project
from sfglab.lab.runs import Run, derived, lines_of
from sfglab.lab.stats import Floats, exactly
from sfglab.qos import Durability, History, Liveliness, QoSProfile, Reliability
from sfglab.rtps import PRESETS
from sfglab.units import NS_PER_S

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

LOSS_WITHIN = 0.03  #: Largest difference in loss that agrees.
LATENCY_WITHIN = 0.30  #: Largest difference in median latency that agrees, of the live one.
_CELL = ["rate_max_hz", "depth", "method"]
_MEASURED = ["loss_live", "loss_model", "p50_live_ms", "p50_model_ms"]


# --- The grid ---------------------------------------------------------------------------------


@derived
def losses(run: Run[Config]) -> pd.DataFrame:
    """Return the table ``cell`` with the column ``loss``: the share of "Hello"s that never arrived."""
    return run["cell"].assign(loss=1 - run["cell"]["arrived"] / run["cell"]["published"])


@derived
def cells(run: Run[Config], column: str) -> pd.DataFrame:
    """Return median, lowest and highest value over seeds of a column or of ``loss``, one row per cell."""
    return (
        losses(run).groupby(_CELL, sort=False)[column].agg(["median", "min", "max"]).reset_index()
    )


@derived
def order(run: Run[Config], column: str, *, tie: float = 0.0) -> pd.DataFrame:
    """Compare the paper's order of methods with the simulated order as `order_of` does, one row per Rmax."""
    rows = []
    for rate, part in cells(run, column).groupby("rate_max_hz"):
        rows.append({"rate_max_hz": rate, **order_of(part, tie=tie)})
    return pd.DataFrame(rows)


def order_of(table: pd.DataFrame, *, tie: float = 0.0) -> dict[str, Any]:
    """Compare the paper's order of methods with the simulated order at one Rmax.

    The function compares the paper's winner at the depth of Eq. 6 with two groups of methods: methods without
    optimisation at every depth of Table 2, and optimised methods without the local cache at the winner's depth.

    Args:
        table: ``depth``, ``method`` and ``median`` of each cell.
        tie: Share within which another cell counts as equal.

    Returns:
        ``best`` (the winner's median, NaN without it), ``lowest`` (that of the others), ``wins``; and ``highest_method``,
        ``highest_depth`` (the cell with the highest median) and ``small_is_worst``.
    """
    optimised = table["method"].map(lambda name: METHODS[name].optimised)
    cached = table["method"].map(lambda name: METHODS[name].local_cache)
    at_optimum = table["depth"] == OPT_DEPTH
    best = table[(table["method"] == BEST) & at_optimum]["median"].min()
    rivals = (~optimised & ~at_optimum) | (optimised & ~cached & at_optimum)
    lowest = table[rivals]["median"].min()
    worst = table.iloc[int(table["median"].argmax())]
    small = worst["depth"] != OPT_DEPTH and int(worst["depth"]) <= SMALL_DEPTH
    return {
        "best": best,
        "lowest": lowest,
        "wins": best <= lowest * (1 + tie),
        "highest_method": worst["method"],
        "highest_depth": worst["depth"],
        "small_is_worst": small and not METHODS[worst["method"]].optimised,
    }


def compared(run: Run[Config], column: str, *, tie: float = 0.0) -> pd.DataFrame:
    """Return `order` as a table for readers, with latencies in ms or losses in per cent."""
    found = order(run, column, tie=tie)
    unit, factor = ("%", 100) if column == "loss" else ("ms", 1)
    answer = {True: "yes", False: "no"}
    return pd.DataFrame(
        {
            "Rmax (Hz)": found["rate_max_hz"],
            f"OPT+LC at opt ({unit})": factor * found["best"],
            f"lowest other ({unit})": factor * found["lowest"],
            "OPT+LC lowest": found["wins"].map(answer),
            "highest cell": found["highest_method"] + ", DEPTH " + found["highest_depth"],
            "DEPTH up to 10 highest": found["small_is_worst"].map(answer),
        }
    )


@derived
def causes(run: Run[Config]) -> pd.DataFrame:
    """Return loss with its causes as means over seeds, without cache control, for DEPTH 10 and the depth of Eq. 6.

    The frames that full queues dropped are counted per second of the cell.
    """
    rows = losses(run)
    chosen = rows[rows["method"].isin(LABELS) & rows["depth"].isin(["10", OPT_DEPTH])]
    means = chosen.groupby(_CELL, sort=False)[["loss", "air_share", "queue_full"]].mean()
    table = pd.DataFrame(index=means.index)
    table["loss (%)"] = 100 * means["loss"]
    table["channel utilisation (%)"] = 100 * means["air_share"]
    table["dropped by full queues (frames/s)"] = means["queue_full"] / run.config.duration_s
    names = {"rate_max_hz": "Rmax (Hz)", "depth": "DEPTH"}
    return table.reset_index().rename(columns=names)


# --- Claims -----------------------------------------------------------------------------------

# The robots of section 3.1 have this mean number of topics: sensors, and two flows of "Hello".
_TOPICS = (8 + 5 + 5) / 3


def as_in_table_2(table: pd.DataFrame, duration_s: float) -> pd.Series[bool]:
    """Return whether rows of the grid have the rate and depth of Table 2, and the number of publications of this rate.

    The optimum is written from Eq. 3 to 6 and section 3.1, without the code that ran: R is Rmax / Tavg - Rmin, D is
    5000 R / Rmax - Dmin, and Rmin and Dmin are 1.
    """
    optimum_hz = table["rate_max_hz"] / _TOPICS - 1
    optimum_depth = (5000 * optimum_hz / table["rate_max_hz"] - 1).astype(int)
    rate_hz = optimum_hz.where(table["method"].str.contains("OPT"), table["rate_max_hz"])
    depth = pd.to_numeric(table["depth"], errors="coerce").fillna(optimum_depth)
    has_rate = (table["rate_hz"] - rate_hz).abs() < 1e-6 * rate_hz
    has_count = (table["published"] - rate_hz * duration_s).abs() <= 1
    return has_rate & has_count & (table["history_depth"] == depth)


def other_policies(config: Config) -> list[GridCell]:
    """Return the cells in which a flow has other policies than those of Table 2; the function runs no cell."""
    others = []
    for cell in grid(config):
        rate_hz, depth = rate_and_depth(cell)
        printed = QoSProfile(
            reliability=Reliability.RELIABLE,
            history=History.KEEP_LAST,
            depth=depth,
            durability=Durability.VOLATILE,
            liveliness=Liveliness.AUTOMATIC,
            deadline_ns=round(NS_PER_S / rate_hz),
        )
        profiles = {flow.qos for flow in scenario_of(cell).flows}
        if profiles != {printed}:
            others.append(cell)
    return others


@exp.claim("B-TAB2", how=How.SIMULATED)
def share_of_grid(run: Run[Config]) -> Finding:
    """Return the share of the paper's grid that ran as in Table 2; 0 if a cell has other policies."""
    rows = run["cell"]
    right = rows.assign(right=as_in_table_2(rows, run.config.duration_s)).groupby(_CELL)["right"]
    is_right = right.all()
    depths = [*map(str, DEPTHS), OPT_DEPTH]
    asked = pd.MultiIndex.from_product([RATES_HZ, depths, METHODS])
    others = other_policies(run.config)
    share = 0.0 if others else float(is_right.reindex(asked, fill_value=False).mean())
    wrong = is_right.index[~is_right]
    details = {
        "cells": str(len(is_right)),
        "with another rate, depth or number of messages than Table 2's": str(len(wrong)),
        "with other policies": str(len(others)),
    }
    reasons = [f"not as in Table 2: {cell}" for cell in [*wrong, *others][:3]]
    estimate = exactly(share, "share of the grid that was run as printed")
    return Finding(estimate=estimate, details=details, reason="; ".join(reasons))


@exp.claim("B-LAT", how=How.SIMULATED)
def latency_order(run: Run[Config]) -> Finding:
    """Return the share of rates at which latencies have the paper's order."""
    return order_finding(order(run, "latency_p50_ms", tie=TIE))


@exp.claim("B-LOSS", how=How.SIMULATED)
def loss_order(run: Run[Config]) -> Finding:
    """Return the share of rates at which losses have the paper's order."""
    return order_finding(order(run, "loss"))


def order_finding(table: pd.DataFrame) -> Finding:
    """Return the share of rates with the paper's order, from a table of `order`."""
    wins = f"{table['wins'].sum()} of {len(table)} rates"
    small = f"{table['small_is_worst'].sum()} of {len(table)} rates"
    highest = [
        f"{row.rate_max_hz} Hz: {row.highest_method}, depth {row.highest_depth}"
        for row in lines_of(table)
    ]
    worst = "; ".join(highest)
    reasons = []
    if not table["wins"].all():
        reasons.append(
            f"{BEST} is lowest at {wins}: histories as deep as Eq. 6's seldom fill, "
            "so that retransmissions wait for heartbeats, 3 s apart"
        )
    if not table["small_is_worst"].all():
        reasons.append(f"a small depth is highest at {small} ({worst})")
    share = float((table["wins"] & table["small_is_worst"]).mean())
    return Finding(
        estimate=exactly(share, "share of rates with this order"),
        details={
            f"{BEST} is lowest": f"at {wins}",
            "full rate with a small depth is highest": f"at {small}",
            "highest": worst,
        },
        reason="; ".join(reasons),
    )


# --- Figures of the grid ----------------------------------------------------------------------

LABELS = {
    "none": "no method",
    "LC": "local cache (LC)",
    "OPT": "balanced QoS (OPT)",
    "OPT+LC": "both (OPT+LC)",
}
"""Names of the methods without cache control."""
_LINE: dict[str, Any] = {"linewidth": 1.2, "elinewidth": 0.8}
_CROSS: dict[str, Any] = {"marker": "x", "linestyle": "", "elinewidth": 0}
STYLES: dict[str, dict[str, Any]] = {
    "none": {"label": LABELS["none"], "marker": "o", "linestyle": ":", **_LINE},
    "LC": {"label": LABELS["LC"], "marker": "D", "linestyle": "--", **_LINE},
    "OPT": {"label": LABELS["OPT"], "marker": "s", "linestyle": "-.", **_LINE},
    "OPT+LC": {"label": LABELS["OPT+LC"], "marker": "^", "linestyle": "-", **_LINE},
    "CC": {"label": "with cache control (CC)", **_CROSS},
    "OPT+CC": _CROSS,
    "OPT+LC+CC": _CROSS,
}
"""Styles of all methods; a method with cache control has the colour of the method without it."""


def draw_grid(figure: Figure, table: pd.DataFrame, quantity: str, *, scale: str) -> None:
    """Draw a table of `cells` over DEPTH, one panel per Rmax; bars reach from lowest to highest seed.

    Args:
        figure: Figure to draw into.
        table: Cells of the grid. The optional column ``few`` marks cells whose markers have a white dot.
        quantity: Name and unit of the values.
        scale: Scale of the vertical axes, ``linear`` or ``log``.
    """
    panels = figure.subplots(2, 2, sharex=True, sharey=True)
    table = table.sort_values("depth", key=lambda depths: depths.map(_place))
    depths = list(dict.fromkeys(table["depth"]))
    for axes, (rate, part) in zip(panels.flat, table.groupby("rate_max_hz"), strict=False):
        for method, style in STYLES.items():
            rows = part[part["method"] == method]
            base = method.removesuffix("CC").removesuffix("+") or "none"
            places = [depths.index(depth) for depth in rows["depth"]]
            at = np.array(places) + 0.15 * ([*LABELS].index(base) - 1.5)
            middle = rows["median"]
            spread = [middle - rows["min"], rows["max"] - middle]
            axes.errorbar(at, middle, spread, color=METHOD_COLORS[base], markersize=4.5, **style)
            if "few" in rows:
                axes.plot(at[rows["few"]], middle[rows["few"]], "w.", markersize=4, zorder=3)
        axes.set_title(f"Rmax = {rate} Hz", fontsize=9)
        axes.set_xticks(range(len(depths)), depths, fontsize=8)
    panels[0, 0].set_yscale(scale)
    figure.supylabel(quantity, fontsize="medium")
    for axes in panels[-1]:
        axes.set_xlabel("DEPTH (samples)")
    figure.legend(*panels[0, 0].get_legend_handles_labels(), loc="outside right center")


def _place(depth: str) -> int:
    """Return a key that sorts depths; the depth of Eq. 6 is about 800 at every Rmax."""
    return 800 if depth == OPT_DEPTH else int(depth)


def codes(run: Run[Config]) -> str:
    """Return the note below the grid's figures, which explains conditions and abbreviations."""
    seeds = run["cell"]["seed"].nunique()
    return (
        f"simulated, {100 * run.config.loss:g} % frame loss, {PRESETS[run.config.vendor].name}; medians over "
        f"{seeds} seeds, bars: lowest to highest seed\n"
        "Rmax: publishing rate without OPT; DEPTH: depth of histories; opt: by Eq. 6, between 100 and 1000"
    )


@exp.figure("transmission_latency", size=(10, 6.4), measured=False)
def draw_latency(figure: Figure, run: Run[Config]) -> None:
    """Draw Fig. 10: median latency of the "Hello"s that arrive over DEPTH, one panel per Rmax."""
    table = cells(run, "latency_p50_ms").assign(few=cells(run, "loss")["median"] > 0.5)
    draw_grid(figure, table, "median latency of messages that arrive (ms)", scale="log")
    wins = order(run, "latency_p50_ms", tie=TIE)["wins"]
    figure.suptitle(
        "OPT+LC at the DEPTH of Eq. 6 (opt) has the lowest latency\n"
        f"at {wins.sum()} of {len(wins)} Rmax (paper: at each)"
    )
    note(
        figure,
        f"{codes(run)}\nwhite dot: more than half of the messages lost; the median is that of the others",
    )


@exp.figure("transmission_loss", size=(10, 6.4), measured=False)
def draw_loss(figure: Figure, run: Run[Config]) -> None:
    """Draw Fig. 11: loss of "Hello" over DEPTH, one panel per Rmax."""
    table = cells(run, "loss")
    percent = table.assign(**(100 * table[["median", "min", "max"]]))
    draw_grid(figure, percent, "lost messages (%)", scale="linear")
    wins = order(run, "loss")["wins"]
    figure.suptitle(
        "No method loses fewer messages than OPT+LC at the DEPTH of Eq. 6 (opt),\n"
        f"at {wins.sum()} of {len(wins)} Rmax (paper: at each)"
    )
    note(figure, codes(run))


# --- Live cells beside the model --------------------------------------------------------------


def agreeing(table: pd.DataFrame) -> pd.DataFrame:
    """Return a table with the columns ``loss_agrees``, ``latency_agrees`` and ``agrees`` of live cells and model."""
    loss = (table["loss_live"] - table["loss_model"]).abs() <= LOSS_WITHIN
    late_ms = (table["p50_live_ms"] - table["p50_model_ms"]).abs()
    latency = late_ms <= LATENCY_WITHIN * table["p50_live_ms"]
    return table.assign(loss_agrees=loss, latency_agrees=latency, agrees=loss & latency)


def on_time(rows: pd.DataFrame) -> pd.DataFrame:
    """Return the live runs that kept their schedules."""
    return rows[rows["kept_up"].astype(bool)]


def counts_text(run: Run[Config], part: str, plays: pd.DataFrame) -> str:
    """Return how many trials of a part are shown and how many are left out, and what is grey."""
    failed = len(failed_plays(run, part))
    return (
        f"{len(on_time(plays))} of {len(plays)} trials kept their schedule, only these are shown; {failed} "
        "failed; grey: acceptance range"
    )


GROUP_STYLES = {
    SENSORS: {"label": "sensors' topics", **series("third")},
    HELLO_TO_STATION: {"label": '"Hello" to the station', **series("proxy")},
    HELLO: {"label": '"Hello" to its actuation', **series("standard")},
}


@exp.figure("transmission_live", size=(10, 5.4))
def draw_live(figure: Figure, run: Run[Config]) -> None:
    """Draw how far each live cell is from the model: loss left, median latency right."""
    kept = on_time(run["live"])
    names = kept["method"] + ", " + kept["rate_max_hz"].astype(str) + " Hz, DEPTH " + kept["depth"]
    loss = 100 * (kept["loss_live"] - kept["loss_model"])
    latency = kept["p50_live_ms"] / kept["p50_model_ms"]
    left, right = figure.subplots(1, 2, sharey=True)
    for group, style in GROUP_STYLES.items():
        own = kept["group"] == group
        left.plot(loss[own], names[own], linestyle="", **style)
        right.plot(latency[own], names[own], linestyle="", **style)
    left.axvspan(-100 * LOSS_WITHIN, 100 * LOSS_WITHIN, color="0.9", zorder=0)
    right.axvspan(1 / (1 + LATENCY_WITHIN), 1 / (1 - LATENCY_WITHIN), color="0.9", zorder=0)
    left.invert_yaxis()
    left.set(xlabel="loss, live - model (percentage points)")
    right.set(xlabel="median latency, live / model (ratio)")
    left.axvline(0, color="black", linewidth=0.8)
    right.axvline(1, color="black", linewidth=0.8)
    figure.legend(*left.get_legend_handles_labels(), loc="outside right center", fontsize=8)
    by_cell = agreeing(kept).groupby(_CELL)[["loss_agrees", "latency_agrees"]].all()
    lost, late = by_cell.sum()
    figure.suptitle(
        f"The model agrees with live Cyclone DDS in loss in {lost} of {len(by_cell)} cells, in latency in {late}"
        if len(kept)
        else run.skipped("live")
    )
    counts = counts_text(run, "live", run["live"].drop_duplicates(_CELL))
    note(
        figure,
        f"one trial per cell; line: equal; {counts}\nnone: no method; OPT+LC: balanced QoS, local cache",
    )


# --- Validation of the presets ----------------------------------------------------------------

KEYS = [one.name for one in fields(Cell)]


@derived
def played(run: Run[Config]) -> pd.DataFrame:
    """Return the validation's live runs, from this run or the committed log, with the column ``of``: topics or grid."""
    rows = run["validation"]
    if rows.empty:
        log = exp.load(find_project().reference_logs / "transmission_ros2.mcap")
        rows = pd.concat([log["validation"], *_earlier_cells(log)])
    return rows.assign(of=np.where(rows["kind"] == GRID, GRID, "topics"))


def _earlier_cells(log: Run[Config]) -> list[pd.DataFrame]:
    """Return the grid's cells of an earlier log; earlier logs have these cells in a separate table."""
    try:
        rows = log["ros2"]
    except KeyError:
        return []
    hello = rows[rows["group"] == HELLO].assign(kind=GRID)
    return [hello.rename(columns={"rate_max_hz": "rate_hz"})]


@derived
def validated(run: Run[Config]) -> pd.DataFrame:
    """Return how well each preset agrees with live runs, by the topics and by the grid's cells.

    Counted are trials that kept their schedule.

    Returns:
        ``preset``, ``of`` (``topics`` or ``grid``), number of ``cells``; the share of these whose medians over
        all trials agree in loss and latency, ``both_within``, and whose first trial does, ``first_within``.
    """
    kept = on_time(played(run))
    cells = kept.groupby([*KEYS, "of"], sort=False, dropna=False)
    medians = agreeing(cells[_MEASURED].median().reset_index())
    whose = ["preset", "of"]
    of_presets = medians.groupby(whose, sort=False)["agrees"]
    table = of_presets.agg(cells="size", both_within="mean")
    firsts = agreeing(kept.drop_duplicates(KEYS))
    table["first_within"] = firsts.groupby(whose)["agrees"].mean()
    return table.reset_index()


_MARKS: dict[str, Any] = {"linestyle": "", "markersize": 3.5, "alpha": 0.7}
KIND_STYLES = {
    "calm": {"label": "topic, few frames lost", **series("third"), **_MARKS},
    "lossy": {"label": "topic, many frames lost", **series("proxy"), **_MARKS},
    "saturated": {"label": "topic, channel saturated", **series("standard"), **_MARKS},
    GRID: {"label": '"Hello" of the grid', **series("fourth"), **_MARKS},
}


@exp.figure("transmission_validation", size=(10, 6.6))
def draw_validation(figure: Figure, run: Run[Config]) -> None:
    """Draw each trial of the validation, live over the model: losses above, median latencies below."""
    rows = played(run)
    kept = on_time(rows)
    panels = figure.subplots(2, len(MODES), sharex="row", sharey="row")
    for preset, (loss, latency) in zip(MODES, panels.T, strict=True):
        own = kept[kept["preset"] == preset]
        for kind, style in KIND_STYLES.items():
            part = own[own["kind"] == kind]
            loss.plot(100 * part["loss_model"], 100 * part["loss_live"], **style)
            latency.plot(part["p50_model_ms"], part["p50_live_ms"], **style)
        equal = np.array([0.0, 100.0])
        draw_band(loss, equal, equal - 100 * LOSS_WITHIN, equal + 100 * LOSS_WITHIN)
        equal = np.array([0.4, 4e4])
        draw_band(latency, equal, equal / (1 + LATENCY_WITHIN), equal / (1 - LATENCY_WITHIN))
        loss.set_title(PRESETS[preset].name, fontsize=9)
        loss.set_xlabel("lost messages, model (%)")
        latency.set(xlabel="median latency, model (ms)", xscale="log", yscale="log")
    panels[0, 0].set_ylabel("lost messages, live (%)")
    panels[1, 0].set_ylabel("median latency, live (ms)")
    panels[0, 0].legend(fontsize=8)
    names = {"topics": "topics", GRID: "grid cells"}
    shares = validated(run).groupby("of")["first_within"].agg(["min", "max"])
    texts = [
        f"{100 * share.min:.0f} to {100 * share.max:.0f} % of the {names[share.Index]}"
        for share in lines_of(shares.sort_index(ascending=False))
    ]
    figure.suptitle(f"The model agrees with real DDS in {' and '.join(texts)}")
    counts = counts_text(run, "validation", rows)
    note(
        figure,
        f"title: first trials, lowest and highest preset; points: all trials; line: equal\n{counts}",
    )


def draw_band(axes: Axes, equal: Floats, low: Floats, high: Floats) -> None:
    """Draw the line of equal values and the band of values that agree; all arrays have shape (n,)."""
    axes.plot(equal, equal, color="black", linewidth=0.8)
    axes.fill_between(equal, low, high, color="black", alpha=0.1)


# --- Explorer ---------------------------------------------------------------------------------

ExploredRate = Annotated[int, Bounds(20, 1000, log=True)]
LossPercent = Annotated[float, Bounds(0, 30)]

#: Simulated time of a coarse picture and of a whole picture, seconds.
COARSE_S, WHOLE_S = 1.0, 20.0
_THREADS = 2
_DEPTH = pictures.Axis("DEPTH", "samples", 0.7, 7000, log=True, ticks=(1, 10, 100, 1000))
_QUANTITIES = {
    "latency_p50_ms": pictures.Axis(
        "median latency", "ms", 0.3, 1e5, log=True, ticks=(1, 100, 1e4)
    ),
    "loss": pictures.Axis("lost messages", "%", 0, 100),
    "utilisation": pictures.Axis("channel utilisation", "%", 0, 100),
}
_OPTIMUM = "DEPTH by Eq. 6"
_LINE_COLORS = {label: METHOD_COLORS[method] for method, label in LABELS.items()}


@exp.explorer
def hello_over_depth(
    *,
    rate_max_hz: ExploredRate = 100,
    loss_percent: LossPercent = 1.0,
    preset: Literal["fast_dds", "cyclone_dds"] = "fast_dds",
) -> Iterator[pictures.Picture | None]:
    """Yield latency and loss of "Hello" and the channel utilisation over DEPTH, coarse, then whole.

    Args:
        rate_max_hz: Publishing rate of methods without balanced QoS, Rmax [Hz].
        loss_percent: Frames that the wireless channel loses [%].
        preset: Middleware whose timing is simulated.
    """
    for duration_s in (COARSE_S, WHOLE_S):
        config = Config(
            rates_hz=(rate_max_hz,),
            methods=("none", "LC", "OPT", "OPT+LC"),
            duration_s=duration_s,
            loss=loss_percent / 100,
            vendor=preset,
        )
        simulated = grid(config)
        rows = []
        with ThreadPoolExecutor(_THREADS) as pool:
            # If the generator is closed at a yield, the iterator of `map` cancels the jobs that wait.
            for row in pool.map(simulate_cell, simulated, repeat(0)):
                rows.append(row)
                yield None
        yield _picture(simulated, rows)


def _picture(simulated: list[GridCell], rows: list[dict[str, Any]]) -> pictures.Picture:
    """Return the plot of simulated cells: a line over DEPTH for each method."""
    table = pd.DataFrame(rows).assign(method=[LABELS[cell.method] for cell in simulated])
    table["loss"] = 100 * (1 - table["arrived"] / table["published"])
    table["utilisation"] = 100 * table["air_share"]
    cell = simulated[-1]
    _, optimum = rate_and_depth(cell)
    panels = []
    for column, axis in _QUANTITIES.items():
        values = table.pivot_table(column, "history_depth", "method")
        drawn = pictures.lines(values.reindex(columns=[*_LINE_COLORS]), _LINE_COLORS)
        mark = pictures.Series(
            name=_OPTIMUM,
            color=COLORS["network"],
            kind="path",
            x=[optimum, optimum],
            y=[axis.low, axis.high],
        )
        panels.append(pictures.Panel(title=axis.quantity, x=_DEPTH, y=axis, series=(*drawn, mark)))
    said = (
        f'"Hello" at Rmax {cell.rate_max_hz} Hz with {cell.loss:.1%} of the frames lost, '
        f"{PRESETS[cell.vendor].name}, simulated for {cell.duration_s:g} s. "
        f"DEPTH by Eq. 6: {optimum}."
    )
    return pictures.Picture(said=said, panels=tuple(panels))
