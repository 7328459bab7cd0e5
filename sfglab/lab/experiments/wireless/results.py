"""Medians by channel and way, claims and figures."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from sfglab.lab.claims import Finding, How
from sfglab.lab.experiments.wireless.experiment import (
    BURSTS,
    CHANNELS,
    FALLING,
    INDEPENDENT,
    VIDEO_CHANNELS,
    Config,
    exp,
)
from sfglab.lab.figures import note, series
from sfglab.lab.runs import Run, derived, lines_of
from sfglab.lab.stats import Estimate, median_of, ratio_of, rounded

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

NAMES = {
    "dds_reliable": "DDS reliable",
    "dds_best_effort": "DDS best effort",
    "zenoh_quic": "Zenoh, QUIC",
    "zenoh_tcp": "Zenoh, TCP",
}
"""Names of the ways in tables and figures."""
STYLES = dict(zip(NAMES, map(series, ("standard", "network", "proxy", "third")), strict=True))
CONDITION = ["channel", "outage_s", "requests"]  #: Columns that distinguish cells of one way.


@derived
def medians(run: Run[Config], table: str, column: str) -> pd.DataFrame:
    """Return the median over repetitions of a column, with the ends of its 95 % interval, by condition and way.

    The columns of the result are `CONDITION`, ``way``, ``value``, ``low`` and ``high``. A time of recovery that exceeds
    `Config.after_s` counts as this time.
    """
    rows = []
    for condition, found in run[table].groupby([*CONDITION, "way"], sort=False):
        values = found[column].fillna(run.config.after_s if column.endswith("_s") else np.nan)
        estimate = median_of(values.dropna().to_numpy(), unit="")
        rows.append((*condition, estimate.value, estimate.low, estimate.high))
    return pd.DataFrame(rows, columns=[*CONDITION, "way", "value", "low", "high"])


def overview(run: Run[Config], table: str, column: str) -> pd.DataFrame:
    """Return `medians` as texts, one row per condition and one column per way."""
    rows: dict[tuple[str, float, bool], dict[str, str]] = {}
    for one in lines_of(medians(run, table, column)):
        of_condition = rows.setdefault((one.channel, one.outage_s, one.requests), {})
        interval = f"[{rounded(one.low)}, {rounded(one.high)}]"
        of_condition[NAMES[one.way]] = f"{rounded(one.value)} {interval}"
    if not rows:  # there are no hosts
        return pd.DataFrame(columns=CONDITION)
    return pd.DataFrame(rows).T.rename_axis(CONDITION).reset_index()


def ratio(run: Run[Config], column: str, channel: str, more: str, less: str) -> Estimate:
    """Estimate the ratio of two ways' medians over a channel, resampling repetitions of both."""
    table = run["samples"]
    pivot = table[table["channel"] == channel].pivot_table(column, "repeat", "way")
    pairs = pivot.reindex(columns=[more, less]).dropna()
    return ratio_of(pairs.to_numpy(), np.median, unit=f"times {NAMES[less]}")


# --- Claims -----------------------------------------------------------------------------------


def _finding(run: Run[Config], column: str) -> Finding:
    """Return RELIABLE relative to BEST_EFFORT, with the conditions that the paper leaves open."""
    pair = ("dds_reliable", "dds_best_effort")
    found = lines_of(medians(run, "samples", column))
    at_loss = [one for one in found if one.channel == INDEPENDENT]
    values = [f"{NAMES[one.way]} {rounded(one.value)} ms" for one in at_loss]
    return Finding(
        estimate=ratio(run, column, INDEPENDENT, *pair),
        under={name: ratio(run, column, name, *pair) for name in (BURSTS, FALLING)},
        reason=f"medians at {INDEPENDENT}: {', '.join(values)}",
    )


@exp.claim("A-BE-STALE", how=How.LIVE)
def stale_data(run: Run[Config]) -> Finding:
    """Return the 95th percentile over time of the age of the newest sample, RELIABLE relative to BEST_EFFORT."""
    return _finding(run, "age_p95_ms")


@exp.claim("A-BE-SPIKES", how=How.LIVE)
def latency_spikes(run: Run[Config]) -> Finding:
    """Return the 99th percentile of the latency of samples that arrived, RELIABLE relative to BEST_EFFORT."""
    return _finding(run, "latency_p99_ms")


