"""Claims, figures and the explorer of transmission: latency and loss of "Hello" over paper B's grid."""

from __future__ import annotations

from collections.abc import Iterator  # noqa: TC003 - an explorer's form reads the annotations
from concurrent.futures import ThreadPoolExecutor
from itertools import product
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
import pandas as pd

from sfglab.arp.hello import (
    OPT_DEPTH,
    SMALL_DEPTH,
    TIE,
    GridCell,
    rate_and_depth,
    scenario_of,
)
from sfglab.arp.robots import BEST, DEPTHS, METHODS, RATES_HZ
from sfglab.fields import Bounds
from sfglab.lab import pictures
from sfglab.lab.cells import failed_plays
from sfglab.lab.claims import Finding, How
from sfglab.lab.experiments.transmission.experiment import Config, exp, grid, simulate_cell
from sfglab.lab.experiments.transmission.live import (
    GRID,
    HELLO,
    HELLO_TO_STATION,
    SENSORS,
    live_cells,
)
from sfglab.lab.figures import COLORS, METHOD_COLORS, note, series
from sfglab.lab.live_flows import MODES
from sfglab.lab.paths import find_project
from sfglab.lab.runs import Run, derived, lines_of
from sfglab.lab.stats import exactly
from sfglab.qos import Durability, History, Liveliness, Reliability
from sfglab.rtps import PRESETS
from sfglab.units import NS_PER_S

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

LOSS_WITHIN = 0.03  #: Largest difference in loss that agrees.
LATENCY_WITHIN = 0.30  #: Largest difference in median latency that agrees, of the live one.
READ = {"fast_dds_foxy": "derived from its source code, not measured"}
"""Presets that cannot be validated, and their origin."""
SATURATED = 0.85  #: Least channel utilisation at which queues fill and lose messages.
SATURATED_LOSS = 0.1  #: Loss in the model from which a live cell counts as saturated.
_CELL = ["rate_max_hz", "depth", "method"]
_MEASURED = ["loss_live", "loss_model", "p50_live_ms", "p50_model_ms"]


# --- The grid ---------------------------------------------------------------------------------


@derived
def losses(run: Run[Config]) -> pd.DataFrame:
    """Return the table ``cell`` with the share of "Hello"s that never arrived, ``loss``."""
    return run["cell"].assign(loss=1 - run["cell"]["arrived"] / run["cell"]["published"])


@derived
def cells(run: Run[Config], column: str) -> pd.DataFrame:
    """Return median, lowest and highest over seeds of a column or of ``loss``, one row per cell."""
    return (
        losses(run).groupby(_CELL, sort=False)[column].agg(["median", "min", "max"]).reset_index()
    )


@derived
def order(run: Run[Config], column: str, *, tie: float = 0.0) -> pd.DataFrame:
    """Compare the paper's order of methods with the simulated one as `order_of` does, one row per Rmax.

    ``best_min`` and ``best_max`` are the winner's range over seeds.
    """
    rows = []
    for rate, part in cells(run, column).groupby("rate_max_hz"):
        row = {"rate_max_hz": rate, **order_of(part, tie=tie)}
        is_best = (part["method"] == BEST) & (part["depth"] == OPT_DEPTH)
        row["best_min"], row["best_max"] = part[is_best][["min", "max"]].iloc[0]
        rows.append(row)
    table = pd.DataFrame(rows)
    first = ["rate_max_hz", "best", "best_min", "best_max"]
    return table[[*first, *table.columns.difference(first, sort=False)]]


def order_of(table: pd.DataFrame, *, tie: float = 0.0) -> dict[str, Any]:
    """Compare the paper's order of methods with the simulated one at one Rmax.

    The paper's winner at the depth of Eq. 6 is compared with the methods without its optimisation, at every
    depth of Table 2, and with those without its local cache, at its own depth.

    Args:
        table: ``depth``, ``method`` and ``median`` of each cell.
        tie: Share within which another cell counts as equal.

    Returns:
        ``best`` (the winner's value), ``lowest`` (the lowest of the others), ``wins``; and
        ``highest_method``, ``highest_depth``, ``highest`` (the cell with the highest value) and
        ``small_is_worst``.
    """
    optimised = table["method"].map(lambda name: METHODS[name].optimised)
    cached = table["method"].map(lambda name: METHODS[name].local_cache)
    at_optimum = table["depth"] == OPT_DEPTH
    best = float(table[(table["method"] == BEST) & at_optimum]["median"].iloc[0])
    rivals = (~optimised & ~at_optimum) | (optimised & ~cached & at_optimum)
    lowest = table[rivals]["median"].min()
    worst = table.iloc[int(table["median"].argmax())]
    small = worst["depth"] != OPT_DEPTH and int(worst["depth"]) <= SMALL_DEPTH
    return {
        "best": best,
        "lowest": lowest,
        "wins": best <= lowest * (1 + tie),
        "highest_method": worst["method"],
        "highest_depth": worst["depth"],
        "highest": worst["median"],
        "small_is_worst": small and not METHODS[worst["method"]].optimised,
    }


