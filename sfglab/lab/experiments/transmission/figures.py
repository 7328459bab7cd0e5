"""Figures 10 and 11 of paper B, redrawn from a run, and where each "Hello" was lost."""

from __future__ import annotations

from textwrap import fill
from typing import TYPE_CHECKING, Any

import numpy as np

from sfglab.arp.hello import BEST, OPT_DEPTH, TIE
from sfglab.arp.robots import METHODS
from sfglab.lab.experiment import Look
from sfglab.lab.experiments.transmission.analysis import (
    agreement,
    cells,
    compare_ways,
    order,
)
from sfglab.lab.experiments.transmission.experiment import Config, exp
from sfglab.lab.experiments.transmission.stage import LATENCY_WITHIN, LOSS_WITHIN
from sfglab.lab.experiments.transmission.validation import READ, by_cell, played, validated
from sfglab.lab.figures import COLORS, grouped_bars, note, series
from sfglab.lab.live_flows import MODES
from sfglab.rtps import PRESETS

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from sfglab.lab.runs import Run

_COLORS = {
    "none": "black",
    "LC": COLORS["standard"],
    "OPT": COLORS["proxy"],
    "OPT+LC": COLORS["third"],
    "own": "#E69F00",
    "own+LC": "#56B4E9",
}
"""By method without CC, and by way to choose rates and depths."""
_MARKERS = {"none": "o", "OPT": "s", "LC": "D", "OPT+LC": "P"}
FATES = {
    "arrived": ("arrived", "#D9D9D9"),
    "lost_medium": ("lost on air, overwritten before repair", COLORS["proxy"]),
    "lost_queue": (
        "dropped by a full sender's queue, overwritten before repair",
        COLORS["standard"],
    ),
    "lost_late": ("pushed out of the reader's history", COLORS["fourth"]),
    "lost_underway": ("still under way at the end", "black"),
}
"""What became of a "Hello", and its colour, by column."""
GROUP_STYLES = {
    "sensors": ("sensors' topics", COLORS["third"], "s"),
    "hello_up": ('"Hello" as far as the station', COLORS["proxy"], "^"),
    "hello": ('"Hello" as far as its actuation', COLORS["standard"], "o"),
}
FATE_METHODS = ("none", "OPT", "LC", "OPT+LC")


@exp.figure("transmission_latency", size=(10, 6.4))
def draw_latency(figure: Figure, run: Run[Config]) -> dict[str, Any]:
    """Draw Fig. 10: the median latency of those "Hello"s that arrive, a panel for each Rmax."""
    _draw_panels(figure, run, "latency_p50_ms", "Latency", tie=TIE)
    figure.axes[0].set_yscale("log")
    figure.supylabel("median latency (ms)", fontsize="medium")
    return {"latency_p50_ms": cells(run, "latency_p50_ms")}


@exp.figure("transmission_loss", size=(10, 6.4))
def draw_loss(figure: Figure, run: Run[Config]) -> dict[str, Any]:
    """Draw Fig. 11: the packet loss of "Hello", a panel for each Rmax."""
    _draw_panels(figure, run, "loss", "Packet loss", scale=100.0)
    figure.supylabel("packet loss (%)", fontsize="medium")
    return {"loss": cells(run, "loss")}


