"""Results: success rates by method and Rmax, the claim, and Figures 16 to 18 drawn again."""

from __future__ import annotations

from dataclasses import asdict
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from sfglab.arp.hallway import AREAS, HOME, RADIUS_M, ROBOTS, Area, End
from sfglab.arp.hallway.simulation import OPTIMUM
from sfglab.arp.robots import BEST, METHODS
from sfglab.lab.claims import Finding, How
from sfglab.lab.experiments.cooperation.experiment import NONE, Config, exp
from sfglab.lab.experiments.cooperation.live import LIVE, LIVE_SETTINGS, LIVE_VALUES, SIMULATED
from sfglab.lab.figures import COLORS, default_sidecar, note
from sfglab.lab.runs import Run, derived, lines_of
from sfglab.lab.stats import Estimate, difference_of, share_of, wilson

if TYPE_CHECKING:
    from collections.abc import Mapping

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

METHOD_WORDS = {"OPT": "balanced QoS", "LC": "local cache", "CC": "cache control"}
ENDINGS = {
    End.SUCCESS: "the lap takes",
    End.CONTACT: "hits a wall or box after",
    End.STOP: "meets an obstacle after",
    End.TIMEOUT: "the lap is given up after",
}
"""Ends of a lap, as the part of a sentence before its duration."""
NO_ROBOT = "no single robot"  #: Failure of a lap that was given up.
ROBOT_COLORS = dict(zip(ROBOTS, (COLORS["proxy"], "#E69F00", "#000000"), strict=True))
_SHARE_COLORS = {End.SUCCESS.value: COLORS["third"], **ROBOT_COLORS, NO_ROBOT: COLORS["network"]}
_SHARE_LABELS = {End.SUCCESS.value: "lap completed", NO_ROBOT: "given up after 120 s"}
_MARK_S = 10.0
_CM_PER_M = 100


def method_text(method: str) -> str:
    """Return a method's name with its code, as ``balanced QoS and local cache (OPT+LC)``."""
    if method == NONE:
        return "no method"
    words = [METHOD_WORDS[code] for code in method.split("+")]
    return f"{' and '.join(words)} ({method})"


# --- Tables -----------------------------------------------------------------------------------


@derived
def laps(run: Run[Config]) -> pd.DataFrame:
    """Return one row per lap, with ``success``."""
    table = run["course"]
    return table.assign(success=table["end"] == End.SUCCESS.value)


def rates(table: pd.DataFrame, *keys: str) -> pd.DataFrame:
    """Return success rates with Wilson's 95 % interval by columns, methods in the paper's order.

    Args:
        table: Laps with ``success``.
        keys: Columns of the groups, ``method`` first.
    """
    counts = table.groupby(list(keys))["success"].agg(successes="sum", runs="count").reset_index()
    order = list(METHODS)
    found = counts.sort_values("method", key=lambda names: names.map(order.index), kind="stable")
    bounds = [wilson(row.successes, row.runs) for row in lines_of(found)]
    low, high = zip(*bounds, strict=True)
    rate = found["successes"] / found["runs"]
    return found.assign(rate=rate, low=low, high=high).reset_index(drop=True)


def failing_robots(table: pd.DataFrame) -> pd.DataFrame:
    """Return how many laps of each method were completed, and in how many which robot failed."""
    robot = table["robot"].replace("", NO_ROBOT)
    ending = robot.where(~table["success"], End.SUCCESS.value)
    counts = pd.crosstab(table["method"], ending)
    methods = [method for method in METHODS if method in counts.index]
    return counts.reindex(index=methods, columns=list(_SHARE_COLORS), fill_value=0)


def endings(table: pd.DataFrame) -> pd.DataFrame:
    """Return how many laps of each method ended in which way: a contact is no stop for an obstacle."""
    counts = pd.crosstab(table["method"], table["end"])
    methods = [method for method in METHODS if method in counts.index]
    ways = [end.value for end in End]
    return counts.reindex(index=methods, columns=ways, fill_value=0)


def causes(table: pd.DataFrame) -> pd.DataFrame:
    """Return rate, history depth, channel utilisation and success by method, Rmax and DEPTH."""
    keys = ["method", "rate_max_hz", "depth"]
    columns = ["rate_hz", "depth_used", "airtime", "success"]
    found = table.groupby(keys)[columns].mean().reset_index()
    found["depth"] = found["depth"].map(depth_text)
    names = {
        "rate_max_hz": "Rmax (Hz)",
        "depth": "DEPTH",
        "rate_hz": "rate of a topic (Hz)",
        "depth_used": "history depth",
        "airtime": "channel utilisation",
        "success": "laps completed",
    }
    return found.rename(columns=names)