@derived
def causes(run: Run[Config]) -> pd.DataFrame:
    """Return loss with its causes, means over seeds: without cache control, at DEPTH 10 and Eq. 6's.

    Per second of the cell: frames that full queues dropped, and retransmissions.
    """
    rows = losses(run)
    chosen = rows[rows["method"].isin(LABELS) & rows["depth"].isin(["10", OPT_DEPTH])]
    groups = chosen.groupby(_CELL, sort=False)
    means = groups[["loss", "air_share", "queue_full", "repeated"]].mean()
    table = pd.DataFrame(index=means.index)
    table["loss (%)"] = 100 * means["loss"]
    table["channel utilisation (%)"] = 100 * means["air_share"]
    table["dropped by full queues (frames/s)"] = means["queue_full"] / run.config.duration_s
    table["retransmissions (frames/s)"] = means["repeated"] / run.config.duration_s
    return table.reset_index().rename(columns={"rate_max_hz": "Rmax (Hz)", "depth": "DEPTH"})


# --- Claims -----------------------------------------------------------------------------------

_TOPICS = (8 + 5 + 5) / 3  # of the robots in section 3.1: their sensors, and two ways of "Hello"


def as_in_table_2(table: pd.DataFrame, duration_s: float) -> pd.Series[bool]:
    """Return whether rows of the grid have the rate and depth of Table 2, and published at that rate.

    The optimum is written from Eq. 3 to 6 and section 3.1, apart from the code that ran: R is
    Rmax / Tavg - Rmin, D is 5000 R / Rmax - Dmin, Rmin and Dmin 1.
    """
    optimum_hz = table["rate_max_hz"] / _TOPICS - 1
    optimum_depth = (5000 * optimum_hz / table["rate_max_hz"] - 1).astype(int)
    rate_hz = optimum_hz.where(table["method"].str.contains("OPT"), table["rate_max_hz"])
    depth = pd.to_numeric(table["depth"], errors="coerce").fillna(optimum_depth)
    has_rate = (table["rate_hz"] - rate_hz).abs() < 1e-6 * rate_hz
    has_count = (table["published"] - rate_hz * duration_s).abs() <= 1
    return has_rate & has_count & (table["history_depth"] == depth)


def policies(config: Config) -> dict[str, bool]:
    """Return whether every flow of every cell has the policies of Table 2; nothing is run."""
    flows = []
    for cell in grid(config):
        rate_hz, _ = rate_and_depth(cell)
        flows += [(flow.qos, rate_hz) for flow in scenario_of(cell).flows]
    return {
        "RELIABLE": all(qos.reliability is Reliability.RELIABLE for qos, _ in flows),
        "KEEP_LAST": all(qos.history is History.KEEP_LAST for qos, _ in flows),
        "VOLATILE": all(qos.durability is Durability.VOLATILE for qos, _ in flows),
        "AUTOMATIC": all(qos.liveliness is Liveliness.AUTOMATIC for qos, _ in flows),
        "DEADLINE is the rate": all(
            qos.deadline_ns == round(NS_PER_S / rate_hz) for qos, rate_hz in flows
        ),
    }


@exp.claim("B-TAB2", how=How.SIMULATED)
def share_of_grid(run: Run[Config]) -> Finding:
    """Return the share of the paper's grid that was run as in Table 2; none of it with other policies."""
    rows = run["cell"]
    right = rows.assign(right=as_in_table_2(rows, run.config.duration_s)).groupby(_CELL)["right"]
    is_right = right.all()
    depths = [*map(str, DEPTHS), OPT_DEPTH]
    asked = pd.MultiIndex.from_product([RATES_HZ, depths, METHODS])
    held = policies(run.config)
    share = float(is_right.reindex(asked, fill_value=False).mean()) if all(held.values()) else 0.0
    wrong = is_right.index[~is_right]
    details = {
        "cells": str(len(is_right)),
        "with another rate, depth or number of messages than Table 2's": str(len(wrong)),
        "policies of every flow": ", ".join(held),
        "seeds": str(rows["seed"].nunique()),
        "simulated seconds per cell": str(run.config.duration_s),
    }
    reasons = [f"not as in Table 2: {cell}" for cell in wrong[:3]]
    reasons += [f"policy: not {name}" for name, holds in held.items() if not holds]
    estimate = exactly(share, "share of the grid that was run as printed")
    return Finding(estimate=estimate, details=details, reason="; ".join(reasons))


