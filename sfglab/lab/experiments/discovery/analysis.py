"""Times until each agent knew its peers, what was received until then, the claims, and Fig. 9 of paper A.

An agent that was given up counts with the time that was waited for it, which makes the standard's figures lower
bounds; the claims' details say how many there were.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from sfglab.fields import Bounds
from sfglab.lab.claims import Finding, How
from sfglab.lab.experiment import Look
from sfglab.lab.experiments.discovery.experiment import ROUTED, STANDARD, Config, Scale, exp
from sfglab.lab.figures import COLORS, MARKERS
from sfglab.lab.runs import Run, derived
from sfglab.lab.stats import Estimate, bootstrap

if TYPE_CHECKING:
    from collections.abc import Sequence

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]


PAPERS_LARGEST = 6
"""Agents of the fleet that the claims are about; a run with smaller ones only does not answer them."""

KEYS = ["mode", "agents", "talkers", "listeners"]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Fleets:
    """Fleets of a run, live or simulated."""

    cells: pd.DataFrame  #: One line a fleet.
    #: One line an agent: its fleet's columns (``mode``, ``agents``, ``repeat`` ...) with its own
    #: ``resolved_s``, ``own_bytes``, ``fleet_bytes`` and ``censored``.
    hosts: pd.DataFrame

    def main_nodes(self) -> tuple[int, int]:
        """Return the numbers of talkers and listeners of the agents that both modes were measured with.

        Where there are several, the largest; of a run that holds no such pair, the largest of all.
        """
        nodes = self.cells[["talkers", "listeners"]]
        standard, routed = (
            set(nodes[self.cells["mode"] == mode].itertuples(index=False)) for mode in (STANDARD, ROUTED)
        )
        talkers, listeners = max((standard & routed) or (standard | routed))
        return int(talkers), int(listeners)

    def of_main_nodes(self, table: pd.DataFrame, mode: str) -> pd.DataFrame:
        """Return the rows of one mode whose agents have the nodes that both modes were measured with."""
        talkers, listeners = self.main_nodes()
        kind = (table["mode"] == mode) & (table["talkers"] == talkers) & (table["listeners"] == listeners)
        return table[kind]

    def sizes(self, mode: str) -> set[int]:
        """Return the sizes of one mode's main fleets."""
        return {int(agents) for agents in self.of_main_nodes(self.cells, mode)["agents"]}

    def samples(self, mode: str, agents: int, column: str) -> Floats:
        """Return one figure of every agent of the main fleets of one size, shape (fleets, agents)."""
        hosts = self.of_main_nodes(self.hosts, mode)
        chosen = hosts[hosts["agents"] == agents]
        if chosen.empty:
            return np.empty((0, agents))
        return chosen.pivot_table(index="cell", columns="host", values=column).to_numpy(dtype=np.float64)


@derived
def live(run: Run[Config]) -> Fleets:
    """Return the live fleets; of a log that was cut off, the finished ones."""
    cells, hosts = run["cell"], run["host"]
    fleet = cells.drop(columns=["resolved_s", "censored"])
    return Fleets(cells=cells, hosts=hosts.merge(fleet, on="cell") if len(cells) else hosts)


@derived
def simulated(run: Run[Config]) -> Fleets:
    """Return the simulated fleets in the form of live ones."""
    rows = run["simulated"]
    cell = rows.groupby([*KEYS, "seed"], sort=False).ngroup()
    hosts = rows.assign(cell=cell, own_bytes=rows["rx_bytes"], fleet_bytes=rows["rx_bytes"])
    cells = hosts.drop_duplicates("cell")[["cell", *KEYS]].assign(
        resolved_s=hosts.groupby("cell")["resolved_s"].max().to_numpy(),
        censored=hosts.groupby("cell")["censored"].any().to_numpy(),
    )
    return Fleets(cells=cells, hosts=hosts)


def _how(run: Run[Config]) -> How:
    return How.SIMULATED if run["cell"].empty else How.LIVE


