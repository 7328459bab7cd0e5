"""Savings of the caches, staleness of values, the claims and the figures, computed from a run."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from sfglab.lab.claims import Finding, How
from sfglab.lab.experiment import Look
from sfglab.lab.experiments.balancing.experiment import Config, exp, shown_of
from sfglab.lab.experiments.balancing.optimum import mean_topics
from sfglab.lab.figures import COLORS, grouped_bars, note, series
from sfglab.lab.runs import Run, derived
from sfglab.lab.stats import exactly

if TYPE_CHECKING:
    from collections.abc import Sequence

    import pandas as pd
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


@derived
def saved(run: Run[Config], *, silence_s: float = 0.0) -> pd.DataFrame:
    """Return the share of readings that caches with a longest silence, 0: none, held back: sensors by rates."""
    cache = run["cache"][run["cache"]["silence_s"] == silence_s]
    cache = cache.assign(held=1 - cache["sent"] / cache["offered"])
    return cache.pivot_table(index="sensor", columns="rate_hz", values="held", sort=False)


@derived
def staleness(run: Run[Config]) -> pd.DataFrame:
    """Return means over seeds of staleness and load, a line for each QoS and longest silence."""
    columns = ["messages_hz", "stale_share", "longest_s"]
    return run["stale"].groupby(["qos", "silence_s"])[columns].mean().reset_index()


@derived
def assumed(run: Run[Config]) -> pd.DataFrame:
    """Return the optimum by Rmin and Dmin, a line each, for the first topics and the lowest Rmax of a run."""
    balance = run["balance"]
    same = (balance[["topics", "weight"]] == balance[["topics", "weight"]].iloc[0]).all(axis=1)
    found: pd.DataFrame = balance[same & (balance["rate_max_hz"] == balance["rate_max_hz"].min())]
    return found


TABLE_1 = {
    **dict.fromkeys(("lidar", "dht11", "imu", "ultrasonic"), ("std_msgs/msg/Float32", 24)),
    "flame": ("std_msgs/msg/Bool", 28),
    "light": ("std_msgs/msg/String", 54),
    "pir": ("std_msgs/msg/String", 59),
}
"""The paper's table, from its text alone: what each message is, and its size in bytes."""


@exp.claim("B-LC", how=How.EXACT)
def local_cache(run: Run[Config]) -> Finding:
    """Return the share of checks of the local cache that hold."""
    return _checked(run, "LC", _cache_details(run, "sent", "messages sent"))


@exp.claim("B-CC", how=How.EXACT)
def cache_control(run: Run[Config]) -> Finding:
    """Return the share of checks of cache control that hold."""
    return _checked(run, "CC", _cache_details(run, "planned", "messages planned with"))


@exp.claim("B-OPT", how=How.EXACT)
def optimum(run: Run[Config]) -> Finding:
    """Return the share of checks of Eq. 1 to 6 that hold."""
    balance = run["balance"]
    found = balance[balance["solvable"]]
    worst = ((found["depth"] - found["depth_closed"]).abs() / found["depth_closed"]).max()
    details = {
        "problems": str(len(balance)),
        "without a solution": str(int((~balance["solvable"]).sum())),
        "largest relative difference of D": f"{worst:.1e}",
        "R and D by what the paper leaves open": "; ".join(
            f"Rmin {row.rate_min_hz:g} Hz, Dmin {row.depth_min:g}: "
            + (f"{row.rate_hz:.1f} Hz, {row.depth:.0f}" if row.solvable else "none")
            for row in assumed(run).itertuples()
        ),
    }
    return _checked(run, "OPT", details)


