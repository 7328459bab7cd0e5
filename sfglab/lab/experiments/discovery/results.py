"""Discovery times and received bytes of agents, the claims A-DISC-*, and Fig. 9 of paper A.

Claims are judged on fleets that are small enough for this machine's cores. Agents with routers start one
after another. Standard fleets have few nodes, and their bytes are extrapolated to the paper's number of
nodes. An agent that was given up counts with the time that was waited.
"""

from __future__ import annotations

from functools import cache
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from sfglab.lab.claims import Finding, How
from sfglab.lab.experiments.discovery.experiment import (
    LAUNCHED,
    PUBLISHING,
    QUERYING,
    ROUTED,
    STANDARD,
    Config,
    exp,
)
from sfglab.lab.experiments.discovery.simulated import CORES, ENDPOINTS_PER_NODE
from sfglab.lab.figures import COLORS, default_sidecar, note, series
from sfglab.lab.paper import paper
from sfglab.lab.paths import find_project
from sfglab.lab.runs import Run, derived, lines_of
from sfglab.lab.stats import Estimate, Floats, bootstrap, rounded

if TYPE_CHECKING:
    from collections.abc import Sequence

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    Few = tuple[int, Floats]  # number of nodes per agent, and received bytes

PAPERS_LARGEST = 6  #: Number of agents that the claims are about.
LARGEST = 1000  #: Number of agents up to which formulas are drawn.
SLOWER = "at two thirds of the pace"
NAMES = {STANDARD: "plain ROS 2", LAUNCHED: "paper's method", ROUTED: "sfglab variant"}
"""Name for readers by live mode."""
SIMULATED_NAMES = {
    STANDARD: NAMES[STANDARD],
    QUERYING: NAMES[LAUNCHED],
    PUBLISHING: NAMES[ROUTED],
}
"""Name for readers by simulated mode."""
TIME, BYTES = "resolved_s", "own_bytes"
_AT_ONCE = 0.0


# --- Fleets -----------------------------------------------------------------------------------


@derived
def agents_of(run: Run[Config]) -> pd.DataFrame:
    """Return one row per agent of the live fleets, with its fleet's columns, `nodes` and `cpu_s`."""
    cells = run["cell"].drop(columns=[TIME, "censored"])
    fleets = cells.assign(
        nodes=cells["talkers"] + cells["listeners"],
        cpu_s=cells["nodes_cpu_s"] + cells["components_cpu_s"],
    )
    return run["host"].merge(fleets, on="cell")


@derived
def main_nodes(run: Run[Config]) -> int:
    """Return the number of nodes per agent with which standard and routed fleets were measured.

    If there are several such numbers, it is the largest; if there is none, the largest of all.
    """
    table = agents_of(run)
    is_standard = table["mode"] == STANDARD
    standard: set[int] = set(table.loc[is_standard, "nodes"].tolist())
    routed: set[int] = set(table.loc[~is_standard, "nodes"].tolist())
    return max((standard & routed) or (standard | routed))


@derived
def main_fleets(run: Run[Config]) -> pd.DataFrame:
    """Return the rows of `agents_of` of fleets with `main_nodes`."""
    table = agents_of(run)
    return table[table["nodes"] == main_nodes(run)] if len(table) else table


def samples(rows: pd.DataFrame, column: str) -> Floats:
    """Return a column of agents of fleets of one size, shape (fleets, agents)."""
    return rows.pivot_table(column, "cell", "host").to_numpy(dtype=np.float64)


def by_pace(run: Run[Config], mode: str, agents: int, column: str) -> list[Floats]:
    """Return the samples of main fleets of one size that were started at a pace, the fastest pace first."""
    table = main_fleets(run)
    of_size = table[(table["mode"] == mode) & (table["agents"] == agents)]
    at_pace = of_size[of_size["pace_s"] > _AT_ONCE].groupby("pace_s")
    return [samples(rows, column) for _, rows in at_pace]


def by_nodes(run: Run[Config]) -> list[Few]:
    """Return what agents of standard fleets with fewer nodes received, by their number of nodes."""
    table = agents_of(run)
    table = table[(table["mode"] == STANDARD) & (table["agents"] == PAPERS_LARGEST)]
    few: Any = table[table["nodes"] < main_nodes(run)].groupby("nodes")
    return [(int(nodes), samples(rows, BYTES)) for nodes, rows in few]


