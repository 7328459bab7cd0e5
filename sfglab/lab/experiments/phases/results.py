"""The module `phases.results` has the answers in each condition, the verdicts on B-LAT, B-LOSS and B-COOP, and the map.

If the criteria (``data/claims.yaml``) leave a choice, the module reads the criteria literally. The median is over the
"Hello"s of all seeds. A "Hello" that never arrives has an infinite latency. A condition in which the median of OPT+LC
is infinite does not agree. Intervals reach from the lowest seed's median to the highest seed's median; with six seeds
such an interval contains the median with 97 % probability.

The module judges only a finished run that has every plausible condition of every mode at every Rmax, with
six seeds or more. Of the modes that can stand for the paper's middleware, the mode with the lowest value counts.
"""

from __future__ import annotations

import shlex
from html import escape
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from sfglab.arp.hallway import End
from sfglab.arp.hello import OPT_DEPTH, SMALL_DEPTH, TIE
from sfglab.arp.robots import BEST
from sfglab.lab.claims import Finding, How
from sfglab.lab.experiments.phases.experiment import (
    CELLS,
    LAPS,
    PLACE,
    Config,
    conditions,
    criterion,
    exp,
    plausible,
)
from sfglab.lab.figures import note
from sfglab.lab.runs import COMPLETION, Run, derived, lines_of
from sfglab.lab.stats import Estimate, bootstrap, difference_of, share_of
from sfglab.rtps import PRESETS

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from sfglab.lab.explore import Pressed

LEAST_SEEDS = 6  #: Number of seeds that the criteria require.
MOST_RATES = 3  #: Number of the four Rmax at which OPT+LC has to be lowest.
_MAP = "figure phases, notebook 22"
FAST_HZ = (
    500,
    1000,
)  #: Values of Rmax; at one of these values a small depth has to be worse than a deep one.
DEEP = 100  #: Lowest depth that counts as deep by the criteria.
#: Share of messages by which OPT+LC's loss may exceed the lowest loss and still agree.
LOSS_POINT = 0.01
_CONDITION = [name for name in PLACE if name != "rate_max_hz"]
_CELL = [*PLACE, "method", "depth"]
_ROBOT2 = "robot2"


# --- Answers ----------------------------------------------------------------------------------

ANSWERS = {
    "latency_lowest": "OPT+LC:\nlatency at most\n5 % above the\nlowest other?",
    "loss_lowest": "OPT+LC:\nloss at most\n1 point above the\nlowest other?",
    "latency_small": "No method:\nhigher latency with\nsome DEPTH ≤ 10 than\nwith some ≥ 100?",
    "loss_small": "No method:\nhigher loss with\nsome DEPTH ≤ 10 than\nwith some ≥ 100?",
    "completed": "OPT+LC:\nrobots complete the\nlap in the hallway?",
    "completed_none": "No method:\nrobots complete the\nlap in the hallway?",
}
"""Questions about each condition, by the column of the answers; an answer is a share from 0, no, to 1, yes."""


def summary(cells: pd.DataFrame) -> pd.DataFrame:
    """Return latency, loss and age of each condition, method and depth.

    The column ``p50_ms`` is the median of all seeds' "Hello"s together; ``p50_ms_low`` and ``p50_ms_high`` are the
    range of the seeds' medians. The column ``lost`` is the lost share of all seeds with Wilson's interval; ``age_ms``
    is the median of the seeds' ``age_ms``.
    """
    grouped = cells.groupby(_CELL, sort=False)
    table = grouped.agg(
        p50_ms=("pooled_ms", "first"),
        p50_ms_low=("p50_ms", "min"),
        p50_ms_high=("p50_ms", "max"),
        age_ms=("age_ms", "median"),
        published=("published", "sum"),
        arrived=("arrived", "sum"),
    )
    lost = []
    for row in lines_of(table):
        share = share_of(row.published - row.arrived, row.published, unit="1")
        lost.append((share.value, share.low, share.high))
    table[["lost", "lost_low", "lost_high"]] = lost
    return table.drop(columns=["published", "arrived"]).reset_index()