def depth_text(depth: int) -> str:
    """Return a value of DEPTH, as Table 2 has it."""
    return "Eq. 6" if depth == OPTIMUM else str(depth)


def live_lap(run: Run[Config]) -> pd.DataFrame:
    """Return how the live lap and the simulated one beside it ended; empty without a live lap."""
    values = {} if run.skipped("live") else run.metadata("live")
    lines = [(name, values[name]) for name in LIVE_VALUES if name in values]
    return pd.DataFrame(lines, columns=["quantity", "value"])


# --- Claim ------------------------------------------------------------------------------------


def difference(table: pd.DataFrame) -> Estimate:
    """Return how much larger the success rate of OPT+LC is than without a method.

    Rates are averaged over Rmax. All values of DEPTH count alike.
    """
    more, less = (_mean_over_rates(table, method) for method in (BEST, NONE))
    return difference_of(more, less, unit="success rate difference")


def _mean_over_rates(table: pd.DataFrame, method: str) -> Estimate:
    laps_of = table[table["method"] == method]
    share = float(laps_of.groupby("rate_max_hz")["success"].mean().mean())
    return share_of(share * len(laps_of), len(laps_of), unit="success rate")


@exp.claim("B-COOP", how=How.SIMULATED)
def success_difference(run: Run[Config]) -> Finding:
    """Return how much more often a lap is completed with OPT+LC than without any method."""
    table = laps(run)
    details = {}
    for row in lines_of(rates(table, "method")):
        interval = f"{row.rate:.2f} [{row.low:.2f}, {row.high:.2f}]"
        details[f"success, {row.method}"] = f"{interval} of {row.runs} laps"
    for method, counts in failing_robots(table).to_dict("index").items():
        details[f"failing robots, {method}"] = _failing_robots_text(counts)
    for method, counts in endings(table).to_dict("index").items():
        ways = [f"{end} in {count}" for end, count in counts.items() if count]
        details[f"ends, {method}"] = ", ".join(ways)
    return Finding(estimate=difference(table), details=details, reason=_reason(table))


def _failing_robots_text(counts: Mapping[Any, int]) -> str:
    failed = {name: count for name, count in counts.items() if name != End.SUCCESS.value}
    parts = [f"{name} in {count}" for name, count in failed.items() if count]
    return ", ".join(parts) or "none"


def _reason(table: pd.DataFrame) -> str:
    """Return why laps with OPT+LC fail; empty if none does."""
    best = table[table["method"] == BEST]
    failed = best[~best["success"]]
    if failed.empty:
        return ""
    depth = int(failed["depth_used"].median())
    robots = _failing_robots_text(failing_robots(best).to_dict("index")[BEST])
    return (
        f"OPT+LC fails in {len(failed)} of {len(best)} laps ({robots}): at a history depth of {depth} the "
        "history seldom fills, so a lost sample is requested only after the next heartbeat, every 3 s, "
        "and RELIABLE holds back all samples behind it"
    )


# --- Figure 16 --------------------------------------------------------------------------------


@exp.figure("cooperation", size=(10.4, 5.8))
def draw_success(figure: Figure, run: Run[Config]) -> dict[str, Any]:
    """Draw completed laps and failing robots by method, and completed laps by DEPTH and Rmax."""
    table = laps(run)
    of_methods, of_cells = figure.subplots(1, 2, width_ratios=(1.25, 1))
    _draw_failing_robots(of_methods, table)
    _draw_counts(of_cells, rates(table, "method", "depth", "rate_max_hz"))
    best, none = (completed(table, method) for method in (BEST, NONE))
    figure.suptitle(
        f"Balanced QoS with the local cache (OPT+LC) completes {best} laps, no method {none}\n"
        "(paper: OPT+LC completes the task; Fig. 18 has a failed lap and names no method)"
    )
    seeds = table["seed"].nunique()
    channel = f"{100 * run.config.loss:g} % of frames lost"
    note(figure, f"simulated, {seeds} seeds per setting, {channel}; in brackets: 95 % CI (Wilson)")
    return default_sidecar(run)


