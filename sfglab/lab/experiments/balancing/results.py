"""Claims, figures and explorers of caches and balanced QoS.

Balanced QoS is Eq. 6 of the paper: from Rmax, the rate at which one topic alone could be sent, it
finds the rate R of all topics and the depth D of their histories.
"""

from __future__ import annotations

import math
from contextlib import suppress
from dataclasses import replace
from functools import cache
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import pandas as pd

from sfglab.arp.balancing import (
    DEPTH_MAX,
    Balance,
    BalanceInput,
    InfeasibleBalanceError,
    balance_closed_form,
)
from sfglab.arp.link import Link, at_depths, link_of
from sfglab.arp.robots import SENSORS, Rate, cdr_bytes
from sfglab.arp.topics import load_topics
from sfglab.errors import InvalidValueError
from sfglab.fields import Bounds
from sfglab.lab import pictures
from sfglab.lab.checks import share_of_checks
from sfglab.lab.claims import Finding, How
from sfglab.lab.experiments import experiment
from sfglab.lab.experiments.balancing.experiment import ELECTRODE, Config, exp, mean_topics
from sfglab.lab.figures import COLORS, METHOD_COLORS, grouped_bars, lines, note
from sfglab.lab.paths import find_project
from sfglab.lab.runs import Run, derived, lines_of
from sfglab.lab.stats import Floats, exactly

if TYPE_CHECKING:
    from collections.abc import Sequence

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


# --- Tables -----------------------------------------------------------------------------------


@derived
def caches(run: Run[Config]) -> pd.DataFrame:
    """Return the table ``cache`` without a maximum silence, with the share and the size of readings.

    `held` is the share of readings that the local cache suppresses, `bytes` the size of all.
    """
    cache = run["cache"][run["cache"]["silence_s"] == 0]
    sizes = cache["sensor"].map({name: cdr_bytes(sensor) for name, sensor in SENSORS.items()})
    held = 1 - cache["sent"] / cache["offered"]
    return cache.assign(held=held, bytes=cache["offered"] * sizes)


@derived
def saved(run: Run[Config]) -> pd.DataFrame:
    """Return the share of readings that the local cache suppresses, by sensor and reading rate."""
    return caches(run).pivot_table(index="sensor", columns="rate_hz", values="held", sort=False)


OPT = "balanced QoS (OPT)"
FRAMES = {"data": "DATA", "heartbeats": "HEARTBEAT", "acknacks": "ACKNACK"}
"""Kinds of RTPS frames by their columns in the table ``cell`` of `transmission`."""
PAIRS = {"no method": ("none", "LC"), OPT: ("OPT", "OPT+LC")}
"""Methods of `transmission` without and with the local cache, by the name of the first."""


@derived
def frames_saved(run: Run[Config]) -> pd.DataFrame:  # noqa: ARG001 - kept with the run
    """Return the share of frames that the local cache saves in the reference run of `transmission`.

    Depths and seeds are summed up. Readings are those of the sensors; "Hello"s pass no cache.

    Returns:
        One row per pair of methods and kind of frame, one column per Rmax. Empty if there is no
        reference run.
    """
    log = find_project().reference_logs / "transmission.mcap"
    if not log.is_file():
        return pd.DataFrame()
    cells = experiment("transmission").load(log)["cell"].rename(columns=FRAMES)
    sums = cells.groupby(["method", "rate_max_hz"])[list(FRAMES.values())].sum()
    shares = {}
    for name, (without, with_cache) in PAIRS.items():
        shares[name] = (1 - sums.loc[with_cache] / sums.loc[without]).T
    return pd.concat(shares, names=["method", "frame"])


METHODS = {
    "no method (R = Rmax)": METHOD_COLORS["none"],
    OPT: METHOD_COLORS["OPT"],
    "OPT and local cache (LC)": METHOD_COLORS["OPT+LC"],
}
"""Colours of methods whose demand on the channel is shown."""


@derived
def channel_loads(run: Run[Config]) -> pd.DataFrame:
    """Return the demand of the topic file's topics on its channel, one row per Rmax, by method."""
    topics = load_topics(find_project().data / run.config.topic_file).topics_of_agents()
    rows = {}
    for rate_max_hz in run.config.rates_hz:
        found = balance_closed_form(BalanceInput(topics=topics, rate_max_hz=rate_max_hz))
        rows[rate_max_hz] = loads_of(run.config.topic_file, found, rate_max_hz)
    return pd.DataFrame.from_dict(rows, orient="index")


