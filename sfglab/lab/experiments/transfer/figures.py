"""Figures 6 and 7 of paper C redrawn from a log, by the model and live, and what follows beyond the paper.

Beyond: residuals, break-even sizes, and node mapping against brute force and simpler ways.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from sfglab.lab.experiment import Look
from sfglab.lab.experiments.transfer.analysis import (
    MAIN,
    bars,
    bars_of,
    fit_meaning,
    live_agreement,
    live_note,
    live_table,
    rtl_residual,
    stated,
)
from sfglab.lab.experiments.transfer.experiment import Config, exp
from sfglab.lab.figures import COLORS, PAPER_STYLE, note, series
from sfglab.soc.paper_values import Panel

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from sfglab.lab.runs import Run

TRANSPORT_COLORS = {"smt": COLORS["standard"], "gateway": COLORS["proxy"]}
NODE_STYLES: dict[int, dict[str, Any]] = {
    2: {"color": "#E69F00", "marker": "o", "linestyle": ":"},
    4: {"color": COLORS["fourth"], "marker": "s", "linestyle": "--"},
    8: {"color": COLORS["third"], "marker": "^", "linestyle": "-"},
}
"""By number of hardware subscribers."""
SIZE_LABELS = {10_000: "10 kB", 100_000: "100 kB", 1_000_000: "1 MB", 10_000_000: "10 MB"}
_RATIO_TICKS = (0.25, 0.5, 1, 2, 4, 8, 16)
_MS_PER_S = 1e3


@exp.figure("transfer", size=(10, 6.6))
def draw_transfer(figure: Figure, run: Run[Config]) -> dict[str, Any]:
    """Draw the model's transfer times (above) and speed-ups (below), with RTL markers and the stated ends."""
    grid = figure.subplots(2, len(Panel), sharex=True, sharey="row")
    for times, ratios, panel in zip(*grid, Panel, strict=True):
        table = bars_of(run, panel)
        for transport, color in TRANSPORT_COLORS.items():
            for count in _counts(table):
                _draw_times(times, table, count, table[f"{transport}_s"] * _MS_PER_S, color)
        _draw_ratios(ratios, table, markersize=4)
        _draw_ratios(
            ratios, bars_of(run, panel, model="rtl"), markersize=9, mfc="none", linestyle=""
        )
        _draw_stated(ratios, run, panel)
        times.set_title(panel.value)
    _finish(
        grid, run, "gateway,\nany number of subscribers", "hollow: with RTL's cycles\ndashed: paper"
    )
    worst = stated(run)[stated(run)["model"] == MAIN]["residual"].abs().max()
    figure.suptitle(
        "A gateway pays for large messages and many hardware subscribers,\n"
        f"and costs time towards software (the paper's ends within {worst:.1%})"
    )
    note(
        figure,
        "model, six of its constants fitted to these ends, others assumed; dashed: the paper's",
    )
    return {"bars": bars(run), "stated": stated(run)}


@exp.figure("transfer_live", size=(10, 6.6), when=lambda run: not run["crossing"].empty)
def draw_live_transfer(figure: Figure, run: Run[Config]) -> dict[str, Any]:
    """Draw medians across processes with their intervals, and the model's speed-ups as thin lines."""
    table = live_table(run)
    grid = figure.subplots(2, len(Panel), sharex=True, sharey="row")
    for times, ratios, panel in zip(*grid, Panel, strict=True):
        chosen = table[table["panel"] == panel.value].sort_values("message_bytes")
        for count in _counts(chosen):
            for transport, color in TRANSPORT_COLORS.items():
                _draw_times(times, chosen, count, chosen[f"{transport}_ms"], color)
            _draw_live_ratios(ratios, chosen[chosen["subscribers"] == count], count)
        times.set_title(panel.value)
    _finish(grid, run, "gateway", "thin: the board's model")
    all_, decided, same = live_agreement(table)
    said = f"Across processes {decided} of {all_} speed-ups are decided, {same} of them as the model has them"
    figure.suptitle(said)
    note(figure, f"live: medians, bars: 95 % interval; {live_note(run)}")
    agreement = {"bars": all_, "decided": decided, "as the model": same}
    return {"live": table, "conditions": live_note(run), "agreement": agreement}


