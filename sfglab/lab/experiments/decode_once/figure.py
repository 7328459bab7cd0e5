"""Figure 8 of paper A, redrawn from a log with the paper's slopes in the same axes."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from sfglab.lab.experiments.decode_once.analysis import CostModel, Results, Slopes, cost_model, slopes
from sfglab.lab.figures import COLORS, MARKERS, PAPER_STYLE, house_style

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


PAPER_CPU = {"standard": 6.5, "proxy": 1.8}
"""Per cent of one core per subscriber (paper A, section 5.2)."""

PAPER_NET_MBIT = 4.0
LABELS = {"standard": "standard: each decodes", "proxy": "decode once, share"}
NAMES = {"h264": "colour, H.264", "rvl": "depth, RVL"}


def figure_8(results: Results, codec: str = "h264") -> tuple[Figure, dict[str, Any]]:
    """Draw CPU, network and cost model of one stream over the number of subscribers.

    Args:
        results: The run.
        codec: Which stream.

    Returns:
        The figure and the numbers that it shows.
    """
    from matplotlib.figure import Figure

    found, fit = slopes(results, codec), cost_model(results, codec)
    with house_style():
        figure = Figure(figsize=(11.5, 3.9))
        cpu, net, cost = figure.subplots(1, 3, width_ratios=(1.15, 1.15, 1))
        draw_cpu(cpu, results, found, codec)
        draw_network(net, results, codec)
        draw_cost_model(cost, fit)
        figure.suptitle(
            f"Decode once per device ({NAMES.get(codec, codec)}): "
            f"{found.reduction.value:.1f} % less CPU per added subscriber "
            f"[{found.reduction.low:.1f}, {found.reduction.high:.1f}]"
        )
    return figure, _twin(found, fit)


def _spread(results: Results, codec: str, mode: str, column: str) -> tuple[Any, Any, Any]:
    r = results.readings
    chosen = r[(r["codec"] == codec) & (r["mode"] == mode)].groupby("subscribers")[column]
    mean, deviation = chosen.mean(), chosen.std().fillna(0)
    return mean.index.to_numpy(), mean.to_numpy(), deviation.to_numpy()


def _draw_modes(axes: Axes, results: Results, codec: str, column: str) -> dict[str, float]:
    """Draw both modes with one standard deviation, and return each mode's first mean."""
    first = {}
    for mode in ("standard", "proxy"):
        counts, mean, deviation = _spread(results, codec, mode, column)
        color = COLORS[mode]
        axes.plot(counts, mean, marker=MARKERS[mode], markersize=4.5, color=color, label=LABELS[mode])
        axes.fill_between(counts, mean - deviation, mean + deviation, color=color, alpha=0.18, linewidth=0)
        first[mode] = float(mean[0])
    axes.set_xlabel("local subscribers")
    axes.set_xticks(counts)
    axes.set_ylim(bottom=0)
    return first


def draw_cpu(axes: Axes, results: Results, found: Slopes, codec: str) -> None:
    """Draw the consumer's CPU over subscribers, with the paper's slopes for the colour stream."""
    first = _draw_modes(axes, results, codec, "cpu_percent")
    for mode, estimate in (("standard", found.cpu_standard), ("proxy", found.cpu_proxy)):
        counts, mean, _ = _spread(results, codec, mode, "cpu_percent")
        axes.annotate(
            f"{estimate.value:+.2f} %",
            (counts[-1], mean[-1]),
            textcoords="offset points",
            xytext=(-4, 7),
            ha="right",
            color=COLORS[mode],
        )
        if codec == "h264":
            paper = first[mode] + PAPER_CPU[mode] * (counts - counts[0])
            label = f"paper: +{PAPER_CPU[mode]} % each"
            axes.plot(counts, paper, color=COLORS[mode], label=label, **PAPER_STYLE)
    axes.set_ylabel("CPU of the consumer host (100 % = one core)")
    axes.set_title("CPU" + ("; the paper's slopes start at our first point" * (codec == "h264")), fontsize=9)
    axes.legend(fontsize=8)


def draw_network(axes: Axes, results: Results, codec: str) -> None:
    """Draw what the consumer's interface receives over subscribers, with the paper's lines."""
    _draw_modes(axes, results, codec, "rx_mbit_s")
    if codec == "h264":
        counts = np.array(axes.get_xticks())
        axes.plot(
            counts, PAPER_NET_MBIT * counts, color=COLORS["standard"], label="paper: linear", **PAPER_STYLE
        )
        flat = np.full_like(counts, PAPER_NET_MBIT, dtype=np.float64)
        axes.plot(counts, flat, color=COLORS["proxy"], label="paper: about 4 Mbit/s", **PAPER_STYLE)
    axes.set_ylabel("received at the consumer's interface (Mbit/s)")
    axes.set_title("network", fontsize=9)
    axes.legend(fontsize=8)


def draw_cost_model(axes: Axes, fit: CostModel) -> None:
    """Draw the fitted terms of Eq. 2 and 3 with their intervals, and the fit's residual."""
    terms = {"$c_{net}$": fit.net, "$c_{dec}$": fit.dec, "$c_{ipc}$": fit.ipc}
    values = [e.value for e in terms.values()]
    errors = np.array([(e.value - e.low, e.high - e.value) for e in terms.values()]).T.clip(min=0)
    colors = [COLORS["network"], COLORS["standard"], COLORS["proxy"]]
    bars = axes.bar(list(terms), values, color=colors, width=0.6, yerr=errors, capsize=4)
    axes.bar_label(bars, labels=[f"{v:.2f}" for v in values], padding=6)
    axes.margins(y=0.15)
    axes.set_ylabel("% of one core")
    axes.set_title(f"Eq. 2 and 3 fitted: {100 * fit.explained.value:.1f} % of the variance", fontsize=9)
    axes.grid(visible=False, axis="x")


def _twin(found: Slopes, fit: CostModel) -> dict[str, Any]:
    shown = {
        "cpu_standard": found.cpu_standard,
        "cpu_proxy": found.cpu_proxy,
        "reduction": found.reduction,
        "net_standard": found.net_standard,
        "net_proxy": found.net_proxy,
        "c_net": fit.net,
        "c_dec": fit.dec,
        "c_ipc": fit.ipc,
        "explained": fit.explained,
        "residual": fit.residual,
    }
    return {name: {"value": e.value, "low": e.low, "high": e.high, "unit": e.unit} for name, e in shown.items()}
