"""Figures of the map: what holds where, and inside one condition in the middle of the plausible region."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from sfglab.lab.experiments.phases.answers import ANSWERS, PLACE, criterion, middle, summary
from sfglab.lab.experiments.phases.experiment import Config, exp
from sfglab.lab.experiments.phases.verdicts import phases
from sfglab.lab.experiments.transmission.figures import draw_panel
from sfglab.lab.figures import COLORS, note

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from sfglab.lab.runs import Run


@exp.figure("phases", size=(10.5, 9.6))
def draw_maps(figure: Figure, run: Run[Config]) -> dict[str, Any]:
    """Draw what holds where, without stalls, a row a mode of publication and what a full queue does."""
    table, keys = phases(run), ["queue_rule", "preset", "loss", "frame_us"]
    table = table[table["stall_ms"] == 0]
    rows = [
        (key, part.groupby(keys, sort=False)[[*ANSWERS]].mean().reset_index())
        for key, part in table.groupby(keys[:2], sort=False)
    ]
    figure.set_size_inches(10.5, 2.2 * len(rows) + 1.2)
    panels = figure.subplots(len(rows), len(ANSWERS), sharex=True, sharey=True, squeeze=False)
    image: Any = None
    for row, ((rule, preset), part) in zip(panels, rows, strict=True):
        for axes, answer in zip(row, ANSWERS, strict=True):
            image = _draw_map(axes, part, answer)
        row[0].set_ylabel(f"{preset}\n{rule}, loss (%)", fontsize=8)
    for axes, last, title in zip(panels[0], panels[-1], ANSWERS.values(), strict=True):
        axes.set_title(title, fontsize=9)
        last.set_xlabel("cost of a frame (us)", fontsize=8)
    figure.colorbar(image, ax=panels, shrink=0.6, label="share of answers")
    rates = ", ".join(map(str, sorted(table["rate_max_hz"].unique())))
    figure.suptitle(f"Where paper B's conclusions hold, Rmax {rates} Hz; box: the plausible region")
    note(figure, f"simulated, {run.config.seeds} seeds; a dot is a condition, its colour reaches to the next")
    return {"answers": pd.concat([part for _, part in rows])}


def _draw_map(axes: Axes, table: pd.DataFrame, answer: str) -> Any:
    """Draw an answer: each place has the colour of the condition that is nearest to it, a dot."""
    from matplotlib.patches import Rectangle

    spots = np.log10(table[["frame_us", "loss"]].to_numpy())
    (left, bottom), (right, top) = spots.min(axis=0) - 0.15, spots.max(axis=0) + 0.15
    x, y = np.linspace(left, right, 120), np.linspace(bottom, top, 120)
    places = np.stack(np.meshgrid(x, y), axis=-1)[:, :, None]
    nearest = (((places - spots) / (right - left, top - bottom)) ** 2).sum(axis=-1).argmin(axis=-1)
    colors = table[answer].to_numpy(float)[nearest]
    image = axes.pcolormesh(10**x, 100 * 10**y, colors, vmin=0, vmax=1, cmap="cividis", rasterized=True)
    axes.plot(
        table["frame_us"], 100 * table["loss"], "o", color="white", markeredgecolor="black", markersize=3.5
    )
    (low, high), (least, most) = (criterion().region[name] for name in ("loss", "frame_us"))
    box = Rectangle((least, 100 * low), most - least, 100 * (high - low), fill=False)
    box.set(edgecolor=COLORS["standard"], linewidth=1.8)
    axes.add_patch(box)
    axes.set(xscale="log", yscale="log")
    axes.grid(visible=False)
    return image


_MEASURES = {"p50_ms": "median latency (ms)", "lost": "loss", "age_ms": "age at the station (ms)"}


@exp.figure("phases_cells", size=(10.5, 7.0))
def draw_cells(figure: Figure, run: Run[Config]) -> dict[str, Any]:
    """Draw latency, loss and age by depth in the condition nearest to the middle of the plausible region."""
    table, region = summary(run["cell"]), criterion().region
    table = table[(table["queue_rule"] == "block") & (table["stall_ms"] == 0)]
    table = table[table["rate_max_hz"] == table["rate_max_hz"].max()].replace(np.inf, np.nan)
    far = sum(np.log(table[name] / middle(*region[name])) ** 2 for name in ("loss", "frame_us"))
    nearest = table.loc[far.groupby(table["preset"]).idxmin(), PLACE]
    groups = list(table.merge(nearest, on=PLACE).groupby("preset", sort=False))
    panels = figure.subplots(len(_MEASURES), len(groups), sharex=True, sharey="row", squeeze=False)
    for row, (column, label) in zip(panels, _MEASURES.items(), strict=True):
        names = {column: "median", f"{column}_low": "min", f"{column}_high": "max"}
        for axes, (preset, part) in zip(row, groups, strict=True):
            draw_panel(axes, part.rename(columns=names))
            axes.set_title(
                f"{preset}\nloss {part['loss'].iloc[0]:.2%}, {part['frame_us'].iloc[0]:.0f} us", fontsize=8
            )
            axes.tick_params(axis="x", labelrotation=60)
        row[0].set(ylabel=label, yscale="linear" if column == "lost" else "log")
    figure.legend(*panels[0][0].get_legend_handles_labels(), loc="outside lower center", ncols=4)
    figure.suptitle(
        f'"Hello" at Rmax {table["rate_max_hz"].max()} Hz by DEPTH (simulated); no median: most never arrived'
    )
    return {"cells": pd.concat([part for _, part in groups])[[*PLACE, "method", "depth", *_MEASURES]]}