@exp.look(
    "sizes",
    Look(
        turn=(
            "message_bytes",
            "subscribers",
            "read_latency_cycles",
            "write_latency_cycles",
            "delegate_us",
            "endpoint_us",
            "cancel_us",
        ),
        needs=("curves",),
        size=(13.5, 3.6),
        reference="transfer",
    ),
)
def draw_curves(figure: Figure, run: Run[Config]) -> None:
    """Draw transfer times over sizes by the run's own constants, and what a gateway gains at its size."""
    size, seconds = run.config.message_bytes, run["curve"].set_index("message_bytes")
    for axes, panel in zip(
        figure.subplots(1, len(Panel), sharex=True, sharey=True), Panel, strict=True
    ):
        table = seconds[seconds["panel"] == panel.value]
        for transport, color in TRANSPORT_COLORS.items():
            name = "gateway" if transport == "gateway" else "software-mapped topic"
            axes.plot(table.index, table[f"{transport}_s"] * _MS_PER_S, color=color, label=name)
        axes.axvline(size, color="black", linewidth=0.8)
        here = table.loc[size]
        times = " and ".join(f"{_MS_PER_S * here[f'{name}_s']:.3g}" for name in TRANSPORT_COLORS)
        axes.set_title(
            f"{panel.value}\n{times} ms: {here['smt_s'] / here['gateway_s']:.2f} times as fast"
        )
        axes.set(xscale="log", yscale="log", xlabel="message")
        axes.set_xticks(list(_BYTE_TICKS), list(_BYTE_TICKS.values()))
        axes.minorticks_off()
    figure.axes[0].set_ylabel("transfer time (ms)")
    figure.axes[0].legend(loc="upper left", fontsize="small")
    figure.suptitle(
        f"{size} B to {run.config.subscribers} hardware subscribers and one in software"
    )


def _counts(table: pd.DataFrame) -> list[int]:
    return sorted(int(count) for count in table["subscribers"].unique())


def _style(count: int) -> dict[str, Any]:
    return NODE_STYLES.get(count, NODE_STYLES[8])


def _draw_times(
    axes: Axes, table: pd.DataFrame, count: int, ms: pd.Series[float], color: str
) -> None:
    chosen = table["subscribers"] == count
    axes.plot(
        table["message_bytes"][chosen],
        ms[chosen],
        **{**_style(count), "color": color},
        markersize=4,
    )


def _draw_ratios(axes: Axes, table: pd.DataFrame, **style: Any) -> None:
    for count in _counts(table):
        chosen = table[table["subscribers"] == count]
        axes.plot(chosen["message_bytes"], chosen["ratio"], **{**_style(count), **style})


def _draw_stated(axes: Axes, run: Run[Config], panel: Panel) -> None:
    table = stated(run)
    numbers = table[(table["model"] == MAIN) & (table["panel"] == panel.value)]["stated"]
    beside: dict[str, Any] = {"xycoords": ("axes fraction", "data"), "textcoords": "offset points"}
    beside |= {"ha": "right", "fontsize": "small"}
    for value in numbers:
        axes.axhline(value, color="black", **PAPER_STYLE)
        # Where the lines are not: they all leave the upper left and the lower right corner free.
        x, dy, va = (0.25, 2, "bottom") if value == numbers.max() else (0.98, -9, "top")
        axes.annotate(f"{value:g}", (x, value), xytext=(0, dy), va=va, **beside)


def _draw_live_ratios(axes: Axes, cell: pd.DataFrame, count: int) -> None:
    style = _style(count)
    around = np.array([cell["speed_up"] - cell["low"], cell["high"] - cell["speed_up"]]).clip(min=0)
    # Shifted apart, so that intervals do not cover each other.
    shifted = cell["message_bytes"] * 1.15 ** (list(NODE_STYLES.values()).index(style) - 1)
    axes.errorbar(shifted, cell["speed_up"], yerr=around, markersize=5, capsize=2, **style)
    axes.plot(cell["message_bytes"], cell["model"], color=style["color"], linewidth=0.9, alpha=0.7)


