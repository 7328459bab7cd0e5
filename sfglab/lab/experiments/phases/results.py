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
    criterion,
    exp,
    plausible,
)
from sfglab.lab.figures import note
from sfglab.lab.runs import COMPLETION, Run, derived, lines_of
from sfglab.lab.stats import Estimate, bootstrap, difference_of, share_of
from sfglab.rtps import PRESETS
from sfglab.units import NS_PER_S

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from sfglab.lab.explore import Pressed

LEAST_SEEDS = 6  #: Number of seeds that the criteria require.
MOST_RATES = (
    3 / 4
)  #: Share of the simulated Rmax, three of the criterion's four, at which OPT+LC has to be lowest.
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

QUEUES = {
    "block": "a full queue blocks",
    "tail": "a full queue drops the newest",
    "head": "a full queue drops the oldest",
}
"""Texts for the rules of a host's full queue."""
ANSWERS = {
    "loss_lowest": "OPT+LC: loss at most 1 point above the lowest",
    "loss_small": "no method: a DEPTH up to 10 loses more",
    "latency_lowest": "OPT+LC: latency at most 5 % above the lowest",
    "latency_small": "no method: a DEPTH up to 10 is later",
    "completed": "OPT+LC: laps completed",
    "completed_none": "no method: laps completed",
}
"""Statements about each condition, by the column of the answers; an answer is a share from 0, no, to 1, yes."""


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
    found["loss_finite"] = True
    lowest_ms = table[none & depth.notna()].groupby(PLACE)["p50_ms"].min()
    found["latency_finite"] = np.isfinite(lowest_ms)
    return found.assign(age_ms=best["age_ms"], age_lowest_ms=lowest["age_ms"]).reset_index()


