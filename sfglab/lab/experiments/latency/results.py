"""Ages of pictures and times to the first picture by path, claims, figure and explorer.

A picture is identified by its capture stamp, which is also in the camera's own table of frames.
"""

from __future__ import annotations

from functools import cache
from textwrap import fill
from typing import TYPE_CHECKING, Annotated

import numpy as np
import pandas as pd

from sfglab.codecs import TABLE_2
from sfglab.fields import Bounds
from sfglab.lab import pictures
from sfglab.lab.claims import Finding, How
from sfglab.lab.experiments.latency.experiment import GOP_S, STEADY_PATHS, Config, exp
from sfglab.lab.figures import COLORS, PAPER_STYLE, note
from sfglab.lab.paper import paper
from sfglab.lab.paths import find_project
from sfglab.lab.runs import Run, derived
from sfglab.lab.stats import Estimate, Floats, bootstrap, line_fit, median_of, ratio_of, rounded
from sfglab.units import NS_PER_MS

if TYPE_CHECKING:
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
STEADY_BARS = (STANDARD, PAPERS, OURS, "decoder")
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
def looks(run: Run[Config]) -> pd.DataFrame:
    """Return the subscriptions with two times of the first picture, ms.

    They are ``first_ms`` since the order to subscribe, and ``first_age_ms`` since its capture, which is NaN if
    the camera did not send it.
    """
    first = run["sight"].drop_duplicates("look").merge(run["camera"], on="number")
    first["first_age_ms"] = (first["seen_ns"] - first["stamp_ns"]) / NS_PER_MS
    table = run["look"].merge(first[["look", "first_age_ms"]], on="look", how="left")
    return table.assign(first_ms=(table["first_ns"] - table["ordered_ns"]) / NS_PER_MS)


@derived
def sights(run: Run[Config]) -> pd.DataFrame:
    """Return the pictures of the steady state, with their age ``glass_ms``, ms."""
    seen = run["sight"]
    steady = seen[seen.groupby("look").cumcount() >= run.config.skipped]
    steady = steady.merge(run["look"][["look", "repeat", "path"]], on="look")
    steady = steady[steady["path"].isin(STEADY_PATHS)]
    steady = steady.merge(run["camera"][["number", "stamp_ns"]], on="number")
    return steady.assign(glass_ms=(steady["seen_ns"] - steady["stamp_ns"]) / NS_PER_MS)


def look_medians(run: Run[Config]) -> pd.DataFrame:
    """Return the median age of each subscription's pictures, ms, by repetition and path."""
    return sights(run).pivot_table("glass_ms", "repeat", "path", aggfunc="median")


def firsts(run: Run[Config]) -> pd.DataFrame:
    """Return the time to the first picture, ms, by repetition and path; NaN: not subscribed."""
    return looks(run).pivot_table("first_ms", "repeat", "path")


def unmeasured(run: Run[Config]) -> list[str]:
    """Return the names of the paths without samples, with which claims, tables and figure cannot be complete."""
    missing = {*STEADY_PATHS}.difference(look_medians(run)) | {*NAMES}.difference(firsts(run))
    return [name for path, name in NAMES.items() if path in missing]


def glass_median(run: Run[Config], path: str) -> Estimate:
    """Estimate the age of pictures on a path by the median over subscriptions."""
    return median_of(look_medians(run)[path].dropna().to_numpy(), unit="ms")


def added(run: Run[Config], path: str, *, to: str = STANDARD) -> Estimate:
    """Estimate what a path adds to another one: the median of the differences in repetitions."""
    medians = look_medians(run)
    return median_of((medians[path] - medians[to]).dropna().to_numpy(), unit="ms added")


def mean_of(samples: Floats) -> Estimate:
    """Estimate the mean of times, ms."""
    return bootstrap([samples], lambda drawn: float(np.mean(drawn[0])), unit="ms")


def first_mean(run: Run[Config], path: str) -> Estimate:
    """Estimate the mean time to the first picture on a path."""
    return mean_of(firsts(run)[path].dropna().to_numpy())