@exp.claim("B-LAT", how=How.SIMULATED)
def latency_order(run: Run[Config]) -> Finding:
    """Return the share of rates at which latencies have the paper's order."""
    return order_finding(run, order(run, "latency_p50_ms", tie=TIE))


@exp.claim("B-LOSS", how=How.SIMULATED)
def loss_order(run: Run[Config]) -> Finding:
    """Return the share of rates at which losses have the paper's order."""
    return order_finding(run, order(run, "loss"))


def order_finding(run: Run[Config], table: pd.DataFrame) -> Finding:
    """Return the share of rates with the paper's order, from a table of `order`."""
    wins = f"{table['wins'].sum()} of {len(table)} rates"
    small = f"{table['small_is_worst'].sum()} of {len(table)} rates"
    highest = [
        f"{row.rate_max_hz} Hz: {row.highest_method}, depth {row.highest_depth}"
        for row in lines_of(table)
    ]
    worst = "; ".join(highest)
    reasons = []
    if not table["wins"].all():
        reasons.append(
            f"{BEST} is lowest at {wins}: histories as deep as Eq. 6's never fill, "
            "so that retransmissions wait for heartbeats, 3 s apart"
        )
    if not table["small_is_worst"].all():
        causes = _causes_of_deep(run, table[~table["small_is_worst"]])
        reasons.append(f"a small depth is highest at {small} ({worst}): {causes}")
    share = float((table["wins"] & table["small_is_worst"]).mean())
    return Finding(
        estimate=exactly(share, "share of rates with this order"),
        details={
            f"{BEST} is lowest": f"at {wins}",
            "full rate with a small depth is highest": f"at {small}",
            "highest": worst,
        },
        reason="; ".join(reasons),
    )


def _causes_of_deep(run: Run[Config], table: pd.DataFrame) -> str:
    """Return why a deep history has the highest value, by the channel utilisation of these cells."""
    used = cells(run, "air_share").set_index(_CELL)["median"]
    rates: dict[str, list[str]] = {}
    for row in lines_of(table):
        share = used[row.rate_max_hz, row.highest_depth, row.highest_method]
        cause = "on a saturated channel a deep history keeps old samples in front of new ones"
        if share < SATURATED:
            cause = "retransmissions behind a deep history wait for heartbeats, 3 s apart"
        rates.setdefault(cause, []).append(f"{row.rate_max_hz} Hz, {share:.0%} used")
    return "; ".join(f"{cause} ({'; '.join(places)})" for cause, places in rates.items())


# --- Figures of the grid ----------------------------------------------------------------------

LABELS = {
    "none": "no method",
    "LC": "local cache (LC)",
    "OPT": "balanced QoS (OPT)",
    "OPT+LC": "both (OPT+LC)",
}
"""Names of the methods without cache control."""
STYLES: dict[str, dict[str, Any]] = {
    "none": {"color": METHOD_COLORS["none"], "marker": "o", "linestyle": ":"},
    "LC": {"color": METHOD_COLORS["LC"], "marker": "D", "linestyle": "--"},
    "OPT": {"color": METHOD_COLORS["OPT"], "marker": "s", "linestyle": "-."},
    "OPT+LC": {"color": METHOD_COLORS["OPT+LC"], "marker": "^", "linestyle": "-"},
}
WITH_CONTROL = {"none": "CC", "LC": "", "OPT": "OPT+CC", "OPT+LC": "OPT+LC+CC"}
"""Methods with cache control besides, which Table 2 has not for the local cache alone."""