@derived
def summary(run: Run[Config]) -> pd.DataFrame:
    """Return medians over agents and fleets, and busy cores, by mode, size, nodes and pace."""
    table = agents_of(run)
    if table.empty:
        return pd.DataFrame()
    keys = ["mode", "agents", "nodes", "pace_s"]
    agents = table.groupby(keys)
    fleets = table.drop_duplicates("cell").groupby(keys)
    columns = {
        "fleets": fleets.size(),
        "agents_given_up": agents["censored"].sum(),
        "median_s": agents[TIME].median(),
        "lowest_s": agents[TIME].min(),
        "highest_s": agents[TIME].max(),
        "median_bytes": agents[BYTES].median(),
        "fleet_cpu_s": fleets["cpu_s"].median(),
        "cores_busy": fleets["cpu_s"].sum() / fleets["window_s"].sum(),
    }
    return pd.DataFrame(columns).reset_index()


def fleet_table(run: Run[Config]) -> pd.DataFrame:
    """Return `summary` with columns for readers, in the order of `NAMES`."""
    table = summary(run)
    if table.empty:
        return table
    columns = {
        "mode": "method",
        "agents": "agents",
        "nodes": "nodes per agent",
        "pace_s": "time between starts (s)",
        "fleets": "starts of the fleet",
        "agents_given_up": "agents given up",
        "median_s": "discovery time, median (s)",
        "lowest_s": "lowest (s)",
        "highest_s": "highest (s)",
        "received_kb": "received per agent, median (kB)",
        "fleet_cpu_s": "CPU time of the fleet (s)",
        "cores_busy": "cores busy, mean",
    }
    table = table.assign(received_kb=table["median_bytes"] / 1e3)
    table = table.sort_values("mode", key=lambda modes: modes.map([*NAMES].index), kind="stable")
    return table.assign(mode=table["mode"].map(NAMES))[[*columns]].rename(columns=columns)


def extrapolation(run: Run[Config]) -> pd.DataFrame:
    """Return received bytes of the paper's largest fleet with plain ROS 2, measured and extrapolated."""
    if agents_of(run).empty:
        return pd.DataFrame()
    known = [(nodes, float(np.median(received))) for nodes, received in by_nodes(run)]
    rows = [(nodes, received, "measured") for nodes, received in known]
    wanted = main_nodes(run)
    for less, more in pairwise(known):
        how = f"extrapolated from {less[0]} and {more[0]} nodes"
        if less == known[0]:
            how += ", used by the claims"
        rows.append((wanted, at_nodes(wanted, [less, more]), how))
    table = agents_of(run)
    of_size = (table["mode"] == STANDARD) & (table["agents"] == PAPERS_LARGEST)
    measured = table.loc[of_size & (table["nodes"] == wanted), BYTES]
    if len(measured):
        rows.append((wanted, float(measured.median()), "measured, limited by the cores"))
    lines = [(nodes, how, each / 1e6, each / nodes / 1e3) for nodes, each, how in rows]
    columns = ["nodes per agent", "origin", "received per agent (MB)", "per node (kB)"]
    return pd.DataFrame(lines, columns=columns)


def growth(run: Run[Config]) -> list[str]:
    """Return in words how much longer the paper's largest fleet takes than two agents, by method."""
    texts = []
    for mode in (LAUNCHED, ROUTED):
        few, many = (by_pace(run, mode, agents, TIME) for agents in (2, PAPERS_LARGEST))
        if few and many:
            few_s, many_s = float(np.median(few[0])), float(np.median(many[0]))
            text = f"{many_s:.2f} s with {PAPERS_LARGEST} agents, {few_s:.2f} s with 2"
            texts.append(f"{NAMES[mode]}: {text}: {many_s / few_s:.1f} times as long")
    return texts


# --- Claims -----------------------------------------------------------------------------------


def draws(table: Floats) -> Floats:
    """Return what is resampled: whole fleets, or the agents of the only fleet, as rows.

    The agents of a fleet are not independent. The interval of a single fleet is one of its agents.
    """
    return table if len(table) > 1 else table.reshape(-1, 1)


def median(table: Floats, unit: str) -> Estimate:
    """Estimate the median over the agents of fleets."""
    return bootstrap([draws(table)], lambda groups: float(np.median(groups[0])), unit=unit)


