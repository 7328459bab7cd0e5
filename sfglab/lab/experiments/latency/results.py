"""Ages of images and times to the first image by path, claims and figure.

The capture stamp identifies an image; the stamp is also in the camera's own table of frames.
"""

from __future__ import annotations

from textwrap import fill
from typing import TYPE_CHECKING, Any

import numpy as np

from sfglab.lab.claims import Finding, How
from sfglab.lab.experiments.latency.experiment import GOP_S, STEADY_PATHS, Config, exp
from sfglab.lab.figures import COLORS, PAPER_STYLE, note
from sfglab.lab.paper import paper
from sfglab.lab.runs import Run, derived
from sfglab.lab.stats import Estimate, bootstrap, median_of, ratio_of, rounded
from sfglab.units import NS_PER_MS

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    import pandas as pd
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

STANDARD, PAPERS, OURS, NEW_PROCESS = "standard", "container", "agent", "on_demand"
FIRST_ENDS = {STANDARD: "standard (ms)", PAPERS: "on demand (ms)"}
"""Keys of the paper's times to the first frame, by path."""
NAMES = {
    STANDARD: "standard",
    PAPERS: "container (paper)",
    NEW_PROCESS: "new process",
    OURS: "sfglab (standby + GOP cache)",
    "decoder": "sfglab without routers",
}
"""Names of the paths as tables, figures and texts print them."""
ADDED_BARS = (PAPERS, OURS, "decoder")
FIRST_BARS = (STANDARD, PAPERS, NEW_PROCESS, OURS)
"""Paths that the panels of the figure show."""
BAR_COLORS = {
    STANDARD: COLORS["standard"],
    PAPERS: COLORS["third"],
    NEW_PROCESS: COLORS["fourth"],
    OURS: COLORS["proxy"],
    "decoder": COLORS["network"],
}


# --- Times ------------------------------------------------------------------------------------


@derived
def sights(run: Run[Config]) -> pd.DataFrame:
    """Return the images of the steady state, with their age ``glass_ms``, ms."""
    seen = run["sight"]
    steady = seen[seen.groupby("look").cumcount() >= run.config.skipped]
    steady = steady.merge(run["look"][["look", "repeat", "path"]], on="look")
    steady = steady[steady["path"].isin(STEADY_PATHS)]
    steady = steady.merge(run["camera"][["number", "stamp_ns"]], on="number")
    return steady.assign(glass_ms=(steady["seen_ns"] - steady["stamp_ns"]) / NS_PER_MS)


def look_medians(run: Run[Config]) -> pd.DataFrame:
    """Return the median age of each subscription's images, ms, by repetition and path."""
    return sights(run).pivot_table("glass_ms", "repeat", "path", aggfunc="median")


def firsts(run: Run[Config]) -> pd.DataFrame:
    """Return the time to the first image, ms, by repetition and path; NaN without a subscription."""
    table = run["look"]
    table = table.assign(first_ms=(table["first_ns"] - table["ordered_ns"]) / NS_PER_MS)
    return table.pivot_table("first_ms", "repeat", "path")


def unmeasured(run: Run[Config]) -> list[str]:
    """Return the names of the paths without samples; if there are any, claims and figure are incomplete."""
    missing = {*STEADY_PATHS}.difference(look_medians(run)) | {*NAMES}.difference(firsts(run))
    return [name for path, name in NAMES.items() if path in missing]


def added(run: Run[Config], path: str, *, to: str = STANDARD) -> Estimate:
    """Estimate the age, ms, that a path adds to that of another path: the median of the differences in repetitions."""
    medians = look_medians(run)
    return median_of((medians[path] - medians[to]).dropna().to_numpy(), unit="ms added")


def first_mean(run: Run[Config], path: str) -> float:
    """Return the mean time to the first image on a path, ms."""
    return float(firsts(run)[path].mean())


def loading(run: Run[Config], path: str) -> Estimate:
    """Estimate the time, ms, that a path adds to the mean time to the first image of standard, within repetitions."""
    times = firsts(run)
    more = (times[path] - times[STANDARD]).dropna().to_numpy()
    return bootstrap([more], lambda drawn: float(np.mean(drawn[0])), unit="ms")


def first_ratio(run: Run[Config], path: str) -> Estimate:
    """Estimate the ratio of a path's mean time to the first image to that of standard.

    Paths of one repetition subscribe at one phase of the GOP, so repetitions are resampled.
    """
    pairs = firsts(run)[[path, STANDARD]].dropna().to_numpy()
    return ratio_of(pairs, np.mean, unit="times standard")


def checks(run: Run[Config]) -> pd.DataFrame:
    """Return sums of the viewer's counts of images, and the number of subscriptions, by path."""
    by_path = run["look"].groupby("path", sort=False)
    counts = ["pictures", "unreadable", "missed", "disordered", "broken", "replay_packets"]
    return by_path[counts].sum().assign(looks=by_path.size()).reset_index()


# --- Claims -----------------------------------------------------------------------------------


@exp.claim("A-G2G", how=How.LIVE)
def glass_to_glass(run: Run[Config]) -> Finding | None:
    """Return the age that routers, decoder and DDS add to an image, as in the paper."""
    if unmeasured(run):
        return None
    by_dds = added(run, PAPERS, to=OURS)
    reason = f"of it DDS in place of shared memory: {by_dds}"
    return Finding(estimate=added(run, PAPERS), reason=reason)