def _finish(grid: Any, run: Run[Config], gateway: str, more: str) -> None:
    """Set scales and labels; draw both legends: `gateway` is its label, `more` says what else is drawn."""
    from matplotlib.lines import Line2D

    for axes in grid.flat:
        axes.set_xscale("log")
        axes.set_xticks(list(SIZE_LABELS), list(SIZE_LABELS.values()), fontsize=8)
        axes.minorticks_off()
    for axes in grid[0]:
        axes.set_yscale("log")
    for axes in grid[1]:
        axes.set_yscale("log", base=2)
        axes.axhline(1, color="black", linewidth=0.8)
        axes.set_yticks(_RATIO_TICKS, [f"{tick:g}" for tick in _RATIO_TICKS])
        axes.set_xlabel("message")
    grid[0, 0].set_ylabel("transfer time (ms)")
    grid[1, 0].set_ylabel("gateway's speed-up (times as fast)")
    labels = {"smt": "software-mapped topic", "gateway": gateway}
    handles = [
        Line2D([], [], color=TRANSPORT_COLORS[name], label=label) for name, label in labels.items()
    ]
    grid[0, 3].legend(handles=handles, loc="upper left", fontsize="small")
    counts = {count: f"{count} hardware subscribers" for count in _counts(bars(run))}
    handles = [Line2D([], [], label=label, **_style(count)) for count, label in counts.items()]
    small = {"fontsize": "small", "title_fontsize": "small"}
    grid[1, 1].legend(handles=handles, title=more, loc="upper left", **small)


# --- Residuals ------------------------------------------------------------------------------------------------

MODEL_STYLES = {
    MAIN: ("proxy", "core stores a chunk"),
    "cut-through": ("standard", "core cuts through"),
}
_ASKED_STATED = 10.0  #: What is asked: per cent of the stated numbers.


@exp.figure("transfer_residuals", size=(10, 4.2))
def draw_residuals(figure: Figure, run: Run[Config]) -> dict[str, Any]:
    """Draw how far the model is from the stated numbers, and what assumptions change."""
    left, assumed = figure.subplots(1, 2, width_ratios=[1.3, 1])
    _draw_residuals(left, run)
    _draw_variants(assumed, run)
    meaning, worst = fit_meaning(run), rtl_residual(run)
    rtl = "" if worst is None else f"; the hardware's simulated cycles are within {worst:.2%} of it"
    figure.suptitle(f"The model is fitted, {meaning['fit'].split(':')[0]}{rtl}")
    note(figure, "exact, no repeats; grey: asked for")
    return {
        "stated": stated(run),
        "variants": run["variant"],
        "cycles": run["cycles"],
        "meaning": meaning,
    }


def _draw_residuals(axes: Axes, run: Run[Config]) -> None:
    for shift, (model, (key, label)) in zip((-0.15, 0.15), MODEL_STYLES.items(), strict=True):
        chosen = stated(run)[stated(run)["model"] == model]
        heights = np.arange(len(chosen)) + shift
        axes.plot(chosen["residual"] * 100, heights, **series(key), linestyle="", label=label)
        labels = [f"{row.panel}: {row.stated:.3g}" for row in chosen.itertuples()]
    axes.set_yticks(range(len(labels)), labels)
    axes.invert_yaxis()
    axes.axvspan(-_ASKED_STATED, _ASKED_STATED, color="0.93", zorder=0)
    axes.axvline(0, color="black", linewidth=0.8)
    axes.set_xlabel("model against stated speed-up (%)")
    worst = stated(run).groupby("model")["residual"].apply(lambda part: part.abs().max() * 100)
    said = f"Stated numbers: {worst[MAIN]:.1f} % off at most ({worst['cut-through']:.1f} % cut through)"
    axes.set_title(said, fontsize=9)
    axes.legend(loc="lower left")