def loads_of(topic_file: str, found: Balance, rate_max_hz: float) -> dict[str, float]:
    """Return the share of the channel that topics ask for if all hosts contend, by method.

    Above 1 it is more than there is. Where hosts seldom contend, the utilisation that a simulation measures is
    lower.

    Args:
        topic_file: File in the data folder with topics and channel.
        found: Optimum of Eq. 6, one rate and depth for all topics.
        rate_max_hz: Rmax, the rate without a method.
    """
    plain, cached = _links(topic_file)
    cases = ((plain, rate_max_hz), (plain, found.rate_hz), (cached, found.rate_hz))
    loads = []
    for link, rate_hz in cases:
        rates_hz = np.full(len(link.loss), rate_hz)
        depths = np.full(len(link.loss), int(found.depth))
        utilisation = at_depths(link, depths, rates_hz).utilisation(rates_hz)
        loads.append(float(utilisation.max()))
    return dict(zip(METHODS, loads, strict=True))


@cache
def _links(topic_file: str) -> tuple[Link, Link]:
    """Return a file's topics on its channel, without and with a local cache for the sensors of Table 1.

    Each "Hello" is counted, so that caches pass them all, as in `sfglab.arp.hello`.
    """
    given = load_topics(find_project().data / topic_file)
    cached = []
    for topic in given.topics:
        is_sensor = topic.name.rpartition("/")[2] in SENSORS
        cached.append(replace(topic, cached=is_sensor))
    plain_link = link_of(given.topics, given.medium, given.vendor)
    return plain_link, link_of(cached, given.medium, given.vendor)


# --- Claims -----------------------------------------------------------------------------------

TABLE_1 = {
    **dict.fromkeys(("lidar", "dht11", "imu", "ultrasonic"), ("std_msgs/msg/Float32", 24)),
    "flame": ("std_msgs/msg/Bool", 28),
    "light": ("std_msgs/msg/String", 54),
    "pir": ("std_msgs/msg/String", 59),
}
"""Types and sizes of messages, bytes, from the paper's text alone."""
_FORMER = {f"recorded {name}": recorded for name, recorded in ELECTRODE.items()}
"""Names of recorded readings by those in earlier logs."""


@exp.claim("B-LC", how=How.EXACT)
def local_cache(run: Run[Config]) -> Finding:
    """Return the share of checks of the local cache that hold, and what it saves."""
    table = caches(run)
    sums = table.groupby("rate_hz")[["held_bytes", "bytes"]].sum()
    details = {
        "fewer messages sent": by_rate(rate_means(table, "sent")),
        "fewer bytes sent": by_rate(sums["held_bytes"] / sums["bytes"]),
    }
    for row in lines_of(run["recorded"].query("silence_s == 0")):
        name = _FORMER.get(row.sensor, row.sensor)
        details[f"fewer messages sent, {name}"] = f"{1 - row.sent / row.offered:.0%}"
    frames = frames_saved(run)
    for method, frame in frames.index:
        shares = frames.loc[(method, frame)]
        details[f"fewer {frame} frames than with {method}"] = by_rate(shares)
    return checked(run, "LC", details)


@exp.claim("B-CC", how=How.EXACT)
def cache_control(run: Run[Config]) -> Finding:
    """Return the share of checks of cache control that hold."""
    fewer = by_rate(rate_means(caches(run), "planned"))
    return checked(run, "CC", {"fewer messages planned with": fewer})


@exp.claim("B-OPT", how=How.EXACT)
def optimum(run: Run[Config]) -> Finding:
    """Return the share of checks of Eq. 1 to 6 that hold."""
    table = run["balance"]
    solved = table[table["solvable"]]
    worst = (solved["depth"] / solved["depth_closed"] - 1).abs().max()
    details = {
        "problems": str(len(table)),
        "without a solution": str(len(table) - len(solved)),
        "largest relative difference of D": f"{worst:.1e}",
    }
    return checked(run, "OPT", details)


@exp.claim("B-TAB1", how=How.EXACT)
def table_one(run: Run[Config]) -> Finding:
    """Return the share of messages whose type and sizes are those of Table 1."""
    matching = []
    sizes = []
    rows = lines_of(run["table_one"])
    for row in rows:
        stated = TABLE_1.get(row.sensor)
        if stated == (row.type, row.table_bytes) == (row.type, row.object_bytes):
            matching.append(row.sensor)
        sizes.append(f"{row.sensor} {row.table_bytes}/{row.cdr_bytes}")
    names = {row.sensor for row in rows} | TABLE_1.keys()
    wrong = sorted(names.difference(matching))
    details = {
        "paper's bytes / CDR on the wire": ", ".join(sizes),
        "what the paper's bytes are": "the size of the value as a Python object",
    }
    return Finding(
        estimate=exactly(1 - len(wrong) / len(names), "share of messages that match"),
        details=details,
        reason=f"not as printed: {', '.join(wrong)}" if wrong else "",
    )