def answers(cells: pd.DataFrame, laps: pd.DataFrame) -> pd.DataFrame:
    """Return whether the paper's statements hold in each condition at each Rmax.

    The result has the columns of `PLACE` and of `ANSWERS`, the age of OPT+LC (``age_ms``), and the
    lowest age of the other methods (``age_lowest_ms``).
    """
    found = _compared(summary(cells))
    done = (laps["end"] == End.SUCCESS.value).astype(float)
    is_best = laps["method"] == BEST
    table = laps.assign(completed=done.where(is_best), completed_none=done.mask(is_best))
    shares = table.groupby(PLACE)[["completed", "completed_none"]].mean()
    return found.merge(shares.reset_index(), on=PLACE)


def _compared(table: pd.DataFrame) -> pd.DataFrame:
    """Return the answers of B-LAT and B-LOSS from a `summary`."""
    depth = pd.to_numeric(table["depth"], errors="coerce")
    is_best = (table["method"] == BEST) & (table["depth"] == OPT_DEPTH)
    none = table["method"] == "none"
    best = table[is_best].set_index(PLACE)
    lowest = table[~is_best].groupby(PLACE, sort=False)[["p50_ms", "lost", "age_ms"]].min()
    small = table[none & (depth <= SMALL_DEPTH)].groupby(PLACE)[["p50_ms_low", "lost_low"]].max()
    deep = table[none & (depth >= DEEP)].groupby(PLACE)[["p50_ms_high", "lost_high"]].min()
    near_ms = lowest["p50_ms"] * (1 + TIE)
    found = pd.DataFrame(index=best.index)
    found["latency_lowest"] = np.isfinite(best["p50_ms"]) & (best["p50_ms"] <= near_ms)
    found["loss_lowest"] = best["lost"] <= lowest["lost"] + LOSS_POINT
    found["latency_small"] = small["p50_ms_low"] > deep["p50_ms_high"]
    found["loss_small"] = small["lost_low"] > deep["lost_high"]
    return found.assign(age_ms=best["age_ms"], age_lowest_ms=lowest["age_ms"]).reset_index()


@derived
def phases(run: Run[Config]) -> pd.DataFrame:
    """Return the answers in the conditions of a run's configuration.

    Earlier logs have further conditions near borders between different answers.
    """
    table = answers(run["cell"], run["course"])
    asked = [[getattr(one, name) for name in PLACE] for one in conditions(run.config)]
    return table.merge(pd.DataFrame(asked, columns=PLACE), on=PLACE)


# --- Claims -----------------------------------------------------------------------------------


@derived
def judged(run: Run[Config]) -> tuple[pd.DataFrame, pd.DataFrame] | None:
    """Return the cells and laps of the plausible conditions; None if a cell or lap is missing."""
    places = pd.DataFrame(plausible(), columns=PLACE)
    tables = run["cell"].merge(places, on=PLACE), run["course"].merge(places, on=PLACE)
    wanted = (len(CELLS), LEAST_SEEDS), (len(LAPS), run.config.course_seeds)
    for table, (lines, seeds) in zip(tables, wanted, strict=True):
        counts = table.groupby(_CELL)["seed"].nunique()
        if len(counts) < lines * len(places) or counts.min() < seeds:
            return None
    return tables if run.metadata(COMPLETION) else None


@exp.claim("B-LAT", how=How.SIMULATED)
def latency_order(run: Run[Config]) -> Finding | None:
    """Return the share of plausible conditions that agree in latency."""
    return agreement_finding(run, "latency")


@exp.claim("B-LOSS", how=How.SIMULATED)
def loss_order(run: Run[Config]) -> Finding | None:
    """Return the share of plausible conditions that agree in loss."""
    return agreement_finding(run, "loss")