def draw_panels(panels: Any, table: pd.DataFrame, *, scale: float = 1.0) -> None:
    """Draw a table of `cells` over DEPTH, one panel per Rmax; bars reach from lowest to highest seed.

    Args:
        panels: Axes, shape (2, 2).
        table: The cells; of those in the column ``hollow`` the markers are.
        scale: Factor of the values.
    """
    depths = list(dict.fromkeys(table["depth"]))
    for axes, (rate, part) in zip(panels.flat, table.groupby("rate_max_hz"), strict=False):
        for place, (method, style) in enumerate(STYLES.items()):
            rows = part[part["method"] == method].set_index("depth").reindex(depths)
            values = scale * rows[["median", "min", "max"]].to_numpy(float).T
            at = np.arange(len(depths)) + 0.15 * (place - 1.5)
            spread = [values[0] - values[1], values[2] - values[0]]
            sizes: dict[str, Any] = {"markersize": 4.5, "elinewidth": 0.8, "linewidth": 1.2}
            axes.errorbar(at, values[0], yerr=spread, label=LABELS[method], **sizes, **style)
            hollow = rows["hollow"].eq(True).to_numpy()
            white = {**style, "linestyle": "", "markerfacecolor": "white", "markersize": 4.5}
            axes.plot(at[hollow], values[0, hollow], zorder=3, **white)
            controlled = part[part["method"] == WITH_CONTROL[method]].set_index("depth")
            crosses = scale * controlled["median"].reindex(depths)
            axes.plot(at + 0.07, crosses, "x", color=style["color"], markersize=4.5)
        axes.set_title(f"Rmax = {rate} Hz", fontsize=9)
        axes.set_xticks(range(len(depths)), depths, fontsize=8)
    for axes in panels[-1]:
        axes.set_xlabel("DEPTH (samples)")


def legend_of(axes: Axes, hollow: str) -> tuple[list[Any], list[str]]:
    """Return handles and labels of `draw_panels` with crosses and hollow markers."""
    handles, labels = axes.get_legend_handles_labels()
    handles += axes.plot([], [], "x", color="black", markersize=4.5)
    handles += axes.plot([], [], "o", color="black", markerfacecolor="white", markersize=4.5)
    return handles, [*labels, "with cache control (CC)", hollow]


def codes(run: Run[Config]) -> str:
    """Return the note of the grid's figures."""
    seeds = run["cell"]["seed"].nunique()
    return (
        "Rmax: publishing rate without OPT; DEPTH: depth of histories, opt: by Eq. 6; "
        f"medians over {seeds} seeds, bars: range"
    )


@exp.figure("transmission_latency", size=(10, 6.4), measured=False)
def draw_latency(figure: Figure, run: Run[Config]) -> None:
    """Draw Fig. 10: median latency of the "Hello"s that arrive over DEPTH, one panel per Rmax."""
    table = cells(run, "latency_p50_ms").assign(hollow=cells(run, "loss")["median"] > 0.5)
    panels = figure.subplots(2, 2, sharex=True, sharey=True)
    panels[0, 0].set_yscale("log")
    draw_panels(panels, table)
    figure.supylabel("median latency of messages that arrive (ms)", fontsize="medium")
    figure.legend(*legend_of(panels[0, 0], "fewer than half\narrived"), loc="outside right center")
    wins = order(run, "latency_p50_ms", tie=TIE)["wins"]
    figure.suptitle(
        f"OPT+LC has the lowest latency at {wins.sum()} of {len(wins)} Rmax (paper: at each Rmax)"
    )
    note(figure, codes(run))


@exp.figure("transmission_loss", size=(10, 6.4), measured=False)
def draw_loss(figure: Figure, run: Run[Config]) -> None:
    """Draw Fig. 11: loss of "Hello" over DEPTH, one panel per Rmax; right: over channel utilisation."""
    table = cells(run, "loss")
    table["hollow"] = table["depth"] == str(DEPTHS[-1])
    table["utilisation"] = cells(run, "air_share")["median"]
    subfigures: Any = figure.subfigures(1, 2, width_ratios=(2, 1.2))
    left, right = subfigures
    panels = left.subplots(2, 2, sharex=True, sharey=True)
    draw_panels(panels, table, scale=100)
    for axes in panels[:, 0]:
        axes.set_ylabel("packet loss (%)")
    cause = right.subplots()
    for (method, hollow), part in table.groupby(["method", "hollow"], sort=False):
        if method in STYLES:
            marks = {**STYLES[method], "linestyle": "", "markersize": 5}
            fill = {"markerfacecolor": "white"} if hollow else {"alpha": 0.7}
            cause.plot(100 * part["utilisation"], 100 * part["median"], **marks, **fill)
    cause.set(xlabel="channel utilisation (%)", ylabel="packet loss (%)", xlim=(0, 100))
    cause.set_title("without CC: loss begins where the channel is full", fontsize=9)
    last = f"DEPTH {DEPTHS[-1]}: messages in\nflight at the end are lost"
    cause.legend(*legend_of(panels[0, 0], last), loc="upper left", fontsize=8)
    wins = order(run, "loss")["wins"]
    figure.suptitle(
        f"OPT+LC loses the fewest messages at {wins.sum()} of {len(wins)} Rmax (paper: at each)"
    )
    note(figure, codes(run))


