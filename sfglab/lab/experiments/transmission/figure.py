"""Figures 10 and 11 of paper B, redrawn from a log, and where each "Hello" was lost."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from sfglab.arp.robots import METHODS
from sfglab.lab.experiments.transmission.analysis import (
    BEST,
    LOSSES,
    TIE,
    Results,
    agreement,
    cells,
    compare_ways,
    order,
)
from sfglab.lab.experiments.transmission.live_rows import LATENCY_WITHIN, LOSS_WITHIN
from sfglab.lab.figures import COLORS, house_style

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


METHOD_STYLES: dict[str, dict[str, Any]] = {
    "none": {"color": "black", "marker": "o", "linestyle": "-"},
    "CC": {"color": COLORS["network"], "marker": "^", "linestyle": "--"},
    "OPT": {"color": COLORS["proxy"], "marker": "s", "linestyle": "-"},
    "OPT+CC": {"color": COLORS["fourth"], "marker": "v", "linestyle": "--"},
    "LC": {"color": COLORS["standard"], "marker": "D", "linestyle": "-"},
    "OPT+LC": {"color": COLORS["third"], "marker": "P", "linestyle": "-"},
    "OPT+LC+CC": {"color": COLORS["third"], "marker": "x", "linestyle": ":"},
}
FATE_COLORS = {
    "arrived": COLORS["third"],
    "lost_medium": COLORS["fourth"],
    "lost_queue": COLORS["standard"],
    "lost_late": COLORS["proxy"],
    "lost_underway": COLORS["network"],
}
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


@dataclass(frozen=True, slots=True, kw_only=True)
class _Axis:
    """How a column is drawn."""

    column: str
    label: str
    scale: float
    kind: str


_LATENCY = _Axis(column="latency_p50_ms", label="median latency (ms)", scale=1.0, kind="log")
_LOSS = _Axis(column="loss", label="packet loss (%)", scale=100.0, kind="linear")


def figure_latency(results: Results) -> tuple[Figure, dict[str, Any]]:
    """Draw Fig. 10: the latency of "Hello", a panel for each Rmax."""
    wins = order(results, _LATENCY.column, tie=TIE)["wins"]
    title = f'Latency of "Hello" (simulated): {BEST} is lowest at {wins.sum()} of {len(wins)} rates'
    return _panels(results, _LATENCY, title)


def figure_loss(results: Results) -> tuple[Figure, dict[str, Any]]:
    """Draw Fig. 11: the packet loss of "Hello", a panel for each Rmax."""
    wins = order(results, _LOSS.column)["wins"]
    title = f'Packet loss of "Hello" (simulated): {BEST} is lowest at {wins.sum()} of {len(wins)} rates'
    return _panels(results, _LOSS, title)


def _panels(results: Results, axis: _Axis, title: str) -> tuple[Figure, dict[str, Any]]:
    from matplotlib.figure import Figure

    table = cells(results, axis.column)
    with house_style():
        figure = Figure(figsize=(10, 6.2))
        panels = figure.subplots(2, 2, sharex=True, sharey=True).ravel()
        for axes, rate in zip(panels, table["rate_max_hz"].unique(), strict=False):
            draw_panel(axes, table[table["rate_max_hz"] == rate], scale=axis.scale)
            axes.set_title(f"Rmax = {rate} Hz", fontsize=9)
            axes.set_yscale(axis.kind)
        for axes in panels[2:]:
            axes.set_xlabel("DEPTH")
        for axes in panels[::2]:
            axes.set_ylabel(axis.label)
        handles, names = panels[0].get_legend_handles_labels()
        figure.legend(handles, names, loc="outside right center")
        figure.suptitle(title)
    return figure, {axis.column: table.to_dict(orient="list")}


def draw_panel(axes: Axes, table: pd.DataFrame, *, scale: float = 1.0) -> None:
    """Draw one panel: a line a method over the depths, bars from the lowest to the highest seed.

    Args:
        axes: Where.
        table: Cells of one Rmax, from `cells`.
        scale: What values are multiplied with.
    """
    depths = list(dict.fromkeys(table["depth"]))
    for shift, method in enumerate(METHODS):
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


def figure_beyond(results: Results) -> tuple[Figure, dict[str, Any]]:
    """Draw how long the station is up to date, and how late "Hello" is, for the printed problem and our own."""
    from matplotlib.figure import Figure

    shown = {c: compare_ways(results, c) for c in ("up_to_date", "latency_p95_ms", "loss", "rate_high_hz")}
    with house_style():
        figure = Figure(figsize=(10, 3.8))
        fresh, late = figure.subplots(1, 2)
        _groups(fresh, 100 * shown["up_to_date"])
        fresh.set_ylabel("station up to date (% of the time)")
        fresh.set_ylim(0, 100)
        _groups(late, shown["latency_p95_ms"])
        late.set_yscale("log")
        late.set_ylabel('"Hello", 95th percentile (ms)')
        handles, names = fresh.get_legend_handles_labels()
        figure.legend(handles, names, loc="outside right center")
        low = shown["up_to_date"].min()
        figure.suptitle(
            f"Whatever Rmax, our own programme keeps the station up to date {low['own']:.0%} of the time, "
            f"the printed one at worst {low['OPT']:.0%} (simulated)"
        )
    return figure, {name: table.reset_index().to_dict(orient="list") for name, table in shown.items()}


def _groups(axes: Axes, table: pd.DataFrame) -> None:
    width = 0.85 / len(table.columns)
    for place, way in enumerate(table.columns):
        spots = np.arange(len(table)) + (place - (len(table.columns) - 1) / 2) * width
        axes.bar(spots, table[way], width, label=way, color=WAY_COLORS[str(way)])
    axes.set_xticks(range(len(table)), [f"{rate} Hz" for rate in table.index])
    axes.set_xlabel("Rmax")
    axes.grid(visible=False, axis="x")


def figure_live(results: Results) -> tuple[Figure, dict[str, Any]]:
    """Draw live cells against the model: losses left, median latencies right, with the bands asked for."""
    from matplotlib.figure import Figure

    live = results.live
    with house_style():
        figure = Figure(figsize=(9.6, 4.6))
        loss, latency = figure.subplots(1, 2)
        _scatter(loss, live, ("loss_model", "loss_live"), 100.0)
        loss.set(xlabel="packet loss, model (%)", ylabel="packet loss, live (%)")
        _scatter(latency, live, ("p50_model_ms", "p50_live_ms"), 1.0)
        latency.set(xlabel="median latency, model (ms)", ylabel="median latency, live (ms)")
        if len(live):
            _bands(loss, latency, live)
            loss.legend(title="filled: kept its schedule", fontsize=8)
        agreed = ", ".join(f"{what}: {count}" for what, count in agreement(results).items())
        figure.suptitle(
            f"Live Cyclone DDS against the model: {agreed}"
            if len(live)
            else f"Nothing live: {results.hindrance}"
        )
    return figure, {"live": live.to_dict(orient="list"), "agreement": agreement(results)}


def _scatter(axes: Axes, live: pd.DataFrame, columns: tuple[str, str], scale: float) -> None:
    for group, (color, marker) in GROUP_STYLES.items():
        part = live[live["group"] == group]
        fair = part["kept_up"].astype(bool)
        for shown, face in ((part[fair], color), (part[~fair], "none")):
            x, y = (scale * shown[column].astype(float) for column in columns)
            label = group.replace("_", " ") if face != "none" else None
            axes.plot(x, y, marker, color=color, markerfacecolor=face, label=label)


def _bands(loss: Axes, latency: Axes, live: pd.DataFrame) -> None:
    ends = np.array([0.0, 100.0])
    loss.plot(ends, ends, color="black", linewidth=0.8)
    loss.fill_between(ends, ends - 100 * LOSS_WITHIN, ends + 100 * LOSS_WITHIN, color="black", alpha=0.1)
    times = live[["p50_model_ms", "p50_live_ms"]].to_numpy(float)
    ends = np.array([0.8 * np.nanmin(times), 1.25 * np.nanmax(times)])
    latency.plot(ends, ends, color="black", linewidth=0.8)
    inside = (ends * (1 - LATENCY_WITHIN), ends * (1 + LATENCY_WITHIN))
    latency.fill_betweenx(ends, *inside, color="black", alpha=0.1)
    latency.set(xscale="log", yscale="log")


def figure_fates(results: Results) -> tuple[Figure, dict[str, Any]]:
    """Draw where "Hello"s were lost: a row a method, a column an Rmax, a bar a depth."""
    from matplotlib.figure import Figure

    rates = results.cells["rate_max_hz"].unique()
    shares = _fates(results)
    with house_style():
        figure = Figure(figsize=(10, 7))
        panels = figure.subplots(len(FATE_METHODS), len(rates), sharex=True, sharey=True, squeeze=False)
        for row, method in zip(panels, FATE_METHODS, strict=True):
            row[0].set_ylabel(f"{method}\nshare (%)")
            for axes, rate in zip(row, rates, strict=True):
                _bars(axes, shares[(shares["rate_max_hz"] == rate) & (shares["method"] == method)])
        for axes, rate in zip(panels[0], rates, strict=True):
            axes.set_title(f"Rmax = {rate} Hz", fontsize=9)
        for axes in panels[-1]:
            axes.set_xlabel("DEPTH")
            axes.tick_params(axis="x", labelrotation=60)
        handles, names = panels[0][0].get_legend_handles_labels()
        figure.legend(handles, names, loc="outside lower center", ncols=3)
        figure.suptitle('What became of every "Hello" (simulated)')
    return figure, {"shares": shares.to_dict(orient="list")}


def _fates(results: Results) -> pd.DataFrame:
    """Return the share of each fate among what was published, mean over seeds, by Rmax, method and depth."""
    table = results.cells
    columns = ["arrived", *LOSSES]
    shares = table[columns].div(table["published"], axis=0)
    keys = [table["rate_max_hz"], table["method"], table["depth"]]
    return shares.groupby(keys, sort=False).mean().reset_index()


def _bars(axes: Axes, shares: pd.DataFrame) -> None:
    floor = np.zeros(len(shares))
    for column, color in FATE_COLORS.items():
        label = LOSSES.get(column, column)
        axes.bar(range(len(shares)), 100 * shares[column], bottom=floor, color=color, width=0.8, label=label)
        floor = floor + 100 * shares[column].to_numpy()
    axes.set_xticks(range(len(shares)), list(shares["depth"]), fontsize=7)
    axes.grid(visible=False, axis="x")