def _draw_panels(
    figure: Figure, run: Run[Config], column: str, what: str, **options: float
) -> None:
    wins = order(run, column, tie=options.pop("tie", 0.0))["wins"]
    table = cells(run, column).assign(hollow=cells(run, "loss")["median"] > 0.5)
    panels = figure.subplots(2, 2, sharex=True, sharey=True).ravel()
    for axes, rate in zip(panels, table["rate_max_hz"].unique(), strict=False):
        draw_panel(axes, table[table["rate_max_hz"] == rate], **options)
        axes.set_title(f"Rmax = {rate} Hz", fontsize=9)
    for axes in panels[2:]:
        axes.set_xlabel("DEPTH")
    handles, labels = panels[0].get_legend_handles_labels()
    handles += panels[0].plot([], [], "o", markerfacecolor="white", color="black", markersize=4.5)
    labels.append("hollow: fewer than\nhalf arrived")
    figure.legend(handles, labels, loc="outside right center")
    figure.suptitle(
        f'{what} of "Hello": {BEST} is lowest at {wins.sum()} of {len(wins)} rates (paper: at all)'
    )
    seeds = run["cell"]["seed"].nunique()
    note(
        figure,
        f"simulated; medians over {seeds} seeds, bars: lowest to highest; DEPTH opt: Eq. 6's",
    )


def draw_panel(axes: Axes, table: pd.DataFrame, *, scale: float = 1.0) -> None:
    """Draw the `cells` of one Rmax: a line a method over depths, bars from the lowest to the highest seed.

    With CC a method has crosses beside its line; a mark is ``hollow`` where the table says so.
    """
    depths = list(dict.fromkeys(table["depth"]))
    for method in sorted(table["method"].unique(), key=[*_MARKERS, *METHODS].index):
        part = table[table["method"] == method].set_index("depth").reindex(depths)
        middle = part["median"] * scale
        spread = np.stack([middle - part["min"] * scale, part["max"] * scale - middle])
        base, with_cc = method.removesuffix("+CC").replace("CC", "none"), "CC" in method
        places = np.arange(len(depths)) + 0.2 * (list(_MARKERS).index(base) - 1.7 + 0.45 * with_cc)
        style: dict[str, Any] = {
            "color": _COLORS[base],
            "marker": "x" if with_cc else _MARKERS[base],
        }
        style |= {"linestyle": "--" if base == "LC" else "-"}
        lines: dict[str, Any] = {
            "linewidth": 0.0 if with_cc else 1.2,
            "elinewidth": 0.8,
            "markersize": 4.5,
        }
        axes.errorbar(places, middle, yerr=spread, label=method, **lines, **style)
        if "hollow" in part and not with_cc:
            hollow = part["hollow"].to_numpy(bool)
            style |= {"markerfacecolor": "white", "linestyle": "", "markersize": 4.5, "zorder": 3}
            axes.plot(places[hollow], middle[hollow], **style)
    axes.set_xticks(range(len(depths)), depths)


@exp.figure("transmission_fates", size=(10, 7))
def draw_fates(figure: Figure, run: Run[Config]) -> dict[str, Any]:
    """Draw where "Hello"s were lost, means over seeds: a row a method, a column an Rmax, a bar a depth."""
    rates = run["cell"]["rate_max_hz"].unique()
    shares = _shares_of_fates(run["cell"])
    panels = figure.subplots(len(FATE_METHODS), len(rates), sharex=True, sharey=True, squeeze=False)
    for row, method in zip(panels, FATE_METHODS, strict=True):
        row[0].set(ylabel=f"{method}\nshare (%)", ylim=(0, 100), yticks=(0, 50, 100))
        for axes, rate in zip(row, rates, strict=True):
            _draw_bars(axes, shares[(shares["rate_max_hz"] == rate) & (shares["method"] == method)])
    for axes, rate in zip(panels[0], rates, strict=True):
        axes.set_title(f"Rmax = {rate} Hz", fontsize=9)
    for axes in panels[-1]:
        axes.set_xlabel("DEPTH")
        axes.tick_params(axis="x", labelrotation=60)
    handles, labels = panels[0][0].get_legend_handles_labels()
    figure.legend(
        handles, [fill(label, 20) for label in labels], loc="outside right center", fontsize=8.5
    )
    opt = shares[shares["depth"] == OPT_DEPTH].groupby("method")["arrived"].min()
    said = ", ".join(f"{method} {opt[method]:.0%}" for method in FATE_METHODS)
    figure.suptitle(f"Arrived at the depth of Eq. 6, at the worst Rmax: {said}")
    note(
        figure,
        f'simulated; the fate of every "Hello", means over {run["cell"]["seed"].nunique()} seeds',
    )
    return {"shares": shares}