def completed(table: pd.DataFrame, method: str) -> str:
    """Return how many of a method's laps are completed, as ``1 of 24``."""
    success = table["success"][table["method"] == method]
    return f"{success.sum()} of {len(success)}"


def _draw_failing_robots(axes: Axes, table: pd.DataFrame) -> None:
    """Draw the laps of each method as a bar: completed, or the robot that failed."""
    counts = failing_robots(table)
    shares = 100 * counts.div(counts.sum(axis=1), axis=0)
    shares.columns = [_SHARE_LABELS.get(ending, f"{ending} fails") for ending in _SHARE_COLORS]
    shares.index = [method if "+" in method else method_text(method) for method in counts.index]
    shares.plot.barh(ax=axes, stacked=True, color=list(_SHARE_COLORS.values()), legend=False)
    for place, row in enumerate(lines_of(rates(table, "method"))):
        text = f"{row.successes} of {row.runs} completed [{row.low:.0%}, {row.high:.0%}]"
        axes.annotate(text, (0, place - 0.3), va="bottom", fontsize=8)
    axes.set(xlabel="share of laps (%)", ylabel="", xlim=(0, 100), ylim=(len(shares) - 0.5, -0.8))
    axes.grid(visible=False, axis="y")
    axes.legend(loc="upper center", bbox_to_anchor=(0.4, -0.11), ncols=3, fontsize=8)


def _draw_counts(axes: Axes, cells: pd.DataFrame) -> None:
    """Draw how many laps are completed, one row per method and DEPTH, one column per Rmax."""
    names = cells["method"].replace(NONE, method_text(NONE)) + ", " + cells["depth"].map(depth_text)
    grid = cells.assign(setting=names)
    shares = grid.pivot_table("rate", "setting", "rate_max_hz", sort=False)
    axes.imshow(shares, cmap="Greens", vmin=0, vmax=2, aspect="auto")
    columns, settings = list(shares.columns), list(shares.index)
    for row in lines_of(grid):
        x, y = columns.index(row.rate_max_hz), settings.index(row.setting)
        axes.text(x, y, f"{row.successes} of {row.runs}", ha="center", va="center", fontsize=8)
    axes.set_xticks(range(len(columns)), columns)
    axes.set_yticks(range(len(settings)), settings, fontsize=8)
    axes.set_xlabel("maximum rate Rmax (Hz)")
    title = "completed laps by method, history depth (DEPTH) and Rmax"
    axes.set_title(title, fontsize=9, loc="right")
    axes.grid(visible=False)


# --- Figures 17 and 18 ------------------------------------------------------------------------


@exp.figure("cooperation_tracks", size=(10, 4.7))
def draw_tracks(figure: Figure, run: Run[Config]) -> dict[str, Any]:
    """Draw the robots' tracks in a lap that was completed (Fig. 17) and one that failed (Fig. 18)."""
    examples: dict[str, Any] = run.metadata("examples")
    figure.set_layout_engine("constrained", h_pad=0.1)  # inches, between axes and note
    panels = figure.subplots(1, max(1, len(examples)), squeeze=False)[0]
    tracks = run["track"]
    sentences = []
    for axes, (name, example) in zip(panels, examples.items(), strict=False):
        draw_lap(axes, tracks[tracks["run"] == name], failing=example["robot"])
        count = completed(laps(run), example["method"])
        axes.set_title(
            f"{_setting_text(example)}\n({count} laps with this method completed)", fontsize=9
        )
        sentences.append(_ending_text(example))
    title = "; ".join(sentences)
    figure.suptitle(title[:1].upper() + title[1:])
    note(figure, "simulated, first lap that ends so; one dot every 10 s; ring: robot that fails")
    return default_sidecar(run)


def _setting_text(example: Mapping[str, Any]) -> str:
    method = method_text(example["method"])
    depth = depth_text(example["depth"])
    return (
        f"{method}\nmaximum rate (Rmax) {example['rate_max_hz']} Hz, history depth (DEPTH): {depth}"
    )


def _ending_text(example: Mapping[str, Any]) -> str:
    """Return how a lap ended, as the part of a sentence."""
    method = "without a method"
    if example["method"] != NONE:
        method = f"with {example['method']}"
    words = [method, example["robot"], ENDINGS[End(example["end"])], f"{example['ended_s']:.0f} s"]
    return " ".join(filter(None, words))


