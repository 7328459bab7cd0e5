"""Figure 9 of paper A, redrawn from a run with the paper's points in the same axes, and how it goes on."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from sfglab.lab.experiments.discovery.analysis import KEYS, live, summary
from sfglab.lab.experiments.discovery.experiment import ROUTED, STANDARD, Config, exp
from sfglab.lab.figures import COLORS, MARKERS

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from numpy.typing import NDArray

    from sfglab.lab.runs import Run

    Floats = NDArray[np.float64]


MODES = {STANDARD: "standard", ROUTED: "proxy"}
LABELS = {STANDARD: "standard: one domain", ROUTED: "routed: a domain for each agent"}
PAPER_S = {STANDARD: {6: 40.0}, ROUTED: {2: 0.8, 6: 2.9}}
"""Paper A, section 5.3: the ends of the ranges that the text names, by number of agents."""

PAPER_BYTES = {STANDARD: {6: 13.6e6}, ROUTED: {6: 13.6e6 / 10**1.8}}
_SIZES = (2, 3, 4, 6, 8, 12, 20, 50, 100, 200, 500, 1000)
_OFFSET = {STANDARD: -0.2, ROUTED: 0.2}
_ASIDE = 0.07
_NO_LINE: dict[str, Any] = {"color": "black", "linestyle": ""}
_PAPER_MARKER: dict[str, Any] = {"marker": "*", "s": 110, "facecolors": "none", "linewidths": 1.3, "zorder": 4}


@exp.figure("discovery_fleet", size=(9.2, 4.6), when=lambda run: not run["cell"].empty)
def draw_fleet(figure: Figure, run: Run[Config]) -> dict[str, Any]:
    """Draw discovery time (solid, linear) and traffic (dotted, logarithmic) over the number of agents.

    Both quantities of both modes are violins with their samples, with the paper's points.
    """
    fleets = live(run)
    time_axes = figure.subplots()
    bytes_axes = time_axes.twinx()
    for mode, style in MODES.items():
        color, aside = COLORS[style], _OFFSET[mode]
        for agents in sorted(fleets.sizes(mode)):
            times_s, received = (fleets.samples(mode, agents, c).ravel() for c in ("resolved_s", "own_bytes"))
            _draw_violin(time_axes, agents + aside - _ASIDE, times_s, color, solid=True)
            _draw_violin(bytes_axes, agents + aside + _ASIDE, np.log10(received), color, solid=False)
        logs = {n: np.log10(received) for n, received in PAPER_BYTES[mode].items()}
        for axes, at, points in ((time_axes, -_ASIDE, PAPER_S[mode]), (bytes_axes, _ASIDE, logs)):
            spots = np.array(list(points)) + aside + at
            axes.scatter(spots, list(points.values()), edgecolors=color, **_PAPER_MARKER)
    _dress(time_axes, bytes_axes, sorted(fleets.sizes(STANDARD) | fleets.sizes(ROUTED)))
    talkers, listeners = fleets.main_nodes()
    figure.suptitle(f"Fleet discovery: {talkers} publishing and {listeners} subscribing nodes on every agent")
    return {
        "fleets": _records(summary(run)),
        "paper": {
            "time_s": {mode: {str(n): v for n, v in points.items()} for mode, points in PAPER_S.items()},
            "bytes": {mode: {str(n): v for n, v in points.items()} for mode, points in PAPER_BYTES.items()},
        },
    }


def _draw_violin(axes: Axes, at: float, values: Floats, color: str, *, solid: bool) -> None:
    """Draw one distribution: its shape where there is one, all samples, and the median."""
    if np.ptp(values) > 0:
        parts = axes.violinplot(values, positions=[at], widths=0.17, showextrema=False)
        for body in parts["bodies"]:  # type: ignore[attr-defined]  # a list, whatever the stubs say
            body.set(facecolor=color if solid else "none", edgecolor=color, alpha=0.35 if solid else 0.9)
            body.set_linestyle("-" if solid else ":")
    axes.scatter(np.full(values.shape, at), values, s=5, color=color, alpha=0.55, linewidths=0, zorder=3)
    axes.hlines(
        np.median(values), at - 0.06, at + 0.06, color=color, linewidth=1.8, linestyles="-" if solid else ":"
    )


def _dress(time_axes: Axes, bytes_axes: Axes, sizes: list[int]) -> None:
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    time_axes.set_xticks(sizes)
    time_axes.set(xlabel="agents in the fleet", ylabel="time until an agent knows all its peers (s), solid")
    time_axes.set_ylim(bottom=0)
    bytes_axes.set_ylabel("received at its interface until then, dotted")
    bytes_axes.grid(visible=False)
    bytes_axes.spines["right"].set_visible(True)
    low, high = bytes_axes.get_ylim()
    ticks = np.arange(np.floor(low), np.ceil(high) + 1)
    bytes_axes.set_yticks(ticks, [_bytes_text(10**tick) for tick in ticks])
    handles = [
        *(Patch(facecolor=COLORS[style], alpha=0.5, label=LABELS[mode]) for mode, style in MODES.items()),
        Line2D([], [], color="black", linestyle="-", label="time (left)"),
        Line2D([], [], color="black", linestyle=":", label="traffic (right)"),
        Line2D([], [], marker="*", markersize=10, markerfacecolor="none", label="paper", **_NO_LINE),
    ]
    time_axes.legend(handles=handles, fontsize=8, loc="upper left")


def _bytes_text(number: float) -> str:
    for unit, size in (("MB", 1e6), ("kB", 1e3)):
        if number >= size:
            return f"{number / size:g} {unit}"
    return f"{number:g} B"


@exp.figure("discovery_scale", size=(10.4, 4.1))
def draw_scale(figure: Figure, run: Run[Config]) -> dict[str, Any]:
    """Draw time and traffic of every fleet there is, live and simulated, over the number of agents."""
    axes = figure.subplots(1, 2)
    for one, column, label, text in (
        (axes[0], "resolved_s", "time until an agent knows all its peers (s)", "{:g}".format),
        (axes[1], "own_bytes", "received at its interface until then", _bytes_text),
    ):
        _draw_fleets(one, run, column)
        one.set(xscale="log", yscale="log", xlabel="agents in the fleet", ylabel=label)
        low, high = one.get_ylim()
        ticks = 10.0 ** np.arange(np.ceil(np.log10(low)), np.floor(np.log10(high)) + 1)
        one.set_yticks(ticks, [text(tick) for tick in ticks])
        first, last = one.get_xlim()
        sizes = [size for size in _SIZES if first <= size <= last]
        one.set_xticks(sizes, [str(size) for size in sizes])
        one.minorticks_off()
    axes[1].legend(fontsize=8, loc="lower right")
    figure.suptitle("Fleet discovery beyond six agents")
    medians = run["simulated"].groupby(KEYS)[["resolved_s", "rx_bytes"]].median().reset_index()
    return {"live": _records(summary(run)), "simulated": _records(medians)}


def _draw_fleets(axes: Axes, run: Run[Config], column: str) -> None:
    for mode, style in MODES.items():
        for number, (nodes, table) in enumerate(_kinds(live(run).hosts, mode)):
            axes.scatter(
                table["agents"],
                table[column],
                marker=MARKERS[style],
                s=16,
                facecolors=COLORS[style] if number == 0 else "none",
                edgecolors=COLORS[style],
                alpha=0.6,
                label=f"{mode}, live, {nodes}",
            )
        simulated = "rx_bytes" if column == "own_bytes" else column
        for nodes, table in _kinds(run["simulated"], mode):
            by_size = table.groupby("agents")[simulated].agg(["min", "median", "max"])
            axes.plot(
                by_size.index, by_size["median"], color=COLORS[style], label=f"{mode}, simulated, {nodes}"
            )
            axes.fill_between(by_size.index, by_size["min"], by_size["max"], color=COLORS[style], alpha=0.18)


def _kinds(table: pd.DataFrame, mode: str) -> list[tuple[str, pd.DataFrame]]:
    """Return a mode's rows by the nodes of its agents, most nodes first."""
    if table.empty:
        return []
    groups = table[table["mode"] == mode].groupby(["talkers", "listeners"])
    found = sorted(groups, key=lambda item: item[0], reverse=True)
    return [(f"{talkers}+{listeners} nodes an agent", rows) for (talkers, listeners), rows in found]


def _records(table: pd.DataFrame) -> list[dict[str, Any]]:
    """Return a table as JSON values, a line a row."""
    return [
        {str(name): value.item() if hasattr(value, "item") else value for name, value in row.items()}
        for row in table.to_dict("records")
    ]
