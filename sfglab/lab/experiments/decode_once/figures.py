"""Figure 8 of paper A, redrawn with the paper's slopes in the same axes."""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING, Any

import numpy as np

from sfglab.fields import to_json
from sfglab.lab.experiment import Look
from sfglab.lab.experiments.decode_once.analysis import (
    PAPER_CPU,
    WAYS,
    CostModel,
    Slopes,
    cells,
    codecs,
    cost_model,
    design,
    modes_of,
    papers_way,
    readings,
    slopes,
    stream_facts,
)
from sfglab.lab.experiments.decode_once.experiment import Config, exp
from sfglab.lab.figures import COLORS, PAPER_STYLE, note, series
from sfglab.lab.paths import find_project

if TYPE_CHECKING:
    from collections.abc import Mapping

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from numpy.typing import NDArray

    from sfglab.lab.runs import Run

PAPER_NET_MBIT = 4.0
LABELS = {
    "standard": "standard: each decodes",
    "dds": "decode once, DDS (the paper's way)",
    "proxy": "decode once, shared memory (ours)",
}
STYLES = {"standard": series("standard"), "dds": series("third"), "proxy": series("proxy")}
NAMES = {"h264": "colour, H.264", "rvl": "depth, RVL"}


@exp.figure("decode_once_h264", size=(11.5, 3.9))
def draw_colour(figure: Figure, run: Run[Config]) -> dict[str, Any]:
    """Draw CPU, network and cost model of the colour stream over the number of subscribers."""
    return _draw_stream(figure, run, "h264")


@exp.figure("decode_once_rvl", size=(11.5, 3.9), when=lambda run: "rvl" in codecs(run))
def draw_depth(figure: Figure, run: Run[Config]) -> dict[str, Any]:
    """Draw CPU, network and cost model of the depth stream over the number of subscribers."""
    return _draw_stream(figure, run, "rvl")


def _draw_stream(figure: Figure, run: Run[Config], codec: str) -> dict[str, Any]:
    found = slopes(run, codec)
    fits = {way: cost_model(run, codec, way) for way in found.reduction}
    cpu, net, cost = figure.subplots(1, 3, width_ratios=(1.15, 1.15, 1))
    _draw_cpu(cpu, run, found, codec)
    _draw_network(net, run, codec)
    again = int(
        cells(run)[cells(run)["codec"] == codec].groupby(["mode", "subscribers"]).size().max()
    )
    _draw_cost_model(cost, fits, spread=again > 1)
    less = [
        f"{_saving(found, mode, has_interval=again > 1)} by {WAYS[mode]}"
        for mode in found.reduction
    ]
    figure.suptitle(
        f"Decode once ({NAMES.get(codec, codec)}), CPU of an added subscriber: {', '.join(less)}"
    )
    often = (
        f"{again} runs a setting: 95 % intervals"
        if again > 1
        else "one run a setting: no intervals"
    )
    each = readings(run).groupby(["cell", "label"]).size().max()
    note(figure, f"{often}; {each} readings a run, bands: one standard deviation of them", run)
    terms = {"net": "c_net", "dec": "c_dec", "ipc": "c_ipc"}
    terms |= {name: name for name in ("explained", "residual", "lack")}
    shown = {
        way: {said: getattr(fit, name) for name, said in terms.items()} for way, fit in fits.items()
    }
    return {**to_json(found), **shown}


def _saving(found: Slopes, mode: str, *, has_interval: bool) -> str:
    """Return in words how much less CPU a further subscriber takes than with the baseline."""
    reduction = found.reduction[mode]
    if not found.can_compare(mode):
        return "not measurable"
    if reduction.value < 0:
        return f"{-reduction.value:.0f} % more"
    interval = f" [{reduction.low:.0f}, {reduction.high:.0f}]" if has_interval else ""
    return f"{reduction.value:.0f} %{interval} less"


def _spread(run: Run[Config], codec: str, mode: str, column: str) -> tuple[Any, Any, Any]:
    r = readings(run)
    chosen = r[(r["label"] == "consumer") & (r["codec"] == codec) & (r["mode"] == mode)]
    by_count = chosen.groupby("subscribers")[column]
    mean, deviation = by_count.mean(), by_count.std().fillna(0)
    return mean.index.to_numpy(), mean.to_numpy(), deviation.to_numpy()


def _draw_modes(axes: Axes, run: Run[Config], codec: str, column: str) -> dict[str, float]:
    """Draw the modes with one standard deviation, and return each mode's first mean."""
    first = {}
    for mode in modes_of(run, codec):
        counts, mean, deviation = _spread(run, codec, mode, column)
        color = STYLES[mode]["color"]
        axes.plot(counts, mean, markersize=4.5, label=LABELS[mode], **STYLES[mode])
        axes.fill_between(
            counts, mean - deviation, mean + deviation, color=color, alpha=0.18, linewidth=0
        )
        first[mode] = float(mean[0])
    axes.set(xlabel="local subscribers", xticks=_spread(run, codec, "standard", column)[0])
    return first


