"""Claims, figures and the explorer of caches and balanced QoS.

Balanced QoS is Eq. 6 of the paper. From Rmax, the rate at which one topic alone could be sent, Eq. 6 gives the rate R
of all topics and the depth D of the topics' histories.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING, Annotated

import numpy as np
import pandas as pd

from sfglab.arp.balancing import BalanceInput, balance_closed_form
from sfglab.arp.link import Link, at_depths, link_of
from sfglab.arp.robots import SENSORS, Rate, cdr_bytes
from sfglab.arp.topics import load_topics
from sfglab.fields import Bounds
from sfglab.lab import pictures
from sfglab.lab.checks import share_of_checks, shown_checks
from sfglab.lab.claims import Finding, How
from sfglab.lab.experiments import experiment
from sfglab.lab.experiments.balancing.experiment import Config, exp
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

    The column `held` is the share of readings that the local cache suppresses, `bytes` is the size of all readings.
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
"""Pairs of methods of `transmission` without and with the local cache, by the name of the method without the cache."""


@derived
def frames_saved(run: Run[Config]) -> pd.DataFrame:  # noqa: ARG001 - kept with the run
    """Return the share of frames that the local cache saves in the reference run of `transmission`.

    The shares are of sums over depths and seeds. The cache suppresses only readings of the sensors, no "Hello".

    Returns:
        One row per pair of methods and kind of frame, one column per Rmax.
    """
    log = find_project().reference_logs / "transmission.mcap"
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
"""Colours of the methods whose demand on the channel the figure shows."""


@derived
def channel_loads(run: Run[Config]) -> pd.DataFrame:
    """Return the share of the channel that the file's topics demand, one row per Rmax, one column per method.

    The share is the demand if all hosts contend; a share above 1 exceeds the channel. If hosts seldom contend, the
    utilisation that a simulation measures is lower. The local cache is a cache of the sensors of Table 1. The cache
    passes each "Hello", because each "Hello" has a new number, as in `sfglab.arp.hello`.
    """
    given = load_topics(find_project().data / run.config.topic_file)
    cached = []
    for topic in given.topics:
        is_sensor = topic.name.rpartition("/")[2] in SENSORS
        cached.append(replace(topic, cached=is_sensor))
    plain = link_of(given)
    with_cache = link_of(replace(given, topics=tuple(cached)))
    topics = given.topics_of_agents()
    rows = {}
    for rate_max_hz in run.config.rates_hz:
        found = balance_closed_form(BalanceInput(topics=topics, rate_max_hz=rate_max_hz))
        cases = ((plain, rate_max_hz), (plain, found.rate_hz), (with_cache, found.rate_hz))
        rows[rate_max_hz] = [demand(link, rate_hz, int(found.depth)) for link, rate_hz in cases]
    return pd.DataFrame.from_dict(rows, orient="index", columns=[*METHODS])


def demand(link: Link, rate_hz: float, depth: int) -> float:
    """Return the share of the channel that topics demand with one rate and one depth for all topics."""
    rates_hz = np.full(len(link.loss), rate_hz)
    depths = np.full(len(link.loss), depth)
    return at_depths(link, depths, rates_hz).utilisation(rates_hz)


_PROPERTIES = {
    "LC: what passes is the first value and every change, nothing else": "LC: the first value and each change pass, "
    "no other value",
    "CC: planning gets the first value and every change, nothing else": "CC: planning receives the first value and "
    "each change, no other value",
    "CC: after a local cache planning gets the same": "CC behind a local cache: planning receives the same",
    "OPT: Eq. 5 holds with nothing to spare, and Dmin <= D <= Dmax": "OPT: Eq. 5 holds as an equality, and "
    "Dmin <= D <= Dmax",
    "LC: the counters say what was held": "LC: the counters equal the suppressed bytes",
    "LC: no silence is longer than allowed": "LC: no silence is longer than the maximum",
    "LC: with a longest silence every change still passes at once": "LC: with a maximum silence every change "
    "passes at once",
    "LC: of what comes through losses planning gets the first and every change": "LC behind losses: planning "
    "receives the first value that arrives and each change",
    "LC: after losses planning ends with the sensor's value": "LC behind losses: planning ends with the sensor's "
    "value",
    "CC: of what comes through losses planning gets the first and every change": "CC behind losses: planning "
    "receives the first value that arrives and each change",
    "CC: after losses planning ends with the sensor's value": "CC behind losses: planning ends with the sensor's "
    "value",
    "OPT: CVXPY finds an optimum where the closed form does, and nowhere else": "OPT: CVXPY and the closed form find "
    "an optimum for the same inputs",
}
"""Sentences for readers, by the names of checks in logs."""


def check_table(run: Run[Config]) -> pd.DataFrame:
    """Return the checks of a run as a notebook shows them."""
    return shown_checks(run["check"], _PROPERTIES)[["property", "cases", "cases that hold"]]


# --- Claims -----------------------------------------------------------------------------------

TABLE_1 = {
    **dict.fromkeys(("lidar", "dht11", "imu", "ultrasonic"), ("std_msgs/msg/Float32", 24)),
    "flame": ("std_msgs/msg/Bool", 28),
    "light": ("std_msgs/msg/String", 54),
    "pir": ("std_msgs/msg/String", 59),
}
"""Types and sizes of messages, bytes, from the paper's text alone."""


