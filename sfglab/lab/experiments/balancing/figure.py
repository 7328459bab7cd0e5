"""The figures on caches and balanced QoS, drawn from a log."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from sfglab.lab.experiments.balancing.analysis import Results, saved, staleness
from sfglab.lab.experiments.balancing.stale import SHOWN
from sfglab.lab.figures import COLORS, MARKERS, house_style

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


_SHADES = ("third", "proxy", "fourth", "standard")


def figure_caches(results: Results) -> tuple[Figure, dict[str, Any]]:
    """Draw what the local cache holds back of each sensor's readings, by rate."""
    from matplotlib.figure import Figure

    table = saved(results)
    with house_style():
        figure = Figure(figsize=(8.4, 3.6))
        draw_caches(figure.subplots(), results)
        figure.suptitle(
            f"Local cache: read {table.columns[-1]} times a second, a sensor repeats itself in "
            f"{table.iloc[:, -1].mean():.0%} of its readings, on average"
        )
    return figure, {"held": table.reset_index().rename(columns=str).to_dict(orient="list")}


def draw_caches(axes: Axes, results: Results) -> None:
    """Draw the share of readings that were held back, a group of bars a sensor."""
    table = saved(results)
    width = 0.8 / len(table.columns)
    for place, (rate, color) in enumerate(zip(table.columns, _SHADES, strict=False)):
        spots = np.arange(len(table)) + (place - (len(table.columns) - 1) / 2) * width
        axes.bar(spots, 100 * table[rate], width, label=f"{rate} Hz", color=COLORS[color])
    change = results.table_one.set_index("sensor")["change_s"]
    names = [f"{name}\nchanges every\n{change[name]:g} s" for name in table.index]
    axes.set_xticks(range(len(table)), names, fontsize=8)
    axes.set_ylabel("readings held back (%)")
    axes.set_ylim(0, 100)
    axes.grid(visible=False, axis="x")
    axes.legend(title="sensor read at", ncols=4, loc="upper center", bbox_to_anchor=(0.5, 1.28))


def figure_stale(results: Results) -> tuple[Figure, dict[str, Any]]:
    """Draw what a lost change does, and what the longest silence does about it."""
    from matplotlib.figure import Figure

    with house_style():
        figure = Figure(figsize=(10, 4.6))
        course, share = figure.subplots(1, 2)
        draw_course(course, results)
        draw_stale(share, results)
        loss = float(results.config["loss"])
        figure.suptitle(f"A lost change stays lost: local cache on a link that loses {loss:.0%} (simulated)")
    table = staleness(results)
    return figure, {"stale": table.to_dict(orient="list")}


def draw_course(axes: Axes, results: Results) -> None:
    """Draw the sensor's value against the station's in the examples; red where they differ."""
    shown = results.shown
    end = float(np.ceil(shown["t_s"].max()))
    for lane, (qos, silence_s) in enumerate(SHOWN):
        part = shown[(shown["qos"] == qos) & (shown["silence_s"] == silence_s)]
        steps = {w: part[part["where"] == w] for w in ("sensor", "station")}
        _lane(axes, -lane, steps, end)
        text = f"{qos}, " + (f"silence at most {silence_s:g} s" if silence_s else "no longest silence")
        axes.text(0, -lane + 0.36, text, fontsize=8)
    axes.set_yticks([])
    axes.set_xlim(0, end)
    axes.set_ylim(-len(SHOWN) + 0.5, 0.75)
    axes.set_xlabel("time (s)")
    axes.set_title("a PIR sensor's state: light and dark blue; red: the station has another", fontsize=9)
    axes.grid(visible=False)


def _lane(axes: Axes, y: float, steps: dict[str, Any], end: float) -> None:
    times = np.unique(np.concatenate([s["t_s"].to_numpy() for s in steps.values()]))
    values = {}
    for where, step in steps.items():
        order = np.searchsorted(step["t_s"].to_numpy(), times, side="right") - 1
        values[where] = np.where(order >= 0, step["value"].to_numpy()[order], -1)
    lasts = np.diff([*times, end])
    for t, lasting, true, known in zip(times, lasts, values["sensor"], values["station"], strict=True):
        color = COLORS["standard"] if true != known else COLORS["proxy"]
        shade = 0.9 if true != known or true % 2 else 0.4
        axes.barh(y, lasting, left=t, height=0.5, color=color, alpha=shade, linewidth=0)