def loading(run: Run[Config], path: str) -> Estimate:
    """Estimate what a path adds to the mean time of standard, within repetitions."""
    times = firsts(run)
    return mean_of((times[path] - times[STANDARD]).dropna().to_numpy())


def first_ratio(run: Run[Config], path: str) -> Estimate:
    """Estimate the ratio of a path's mean time to the first picture to that of standard.

    Paths of one repetition subscribe at one phase of the GOP, so repetitions are resampled.
    """
    pairs = firsts(run)[[path, STANDARD]].dropna().to_numpy()
    return ratio_of(pairs, np.mean, unit="times standard")


def checks(run: Run[Config]) -> pd.DataFrame:
    """Return, by path, counts of the pictures that the viewer received.

    ``unknown`` counts first pictures that the camera did not send. ``oldest_ms`` is the largest age of a first
    picture.
    """
    by_path = looks(run).groupby("path", sort=False)
    columns = ["pictures", "unreadable", "missed", "disordered", "broken"]
    table = by_path[[*columns, "replay_packets", "replay_bytes"]].sum()
    table["looks"] = by_path.size()
    table["unknown"] = table["looks"] - by_path["first_age_ms"].count()
    table["oldest_ms"] = by_path["first_age_ms"].max()
    return table.reset_index()


# --- Tables of the notebook -------------------------------------------------------------------


def added_table(run: Run[Config]) -> pd.DataFrame:
    """Return the latencies that paths add to each other, in the steady state, or the paths without samples."""
    if missing := unmeasured(run):
        return pd.DataFrame({"not measured": missing})
    pairs = [(path, STANDARD, "") for path in (PAPERS, OURS, "decoder")]
    pairs += [
        (OURS, "decoder", "the two routers"),
        (PAPERS, OURS, "DDS instead of shared memory"),
    ]
    rows = []
    for path, other, part in pairs:
        found = added(run, path, to=other)
        row = {
            "path": NAMES[path],
            "compared with": NAMES[other],
            "difference is due to": part or "all that the path adds",
            "added latency (ms)": found.value,
            "95 % interval": f"{rounded(found.low)} to {rounded(found.high)}",
        }
        rows.append(row)
    return pd.DataFrame(rows)


def first_table(run: Run[Config]) -> pd.DataFrame:
    """Return the times to the first frame by path, and their ratios to *standard* within repetitions.

    If paths have no samples, it is a table of these paths.
    """
    if missing := unmeasured(run):
        return pd.DataFrame({"not measured": missing})
    times = firsts(run)
    rows = []
    for path, name in NAMES.items():
        ratio = first_ratio(run, path)
        row = {
            "path": name,
            "subscriptions": int(times[path].count()),
            "mean (ms)": times[path].mean(),
            "shortest (ms)": times[path].min(),
            "longest (ms)": times[path].max(),
            "mean / mean of standard": ratio.value,
            "95 % interval": f"{rounded(ratio.low)} to {rounded(ratio.high)}",
        }
        if path == STANDARD:
            row["95 % interval"] = ""  # compared with itself
        rows.append(row)
    return pd.DataFrame(rows)


# --- Claims -----------------------------------------------------------------------------------


def hosts_of(run: Run[Config]) -> dict[str, str]:
    """Return the details that name hosts and encoder of a run."""
    description, encoder = run.metadata("hosts")["description"], run.metadata("stream")["encoder"]
    return {"hosts": str(description), "encoder": str(encoder)}


@exp.claim("A-G2G", how=How.LIVE)
def glass_to_glass(run: Run[Config]) -> Finding | None:
    """Return what routers, decoder and DDS add to the age of a picture, as in the paper."""
    if unmeasured(run):
        return None
    by_dds = added(run, PAPERS, to=OURS)
    details = {**hosts_of(run), "standard": str(glass_median(run, STANDARD))}
    reason = f"of it DDS in place of shared memory: {by_dds}"
    return Finding(estimate=added(run, PAPERS), details=details, reason=reason)


