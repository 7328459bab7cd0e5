"""Verdicts on B-LAT, B-LOSS and B-COOP by their criteria, from runs that have all that the criteria ask for.

Asked is a finished run with every plausible condition of every mode at every Rmax, with six seeds or more; from
any other there is no finding. Of the modes that may stand for the paper's middleware, the lowest figure judges.
"""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from sfglab.arp.hallway import End
from sfglab.arp.hello import BEST
from sfglab.lab.claims import Finding, How
from sfglab.lab.experiments.phases.answers import (
    ANSWERS,
    PLACE,
    answers,
    criterion,
    plausible,
)
from sfglab.lab.experiments.phases.experiment import CELLS, COURSES, Config, exp
from sfglab.lab.figures import note
from sfglab.lab.runs import COMPLETION, Run, derived
from sfglab.lab.stats import Estimate, difference_of, share_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

LEAST_SEEDS = 6  #: With how many seeds the criteria want each condition.
MOST_RATES = 3  #: At how many of the four Rmax OPT+LC has to be lowest.
FAST_HZ = (500, 1000)  #: Rmax at which a small depth has to be worse than a deep one, at either.
_CONDITION = [name for name in PLACE if name != "rate_max_hz"]
_ROBOT2 = "robot2"


@derived
def phases(run: Run[Config]) -> pd.DataFrame:
    """Return the answers of a run's conditions."""
    return answers(run["cell"], run["course"])


@derived
def shares(run: Run[Config]) -> pd.DataFrame:
    """Return the share of conditions, by preset and queue, with each answer: of all, and inside the region."""
    table = phases(run)
    inside = np.all(
        [table[name].between(*bounds) for name, bounds in criterion().region.items()], axis=0
    )
    keys, columns = ["preset", "queue_rule"], list(ANSWERS)
    parts = {"all": table, "region": table[inside]}
    found = [
        part.groupby(keys, sort=False)[columns].mean().assign(of=name)
        for name, part in parts.items()
    ]
    counts = [part.groupby(keys, sort=False).size() for part in parts.values()]
    return pd.concat(found).assign(conditions=pd.concat(counts).to_numpy()).reset_index()


@derived
def judged(run: Run[Config]) -> tuple[pd.DataFrame, pd.DataFrame] | None:
    """Return both tables of a run in the plausible conditions alone; None if the run has not all of them."""
    places = pd.DataFrame(plausible(), columns=PLACE)
    tables = run["cell"].merge(places, on=PLACE), run["course"].merge(places, on=PLACE)
    wanted = (len(CELLS), LEAST_SEEDS), (len(COURSES), run.config.course_seeds)
    for table, (lines, seeds) in zip(tables, wanted, strict=True):
        counts = table.groupby([*PLACE, "method", "depth"])["seed"].nunique()
        if len(counts) < lines * len(places) or counts.min() < seeds:
            return None
    return tables if run.metadata(COMPLETION) else None


def agreement(table: pd.DataFrame, of: str) -> pd.DataFrame:
    """Return where the criterion of B-LAT (``latency``) or B-LOSS (``loss``) holds, a line a condition.

    Returns:
        The columns of `PLACE` but Rmax; ``lowest`` (OPT+LC, at three Rmax or more), ``small`` (a small depth
        is worse than a deep one, at 500 or 1000 Hz), and ``agrees``: both.
    """
    lowest = table.groupby(_CONDITION, sort=False)[f"{of}_lowest"].sum() >= MOST_RATES
    small = (
        table[table["rate_max_hz"].isin(FAST_HZ)]
        .groupby(_CONDITION, sort=False)[f"{of}_small"]
        .any()
    )
    found = pd.DataFrame({"lowest": lowest, "small": small})
    return found.assign(agrees=found["lowest"] & found["small"]).reset_index()


def _agreement_finding(run: Run[Config], *, of: str) -> Finding | None:
    """Return in what share of the plausible conditions the criterion of B-LAT or B-LOSS holds."""
    if (tables := judged(run)) is None:
        return None
    table = run.once("plausible", lambda: answers(*tables))
    found = agreement(table, of)
    figures: dict[str, Estimate] = {}
    details: dict[str, str] = {}
    for mode in criterion().modes:
        part = found[found["preset"] == mode]
        figures[mode] = share_of(
            int(part["agrees"].sum()), len(part), unit="share of plausible conditions"
        )
        fast = table[(table["preset"] == mode) & table["rate_max_hz"].isin(FAST_HZ)]
        without = int(fast.groupby(_CONDITION)["no_median"].all().sum())
        ages = table[table["preset"] == mode][["age_ms", "age_lowest_ms"]].median()
        details |= {
            f"{mode}, agree": f"{figures[mode]}: {part['agrees'].sum()} of {len(part)}",
            f"{mode}, {BEST} lowest": f"in {part['lowest'].sum()} of {len(part)}",
            f"{mode}, a small depth worse": f"in {part['small'].sum()} of {len(part)}",
            f"{mode}, no median at any depth": f"in {without} of {len(part)} (none, 500 and 1000 Hz)",
            f"{mode}, age at the station": f"{BEST} {ages.iloc[0]:.3g} ms, lowest other {ages.iloc[1]:.3g} ms",
        }
    mode = min(figures, key=lambda name: figures[name].value)
    halves = [
        f"{what} {details[f'{mode}, {what}']}" for what in (f"{BEST} lowest", "a small depth worse")
    ]
    if of == "latency":  # as many are lost there that a small depth cannot be later than a deep one
        halves.append(f"no median at any depth {details[f'{mode}, no median at any depth']}")
    where = _where(found[found["preset"] == mode], "agrees")
    reason = f"as {mode}, {'; '.join(halves)}; agree {where} (map: figure phases, notebook 19)"
    return Finding(estimate=figures[mode], details=details, reason=reason, by_criterion=True)