def _draw_cpu(axes: Axes, run: Run[Config], found: Slopes, codec: str) -> None:
    """Draw the consumer's CPU over subscribers, with the paper's slopes for the colour stream."""
    first = _draw_modes(axes, run, codec, "cpu_percent")
    for line, estimate in zip(axes.get_lines(), found.cpu.values(), strict=True):
        line.set_label(f"{line.get_label()}: {estimate.value:+.1f} % each")
    if codec == "h264":
        for mode, slope in zip(("standard", papers_way(run)), PAPER_CPU, strict=True):
            counts = _spread(run, codec, mode, "cpu_percent")[0]
            paper, color = first[mode] + slope * (counts - counts[0]), STYLES[mode]["color"]
            axes.plot(counts, paper, color=color, label=f"paper: +{slope} % each", **PAPER_STYLE)
    _label(axes, "consumer's CPU (100 % = one core)")
    axes.set_title(
        "CPU" + ("; the paper's slopes start at our first point" * (codec == "h264")), fontsize=9
    )


def _draw_network(axes: Axes, run: Run[Config], codec: str) -> None:
    _draw_modes(axes, run, codec, "rx_mbit_s")
    if codec == "h264":
        counts = np.array(axes.get_xticks())
        linear = PAPER_NET_MBIT * counts
        axes.plot(counts, linear, color=COLORS["standard"], label="paper: linear", **PAPER_STYLE)
        flat = np.full_like(counts, PAPER_NET_MBIT, dtype=np.float64)
        color = STYLES[papers_way(run)]["color"]
        axes.plot(counts, flat, color=color, label="paper: about 4 Mbit/s", **PAPER_STYLE)
    _label(axes, "received by the consumer (Mbit/s)")
    axes.set_title("network", fontsize=9)


def _label(axes: Axes, what: str) -> None:
    axes.set(ylabel=what, ylim=(0, 1.45 * axes.dataLim.ymax))  # room for the legend
    axes.legend(fontsize=8, loc="upper left")


def _draw_cost_model(axes: Axes, fits: Mapping[str, CostModel], *, spread: bool) -> None:
    """Draw the fitted terms of Eq. 2 and 3; each way of handing on has its own c_ipc."""
    fit = next(iter(fits.values()))
    terms = {"$c_{net}$": (fit.net, COLORS["network"]), "$c_{dec}$": (fit.dec, COLORS["standard"])}
    terms |= {f"$c_{{ipc}}$, {WAYS[m]}": (one.ipc, STYLES[m]["color"]) for m, one in fits.items()}
    estimates, colors = zip(*terms.values(), strict=True)
    values = [e.value for e in estimates]
    errors = np.array([(e.value - e.low, e.high - e.value) for e in estimates]).T.clip(min=0)
    names = [name.replace(" ", "\n") for name in terms]
    bars = axes.bar(
        names, values, color=colors, width=0.6, yerr=errors if spread else None, capsize=4
    )
    axes.bar_label(bars, labels=[f"{v:.1f}" for v in values], padding=6)
    axes.margins(y=0.15)
    axes.set_ylabel("% of one core")
    lack = (
        f"\nlack of fit: p {'< 0.001' if fit.lack.p < 1e-3 else f'= {fit.lack.p:.2g}'}"
        if fit.lack
        else ""
    )
    axes.set_title(
        f"Eq. 2 and 3 fitted: {100 * fit.explained.value:.0f} % of the variance{lack}", fontsize=9
    )
    axes.grid(visible=False, axis="x")


@cache
def _reference_terms() -> tuple[dict[str, NDArray[np.float64]], float]:
    """Return the reference run's terms of Eq. 2 and 3 by mode, % of a core, and its stream's rate, Mbit/s."""
    reference = exp.load(find_project().reference_logs / f"{exp.name}.mcap")
    modes = modes_of(reference)
    ways = {mode: mode if mode in WAYS else modes[1] for mode in modes}
    fits = {mode: cost_model(reference, way=way) for mode, way in ways.items()}
    terms = {
        mode: np.array([fit.net.value, fit.dec.value, fit.ipc.value]) for mode, fit in fits.items()
    }
    return terms, stream_facts(reference).bitrate.value


@exp.look(
    "equations",
    Look(turn=("most", "multicast"), needs=(), size=(10, 3.6), reference="decode_once_h264"),
)
def draw_equations(figure: Figure, run: Run[Config]) -> None:
    """Draw what Eq. 2 and 3 say of so many subscribers, with the terms fitted to the reference run's colour.

    Nothing is measured here; what the network carries follows from the stream's rate and from multicast.
    """
    terms, rate = _reference_terms()
    counts = np.arange(1, run.config.most + 1)
    copies = counts if run.config.multicast == "spdp" else np.ones_like(counts)
    cpu, net = figure.subplots(1, 2)
    for place, mode in enumerate(terms):
        style: dict[str, Any] = {**STYLES[mode], "label": LABELS[mode]}
        style |= {"linewidth": 5.5 - 2 * place}  # where they are equal, all are seen
        cpu.plot(counts, [np.dot(terms[mode], design(mode, float(n))) for n in counts], **style)
        net.plot(counts, rate * (copies if mode == "standard" else np.ones_like(counts)), **style)
    cpu.set(ylabel="CPU of the consumer (% of a core)", title="Eq. 2 and 3")
    net.set(
        ylabel="received by the consumer (Mbit/s)",
        title=f"network, multicast: {run.config.multicast}",
    )
    for axes in (cpu, net):
        axes.set(xlabel="local subscribers", xticks=counts, ylim=(0, 1.1 * axes.dataLim.ymax))
    cpu.legend(fontsize=8)
    figure.suptitle(
        "Computed, not measured: terms and bit rate of the reference run; Run all measures"
    )
