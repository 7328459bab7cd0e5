"""Discovery times and received bytes of agents, the claims A-DISC-*, and Fig. 9 of paper A.

The claims use fleets that are small enough for this machine's cores. Agents with routers start one
after another. Standard fleets have few nodes, and their bytes are extrapolated to the paper's number of
nodes. An agent that did not discover its peers in time counts with the duration of the wait.
"""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from sfglab.lab.claims import Finding, How
from sfglab.lab.experiments.discovery.experiment import (
    LAUNCHED,
    ROUTED,
    STANDARD,
    Config,
    exp,
)
from sfglab.lab.figures import default_sidecar, note, series
from sfglab.lab.paper import paper
from sfglab.lab.runs import Run, derived
from sfglab.lab.stats import Estimate, Floats, bootstrap

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    Few = tuple[int, Floats]  # number of nodes per agent, and received bytes

PAPERS_LARGEST = 6  #: Number of agents that the claims are about.
SLOWER = "at two thirds of the pace"
NAMES = {STANDARD: "plain ROS 2", LAUNCHED: "paper's method", ROUTED: "sfglab variant"}
"""Name for readers by live mode."""
SHORT = {LAUNCHED: "paper", ROUTED: "sfglab"}  #: Shorter names for titles.
TIME, BYTES = "resolved_s", "own_bytes"
STANDARD_MB = "MB at 6 agents, standard"  #: Key of the paper's bytes of the standard fleet.
RECEIVED_MB = "MB received by standard"  #: Key of the bytes of sfglab's standard fleet.


# --- Fleets -----------------------------------------------------------------------------------


@derived
def agents_of(run: Run[Any]) -> pd.DataFrame:
    """Return one row per agent of the live fleets, with its fleet's columns, `nodes` and `cpu_s`."""
    fleets = run["cell"]
    fleets = fleets.assign(nodes=fleets["talkers"] + fleets["listeners"])
    return run["host"].merge(fleets, on="cell")


@derived
def main_nodes(run: Run[Config]) -> int:
    """Return the largest number of nodes per agent, with which the methods are compared."""
    return int(agents_of(run)["nodes"].max())


@derived
def main_fleets(run: Run[Config]) -> pd.DataFrame:
    """Return the rows of `agents_of` of fleets with the most nodes per agent."""
    return agents_of(run).query("nodes == nodes.max()")


def samples(rows: pd.DataFrame, column: str) -> Floats:
    """Return a column of the agents of fleets of one size in the form for the bootstrap, shape (n, ...).

    One row is one fleet, because the agents of a fleet are not independent. For a single fleet, one row is one agent.
    """
    table = rows.pivot_table(column, "cell", "host").to_numpy(dtype=np.float64)
    return table if len(table) > 1 else table.T


def at_pace(run: Run[Config], mode: str, agents: int) -> pd.DataFrame:
    """Return the rows of main fleets of one mode and size whose agents were started one by one (``pace_s`` > 0)."""
    table = main_fleets(run)
    return table[(table["mode"] == mode) & (table["agents"] == agents) & (table["pace_s"] > 0)]


def by_pace(run: Run[Config], mode: str, agents: int, column: str) -> list[Floats]:
    """Return `samples` of the rows of `at_pace` for each pace, the fastest pace first."""
    paces = at_pace(run, mode, agents).groupby("pace_s")
    return [samples(rows, column) for _, rows in paces]


def by_nodes(run: Run[Config]) -> list[Few]:
    """Return the bytes received by agents of standard fleets with fewer nodes, by number of nodes."""
    few = agents_of(run).query(
        "mode == @STANDARD and agents == @PAPERS_LARGEST and nodes < nodes.max()"
    )
    by_number: Any = few.groupby("nodes")
    return [(int(nodes), samples(rows, BYTES)) for nodes, rows in by_number]