@exp.claim("A-G2G-OURS", how=How.LIVE)
def glass_to_glass_ours(run: Run[Config]) -> Finding | None:
    """Return what routers, decoder and shared memory add to the age of a picture."""
    if unmeasured(run):
        return None
    details = {**hosts_of(run), "without routers": str(added(run, "decoder"))}
    return Finding(estimate=added(run, OURS), details=details)


@exp.claim("A-FIRST", how=How.LIVE)
def first_picture(run: Run[Config]) -> Finding | None:
    """Return the time to the first picture in a component container, relative to standard."""
    if unmeasured(run):
        return None
    in_paper_ms = paper("A-FIRST", FIRST_ENDS[PAPERS]) - paper("A-FIRST", FIRST_ENDS[STANDARD])
    wait_ms = 500 * GOP_S
    reason = (
        f"both wait for a key frame; loading adds {loading(run, PAPERS)} in a container and "
        f"{loading(run, NEW_PROCESS)} in a new process, {in_paper_ms:.0f} ms in the paper, about as a "
        f"second such wait would ({wait_ms:.0f} ms)"
    )
    ends = {key: first_mean(run, path).value for path, key in FIRST_ENDS.items()}
    estimate = first_ratio(run, PAPERS)
    return Finding(estimate=estimate, details=hosts_of(run), reason=reason, ends=ends)


@exp.claim("A-FIRST-OURS", how=How.LIVE)
def first_picture_ours(run: Run[Config]) -> Finding | None:
    """Return the time to the first picture with standby process and GOP replay, relative to standard."""
    if unmeasured(run):
        return None
    details = {**hosts_of(run), "with replay, through routers": str(first_mean(run, OURS))}
    return Finding(estimate=first_ratio(run, OURS), details=details)


# --- Figure -----------------------------------------------------------------------------------


@exp.figure("latency", size=(11.6, 4.4))
def draw_latency(figure: Figure, run: Run[Config]) -> None:
    """Draw the age of pictures in the steady state (left) and the time to the first picture (right)."""
    if missing := unmeasured(run):
        figure.suptitle(f"Not measured: {', '.join(missing)}")
        return
    steady, first = figure.subplots(1, 2)
    medians, times = look_medians(run), firsts(run)
    more_ms = paper("A-G2G")
    expected_ms = {PAPERS: medians[STANDARD].median() + more_ms}
    draw_bars(steady, medians[[*STEADY_BARS]], medians.median(), expected_ms)
    steady.set(title="From capture to decoded frame, median", ylabel="latency (ms)")
    steady.legend([steady.collections[-1]], [f"standard + the paper's {more_ms:g} ms"])
    expected_ms = {path: paper("A-FIRST", key) for path, key in FIRST_ENDS.items()}
    draw_bars(first, times[[*FIRST_BARS]], times.mean(), expected_ms)
    first.set(title="From subscribing to first frame, mean", ylabel="time to first frame (ms)")
    first.legend([first.collections[-1]], ["paper A, 5.4"])
    before_ms, after_ms = times[STANDARD].mean(), times[OURS].mean()
    figure.suptitle(
        f"Routers and decoder add {added(run, PAPERS).value:.1f} ms; with a GOP cache the first frame "
        f"arrives {before_ms / after_ms:.1f} times sooner ({after_ms:.0f} instead of {before_ms:.0f} ms)",
        fontsize=11,
    )
    note(figure, "one dot per subscription; error bars: 16th to 84th percentile", run)