def checked(run: Run[Config], prefix: str, details: dict[str, str]) -> Finding:
    """Return the share of checks that hold, in the property where it is lowest."""
    share = share_of_checks(run, f"{prefix}:")
    counts = {"properties": str(len(share.groups))}
    return Finding(estimate=share.estimate, details={**counts, **details}, reason=share.reason)


def rate_means(table: pd.DataFrame, column: str) -> pd.Series[float]:
    """Return the share of readings of all sensors that are not in a column, by reading rate."""
    sums = table.groupby("rate_hz")[["offered", column]].sum()
    return 1 - sums[column] / sums["offered"]


def by_rate(shares: pd.Series[float]) -> str:
    """Return shares by rate as a text."""
    return ", ".join(f"{share:.0%} at {rate} Hz" for rate, share in shares.items())


# --- Figures ----------------------------------------------------------------------------------

_SHADES = ("#cfe3f2", "#86b9de", "#3d8fc8", COLORS["proxy"])


@exp.figure("balancing_caches", size=(8.4, 6.2))
def draw_caches(figure: Figure, run: Run[Config]) -> None:
    """Draw what the local cache (LC) saves: readings of each sensor, and RTPS frames by kind."""
    frames = frames_saved(run)
    panels = figure.subplots(1 if frames.empty else 2, squeeze=False)[:, 0]
    changes = run["table_one"].set_index("sensor")["change_s"]
    names = [f"{name}\nchanges every\n{changes[name]:g} s" for name in saved(run).index]
    draw_shares(panels[0], saved(run), names)
    panels[0].set_ylabel("readings suppressed (%)")
    place = {"loc": "upper center", "bbox_to_anchor": (0.5, 1.3)}
    panels[0].legend(title="reading rate (above), Rmax (below)", ncols=4, **place)
    if not frames.empty:
        names = [f"{frame}\ncompared with\n{method}" for method, frame in frames.index]
        draw_shares(panels[1], frames, names)
        panels[1].set_ylabel("frames saved by LC (%)")
    highest = saved(run).iloc[:, -1].mean()
    figure.suptitle(
        f"At {saved(run).columns[-1]} Hz the local cache (LC) suppresses {highest:.0%} of the "
        "readings (mean of the sensors)"
    )
    what = f"random readings of {run.config.readings_s:g} s per sensor, one run"
    note(figure, f"{what}; frames: RTPS model, reference run of transmission")


def draw_shares(axes: Axes, shares: pd.DataFrame, names: Sequence[str]) -> None:
    """Draw shares as one group of bars per row and one bar per rate."""
    percent = (100 * shares).rename(columns=lambda rate: f"{rate} Hz")
    grouped_bars(axes, percent, _SHADES, width=0.8)
    axes.set_xticks(range(len(names)), names, fontsize=8)
    axes.set_ylim(0, 100)


_DEMAND = "demand on the channel if all hosts contend"


@exp.figure("balancing_qos", size=(10, 4.4))
def draw_qos(figure: Figure, run: Run[Config]) -> None:
    """Draw the published optimum (Eq. 6), and the share of the channel that methods ask for."""
    rates, channel = figure.subplots(1, 2)
    draw_optimum(rates, run["balance"])
    rates.set_xlim(0, 1.45 * max(run.config.rates_hz))
    loads = 100 * channel_loads(run)
    styles = {name: {"color": color, "label": name} for name, color in METHODS.items()}
    lines(channel, loads, styles, marker="o", markersize=4)
    channel.axhline(100, color="black", linestyle="--", linewidth=1)
    channel.text(loads.index[-1], 108, "saturated", ha="right", va="bottom", fontsize=8)
    channel.set(xlabel="Rmax (Hz)", ylabel=f"{_DEMAND} (%)", yscale="log")
    channel.set_yticks([10, 100, 1000], ["10", "100", "1000"])
    channel.set_title("topics of paper B on a channel of 20 Mbit/s", fontsize=9)
    channel.legend(fontsize=8)
    most = loads[OPT]
    figure.suptitle(
        "Balanced QoS (OPT, Eq. 6) ignores the channel: "
        f"at Rmax = {most.index[-1]} Hz it needs {most.iloc[-1]:.0f} % of it"
    )
    note(
        figure,
        'Eq. 6 with Rmin 1 Hz and Dmin 1; demand as sfglab qos computes it; LC passes each "Hello"',
    )