@exp.claim("B-TAB1", how=How.EXACT)
def table_one(run: Run[Config]) -> Finding:
    """Return the share of sizes that are Table 1's."""
    table = run["table_one"]
    sizes = ", ".join(
        f"{row.sensor} {row.table_bytes}/{row.cdr_bytes}" for row in table.itertuples()
    )
    details = {
        "paper's bytes / CDR on the wire": sizes,
        "what the paper's bytes are": "the size of the value as a Python object",
    }
    rows = table[["sensor", "type", "table_bytes", "object_bytes"]].to_numpy()
    found = {str(name): ((kind, declared), (kind, size)) for name, kind, declared, size in rows}
    names = found.keys() | TABLE_1.keys()
    wrong = [
        name for name in names if name not in TABLE_1 or found.get(name) != (TABLE_1[name],) * 2
    ]
    share = exactly(1 - len(wrong) / len(names), "share of messages that match")
    reason = f"not as printed: {', '.join(wrong)}" if wrong else ""
    return Finding(estimate=share, details=details, reason=reason)


def _checked(run: Run[Config], prefix: str, details: dict[str, str]) -> Finding:
    checks = run["check"][run["check"]["check"].str.startswith(prefix + ":")]
    counts = {"checks": str(int(checks["checked"].sum())), "properties": str(len(checks))}
    share = float(checks["held"].sum() / checks["checked"].sum())
    return Finding(
        estimate=exactly(share, "share of checks that hold"), details={**counts, **details}
    )


def _cache_details(run: Run[Config], column: str, what: str) -> dict[str, str]:
    cache = run["cache"][run["cache"]["silence_s"] == 0.0]
    by_rate = cache.groupby("rate_hz")[["offered", column]].sum()
    shares = 1 - by_rate[column] / by_rate["offered"]
    text = ", ".join(f"{share:.0%} at {rate} Hz" for rate, share in shares.items())
    recorded = {
        f"of what was {row.sensor}, fewer {what}": f"{1 - getattr(row, column) / row.offered:.0%}"
        for row in run["recorded"].query("silence_s == 0").itertuples()
    }
    return {f"fewer {what}": text, "readings": str(int(cache["offered"].sum())), **recorded}


_SHADES = ("#cfe3f2", "#86b9de", "#3d8fc8", COLORS["proxy"])


@exp.figure("balancing_caches", size=(8.4, 3.6))
def draw_caches(figure: Figure, run: Run[Config]) -> dict[str, Any]:
    """Draw what the local cache holds back of each sensor's readings, a group of bars a sensor."""
    table, axes = saved(run), figure.subplots()
    grouped_bars(axes, (100 * table).rename(columns=lambda rate: f"{rate} Hz"), _SHADES, width=0.8)
    change = run["table_one"].set_index("sensor")["change_s"]
    names = [f"{name}\nchanges every\n{change[name]:g} s" for name in table.index]
    axes.set_xticks(range(len(table)), names, fontsize=8)
    axes.set(ylabel="readings held back (%)", ylim=(0, 100))
    axes.legend(title="sensor read at", ncols=4, loc="upper center", bbox_to_anchor=(0.5, 1.28))
    figure.suptitle(
        f"Local cache: read {table.columns[-1]} times a second, a sensor repeats itself in "
        f"{table.iloc[:, -1].mean():.0%} of its readings, on average"
    )
    note(
        figure,
        f"drawn readings of {run.config.readings_s:g} s a sensor, once, through the live nodes' cache",
    )
    return {"held": table.reset_index().rename(columns=str)}


@exp.figure("balancing_stale", size=(10, 4.6))
def draw_lost_changes(figure: Figure, run: Run[Config]) -> dict[str, Any]:
    """Draw what a lost change does, and what the longest silence does about it."""
    course, share = figure.subplots(1, 2)
    _draw_courses(course, run["shown"], shown_of(run.config))
    _draw_staleness(share, staleness(run))
    figure.suptitle(
        f"A lost change stays lost: local cache on a link that loses {run.config.loss:.0%}"
    )
    runs, each_s = run.config.stale_seeds, run.config.stale_s
    note(
        figure,
        f"simulated; right: {runs} seeds of {each_s:g} s together; at a point: the longest silence",
    )
    return {"stale": staleness(run)}