def draw_lap(axes: Axes, tracks: pd.DataFrame, *, failing: str = "") -> None:
    """Draw the tracks of a lap into one hallway, each robot's track and boxes in its colour.

    Args:
        axes: Axes to draw into.
        tracks: Rows of the table ``track`` of one lap.
        failing: Name of the robot that gets a ring at its end.
    """
    from matplotlib.patches import Circle

    for x0, y0, x1, y1 in Area(robot="walls").segments:
        axes.plot([x0, x1], [y0, y1], color="black", linewidth=1.3)
    axes.plot(*HOME[:2], "+", color="black", markersize=9)
    for area in AREAS:
        color = ROBOT_COLORS[area.robot]
        for box in area.boxes:
            axes.fill(*box.corners().T, color=color, alpha=0.6)
        own = tracks[tracks["robot"] == area.robot]
        axes.plot(own["x_m"], own["y_m"], color=color, linewidth=1.2, label=area.robot)
        marked = own[np.isclose(own["t_s"] % _MARK_S, 0.0, atol=1e-6)]
        axes.plot(marked["x_m"], marked["y_m"], "o", color=color, markersize=2.5)
        end = own[["x_m", "y_m"]].iloc[-1]
        axes.add_patch(Circle(tuple(end), RADIUS_M, color=color, alpha=0.7))
        if area.robot == failing:
            axes.plot(*end, "o", markersize=17, mfc="none", color="black")
    axes.legend(
        fontsize=8,
        title="track and boxes of",
        title_fontsize=8,
        loc="upper right",
        bbox_to_anchor=(1.06, 0.97),
    )
    axes.set(aspect="equal", xlabel="x (m)", ylabel="y (m)")
    axes.grid(visible=False)


# --- The live lap -----------------------------------------------------------------------------


def _has_live_lap(run: Run[Config]) -> bool:
    return bool((run["track"]["run"] == LIVE).any())


@exp.figure("cooperation_live", size=(10.4, 4.6), when=_has_live_lap)
def draw_live(figure: Figure, run: Run[Config]) -> None:
    """Draw the live lap, and how far each robot's track is from the simulated one."""
    tracks = run["track"]
    ways, distances = figure.subplots(1, 2, width_ratios=(1.2, 1))
    draw_lap(ways, tracks[tracks["run"] == LIVE])
    ways.set_title(_setting_text(asdict(LIVE_SETTINGS)), fontsize=9)
    farthest_cm = 0.0
    for robot, color in ROBOT_COLORS.items():
        apart = distance_to_simulated(tracks, robot)
        distance_cm = _CM_PER_M * apart["distance_m"]
        distances.plot(apart["t_s"], distance_cm, color=color, label=robot)
        farthest_cm = max(farthest_cm, distance_cm.max())
    distances.set(xlabel="time (s)", ylabel="distance to the simulated track (cm)", ylim=(0, None))
    values = run.metadata("live")
    schedule = "kept its schedule" if values["kept_up"] else "did not keep its schedule"
    figure.suptitle(
        f"The live lap over DDS {schedule} and ended with: {values['end']}\n"
        f"The robots stay within {farthest_cm:.0f} cm of their simulated tracks"
    )
    lasted_s = values["lasted_s"]
    note(figure, f"one live lap of {lasted_s:.0f} s, over Cyclone DDS; one dot every 10 s")


def distance_to_simulated(tracks: pd.DataFrame, robot: str) -> pd.DataFrame:
    """Return how far a live robot is from the nearest point of its simulated track.

    Returns:
        One row per pose: ``t_s``, and ``distance_m``.
    """
    own = tracks[tracks["robot"] == robot]
    live, simulated = (own[own["run"] == name] for name in (LIVE, SIMULATED))
    points = live[["x_m", "y_m"]].to_numpy()
    others = simulated[["x_m", "y_m"]].to_numpy()
    apart_m = np.linalg.norm(points[:, None] - others[None], axis=2)
    # The live robot may have come further than the simulated one; the track's end alone does not count.
    is_beside = apart_m.argmin(axis=1) < len(others) - 1
    times_s = live["t_s"].to_numpy()
    return pd.DataFrame({"t_s": times_s[is_beside], "distance_m": apart_m.min(axis=1)[is_beside]})