# --- Live cells beside the model --------------------------------------------------------------


def agreeing(table: pd.DataFrame) -> pd.DataFrame:
    """Return a table with ``loss_agrees`` and ``latency_agrees``: whether live and model do."""
    loss = (table["loss_live"] - table["loss_model"]).abs()
    late_ms = (table["p50_live_ms"] - table["p50_model_ms"]).abs()
    return table.assign(
        loss_agrees=loss <= LOSS_WITHIN,
        latency_agrees=late_ms <= LATENCY_WITHIN * table["p50_live_ms"],
    )


@derived
def agreement(run: Run[Config]) -> dict[str, str]:
    """Return how many live cells agree with the model in all flows, saturated ones apart.

    Counted are cells that kept their schedules. A cell is saturated if the model loses more than
    `SATURATED_LOSS` of a flow. ``failed`` are cells that could not be played.
    """
    live = run["live"]
    fair = agreeing(live[live["kept_up"].astype(bool)])
    table = fair.groupby(_CELL, sort=False).agg(
        loss=("loss_agrees", "all"),
        latency=("latency_agrees", "all"),
        loss_model=("loss_model", "max"),
    )
    is_full = table["loss_model"] > SATURATED_LOSS
    counts = {}
    for column, words in (("loss", "loss within 3 points"), ("latency", "latency within 30 %")):
        free, full = table[column][~is_full], table[column][is_full]
        text = f"{free.sum()} of {len(free)} cells"
        counts[words] = f"{text}, saturated {full.sum()} of {len(full)}"
    counts["failed"] = f"{len(failed_plays(run, 'live'))} of {len(live_cells(run.config))}"
    return counts


GROUP_STYLES: dict[str, dict[str, Any]] = {
    SENSORS: {"label": "sensors' topics", "color": COLORS["third"], "marker": "s"},
    HELLO_TO_STATION: {
        "label": '"Hello" to the station',
        "color": COLORS["proxy"],
        "marker": "^",
    },
    HELLO: {"label": '"Hello" to its actuation', "color": COLORS["standard"], "marker": "o"},
}


@exp.figure("transmission_live", size=(10, 5.4))
def draw_live(figure: Figure, run: Run[Config]) -> None:
    """Draw how far each live cell is from the model: loss left, median latency right."""
    live = run["live"]
    kept = live[live["kept_up"].astype(bool)]
    methods = kept["method"].map(lambda name: LABELS.get(name, name))
    rates = kept["rate_max_hz"].astype(str) + " Hz, DEPTH "
    places, rows = pd.factorize(methods + ", " + rates + kept["depth"])
    left, right = figure.subplots(1, 2, sharey=True)
    for shift, (group, style) in zip((-0.22, 0, 0.22), GROUP_STYLES.items(), strict=True):
        part = kept[kept["group"] == group]
        at = places[kept["group"] == group] + shift
        loss = 100 * (part["loss_live"] - part["loss_model"])
        left.plot(loss, at, linestyle="", markersize=5, **style)
        ratio = part["p50_live_ms"] / part["p50_model_ms"]
        right.plot(ratio, at, linestyle="", markersize=5, **style)
    bands = [(-100 * LOSS_WITHIN, 100 * LOSS_WITHIN)]
    bands.append((1 / (1 + LATENCY_WITHIN), 1 / (1 - LATENCY_WITHIN)))
    for axes, band in zip((left, right), bands, strict=True):
        axes.axvspan(*band, color="black", alpha=0.1, linewidth=0)
    left.set(xlabel="loss, live - model (percentage points)")
    left.set_yticks(range(len(rows)), rows, fontsize=8)
    left.set_ylim(max(len(rows), 1) - 0.5, -0.5)
    right.set(xlabel="median latency, live / model")
    right.legend(loc="lower right", fontsize=8)
    counts = agreement(run)
    failed = counts["failed"]
    lines = [f"{what}: {count}" for what, count in counts.items() if what != "failed"]
    said = "\n".join(lines) if len(live) else run.skipped("live")
    figure.suptitle(f"Live cells on Cyclone DDS that agree with the model\n{said}")
    late = live[~live["kept_up"].astype(bool)].drop_duplicates(_CELL)
    note(
        figure,
        f"{len(late)} cells late and left out, {failed} failed; grey: acceptance range; saturated: the "
        f"model loses more than {SATURATED_LOSS:.0%}",
    )


# --- Validation of the presets ----------------------------------------------------------------

