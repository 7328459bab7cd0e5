"""Residuals, break-even sizes, and node mapping against brute force and simpler ways."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from sfglab.lab.experiments.transfer.analysis import MAIN, fit_meaning, rtl_residual, stated
from sfglab.lab.experiments.transfer.experiment import Config, exp
from sfglab.lab.figures import COLORS, MARKERS, PAPER_STYLE

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from sfglab.lab.runs import Run


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


@exp.figure("transfer_residuals", size=(13.5, 4.6))
def draw_residuals(figure: Figure, run: Run[Config]) -> dict[str, Any]:
    """Draw how far the model is from the stated numbers, what assumptions change, and RTL against model."""
    left, assumed, cycles = figure.subplots(1, 3, width_ratios=[1.5, 1, 1])
    _draw_residuals(left, run)
    _draw_variants(assumed, run)
    _draw_cycles(cycles, run)
    meaning = fit_meaning(run)
    figure.suptitle(f"Model against paper and hardware. {meaning['fit'].split(':')[0].capitalize()}")
    return {
        "stated": stated(run).to_dict(orient="list"),
        "variants": run["variant"].to_dict(orient="list"),
        "cycles": run["cycles"].to_dict(orient="list"),
        "meaning": meaning,
    }


def _draw_residuals(axes: Axes, run: Run[Config]) -> None:
    for shift, (model, (key, label)) in zip((-0.15, 0.15), MODEL_STYLES.items(), strict=True):
        chosen = stated(run)[stated(run)["model"] == model]
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
    worst = stated(run).groupby("model")["residual"].apply(lambda part: part.abs().max() * 100)
    axes.set_title(
        f"Stated numbers: {worst[MAIN]:.1f} % off at most ({worst['cut-through']:.1f} % cut through)"
    )
    axes.legend(loc="lower left")


def _draw_variants(axes: Axes, run: Run[Config]) -> None:
    chosen = run["variant"]
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


def _draw_cycles(axes: Axes, run: Run[Config]) -> None:
    worst = rtl_residual(run)
    axes.axhspan(-_ASKED_RTL, _ASKED_RTL, color="0.93", zorder=0)
    axes.set_ylim(-1.2 * _ASKED_RTL, 1.2 * _ASKED_RTL)
    axes.axhline(0, color="black", linewidth=0.8)
    axes.set_ylabel("model against simulated cycles (%)")
    axes.set_xticks(range(len(PATH_LABELS)), list(PATH_LABELS.values()))
    if worst is None:
        axes.set_title("The hardware was not simulated")
        return
    ran = run["cycles"][run["cycles"]["simulated"]]
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


@exp.figure("transfer_break_even", size=(13.5, 4.6))
def draw_break_even(figure: Figure, run: Run[Config]) -> dict[str, Any]:
    """Draw from which size on a gateway is faster, and what a rule that knows sizes gains in Fig. 8."""
    first, second, third = figure.subplots(1, 3, width_ratios=[1, 1, 1.1])
    for axes, publisher in ((first, "hardware"), (second, "software")):
        _draw_break_even(axes, run, publisher)
    second.sharey(first)
    second.legend(loc="upper right")
    gain = _draw_rules(third, run)
    figure.suptitle(
        "From which message size a gateway is faster depends on who waits; "
        f"in Fig. 8 the paper's rule costs up to {gain:.0%} more than one that knows sizes"
    )
    return {
        "break_even": run["break_even"].to_dict(orient="list"),
        "sized": run["sized_mapping"].to_dict(orient="list"),
    }


def _draw_break_even(axes: Axes, run: Run[Config], publisher: str) -> None:
    table = run["break_even"]
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


def _draw_rules(axes: Axes, run: Run[Config]) -> float:
    """Draw predicted times against no gateway at all; return what the paper's rule costs more at most."""
    times = run["sized_mapping"].pivot_table(index="message_bytes", columns="rule", values="predicted_s")
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
    chosen = run["sized_mapping"][run["sized_mapping"]["rule"] == "size-aware"].set_index("message_bytes")[
        "gateways"
    ]
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


BASELINES = {
    "same_without_gateways": "same placement,\nno gateways",
    "greedy_with_gateways": "blind greedy,\nwith gateways",
    "greedy": "blind greedy,\nno gateways",
    "software": "all in\nsoftware",
}
_ASKED_S = 10.0
"""What is asked for 50 nodes, seconds."""


@exp.figure("node_mapping", size=(13.5, 4.4))
def draw_node_mapping(figure: Figure, run: Run[Config]) -> dict[str, Any]:
    """Draw node mapping against brute force, against simpler ways, and how long it takes."""
    placed = run["placed"]
    small, large = (placed[placed["kind"] == kind] for kind in ("small", "large"))
    exact, others, times = figure.subplots(1, 3, width_ratios=[1, 1.6, 1])
    axes_range = [0, 1.1 * small["placed"].max()]
    exact.plot(axes_range, axes_range, color="black", linewidth=0.8)
    exact.plot(small["brute_force"], small["placed"], color=COLORS["proxy"], marker="s", linestyle="")
    exact.set_xlabel("least cost, by brute force (s each second)")
    exact.set_ylabel("cost of the programme's mapping (s each second)")
    equal = int((np.abs(small["placed"] / small["brute_force"] - 1) < 1e-6).sum())
    exact.set_title(f"{equal} of {len(small)} small graphs: the best of all")
    _draw_baselines(others, run)
    _draw_seconds(times, run)
    slowest, nodes = large["seconds"].max(), large["nodes"].max()
    figure.suptitle(
        f"Node mapping with gateways: proved best for {int(placed['optimal'].sum())} of {len(placed)} "
        f"random graphs, {nodes} nodes in {slowest:.2f} s at most"
    )
    # What was not computed is null in the twin: NaN is no JSON.
    shown = placed.astype(object).where(placed.notna(), None)
    return {"placed": shown.to_dict(orient="list")}


def _draw_baselines(axes: Axes, run: Run[Config]) -> None:
    for place, name in enumerate(BASELINES):
        for shift, kind, key in ((-0.12, "small", "third"), (0.12, "large", "proxy")):
            part = run["placed"][run["placed"]["kind"] == kind]
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
    large = run["placed"][run["placed"]["kind"] == "large"]
    axes.set_title(
        f"Ignoring communication costs {(large['greedy'] / large['placed']).median():.2f} times "
        "as much (large graphs, median)"
    )
    axes.legend(loc="upper left")


def _nodes(part: pd.DataFrame) -> str:
    least, most = part["nodes"].min(), part["nodes"].max()
    return str(least) if least == most else f"{least} to {most}"


def _draw_seconds(axes: Axes, run: Run[Config]) -> None:
    axes.plot(run["placed"]["nodes"], run["placed"]["seconds"], color=COLORS["proxy"], marker="s", linestyle="")
    axes.axhline(_ASKED_S, color=COLORS["standard"], **PAPER_STYLE)
    axes.annotate("asked", (run["placed"]["nodes"].min(), _ASKED_S), va="bottom")
    axes.set_yscale("log")
    axes.set_xlabel("nodes")
    axes.set_ylabel("time of the programme (s)")
    axes.set_title("One programme, solver loaded")