def draw_optimum(axes: Axes, balance: pd.DataFrame) -> None:
    """Draw R of Eq. 6 over Rmax, by CVXPY as markers on the lines of the closed form."""
    chosen = balance.query("weight == 0.5 and rate_min_hz == 1 and depth_min == 1")
    by_topics: Any = {"index": "rate_max_hz", "columns": "topics", "sort": False}
    closed = chosen.pivot_table(values="rate_closed_hz", **by_topics)
    lines(axes, closed, {}, color="black", linewidth=1)
    solved = chosen.pivot_table(values="rate_hz", **by_topics)
    lines(axes, solved, {}, color=COLORS["proxy"], marker="o", markersize=4, linestyle="")
    for row in lines_of(chosen[chosen["rate_max_hz"] == chosen["rate_max_hz"].max()]):
        text = f"{mean_topics(row.topics):.3g} topics, D = {row.depth:.0f}"
        place = (row.rate_max_hz, row.rate_hz)
        axes.annotate(text, place, (6, 0), textcoords="offset points", fontsize=8, va="center")
    axes.set(xlabel="Rmax (Hz)", ylabel="common rate R (Hz)")
    axes.set_title("by mean number of topics per robot: CVXPY (dots), closed form (lines)")
    axes.title.set_fontsize(9)


# --- Explorers --------------------------------------------------------------------------------


def behind_cache(
    rate_hz: float, change_s: Floats, silence_s: float, loss: float
) -> tuple[Floats, Floats]:
    """Return what the station gets from a sensor behind a local cache.

    Times between changes are exponential, and each new value differs from all before. Messages
    are BEST_EFFORT: none is sent again, and a value is outdated until a message with a newer one
    arrives.

    Args:
        rate_hz: Reading rate, Hz.
        change_s: Mean times between changes, shape (n,), s.
        silence_s: Maximum silence, after which an equal value is sent, s. 0: no cache.
        loss: Share of messages that are lost.

    Returns:
        Rate of messages, Hz, and share of readings at which the station has an outdated value;
        both of shape (n,).
    """
    readings_per_silence = max(1.0, silence_s * rate_hz)
    changed = -np.expm1(-1 / (rate_hz * change_s))
    changed_in_silence = -np.expm1(-readings_per_silence / (rate_hz * change_s))
    messages_hz = rate_hz * (changed / changed_in_silence)
    outdated = loss * changed_in_silence / (1 - loss * (1 - changed_in_silence))
    return messages_hz, outdated


Loss = Annotated[float, Bounds(0, 0.9)]
Silence = Annotated[float, Bounds(0.05, 60, log=True)]
CACHE_COLORS = {
    "no cache": METHOD_COLORS["none"],
    "local cache (LC)": METHOD_COLORS["LC"],
    "LC with a maximum silence": COLORS["fourth"],
}
"""Colours of curves by kind of cache."""
_SENSORS_S = sorted({sensor.change_s for sensor in SENSORS.values()})
_CHANGES_S = np.unique([*np.geomspace(0.001, 100, 41), *_SENSORS_S])
_CHANGE = pictures.Axis(
    "mean time between changes", "s", 0.001, 100, log=True, ticks=(0.001, 0.01, 0.1, 1, 10, 100)
)
_MESSAGES = pictures.Axis(
    "messages", "1/s", 0.005, 1000, log=True, ticks=(0.01, 0.1, 1, 10, 100, 1000)
)
_OUTDATED = pictures.Axis("readings with an outdated value", "%", 0, 100, si=True)


@exp.explorer
def cache_curves(
    *, rate_hz: Rate = 100, loss: Loss = 0.2, silence_s: Silence = 1.0
) -> pictures.Picture:
    """Return the rate of messages with and without a local cache, and how often a value is outdated.

    Args:
        rate_hz: Rate at which the sensor is read [Hz].
        loss: Share of messages that are lost; BEST_EFFORT, so that none is sent again.
        silence_s: Maximum silence, after which the cache sends an equal value [s].
    """
    messages = pd.DataFrame(index=_CHANGES_S)
    outdated = pd.DataFrame(index=_CHANGES_S)
    for name, silent_s in zip(CACHE_COLORS, (0.0, math.inf, silence_s), strict=True):
        messages[name], shares = behind_cache(rate_hz, _CHANGES_S, silent_s, loss)
        outdated[name] = 100 * shares
    said = (
        f"Messages and outdated values of a sensor read at {rate_hz} Hz, over the mean time between "
        f"changes; {loss:.0%} of the messages are lost. Dots: the sensors of Table 1."
    )
    panels = (
        curves("messages sent", _CHANGE, _MESSAGES, messages, _SENSORS_S),
        curves("outdated values at the station", _CHANGE, _OUTDATED, outdated, _SENSORS_S),
    )
    return pictures.Picture(said=said, panels=panels)