def fleet_table(run: Run[Config]) -> pd.DataFrame:
    """Return medians over agents and fleets, and busy cores, by method, size, nodes and pace, largest fleets first."""
    table = agents_of(run).rename(
        columns={"nodes": "nodes per agent", "pace_s": "time between starts (s)"}
    )
    table = table.assign(method=table["mode"].map(NAMES))
    by = ["method", "agents", "nodes per agent", "time between starts (s)"]
    agents = table.groupby(by)
    fleets = table.drop_duplicates("cell").groupby(by)
    columns = {
        "starts of the fleet": fleets.size(),
        "agents given up": agents["censored"].sum(),
        "discovery time, median (s)": agents[TIME].median(),
        "received per agent, median (kB)": agents[BYTES].median() / 1e3,
        "CPU time of the fleet (s)": fleets["cpu_s"].median(),
        "cores busy, mean": fleets["cpu_s"].sum() / fleets["window_s"].sum(),
    }
    found = pd.DataFrame(columns).reset_index()
    return found.sort_values("agents", ascending=False, kind="stable")


# --- Claims -----------------------------------------------------------------------------------


def extrapolated(wanted: int, less: Few, more: Few) -> float:
    """Return the median of the bytes that agents with a number of nodes receive.

    The bytes per node are on the line through those with two known numbers of nodes.
    """
    (few, received_by_few), (many, received_by_many) = less, more
    low = float(np.median(received_by_few)) / few
    high = float(np.median(received_by_many)) / many
    return wanted * (low + (high - low) / (many - few) * (wanted - few))


def fewer_bytes(less: Few, more: Few, wanted: int, routed: Floats) -> Estimate:
    """Estimate how much less routed agents receive than standard agents with a number of nodes, orders of magnitude.

    Args:
        less: Smaller number of nodes, and the bytes that standard agents with it received.
        more: Larger number of nodes, likewise.
        wanted: Number of nodes for which the bytes are extrapolated.
        routed: Samples of the bytes that routed agents received, as `samples` returns them.
    """

    def orders(groups: Sequence[Floats]) -> float:
        standard = extrapolated(wanted, (less[0], groups[0]), (more[0], groups[1]))
        return float(np.log10(standard / np.median(groups[2])))

    groups = [less[1], more[1], routed]
    return bootstrap(groups, orders, unit="orders of magnitude fewer bytes")


def median(groups: Sequence[Floats]) -> float:
    """Return the median of the only group of samples; a statistic for `bootstrap`."""
    return float(np.median(groups[0]))


def time_of(run: Run[Config], mode: str) -> Finding | None:
    """Return the discovery time in the paper's largest fleet; None without such fleets at a pace."""
    times = by_pace(run, mode, PAPERS_LARGEST, TIME)
    if not times:
        return None
    unit = f"s at {PAPERS_LARGEST} agents"
    estimates = [bootstrap([each], median, unit=unit) for each in times]
    ends = {}
    if few := by_pace(run, mode, 2, TIME):
        few_s = median(few)
        ends["s at 2 agents"] = few_s
        ends["times as long at 6 agents as at 2"] = estimates[0].value / few_s
    agents = at_pace(run, mode, PAPERS_LARGEST)
    cpu_s = agents.drop_duplicates("cell")["cpu_s"].median() / PAPERS_LARGEST
    reason = (
        f"starting one agent takes {cpu_s:.1f} s of CPU on this machine, which all agents share"
    )
    if given_up := agents["censored"].sum():
        reason += (
            f"; {given_up} of {len(agents)} agents were given up and count with the time waited"
        )
    return Finding(
        estimate=estimates[0],
        under=dict(zip([SLOWER], estimates[1:], strict=False)),
        ends=ends,
        reason=reason,
    )


