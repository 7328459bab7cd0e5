"""The module `cooperation.results` has success rates, the claim B-COOP, and figures like paper B's Fig. 16 to 18."""

from __future__ import annotations

from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from sfglab.arp.hallway import AREAS, HOME, RADIUS_M, ROBOTS, Area, End
from sfglab.arp.hallway.simulation import OPTIMUM
from sfglab.arp.robots import BEST, METHODS
from sfglab.lab.claims import Finding, How
from sfglab.lab.experiments.cooperation.experiment import NONE, Config, exp
from sfglab.lab.experiments.cooperation.live import LIVE, LIVE_SETTINGS, SIMULATED
from sfglab.lab.figures import COLORS, note
from sfglab.lab.runs import Run, derived
from sfglab.lab.stats import Estimate, difference_of, share_of
from sfglab.rtps import PRESETS

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

ENDS = [end.value for end in End]
ROBOT_COLORS = dict(zip(ROBOTS, (COLORS["proxy"], "#E69F00", "#000000"), strict=True))


def setting_text(settings: Any) -> str:
    """Return method, Rmax and DEPTH of `LapSettings` or of a row."""
    depth = depth_text(settings.depth)
    return f"{settings.method}, Rmax {settings.rate_max_hz} Hz, DEPTH {depth}"


def ending_text(end: End, robot: str, ended_s: float) -> str:
    """Return a text about how a lap ended, such as ``robot2: contact after 11 s``."""
    whose = f"{robot}: " if robot else ""
    return f"{whose}{end.value} after {ended_s:.0f} s"


# --- Tables -----------------------------------------------------------------------------------


@derived
def laps(run: Run[Config]) -> pd.DataFrame:
    """Return one row per lap, with the column ``success``."""
    table = run["course"]
    return table.assign(success=table["end"] == End.SUCCESS.value)


def endings(table: pd.DataFrame) -> pd.DataFrame:
    """Return the number of laps of each method by kind of end, and the number of laps that each robot failed.

    A contact does not count as a stop for an obstacle.
    """
    ends, robots = (pd.crosstab(table["method"], table[column]) for column in ("end", "robot"))
    methods = [method for method in METHODS if method in ends.index]
    return ends.join(robots).reindex(index=methods, columns=[*ENDS, *ROBOTS], fill_value=0)


def depth_text(depth: int) -> str:
    """Return the text of a value of DEPTH, as Table 2 has the value."""
    return "Eq. 6" if depth == OPTIMUM else str(depth)


# --- Claim ------------------------------------------------------------------------------------


def difference(table: pd.DataFrame) -> Estimate:
    """Return the success rate of OPT+LC minus the success rate without a method.

    The rates are means over Rmax. All values of DEPTH have the same weight.
    """
    more, less = (_mean_over_rates(table, method) for method in (BEST, NONE))
    return difference_of(more, less, unit="success rate difference")


def _mean_over_rates(table: pd.DataFrame, method: str) -> Estimate:
    laps_of = table[table["method"] == method]
    share = float(laps_of.groupby("rate_max_hz")["success"].mean().mean())
    return share_of(share * len(laps_of), len(laps_of), unit="success rate")


@exp.claim("B-COOP", how=How.SIMULATED)
def success_difference(run: Run[Config]) -> Finding:
    """Return the difference of the success rates of laps with OPT+LC and without any method."""
    table = laps(run)
    counts = endings(table)
    details = {}
    for method in counts.index:
        done = table[table["method"] == method]["success"]
        rate = share_of(int(done.sum()), len(done), unit="success rate")
        texts = [counts_text(counts.loc[method, names]) for names in (ENDS, [*ROBOTS])]
        counted = "; by robot: ".join(filter(None, texts))
        details[f"{method}, {len(done)} laps"] = f"{rate}: {counted}"
    return Finding(estimate=difference(table), details=details, reason=_reason(table))


def counts_text(counts: Any) -> str:
    """Return a text of the counts that are not zero, such as ``contact in 3, timeout in 2``."""
    return ", ".join(f"{name} in {count}" for name, count in counts.items() if count)


def _reason(table: pd.DataFrame) -> str:
    """Return why laps with OPT+LC fail; empty if no lap fails."""
    best = table[table["method"] == BEST]
    failed = best[~best["success"]]
    if failed.empty:
        return ""
    depth = int(failed["depth_used"].median())
    return (
        f"OPT+LC fails in {len(failed)} of {len(best)} laps: at a history depth of {depth} the "
        "history seldom fills, so a lost sample is requested only after the next heartbeat, every 3 s, "
        "and RELIABLE holds back all samples behind it"
    )


# --- Figure 16 --------------------------------------------------------------------------------