KEYS = ["preset", "kind", "rate_hz", "depth", "size_bytes", "loss", "overhead_us"]
KEYS += ["queue_frames", "queue_rule", "burst_frames", "access_point", "method", "slowed"]


@derived
def validation(run: Run[Config]) -> Run[Config]:
    """Return the run with the validation's plays: this one, otherwise that of the committed log."""
    committed = find_project().reference_logs / "transmission_ros2.mcap"
    if not run["validation"].empty or not committed.is_file():
        return run
    return exp.load(committed)


@derived
def played(run: Run[Config]) -> pd.DataFrame:
    """Return the validation's rows."""
    log = validation(run)
    try:
        older = log["ros2"]
    except KeyError:
        return log["validation"]
    hello = older[older["group"] == HELLO]
    of_grid = hello.rename(columns={"rate_max_hz": "rate_hz"}).assign(kind=GRID)
    columns = ["preset", "kind", "rate_hz", "depth", "method", "slowed", "kept_up", *_MEASURED]
    return pd.concat([log["validation"], of_grid[columns]], ignore_index=True)


def _keys_of(rows: pd.DataFrame) -> list[str]:
    return [key for key in KEYS if key in rows]


@derived
def by_cell(run: Run[Config]) -> pd.DataFrame:
    """Return one row per cell that kept its schedule, over the repetitions that did.

    Columns are the cell's, the medians of what was measured live and in the model, each with ``_low`` and
    ``_high``, and whether the medians agree: ``loss_agrees`` and ``latency_agrees``.
    ``first_agrees`` says whether the first of these repetitions agrees in both.
    """
    rows = played(run)
    kept = rows[rows["kept_up"].astype(bool)]
    groups = kept.groupby(_keys_of(kept), sort=False, dropna=False)[_MEASURED]
    ends = [groups.min().add_suffix("_low"), groups.max().add_suffix("_high")]
    table = agreeing(pd.concat([groups.median(), *ends], axis="columns").reset_index())
    first = agreeing(kept.drop_duplicates(_keys_of(kept)))
    both = first["loss_agrees"] & first["latency_agrees"]
    return table.assign(first_agrees=both.to_numpy())


@derived
def validated(run: Run[Config]) -> pd.DataFrame:
    """Return how far each preset is validated, by its topics and by the grid's cells.

    Returns:
        ``preset``, ``of`` (``topics`` or ``grid``); numbers of ``plays``, of those that were ``late`` and of
        those that ``failed``; how many ``cells`` were played and how many ``kept`` their schedule. Of these,
        the shares whose medians agree, ``loss_within``, ``latency_within`` and ``both_within``, and the share
        whose first play agrees in both, ``first_within``.
    """
    rows, table = played(run), by_cell(run)
    table = table.assign(both=table["loss_agrees"] & table["latency_agrees"])
    marked = rows.assign(
        distinct=~rows.duplicated(_keys_of(rows)), late=~rows["kept_up"].astype(bool)
    )
    counts = marked.groupby(["preset", _of(rows)], sort=False).agg(
        plays=("late", "size"), late=("late", "sum"), cells=("distinct", "sum")
    )
    shares = table.groupby(["preset", _of(table)], sort=False).agg(
        kept=("preset", "size"),
        loss_within=("loss_agrees", "mean"),
        latency_within=("latency_agrees", "mean"),
        both_within=("both", "mean"),
        first_within=("first_agrees", "mean"),
    )
    texts = pd.Series(failed_plays(validation(run), "validation"), dtype=str)
    lost = pd.DataFrame(
        {name: texts.str.extract(f"{name}='(.*?)'")[0] for name in ("preset", "kind")}
    )
    failed = lost.groupby(["preset", _of(lost)]).size().rename("failed")
    found = pd.concat([counts, failed, shares], axis="columns")
    numbers = ["plays", "late", "cells", "failed", "kept"]
    found[numbers] = found[numbers].fillna(0).astype(int)
    return found.reset_index()


def _of(table: pd.DataFrame) -> pd.Series[str]:
    """Return ``grid`` for the grid's cells, and otherwise ``topics``."""
    return table["kind"].where(table["kind"] == GRID, "topics").rename("of")


@derived
def never_kept(run: Run[Config]) -> pd.DataFrame:
    """Return the cells none of whose plays kept its schedule."""
    rows = played(run)
    kept = rows.groupby(_keys_of(rows), sort=False, dropna=False)["kept_up"].sum()
    return kept[kept == 0].reset_index()