def at_nodes(wanted: int, known: Sequence[tuple[int, float]]) -> float:
    """Return the bytes of agents with a number of nodes; bytes per node are on the line through two known ones."""
    (few, low), (more, high) = known
    slope = (high / more - low / few) / (more - few)
    return wanted * (low / few + slope * (wanted - few))


def fewer_bytes(few: Few, more: Few, wanted: int, routed: Floats) -> Estimate:
    """Estimate how much less routed agents receive than standard ones with a number of nodes."""

    def orders(groups: Sequence[Floats]) -> float:
        low, high, own = (float(np.median(group)) for group in groups)
        return float(np.log10(at_nodes(wanted, [(few[0], low), (more[0], high)]) / own))

    groups = [draws(few[1]), draws(more[1]), draws(routed)]
    return bootstrap(groups, orders, unit="orders of magnitude fewer bytes")


def standard_bytes(run: Run[Config]) -> float:
    """Return the bytes of agents of the paper's largest standard fleet by those with the fewest nodes."""
    known = [(nodes, float(np.median(received))) for nodes, received in by_nodes(run)[:2]]
    return at_nodes(main_nodes(run), known)


def time_of(run: Run[Config], mode: str) -> Finding | None:
    """Return the discovery time in the paper's largest fleet; None without such fleets at a pace."""
    times = by_pace(run, mode, PAPERS_LARGEST, TIME)
    if not times:
        return None
    estimates = [median(each, f"s at {PAPERS_LARGEST} agents") for each in times]
    ends = {}
    if few := by_pace(run, mode, 2, TIME):
        few_s = float(np.median(few[0]))
        ends["s at 2 agents"] = few_s
        ends["times as long at 6 agents as at 2"] = estimates[0].value / few_s
    table = summary(run)
    table = table[table["nodes"] == main_nodes(run)]
    details = {}
    for row in lines_of(table[table["mode"].isin([mode, STANDARD])]):
        when = f"{row.pace_s:g} s apart" if row.pace_s else "at once"
        text = f"{row.median_s:.2f} s ({row.lowest_s:.2f} to {row.highest_s:.2f})"
        text += f", {row.agents_given_up} agents given up" if row.agents_given_up else ""
        text += f", {row.cores_busy:.1f} cores busy"
        details[f"{row.mode}, {row.agents} agents, {when}"] = text
    started = main_fleets(run).drop_duplicates("cell").query("agents == 6 and pace_s > 0")
    cpu_s = started.loc[started["mode"] == mode, "cpu_s"].median() / PAPERS_LARGEST
    return Finding(
        estimate=estimates[0],
        under=dict(zip([SLOWER], estimates[1:], strict=False)),
        ends=ends,
        details=details,
        reason=f"starting one agent takes {cpu_s:.1f} s of CPU on this machine, which all agents share",
    )


def bytes_of(run: Run[Config], mode: str) -> Finding | None:
    """Return how much less an agent receives than in the standard fleet; None without such fleets."""
    routed = by_pace(run, mode, PAPERS_LARGEST, BYTES)
    if not routed:
        return None
    few = by_nodes(run)
    if len(few) < 2:
        return None
    wanted = main_nodes(run)
    under = {}
    for less, more in pairwise(few[1:]):
        under[f"with {less[0]} and {more[0]} nodes"] = fewer_bytes(less, more, wanted, routed[0])
    for name, received in zip([SLOWER], routed[1:], strict=False):
        under[name] = fewer_bytes(few[0], few[1], wanted, received)
    details = {mode: str(median(routed[0] / 1e3, "kB"))}
    for nodes, received in few:
        details[f"standard, {nodes} nodes per agent"] = str(median(received / 1e6, "MB"))
    return Finding(
        estimate=fewer_bytes(few[0], few[1], wanted, routed[0]),
        under=under,
        ends={"MB received by standard": standard_bytes(run) / 1e6},
        details=details,
        reason=_bytes_reason(float(np.median(routed[0])), standard_bytes(run)),
    )


def _bytes_reason(own: float, standard: float) -> str:
    """Return received bytes per agent beside the paper's."""
    standard_mb = paper("A-DISC-BYTES", "MB at 6 agents, standard")
    paper_kb = 1e3 * standard_mb / 10 ** paper("A-DISC-BYTES")
    return (
        f"with routers an agent receives {own / 1e3:.0f} kB (paper: about {paper_kb:.0f} kB), with plain "
        f"ROS 2 {standard / 1e6:.0f} MB, extrapolated (paper: {standard_mb} MB)"
    )


