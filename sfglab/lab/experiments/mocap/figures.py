"""The figures of the mocap experiment."""

from __future__ import annotations

from textwrap import fill
from typing import TYPE_CHECKING, Any

import numpy as np

from sfglab.lab.experiments.mocap.analysis import errors, findings_of, offsets, tree_of
from sfglab.lab.experiments.mocap.experiment import Config, exp
from sfglab.lab.figures import COLORS, MARKERS

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from sfglab.lab.runs import Run


_TITLES = {
    "direct": "Direct receiver (Fig. 6, left)",
    "renamed": "The same under the right name",
    "proxy": "Bridge, via the proxy frame (Fig. 6, right)",
}
_FAULTS = {"occluded": COLORS["network"], "flipped": COLORS["fourth"], "dropped": COLORS["third"]}
_ROUNDS = {"faulty": COLORS["proxy"], "ideal": COLORS["third"]}
_CASES = {
    (False, True): ("proxy", "odometry is steady"),
    (True, True): ("third", "it drifts, allowed for"),
    (True, False): ("standard", "it drifts, not allowed for"),
}


@exp.figure("mocap_trees", size=(10, 4.6))
def draw_trees(figure: Figure, run: Run[Config]) -> dict[str, Any]:
    """Draw both trees of Fig. 6, and the one between, with what is wrong."""
    from sfglab.spatial.frames.lint import draw_tree

    twin: dict[str, Any] = {}
    for ax, (way, title) in zip(figure.subplots(1, 3), _TITLES.items(), strict=True):
        found = findings_of(run, "figure 6", way)
        draw_tree(ax, tree_of(run, "figure 6", way), findings=found, outside="mocap")
        ax.set_title(title)
        text = (
            "\n".join(fill(f"{f.code}: {', '.join(f.frames)}", 42) for f in found) or "nothing is found wrong"
        )
        colour = COLORS["standard"] if found else COLORS["third"]
        ax.text(0.5, -0.02, text, transform=ax.transAxes, ha="center", va="top", color=colour, fontsize=8.5)
        twin[way] = [str(finding) for finding in found]
    figure.suptitle("What motion capture does to a robot's tree of frames (blue: what the cameras add)")
    return twin


@exp.figure("mocap_error", size=(10, 6.6))
def draw_error(figure: Figure, run: Run[Config]) -> dict[str, Any]:
    """Draw the live rounds: error and waiting time over time, latencies, and what the error is made of."""
    axes = figure.subplots(2, 2, width_ratios=[2, 1])
    _draw_errors(axes[0, 0], run)
    _draw_waits(axes[1, 0], run)
    _draw_latencies(axes[0, 1], run)
    _draw_parts(axes[1, 1], run)
    figure.suptitle(f"World to camera while the robot moves, live on {run.metadata('hosts')['description']}")
    return {"medians": errors(run).round(4).to_dict(orient="index")}


@exp.figure("mocap_offset", size=(10, 3.8))
def draw_offset(figure: Figure, run: Run[Config]) -> dict[str, Any]:
    """Draw what an estimate of the offset is worth, by the length of the motion."""
    table = offsets(run)
    error, cover, worth = figure.subplots(1, 3)
    for (drifts, modelled), (key, name) in _CASES.items():
        rows = table[(table["drifts"] == drifts) & (table["modelled"] == modelled)]
        style = {"color": COLORS[key], "marker": MARKERS[key]}
        error.plot(rows["length_s"], rows["error_mm"], label=name, **style)
        error.plot(rows["length_s"], rows["sigma_mm"], linestyle=":", **style)
        cover.plot(rows["length_s"], rows["covered"], label=name, **style)
        worth.plot(rows["length_s"], rows["after_mm"], label=name, **style)
    worth.axhline(table["before_mm"].median(), color=COLORS["network"], label="no offset")
    cover.axhline(0.95, color=COLORS["network"], linestyle=":", label="stated: 95 %")
    _label(error, "error of the offset, mm (dotted: stated)", log=True)
    error.set_ylim(top=5 * table["error_mm"].max())  # room for the legend
    _label(cover, "share of numbers within their interval")
    cover.set_ylim(0, 1.05)
    _label(worth, "base through the bridge, other motion, mm", log=True)
    figure.suptitle("Beyond the paper: where the base is in the tracked object, from a recorded motion")
    return {"by_length": table.round(4)}


