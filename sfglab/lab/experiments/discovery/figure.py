"""Figure 9 of paper A, redrawn from a log with the paper's points in the same axes, and how it goes on."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from sfglab.lab.experiments.discovery.analysis import samples, summary
from sfglab.lab.experiments.discovery.config import ROUTED, STANDARD
from sfglab.lab.figures import COLORS, MARKERS, house_style

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from numpy.typing import NDArray

    from sfglab.lab.experiments.discovery.analysis import Results

    Floats = NDArray[np.float64]


MODES = {STANDARD: "standard", ROUTED: "proxy"}
LABELS = {STANDARD: "standard: one domain", ROUTED: "routed: a domain for each agent"}
PAPER_S = {STANDARD: {6: 40.0}, ROUTED: {2: 0.8, 6: 2.9}}
"""Paper A, section 5.3: the ends of the ranges that the text names, by number of agents."""

PAPER_BYTES = {STANDARD: {6: 13.6e6}, ROUTED: {6: 13.6e6 / 10**1.8}}
_SIZES = (2, 3, 4, 6, 8, 12, 20, 50, 100, 200, 500, 1000)
_OFFSET = {STANDARD: -0.2, ROUTED: 0.2}
_ASIDE = 0.07
_PAPER_MARKER: dict[str, Any] = {"marker": "*", "s": 110, "facecolors": "none", "linewidths": 1.3, "zorder": 4}


def figure_9(results: Results) -> tuple[Figure, dict[str, Any]]:
    """Draw discovery time (solid, linear) and traffic (dotted, logarithmic) over the number of agents.

    Args:
        results: The run.

    Returns:
        The figure and the numbers that it shows.
    """
    from matplotlib.figure import Figure

    talkers, listeners = results.main_nodes()
    with house_style():
        figure = Figure(figsize=(9.2, 4.6))
        time_axes = figure.subplots()
        bytes_axes = time_axes.twinx()
        draw_fleet(time_axes, bytes_axes, results)
        figure.suptitle(
            f"Fleet discovery: {talkers} publishing and {listeners} subscribing nodes on every agent"
        )
    return figure, _twin(results)


def draw_fleet(time_axes: Axes, bytes_axes: Axes, results: Results) -> None:
    """Draw both quantities of both modes as violins with their samples, and the paper's points."""
    sizes = set()
    for mode, style in MODES.items():
        color = COLORS[style]
        for agents in sorted(set(results.cells["agents"])):
            times_s = samples(results, mode, int(agents), "resolved_s").ravel()
            received = samples(results, mode, int(agents), "own_bytes").ravel()
            if times_s.size:
                sizes.add(int(agents))
                at = agents + _OFFSET[mode]
                _violin(time_axes, at - _ASIDE, times_s, color, solid=True)
                _violin(bytes_axes, at + _ASIDE, np.log10(received), color, solid=False)
        for axes, aside, points in (
            (time_axes, -_ASIDE, PAPER_S[mode]),
            (bytes_axes, _ASIDE, {n: np.log10(received) for n, received in PAPER_BYTES[mode].items()}),
        ):
            at = np.array(list(points)) + _OFFSET[mode] + aside
            axes.scatter(at, list(points.values()), edgecolors=color, **_PAPER_MARKER)
    _dress(time_axes, bytes_axes, sorted(sizes))


def _violin(axes: Axes, at: float, values: Floats, color: str, *, solid: bool) -> None:
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
    time_axes.set_xlabel("agents in the fleet")
    time_axes.set_ylabel("time until an agent knows all its peers (s), solid")
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
        Line2D(
            [],
            [],
            color="black",
            marker="*",
            markersize=10,
            markerfacecolor="none",
            linestyle="",
            label="paper",
        ),
    ]
    time_axes.legend(handles=handles, fontsize=8, loc="upper left")


def _bytes_text(number: float) -> str:
    for unit, size in (("MB", 1e6), ("kB", 1e3)):
        if number >= size:
            return f"{number / size:g} {unit}"
    return f"{number:g} B"


def figure_scale(results: Results) -> tuple[Figure, dict[str, Any]]:
    """Draw time and traffic of every fleet there is, live and simulated, over the number of agents.

    Args:
        results: The run.

    Returns:
        The figure and the numbers that it shows.
    """
    from matplotlib.figure import Figure

    with house_style():
        figure = Figure(figsize=(10.4, 4.1))
        axes = figure.subplots(1, 2)
        for one, column, label in zip(
            axes,
            ("resolved_s", "own_bytes"),
            ("time until an agent knows all its peers (s)", "received at its interface until then"),
            strict=True,
        ):
            _draw_scale(one, results, column)
            one.set(xscale="log", yscale="log", xlabel="agents in the fleet", ylabel=label)
        for one, text in zip(axes, ("{:g}".format, _bytes_text), strict=True):
            low, high = one.get_ylim()
            ticks = 10.0 ** np.arange(np.ceil(np.log10(low)), np.floor(np.log10(high)) + 1)
            one.set_yticks(ticks, [text(tick) for tick in ticks])
            first, last = one.get_xlim()
            sizes = [size for size in _SIZES if first <= size <= last]
            one.set_xticks(sizes, [str(size) for size in sizes])
            one.minorticks_off()
        axes[1].legend(fontsize=8, loc="lower right")
        figure.suptitle("Fleet discovery beyond six agents")
    return figure, {
        "live": _records(summary(results)) if len(results.cells) else [],
        **_simulated_twin(results),
    }


def _draw_scale(axes: Axes, results: Results, column: str) -> None:
    for mode, style in MODES.items():
        for number, (nodes, table) in enumerate(_kinds(results.hosts, mode)):
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
        for nodes, table in _kinds(results.simulated, mode):
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


def _twin(results: Results) -> dict[str, Any]:
    return {
        "fleets": _records(summary(results)),
        "paper": {
            "time_s": {mode: {str(n): v for n, v in points.items()} for mode, points in PAPER_S.items()},
            "bytes": {mode: {str(n): v for n, v in points.items()} for mode, points in PAPER_BYTES.items()},
        },
    }


def _simulated_twin(results: Results) -> dict[str, Any]:
    if results.simulated.empty:
        return {"simulated": []}
    groups = results.simulated.groupby(["mode", "agents", "talkers", "listeners"])
    table = groups[["resolved_s", "rx_bytes"]].median().reset_index()
    return {"simulated": _records(table)}
