"""Residuals and break-even sizes, redrawn from a log."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from sfglab.lab.experiments.transfer.analysis import MAIN, Results, rtl_residual
from sfglab.lab.experiments.transfer.claims import fit_meaning
from sfglab.lab.figures import COLORS, MARKERS, house_style

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


MODEL_STYLES = {MAIN: ("proxy", "core stores a chunk"), "cut-through": ("standard", "core cuts through")}
JUDGE_STYLES = {
    "hardware": ("standard", "-", "last hardware subscriber"),
    "software": ("proxy", "-", "software subscriber"),
    "last": ("third", "--", "whoever is last"),
}
RULE_STYLES = {
    "paper": ("standard", "the paper's rule"),
    "size-aware": ("proxy", "by predicted time"),
}
PATH_LABELS = {
    "gateway, memory to stream": "gateway\nout",
    "gateway, stream to memory": "gateway\nin",
    "shared reads": "shared\nreads",
    "write": "write",
}
_ASKED_STATED, _ASKED_RTL = 10.0, 5.0
"""What is asked: per cent of the stated numbers and of the hardware's cycles."""
_NEVER_BYTES = 2.0**33
_BYTE_TICKS = {256: "any", 1_000: "1 kB", 10_000: "10 kB", 100_000: "100 kB", 1_000_000: "1 MB"}
_BYTE_TICKS |= {10_000_000: "10 MB", 100_000_000: "100 MB", 1_000_000_000: "1 GB", int(_NEVER_BYTES): "never"}


def figure_residuals(results: Results) -> tuple[Figure, dict[str, Any]]:
    """Draw how far the model is from the stated numbers, what assumptions change, and RTL against model.

    Args:
        results: The run.

    Returns:
        The figure and the numbers that it shows.
    """
    from matplotlib.figure import Figure

    with house_style():
        figure = Figure(figsize=(13.5, 4.6))
        stated, assumed, cycles = figure.subplots(1, 3, width_ratios=[1.5, 1, 1])
        _draw_residuals(stated, results)
        _draw_variants(assumed, results)
        _draw_cycles(cycles, results)
        meaning = fit_meaning(results)
        figure.suptitle(f"Model against paper and hardware. {meaning['fit'].split(':')[0].capitalize()}")
    return figure, {
        "stated": results.stated.to_dict(orient="list"),
        "variants": results.variants.to_dict(orient="list"),
        "cycles": results.cycles.to_dict(orient="list"),
        "meaning": meaning,
    }


def _draw_residuals(axes: Axes, results: Results) -> None:
    for shift, (model, (key, label)) in zip((-0.15, 0.15), MODEL_STYLES.items(), strict=True):
        chosen = results.stated[results.stated["model"] == model]
        heights = np.arange(len(chosen)) + shift
        axes.plot(
            chosen["residual"] * 100, heights, color=COLORS[key], marker=MARKERS[key], linestyle="", label=label
        )
        labels = [
            f"{panel}: {value:.3g}" for panel, value in zip(chosen["panel"], chosen["stated"], strict=True)
        ]
    axes.set_yticks(range(len(labels)), labels)
    axes.invert_yaxis()
    axes.axvspan(-_ASKED_STATED, _ASKED_STATED, color="0.93", zorder=0)
    axes.axvline(0, color="black", linewidth=0.8)
    axes.set_xlabel("model against stated speed-up (%)")
    worst = results.stated.groupby("model")["residual"].apply(lambda part: part.abs().max() * 100)
    axes.set_title(
        f"Stated numbers: {worst[MAIN]:.1f} % off at most ({worst['cut-through']:.1f} % cut through)"
    )
    axes.legend(loc="lower left")


def _draw_variants(axes: Axes, results: Results) -> None:
    chosen = results.variants
    labels = [
        f"{name.removesuffix('_cycles').removesuffix('_s').replace('_', ' ')} x{factor:g}"
        for name, factor in zip(chosen["constant"], chosen["factor"], strict=True)
    ]
    order = list(dict.fromkeys(labels))
    for shift, (model, (key, _)) in zip((-0.15, 0.15), MODEL_STYLES.items(), strict=True):
        mine = [(order.index(label), worst) for label, worst, name in
                zip(labels, chosen["worst"], chosen["model"], strict=True) if name == model]  # fmt: skip
        axes.plot(
            [worst * 100 for _, worst in mine],
            [place + shift for place, _ in mine],
            color=COLORS[key],
            marker=MARKERS[key],
            linestyle="",
        )
    axes.set_yticks(range(len(order)), order)
    axes.invert_yaxis()
    axes.axvspan(0, _ASKED_STATED, color="0.93", zorder=0)
    axes.set_xlim(left=0)
    axes.set_xlabel("largest residual after a new fit (%)")
    axes.set_title("An assumed constant halved or doubled")