def _measured(run: Run[Config]) -> Fleets | None:
    """Return what the claims are about: the live fleets, else the simulated ones, else nothing."""
    fleets = live(run) if _how(run) is How.LIVE else simulated(run)
    return None if fleets.cells.empty else fleets


def _draws(table: Floats) -> Floats:
    """Return what is resampled: whole fleets, or the agents of the only one, as rows.

    Agents of one fleet are not independent of each other. Of a single fleet nothing but its agents is known, so
    its interval says how they differ, and not how fleets do.
    """
    return table if len(table) > 1 else table.reshape(-1, 1)


def _median(table: Floats, unit: str) -> Estimate:
    return bootstrap([_draws(table)], lambda groups: float(np.median(groups[0])), unit=unit)


def _orders_of_magnitude(standard: Floats, routed: Floats) -> Estimate:
    def ratio(groups: Sequence[Floats]) -> float:
        return float(np.log10(np.median(groups[0]) / np.median(groups[1])))

    return bootstrap([_draws(standard), _draws(routed)], ratio, unit="orders of magnitude fewer bytes")


@derived
def summary(run: Run[Config]) -> pd.DataFrame:
    """Return medians over agents and fleets, and how busy the machine was, by kind and size of fleet."""
    if run["cell"].empty:
        return pd.DataFrame()
    hosts, cells = live(run).hosts.groupby(KEYS), live(run).cells.groupby(KEYS)
    busy_s = cells["nodes_cpu_s"].sum() + cells["components_cpu_s"].sum()
    table = pd.DataFrame(
        {
            "fleets": cells.size(),
            "given_up": cells["censored"].sum(),
            "agent_s": hosts["resolved_s"].median(),
            "fleet_s": cells["resolved_s"].median(),
            "own_bytes": hosts["own_bytes"].median(),
            "fleet_bytes": hosts["fleet_bytes"].median(),
            "cpu_s": cells["nodes_cpu_s"].median() + cells["components_cpu_s"].median(),
            "cores_busy": busy_s / cells["window_s"].sum(),
        }
    )
    return table.reset_index()


@exp.claim("A-DISC-TIME", how=_how)
def discovery_time(run: Run[Config]) -> Finding | None:
    """Return how long an agent of the largest routed fleet takes; None of a run with smaller fleets only."""
    fleets = _measured(run)
    agents = max(fleets.sizes(ROUTED), default=0) if fleets else 0
    if fleets is None or agents < PAPERS_LARGEST:
        return None
    times_s = fleets.samples(ROUTED, agents, "resolved_s")
    details = {
        "agents": str(agents),
        "fleets": str(len(times_s)),
        "slowest agent": f"{times_s.max():.2f} s",
        **_by_size(fleets, ROUTED),
        **_by_size(fleets, STANDARD),
    }
    reasons = _too_many(agents)
    if _how(run) is How.LIVE:
        busy, share = _cores_busy(fleets, agents)
        details |= {"cores busy, routed": f"{busy:.2f}", **_fewer_nodes(fleets, agents)}
        reasons.append(
            f"all agents share one machine, where they kept {busy:.1f} cores busy until then, "
            f"{100 * share:.0f} % of that with finding the nodes inside each agent"
        )
    estimate = _median(times_s, f"s at {agents} agents, routed")
    return Finding(estimate=estimate, details=details, reason="; ".join(reasons))


def _too_many(agents: int) -> list[str]:
    return [] if agents == PAPERS_LARGEST else [f"the run has {agents} agents at most"]


def _cores_busy(fleets: Fleets, agents: int) -> tuple[float, float]:
    """Return how many cores routed fleets of one size kept busy, and the share of the agents' own nodes."""
    cells = fleets.of_main_nodes(fleets.cells, ROUTED)
    sums = cells[cells["agents"] == agents][["nodes_cpu_s", "components_cpu_s", "window_s"]].sum()
    busy_s = sums["nodes_cpu_s"] + sums["components_cpu_s"]
    return float(busy_s / sums["window_s"]), float(sums["nodes_cpu_s"] / busy_s)