_KINDS = {"calm": "third", "lossy": "proxy", "saturated": "standard", GRID: "fourth"}
_LABELS = {GRID: '"Hello" of the grid'}
_NAMED = 2  # lines of cells that a note names
_GROUPS = {"topics": "topics", GRID: "cells of the grid"}
_CORNER: dict[str, Any] = {"xycoords": "axes fraction", "ha": "right", "fontsize": 9}
_CORNER["xy"] = (0.97, 0.05)
_COMPARED = {
    "loss (%)": ("loss_model", "loss_live", 100.0),
    "median latency (ms)": ("p50_model_ms", "p50_live_ms", 1.0),
}
"""Columns of model and live, and the scale, by what they say."""


@exp.figure("transmission_validation", size=(10, 7))
def draw_validation(figure: Figure, run: Run[Config]) -> dict[str, Any]:
    """Draw each cell of the validation, live over the model: losses above, median latencies below."""
    table = by_cell(run)
    if table.empty:
        figure.suptitle("Validation: no cell was played")
        return {}
    shares = validated(run).set_index("of")
    panels = figure.subplots(2, len(MODES), sharex="row", sharey="row")
    for row, quantity in zip(panels, _COMPARED, strict=True):
        for axes, preset in zip(row, MODES, strict=True):
            _draw_cells(axes, table[table["preset"] == preset], quantity)
            axes.set_xlabel(f"{quantity}, model")
        row[0].set_ylabel(f"{quantity}, live")
    for preset, (loss, latency) in zip(MODES, panels.T, strict=True):
        lines = shares[shares["preset"] == preset]
        kept = [f"{line.kept} of {line.cells} {_GROUPS[line.Index]}" for line in lines_of(lines)]
        kept[0] += " kept their schedule"
        first = f"first play agrees: {_by_group(lines['first_within'], ', ')}"
        loss.set_title("\n".join([PRESETS[preset].name, *kept, first]), fontsize=9)
        for axes, column in ((loss, "loss_within"), (latency, "latency_within")):
            axes.annotate(f"medians agree:\n{_by_group(lines[column])}", **_CORNER)
    percent = np.array([0.0, 100.0])
    times_ms = table[["p50_model_ms", "p50_live_ms"]].to_numpy()
    ends_ms = np.array([0.8 * np.nanmin(times_ms), 1.25 * np.nanmax(times_ms)])
    for loss, latency in panels.T:
        _draw_band(loss, percent, percent - 100 * LOSS_WITHIN, percent + 100 * LOSS_WITHIN)
        _draw_band(latency, ends_ms, ends_ms / (1 + LATENCY_WITHIN), ends_ms / (1 - LATENCY_WITHIN))
        latency.set(xscale="log", yscale="log")
    panels[1, 0].legend(loc="upper left", fontsize=8)
    ends = shares.groupby("of", sort=False)["first_within"].agg(["min", "max"])
    agreeing_cells = [
        f"{line.min:.0%} to {line.max:.0%} of the {_GROUPS[line.Index]}" for line in lines_of(ends)
    ]
    figure.suptitle(
        "First plays on real DDS agree with the model in both loss and latency:\n"
        f"{', '.join(agreeing_cells)} (by preset)"
    )
    note(figure, _validation_note(run))
    return {"cells": table, "validated": validated(run)}


def _by_group(shares: pd.Series[float], between: str = "\n") -> str:
    return between.join(f"{of} {share:.0%}" for of, share in shares.items())


def _validation_note(run: Run[Config]) -> str:
    """Return what was played, which cells never kept their schedule, and what cannot be validated."""
    totals = validated(run)[["plays", "late", "failed"]].sum()
    counts = (
        f"{totals['plays']} plays, {totals['late']} late and left out, {totals['failed']} failed"
    )
    read = "; ".join(f"{PRESETS[name].name}: {why}" for name, why in READ.items())
    lines = [f"{counts}; medians, bars: range; grey: acceptance range", read]
    late = never_kept(run)
    names = late["method"].where(late["kind"] == GRID, late["kind"]).rename("name")
    places = []
    for _, part in late.groupby(["preset", names, "rate_hz", "slowed"], dropna=False):
        [cell, *_] = lines_of(part.assign(name=names))
        depths = ", ".join(map(str, part["depth"]))
        places.append(
            f"{PRESETS[cell.preset].name}, {cell.name}, {cell.rate_hz:g} Hz slowed {cell.slowed:g} times, "
            f"DEPTH {depths}"
        )
    more = [] if len(places) <= _NAMED else ["and others"]
    named = ";\n".join([*places[:_NAMED], *more])
    lines.append(f"{len(late)} cells without a play on time: {named}")
    return "\n".join(lines)