def _shares_of_fates(table: pd.DataFrame) -> pd.DataFrame:
    """Return the share of each fate among what was published, mean over seeds, by Rmax, method and depth."""
    shares = table[list(FATES)].div(table["published"], axis=0)
    keys = [table["rate_max_hz"], table["method"], table["depth"]]
    return shares.groupby(keys, sort=False).mean().reset_index()


def _draw_bars(axes: Axes, shares: pd.DataFrame) -> None:
    floor = np.zeros(len(shares))
    for column, (label, color) in FATES.items():
        axes.bar(
            range(len(shares)),
            100 * shares[column],
            bottom=floor,
            color=color,
            width=0.8,
            label=label,
        )
        floor = floor + 100 * shares[column].to_numpy()
    axes.set_xticks(range(len(shares)), list(shares["depth"]), fontsize=7)
    axes.grid(visible=False, axis="x")


@exp.figure("transmission_beyond", size=(8.8, 4.0))
def draw_beyond(figure: Figure, run: Run[Config]) -> dict[str, Any]:
    """Draw how long the station is up to date, and how late "Hello" is, for the printed problem and our own."""
    shown = {
        c: compare_ways(run, c) for c in ("up_to_date", "latency_p95_ms", "loss", "rate_high_hz")
    }
    fresh, late = figure.subplots(1, 2)
    _draw_groups(fresh, run, "up_to_date", 100.0)
    fresh.set(ylabel="station up to date (% of the time)", ylim=(0, 100))
    _draw_groups(late, run, "latency_p95_ms", 1.0)
    late.set(yscale="log", ylabel='"Hello", 95th percentile (ms)')
    figure.legend(*fresh.get_legend_handles_labels(), loc="outside right center")
    low = shown["up_to_date"].min()
    figure.suptitle(
        f"Our own programme keeps the station up to date {low['own']:.0%} of the time or more at every Rmax,\n"
        f"the printed one {low['OPT']:.0%}"
    )
    seeds = run["beyond"]["seed"].nunique()
    note(figure, f"simulated; means over {seeds} seeds, bars from the lowest to the highest")
    return {name: table.reset_index() for name, table in shown.items()}


def _draw_groups(axes: Axes, run: Run[Config], column: str, scale: float) -> None:
    table, low, high = (scale * compare_ways(run, column, of) for of in ("mean", "min", "max"))
    spots = grouped_bars(axes, table, [_COLORS[str(way)] for way in table], width=0.85)
    for at, way in zip(spots, table, strict=True):
        ends = [table[way] - low[way], high[way] - table[way]]
        axes.errorbar(
            at, table[way], yerr=ends, fmt="none", color="#555555", capsize=2, elinewidth=1
        )
    for bars in (axes.containers[place] for place, way in enumerate(table) if "LC" in str(way)):
        for bar in bars:
            bar.set(hatch="////", edgecolor="white", linewidth=0)
    axes.set_xticks(range(len(table)), [f"{rate} Hz" for rate in table.index])
    axes.set_xlabel("Rmax")


