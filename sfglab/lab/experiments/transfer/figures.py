"""Figures 6 and 7 of paper C redrawn from a log, by the model and live, with what the paper states."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from sfglab.lab.experiments.transfer.analysis import (
    MAIN,
    bars,
    bars_of,
    live_agreement,
    live_note,
    live_table,
    stated,
)
from sfglab.lab.experiments.transfer.experiment import Config, exp
from sfglab.lab.figures import COLORS, PAPER_STYLE
from sfglab.soc.paper_values import Panel

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from sfglab.lab.runs import Run


TRANSPORT_COLORS = {"smt": COLORS["standard"], "gateway": COLORS["proxy"]}
NODE_COLORS = ("#E69F00", COLORS["fourth"], COLORS["third"])
NODE_MARKERS = ("o", "s", "^")
NODE_LINES: tuple[Any, ...] = (":", "--", "-")
SIZE_LABELS = {10_000: "10 kB", 100_000: "100 kB", 1_000_000: "1 MB", 10_000_000: "10 MB"}
_RATIO_TICKS = (0.25, 0.5, 1, 2, 4, 8, 16)
_MS_PER_S = 1e3


@exp.figure("transfer", size=(13.5, 6.6))
def draw_transfer(figure: Figure, run: Run[Config]) -> dict[str, Any]:
    """Draw the model's transfer times (above) and speed-ups (below), with RTL markers and the stated ends."""
    grid = figure.subplots(2, len(Panel), sharex=True, sharey="row")
    for place, panel in enumerate(Panel):
        times, ratios = grid[0, place], grid[1, place]
        _draw_times(times, bars_of(run, panel))
        _draw_ratios(ratios, bars_of(run, panel), line=True)
        _draw_ratios(ratios, bars_of(run, panel, model="rtl"), line=False)
        _draw_stated(ratios, run, panel)
        times.set_title(panel.value)
    _finish(grid)
    _legend_of_times(grid[0, 3], "gateway, any number of subscribers")
    _legend_of_ratios(grid[1, 1], run, "hollow: with RTL's cycles\ndashed: stated ends")
    figure.suptitle(_title(run))
    return {
        "bars": bars(run).to_dict(orient="list"),
        "stated": stated(run).to_dict(orient="list"),
    }


@exp.figure("transfer_live", size=(13.5, 6.6), when=lambda run: not run["crossing"].empty)
def draw_live_transfer(figure: Figure, run: Run[Config]) -> dict[str, Any]:
    """Draw medians across processes with their intervals, and the model's speed-ups as thin lines."""
    table = live_table(run)
    grid = figure.subplots(2, len(Panel), sharex=True, sharey="row")
    for place, panel in enumerate(Panel):
        times, ratios = grid[0, place], grid[1, place]
        chosen = table[table["panel"] == panel.value]
        _draw_live(times, ratios, chosen)
        times.set_title(panel.value)
    _finish(grid)
    _legend_of_times(grid[0, 3], "gateway")
    _legend_of_ratios(grid[1, 1], run, "thin: the board's model")
    figure.suptitle(f"{_live_title(table)}\n{live_note(run)}", fontsize="medium")
    agreement = dict(zip(("bars", "decided", "as the model"), live_agreement(table), strict=True))
    return {
        "live": table.to_dict(orient="list"),
        "conditions": live_note(run),
        "agreement": agreement,
    }


def _title(run: Run[Config]) -> str:
    worst = stated(run)[stated(run)["model"] == MAIN]["residual"].abs().max()
    return (
        "A gateway pays for large messages and many hardware subscribers, and costs time towards software "
        f"(model, all stated ends within {worst:.1%})"
    )


def _live_title(table: pd.DataFrame) -> str:
    bars, decided, same = live_agreement(table)
    return f"Across processes {decided} of {bars} bars say which is faster, {same} of them as the model does"


def _counts(table: pd.DataFrame) -> list[int]:
    return sorted(int(count) for count in table["subscribers"].unique())