def agreement_finding(run: Run[Config], of: str) -> Finding | None:
    """Return the share of plausible conditions in which the criterion of B-LAT or B-LOSS holds.

    Args:
        run: The run.
        of: Quantity of the criterion: ``latency`` or ``loss``.
    """
    tables = judged(run)
    if tables is None:
        return None
    table = run.once("plausible", lambda: answers(*tables))
    found = agreement(table, of)
    findings = {}
    for mode in criterion().modes:
        part = found[found["preset"] == mode]
        count = len(part)
        agreeing, lowest, small = part[["agrees", "lowest", "small"]].sum()
        share = share_of(int(agreeing), count, unit="share of plausible conditions")
        counts = (
            f"{BEST} is lowest in {lowest} of {count} conditions, and a small depth is worse than a deep "
            f"one in {small} of {count}"
        )
        best_ms, other_ms = table[table["preset"] == mode][["age_ms", "age_lowest_ms"]].median()
        details = {
            "agree": f"{share}: {agreeing} of {count}; {counts}",
            "age at the station": f"{BEST} {best_ms:.3g} ms, lowest other {other_ms:.3g} ms",
        }
        findings[mode] = Finding(estimate=share, details=details, reason=counts)
    return lowest_of(findings)


def lowest_of(findings: Mapping[str, Finding]) -> Finding:
    """Return the finding of the mode with the lowest value, which is judged, with the details of all modes."""
    details = {}
    for mode, finding in findings.items():
        for name, text in finding.details.items():
            details[f"{mode}, {name}"] = text
    mode = min(findings, key=lambda mode: findings[mode].estimate.value)
    lowest = findings[mode]
    reason = f"with the simulated timing of {PRESETS[mode].name}, {lowest.reason} ({_MAP})"
    return Finding(estimate=lowest.estimate, details=details, reason=reason, by_criterion=True)


def agreement(table: pd.DataFrame, of: str) -> pd.DataFrame:
    """Return where the criterion of B-LAT (``latency``) or B-LOSS (``loss``) holds.

    Returns:
        One row per condition: the columns of `PLACE` except Rmax; ``lowest`` (OPT+LC is lowest at
        three Rmax or more), ``small`` (a small depth is worse than a deep one at 500 or 1000 Hz),
        and ``agrees`` (both conditions hold).
    """
    fast = table[table["rate_max_hz"].isin(FAST_HZ)]
    lowest = table.groupby(_CONDITION, sort=False)[f"{of}_lowest"].sum() >= MOST_RATES
    small = fast.groupby(_CONDITION, sort=False)[f"{of}_small"].any()
    found = pd.DataFrame({"lowest": lowest, "small": small})
    return found.assign(agrees=found["lowest"] & found["small"]).reset_index()


@exp.claim("B-COOP", how=How.SIMULATED)
def laps_completed(run: Run[Config]) -> Finding | None:
    """Return the success rate of OPT+LC minus the success rate without a method, over plausible conditions.

    All conditions have the same number of laps, so a share over all laps is the mean that the criterion requires.
    """
    tables = judged(run)
    if tables is None:
        return None
    laps = tables[1].assign(done=tables[1]["end"] == End.SUCCESS.value)
    findings = {}
    for mode in criterion().modes:
        part = laps[laps["preset"] == mode]
        best, none = (part[part["method"] == method] for method in (BEST, "none"))
        more, less = (
            share_of(int(of["done"].sum()), len(of), unit="success rate") for of in (best, none)
        )
        apart = difference_of(more, less, unit="success rate difference")
        details = {
            f"{BEST} less none": f"{more} less {less}: {apart}",
            "by conditions": f"{by_conditions(part)}: bootstrap of conditions, because laps of one "
            "condition are not independent",
            "none: ends of laps": obstacles(none),
        }
        reason = f"{BEST} completes {by_loss(best)}"
        findings[mode] = Finding(estimate=apart, details=details, reason=reason)
    return lowest_of(findings)


def by_conditions(laps: pd.DataFrame) -> Estimate:
    """Return how much more often laps are ``done`` with OPT+LC than without a method.

    Laps of one condition share the condition's channel, and laps of one seed share random numbers. The interval is that
    of a bootstrap that samples conditions, each with all of its laps, instead of laps.
    """
    rates = laps.pivot_table("done", index=_CONDITION, columns="method", aggfunc="mean")
    apart = (rates[BEST] - rates["none"]).to_numpy(dtype=np.float64)
    return bootstrap([apart], lambda drawn: float(drawn[0].mean()), unit="success rate difference")