@exp.figure("transmission_live", size=(10, 5.4))
def draw_live(figure: Figure, run: Run[Config]) -> dict[str, Any]:
    """Draw how far each live cell is from the model, and the bands asked for: losses left, latencies right."""
    live, agreed = run["live"], agreement(run)
    loss, latency = figure.subplots(1, 2, sharey=True)
    _draw_apart(loss, live, 100 * (live["loss_live"] - live["loss_model"]).astype(float))
    loss.axvspan(-100 * LOSS_WITHIN, 100 * LOSS_WITHIN, color="black", alpha=0.1, linewidth=0)
    loss.set(xlabel="packet loss, live less model (points)")
    _draw_apart(latency, live, (live["p50_live_ms"] / live["p50_model_ms"]).astype(float))
    latency.axvspan(
        1 / (1 + LATENCY_WITHIN), 1 / (1 - LATENCY_WITHIN), color="black", alpha=0.1, linewidth=0
    )
    latency.set(xlabel="median latency, live / model")
    figure.legend(
        *latency.get_legend_handles_labels(), loc="outside lower right", ncols=3, fontsize=8
    )
    said = ", ".join(f"{what}: {count}" for what, count in agreed.items())
    if len(live):
        note(
            figure,
            f"each cell once for {live['duration_s'].max():g} s; hollow: late; grey: asked for",
        )
    figure.suptitle(
        f"Live Cyclone DDS against the model: {said if len(live) else run.skipped('live')}"
    )
    return {"live": live, "agreement": agreed}


def _draw_apart(axes: Axes, live: pd.DataFrame, apart: pd.Series[float]) -> None:
    names = (
        live["method"]
        + ", "
        + live["rate_max_hz"].astype(str)
        + " Hz, "
        + live["depth"].astype(str)
    )
    cells_ = list(dict.fromkeys(names))
    for shift, (group, (label, color, marker)) in enumerate(GROUP_STYLES.items()):
        of_group = live["group"] == group
        for fair in (True, False):
            part = of_group & (live["kept_up"].astype(bool) == fair)
            places = [cells_.index(name) + 0.22 * (shift - 1) for name in names[part]]
            look: dict[str, Any] = {"label": label} if fair else {"markerfacecolor": "none"}
            axes.plot(apart[part], places, marker, color=color, markersize=5, **look)
    axes.set_yticks(range(len(cells_)), cells_, fontsize=8)
    axes.set_ylim(max(len(cells_), 1) - 0.5, -0.5)


_KINDS = {"calm": "third", "lossy": "proxy", "saturated": "standard"}


@exp.figure("transmission_validation", size=(10, 6.4))
def draw_validation(figure: Figure, run: Run[Config]) -> dict[str, Any]:
    """Draw every cell that validates a preset, live over the model: losses above, median latencies below."""
    table, said = by_cell(run), validated(run).set_index("preset")
    panels = figure.subplots(2, len(MODES), sharex="row", sharey="row")
    for preset, (loss, latency) in zip(MODES, panels.T, strict=True):
        line, part = said.loc[preset], table[table["preset"] == preset]
        _draw_cells(loss, part, "loss", "", 100.0)
        _draw_cells(latency, part, "p50", "_ms", 1.0)
        left_out = "" if line["enough"] else ": too few"
        kept = f"{line['kept']} of {line['cells']} cells kept their schedule{left_out}"
        within = f"{kept}\nwithin 3 points: {line['loss_within']:.0%}"
        loss.set_title(f"{PRESETS[preset].name}\n{within}", fontsize=9)
        latency.set_title(f"within 30 %: {line['latency_within']:.0%}", fontsize=9)
        loss.set(xlabel="loss, model (%)")
        latency.set(xlabel="median latency, model (ms)")
    if len(table):
        for loss, latency in panels.T:
            _draw_bands(loss, latency, table)
    panels[0][0].set(ylabel="loss, live (%)")
    panels[1][0].set(ylabel="median latency, live (ms)")
    panels[1][0].legend(loc="lower right", fontsize=8)
    read = "; ".join(f"{PRESETS[name].name}: {why}" for name, why in READ.items())
    shares = [
        f"{said[c].min():.0%} to {said[c].max():.0%}" for c in ("loss_within", "latency_within")
    ]
    if len(table):
        kept = f"loss within 3 points in {shares[0]}, median latency within 30 % in {shares[1]}"
        figure.suptitle(f"Live against the model: {kept} of cells")
        said_of = f"{len(table)} cells, medians of {len(played(run))} runs, bars: the lowest and the highest"
        note(figure, f"{said_of}; grey: asked of 90 % of the cells; {read}")
    else:
        figure.suptitle("Nothing played yet")
    return {"cells": table, "validated": said.reset_index()}


