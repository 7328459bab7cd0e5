"""Figures 10 and 11 of paper B, redrawn from a run, and where each "Hello" was lost."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from sfglab.arp.robots import METHODS
from sfglab.lab.experiment import Look
from sfglab.lab.experiments.transmission.analysis import BEST, TIE, agreement, cells, compare_ways, order
from sfglab.lab.experiments.transmission.experiment import OPT_DEPTH, Config, exp
from sfglab.lab.experiments.transmission.stage import LATENCY_WITHIN, LOSS_WITHIN
from sfglab.lab.experiments.transmission.validation import MODES, READ, by_cell, validated
from sfglab.lab.figures import COLORS, grouped_bars
from sfglab.rtps import PRESETS

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from sfglab.lab.runs import Run


METHOD_STYLES: dict[str, dict[str, Any]] = {
    "none": {"color": "black", "marker": "o", "linestyle": "-"},
    "CC": {"color": COLORS["network"], "marker": "^", "linestyle": "--"},
    "OPT": {"color": COLORS["proxy"], "marker": "s", "linestyle": "-"},
    "OPT+CC": {"color": COLORS["fourth"], "marker": "v", "linestyle": "--"},
    "LC": {"color": COLORS["standard"], "marker": "D", "linestyle": "-"},
    "OPT+LC": {"color": COLORS["third"], "marker": "P", "linestyle": "-"},
    "OPT+LC+CC": {"color": COLORS["third"], "marker": "x", "linestyle": ":"},
}
FATES = {
    "arrived": ("arrived", COLORS["third"]),
    "lost_medium": ("lost on air, overwritten before repair", COLORS["fourth"]),
    "lost_queue": ("dropped by a full sender's queue, overwritten before repair", COLORS["standard"]),
    "lost_late": ("pushed out of the reader's history", COLORS["proxy"]),
    "lost_underway": ("still under way at the end", COLORS["network"]),
}
"""What became of a "Hello", and its colour, by column."""
WAY_COLORS = {
    "none": "black",
    "LC": COLORS["standard"],
    "OPT": COLORS["proxy"],
    "OPT+LC": COLORS["network"],
    "own": COLORS["fourth"],
    "own+LC": COLORS["third"],
}
GROUP_STYLES = {
    "sensors": (COLORS["third"], "s"),
    "hello_up": (COLORS["proxy"], "^"),
    "hello": (COLORS["standard"], "o"),
}
FATE_METHODS = ("none", "OPT", "LC", "OPT+LC")


@exp.figure("transmission_latency", size=(10, 6.2))
def draw_latency(figure: Figure, run: Run[Config]) -> dict[str, Any]:
    """Draw Fig. 10: the latency of "Hello", a panel for each Rmax."""
    wins = order(run, "latency_p50_ms", tie=TIE)["wins"]
    figure.suptitle(f'Latency of "Hello" (simulated): {BEST} is lowest at {wins.sum()} of {len(wins)} rates')
    table = cells(run, "latency_p50_ms")
    _draw_panels(figure, table, "median latency (ms)", "log")
    return {"latency_p50_ms": table}


@exp.figure("transmission_loss", size=(10, 6.2))
def draw_loss(figure: Figure, run: Run[Config]) -> dict[str, Any]:
    """Draw Fig. 11: the packet loss of "Hello", a panel for each Rmax."""
    wins = order(run, "loss")["wins"]
    figure.suptitle(
        f'Packet loss of "Hello" (simulated): {BEST} is lowest at {wins.sum()} of {len(wins)} rates'
    )
    table = cells(run, "loss")
    _draw_panels(figure, table, "packet loss (%)", "linear", scale=100.0)
    return {"loss": table}


def _draw_panels(figure: Figure, table: pd.DataFrame, label: str, kind: str, scale: float = 1.0) -> None:
    panels = figure.subplots(2, 2, sharex=True, sharey=True).ravel()
    for axes, rate in zip(panels, table["rate_max_hz"].unique(), strict=False):
        draw_panel(axes, table[table["rate_max_hz"] == rate], scale=scale)
        axes.set_title(f"Rmax = {rate} Hz", fontsize=9)
        axes.set_yscale(kind)
    for axes in panels[2:]:
        axes.set_xlabel("DEPTH")
    for axes in panels[::2]:
        axes.set_ylabel(label)
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside right center")


def draw_panel(axes: Axes, table: pd.DataFrame, *, scale: float = 1.0) -> None:
    """Draw the `cells` of one Rmax: a line a method over depths, bars from the lowest to the highest seed."""
    depths = list(dict.fromkeys(table["depth"]))
    for shift, method in enumerate(METHODS):
        if method not in set(table["method"]):
            continue
        part = table[table["method"] == method].set_index("depth").reindex(depths)
        middle = part["median"] * scale
        spread = np.stack([middle - part["min"] * scale, part["max"] * scale - middle])
        axes.errorbar(
            np.arange(len(depths)) + 0.04 * (shift - 3),
            middle,
            yerr=spread,
            label=method,
            markersize=4.5,
            linewidth=1.2,
            elinewidth=0.8,
            **METHOD_STYLES[method],
        )
    axes.set_xticks(range(len(depths)), depths)


@exp.figure("transmission_fates", size=(10, 7))
def draw_fates(figure: Figure, run: Run[Config]) -> dict[str, Any]:
    """Draw where "Hello"s were lost: a row a method, a column an Rmax, a bar a depth."""
    rates = run["cell"]["rate_max_hz"].unique()
    shares = _shares_of_fates(run["cell"])
    panels = figure.subplots(len(FATE_METHODS), len(rates), sharex=True, sharey=True, squeeze=False)
    for row, method in zip(panels, FATE_METHODS, strict=True):
        row[0].set_ylabel(f"{method}\nshare (%)")
        for axes, rate in zip(row, rates, strict=True):
            _draw_bars(axes, shares[(shares["rate_max_hz"] == rate) & (shares["method"] == method)])
    for axes, rate in zip(panels[0], rates, strict=True):
        axes.set_title(f"Rmax = {rate} Hz", fontsize=9)
    for axes in panels[-1]:
        axes.set_xlabel("DEPTH")
        axes.tick_params(axis="x", labelrotation=60)
    figure.legend(*panels[0][0].get_legend_handles_labels(), loc="outside lower center", ncols=3)
    figure.suptitle('What became of every "Hello" (simulated)')
    return {"shares": shares}


def _shares_of_fates(table: pd.DataFrame) -> pd.DataFrame:
    """Return the share of each fate among what was published, mean over seeds, by Rmax, method and depth."""
    shares = table[list(FATES)].div(table["published"], axis=0)
    keys = [table["rate_max_hz"], table["method"], table["depth"]]
    return shares.groupby(keys, sort=False).mean().reset_index()


def _draw_bars(axes: Axes, shares: pd.DataFrame) -> None:
    floor = np.zeros(len(shares))
    for column, (label, color) in FATES.items():
        axes.bar(range(len(shares)), 100 * shares[column], bottom=floor, color=color, width=0.8, label=label)
        floor = floor + 100 * shares[column].to_numpy()
    axes.set_xticks(range(len(shares)), list(shares["depth"]), fontsize=7)
    axes.grid(visible=False, axis="x")


@exp.figure("transmission_beyond", size=(10, 3.8))
def draw_beyond(figure: Figure, run: Run[Config]) -> dict[str, Any]:
    """Draw how long the station is up to date, and how late "Hello" is, for the printed problem and our own."""
    shown = {c: compare_ways(run, c) for c in ("up_to_date", "latency_p95_ms", "loss", "rate_high_hz")}
    fresh, late = figure.subplots(1, 2)
    _draw_groups(fresh, 100 * shown["up_to_date"])
    fresh.set(ylabel="station up to date (% of the time)", ylim=(0, 100))
    _draw_groups(late, shown["latency_p95_ms"])
    late.set(yscale="log", ylabel='"Hello", 95th percentile (ms)')
    figure.legend(*fresh.get_legend_handles_labels(), loc="outside right center")
    low = shown["up_to_date"].min()
    figure.suptitle(
        f"Whatever Rmax, our own programme keeps the station up to date {low['own']:.0%} of the time, "
        f"the printed one at worst {low['OPT']:.0%} (simulated)"
    )
    return {name: table.reset_index() for name, table in shown.items()}


def _draw_groups(axes: Axes, table: pd.DataFrame) -> None:
    grouped_bars(axes, table, [WAY_COLORS[str(way)] for way in table], width=0.85)
    axes.set_xticks(range(len(table)), [f"{rate} Hz" for rate in table.index])
    axes.set_xlabel("Rmax")


@exp.figure("transmission_live", size=(9.6, 4.6))
def draw_live(figure: Figure, run: Run[Config]) -> dict[str, Any]:
    """Draw live cells against the model: losses left, median latencies right, with the bands asked for."""
    live, agreed = run["live"], agreement(run)
    loss, latency = figure.subplots(1, 2)
    _draw_scatter(loss, live, ("loss_model", "loss_live"), 100.0)
    loss.set(xlabel="packet loss, model (%)", ylabel="packet loss, live (%)")
    _draw_scatter(latency, live, ("p50_model_ms", "p50_live_ms"), 1.0)
    latency.set(xlabel="median latency, model (ms)", ylabel="median latency, live (ms)")
    if len(live):
        _draw_bands(loss, latency, live)
        loss.legend(title="filled: kept its schedule", fontsize=8)
    said = ", ".join(f"{what}: {count}" for what, count in agreed.items())
    figure.suptitle(
        f"Live Cyclone DDS against the model: {said}" if len(live) else f"Nothing live: {run.skipped('live')}"
    )
    return {"live": live, "agreement": agreed}


def _draw_scatter(axes: Axes, live: pd.DataFrame, columns: tuple[str, str], scale: float) -> None:
    for group, (color, marker) in GROUP_STYLES.items():
        part = live[live["group"] == group]
        fair = part["kept_up"].astype(bool)
        for shown, face in ((part[fair], color), (part[~fair], "none")):
            x, y = (scale * shown[column].astype(float) for column in columns)
            label = group.replace("_", " ") if face != "none" else None
            axes.plot(x, y, marker, color=color, markerfacecolor=face, label=label)


_KINDS = {"calm": COLORS["third"], "lossy": COLORS["proxy"], "saturated": COLORS["standard"]}


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
        loss.set_title(
            f"{PRESETS[preset].name}\n{line['kept']} of {line['cells']} cells kept their schedule{left_out}\n"
            f"within 3 points: {line['loss_within']:.0%}; 30 %: {line['latency_within']:.0%}",
            fontsize=9,
        )
        loss.set(xlabel="loss, model (%)")
        latency.set(xlabel="median latency, model (ms)")
    if len(table):
        for loss, latency in panels.T:
            _draw_bands(loss, latency, table)
    panels[0][0].set(ylabel="loss, live (%)")
    panels[1][0].set(ylabel="median latency, live (ms)")
    figure.legend(*panels[0][0].get_legend_handles_labels(), loc="outside lower center", ncols=4)
    read = "; ".join(f"{PRESETS[name].name}: {why}" for name, why in READ.items())
    figure.suptitle(
        f"Reality beside the model, {len(table)} cells ({read})" if len(table) else "Nothing played yet"
    )
    return {"cells": table, "validated": said.reset_index()}


def _draw_cells(axes: Axes, table: pd.DataFrame, name: str, unit: str, scale: float) -> None:
    """Draw cells of a preset, with bars from the lowest to the highest repetition."""
    for kind, color in _KINDS.items():
        part = scale * table[table["kind"] == kind].filter(regex=f"^{name}_(live|model)")
        x, y = part[f"{name}_model{unit}"], part[f"{name}_live{unit}"]
        bars = [y - part[f"{name}_live{unit}_low"], part[f"{name}_live{unit}_high"] - y]
        axes.errorbar(
            x, y, yerr=bars, fmt="o", color=color, label=kind, markersize=4, elinewidth=0.8, alpha=0.8
        )


def _draw_bands(loss: Axes, latency: Axes, live: pd.DataFrame) -> None:
    ends = np.array([0.0, 100.0])
    loss.plot(ends, ends, color="black", linewidth=0.8)
    loss.fill_between(ends, ends - 100 * LOSS_WITHIN, ends + 100 * LOSS_WITHIN, color="black", alpha=0.1)
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
        table = scale * table.loc[list(METHODS), depths].set_axis(names, axis="columns")
        colors: Any = [COLORS["standard"], COLORS["proxy"]]
        table.plot.barh(ax=axes, width=0.8, legend=axes is loss, color=colors)
        axes.set(xlabel=label, ylabel="")
    latency.set_xscale("log")
    shares = _shares_of_fates(run["cell"])
    for axes, depth, name in zip(fates, depths, names, strict=True):
        part = shares[shares["depth"] == depth].set_index("method").loc[list(METHODS), list(FATES)]
        (100 * part).plot.barh(ax=axes, stacked=True, legend=False, color=[c for _, c in FATES.values()])
        axes.set(title=f"fate at {name}", xlabel="share (%)", ylabel="")
    bars = fates[-1].containers
    figure.legend(bars, [text for text, _ in FATES.values()], loc="outside lower center", ncols=3, fontsize=8)