def draw_bars(
    axes: Axes, samples: pd.DataFrame, heights: pd.Series, expected_ms: dict[str, float]
) -> None:
    """Draw a bar per path with its samples, and the paper's values.

    Args:
        axes: Axes to draw into.
        samples: Times, ms, by repetition; one column per path.
        heights: Heights of the bars, ms, by path.
        expected_ms: The paper's values, ms, by path.
    """
    names = []
    for place, path in enumerate(map(str, samples)):
        times, height = samples[path].dropna(), float(heights[path])
        # The paper draws one standard deviation. Of normal samples this is the same, and it does not follow
        # one subscription during which the machine was busy.
        low, high = np.percentile(times, (16, 84))
        error = [[max(height - low, 0)], [max(high - height, 0)]]
        axes.bar(place, height, 0.5, color=BAR_COLORS[path], yerr=error, capsize=4)
        beside = place + np.linspace(-0.25, 0.25, len(times))
        axes.plot(beside, times, ".", color="black", markersize=3, alpha=0.4)
        names.append(f"{fill(NAMES[path], 16)}\n{rounded(height)} ms (n = {len(times)})")
    places = np.array([samples.columns.get_loc(path) for path in expected_ms])
    values = [*expected_ms.values()]
    axes.hlines(values, places - 0.38, places + 0.38, **PAPER_STYLE, color="black")
    axes.set_xticks(range(len(names)), names)
    axes.grid(visible=False, axis="x")
    axes.set_ylim(0, 1.15 * axes.dataLim.ymax)


# --- Explorer ---------------------------------------------------------------------------------

GOP = Annotated[int, Bounds(1, 300, log=True)]
Rate = Annotated[float, Bounds(1, 120, log=True)]

LENGTHS = (1, 2, 3, 5, 10, 20, 30, 60, 100, 200, 300)
_GOP = pictures.Axis("frames per GOP", "", 1, 300, log=True, ticks=(1, 10, 30, 100, 300))
_WAIT = pictures.Axis(
    "time to first frame", "ms", 10, 200_000, log=True, ticks=(10, 100, 1000, 10_000, 100_000)
)


@cache
def reference_times() -> tuple[dict[str, float], float]:
    """Return times of the reference run, ms: on each path without a wait, and for each replayed packet."""
    run = exp.load(find_project().reference_logs / f"{exp.name}.mcap")
    # A key frame arrives as late as any picture.
    rest_ms = {STANDARD: glass_median(run, STANDARD).value}
    for path in (PAPERS, NEW_PROCESS):
        rest_ms[path] = rest_ms[STANDARD] + loading(run, path).value
    replays = looks(run).query("path == @OURS")[["replay_packets", "first_ms"]].to_numpy(float)
    packet_ms, rest_ms[OURS] = line_fit(*replays.T)
    return rest_ms, packet_ms


@exp.explorer
def first_frame(*, gop: GOP = 30, rate_hz: Rate = TABLE_2.fps) -> pictures.Picture:
    """Return the mean time to the first frame over the length of the group of pictures (GOP).

    *Computed*: without a GOP cache a subscriber waits for half a GOP on average; with it, half a GOP is replayed.
    *Assumed*: loading, and each replayed packet, take as long as in the reference run.

    Args:
        gop: Frames from key frame to key frame, of the dots.
        rate_hz: Frame rate of the camera [Hz].
    """
    rest_ms, packet_ms = reference_times()
    lengths = [*LENGTHS, gop]
    half = np.array(lengths) / 2
    wait_ms = 1000 / rate_hz
    times: list[pictures.Series] = []
    means = []
    for path in FIRST_BARS:
        frame_ms = packet_ms if path == OURS else wait_ms
        path_ms = rest_ms[path] + frame_ms * half
        name = NAMES[path]
        times += pictures.curve(name, BAR_COLORS[path], lengths, path_ms.tolist())
        means.append(f"{name}: {path_ms[-1]:.0f} ms")
    # On all frame rates that can be set a frame takes longer than the replay of one.
    equal = 2 * (rest_ms[OURS] - rest_ms[STANDARD]) / (wait_ms - packet_ms)
    said = (
        f"Mean time to the first frame with {gop} frames per GOP at {rate_hz:g} Hz. {'; '.join(means)}. "
        f"Below {equal:.1f} frames per GOP, standard is faster than sfglab."
    )
    text = f"{rate_hz:g} Hz; dots: {gop} frames per GOP"
    panel = pictures.Panel(title="first frame", x=_GOP, y=_WAIT, series=tuple(times), note=text)
    return pictures.Picture(said=said, panels=(panel,))