def _label(ax: Axes, what: str, *, log: bool = False) -> None:
    ax.set(xlabel="length of the motion, s", ylabel=what, yscale="log" if log else "linear")
    ax.legend(fontsize=8)


def _draw_errors(ax: Axes, run: Run[Config]) -> None:
    _mark_faults(ax, run)
    for name, colour in _ROUNDS.items():
        looks = _of(run["look"], name)
        ax.plot(looks["at_s"], looks["error_mm"], ".", color=colour, markersize=4, label=f"{name}: at its time")
    looks = _of(run["look"], "faulty")
    style: dict[str, Any] = {"color": COLORS["standard"], "markersize": 3, "label": "faulty: newest as now"}
    ax.plot(looks["at_s"], looks["latest_mm"], ".", **style)
    ax.set(yscale="log", ylabel="error, mm", title="How far the camera is from where it really is")
    ax.legend(fontsize=8, ncols=3, loc="upper right")


def _draw_waits(ax: Axes, run: Run[Config]) -> None:
    _mark_faults(ax, run, named=True)
    looks = _of(run["look"], "faulty")
    ax.plot(looks["at_s"], looks["wait_ms"], ".", color=COLORS["proxy"], markersize=4)
    ax.set(yscale="log", xlabel="time, s", ylabel="until that time is known, ms")
    ax.set_title("How long a look at the present waits (faulty round)")
    ax.legend(fontsize=8, loc="upper right", ncols=3)


def _draw_latencies(ax: Axes, run: Run[Config]) -> None:
    heard = _of(run["heard"], "faulty")
    parts = (("receipt_ms", "third", "received"), ("publication_ms", "proxy", "published"))
    for column, key, name in (*parts, ("heard_ms", "standard", "heard")):
        values = np.sort(heard[column].to_numpy())
        share = np.arange(1, len(values) + 1) / max(1, len(values))
        ax.plot(values, share, color=COLORS[key], label=name)
    if len(heard):
        ax.set_xlim(right=float(heard["heard_ms"].quantile(0.99)) * 1.15)
    ax.set(xlabel="since capture, ms", ylabel="share of transforms", title="Latency")
    ax.legend(fontsize=8)


def _draw_parts(ax: Axes, run: Run[Config]) -> None:
    medians = errors(run).to_dict(orient="index")
    parts = (
        ("bridge and\ntree", "ideal", "error_mm", _ROUNDS["ideal"]),
        ("with the\ncameras' noise", "faulty", "error_mm", _ROUNDS["faulty"]),
        ("newest\nas now", "faulty", "latest_mm", COLORS["standard"]),
    )
    bars = [(name, float(medians[r][c]), colour) for name, r, c, colour in parts if r in medians]
    for place, (_, value, colour) in enumerate(bars):
        ax.bar(place, value, color=colour)
        ax.text(place, value, f"{value:.2g}", ha="center", va="bottom")
    ax.set_xticks(range(len(bars)), [name for name, _, _ in bars])
    ax.set(yscale="log", ylabel="median error, mm", title="What the error is made of")
    ax.margins(y=0.2)


def _mark_faults(ax: Axes, run: Run[Config], *, named: bool = False) -> None:
    spells = _of(run["spell"], "faulty")
    for kind, colour in _FAULTS.items():
        times = spells[spells["kind"] == kind][["begin_s", "end_s"]].to_numpy(dtype=float).tolist()
        for place, (begin_s, end_s) in enumerate(times):
            alpha = 0.8 if kind == "flipped" else 0.35
            label = kind if named and place == 0 else None
            ax.axvspan(begin_s - 0.01, end_s + 0.01, color=colour, alpha=alpha, linewidth=0, label=label)


def _of(table: pd.DataFrame, name: str) -> pd.DataFrame:
    return table[table["round"] == name]
