"""Discovery and cost of DDS and Zenoh between agents: tables, figures and the formula for large fleets over DDS.

The formula counts announcements of DDS: an agent receives that of each endpoint of each other agent, once per
participant. Bytes and CPU time of an announcement are those of the largest live fleet.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import pandas as pd

from sfglab.fields import Bounds
from sfglab.lab import pictures
from sfglab.lab.experiments.discovery.results import BYTES, TIME, agents_of, median, samples
from sfglab.lab.experiments.middleware.experiment import (
    ASKING,
    DATA_WAYS,
    HUB,
    PEERS,
    PUBLISHED,
    STANDARD,
    WAYS,
    Config,
    exp,
)
from sfglab.lab.figures import note, series
from sfglab.lab.runs import Run, derived, lines_of
from sfglab.lab.stats import Estimate, Floats, bootstrap, median_of
from sfglab.lab.workers.ros_nodes import TALKER, endpoints_of

if TYPE_CHECKING:
    from collections.abc import Iterable

    from matplotlib.figure import Figure

NAMES = {
    STANDARD: "plain ROS 2 (DDS)",
    ASKING: "routers over DDS, queries (paper)",
    PUBLISHED: "routers over DDS, published",
    HUB: "routers over Zenoh, hub",
    PEERS: "routers over Zenoh, peers",
}
"""Name for readers by way."""
COLORS = ("standard", "third", "proxy", "fourth", "network")
STYLES = {way: series(color) for way, color in zip(WAYS, COLORS, strict=True)}
DDS_WAYS = (STANDARD, ASKING, PUBLISHED)
KINDS = {"message": "message, 64 B at 50 Hz", "image": "image, 921,600 B at 30 Hz"}
COSTS = {"latency_ms": "latency (ms)", "cpu_ms": "CPU time per message (ms)"}
BEYOND = "beyond_ms"
"""Column of the latency less that over DDS routers in the same repetition, ms."""
ENDPOINTS_PER_NODE = len(endpoints_of(TALKER, "/a/b", "/c"))
LARGEST = 1000  #: Largest number of agents of sessions and formula.


# --- Formula ------------------------------------------------------------------------------------


def endpoints(way: str, agents: Any, nodes: int) -> Any:
    """Return the number of endpoints in the global domain of DDS.

    Args:
        way: One of `DDS_WAYS`.
        agents: Number of agents, or an array of numbers.
        nodes: Number of nodes per agent.
    """
    if way == STANDARD:
        return agents * nodes * ENDPOINTS_PER_NODE
    if way == PUBLISHED:
        return 5 * agents
    return 4 * agents + 2 * agents * (agents - 1)  # two per query, from each agent to each other


def announcements(way: str, agents: Any, nodes: int) -> Any:
    """Return the number of announcements that an agent receives; the arguments are those of `endpoints`.

    Each node has a participant in the global domain, or each router has one.
    """
    participants = nodes if way == STANDARD else 1
    return endpoints(way, agents, nodes) * participants * (agents - 1) / agents


@derived
def unit_costs(run: Run[Config]) -> pd.DataFrame:
    """Return bytes and CPU time (s) of an announcement by way over DDS, from the largest live fleets.

    The CPU time is that of plain ROS 2: routed agents spend theirs on starting processes.
    """
    largest = agents_of(run).query("agents == agents.max()").groupby("mode")
    table = largest[["agents", "nodes", BYTES, "cpu_s"]].median().loc[[*DDS_WAYS]]
    received = [announcements(str(way), one.agents, one.nodes) for way, one in table.iterrows()]
    cpu_s = (table["cpu_s"] / table["agents"] / received)[STANDARD]
    return pd.DataFrame({BYTES: table[BYTES] / received, TIME: cpu_s})


# --- Tables -------------------------------------------------------------------------------------


@derived
def fleets(run: Run[Config]) -> pd.DataFrame:
    """Return medians over agents by number of agents and way, the largest fleets first."""
    rows = []
    groups: Any = agents_of(run).groupby(["agents", "mode"])
    for (count, way), fleet in groups:
        row = {
            "agents": count,
            "way": way,
            TIME: bootstrap([samples(fleet, TIME)], median, unit="s"),
            BYTES: bootstrap([samples(fleet, BYTES)], median, unit="B"),
            "given up": fleet["censored"].sum(),
        }
        rows.append(row)
    return pd.DataFrame(rows[::-1])


@derived
def costs(run: Run[Config]) -> pd.DataFrame:
    """Return medians over repetitions of `COSTS`, by kind and way; `BEYOND` is from pairs with routers over DDS."""
    rows = []
    flows: Any = run["flow"].groupby(["kind", "way"])
    for (kind, way), flow in flows:
        over_dds = flows.get_group((kind, PUBLISHED))["latency_ms"].to_numpy()
        values = flow.assign(**{BEYOND: flow["latency_ms"] - over_dds})
        row = {"kind": kind, "way": way, "sent": flow["sent"].sum()}
        row["received"] = flow["received"].sum()
        for column in (*COSTS, BEYOND):
            row[column] = median_of(values[column].to_numpy(), unit="ms")
        rows.append(row)
    return pd.DataFrame(rows)


# --- Figures ------------------------------------------------------------------------------------


def middle_and_error(estimates: Iterable[Estimate]) -> tuple[Floats, Floats]:
    """Return values, shape (n,), and their distances to the ends of the intervals, shape (2, n)."""
    values = np.array([(one.value, one.low, one.high) for one in estimates]).T
    return values[0], np.abs(values[1:] - values[0])


@exp.figure("middleware_scale", size=(10, 5), when=lambda run: not run["sessions"].empty)
def draw_scale(figure: Figure, run: Run[Config]) -> None:
    """Draw the discovery time (left) and the received bytes (right) of an agent, over the number of agents."""
    from matplotlib.ticker import NullLocator

    sessions = run["sessions"]
    panels: Any = dict(zip((TIME, BYTES), figure.subplots(1, 2), strict=True))
    labels = {TIME: "discovery time (s)", BYTES: "received per agent during discovery (B)"}
    many = np.geomspace(2, LARGEST, 60)
    nodes = int(agents_of(run)["nodes"].max())
    open_style = {**STYLES[HUB], "marker": "v", "fillstyle": "none"}
    for column, axes in panels.items():
        for way in WAYS:
            table = fleets(run).query("way == @way")
            middle, error = middle_and_error(table[column])
            style = {"label": NAMES[way], "linestyle": "", "capsize": 3, **STYLES[way]}
            axes.errorbar(table["agents"], middle, error, **style)
        for way in DDS_WAYS:
            formula = unit_costs(run).loc[way, column] * announcements(way, many, nodes)
            axes.plot(many, formula, "--", color=STYLES[way]["color"], linewidth=1)
        measured = sessions["known_s" if column == TIME else "presence_bytes"]
        axes.plot(sessions["agents"], measured, **open_style)
        axes.set(xscale="log", yscale="log", xlabel="number of agents", ylabel=labels[column])
        axes.set_xticks([2, 6, 20, 100, LARGEST], ["2", "6", "20", "100", f"{LARGEST:,}"])
        axes.xaxis.set_minor_locator(NullLocator())
    panels[BYTES].plot(sessions["agents"], sessions["described_bytes"], linestyle=":", **open_style)
    panels[TIME].legend(fontsize=8)
    [*_, largest] = lines_of(sessions)
    asking = unit_costs(run).loc[ASKING, BYTES] * announcements(ASKING, largest.agents, nodes)
    figure.suptitle(
        f"{largest.agents:,} Zenoh sessions discover each other within {largest.known_s:.1f} s, with "
        f"{largest.presence_bytes / 1e6:.2g} MB each;\nwith the paper's method over DDS, {asking / 1e6:,.0f} MB "
        "each by formula",
        fontsize=11,
    )
    note(
        figure,
        "filled: live agents, medians with 95 % intervals; open: Zenoh sessions, which send 100 heartbeats per second "
        "in all;\ndotted: with descriptions; dashed: formula",
    )


@exp.figure("middleware_cost", size=(10, 4.6), when=lambda run: not run["flow"].empty)
def draw_cost(figure: Figure, run: Run[Config]) -> None:
    """Draw latency (left) and CPU time (right) of a message and of an image between two agents."""
    table: Any = costs(run).set_index(["kind", "way"])
    panels: Any = figure.subplots(len(KINDS), len(COSTS), sharey=True)
    for row, (kind, title) in zip(panels, KINDS.items(), strict=True):
        for axes, (column, label) in zip(row, COSTS.items(), strict=True):
            for place, way in enumerate(DATA_WAYS):
                middle, error = middle_and_error([table.loc[(kind, way), column]])
                axes.errorbar(middle, [place], xerr=error, capsize=3, **STYLES[way])
            axes.set(xlabel=label, xlim=(0, None))
            axes.set_title(title, fontsize=10)
            axes.set_yticks(range(len(DATA_WAYS)), [NAMES[way] for way in DATA_WAYS])
            axes.margins(y=0.2)
    panels[0][0].invert_yaxis()
    hub, peers = (table.loc[("message", way), BEYOND].value for way in (HUB, PEERS))
    figure.suptitle(
        f"A message takes {peers:.2f} ms longer between Zenoh peers, and {hub:.2f} ms over a hub, than over DDS routers",
        fontsize=11,
    )
    note(
        figure,
        "live; medians with 95 % intervals; CPU time of publisher, subscriber, routers and hub",
    )


# --- Explorer -----------------------------------------------------------------------------------

Nodes = Annotated[int, Bounds(2, 100)]

#: Numbers of agents at which the curves are drawn.
COUNTS = np.array([2, 3, 6, 10, 25, 60, 100, 250, 600, LARGEST])
_AGENTS = pictures.Axis("agents", "", 2, LARGEST, log=True, ticks=(2, 10, 100, LARGEST))
_ANNOUNCEMENTS = pictures.Axis(
    "announcements", "", 1, 1e9, log=True, si=True, ticks=(1, 1e3, 1e6, 1e9)
)


@exp.explorer
def fleet_announcements(*, nodes_per_agent: Nodes = 20) -> pictures.Picture:
    """Return the announcements of DDS that an agent receives, over the number of agents, by formula.

    Each endpoint in the global domain is announced to each participant of another agent.

    Args:
        nodes_per_agent: Number of ROS 2 nodes of each agent.
    """
    values = {NAMES[way]: announcements(way, COUNTS, nodes_per_agent) for way in DDS_WAYS}
    table = pd.DataFrame(values, index=COUNTS)
    colors = {NAMES[way]: str(STYLES[way]["color"]) for way in DDS_WAYS}
    drawn = pictures.lines(table, colors)
    counted = ", ".join(f"{count:,.0f} ({name})" for name, count in table.loc[LARGEST].items())
    panel = pictures.Panel(
        title="announcements per agent", x=_AGENTS, y=_ANNOUNCEMENTS, series=drawn
    )
    said = f"Announcements that each of {LARGEST:,} agents receives: {counted}."
    return pictures.Picture(said=said, panels=(panel,))