def obstacles(laps: pd.DataFrame) -> str:
    """Return the number of laps by kind of end, and how many of these laps ended because of robot 2.

    A contact means that a robot touches a wall or a box. A stop means that a robot stops for a detected obstacle.
    """
    counts = laps["end"].value_counts()
    of_robot2 = laps[laps["robot"] == _ROBOT2]["end"].value_counts()
    texts = [f"{end} in {n} ({_ROBOT2} in {of_robot2.get(end, 0)})" for end, n in counts.items()]
    return f"{', '.join(texts)} of {len(laps)} laps"


def by_loss(laps: pd.DataFrame) -> str:
    """Return the share of laps that are ``done`` for each frame loss, as a text."""
    means = laps.groupby("loss")["done"].mean()
    return ", ".join(f"{share:.0%} of laps at {loss:.2%} loss" for loss, share in means.items())


# --- Map --------------------------------------------------------------------------------------

QUEUES = {
    "block": "a full queue blocks",
    "tail": "a full queue drops the newest",
    "head": "a full queue drops the oldest",
}
"""Texts for the rules of a host's full queue."""
_SQUARE: dict[str, Any] = {"marker": "s", "cmap": "cividis", "vmin": 0, "vmax": 1, "ec": "black"}
_WIDTH, _ROW_HEIGHT = 10.5, 2.2


@derived
def mapped(run: Run[Config]) -> pd.DataFrame:
    """Return the mean outcomes over Rmax in the conditions without stalls."""
    table = phases(run)
    keys = ["queue_rule", "preset", "loss", "frame_us"]
    without_stalls = table[table["stall_ms"] == 0].groupby(keys, sort=False)
    return without_stalls[list(ANSWERS)].mean().reset_index()


@exp.figure("phases", size=(_WIDTH, 9.6))
def draw_map(figure: Figure, run: Run[Config]) -> None:
    """Draw where the paper's conclusions hold: by airtime and loss of a frame, one row per middleware."""
    rows = list(mapped(run).groupby(["queue_rule", "preset"], sort=False))
    rules = sorted({str(rule) for (rule, _), _ in rows})
    figure.set_size_inches(_WIDTH, _ROW_HEIGHT * len(rows) + 1.4)
    grid = figure.subplots(len(rows), len(ANSWERS), sharex=True, sharey=True, squeeze=False)
    for panels, ((rule, preset), part) in zip(grid, rows, strict=True):
        name = PRESETS[str(preset)].name
        queue = f"{QUEUES[str(rule)]}\n" if len(rules) > 1 else ""
        panels[0].set_ylabel(f"{name}\n{queue}frame loss (%)", fontsize=8)
        squares = draw_row(panels, part)
    for top, bottom, question in zip(grid[0], grid[-1], ANSWERS.values(), strict=True):
        top.set_title(question, fontsize=8)
        bottom.set_xlabel("airtime of a frame (us)", fontsize=8)
    figure.colorbar(
        squares,
        ax=grid,
        shrink=0.5,
        aspect=40,
        label="share of the Rmax with answer yes (hallway: share of laps)",
    )
    figure.suptitle(_title(run))
    note(
        figure,
        f"simulated, {run.config.seeds} seeds; OPT: balanced QoS, LC: local cache; one square per condition "
        f"without channel stalls; {' or '.join(QUEUES[rule] for rule in rules)}\n"
        "grey: plausible conditions in the modes that the criteria judge; the title also counts those with "
        "stalls, by the mode with the lower result",
    )


def _title(run: Run[Config]) -> str:
    """Return how many plausible conditions agree, as the title of the map."""
    found = [finding(run) for finding in (loss_order, latency_order, laps_completed)]
    lost, late, more = (one.estimate.value if one else np.nan for one in found)
    if np.isnan(lost):
        return "Six answers about paper B's conclusions, by condition"
    places = pd.DataFrame(plausible(), columns=PLACE)
    count = len(places.drop_duplicates(["loss", "frame_us", "stall_ms"]))
    return (
        f"Plausible conditions that agree with paper B: loss {lost * count:.0f} of {count}, latency "
        f"{late * count:.0f} of {count}\nsuccess rate of laps with OPT+LC: {100 * more:.0f} percentage "
        "points above that without a method"
    )