def _draw_times(axes: Axes, bars: pd.DataFrame) -> None:
    for transport, color in TRANSPORT_COLORS.items():
        for place, count in enumerate(_counts(bars)):
            chosen = bars[bars["subscribers"] == count]
            axes.plot(
                chosen["message_bytes"],
                chosen[f"{transport}_s"] * _MS_PER_S,
                color=color,
                linestyle=NODE_LINES[place],
                marker=NODE_MARKERS[place],
                markersize=4,
            )


def _draw_ratios(axes: Axes, bars: pd.DataFrame, *, line: bool) -> None:
    for count in _counts(bars):
        chosen = bars[bars["subscribers"] == count]
        place = _place(count)
        axes.plot(
            chosen["message_bytes"],
            chosen["ratio"],
            color=NODE_COLORS[place],
            linestyle=NODE_LINES[place] if line else "",
            marker=NODE_MARKERS[place],
            markersize=4 if line else 9,
            markerfacecolor=NODE_COLORS[place] if line else "none",
        )


def _place(count: int) -> int:
    """Return which of the colours and markers a number of hardware subscribers has."""
    return {2: 0, 4: 1}.get(count, 2)


def _draw_stated(axes: Axes, run: Run[Config], panel: Panel) -> None:
    table = stated(run)
    numbers = table[(table["model"] == MAIN) & (table["panel"] == panel.value)]
    for value in numbers["stated"]:
        largest = value == numbers["stated"].max()
        axes.axhline(value, color="black", **PAPER_STYLE)
        # Where the lines are not: they all leave the upper left and the lower right corner free.
        axes.annotate(
            f"{value:g}",
            (0.25 if largest else 0.98, value),
            xytext=(0, 2 if largest else -2),
            xycoords=("axes fraction", "data"),
            textcoords="offset points",
            ha="right",
            va="bottom" if largest else "top",
            fontsize="small",
        )


def _draw_live(times: Axes, ratios: Axes, chosen: pd.DataFrame) -> None:
    for count in _counts(chosen):
        cell = chosen[chosen["subscribers"] == count].sort_values("message_bytes")
        place = _place(count)
        for transport, color in TRANSPORT_COLORS.items():
            times.plot(
                cell["message_bytes"],
                cell[f"{transport}_ms"],
                color=color,
                linestyle=NODE_LINES[place],
                marker=NODE_MARKERS[place],
                markersize=4,
            )
        around = np.array([cell["speed_up"] - cell["low"], cell["high"] - cell["speed_up"]]).clip(min=0)
        # Shifted apart, so that intervals do not cover each other.
        shifted = cell["message_bytes"] * 1.15 ** (place - 1)
        style: dict[str, Any] = {
            "color": NODE_COLORS[place],
            "marker": NODE_MARKERS[place],
            "linestyle": NODE_LINES[place],
        }
        ratios.errorbar(shifted, cell["speed_up"], yerr=around, markersize=5, capsize=2, **style)
        ratios.plot(cell["message_bytes"], cell["model"], color=NODE_COLORS[place], linewidth=0.9, alpha=0.7)


def _finish(grid: Any) -> None:
    for axes in grid.flat:
        axes.set_xscale("log")
        axes.set_xticks(list(SIZE_LABELS), list(SIZE_LABELS.values()))
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


def _legend_of_times(axes: Axes, gateway: str) -> None:
    from matplotlib.lines import Line2D

    labels = {"smt": "software-mapped topic", "gateway": gateway}
    handles = [Line2D([], [], color=TRANSPORT_COLORS[name], label=label) for name, label in labels.items()]
    axes.legend(handles=handles, loc="upper left")


def _legend_of_ratios(axes: Axes, run: Run[Config], more: str) -> None:
    from matplotlib.lines import Line2D

    handles = [
        Line2D(
            [],
            [],
            color=NODE_COLORS[_place(count)],
            marker=NODE_MARKERS[_place(count)],
            linestyle=NODE_LINES[_place(count)],
            label=f"{count} hardware subscribers",
        )
        for count in _counts(bars(run))
    ]
    axes.legend(handles=handles, title=more, loc="upper left", fontsize="small", title_fontsize="small")