def _draw_cycles(axes: Axes, results: Results) -> None:
    worst = rtl_residual(results)
    axes.axhspan(-_ASKED_RTL, _ASKED_RTL, color="0.93", zorder=0)
    axes.set_ylim(-1.2 * _ASKED_RTL, 1.2 * _ASKED_RTL)
    axes.axhline(0, color="black", linewidth=0.8)
    axes.set_ylabel("model against simulated cycles (%)")
    axes.set_xticks(range(len(PATH_LABELS)), list(PATH_LABELS.values()))
    if worst is None:
        axes.set_title("The hardware was not simulated")
        return
    ran = results.cycles[results.cycles["simulated"]]
    for place, (count, part) in enumerate(ran.groupby("subscribers")):
        key = ("standard", "proxy", "third")[place % 3]
        axes.plot(
            [list(PATH_LABELS).index(path) + 0.15 * (place - 1) for path in part["path"]],
            (part["model_cycles"] / part["rtl_cycles"] - 1) * 100,
            color=COLORS[key],
            marker=MARKERS[key],
            linestyle="",
            label=f"{count} subscribers",
        )
    axes.legend(loc="lower right")
    axes.set_title(f"RTL: {worst:.2%} off at most")


def figure_break_even(results: Results) -> tuple[Figure, dict[str, Any]]:
    """Draw from which size on a gateway is faster, and what a rule that knows sizes gains in Fig. 8.

    Args:
        results: The run.

    Returns:
        The figure and the numbers that it shows.
    """
    from matplotlib.figure import Figure

    with house_style():
        figure = Figure(figsize=(13.5, 4.6))
        first, second, third = figure.subplots(1, 3, width_ratios=[1, 1, 1.1])
        for axes, publisher in ((first, "hardware"), (second, "software")):
            _draw_break_even(axes, results, publisher)
        second.sharey(first)
        second.legend(loc="upper right")
        gain = _draw_rules(third, results)
        figure.suptitle(
            "From which message size a gateway is faster depends on who waits; "
            f"in Fig. 8 the paper's rule costs up to {gain:.0%} more than one that knows sizes"
        )
    return figure, {
        "break_even": results.break_even.to_dict(orient="list"),
        "sized": results.sized.to_dict(orient="list"),
    }


def _draw_break_even(axes: Axes, results: Results, publisher: str) -> None:
    table = results.break_even
    for judge, (key, line, label) in JUDGE_STYLES.items():
        part = table[(table["publisher"] == publisher) & (table["judge"] == judge)].sort_values("subscribers")
        sizes = np.where(part["worth"], part["from_bytes"], _NEVER_BYTES)
        axes.plot(
            part["subscribers"],
            sizes,
            color=COLORS[key],
            linestyle=line,
            marker=MARKERS[key],
            markersize=4,
            label=label,
        )
    axes.set_yscale("log")
    axes.minorticks_off()
    axes.set_yticks(list(_BYTE_TICKS), list(_BYTE_TICKS.values()))
    axes.set_xticks(range(2, int(table["subscribers"].max()) + 1, 2))
    axes.set_xlabel("hardware subscribers")
    axes.set_ylabel("faster by a gateway from this message size")
    axes.set_title(f"{publisher} publishes")


def _draw_rules(axes: Axes, results: Results) -> float:
    """Draw predicted times against no gateway at all; return what the paper's rule costs more at most."""
    times = results.sized.pivot_table(index="message_bytes", columns="rule", values="predicted_s")
    for rule, (key, label) in RULE_STYLES.items():
        axes.plot(
            times.index,
            times[rule] / times["none"],
            color=COLORS[key],
            marker=MARKERS[key],
            markersize=4,
            linestyle="-" if rule == "paper" else "--",
            label=label,
        )
    chosen = results.sized[results.sized["rule"] == "size-aware"].set_index("message_bytes")["gateways"]
    for size in chosen.index[chosen.diff().fillna(1) != 0]:
        axes.annotate(
            f"{chosen[size]} gateways",
            (size, times["size-aware"][size] / times["none"][size]),
            xytext=(0, -16),
            textcoords="offset points",
            ha="center",
            fontsize="small",
        )
    axes.axhline(1, color="black", linewidth=0.8)
    axes.set_xscale("log")
    axes.set_xticks([100, 1_000, 10_000, 100_000, 1_000_000, 10_000_000],
                    ["100 B", "1 kB", "10 kB", "100 kB", "1 MB", "10 MB"])  # fmt: skip
    axes.minorticks_off()
    axes.set_xlabel("size of every message")
    axes.set_ylabel("predicted time, against no gateway (times)")
    axes.set_title("The example of Fig. 8, topics' times added")
    axes.legend(loc="lower left")
    return float((times["paper"] / times["size-aware"]).max() - 1)