def _fewer_nodes(fleets: Fleets, agents: int) -> dict[str, str]:
    """Return the times of routed fleets of the same size whose agents have other nodes, by their nodes."""
    hosts = fleets.hosts[(fleets.hosts["mode"] == ROUTED) & (fleets.hosts["agents"] == agents)]
    return {
        f"with {talkers} + {listeners} nodes an agent": f"{rows['resolved_s'].median():.2f} s"
        for (talkers, listeners), rows in hosts.groupby(["talkers", "listeners"])
        if (talkers, listeners) != fleets.main_nodes()
    }


def _by_size(fleets: Fleets, mode: str) -> dict[str, str]:
    texts = {}
    for agents in sorted(fleets.sizes(mode)):
        times_s = fleets.samples(mode, agents, "resolved_s")
        given_up = int(fleets.samples(mode, agents, "censored").sum())
        text = f"{np.median(times_s):.2f} s ({times_s.min():.2f} to {times_s.max():.2f})"
        texts[f"{mode}, {agents} agents"] = text + (f", {given_up} agents given up" if given_up else "")
    return texts


@exp.claim("A-DISC-BYTES", how=_how)
def discovery_bytes(run: Run[Config]) -> Finding | None:
    """Return how much less a routed agent receives; None of a run without two fleets of the paper's size."""
    fleets = _measured(run)
    agents = max(fleets.sizes(ROUTED) & fleets.sizes(STANDARD), default=0) if fleets else 0
    if fleets is None or agents < PAPERS_LARGEST:
        return None
    own, fleet = (
        [fleets.samples(mode, agents, column) for mode in (STANDARD, ROUTED)]
        for column in ("own_bytes", "fleet_bytes")
    )
    details = {
        "agents": str(agents),
        "standard": f"{_median(own[0] / 1e6, 'MB')}",
        "routed": f"{_median(own[1] / 1e3, 'kB')}",
        "until the whole fleet is complete": str(_orders_of_magnitude(*fleet)),
        "fleets": f"{len(own[0])} standard, {len(own[1])} routed",
    }
    estimate = _orders_of_magnitude(*own)
    return Finding(estimate=estimate, details=details, reason="; ".join(_too_many(agents)))


MODES = {STANDARD: "standard", ROUTED: "proxy"}
LABELS = {STANDARD: "standard: one domain", ROUTED: "routed: a domain for each agent"}
PAPER_S = {STANDARD: {6: 40.0}, ROUTED: {2: 0.8, 6: 2.9}}
"""Paper A, section 5.3: the ends of the ranges that the text names, by number of agents."""

PAPER_BYTES = {STANDARD: {6: 13.6e6}, ROUTED: {6: 13.6e6 / 10**1.8}}
_SIZES = (2, 3, 4, 6, 8, 12, 20, 50, 100, 200, 500, 1000)
_OFFSET = {STANDARD: -0.2, ROUTED: 0.2}
_ASIDE = 0.07
_NO_LINE: dict[str, Any] = {"color": "black", "linestyle": ""}
_PAPER_MARKER: dict[str, Any] = {"marker": "*", "s": 110, "facecolors": "none", "linewidths": 1.3, "zorder": 4}