def curves(
    title: str, x: pictures.Axis, y: pictures.Axis, frame: pd.DataFrame, dots: list[float]
) -> pictures.Panel:
    """Return a panel with a curve for each column of a table, and dots at some of its positions."""
    series = []
    for name, values in frame.items():
        color = {**CACHE_COLORS, **METHODS}[str(name)]
        line = pictures.Series(
            name=str(name), color=color, x=frame.index.tolist(), y=values.tolist()
        )
        dot = pictures.Series(
            name=str(name), color=color, kind="dot", x=dots, y=values[dots].tolist()
        )
        series += [line, dot]
    return pictures.Panel(title=title, x=x, y=y, series=tuple(series))


Topics = Annotated[int, Bounds(1, 20)]
RateMin = Annotated[float, Bounds(0.1, 100, log=True)]
DepthMin = Annotated[int, Bounds(1, 1000, log=True)]
_RATES_MAX_HZ = np.geomspace(10, 1000, 25).round(3).tolist()
_RATE_MAX = pictures.Axis("Rmax", "Hz", 10, 1000, log=True, ticks=(10, 100, 1000))
_RATE = pictures.Axis("rate R", "Hz", 0.1, 1000, log=True, ticks=(0.1, 1, 10, 100, 1000))
_DEPTH = pictures.Axis("depth D", "samples", 0, DEPTH_MAX, si=True)
_LOAD = pictures.Axis(_DEMAND, "%", 0.1, 10_000, log=True, ticks=(0.1, 1, 10, 100, 1000, 10_000))


@exp.explorer
def optimum_curves(
    *,
    topics_per_agent: Topics = 6,
    rate_max_hz: Rate = 100,
    rate_min_hz: RateMin = 1.0,
    depth_min: DepthMin = 1,
) -> pictures.Picture:
    """Return the published optimum (Eq. 6) over Rmax, and the demand on the channel by method.

    Args:
        topics_per_agent: Mean number of topics per robot, T_avg.
        rate_max_hz: Rate at which one topic alone could be sent, Rmax, of the dots [Hz].
        rate_min_hz: Lowest rate, Rmin [Hz].
        depth_min: Lowest depth, Dmin [samples].

    Raises:
        InvalidValueError: Rmin is above Rmax.
        InfeasibleBalanceError: No rate and depth satisfy Eq. 4 and 5 at this Rmax.
    """
    problem = BalanceInput(
        topics=(topics_per_agent,),
        rate_max_hz=rate_max_hz,
        rate_min_hz=rate_min_hz,
        depth_min=depth_min,
    )
    rows = {rate_max_hz: optimum_row(problem)}
    for rate_hz in _RATES_MAX_HZ:
        # Where there is no optimum, there is no curve.
        with suppress(InfeasibleBalanceError, InvalidValueError):
            rows[rate_hz] = optimum_row(replace(problem, rate_max_hz=rate_hz))
    table = pd.DataFrame.from_dict(rows, orient="index").sort_index()
    said = (
        f"The published optimum for {topics_per_agent} topics per robot over Rmax, and the demand "
        f"of paper B's topics on the channel. Dots: Rmax {rate_max_hz} Hz."
    )
    dots = [float(rate_max_hz)]
    rates = table[["R"]].set_axis([OPT], axis=1)
    depths = table[["D"]].set_axis([OPT], axis=1)
    panels = (
        curves("rate of all topics", _RATE_MAX, _RATE, rates, dots),
        curves("depth of their histories", _RATE_MAX, _DEPTH, depths, dots),
        curves("channel", _RATE_MAX, _LOAD, 100 * table[list(METHODS)], dots),
    )
    return pictures.Picture(said=said, panels=panels)


def optimum_row(problem: BalanceInput) -> dict[str, float]:
    """Return R, Hz, and D of Eq. 6, and the demand on the channel by method."""
    found = balance_closed_form(problem)
    loads = loads_of(exp.config().topic_file, found, problem.rate_max_hz)
    return {"R": found.rate_hz, "D": found.depth, **loads}