@exp.claim("B-LC", how=How.EXACT)
def local_cache(run: Run[Config]) -> Finding:
    """Return the share of the local cache's checks that hold, and in the details the savings of the local cache."""
    table = caches(run)
    sums = table.groupby("rate_hz")[["held_bytes", "bytes"]].sum()
    details = {
        "fewer messages sent": by_rate(rate_means(table, "sent")),
        "fewer bytes sent": by_rate(sums["held_bytes"] / sums["bytes"]),
    }
    for row in lines_of(run["recorded"].query("silence_s == 0")):
        details[f"fewer messages sent, {row.sensor}"] = f"{1 - row.sent / row.offered:.0%}"
    frames = frames_saved(run)
    for method, frame in frames.index:
        shares = frames.loc[(method, frame)]
        details[f"fewer {frame} frames than with {method}"] = by_rate(shares)
    return checked(run, "LC", details)


@exp.claim("B-CC", how=How.EXACT)
def cache_control(run: Run[Config]) -> Finding:
    """Return the share of cache control's checks that hold."""
    fewer = by_rate(rate_means(caches(run), "planned"))
    return checked(run, "CC", {"fewer messages planned with": fewer})


@exp.claim("B-OPT", how=How.EXACT)
def optimum(run: Run[Config]) -> Finding:
    """Return the share of the checks of Eq. 1 to 6 that hold."""
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
    table = run["table_one"].set_index("sensor")
    wrong = []
    for name, (kind, size_bytes) in TABLE_1.items():
        sent = table[table.index == name][["type", "table_bytes", "object_bytes"]]
        if sent.to_numpy().tolist() != [[kind, size_bytes, size_bytes]]:
            wrong.append(name)
    sizes = table["table_bytes"].astype(str) + "/" + table["cdr_bytes"].astype(str)
    details = {
        "paper's bytes / CDR on the wire": ", ".join(sizes.index + " " + sizes),
        "what the paper's bytes are": "the size of the value as a Python object",
    }
    return Finding(
        estimate=exactly(1 - len(wrong) / len(TABLE_1), "share of messages that match"),
        details=details,
        reason=f"not as printed: {', '.join(wrong)}" if wrong else "",
    )


def checked(run: Run[Config], prefix: str, details: dict[str, str]) -> Finding:
    """Return the share of checks that hold of the property with the lowest share."""
    share = share_of_checks(run, f"{prefix}:")
    counts = {"properties": str(len(share.groups))}
    return Finding(estimate=share.estimate, details={**counts, **details}, reason=share.reason)


def rate_means(table: pd.DataFrame, column: str) -> pd.Series[float]:
    """Return the share of all sensors' readings that are not in a column, by reading rate."""
    sums = table.groupby("rate_hz")[["offered", column]].sum()
    return 1 - sums[column] / sums["offered"]


def by_rate(shares: pd.Series[float]) -> str:
    """Return shares by rate, in Hz, as a text such as "12% at 50 Hz"."""
    return ", ".join(f"{share:.0%} at {rate} Hz" for rate, share in shares.items())


# --- Figures ----------------------------------------------------------------------------------

_SHADES = ("#cfe3f2", "#86b9de", "#3d8fc8", COLORS["proxy"])


@exp.figure("balancing_caches", size=(9.4, 6.2))
def draw_caches(figure: Figure, run: Run[Config]) -> None:
    """Draw what the local cache (LC) saves: readings of each sensor, and RTPS frames by kind."""
    suppressed, frames = saved(run), frames_saved(run)
    readings, transport = figure.subplots(2)
    changes = run["table_one"].set_index("sensor")["change_s"]
    names = [f"{name}\nchanges every\n{changes[name]:g} s" for name in suppressed.index]
    draw_shares(readings, suppressed, names)
    readings.set_ylabel("readings suppressed (%)")
    readings.set_title(
        "Readings that the local cache suppresses, by sensor and reading rate", fontsize=9
    )
    transport.set_title("Frames that the local cache saves, by kind, method and Rmax", fontsize=9)
    handles = readings.get_legend_handles_labels()
    figure.legend(*handles, loc="outside right center", title="reading rate\nor Rmax")
    names = [f"{frame}\n{PAIRS[name][1]} instead of\n{name}" for name, frame in frames.index]
    draw_shares(transport, frames, names)
    transport.set_ylabel("frames saved by LC (%)")
    figure.suptitle(
        f"At {suppressed.columns[-1]} Hz the local cache (LC) suppresses "
        f"{100 * suppressed.iloc[:, -1].mean():.0f} % of the readings (mean of the sensors)"
    )
    readings_text = f"random readings of {run.config.readings_s:g} s per sensor, one run"
    note(figure, f"{readings_text}; frames: simulated, reference run of notebook 22")