@exp.figure("discovery_fleet", size=(9.2, 4.6), when=lambda run: not run["cell"].empty)
def draw_fleet(figure: Figure, run: Run[Config]) -> dict[str, Any]:
    """Draw discovery time (solid, linear) and traffic (dotted, logarithmic) over the number of agents.

    Both quantities of both modes are violins with their samples, with the paper's points.
    """
    fleets = live(run)
    time_axes = figure.subplots()
    bytes_axes = time_axes.twinx()
    for mode, style in MODES.items():
        color, aside = COLORS[style], _OFFSET[mode]
        for agents in sorted(fleets.sizes(mode)):
            times_s, received = (fleets.samples(mode, agents, c).ravel() for c in ("resolved_s", "own_bytes"))
            _draw_violin(time_axes, agents + aside - _ASIDE, times_s, color, solid=True)
            _draw_violin(bytes_axes, agents + aside + _ASIDE, np.log10(received), color, solid=False)
        logs = {n: np.log10(received) for n, received in PAPER_BYTES[mode].items()}
        for axes, at, points in ((time_axes, -_ASIDE, PAPER_S[mode]), (bytes_axes, _ASIDE, logs)):
            spots = np.array(list(points)) + aside + at
            axes.scatter(spots, list(points.values()), edgecolors=color, **_PAPER_MARKER)
    _dress(time_axes, bytes_axes, sorted(fleets.sizes(STANDARD) | fleets.sizes(ROUTED)))
    talkers, listeners = fleets.main_nodes()
    figure.suptitle(f"Fleet discovery: {talkers} publishing and {listeners} subscribing nodes on every agent")
    return {
        "fleets": _records(summary(run)),
        "paper": {
            "time_s": {mode: {str(n): v for n, v in points.items()} for mode, points in PAPER_S.items()},
            "bytes": {mode: {str(n): v for n, v in points.items()} for mode, points in PAPER_BYTES.items()},
        },
    }


def _draw_violin(axes: Axes, at: float, values: Floats, color: str, *, solid: bool) -> None:
    """Draw one distribution: its shape where there is one, all samples, and the median."""
    if np.ptp(values) > 0:
        parts = axes.violinplot(values, positions=[at], widths=0.17, showextrema=False)
        for body in parts["bodies"]:  # type: ignore[attr-defined]  # a list, whatever the stubs say
            body.set(facecolor=color if solid else "none", edgecolor=color, alpha=0.35 if solid else 0.9)
            body.set_linestyle("-" if solid else ":")
    axes.scatter(np.full(values.shape, at), values, s=5, color=color, alpha=0.55, linewidths=0, zorder=3)
    axes.hlines(
        np.median(values), at - 0.06, at + 0.06, color=color, linewidth=1.8, linestyles="-" if solid else ":"
    )


def _dress(time_axes: Axes, bytes_axes: Axes, sizes: list[int]) -> None:
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    time_axes.set_xticks(sizes)
    time_axes.set(xlabel="agents in the fleet", ylabel="time until an agent knows all its peers (s), solid")
    time_axes.set_ylim(bottom=0)
    bytes_axes.set_ylabel("received at its interface until then, dotted")
    bytes_axes.grid(visible=False)
    bytes_axes.spines["right"].set_visible(True)
    low, high = bytes_axes.get_ylim()
    ticks = np.arange(np.floor(low), np.ceil(high) + 1)
    bytes_axes.set_yticks(ticks, [_bytes_text(10**tick) for tick in ticks])
    handles = [
        *(Patch(facecolor=COLORS[style], alpha=0.5, label=LABELS[mode]) for mode, style in MODES.items()),
        Line2D([], [], color="black", linestyle="-", label="time (left)"),
        Line2D([], [], color="black", linestyle=":", label="traffic (right)"),
        Line2D([], [], marker="*", markersize=10, markerfacecolor="none", label="paper", **_NO_LINE),
    ]
    time_axes.legend(handles=handles, fontsize=8, loc="upper left")


def _bytes_text(number: float) -> str:
    for unit, size in (("MB", 1e6), ("kB", 1e3)):
        if number >= size:
            return f"{number / size:g} {unit}"
    return f"{number:g} B"


