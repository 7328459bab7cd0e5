"""Figure 10 of paper A, redrawn with the paper's values in the same axes."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from sfglab.lab.experiments.latency.analysis import (
    added,
    first_mean,
    first_ratio,
    glass_median,
    look_medians,
    looks,
)
from sfglab.lab.experiments.latency.experiment import Config, exp
from sfglab.lab.figures import COLORS, PAPER_STYLE

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from numpy.typing import NDArray

    from sfglab.lab.runs import Run
    from sfglab.lab.stats import Estimate


PAPER_ADDED_MS = 2.6
PAPER_FIRST_MS = {"standard": 570.0, "on_demand": 1095.0}
"""Paper A, section 5.4."""

GLASS_LABELS = {
    "standard": "standard:\neach decodes",
    "decoder": "through the\ndecoder",
    "agent": "through routers\nand decoder",
}
FIRST_LABELS = {
    "standard": "standard,\nno decoder",
    "on_demand": "on demand,\nthe paper's way",
    "agent": "on demand,\nspare and replay",
}
BAR_COLORS = {
    "standard": COLORS["standard"],
    "decoder": COLORS["proxy"],
    "on_demand": COLORS["network"],
    "agent": COLORS["third"],
}


@exp.figure("latency", size=(9.6, 4.2))
def draw_latency(figure: Figure, run: Run[Config]) -> dict[str, Any]:
    """Draw glass-to-glass times (left) and times to the first picture (right)."""
    glass, first = figure.subplots(1, 2)
    draw_glass(glass, run)
    draw_first(first, run)
    ratio, more = first_ratio(run, "agent"), added(run, "decoder")
    figure.suptitle(
        f"Latency: the decoder adds {more.value:.1f} ms; with replay the first picture takes "
        f"{ratio.value:.2f} times standard [{ratio.low:.2f}, {ratio.high:.2f}]"
    )
    return _twin(run)


def draw_glass(axes: Axes, run: Run[Config]) -> None:
    """Draw the time from capture to the viewer's hands, a dot a look, and the paper's addition."""
    medians = look_medians(run)
    groups = {path: medians[path].dropna().to_numpy() for path in GLASS_LABELS}
    heights = {path: glass_median(run, path).value for path in groups}
    paper = heights["standard"] + PAPER_ADDED_MS
    _bars(axes, GLASS_LABELS, heights, groups)
    _paper_line(axes, 1, paper, f"paper:\n+{PAPER_ADDED_MS} ms")
    _limit(axes, groups, paper)
    axes.set_ylabel("capture to picture in hand (ms)")
    axes.set_title("glass to glass, without lens and display (paper, with both: 118.3 ms)", fontsize=9)


def draw_first(axes: Axes, run: Run[Config]) -> None:
    """Draw the time from the order to subscribe to the first picture, a dot a subscription."""
    table = looks(run)
    groups = {path: table.loc[table["path"] == path, "first_ms"].to_numpy() for path in FIRST_LABELS}
    _bars(axes, FIRST_LABELS, {path: float(group.mean()) for path, group in groups.items()}, groups)
    for position, path in enumerate(FIRST_LABELS):
        if path in PAPER_FIRST_MS:
            _paper_line(axes, position, PAPER_FIRST_MS[path], f"paper:\n{PAPER_FIRST_MS[path]:.0f} ms")
    _limit(axes, groups, max(PAPER_FIRST_MS.values()))
    axes.set_ylabel("order to first picture (ms)")
    axes.set_title("first picture after a subscription", fontsize=9)


def _bars(
    axes: Axes, labels: dict[str, str], heights: dict[str, float], groups: dict[str, NDArray[np.float64]]
) -> None:
    """Draw one bar a path, its samples beside its middle, and the range of two thirds of them."""
    for position, path in enumerate(labels):
        height, group = heights[path], groups[path]
        # The paper draws one standard deviation; this is the same where samples are normal, and does not follow
        # the one look in which the machine was busy elsewhere.
        low, high = np.percentile(group, (16, 84))
        axes.bar(position, height, color=BAR_COLORS[path], width=0.5)
        axes.errorbar(
            position, height, yerr=[[max(height - low, 0)], [max(high - height, 0)]], color="black", capsize=4
        )
        spots = position + np.linspace(-0.25, 0.25, len(group))
        axes.plot(spots, group, ".", color="black", markersize=3, alpha=0.4)
    names = [f"{text}\n{heights[path]:.{1 if heights[path] < 100 else 0}f} ms" for path, text in labels.items()]
    axes.set_xticks(range(len(labels)), names)
    axes.set_xlim(-0.5, len(labels) - 0.1)
    axes.grid(visible=False, axis="x")


def _limit(axes: Axes, groups: dict[str, NDArray[np.float64]], shown: float) -> None:
    """End the axis above nine tenths of each group; what lies beyond is marked at the edge with its value."""
    top = 1.3 * max(shown, *(float(np.percentile(group, 90)) for group in groups.values()))
    axes.set_ylim(0, top)
    for position, group in enumerate(groups.values()):
        beyond = sorted(group[group > top])
        if beyond:
            axes.plot(position, 0.98 * top, "^", color="black", markersize=4, alpha=0.6)
            values = ", ".join(f"{value:.0f}" for value in beyond)
            axes.annotate(values, (position + 0.06, 0.98 * top), va="center", fontsize=7)


def _paper_line(axes: Axes, position: int, height: float, text: str) -> None:
    axes.plot([position - 0.38, position + 0.4], [height, height], color="black", **PAPER_STYLE)
    axes.annotate(text, (position + 0.42, height), va="center", fontsize=8)


def _twin(run: Run[Config]) -> dict[str, Any]:
    shown: dict[str, Estimate] = {
        **{f"glass_{path}": glass_median(run, path) for path in GLASS_LABELS},
        **{f"added_{path}": added(run, path) for path in ("decoder", "agent")},
        **{f"first_{path}": first_mean(run, path) for path in (*FIRST_LABELS, "decoder")},
        **{f"first_ratio_{path}": first_ratio(run, path) for path in ("on_demand", "agent", "decoder")},
    }
    return {name: {"value": e.value, "low": e.low, "high": e.high, "unit": e.unit} for name, e in shown.items()}