def draw_stale(axes: Axes, results: Results) -> None:
    """Draw the share of time with a stale value against the messages that it costs."""
    table = staleness(results)
    for qos, color in (("best effort", "standard"), ("reliable", "proxy")):
        part = table[table["qos"] == qos].sort_values("messages_hz")
        axes.plot(
            part["messages_hz"],
            100 * part["stale_share"],
            marker=MARKERS[color],
            color=COLORS[color],
            label=f"{qos}, KEEP_LAST 1",
        )
    points = table[table["qos"] == "best effort"][["silence_s", "messages_hz", "stale_share"]].to_numpy()
    for silence_s, messages_hz, share in points:
        text = f"{silence_s:g} s" if silence_s else "none"
        place = (messages_hz, 100 * share)
        axes.annotate(text, place, textcoords="offset points", xytext=(5, 5), fontsize=8)
    axes.set(xscale="log", yscale="log")
    axes.set_xlabel("messages a second (100 without a cache)")
    axes.set_ylabel("time with a stale value (%)")
    axes.set_title("at each point: the longest silence", fontsize=9)
    axes.legend()


def figure_qos(results: Results) -> tuple[Figure, dict[str, Any]]:
    """Draw the printed optimum, which has no trade-off, beside our own problem's Pareto front."""
    from matplotlib.figure import Figure

    front = results.front
    printed = front[front["method"] == "printed"]
    over = printed[printed["utilisation"] > 1]["rate_max_hz"].tolist()
    with house_style():
        figure = Figure(figsize=(10, 4.4))
        optimum, pareto = figure.subplots(1, 2)
        draw_optimum(optimum, results)
        draw_front(pareto, results)
        figure.suptitle(
            "QoS balancing: the printed optimum does not see the link, and overloads it at Rmax = "
            + " and ".join(f"{rate}" for rate in over)
            + " Hz"
            if over
            else "QoS balancing: the printed optimum and our own"
        )
    return figure, {"front": front.to_dict(orient="list")}


def draw_front(axes: Axes, results: Results) -> None:
    """Draw latency against freshness: our front, its chosen point, and where the printed optima lie."""
    front = results.front
    top = front["rate_max_hz"].max()
    ours = front[(front["method"] == "ours") & (front["rate_max_hz"] == top)].sort_values("freshness")
    axes.plot(
        ours["freshness"],
        ours["latency_ms"],
        "-",
        marker="o",
        markersize=3,
        color=COLORS["third"],
        label=f"our front (Rmax = {top} Hz)",
    )
    chosen = ours[ours["chosen"]]
    axes.plot(
        chosen["freshness"], chosen["latency_ms"], "*", markersize=13, color=COLORS["third"], label="chosen"
    )
    printed = front[front["method"] == "printed"]
    fits = printed[printed["utilisation"] < 1]
    axes.plot(fits["freshness"], fits["latency_ms"], "s", color=COLORS["proxy"], label="printed, Eq. 6")
    for row in fits.itertuples():
        axes.annotate(f"  Rmax {row.rate_max_hz} Hz", (row.freshness, row.latency_ms), fontsize=8, va="center")
    axes.set_yscale("log")
    # Room at the top for what has no finite latency.
    axes.set_ylim(top=5 * max(fits["latency_ms"].max(), ours["latency_ms"].max()))
    _overloaded(axes, printed[printed["utilisation"] >= 1])
    axes.set_xlabel("freshness: time in which what was sent last is true (share)")
    axes.set_ylabel("mean latency, expected (ms)")
    axes.set_title("to the right and down is better", fontsize=9)
    axes.legend(fontsize=8, loc="center left")


def _overloaded(axes: Axes, printed: Any) -> None:
    """Mark at the upper edge what has no finite latency."""
    edge = axes.get_xaxis_transform()
    for line, row in enumerate(printed.itertuples()):
        height = 0.97 - 0.06 * line
        axes.plot(row.freshness, height, "s", color=COLORS["standard"], transform=edge)
        text = f"Rmax {row.rate_max_hz} Hz needs {row.utilisation:.1f} times the air  "
        axes.annotate(text, (row.freshness, height), xycoords=edge, ha="right", va="center", fontsize=8)


def draw_optimum(axes: Axes, results: Results) -> None:
    """Draw R and D of Eq. 6 over Rmax, CVXPY as markers on the closed form's lines."""
    balance = results.balance[(results.balance["weight"] == 0.5) & (results.balance["rate_min_hz"] == 1.0)]
    for (topics, group), color in zip(balance.groupby("topics", sort=False), _cycle(), strict=False):
        counts = [int(part) for part in str(topics).split("+")]
        label = f"{sum(counts) / len(counts):.3g} topics"
        axes.plot(group["rate_max_hz"], group["rate_closed_hz"], color=color, linewidth=1)
        axes.plot(group["rate_max_hz"], group["rate_hz"], "o", color=color, markersize=4, label=label)
        last = group.iloc[int(group["rate_max_hz"].argmax())]
        place = (float(last["rate_max_hz"]), float(last["rate_hz"]))
        axes.annotate(f" D = {last['depth']:.0f}", place, fontsize=7, va="center")
    axes.set_xlabel("Rmax (Hz)")
    axes.set_ylabel("R (Hz)")
    axes.set_title("Eq. 6: CVXPY (dots) on the closed form (lines)", fontsize=9)
    axes.legend(title="T_avg", fontsize=8)


def _cycle() -> list[str]:
    return [*COLORS.values(), "black"]