@exp.claim("A-DISC-TIME", how=How.LIVE)
def launched_time(run: Run[Config]) -> Finding | None:
    """Return the discovery time with the paper's method."""
    return time_of(run, LAUNCHED)


@exp.claim("A-DISC-BYTES", how=How.LIVE)
def launched_bytes(run: Run[Config]) -> Finding | None:
    """Return how much less agents receive with the paper's method."""
    return bytes_of(run, LAUNCHED)


@exp.claim("A-DISC-TIME-OURS", how=How.LIVE)
def routed_time(run: Run[Config]) -> Finding | None:
    """Return the discovery time with the sfglab variant."""
    return time_of(run, ROUTED)


@exp.claim("A-DISC-BYTES-OURS", how=How.LIVE)
def routed_bytes(run: Run[Config]) -> Finding | None:
    """Return how much less agents receive with the sfglab variant."""
    return bytes_of(run, ROUTED)


# --- Larger fleets ----------------------------------------------------------------------------


def endpoints(mode: str, agents: Any, nodes: int) -> Any:
    """Return the number of endpoints in the global domain by formula, as the simulation counts them.

    Args:
        mode: Mode of a simulated fleet.
        agents: Number of agents, or an array of numbers.
        nodes: Number of nodes per agent.
    """
    if mode == STANDARD:
        return agents * nodes * ENDPOINTS_PER_NODE
    if mode == PUBLISHING:
        return 5 * agents
    return 4 * agents + 2 * agents * (agents - 1)  # two per query, from each agent to each other


@derived
def simulated_fleets(run: Run[Config]) -> pd.DataFrame:
    """Return the rows of the table `simulated` that were simulated.

    A former version computed larger fleets, whose agents all have the same bytes, and wrote them into
    the same table.
    """
    table = run["simulated"]
    if "rx_bytes" not in table:
        return table
    kinds = table.groupby(["mode", "agents"])["rx_bytes"].transform("nunique")
    return table[kinds > 1]


@cache
def counted_bytes() -> pd.DataFrame:
    """Return the mean bytes per agent of the reference run's simulated fleets, which counted each packet.

    The index is the number of agents, the columns are modes; agents have 20 nodes.
    """
    log = find_project().reference_logs / f"{exp.name}.mcap"
    table = simulated_fleets(exp.load(log))
    return table.pivot_table("rx_bytes", "agents", "mode")


def received_bytes(mode: str, agents: Any) -> Any:
    """Return the bytes that an agent with 20 nodes receives during discovery, by formula.

    In a standard fleet they grow with the number of peers. Where agents query, the bytes per peer grow
    with the number of agents; the line through 2 and 6 agents is within 2.5 % of the counted bytes up to
    50 agents, and 19 % too low at 100.

    Args:
        mode: ``standard`` or ``routed`` (agents query).
        agents: Number of agents, or an array of numbers.
    """
    table = counted_bytes()[mode].dropna()
    per_peer = table / (table.index - 1)
    if mode == STANDARD:
        return per_peer.mean() * (agents - 1)
    slope = (per_peer[PAPERS_LARGEST] - per_peer[2]) / (PAPERS_LARGEST - 2)
    return (per_peer[2] + slope * (agents - 2)) * (agents - 1)


# --- Figures ----------------------------------------------------------------------------------

STYLES = {STANDARD: series("standard"), LAUNCHED: series("third"), ROUTED: series("proxy")}
LABELS = {
    STANDARD: "plain ROS 2: one domain",
    LAUNCHED: "paper's method: processes launched by the start command, agents query each other",
    ROUTED: "sfglab variant: processes already loaded, descriptions published",
}
SCALE_STYLES = {STANDARD: STYLES[STANDARD], QUERYING: STYLES[LAUNCHED], PUBLISHING: STYLES[ROUTED]}
SCALE_LABELS = {
    STANDARD: "plain ROS 2: one domain",
    QUERYING: "paper's method: agents query each other",
    PUBLISHING: "sfglab variant: descriptions published",
}
LIVE_MODES = {STANDARD: STANDARD, QUERYING: LAUNCHED, PUBLISHING: ROUTED}
"""Live mode by simulated mode."""
BESIDE = {STANDARD: -0.25, LAUNCHED: -0.05, ROUTED: 0.15}
PACED = 0.1  #: Offset of fleets that were started at a pace.
_HOLLOW: dict[str, Any] = {"color": "black", "linestyle": "", "markerfacecolor": "none"}