@exp.look(
    "caches",
    Look(
        turn=("rates_hz", "loss", "silences_s"),
        needs=("Table 1", "caches", "lost changes"),
        size=(10, 8),
        start={"rates_hz": (100,), "silences_s": (0.0, 2.0, 0.5), "stale_seeds": 3},
        coarse={"readings_s": 10.0, "stale_s": 60.0},
        reference="balancing_stale",
    ),
)
def draw_held_and_stale(figure: Figure, run: Run[Config]) -> None:
    """Draw what the caches hold back, above what a lost change does."""
    halves: Any = figure.subfigures(2, 1, height_ratios=(3, 4))
    draw_caches(halves[0], run)
    draw_lost_changes(halves[1], run)


def _draw_courses(axes: Axes, shown: pd.DataFrame, lanes: Sequence[tuple[str, float]]) -> None:
    """Draw the sensor's value against the station's in the examples; red where they differ."""
    end = float(np.ceil(shown["t_s"].max()))
    for lane, (qos, silence_s) in enumerate(lanes):
        part = shown[(shown["qos"] == qos) & (shown["silence_s"] == silence_s)]
        _draw_lane(axes, -lane, {w: part[part["where"] == w] for w in ("sensor", "station")}, end)
        text = f"{qos}, " + (
            f"silence at most {silence_s:g} s" if silence_s else "no longest silence"
        )
        axes.text(0.3, -lane + 0.33, text, fontsize=8)
    axes.set(yticks=[], xlim=(0, end), ylim=(-len(lanes) + 0.5, 0.75), xlabel="time (s)")
    axes.set_title(
        "a PIR sensor's state, light and dark blue; orange: the station has another", fontsize=9
    )
    axes.grid(visible=False)
    axes.spines["left"].set_visible(False)


def _draw_lane(axes: Axes, y: float, steps: dict[str, Any], end: float) -> None:
    times = np.unique(np.concatenate([s["t_s"].to_numpy() for s in steps.values()]))
    both = [
        np.append(s["value"], -1)[np.searchsorted(s["t_s"], times, "right") - 1]
        for s in steps.values()
    ]
    for t, lasting, true, known in zip(times, np.diff([*times, end]), *both, strict=True):
        color = COLORS["standard"] if true != known else COLORS["proxy"]
        shade = 0.9 if true != known or true % 2 else 0.4
        axes.barh(y, lasting, left=t, height=0.5, color=color, alpha=shade, linewidth=0)


def _draw_staleness(axes: Axes, table: pd.DataFrame) -> None:
    """Draw the share of time with a stale value against the messages that it costs."""
    for qos, color in (("best effort", "standard"), ("reliable", "proxy")):
        part = table[table["qos"] == qos].sort_values("messages_hz")
        axes.plot(
            part["messages_hz"],
            100 * part["stale_share"],
            label=f"{qos}, KEEP_LAST 1",
            **series(color),
        )
    points = table[table["qos"] == "best effort"][
        ["silence_s", "messages_hz", "stale_share"]
    ].to_numpy()
    for silence_s, messages_hz, share in points:
        text, place = f"{silence_s:g} s" if silence_s else "none", (messages_hz, 100 * share)
        axes.annotate(text, place, textcoords="offset points", xytext=(6, 5), fontsize=8)
    axes.set(xscale="log", yscale="log")
    axes.set_xlim(right=2 * points[:, 1].max())
    axes.set(xlabel="messages a second (100 without a cache)", ylabel="time with a stale value (%)")
    axes.legend()


@exp.look(
    "optimum",
    Look(
        turn=("rates_min_hz", "rates_hz", "weights"),
        needs=("Eq. 6", "Pareto front"),
        size=(10, 4.4),
        start={"rates_min_hz": (1.0,), "rates_hz": (100, 500), "weights": 9},
        coarse={"weights": 2},
        reference="balancing_qos",
    ),
)
@exp.figure("balancing_qos", size=(10, 4.4))
def draw_qos(figure: Figure, run: Run[Config]) -> dict[str, Any]:
    """Draw the printed optimum, which has no trade-off, beside our own problem's Pareto front."""
    front = run["front"]
    printed = front[front["method"] == "printed"]
    over = printed[printed["utilisation"] > 1]["rate_max_hz"].tolist()
    optimum, pareto = figure.subplots(1, 2)
    _draw_optimum(optimum, run["balance"])
    _draw_front(pareto, front)
    rates = " and ".join(map(str, over)) or "no"
    figure.suptitle(
        f"The printed optimum does not see the link, and overloads it at Rmax = {rates} Hz"
    )
    note(
        figure, "exact for Eq. 6; latency and freshness are expected by our programme, not measured"
    )
    return {"front": front}