def _draw_variants(axes: Axes, run: Run[Config]) -> None:
    names = (
        run["variant"]["constant"]
        .str.removesuffix("_cycles")
        .str.removesuffix("_s")
        .str.replace("_", " ")
    )
    labels = names + run["variant"]["factor"].map(" x{:g}".format)
    order = list(labels.unique())
    for shift, (model, (key, _)) in zip((-0.15, 0.15), MODEL_STYLES.items(), strict=True):
        mine = run["variant"]["model"] == model
        heights = [order.index(label) + shift for label in labels[mine]]
        axes.plot(run["variant"]["worst"][mine] * 100, heights, **series(key), linestyle="")
    axes.set_yticks(range(len(order)), order)
    axes.invert_yaxis()
    axes.axvspan(0, _ASKED_STATED, color="0.93", zorder=0)
    axes.set_xlim(left=0)
    axes.set_xlabel("largest residual after a new fit (%)")
    axes.set_title("An assumed constant halved or doubled", fontsize=9)


# --- Break-even sizes -----------------------------------------------------------------------------------------

JUDGE_STYLES = {
    "hardware": ("standard", "-", "last hardware subscriber"),
    "software": ("proxy", "-", "software subscriber"),
    "last": ("third", "--", "whoever is last"),
}
_RULES = {
    "paper": ("standard", "-", "the paper's rule"),
    "size-aware": ("proxy", "--", "by predicted time"),
}
_NEVER_BYTES = 2.0**33
_BYTE_TICKS = {1_000: "1 kB", **SIZE_LABELS}


@exp.figure("transfer_break_even", size=(10, 4.6))
def draw_break_even(figure: Figure, run: Run[Config]) -> dict[str, Any]:
    """Draw from which size on a gateway is faster, and what a rule that knows sizes gains in Fig. 8."""
    first, second, third = figure.subplots(1, 3, width_ratios=[1, 1, 1.1])
    for axes, publisher in ((first, "hardware"), (second, "software")):
        _draw_break_even(axes, run, publisher)
    second.sharey(first)
    second.set_ylabel("")
    second.legend(loc="upper right", fontsize=8.5)
    gain = _draw_rules(third, run)
    figure.suptitle(
        "From which message size a gateway is faster depends on who waits;\n"
        f"in Fig. 8 the paper's rule costs up to {gain:.0%} more than one that knows sizes"
    )
    note(figure, "model with fitted and assumed constants, exact; nothing is measured")
    return {"break_even": run["break_even"], "sized": run["sized_mapping"]}


def _draw_break_even(axes: Axes, run: Run[Config], publisher: str) -> None:
    table = run["break_even"]
    for judge, (key, line, label) in JUDGE_STYLES.items():
        part = table[(table["publisher"] == publisher) & (table["judge"] == judge)].sort_values(
            "subscribers"
        )
        sizes = np.where(part["worth"], part["from_bytes"], _NEVER_BYTES)
        size = 8 if judge == "hardware" else 4  # seen where another is on it
        axes.plot(
            part["subscribers"], sizes, **series(key), linestyle=line, markersize=size, label=label
        )
    axes.set_yscale("log")
    axes.minorticks_off()
    ticks = {256: "any", **_BYTE_TICKS, 10**8: "100 MB", 10**9: "1 GB", int(_NEVER_BYTES): "never"}
    axes.set_yticks(list(ticks), list(ticks.values()))
    axes.set_xticks(range(2, int(table["subscribers"].max()) + 1, 2))
    axes.set(xlabel="hardware subscribers", ylabel="faster by a gateway from this message size")
    axes.set_title(f"{publisher} publishes")