def _draw_cells(axes: Axes, table: pd.DataFrame, quantity: str) -> None:
    """Draw cells of a preset, with bars from the lowest to the highest repetition."""
    model, live, scale = _COMPARED[quantity]
    for kind, key in _KINDS.items():
        part = scale * table[table["kind"] == kind][[model, live, f"{live}_low", f"{live}_high"]]
        spread = [part[live] - part[f"{live}_low"], part[f"{live}_high"] - part[live]]
        style: dict[str, Any] = {"markersize": 4, "elinewidth": 0.8, "linestyle": "", **series(key)}
        label = _LABELS.get(kind, f"{kind} topic")
        axes.errorbar(part[model], part[live], yerr=spread, label=label, alpha=0.8, **style)


def _draw_band(axes: Axes, ends: Any, low: Any, high: Any) -> None:
    axes.plot(ends, ends, color="black", linewidth=0.8)
    axes.fill_between(ends, low, high, color="black", alpha=0.1)


# --- Explorer ---------------------------------------------------------------------------------

ExploredRate = Annotated[int, Bounds(20, 1000, log=True)]
Loss = Annotated[float, Bounds(0.0, 0.3)]

COARSE_S, WHOLE_S = 1.0, 20.0  #: Simulated time of a coarse picture and of a whole one, seconds.
_THREADS = 2
_DEPTH = pictures.Axis("DEPTH", "samples", 0.7, 7000, log=True, ticks=(1, 10, 100, 1000))
_QUANTITIES = {
    "latency_p50_ms": pictures.Axis(
        "median latency", "ms", 0.3, 1e5, log=True, ticks=(1, 100, 1e4)
    ),
    "loss": pictures.Axis("packet loss", "%", 0, 100),
    "utilisation": pictures.Axis("channel utilisation", "%", 0, 100),
}


@exp.explorer
def hello_over_depth(
    *,
    rate_max_hz: ExploredRate = 100,
    loss: Loss = 0.01,
    vendor: Literal["fast_dds", "cyclone_dds"] = "fast_dds",
) -> Iterator[pictures.Picture | None]:
    """Yield latency and loss of "Hello" and the channel utilisation over DEPTH, coarse, then whole.

    Args:
        rate_max_hz: Publishing rate of methods without balanced QoS, Rmax [Hz].
        loss: Share of frames that the channel loses.
        vendor: Timing of the middleware.
    """
    for duration_s in (COARSE_S, WHOLE_S):
        simulated = []
        for method, depth in product(LABELS, (*map(str, DEPTHS), OPT_DEPTH)):
            cell = GridCell(
                rate_max_hz=rate_max_hz,
                depth=depth,
                method=method,
                duration_s=duration_s,
                loss=loss,
                vendor=vendor,
            )
            simulated.append(cell)
        rows = []
        with ThreadPoolExecutor(_THREADS) as pool:
            jobs = [pool.submit(simulate_cell, cell, 0) for cell in simulated]
            try:
                for job in jobs:
                    rows.append(job.result())
                    yield None
            finally:
                pool.shutdown(wait=False, cancel_futures=True)
        yield _picture(simulated, rows)


def _picture(simulated: list[GridCell], rows: list[dict[str, Any]]) -> pictures.Picture:
    """Return the picture of simulated cells: a line over DEPTH for each method."""
    for row in rows:
        row["loss"] = 100 * (1 - row["arrived"] / row["published"])
        row["utilisation"] = 100 * row["air_share"]
    panels = []
    for column, axis in _QUANTITIES.items():
        drawn = []
        for method, label in LABELS.items():
            points = sorted(
                (row["history_depth"], row[column])
                for cell, row in zip(simulated, rows, strict=True)
                if cell.method == method and np.isfinite(row[column])
            )
            x = [depth for depth, _ in points]
            y = [value for _, value in points]
            line = pictures.Series(name=label, color=STYLES[method]["color"], x=x, y=y)
            drawn.append(line)
        panels.append(pictures.Panel(title=axis.quantity, x=_DEPTH, y=axis, series=tuple(drawn)))
    cell = simulated[0]
    _, optimum = rate_and_depth(simulated[-1])
    said = (
        f'"Hello" at Rmax {cell.rate_max_hz} Hz with {cell.loss:.1%} of the frames lost, '
        f"{PRESETS[cell.vendor].name}, simulated for {cell.duration_s:g} s. "
        f"DEPTH by Eq. 6: {optimum}."
    )
    return pictures.Picture(said=said, panels=tuple(panels))
