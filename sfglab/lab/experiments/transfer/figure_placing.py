"""Node mapping against brute force and simpler ways, redrawn from a log."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from sfglab.lab.figures import COLORS, MARKERS, PAPER_STYLE, house_style

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from sfglab.lab.experiments.transfer.analysis import Results


BASELINES = {
    "same_without_gateways": "same placement,\nno gateways",
    "greedy_with_gateways": "blind greedy,\nwith gateways",
    "greedy": "blind greedy,\nno gateways",
    "software": "all in\nsoftware",
}
_ASKED_S = 10.0
"""What is asked for 50 nodes, seconds."""


def figure_node_mapping(results: Results) -> tuple[Figure, dict[str, Any]]:
    """Draw node mapping against brute force, against simpler ways, and how long it takes.

    Args:
        results: The run.

    Returns:
        The figure and the numbers that it shows.
    """
    from matplotlib.figure import Figure

    placed = results.placed
    small, large = (placed[placed["kind"] == kind] for kind in ("small", "large"))
    with house_style():
        figure = Figure(figsize=(13.5, 4.4))
        exact, others, times = figure.subplots(1, 3, width_ratios=[1, 1.6, 1])
        axes_range = [0, 1.1 * small["placed"].max()]
        exact.plot(axes_range, axes_range, color="black", linewidth=0.8)
        exact.plot(small["brute_force"], small["placed"], color=COLORS["proxy"], marker="s", linestyle="")
        exact.set_xlabel("least cost, by brute force (s each second)")
        exact.set_ylabel("cost of the programme's mapping (s each second)")
        equal = int((np.abs(small["placed"] / small["brute_force"] - 1) < 1e-6).sum())
        exact.set_title(f"{equal} of {len(small)} small graphs: the best of all")
        _draw_baselines(others, results)
        _draw_seconds(times, results)
        slowest, nodes = large["seconds"].max(), large["nodes"].max()
        figure.suptitle(
            f"Node mapping with gateways: proved best for {int(placed['optimal'].sum())} of {len(placed)} "
            f"random graphs, {nodes} nodes in {slowest:.2f} s at most"
        )
    # What was not computed is null in the twin: NaN is no JSON.
    shown = placed.astype(object).where(placed.notna(), None)
    return figure, {"placed": shown.to_dict(orient="list")}


def _draw_baselines(axes: Axes, results: Results) -> None:
    for place, name in enumerate(BASELINES):
        for shift, kind, key in ((-0.12, "small", "third"), (0.12, "large", "proxy")):
            part = results.placed[results.placed["kind"] == kind]
            ratios = part[name] / part["placed"]
            axes.plot(
                np.full(len(ratios), place + shift),
                ratios,
                color=COLORS[key],
                marker=MARKERS[key],
                markersize=5,
                alpha=0.7,
                linestyle="",
                label=f"{_nodes(part)} nodes" if place == 0 else None,
            )
    axes.axhline(1, color="black", linewidth=0.8)
    axes.set_xticks(range(len(BASELINES)), list(BASELINES.values()))
    axes.set_ylabel("cost against the programme's mapping (times)")
    large = results.placed[results.placed["kind"] == "large"]
    axes.set_title(
        f"Ignoring communication costs {(large['greedy'] / large['placed']).median():.2f} times "
        "as much (large graphs, median)"
    )
    axes.legend(loc="upper left")


def _nodes(part: pd.DataFrame) -> str:
    least, most = part["nodes"].min(), part["nodes"].max()
    return str(least) if least == most else f"{least} to {most}"


def _draw_seconds(axes: Axes, results: Results) -> None:
    axes.plot(
        results.placed["nodes"], results.placed["seconds"], color=COLORS["proxy"], marker="s", linestyle=""
    )
    axes.axhline(_ASKED_S, color=COLORS["standard"], **PAPER_STYLE)
    axes.annotate("asked", (results.placed["nodes"].min(), _ASKED_S), va="bottom")
    axes.set_yscale("log")
    axes.set_xlabel("nodes")
    axes.set_ylabel("time of the programme (s)")
    axes.set_title("One programme, solver loaded")