def _draw_front(axes: Axes, front: pd.DataFrame) -> None:
    """Draw latency against freshness: our front, its chosen point, and where the printed optima lie."""
    top = front["rate_max_hz"].max()
    ours = front[(front["method"] == "ours") & (front["rate_max_hz"] == top)].sort_values(
        "freshness"
    )
    style: dict[str, Any] = {"color": COLORS["third"], "label": f"our front (Rmax = {top} Hz)"}
    axes.plot(ours["freshness"], ours["latency_ms"], "-", marker="o", markersize=3, **style)
    chosen = ours[ours["chosen"]]
    style["label"] = "chosen"
    axes.plot(chosen["freshness"], chosen["latency_ms"], "*", markersize=13, **style)
    printed = front[front["method"] == "printed"]
    fits = printed[printed["utilisation"] < 1]
    axes.plot(
        fits["freshness"], fits["latency_ms"], "s", color=COLORS["proxy"], label="printed, Eq. 6"
    )
    for row in fits.itertuples():
        axes.annotate(
            f"   Rmax {row.rate_max_hz} Hz",
            (row.freshness, row.latency_ms),
            fontsize=8,
            va="center",
        )
    axes.set_yscale("log")
    # Room at the top for what has no finite latency.
    axes.set_ylim(top=5 * max(fits["latency_ms"].max(), ours["latency_ms"].max()))
    _draw_overloaded(axes, printed[printed["utilisation"] >= 1])
    axes.set_xlabel("freshness: time in which what was sent last is true (share)")
    axes.set_ylabel("mean latency, expected (ms)")
    axes.set_title("to the right and down is better", fontsize=9)
    axes.legend(fontsize=8, loc="center left")


def _draw_overloaded(axes: Axes, printed: Any) -> None:
    """Mark at the upper edge what has no finite latency."""
    edge = axes.get_xaxis_transform()
    for line, row in enumerate(printed.itertuples()):
        height = 0.97 - 0.06 * line
        axes.plot(row.freshness, height, "s", color=COLORS["standard"], transform=edge)
        text = f"Rmax {row.rate_max_hz} Hz needs {row.utilisation:.1f} times the air   "
        axes.annotate(
            text, (row.freshness, height), xycoords=edge, ha="right", va="center", fontsize=8
        )


def _draw_optimum(axes: Axes, balance: pd.DataFrame) -> None:
    """Draw R and D of Eq. 6 over Rmax, CVXPY as markers on the closed form's lines."""
    rates_min = set(balance["rate_min_hz"])
    shown = 1.0 if 1.0 in rates_min else min(rates_min)
    balance = balance[(balance["weight"] == 0.5) & (balance["rate_min_hz"] == shown)]
    balance = balance[balance["depth_min"] == balance["depth_min"].min()]
    for topics, group in balance.groupby("topics", sort=False):
        axes.plot(group["rate_max_hz"], group["rate_closed_hz"], color="black", linewidth=1)
        axes.plot(group["rate_max_hz"], group["rate_hz"], "o", color=COLORS["proxy"], markersize=4)
        last = group.iloc[int(group["rate_max_hz"].argmax())]
        place = (float(last["rate_max_hz"]), float(last["rate_hz"]))
        said = f"{mean_topics(str(topics)):.3g} topics, D = {last['depth']:.0f}"
        axes.annotate(said, place, (6, 0), textcoords="offset points", fontsize=8, va="center")
    axes.set_xlim(right=1.4 * balance["rate_max_hz"].max())
    axes.set(xlabel="Rmax (Hz)", ylabel="R (Hz)")
    axes.set_title(
        "Eq. 6 by mean topics a robot: CVXPY (dots) on the closed form (lines)", fontsize=9
    )