@derived
def phases(run: Run[Config]) -> pd.DataFrame:
    """Return the answers in the conditions of a run."""
    return answers(run["cell"], run["course"])


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
            f"{BEST} is lowest in {lowest} of {count} conditions (compared with no method, CC and OPT+CC), "
            f"and a small depth is worse than a deep one in {small} of {count}"
        )
        undecidable = count - part["finite"].sum()
        if undecidable:
            counts += (
                f"; the latter cannot be decided in {undecidable}, because without a method most messages never "
                "arrive at any depth"
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
    reasons = [f"with the simulated timing of {PRESETS[mode].name}, {lowest.reason}"]
    for other in (name for name in findings if name != mode):
        value = findings[other].estimate
        reasons.append(f"with the timing of {PRESETS[other].name}, the value is {value.value:.3g}")
    reason = f"{'; '.join(reasons)}. The lowest value counts ({_MAP})"
    return Finding(estimate=lowest.estimate, details=details, reason=reason, by_criterion=True)


def agreement(table: pd.DataFrame, of: str) -> pd.DataFrame:
    """Return where the criterion of B-LAT (``latency``) or B-LOSS (``loss``) holds.

    Returns:
        One row per condition, with the columns of `PLACE` except Rmax and these columns:

        - ``lowest``: OPT+LC is lowest at three quarters of the Rmax or more.
        - ``small``: a small depth is worse than a deep one at 500 or 1000 Hz.
        - ``finite``: some depth without a method has a finite median at 500 or 1000 Hz.
        - ``agrees``: ``lowest`` and ``small`` hold.
    """
    fast = table[table["rate_max_hz"].isin(FAST_HZ)]
    lowest = table.groupby(_CONDITION, sort=False)[f"{of}_lowest"].mean() >= MOST_RATES
    small = fast.groupby(_CONDITION, sort=False)[f"{of}_small"].any()
    finite = fast.groupby(_CONDITION, sort=False)[f"{of}_finite"].any()
    found = pd.DataFrame({"lowest": lowest, "small": small, "finite": finite})
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
        reason = (
            f"{BEST} completes {by_loss(best)}: Eq. 6 gives a deep history, with which a reader can request "
            f"a lost message only after the next heartbeat, up to {PRESETS[mode].heartbeat_ns / NS_PER_S:g} s later"
        )
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
    means = lines_of(laps.groupby("loss")["done"].mean().reset_index())
    texts = [f"{100 * row.done:.0f} % of laps at {100 * row.loss:.2g} % loss" for row in means]
    return ", ".join(texts)


# --- Map --------------------------------------------------------------------------------------

_COLUMN = ["queue_rule", "preset", "loss", "frame_us"]
_WIDTH, _ROW_HEIGHT = 10.5, 2.5
_LIGHT = 0.45  #: Share from which the colour of a cell is light, so that its text is black.


@derived
def mapped(run: Run[Config]) -> pd.DataFrame:
    """Return the mean outcomes over Rmax in the conditions without stalls."""
    table = phases(run)
    without_stalls = table[table["stall_ms"] == 0].groupby(_COLUMN, sort=False)
    return without_stalls[list(ANSWERS)].mean().reset_index()


@derived
def in_conditions(run: Run[Config]) -> pd.DataFrame:
    """Return the answers in each plausible condition, or in all conditions of a run without the criterion."""
    table = phases(run)
    if run.config.criterion:
        table = table.merge(pd.DataFrame(plausible(), columns=PLACE), on=PLACE)
    found = table.groupby(_CONDITION, sort=False)[["completed", "completed_none"]].mean()
    for of in ("loss", "latency"):
        halves = agreement(table, of).set_index(_CONDITION)
        found[f"{of}_lowest"] = halves["lowest"]
        found[f"{of}_small"] = halves["small"]
    return found.reset_index()


@exp.figure("phases", size=(_WIDTH, 6.4))
def draw_map(figure: Figure, run: Run[Config]) -> None:
    """Draw in how many conditions paper B's statements hold: one column per frame loss and airtime, one panel per timing."""
    groups = list(in_conditions(run).groupby(["queue_rule", "preset"], sort=False))
    figure.set_size_inches(_WIDTH, _ROW_HEIGHT * len(groups) + 1.4)
    panels = figure.subplots(len(groups), squeeze=False)[:, 0]
    for axes, ((rule, preset), part) in zip(panels, groups, strict=True):
        cells = part.groupby(["loss", "frame_us"])
        texts = [texts_of(cell) for _, cell in cells]
        draw_answers(axes, cells[list(ANSWERS)].mean().reset_index(), texts)
        for y, text in enumerate(texts_of(part)):
            axes.text(len(texts) + 0.1, y + 0.5, text, va="center", fontsize=8, weight="bold")
        name = PRESETS[str(preset)].name
        axes.set_title(f"timing of {name}; {QUEUES[str(rule)]}", fontsize=9)
    figure.suptitle(_title(run))
    note(
        figure,
        f"simulated, {run.config.seeds} seeds; number of conditions in which the statement holds, or share of laps; "
        "bold: all columns; yellow: all, dark blue: none\n"
        "OPT: balanced QoS, LC: local cache; conditions of one column differ in the length of channel stalls",
    )


def texts_of(found: pd.DataFrame) -> list[str]:
    """Return for each statement the number of conditions in which it holds, or the share of laps completed."""
    texts = []
    for answer in ANSWERS:
        if answer.startswith("completed"):
            texts.append(f"{100 * found[answer].mean():.0f} %")
        else:
            texts.append(f"{found[answer].sum()} of {len(found)}")
    return texts


def draw_answers(axes: Axes, columns: pd.DataFrame, texts: Sequence[Sequence[str]]) -> None:
    """Draw one row per statement and one column per frame loss and airtime: yellow is yes, dark blue is no.

    Args:
        axes: Axes to draw into.
        columns: Frame loss, airtime and answers of each column.
        texts: Texts of the cells of each column.
    """
    shares = columns[list(ANSWERS)].to_numpy(dtype=np.float64)
    axes.pcolormesh(shares.T, cmap="cividis", vmin=0, vmax=1, edgecolors="white")
    for (x, y), share in np.ndenumerate(shares):
        color = "black" if share > _LIGHT else "white"
        axes.text(x + 0.5, y + 0.5, texts[x][y], ha="center", va="center", fontsize=8, color=color)
    ticks = [f"{100 * row.loss:.2g} %\n{row.frame_us:.0f} µs" for row in lines_of(columns)]
    axes.set_xticks(np.arange(len(ticks)) + 0.5, ticks, fontsize=8)
    axes.set_yticks(np.arange(len(ANSWERS)) + 0.5, ANSWERS.values(), fontsize=8)
    axes.set_xlabel("frame loss and airtime of a frame, on each hop", fontsize=8)
    for x in np.flatnonzero(np.diff(columns["loss"])) + 1:
        axes.axvline(float(x), color="white", linewidth=5)
    axes.invert_yaxis()
    axes.grid(visible=False)


def _title(run: Run[Config]) -> str:
    """Return how many plausible conditions agree, as the title of the map."""
    found = [finding(run) for finding in (loss_order, latency_order, laps_completed)]
    lost, late, more = (one.estimate.value if one else np.nan for one in found)
    if np.isnan(lost):
        return "Answers about paper B's conclusions, by condition"
    places = pd.DataFrame(plausible(), columns=PLACE)
    count = len(places.drop_duplicates(["loss", "frame_us", "stall_ms"]))
    return (
        f"By the timing that counts, {lost * count:.0f} of {count} plausible conditions agree with paper B in loss, and "
        f"{late * count:.0f} in latency;\nOPT+LC completes {100 * more:.0f} percentage points more laps than no method"
    )


def press_map(run: Run[Config], preset: str = "fast_dds_foxy") -> Pressed:
    """Return the map of one middleware; a click on a condition prints the condition's cells and command.

    Raises:
        MissingExtraError: The extra ``view`` is not installed.
    """
    from sfglab.lab.explore import Pressed, part
    from sfglab.view.widgets import widgets

    table = mapped(run).query("preset == @preset").sort_values(["loss", "frame_us"])
    rows = {str(row.Index): row for row in lines_of(table)}
    texts = [[f"{100 * getattr(row, answer):.0f} %" for answer in ANSWERS] for row in rows.values()]
    printed = widgets().HTML("<p>Click a column to print its cells.</p>")

    class ConditionMap(Pressed):
        """Conditions without stalls of one middleware: share of the Rmax, or of laps, with six statements; to click."""

        def draw(self, figure: Figure) -> None:
            axes = figure.subplots()
            draw_answers(axes, table, texts)
            axes.set_title(
                f"timing of {PRESETS[preset].name}: share of the Rmax, or of laps", fontsize=9
            )
            for x, name in enumerate(rows):
                # The column is nearly invisible, because the mouse needs an area.
                part(name, axes.axvspan(x, x + 1, alpha=0.02))

        def titles(self) -> dict[str, str]:
            found = {}
            for name, row in rows.items():
                lines = [
                    f"{100 * getattr(row, key):.0f} %: {text}" for key, text in ANSWERS.items()
                ]
                found[name] = "\n".join(lines)
            return found

        def take(self, name: str) -> None:
            cells = cells_at(run, rows[name]).to_html(float_format="{:.3g}".format)
            printed.value = f"<pre>{escape(command_of(run, rows[name]))}</pre>{cells}"

    return ConditionMap((_WIDTH, 3.0), [printed])


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