def draw_shares(axes: Axes, shares: pd.DataFrame, names: Sequence[str]) -> None:
    """Draw shares, 0 to 1, in per cent: one group of bars per row with its name, and one bar per rate, Hz."""
    percent = (100 * shares).rename(columns=lambda rate: f"{rate} Hz")
    grouped_bars(axes, percent, _SHADES)
    axes.set_xticks(range(len(names)), names, fontsize=8)
    axes.set_ylim(0, 100)


@exp.figure("balancing_qos", size=(7, 4.4))
def draw_qos(figure: Figure, run: Run[Config]) -> None:
    """Draw the share of the channel that paper B's topics need, by method."""
    loads = 100 * channel_loads(run)
    axes = figure.subplots()
    styles = {name: {"color": color} for name, color in METHODS.items()}
    lines(axes, loads, styles, marker="o", markersize=4)
    for name in METHODS:
        axes.text(1.03 * loads.index[-1], loads[name].iloc[-1], name, va="center", fontsize=8)
    axes.set_xticks(loads.index)
    axes.set_xlim(0, 1.4 * loads.index[-1])
    axes.axhline(100, color="black", linestyle="--", linewidth=1)
    axes.text(1.38 * loads.index[-1], 95, "above: saturated", ha="right", va="top", fontsize=8)
    demand_text = "demand on the channel (%)"
    axes.set(xlabel="Rmax (Hz)", ylabel=demand_text, yscale="log")
    axes.set_yticks([10, 100, 1000], ["10", "100", "1000"])
    most, cached = loads[OPT], loads.iloc[:, -1]
    figure.suptitle(
        f"At Rmax = {most.index[-1]} Hz balanced QoS (OPT, Eq. 6) needs {most.iloc[-1]:.0f} %\n"
        f"of the channel, with the local cache (LC) {cached.iloc[-1]:.0f} %"
    )
    note(
        figure,
        'topics of paper B, assumed channel of 20 Mbit/s; all hosts contend; LC passes each "Hello"',
    )


# --- Explorers --------------------------------------------------------------------------------


def behind_cache(
    rate_hz: float, change_s: Floats, silence_s: float, loss: float
) -> tuple[Floats, Floats]:
    """Return the messages and values that the station gets from a sensor behind a local cache.

    Times between changes are exponential, and each new value differs from all values before. Messages
    are BEST_EFFORT: a lost message is not sent again, and a value is outdated until a message with a newer value
    arrives.

    Args:
        rate_hz: Reading rate, Hz.
        change_s: Mean times between changes, shape (n,), s.
        silence_s: Maximum silence, after which the cache sends an equal value, s. 0: no cache.
        loss: Share of messages that the link loses.

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


LossPercent = Annotated[float, Bounds(0, 90)]
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
    *, rate_hz: Rate = 100, loss_percent: LossPercent = 20.0, silence_s: Silence = 1.0
) -> pictures.Picture:
    """Return the rate of messages with and without a local cache, and how often a value is outdated.

    Args:
        rate_hz: Rate at which the sensor is read [Hz].
        loss_percent: Messages that are lost; BEST_EFFORT, so that none is sent again [%].
        silence_s: Maximum silence, after which the cache sends an equal value [s].
    """
    messages = pd.DataFrame(index=_CHANGES_S)
    outdated = pd.DataFrame(index=_CHANGES_S)
    for name, silent_s in zip(CACHE_COLORS, (0.0, math.inf, silence_s), strict=True):
        messages[name], shares = behind_cache(rate_hz, _CHANGES_S, silent_s, loss_percent / 100)
        outdated[name] = 100 * shares
    said = (
        f"Messages and outdated values of a sensor read at {rate_hz} Hz, over the mean time between "
        f"changes; {loss_percent:g} % of the messages are lost. Dots: the sensors of Table 1."
    )
    panels = (
        curves("messages sent", _MESSAGES, messages),
        curves("outdated values at the station", _OUTDATED, outdated),
    )
    return pictures.Picture(said=said, panels=panels)


def curves(title: str, axis: pictures.Axis, table: pd.DataFrame) -> pictures.Panel:
    """Return a panel with a curve for each column of a table, and dots at the sensors of Table 1."""
    drawn = pictures.lines(table, CACHE_COLORS)
    dots = pictures.lines(table.loc[_SENSORS_S], CACHE_COLORS, "dot")
    return pictures.Panel(title=title, x=_CHANGE, y=axis, series=(*drawn, *dots))