# --- Figures ----------------------------------------------------------------------------------


def draw_groups(axes: Axes, found: pd.DataFrame, channels: tuple[str, ...]) -> None:
    """Draw medians with 95 % intervals, one group per channel and one mark per way."""
    for number, (way, style) in enumerate(STYLES.items()):
        rows = found[found["way"] == way].set_index("channel").reindex(channels)
        at = np.arange(len(channels)) + 0.17 * (number - 1.5)
        errors = np.array([rows["value"] - rows["low"], rows["high"] - rows["value"]]).clip(0)
        axes.errorbar(at, rows["value"], errors, linestyle="", capsize=3, **style)
    axes.set_xticks(range(len(channels)), channels)
    axes.grid(visible=False, axis="x")


def draw_legend(axes: Axes) -> None:
    """Draw the marks of the ways into a panel."""
    from matplotlib.lines import Line2D

    marks = [Line2D([], [], linestyle="", **style) for style in STYLES.values()]
    axes.legend(marks, list(NAMES.values()), loc="upper left", fontsize=9)


@exp.figure("wireless_age", size=(11.6, 4.8), when=lambda run: not run["samples"].empty)
def draw_age(figure: Figure, run: Run[Config]) -> None:
    """Draw the age of the newest sample by channel (left) and around the longest outage (right)."""
    from matplotlib.ticker import LogLocator, NullLocator

    by_channel, around = figure.subplots(1, 2)
    found = medians(run, "samples", "age_p95_ms")
    draw_groups(by_channel, found[found["outage_s"] == 0], CHANNELS)
    by_channel.set(yscale="log", ylabel="95th percentile of the age (ms)")
    by_channel.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    by_channel.yaxis.set_major_formatter("{x:g}")
    by_channel.yaxis.set_minor_locator(NullLocator())
    longest_s = max(run.config.outages_s)
    trace = run["trace"]
    trace = trace[trace["outage_s"] == longest_s].assign(t_s=trace["t_s"].round(1))
    for way, rows in trace.groupby("way"):
        ages = rows.groupby("t_s")["age_s"].median()
        around.plot(ages.index, ages, color=STYLES[str(way)]["color"])
    around.axvspan(0, longest_s, color="0.92", zorder=0)
    around.set(
        xlabel=f"time since the beginning of an outage of {longest_s:g} s (s)",
        ylabel="age (s), median over repetitions",
    )
    draw_legend(by_channel)
    at_loss = found[found["channel"] == INDEPENDENT].set_index("way")["value"]
    texts = [f"{at_loss[way]:.0f} ms ({name})" for way, name in NAMES.items() if way in at_loss]
    figure.suptitle(
        f"Age of the newest sample at {INDEPENDENT}, 95th percentile: {', '.join(texts)}",
        fontsize=11,
    )
    note(figure, "live; age of the newest sample, 64 B at 50 Hz; left: medians, 95 % intervals")


@exp.figure("wireless_video", size=(11.6, 4.6), when=lambda run: not run["video"].empty)
def draw_video(figure: Figure, run: Run[Config]) -> None:
    """Draw the share of the time in which a decoded stream is frozen, without and with requests for key frames."""
    panels = figure.subplots(1, 2, sharey=True)
    found = medians(run, "video", "frozen")
    titles = {False: "A key frame once per second", True: "A key frame also on request"}
    for axes, (requests, title) in zip(panels, titles.items(), strict=True):
        draw_groups(axes, found[found["requests"] == requests], VIDEO_CHANNELS)
        axes.set(title=title, ylim=(0, 1))
    panels[0].set_ylabel("share of the time that is frozen")
    draw_legend(panels[1])
    lossy = found[(found["channel"] == VIDEO_CHANNELS[0]) & (found["way"] == "dds_best_effort")]
    frozen = dict(zip(lossy["requests"], lossy["value"], strict=True))
    figure.suptitle(
        f"At {VIDEO_CHANNELS[0]}, best effort freezes the picture for {frozen[False] * 100:.0f} % of the time; with key frames "
        f"on request, for {frozen[True] * 100:.0f} %",
        fontsize=11,
    )
    note(figure, "live; H.264, 640 x 360, 30 Hz, 4 Mbit/s; medians, 95 % intervals")