def _draw_rules(axes: Axes, run: Run[Config]) -> float:
    """Draw predicted times against no gateway at all; return what the paper's rule costs more at most."""
    table = run["sized_mapping"]
    times = table.pivot_table(index="message_bytes", columns="rule", values="predicted_s")
    for rule, (key, line, label) in _RULES.items():
        relative = times[rule] / times["none"]
        axes.plot(times.index, relative, **series(key), markersize=4, linestyle=line, label=label)
    chosen = table[table["rule"] == "size-aware"].set_index("message_bytes")["gateways"]
    for size in chosen.index[chosen.diff().fillna(1) != 0]:
        where = (size, times["size-aware"][size] / times["none"][size])
        side = "left" if size == chosen.index[0] else "right"
        style: dict[str, Any] = {"textcoords": "offset points", "ha": side, "fontsize": "small"}
        axes.annotate(f"{chosen[size]} gateways", where, xytext=(-6, -14), **style)
    axes.axhline(1, color="black", linewidth=0.8)
    axes.set_xscale("log")
    ticks = {100: "100 B", **_BYTE_TICKS}
    axes.set_xticks(list(ticks)[::2], list(ticks.values())[::2])
    axes.minorticks_off()
    axes.set(xlabel="size of every message", ylabel="predicted time, against no gateway (times)")
    axes.set_title("Fig. 8, topics' times added")
    axes.legend(loc="lower left")
    return float((times["paper"] / times["size-aware"]).max() - 1)


# --- Node mapping ---------------------------------------------------------------------------------------------

BASELINES = {
    "same_without_gateways": "same placement,\nno gateways",
    "greedy_with_gateways": "blind greedy,\nwith gateways",
    "greedy": "blind greedy,\nno gateways",
    "software": "all in\nsoftware",
}


@exp.figure("node_mapping", size=(10, 4.4))
def draw_node_mapping(figure: Figure, run: Run[Config]) -> dict[str, Any]:
    """Draw node mapping against brute force and against simpler ways."""
    placed = run["placed"]
    small, large = (placed[placed["kind"] == kind] for kind in ("small", "large"))
    exact, others = figure.subplots(1, 2, width_ratios=[1, 1.6])
    axes_range = [0, 1.1 * small["placed"].max()]
    exact.plot(axes_range, axes_range, color="black", linewidth=0.8)
    exact.plot(small["brute_force"], small["placed"], **series("proxy"), linestyle="")
    exact.set(xlabel="least cost, by brute force (s each second)")
    exact.set(ylabel="cost of the programme's mapping (s each second)")
    equal = int((np.abs(small["placed"] / small["brute_force"] - 1) < 1e-6).sum())
    exact.set_title(f"{equal} of {len(small)} small graphs: the best of all")
    _draw_baselines(others, small, large)
    figure.suptitle(
        f"Node mapping with gateways: proved best for {int(placed['optimal'].sum())} of {len(placed)} "
        f"random graphs, {large['nodes'].max()} nodes in {large['seconds'].max():.2g} s at most"
    )
    note(figure, "costs are predicted by the model, each graph solved once; time on this machine")
    # What was not computed is null in the twin: NaN is no JSON.
    return {"placed": placed.astype(object).where(placed.notna(), None)}


def _draw_baselines(axes: Axes, small: pd.DataFrame, large: pd.DataFrame) -> None:
    for place, name in enumerate(BASELINES):
        for shift, part, key in ((-0.12, small, "third"), (0.12, large, "proxy")):
            ratios = part[name] / part["placed"]
            nodes = " to ".join(str(n) for n in sorted({part["nodes"].min(), part["nodes"].max()}))
            label = f"{nodes} nodes" if place == 0 else None
            spots = np.full(len(ratios), place + shift)
            axes.plot(
                spots, ratios, **series(key), markersize=5, alpha=0.7, linestyle="", label=label
            )
    axes.axhline(1, color="black", linewidth=0.8)
    axes.set_xticks(range(len(BASELINES)), list(BASELINES.values()))
    axes.set_ylabel("cost against the programme's mapping (times)")
    more = f"{(large['greedy'] / large['placed']).median():.2f} times as much"
    axes.set_title(f"Ignoring communication costs {more} (large graphs, median)", fontsize=10)
    axes.legend(loc="upper left")