@exp.figure("cooperation", size=(7.5, 5.6), measured=False)
def draw_success(figure: Figure, run: Run[Config]) -> None:
    """Draw how many laps are completed, one row per method and DEPTH, one column per Rmax."""
    table = laps(run)
    rows = ["method", "depth"]
    counts = table.pivot_table("success", rows, "rate_max_hz", aggfunc=["sum", "count"])
    ordered = counts.reindex([*METHODS], level="method")
    done, driven = ordered["sum"], ordered["count"].to_numpy()
    axes = figure.subplots()
    axes.imshow(done / driven, cmap="Greens", vmin=0, vmax=2, aspect="auto")
    for (y, x), count in np.ndenumerate(done):
        axes.text(x, y, f"{count} of {driven[y, x]}", ha="center", va="center", fontsize=8)
    names = [f"{method}, DEPTH {depth_text(depth)}" for method, depth in done.index]
    axes.set_xticks(range(len(done.columns)), [f"{rate_hz} Hz" for rate_hz in done.columns])
    axes.set_yticks(range(len(done)), names, fontsize=8)
    axes.set_xlabel("Rmax, the highest rate of a topic")
    axes.grid(visible=False)
    is_always = (done.to_numpy() == driven).all(axis=1)
    always = [name for name, every in zip(names, is_always, strict=True) if every]
    figure.suptitle(
        f"Laps completed: {completed(table, BEST)} with OPT+LC (paper: it completes the task),\n"
        f"{completed(table, NONE)} without a method; all with: {'; '.join(always) or 'no setting'}"
    )
    note(
        figure,
        f"simulated, {table['seed'].nunique()} seeds per setting, {100 * run.config.loss:g} % frame loss; "
        f"timing of {PRESETS[run.config.vendor].name}\n"
        "none: no method; OPT: balanced QoS, LC: local cache, CC: cache control",
    )


def completed(table: pd.DataFrame, method: str) -> str:
    """Return a text of the number of a method's completed laps, such as ``1 of 24``."""
    success = table["success"][table["method"] == method]
    return f"{success.sum()} of {len(success)}"


# --- Figures 17 and 18 ------------------------------------------------------------------------


@exp.figure("cooperation_tracks", size=(10, 5), measured=False)
def draw_tracks(figure: Figure, run: Run[Config]) -> None:
    """Draw the robots' tracks in a lap that was completed (Fig. 17) and one that failed (Fig. 18)."""
    titles = {}
    for name, values in run.metadata("examples").items():
        lap = SimpleNamespace(**values)
        ending = ending_text(End(lap.end), lap.robot, lap.ended_s)
        titles[name] = f"{setting_text(lap)}: {ending}"
    draw_laps(figure, run["track"], titles)
    figure.suptitle("The first lap that is completed, and the first that fails")
    note(
        figure,
        "simulated; +: start, disc: end; the hallways of the three robots are drawn as one\n"
        "OPT+LC: balanced QoS and local cache, none: no method",
    )


def draw_laps(figure: Figure, tracks: pd.DataFrame, titles: dict[str, str]) -> None:
    """Draw the tracks of laps side by side, with their titles by the laps' names."""
    panels = figure.subplots(1, max(1, len(titles)), squeeze=False)[0]
    for axes, (name, title) in zip(panels, titles.items(), strict=False):
        draw_lap(axes, tracks[tracks["run"] == name])
        axes.set_title(title, fontsize=9)
    panels[0].legend(
        fontsize=8,
        title="track and boxes of",
        title_fontsize=8,
        loc="center",
        bbox_to_anchor=(1.5, 2.2),
        bbox_transform=panels[0].transData,
    )


def draw_lap(axes: Axes, tracks: pd.DataFrame) -> None:
    """Draw the tracks of a lap into one hallway, with each robot's track and boxes in the robot's colour."""
    from matplotlib.patches import Circle

    for ring in Area(robot="walls").rings:
        axes.fill(*ring.T, fill=False, linewidth=1.3)
    axes.plot(*HOME[:2], "+", color="black", markersize=9)
    for area in AREAS:
        color = ROBOT_COLORS[area.robot]
        for box in area.boxes:
            axes.fill(*box.corners().T, color=color, alpha=0.6)
        own = tracks[tracks["robot"] == area.robot]
        axes.plot(own["x_m"], own["y_m"], color=color, linewidth=1.2, label=area.robot)
        end = own[["x_m", "y_m"]].iloc[-1]
        axes.add_patch(Circle(tuple(end), RADIUS_M, color=color, alpha=0.7))
    axes.set(aspect="equal", xlabel="x (m)", ylabel="y (m)")
    axes.grid(visible=False)


# --- The live lap -----------------------------------------------------------------------------


def _has_live_lap(run: Run[Config]) -> bool:
    return bool((run["track"]["run"] == LIVE).any())


@exp.figure("cooperation_live", size=(10, 5), when=_has_live_lap)
def draw_live(figure: Figure, run: Run[Config]) -> None:
    """Draw the robots' tracks in the live lap, and in the simulated one beside it."""
    values = run.metadata("live")
    titles = {LIVE: f"live: {values['end']}", SIMULATED: f"simulated: {values['simulated_end']}"}
    draw_laps(figure, run["track"], titles)
    schedule = "kept its schedule" if values["kept_up"] else "did not keep its schedule"
    figure.suptitle(
        f"One lap over Cyclone DDS with {setting_text(LIVE_SETTINGS)}, live and simulated"
    )
    note(
        figure,
        f"the live lap {schedule} and lasted {values['lasted_s']:.0f} s; +: start, disc: end; B-COOP is about Fast DDS",
    )