@exp.figure("discovery_fleet", size=(10, 5.6), when=lambda run: not run["cell"].empty)
def draw_fleet(figure: Figure, run: Run[Config]) -> dict[str, Any]:
    """Draw the discovery time and received bytes of each agent of the live fleets, and the paper's values."""
    table = main_fleets(run)
    layout: Any = [["time", "bytes"], ["key", "key"]]
    axes = figure.subplot_mosaic(layout, height_ratios=(6, 1))
    time_axes, bytes_axes, key = axes["time"], axes["bytes"], axes["key"]
    draw_agents(time_axes, table, TIME)
    draw_agents(bytes_axes, table, BYTES)
    star = {"marker": "*", "markersize": 13, "linestyle": "", "fillstyle": "none"}
    standard_s = paper("A-DISC-TIME", "s at 6 agents, standard")
    two_s, six_s = paper("A-DISC-TIME", "s at 2 agents"), paper("A-DISC-TIME")
    standard_mb = paper("A-DISC-BYTES", "MB at 6 agents, standard")
    routed_mb = standard_mb / 10 ** paper("A-DISC-BYTES")
    orange, green = COLORS["standard"], COLORS["third"]
    time_axes.plot([PAPERS_LARGEST], [standard_s], color=orange, **star)
    time_axes.plot([2, PAPERS_LARGEST], [two_s, six_s], color=green, **star)
    bytes_axes.plot([PAPERS_LARGEST], [standard_mb * 1e6], color=orange, **star)
    bytes_axes.plot([PAPERS_LARGEST], [routed_mb * 1e6], color=green, **star)
    if len(by_nodes(run)) > 1:
        place = PAPERS_LARGEST + BESIDE[STANDARD] + PACED
        whole = standard_bytes(run)
        bytes_axes.plot(place, whole, markersize=8, **STYLES[STANDARD])
        side: dict[str, Any] = {"textcoords": "offset points", "ha": "right", "va": "center"}
        text = f"{whole / 1e6:.0f} MB, extrapolated"
        bytes_axes.annotate(text, (place, whole), (-8, 0), fontsize=8.5, **side)
    time_axes.set_ylabel("discovery time per agent (s)")
    bytes_axes.set_ylabel("received per agent during discovery")
    sizes = sorted(table["agents"].unique())
    for each, unit in ((time_axes, "s"), (bytes_axes, "B")):
        each.set(xlabel="number of agents (markers are offset)")
        log_axis(each, unit)
        each.set_xticks(sizes, [str(size) for size in sizes])
    for mode, label in LABELS.items():
        key.plot([], [], linestyle="", label=label, **STYLES[mode])
    key.plot([], [], "o", label="filled: agents started one after another", color="black")
    key.plot([], [], "o", label="hollow: all started at once, limited by the cores", **_HOLLOW)
    key.plot([], [], "*", label="paper A, Fig. 9", markersize=10, **_HOLLOW)
    key.legend(loc="center", ncols=2, fontsize=8.5)
    key.axis("off")
    figure.suptitle(fleet_title(run))
    few = " and ".join(str(nodes) for nodes, _ in by_nodes(run)[:2])
    text = f"live, {main_nodes(run)} nodes per agent; one marker per agent; bars: medians"
    note(figure, f"{text}; filled orange: extrapolated from {few} nodes" if few else text)
    return {**default_sidecar(run), "repetitions": int(table["repeat"].nunique())}


def log_axis(axes: Axes, unit: str) -> None:
    """Make the y axis a logarithmic one with ticks such as ``10 kB``."""
    from matplotlib.ticker import EngFormatter, NullLocator

    axes.set_yscale("log")
    axes.yaxis.set_major_formatter(EngFormatter(unit=unit))
    axes.yaxis.set_minor_locator(NullLocator())


def draw_agents(axes: Axes, table: pd.DataFrame, column: str) -> None:
    """Draw one marker per agent, filled where starts were at a pace, and bars at medians."""
    groups: Any = table.groupby(["mode", "agents", "pace_s"])
    for (mode, agents, pace_s), rows in groups:
        place = agents + BESIDE[mode] + (PACED if pace_s else 0)
        fill: dict[str, Any] = {} if pace_s else {"markerfacecolor": "none"}
        places = [place] * len(rows)
        axes.plot(places, rows[column], linestyle="", markersize=4, **STYLES[mode], **fill)
        middle = rows[column].median()
        axes.plot(place, middle, "_", color=STYLES[mode]["color"], markersize=11, markeredgewidth=2)