def bytes_of(run: Run[Config], mode: str) -> Finding | None:
    """Return by how many orders of magnitude an agent receives fewer bytes than in the standard fleet.

    Returns:
        None if the run lacks fleets of the paper's size or of two numbers of nodes.
    """
    routed = by_pace(run, mode, PAPERS_LARGEST, BYTES)
    few = by_nodes(run)
    if not routed or len(few) < 2:
        return None
    wanted = main_nodes(run)
    under = {}
    for less, more in pairwise(few[1:]):
        under[f"with {less[0]} and {more[0]} nodes"] = fewer_bytes(less, more, wanted, routed[0])
    for name, received in zip([SLOWER], routed[1:], strict=False):
        under[name] = fewer_bytes(few[0], few[1], wanted, received)
    estimate = fewer_bytes(few[0], few[1], wanted, routed[0])
    own_kb = median(routed) / 1e3
    standard_mb = extrapolated(wanted, *few[:2]) / 1e6
    paper_mb = paper("A-DISC-BYTES", STANDARD_MB)
    paper_kb = 1e3 * paper_mb / 10 ** paper("A-DISC-BYTES")
    return Finding(
        estimate=estimate,
        under=under,
        ends={RECEIVED_MB: standard_mb},
        reason=f"with routers an agent receives {own_kb:.0f} kB (paper: about {paper_kb:.0f} kB), with "
        f"plain ROS 2 {standard_mb:.0f} MB, extrapolated (paper: {paper_mb} MB)",
    )


@exp.claim("A-DISC-TIME", how=How.LIVE)
def launched_time(run: Run[Config]) -> Finding | None:
    """Return the discovery time with the paper's method."""
    return time_of(run, LAUNCHED)


@exp.claim("A-DISC-BYTES", how=How.LIVE)
def launched_bytes(run: Run[Config]) -> Finding | None:
    """Return how much less agents receive with the paper's method than in the standard fleet."""
    return bytes_of(run, LAUNCHED)


@exp.claim("A-DISC-TIME-OURS", how=How.LIVE)
def routed_time(run: Run[Config]) -> Finding | None:
    """Return the discovery time with the sfglab variant."""
    return time_of(run, ROUTED)


@exp.claim("A-DISC-BYTES-OURS", how=How.LIVE)
def routed_bytes(run: Run[Config]) -> Finding | None:
    """Return how much less agents receive with the sfglab variant than in the standard fleet."""
    return bytes_of(run, ROUTED)


# --- Figures ----------------------------------------------------------------------------------

STYLES = {STANDARD: series("standard"), LAUNCHED: series("third"), ROUTED: series("proxy")}
SHIFTS = {STANDARD: -0.12, LAUNCHED: 0.0, ROUTED: 0.12}
"""Offset of the markers of a mode, so that they do not overlap."""
_STAR: dict[str, Any] = {"marker": "*", "markersize": 13, "linestyle": "", "fillstyle": "none"}
_STARTS: dict[str, dict[str, Any]] = {
    "filled: agents start one after the other": {"marker": "s", "linestyle": ""},
    "open: all agents start at once": {"marker": "s", "linestyle": "", "fillstyle": "none"},
    "paper A, Fig. 9: all at once": _STAR,
}
"""Styles of the markers by their meaning."""


def drawn_fleets(run: Run[Config]) -> pd.DataFrame:
    """Return the agents that Fig. 9 shows, with ``at_once``: fleets started at once, and at their fastest pace."""
    table = main_fleets(run)
    table = table.assign(at_once=table["pace_s"] == 0)
    fastest_s = table.groupby(["mode", "agents", "at_once"])["pace_s"].transform("min")
    return table[table["pace_s"] == fastest_s]