def draw_row(panels: Sequence[Axes], table: pd.DataFrame) -> Any:
    """Draw the simulated conditions of one middleware, one panel per question, and return the last squares."""
    from matplotlib.patches import Rectangle

    asked = criterion()
    low, high = asked.region["loss"]
    least_us, most_us = asked.region["frame_us"]
    is_judged = table["preset"].isin(asked.modes).all()
    for axes, answer in zip(panels, ANSWERS, strict=True):
        size = (most_us - least_us, 100 * (high - low))
        if is_judged:
            axes.add_patch(Rectangle((least_us, 100 * low), *size, color="0.85", zorder=0))
        squares = axes.scatter(table["frame_us"], 100 * table["loss"], 36, table[answer], **_SQUARE)
        axes.set(xscale="log", yscale="log")
        axes.set_xticks([50, 200, 1000], ["50", "200", "1000"], fontsize=8)
        axes.set_yticks([0.01, 0.1, 1], ["0.01", "0.1", "1"])
        axes.minorticks_off()
    return squares


def press_map(run: Run[Config], preset: str = "fast_dds_foxy") -> Pressed:
    """Return the map of one middleware; a click on a condition prints the condition's cells and command.

    Raises:
        MissingExtraError: The extra ``view`` is not installed.
    """
    from sfglab.lab.explore import Pressed, part
    from sfglab.view.widgets import widgets

    table = mapped(run).query("preset == @preset")
    rows = {str(row.Index): row for row in lines_of(table)}
    printed = widgets().HTML(
        "<p>Yellow: yes; dark blue: no. Click a square to print its cells.</p>"
    )

    class ConditionMap(Pressed):
        """Simulated conditions of one middleware with the answers to six questions, to click."""

        def draw(self, figure: Figure) -> None:
            panels = figure.subplots(1, len(ANSWERS), sharey=True)
            draw_row(panels, table)
            panels[0].set_ylabel(f"{PRESETS[preset].name}\nframe loss (%)", fontsize=8)
            figure.supxlabel("airtime of a frame (us)", fontsize=8)
            for axes, question in zip(panels, ANSWERS.values(), strict=True):
                axes.set_title(question, fontsize=8)
                for name, row in rows.items():
                    # The square is nearly invisible, because the mouse needs an area.
                    part(name, *axes.plot(row.frame_us, 100 * row.loss, "s", ms=9, alpha=0.02))

        def take(self, name: str) -> None:
            cells = cells_at(run, rows[name]).to_html(float_format="{:.3g}".format)
            printed.value = f"<pre>{escape(command_of(run, rows[name]))}</pre>{cells}"

    return ConditionMap((_WIDTH, 3.2), [printed])


def cells_at(run: Run[Config], place: Any) -> pd.DataFrame:
    """Return latency and loss in the condition of one row of `mapped`, by method, depth and Rmax."""
    cells = run["cell"][run["cell"]["stall_ms"] == 0]
    for name in ("preset", "queue_rule", "loss", "frame_us"):
        cells = cells[cells[name] == getattr(place, name)]
    table = summary(cells).rename(columns={"p50_ms": "median latency (ms)", "lost": "loss"})
    return table.pivot_table(
        index=["method", "depth"],
        columns="rate_max_hz",
        values=["median latency (ms)", "loss"],
        sort=False,
    )


def command_of(run: Run[Config], place: Any) -> str:
    """Return the command that simulates the condition of one row of `mapped` again."""
    rates = ", ".join(map(str, cells_at(run, place)["loss"].columns))
    words = [
        f"presets=[{place.preset}]",
        f"losses=[{place.loss}]",
        f"frames_us=[{place.frame_us}]",
        f"queue_rules=[{place.queue_rule}]",
        f"rates_hz=[{rates}]",
    ]
    return shlex.join(["sfglab", "try", "phases", *words, "criterion=false"])