@exp.figure("discovery_scale", size=(10.4, 4.1))
def draw_scale(figure: Figure, run: Run[Config]) -> dict[str, Any]:
    """Draw time and traffic of every fleet there is, live and simulated, over the number of agents."""
    axes = figure.subplots(1, 2)
    for one, column, label, text in (
        (axes[0], "resolved_s", "time until an agent knows all its peers (s)", "{:g}".format),
        (axes[1], "own_bytes", "received at its interface until then", _bytes_text),
    ):
        _draw_fleets(one, run, column)
        one.set(xscale="log", yscale="log", xlabel="agents in the fleet", ylabel=label)
        low, high = one.get_ylim()
        ticks = 10.0 ** np.arange(np.ceil(np.log10(low)), np.floor(np.log10(high)) + 1)
        one.set_yticks(ticks, [text(tick) for tick in ticks])
        first, last = one.get_xlim()
        sizes = [size for size in _SIZES if first <= size <= last]
        one.set_xticks(sizes, [str(size) for size in sizes])
        one.minorticks_off()
    axes[1].legend(fontsize=8, loc="lower right")
    figure.suptitle("Fleet discovery beyond six agents")
    medians = run["simulated"].groupby(KEYS)[["resolved_s", "rx_bytes"]].median().reset_index()
    return {"live": _records(summary(run)), "simulated": _records(medians)}


@exp.look(
    "fleet",
    Look(
        turn=("simulated.agents", "simulated.talkers", "simulated.listeners"),
        needs=("simulated",),
        size=(10, 2.4),
        start={"simulated": Scale(agents=(6,))},
        within={f"simulated.{nodes}": Bounds(1, 20) for nodes in ("talkers", "listeners")}
        | {"simulated.agents": Bounds(2, 16)},
        reference="discovery_scale",
    ),
)
def draw_one(figure: Figure, run: Run[Config]) -> None:
    """Draw one simulated fleet of each kind: how long its agents take, and what each receives until then."""
    time_axes, bytes_axes = figure.subplots(1, 2, sharey=True)
    for axes, column, label, limits, text in (
        (time_axes, "resolved_s", "time until an agent knows all its peers (s)", (0.01, 300), "{:.2f}".format),
        (bytes_axes, "rx_bytes", "received at its interface until then", (1e3, 1e9), _bytes_text),
    ):
        for mode, style in MODES.items():
            values = run["simulated"].query("mode == @mode")[column]
            middle = float(f"{values.median():.3g}")
            axes.barh(LABELS[mode], middle, color=COLORS[style], alpha=0.5)
            axes.plot(values, [LABELS[mode]] * len(values), MARKERS[style], color=COLORS[style], markersize=4)
            axes.annotate(text(middle), (middle, LABELS[mode]), (6, 0), textcoords="offset points", va="center")
        axes.set(xscale="log", xlim=limits, xlabel=label)


def _draw_fleets(axes: Axes, run: Run[Config], column: str) -> None:
    for mode, style in MODES.items():
        for number, (nodes, table) in enumerate(_kinds(live(run).hosts, mode)):
            color = COLORS[style]
            dots: dict[str, Any] = {"marker": MARKERS[style], "s": 16, "edgecolors": color, "alpha": 0.6}
            dots |= {"facecolors": color if number == 0 else "none", "label": f"{mode}, live, {nodes}"}
            axes.scatter(table["agents"], table[column], **dots)
        simulated = "rx_bytes" if column == "own_bytes" else column
        for nodes, table in _kinds(run["simulated"], mode):
            by_size = table.groupby("agents")[simulated].agg(["min", "median", "max"])
            label = f"{mode}, simulated, {nodes}"
            axes.plot(by_size.index, by_size["median"], color=COLORS[style], label=label)
            axes.fill_between(by_size.index, by_size["min"], by_size["max"], color=COLORS[style], alpha=0.18)


def _kinds(table: pd.DataFrame, mode: str) -> list[tuple[str, pd.DataFrame]]:
    """Return a mode's rows by the nodes of its agents, most nodes first."""
    if table.empty:
        return []
    groups = table[table["mode"] == mode].groupby(["talkers", "listeners"])
    found = sorted(groups, key=lambda item: item[0], reverse=True)
    return [(f"{talkers}+{listeners} nodes an agent", rows) for (talkers, listeners), rows in found]


def _records(table: pd.DataFrame) -> list[dict[str, Any]]:
    """Return a table as JSON values, a line a row."""
    return [
        {str(name): value.item() if hasattr(value, "item") else value for name, value in row.items()}
        for row in table.to_dict("records")
    ]