@exp.figure("discovery_fleet", size=(10, 5), when=lambda run: not run["cell"].empty)
def draw_fleet(figure: Figure, run: Run[Config]) -> dict[str, Any]:
    """Draw the discovery time (left) and the received bytes (right) of each agent, over the number of agents."""
    fleets = drawn_fleets(run)
    time_axes, bytes_axes = figure.subplots(1, 2)
    times_s = {
        (PAPERS_LARGEST, STANDARD): paper("A-DISC-TIME", "s at 6 agents, standard"),
        (2, LAUNCHED): paper("A-DISC-TIME", "s at 2 agents"),
        (PAPERS_LARGEST, LAUNCHED): paper("A-DISC-TIME"),
    }
    standard = 1e6 * paper("A-DISC-BYTES", STANDARD_MB)
    received = {
        (PAPERS_LARGEST, STANDARD): standard,
        (PAPERS_LARGEST, LAUNCHED): standard / 10 ** paper("A-DISC-BYTES"),
    }
    draw_agents(time_axes, fleets, TIME, "s", times_s)
    draw_agents(bytes_axes, fleets, BYTES, "B", received)
    time_axes.set_ylabel("discovery time per agent (s)")
    bytes_axes.set_ylabel("received per agent during discovery")
    for mode, name in NAMES.items():
        time_axes.plot([], [], linestyle="", markersize=5, label=name, **STYLES[mode])
    time_axes.legend(loc="upper left", fontsize=9)
    for label, style in _STARTS.items():
        bytes_axes.plot([], [], color="black", label=label, **style)
    bytes_axes.legend(loc=(0.1, 0.42), fontsize=9)
    findings = {mode: time_of(run, mode) for mode in SHORT}
    took = [f"{one.estimate.value:.2g} s ({NAMES[m]})" for m, one in findings.items() if one]
    time_axes.set_title(
        f"{PAPERS_LARGEST} agents discover each other in\n{' and '.join(took)}"
        if took
        else "Discovery time",
        fontsize=10,
    )
    title = "Received bytes"
    saved = []
    for mode in (LAUNCHED, ROUTED):
        if finding := bytes_of(run, mode):
            times = float(f"{10**finding.estimate.value:.2g}")
            saved.append(f"1/{times:g} ({SHORT[mode]})")
    if saved:
        few = by_nodes(run)[:2]
        draw_extrapolated(bytes_axes, main_nodes(run), *few)
        standard_mb = extrapolated(main_nodes(run), *few) / 1e6
        title = (
            f"Each agent receives {' and '.join(saved)} of\n"
            f"the {standard_mb:.0f} MB that are extrapolated for plain ROS 2"
        )
    bytes_axes.set_title(title, fontsize=10)
    shown = {**default_sidecar(run), "repetitions": int(fleets["repeat"].nunique())}
    note(
        figure,
        f"live, {main_nodes(run)} nodes per agent; one marker per agent; bars: medians; run on {shown['machine']}",
    )
    return shown


def draw_agents(
    axes: Axes,
    table: pd.DataFrame,
    column: str,
    unit: str,
    stated: Mapping[tuple[int, str], float],
) -> None:
    """Draw one marker per agent, bars at medians, and the paper's values, on a logarithmic axis.

    Args:
        axes: Axes to draw into.
        table: One row per agent.
        column: Column with the values.
        unit: Unit of the values.
        stated: The paper's values by number of agents and mode.
    """
    from matplotlib.ticker import EngFormatter, NullLocator

    groups: Any = table.groupby(["mode", "at_once"])
    for (mode, at_once), rows in groups:
        style = {**STYLES[mode], "fillstyle": "none" if at_once else "full"}
        places = rows["agents"] + SHIFTS[mode] - 0.07 * at_once
        axes.plot(places, rows[column], linestyle="", markersize=4, **style)
        medians = rows.groupby(places)[column].median()
        axes.plot(medians, "_", color=style["color"], markersize=11, markeredgewidth=1)
    for (agents, mode), value in stated.items():
        axes.plot(agents, value, color=STYLES[mode]["color"], **_STAR)
    axes.set_xticks(sorted(table["agents"].unique()))
    axes.set(xlabel="number of agents", yscale="log")
    axes.yaxis.set_major_formatter(EngFormatter(unit=unit))
    axes.yaxis.set_minor_locator(NullLocator())


def draw_extrapolated(axes: Axes, nodes: int, less: Few, more: Few) -> None:
    """Draw the bytes of the standard fleet that the claims use."""
    received = extrapolated(nodes, less, more)
    at = (PAPERS_LARGEST + SHIFTS[STANDARD], received)
    axes.plot(*at, "x", color=STYLES[STANDARD]["color"], markersize=8)
    text = f"{received / 1e6:.0f} MB, extrapolated from\n{less[0]} and {more[0]} nodes per agent"
    side: dict[str, Any] = {"textcoords": "offset points", "ha": "right", "va": "center"}
    axes.annotate(text, at, (-8, 0), fontsize=9, **side)