def _draw_cells(axes: Axes, table: pd.DataFrame, name: str, unit: str, scale: float) -> None:
    """Draw cells of a preset, with bars from the lowest to the highest repetition."""
    for kind, key in _KINDS.items():
        part = scale * table[table["kind"] == kind].filter(regex=f"^{name}_(live|model)")
        x, y = part[f"{name}_model{unit}"], part[f"{name}_live{unit}"]
        bars = [y - part[f"{name}_live{unit}_low"], part[f"{name}_live{unit}_high"] - y]
        style: dict[str, Any] = {"markersize": 4, "elinewidth": 0.8, "linestyle": "", **series(key)}
        axes.errorbar(x, y, yerr=bars, label=kind, alpha=0.8, **style)


def _draw_bands(loss: Axes, latency: Axes, live: pd.DataFrame) -> None:
    ends = np.array([0.0, 100.0])
    loss.plot(ends, ends, color="black", linewidth=0.8)
    loss.fill_between(
        ends, ends - 100 * LOSS_WITHIN, ends + 100 * LOSS_WITHIN, color="black", alpha=0.1
    )
    times = live[["p50_model_ms", "p50_live_ms"]].to_numpy(float)
    ends = np.array([0.8 * np.nanmin(times), 1.25 * np.nanmax(times)])
    latency.plot(ends, ends, color="black", linewidth=0.8)
    inside = (ends * (1 - LATENCY_WITHIN), ends * (1 + LATENCY_WITHIN))
    latency.fill_betweenx(ends, *inside, color="black", alpha=0.1)
    latency.set(xscale="log", yscale="log")


@exp.look(
    "hello",
    Look(
        turn=("loss", "depths", "rates_hz", "size_factor", "vendor"),
        needs=("cell",),
        size=(10, 3.6),
        start={"seeds": 1, "rates_hz": (100,), "depths": (10,)},
        coarse={"duration_s": 10.0},
        reference="transmission_loss",
    ),
)
def draw_hello(figure: Figure, run: Run[Config]) -> None:
    """Draw latency, loss and fate of "Hello" at one Rmax: a bar a method at this depth, one at the optimum."""
    depths = list(dict.fromkeys(run["cell"]["depth"]))
    names = ["the optimum" if depth == OPT_DEPTH else f"DEPTH {depth}" for depth in depths]
    latency, loss, *fates = figure.subplots(1, 2 + len(depths), sharey=True)
    for axes, column, label, scale in (
        (latency, "latency_p50_ms", "median latency (ms)", 1.0),
        (loss, "loss", "packet loss (%)", 100.0),
    ):
        table = cells(run, column).pivot_table(index="method", columns="depth", values="median")
        # Of what never arrives there is no latency, and no bar.
        table = scale * table.reindex(index=list(METHODS), columns=depths).set_axis(
            names, axis="columns"
        )
        colors: Any = [COLORS["standard"], COLORS["proxy"]]
        table.plot.barh(ax=axes, width=0.8, legend=axes is loss, color=colors)
        axes.set(xlabel=label, ylabel="")
    latency.set_xscale("log")
    shares = _shares_of_fates(run["cell"])
    for axes, depth, name in zip(fates, depths, names, strict=True):
        part = shares[shares["depth"] == depth].set_index("method").loc[list(METHODS), list(FATES)]
        (100 * part).plot.barh(
            ax=axes, stacked=True, legend=False, color=[c for _, c in FATES.values()]
        )
        axes.set(title=f"fate at {name}", xlabel="share (%)", ylabel="")
    bars = fates[-1].containers
    figure.legend(
        bars, [text for text, _ in FATES.values()], loc="outside lower center", ncols=3, fontsize=8
    )