@exp.claim("A-G2G-OURS", how=How.LIVE)
def glass_to_glass_ours(run: Run[Config]) -> Finding | None:
    """Return the age that routers, decoder and shared memory add to an image."""
    if unmeasured(run):
        return None
    return Finding(estimate=added(run, OURS))


@exp.claim("A-FIRST", how=How.LIVE)
def first_picture(run: Run[Config]) -> Finding | None:
    """Return the time to the first image with a component container, relative to standard."""
    if unmeasured(run):
        return None
    in_paper_ms = paper("A-FIRST", FIRST_ENDS[PAPERS]) - paper("A-FIRST", FIRST_ENDS[STANDARD])
    reason = (
        f"both wait for a key frame. Loading the decoder adds {loading(run, PAPERS)} in a running container "
        f"and {loading(run, NEW_PROCESS)} in a new process. The paper's difference is {in_paper_ms:.0f} ms, "
        f"about the mean wait for one more key frame ({500 * GOP_S:.0f} ms)"
    )
    ends = {key: first_mean(run, path) for path, key in FIRST_ENDS.items()}
    return Finding(estimate=first_ratio(run, PAPERS), reason=reason, ends=ends)


@exp.claim("A-FIRST-OURS", how=How.LIVE)
def first_picture_ours(run: Run[Config]) -> Finding | None:
    """Return the time to the first image with standby process and GOP replay, relative to standard."""
    if unmeasured(run):
        return None
    return Finding(estimate=first_ratio(run, OURS))


# --- Figure -----------------------------------------------------------------------------------


@exp.figure("latency", size=(11.6, 4.4))
def draw_latency(figure: Figure, run: Run[Config]) -> None:
    """Draw the latency that each path adds to standard (left), and the time to the first frame (right)."""
    if missing := unmeasured(run):
        figure.suptitle(f"Not measured: {', '.join(missing)}")
        return
    steady, first = figure.subplots(1, 2, width_ratios=(3, 4))
    medians, times = look_medians(run), firsts(run)
    more = {path: added(run, path) for path in ADDED_BARS}
    heights = {path: one.value for path, one in more.items()}
    spans = {path: (one.low, one.high) for path, one in more.items()}
    apart = medians[[*ADDED_BARS]].sub(medians[STANDARD], axis=0)
    draw_bars(steady, apart, heights, spans, {PAPERS: paper("A-G2G")})
    low, high = spans[PAPERS]
    steady.set(
        title=f"The paper's method adds {heights[PAPERS]:.1f} ms [{low:.1f}, {high:.1f}]\n"
        f"to the {rounded(medians[STANDARD].median())} ms of standard",
        ylabel="added latency (ms), bars: median",
    )
    expected_ms = {path: paper("A-FIRST", key) for path, key in FIRST_ENDS.items()}
    times = times[[*FIRST_BARS]]
    draw_bars(first, times, times.mean().to_dict(), {}, expected_ms)
    first.set(
        title=f"First frame after {times[STANDARD].mean():.0f} ms (standard), {times[PAPERS].mean():.0f} ms "
        f"(paper's method)\nand {times[OURS].mean():.0f} ms with a GOP cache (sfglab)",
        ylabel="time to first frame (ms), bars: mean",
    )
    note(
        figure,
        "dots: left repetitions, right subscriptions; error bars (left): 95 % intervals of the medians;\n"
        "dashed: paper A, 5.4",
        run,
    )


def draw_bars(
    axes: Axes,
    samples: pd.DataFrame,
    heights: dict[Any, float],
    spans: Mapping[str, Sequence[float]],
    expected_ms: dict[str, float],
) -> None:
    """Draw a bar per path with its samples, and the paper's values.

    Args:
        axes: Axes to draw into.
        samples: Times, ms, by repetition; one column per path.
        heights: Heights of the bars, ms, by path.
        spans: Ends of the error bars, ms, by path; without them a path has no error bar.
        expected_ms: The paper's values, ms, by path.
    """
    names = []
    for place, path in enumerate(map(str, samples)):
        times, height = samples[path].dropna(), heights[path]
        axes.bar(place, height, 0.5, color=BAR_COLORS[path])
        if path in spans:
            low, high = spans[path]
            error = [[max(height - low, 0)], [max(high - height, 0)]]
            axes.errorbar(place, height, error, color="black", capsize=4)
        beside = place + np.linspace(-0.25, 0.25, len(times))
        axes.plot(beside, times, ".", color="black", markersize=3, alpha=0.4)
        names.append(f"{fill(NAMES[path], 16)}\n{rounded(height)} ms (n = {len(times)})")
    places = np.array([samples.columns.get_loc(path) for path in expected_ms])
    values = [*expected_ms.values()]
    axes.hlines(values, places - 0.38, places + 0.38, **PAPER_STYLE, color="black")
    for place, value in zip(places, values, strict=True):
        axes.text(place + 0.4, value, f"paper\n{value:g}", va="center", fontsize=9)
    axes.set_xticks(range(len(names)), names)
    axes.grid(visible=False, axis="x")
    axes.set_ylim(1.15 * min(axes.dataLim.ymin, 0), 1.15 * axes.dataLim.ymax)