def fleet_title(run: Run[Config]) -> str:
    """Return how much less the agents of the paper's largest fleet receive than with plain ROS 2."""
    saved = []
    for mode, name in ((ROUTED, "sfglab variant"), (LAUNCHED, "paper's method")):
        finding = bytes_of(run, mode)
        if finding is not None:
            factor = rounded(float(f"{10**finding.estimate.value:.2g}"))
            saved.append(f"{factor} times ({name})")
    if not saved:
        return "Discovery in small live fleets"
    return f"Six agents receive {' and '.join(saved)} fewer bytes than with plain ROS 2"


@exp.figure("discovery_scale", size=(10, 4.6))
def draw_scale(figure: Figure, run: Run[Config]) -> dict[str, Any]:
    """Draw discovery time, endpoints and received bytes over the number of agents, by their source."""
    layout: Any = [["time", "endpoints", "bytes"], ["key"] * 3]
    axes = figure.subplot_mosaic(layout, height_ratios=(6, 1))
    time_axes, endpoint_axes, bytes_axes, key = axes.values()
    table = simulated_fleets(run)
    nodes = int((table["talkers"] + table["listeners"]).max())
    many = np.geomspace(2, LARGEST, 60)
    for mode, style in SCALE_STYLES.items():
        color = style["color"]
        fleets = table[table["mode"] == mode].groupby("agents")
        times_s = fleets[TIME].median()
        time_axes.plot(times_s, markersize=4, **style)
        key.plot([], [], label=SCALE_LABELS[mode], **style)
        endpoint_axes.plot(many, endpoints(mode, many, nodes), "--", color=color)
        if "endpoints" in table:
            endpoint_axes.plot(fleets["endpoints"].max(), linestyle="", markersize=4, **style)
        if mode in counted_bytes():
            bytes_axes.plot(counted_bytes()[mode].dropna(), markersize=4, **style)
            bytes_axes.plot(many, received_bytes(mode, many), "--", color=color)
        draw_live(bytes_axes, run, LIVE_MODES[mode])
    standard_s = table[table["mode"] == STANDARD].groupby("agents")[TIME].median()
    if len(standard_s) > 1:
        line = np.polyfit(standard_s.index, standard_s, 1)
        time_axes.plot(many, np.polyval(line, many), "--", color=COLORS["standard"])
    time_axes.set_ylabel("discovery time")
    endpoint_axes.set_ylabel("endpoints in the global domain")
    bytes_axes.set_ylabel("received per agent")
    for each, unit in ((time_axes, "s"), (endpoint_axes, ""), (bytes_axes, "B")):
        each.set(xscale="log", xlabel="number of agents")
        each.set_xticks([2, 6, 25, 100, LARGEST], ["2", "6", "25", "100", f"{LARGEST:,}"])
        each.minorticks_off()
        log_axis(each, unit)
    kinds = (("simulated", "o-"), ("formula", "--"), ("live, started one after another", "x"))
    for label, kind in kinds:
        key.plot([], [], kind, color="black", markersize=5, label=label)
    key.legend(loc="center", ncols=3, fontsize=8.5)
    key.axis("off")
    querying, publishing = (endpoints(mode, LARGEST, nodes) for mode in (QUERYING, PUBLISHING))
    figure.suptitle(
        f"Queries cause the quadratic growth: {querying:,} endpoints at {LARGEST:,} agents, "
        f"{publishing:,} where descriptions are published"
    )
    each = f"{nodes} nodes and {CORES} simulated cores per agent"
    text = f"time and endpoints: {each}; bytes: 20 nodes per agent; medians"
    if len(standard_s) > 1:
        sizes = " and ".join(map(str, standard_s.index))
        text += f"; dashed time: line through fleets of {sizes} agents"
    note(figure, text)
    return default_sidecar(run)


def draw_live(axes: Axes, run: Run[Config], mode: str) -> None:
    """Draw the median bytes of live fleets of a mode that were started at a pace."""
    table = main_fleets(run)
    paced = table[(table["mode"] == mode) & (table["pace_s"] > _AT_ONCE)]
    medians = paced.groupby("agents")[BYTES].median()
    axes.plot(medians, "x", color=STYLES[mode]["color"], markersize=7)