exp.claim("B-LAT", how=How.SIMULATED)(partial(_agreement_finding, of="latency"))
exp.claim("B-LOSS", how=How.SIMULATED)(partial(_agreement_finding, of="loss"))


def _where(table: pd.DataFrame, column: str) -> str:
    """Say by each axis of the region where something holds: the map in words."""
    said = []
    for axis in criterion().region:
        by = table.groupby(axis)[column].mean()
        said.append(
            f"by {axis} " + ", ".join(f"{value:g}: {share:.0%}" for value, share in by.items())
        )
    return "; ".join(said)


@exp.claim("B-COOP", how=How.SIMULATED)
def cooperation_verdict(run: Run[Config]) -> Finding | None:
    """Return by how much OPT+LC completes the hallway more often than no method, over plausible conditions.

    All have as many rounds, so that a share over all is the mean that the criterion asks for.
    """
    if (tables := judged(run)) is None:
        return None
    courses = tables[1].assign(done=tables[1]["end"] == End.SUCCESS.value)
    figures: dict[str, Estimate] = {}
    details: dict[str, str] = {}
    for mode in criterion().modes:
        part = courses[courses["preset"] == mode]
        best, none = (part[part["method"] == method] for method in (BEST, "none"))
        rates = [
            share_of(int(one["done"].sum()), len(one), unit="success rate") for one in (best, none)
        ]
        figures[mode] = difference_of(*rates, unit="success rate difference")
        met = none["end"].isin([End.STOP.value, End.CONTACT.value])
        second = met & (none["robot"] == _ROBOT2)
        details |= {
            f"{mode}, {BEST} less none": f"{rates[0]} less {rates[1]}: {figures[mode]}",
            f"{mode}, none: who meets an obstacle": f"{_ROBOT2} in {second.sum()}, anyone in {met.sum()}, "
            f"nobody (given up) in {(none['end'] == End.TIMEOUT.value).sum()} of {len(none)} rounds",
        }
    mode = min(figures, key=lambda name: figures[name].value)
    best = courses[(courses["preset"] == mode) & (courses["method"] == BEST)]
    reason = f"as {mode}, {BEST} completes {_where(best, 'done')} (map: figure phases, notebook 19)"
    return Finding(estimate=figures[mode], details=details, reason=reason, by_criterion=True)


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
    inside = table.merge(pd.DataFrame(plausible(), columns=PLACE))[[*ANSWERS]].mean()
    for axes, last, answer in zip(panels[0], panels[-1], ANSWERS, strict=True):
        share = "" if np.isnan(inside[answer]) else f"\n(in the box: {inside[answer]:.0%})"
        axes.set_title(ANSWERS[answer] + share, fontsize=9)
        last.set_xlabel("cost of a frame (us)", fontsize=8)
    figure.colorbar(
        image, ax=panels, shrink=0.6, label="left: agreement with the paper, right: share of laps"
    )
    rates = ", ".join(map(str, sorted(table["rate_max_hz"].unique())))
    shares = inside.map("{:.0%}".format)
    figure.suptitle(
        f"Plausible conditions (box): OPT+LC completes {shares['completed']} of the laps, "
        f"no method {shares['completed_none']}"
    )
    how = f"simulated, {run.config.seeds} seeds, Rmax {rates} Hz, no stalls; a dot is a condition"
    note(
        figure,
        f"{how}, its colour reaches to the next; shares are of {' and '.join(criterion().modes)}",
    )
    return {"answers": pd.concat([part for _, part in rows]), "inside": inside.to_dict()}


def _draw_map(axes: Axes, table: pd.DataFrame, answer: str) -> Any:
    """Draw an answer: each place has the colour of the condition that is nearest to it, a dot."""
    from matplotlib.patches import Rectangle

    spots = np.log10(table[["frame_us", "loss"]].to_numpy())
    (left, bottom), (right, top) = spots.min(axis=0) - 0.15, spots.max(axis=0) + 0.15
    x, y = np.linspace(left, right, 120), np.linspace(bottom, top, 120)
    places = np.stack(np.meshgrid(x, y), axis=-1)[:, :, None]
    nearest = (((places - spots) / (right - left, top - bottom)) ** 2).sum(axis=-1).argmin(axis=-1)
    colors = table[answer].to_numpy(float)[nearest]
    image = axes.pcolormesh(
        10**x, 100 * 10**y, colors, vmin=0, vmax=1, cmap="cividis", rasterized=True
    )
    axes.plot(
        table["frame_us"], 100 * table["loss"], "o", color="white", mec="black", markersize=3.5
    )
    (low, high), (least, most) = (criterion().region[name] for name in ("loss", "frame_us"))
    for look in (
        {"edgecolor": "black", "linewidth": 2.6},
        {"edgecolor": "white", "linestyle": ":"},
    ):
        axes.add_patch(
            Rectangle((least, 100 * low), most - least, 100 * (high - low), fill=False, **look)
        )
    axes.set(xscale="log", yscale="log")
    axes.grid(visible=False)
    return image
