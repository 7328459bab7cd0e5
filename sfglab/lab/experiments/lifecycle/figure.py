"""Heartbeats over time, with the paper's periods in the same axes."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from sfglab.lab.experiments.lifecycle.beats import heartbeat_checks, intervals
from sfglab.lab.figures import COLORS, MARKERS, PAPER_STYLE, house_style

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from sfglab.lab.experiments.lifecycle.results import Results


PAPER_PERIODS = {0: 1.0, 1: 5.0}
"""Seconds by phase (paper A, section 4.2)."""

PHASES = {0: "start-up", 1: "steady state"}
_STYLES = {0: "proxy", 1: "standard"}


def draw_heartbeats(results: Results) -> tuple[Figure, dict[str, Any]]:
    """Draw the time between heartbeats over the time since the start, and how far it is from its period.

    Args:
        results: The run.

    Returns:
        The figure and the numbers that it shows.
    """
    from matplotlib.figure import Figure

    table, checks = intervals(results), heartbeat_checks(results)
    held = sum(check.held for check in checks)
    agents = len(results.answers)
    with house_style():
        figure = Figure(figsize=(10.5, 3.8))
        over_time, errors = figure.subplots(1, 2, width_ratios=(1.7, 1))
        _draw_gaps(over_time, results)
        medians = _draw_errors(errors, results)
        where = "on another host" if results.hosts["separate"] else "by another process"
        scaled = "" if results.at_paper_periods else " (faster than the paper's, for a short run)"
        figure.suptitle(
            f"Heartbeats of {agents} agents, heard {where}{scaled}: {held} of {len(checks)} checks hold"
        )
    return figure, {"held": held, "checks": len(checks), "heartbeats": len(table), "median_gap_s": medians}


def _draw_gaps(axes: Axes, results: Results) -> None:
    table = intervals(results)
    for phase, style in _STYLES.items():
        chosen = table[table["phase"] == phase]
        axes.plot(
            chosen["since_s"],
            chosen["gap_s"],
            linestyle="none",
            marker=MARKERS[style],
            color=COLORS[style],
            alpha=0.75,
            label=f"measured, {PHASES[phase]}",
        )
        if results.at_paper_periods:
            label = f"paper: {PAPER_PERIODS[phase]:g} s, {PHASES[phase]}"
            axes.axhline(PAPER_PERIODS[phase], color=COLORS[style], label=label, **PAPER_STYLE)
    _mark_events(axes, results)
    axes.set(xlabel="time since an agent's first heartbeat (s)", ylabel="time until its next heartbeat (s)")
    axes.set_ylim(0, 1.45 * table["gap_s"].max())
    axes.set_title("every interval", fontsize=9)
    axes.legend(fontsize=8, loc="upper left", ncols=2)


def _mark_events(axes: Axes, results: Results) -> None:
    """Mark where the start-up phase ends and where another listener joined."""
    beats = results.beats[results.beats["listener"] == "first"]
    first_ns = beats.groupby("agent")["received_ns"].min()
    joined_ns = results.joins.set_index("listener")["t_ns"]["late"]
    joined_s = float(np.median((joined_ns - first_ns) / 1e9))
    startup_s = results.config["schedule"]["startup_s"]
    for at_s, text in ((startup_s, "start-up ends"), (joined_s, "a late listener joins")):
        axes.axvline(at_s, ymax=0.8, color="black", linewidth=0.8, linestyle=":")
        axes.annotate(
            text,
            (at_s, 0.02),
            xycoords=("data", "axes fraction"),
            xytext=(3, 2),
            textcoords="offset points",
            fontsize=7.5,
            rotation=90,
            va="bottom",
        )


def _draw_errors(axes: Axes, results: Results) -> dict[str, float]:
    """Draw every interval's distance from its phase's period, and return the median intervals."""
    table, medians = intervals(results), {}
    schedule = results.config["schedule"]
    rng = np.random.default_rng(0)
    for phase, style in _STYLES.items():
        stated = schedule["steady_period_s" if phase else "startup_period_s"]
        gaps = table.loc[table["phase"] == phase, "gap_s"].to_numpy()
        errors_ms = 1e3 * (gaps - stated)
        spread = phase + rng.uniform(-0.18, 0.18, len(gaps))
        axes.plot(spread, errors_ms, linestyle="none", marker=MARKERS[style], color=COLORS[style], alpha=0.6)
        median = float(np.median(errors_ms))
        axes.hlines(median, phase - 0.3, phase + 0.3, color="black", linewidth=1.5)
        axes.annotate(
            f"median {median:+.2f} ms",
            (phase, 1),
            xycoords=("data", "axes fraction"),
            ha="center",
            va="top",
            fontsize=8,
        )
        medians[PHASES[phase]] = float(np.median(gaps))
    axes.axhline(0, color="grey", linewidth=0.8)
    stated = [f"{schedule[f'{name}_period_s']:g} s" for name in ("startup", "steady")]
    axes.set_xticks([0, 1], [f"{PHASES[p]}\n({s})" for p, s in zip(PHASES, stated, strict=True)])
    axes.set_xlim(-0.5, 1.5)
    axes.margins(y=0.25)
    axes.set_ylabel("interval minus period (ms)")
    axes.set_title("how far from the period", fontsize=9)
    axes.grid(visible=False, axis="x")
    return medians
