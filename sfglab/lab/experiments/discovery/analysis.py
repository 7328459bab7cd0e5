"""Times until each agent knew its peers, what was received until then, the claims, and Fig. 9 of paper A.

Claims are judged by what this machine's cores carry: routed fleets at a pace, and standard ones with few nodes,
whose bytes lead to the paper's along the square that discovery grows with. An agent that was given up counts
with the time that was waited for it.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from sfglab.fields import Bounds
from sfglab.lab.claims import Finding, How
from sfglab.lab.experiment import Look
from sfglab.lab.experiments.discovery.experiment import (
    LAUNCHED,
    ROUTED,
    STANDARD,
    Config,
    Scale,
    exp,
)
from sfglab.lab.experiments.discovery.simulated import CORES, EXACT_MOST
from sfglab.lab.figures import COLORS, MARKERS, series
from sfglab.lab.runs import Run, derived
from sfglab.lab.stats import Estimate, Floats, bootstrap, rounded

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

PAPERS_LARGEST = 6
"""Agents of the fleet that the claims are about; a run with smaller ones only does not answer them."""

_TIME = "resolved_s"
KEYS = ["mode", "agents", "talkers", "listeners"]
_AT_ONCE = 0.0
_SLOWER = ("at two thirds of the pace",)
_OWN_COMPUTERS = float(
    "inf"
)  # the pace that stands for simulated fleets: no agent takes another one's cores


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Fleets:
    """Fleets of a run, live or simulated."""

    cells: pd.DataFrame  #: One line a fleet.
    #: One line an agent: its fleet's columns (``mode``, ``agents``, ``repeat`` ...) with its own
    #: ``resolved_s``, ``own_bytes`` and ``censored``.
    hosts: pd.DataFrame

    def main_nodes(self) -> tuple[int, int]:
        """Return the numbers of talkers and listeners of the agents that both modes were measured with.

        Where there are several, the largest; of a run that holds no such pair, the largest of all.
        """
        nodes = self.cells[["talkers", "listeners"]]
        is_standard = self.cells["mode"] == STANDARD
        standard, routed = (
            set(nodes[of].itertuples(index=False)) for of in (is_standard, ~is_standard)
        )
        talkers, listeners = max((standard & routed) or (standard | routed))
        return int(talkers), int(listeners)

    def of_main_nodes(self, table: pd.DataFrame, mode: str) -> pd.DataFrame:
        """Return the rows of one mode whose agents have the nodes that both modes were measured with."""
        talkers, listeners = self.main_nodes()
        kind = (
            (table["mode"] == mode)
            & (table["talkers"] == talkers)
            & (table["listeners"] == listeners)
        )
        return table[kind]

    def sizes(self, mode: str) -> list[int]:
        """Return the sizes of one mode's main fleets, in order."""
        return sorted({int(agents) for agents in self.of_main_nodes(self.cells, mode)["agents"]})

    def paces_s(self, mode: str, agents: int) -> list[float]:
        """Return the paces at which main fleets of one size were started, the fastest first."""
        cells = self.of_main_nodes(self.cells, mode)
        return sorted(set(cells.loc[cells["agents"] == agents, "pace_s"]) - {_AT_ONCE})

    def samples(self, mode: str, agents: int, column: str, *, pace_s: float = _AT_ONCE) -> Floats:
        """Return one figure of every agent of the main fleets of one size and pace, shape (fleets, agents)."""
        hosts = self.of_main_nodes(self.hosts, mode)
        chosen = hosts[(hosts["agents"] == agents) & (hosts["pace_s"] == pace_s)]
        if chosen.empty:
            return np.empty((0, agents))
        return chosen.pivot_table(index="cell", columns="host", values=column).to_numpy(
            dtype=np.float64
        )

    def by_pace(self, mode: str, agents: int, column: str) -> list[Floats]:
        """Return the samples of one size for each of its paces, the fastest first."""
        return [
            self.samples(mode, agents, column, pace_s=pace_s)
            for pace_s in self.paces_s(mode, agents)
        ]

    def by_density(self, agents: int) -> list[tuple[int, Floats]]:
        """Return what agents of standard fleets with fewer nodes received, by their nodes, in order."""
        hosts = self.hosts[(self.hosts["mode"] == STANDARD) & (self.hosts["agents"] == agents)]
        groups: Any = hosts.groupby(hosts["talkers"] + hosts["listeners"])
        tables = [
            (n, rows.pivot_table(index="cell", columns="host", values="own_bytes"))
            for n, rows in groups
        ]
        return [
            (int(n), table.to_numpy(np.float64))
            for n, table in tables
            if n < sum(self.main_nodes())
        ]


@derived
def live(run: Run[Config]) -> Fleets:
    """Return the live fleets; of a log that was cut off, the finished ones."""
    cells, hosts = run["cell"], run["host"]
    cells = cells.assign(cpu_s=cells["nodes_cpu_s"] + cells["components_cpu_s"])
    fleet = cells.drop(columns=["resolved_s", "censored"])
    return Fleets(cells=cells, hosts=hosts.merge(fleet, on="cell") if len(cells) else hosts)


@derived
def simulated(run: Run[Config]) -> Fleets:
    """Return the simulated fleets that have times, in the form of live ones."""
    rows = run["simulated"].dropna(subset=[_TIME])
    hosts = rows.assign(
        cell=rows.groupby([*KEYS, "seed"], sort=False).ngroup(), own_bytes=rows["rx_bytes"]
    )
    hosts["pace_s"] = _OWN_COMPUTERS
    cells = hosts.drop_duplicates("cell")[["cell", *KEYS, "pace_s"]].assign(
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


@derived
def summary(run: Run[Config]) -> pd.DataFrame:
    """Return medians over agents and fleets, and how busy the machine was, by kind, size and pace of fleet."""
    if run["cell"].empty:
        return pd.DataFrame()
    hosts, cells = (
        table.groupby([*KEYS, "pace_s"]) for table in (live(run).hosts, live(run).cells)
    )
    table = pd.DataFrame(
        {
            "fleets": cells.size(),
            "given_up": cells["censored"].sum(),
            "agent_s": hosts["resolved_s"].median(),
            "fleet_s": cells["resolved_s"].median(),
            "own_bytes": hosts["own_bytes"].median(),
            "cpu_s": cells["cpu_s"].median(),
            "cores_busy": cells["cpu_s"].sum() / cells["window_s"].sum(),
        }
    )
    return table.reset_index()


def _time_of(run: Run[Config], mode: str) -> Finding | None:
    """Return how long an agent of the largest fleet takes; None of a run without such fleets at a pace."""
    fleets, agents = _measured(run), _largest(run, mode)
    if fleets is None or agents < PAPERS_LARGEST:
        return None
    estimates = [
        _median(times, f"s at {agents} agents") for times in fleets.by_pace(mode, agents, _TIME)
    ]
    details = {"agents": str(agents), **_by_size(fleets, mode), **_by_size(fleets, STANDARD)}
    ends = {}
    if few := fleets.by_pace(mode, 2, _TIME):
        few_s = float(np.median(few[0]))
        ends = {
            "s at 2 agents": few_s,
            "times as long at 6 agents as at 2": estimates[0].value / few_s,
        }
    return Finding(
        estimate=estimates[0],
        under=dict(zip(_SLOWER, estimates[1:], strict=False)),
        ends=ends,
        details=details,
        reason=_work(fleets, mode, agents),
    )


def _bytes_of(run: Run[Config], mode: str) -> Finding | None:
    """Return how much less an agent receives than standard; None of a run without what it follows from."""
    fleets, agents = _measured(run), _largest(run, mode)
    if fleets is None or agents < PAPERS_LARGEST:
        return None
    routed = fleets.by_pace(mode, agents, "own_bytes")
    few = fleets.by_density(agents)
    if _how(run) is How.SIMULATED:  # nothing is starved there
        few = [
            (
                sum(fleets.main_nodes()),
                fleets.samples(STANDARD, agents, "own_bytes", pace_s=_OWN_COMPUTERS),
            )
        ]
        few *= 2
    if len(few) < 2:
        return None
    first, *others = pairwise(few)
    wanted = sum(fleets.main_nodes())
    under = {f"with {a[0]} and {b[0]} nodes": _fewer(a, b, wanted, routed[0]) for a, b in others}
    under |= {
        name: _fewer(*first, wanted, each) for name, each in zip(_SLOWER, routed[1:], strict=False)
    }
    standard = _at_nodes(wanted, [(n, float(np.median(each))) for n, each in first])
    details = {"agents": str(agents), mode: f"{_median(routed[0] / 1e3, 'kB')}"}
    details |= {f"standard, {n} nodes an agent": f"{_median(each / 1e6, 'MB')}" for n, each in few}
    return Finding(
        estimate=_fewer(*first, wanted, routed[0]),
        under=under,
        ends={"MB received by standard": standard / 1e6},
        details=details,
        reason="the nodes' stand-ins are on Cyclone DDS, the paper's nodes on Fast DDS, over a radio",
    )


def _at_nodes(wanted: int, known: Sequence[tuple[int, float]]) -> float:
    """Return a figure for agents with so many nodes; divided by the nodes, it is on the line of two."""
    (few, low), (more, high) = known
    slope = (high / more - low / few) / max(1, more - few)
    return wanted * (low / few + slope * (wanted - few))


def _fewer(
    few: tuple[int, Floats], more: tuple[int, Floats], wanted: int, routed: Floats
) -> Estimate:
    def ratio(groups: Sequence[Floats]) -> float:
        low, high, own = (float(np.median(group)) for group in groups)
        return float(np.log10(_at_nodes(wanted, [(few[0], low), (more[0], high)]) / own))

    samples = [_draws(few[1]), _draws(more[1]), _draws(routed)]
    return bootstrap(samples, ratio, unit="orders of magnitude fewer bytes")


def _largest(run: Run[Config], mode: str) -> int:
    """Return the size of the largest main fleet that was started at a pace; 0: there is none."""
    fleets = _measured(run)
    return (
        max((n for n in fleets.sizes(mode) if fleets.paces_s(mode, n)), default=0) if fleets else 0
    )


for mark, mode in (("", LAUNCHED), ("-OURS", ROUTED)):  # the paper's way, and ours
    exp.claim(f"A-DISC-TIME{mark}", how=_how)(partial(_time_of, mode=mode))
    exp.claim(f"A-DISC-BYTES{mark}", how=_how)(partial(_bytes_of, mode=mode))


def _by_size(fleets: Fleets, mode: str) -> dict[str, str]:
    """Return times of one mode by size and pace, and how many cores its fleets kept busy."""
    texts = {}
    groups: Any = fleets.of_main_nodes(fleets.cells, mode).groupby(["agents", "pace_s"])
    for (agents, pace_s), group in groups:
        times_s = fleets.samples(mode, agents, _TIME, pace_s=pace_s)
        text = f"{np.median(times_s):.2f} s ({times_s.min():.2f} to {times_s.max():.2f})"
        given_up = int(fleets.samples(mode, agents, "censored", pace_s=pace_s).sum())
        text += f", {given_up} agents given up" if given_up else ""
        if "window_s" in group:  # from the first start to the last agent's last peer
            text += f", {group['cpu_s'].sum() / group['window_s'].sum():.1f} cores busy"
        texts[f"{mode}, {agents} agents, {f'{pace_s:g} s apart' if pace_s else 'at once'}"] = text
    return texts


def _work(fleets: Fleets, mode: str, agents: int) -> str:
    """Return what all processes of an agent take; nothing of simulated fleets."""
    cells = fleets.of_main_nodes(fleets.cells, mode).query("agents == @agents and pace_s > 0")
    if "window_s" not in cells:
        return ""
    return f"to start an agent takes {cells['cpu_s'].median() / agents:.1f} s of CPU here"


MODES = {STANDARD: "standard", ROUTED: "proxy"}
LABELS = {STANDARD: "standard: one domain", ROUTED: "routed: a domain for each agent"}
_LIVE = {STANDARD: "standard", LAUNCHED: "third", ROUTED: "proxy"}
_LIVE_LABELS = {
    **LABELS,
    LAUNCHED: "routed, launched by the order",
    ROUTED: "routed, kept ready (ours)",
}
_SHORT = {STANDARD: "in one domain", LAUNCHED: "paper's method", ROUTED: "sfglab variant"}
_PANELS = {
    _TIME: "discovery time per agent (s)",
    "own_bytes": "bytes received per agent during discovery",
}
_PAPER: dict[str, dict[str, dict[int, float]]] = {
    _TIME: {STANDARD: {6: 40.0}, LAUNCHED: {2: 0.8, 6: 2.9}},
    "own_bytes": {STANDARD: {6: 13.6e6}, LAUNCHED: {6: 13.6e6 / 10**1.8}},
}  # section 5.3: the ends of the ranges that the text names, by number of agents
_SIZES = (2, 3, 4, 6, 12, 25, 50, 100, 200, 500, 1000)
_BESIDE = {STANDARD: -0.3, LAUNCHED: -0.05, ROUTED: 0.2}
_PACED = 0.1


@exp.figure("discovery_fleet", size=(10.4, 5.2), when=lambda run: not run["cell"].empty)
def draw_fleet(figure: Figure, run: Run[Config]) -> dict[str, Any]:
    """Draw time and traffic of every agent of the live fleets, with medians and the paper's points."""
    fleets = live(run)
    sizes = sorted({size for mode in _LIVE for size in fleets.sizes(mode)})
    for axes, column in zip(figure.subplots(1, 2), _PANELS, strict=True):
        for mode, beside in _BESIDE.items():
            _draw_agents(axes, fleets.of_main_nodes(fleets.hosts, mode), mode, column, beside)
        if column != _TIME and len(few := fleets.by_density(PAPERS_LARGEST)) > 1:
            received = _at_nodes(
                sum(fleets.main_nodes()), [(n, float(np.median(each))) for n, each in few[:2]]
            )
            axes.plot(PAPERS_LARGEST + _BESIDE[STANDARD] + _PACED, received, **series("standard"))
        _dress(axes, column, sizes)
    nodes = "{} publishing and {} subscribing nodes".format(*fleets.main_nodes())
    _explain(
        figure,
        run,
        f"Live, {nodes} an agent; standard's filled one follows from few. Bars: medians.",
    )
    figure.suptitle(_fleet_title(run, max(sizes)))
    return {"fleets": summary(run).to_dict("records"), "paper": _PAPER}


def _fleet_title(run: Run[Config], agents: int) -> str:
    """Return how many bytes fewer than with standard the agents of the largest fleet receive."""
    found = {mode: _bytes_of(run, mode) for mode in (ROUTED, LAUNCHED)}
    factors = [
        f"{rounded(float(f'{10**finding.estimate.value:.2g}'))}x ({_SHORT[mode]})"
        for mode, finding in found.items()
        if finding is not None
    ]
    if not factors:
        return f"Discovery of {agents} live agents"
    saved = " and ".join(factors)
    return f"{agents} agents discover each other with {saved} fewer bytes than plain ROS 2"


def _title(agents: int, how: str, times_s: Mapping[str, float]) -> str:
    """Return what came of a size of fleet, by kind."""
    told = " and ".join(
        f"{float(f'{time_s:.2g}'):g} s ({_SHORT[mode]})" for mode, time_s in times_s.items()
    )
    who = f"{agents} {how} agents"
    return f"{who} discover each other in {told}" if told else f"Discovery of {who}"


def _draw_agents(
    axes: Axes, hosts: pd.DataFrame, mode: str, column: str, beside: float = 0.0
) -> None:
    """Draw a dot an agent, filled where starts were at a pace, and the paper's stars; medians beside others."""
    style, shift = _LIVE[mode], _PACED if beside else 0.0
    groups: Any = hosts.groupby(["agents", "pace_s"])[column].median().items() if beside else ()
    for (agents, pace_s), median in groups:
        at = agents + beside + shift * (pace_s > 0)
        axes.hlines(median, at - 0.06, at + 0.06, color=COLORS[style], linewidth=1.8)
    for paced in (False, True):
        rows = hosts[(hosts["mode"] == mode) & ((hosts["pace_s"] > 0) == paced)]
        dots: dict[str, Any] = {
            "marker": MARKERS[style],
            "s": 16,
            "edgecolors": COLORS[style],
            "alpha": 0.7,
        }
        dots["facecolors"] = COLORS[style] if paced else "none"
        axes.scatter(rows["agents"] + beside + shift * paced, rows[column], **dots)
    points = _PAPER[column].get(mode, {})
    star: dict[str, Any] = {
        "marker": "*",
        "s": 130,
        "facecolors": "none",
        "linewidths": 1.3,
        "zorder": 4,
    }
    spots = [n + beside + shift / 2 for n in points]
    axes.scatter(spots, list(points.values()), edgecolors=COLORS[style], **star)


def _dress(axes: Axes, column: str, sizes: Sequence[int]) -> None:
    axes.set(yscale="log", xlabel="agents in the fleet", ylabel=_PANELS[column])
    low, high = axes.get_ylim()
    ticks = 10.0 ** np.arange(np.ceil(np.log10(low)), np.floor(np.log10(high)) + 1)
    axes.set_yticks(
        ticks, [f"{tick:g}" if column == _TIME else _bytes_text(tick) for tick in ticks]
    )
    axes.set_xticks(sizes, [str(size) for size in sizes])
    axes.minorticks_off()


def _explain(figure: Figure, run: Run[Config], text: str, **lines: Any) -> None:
    """Write under a figure what its dots and lines are, and how many fleets there were."""
    from matplotlib.lines import Line2D

    hollow: dict[str, Any] = {"color": "black", "linestyle": "", "markerfacecolor": "none"}
    handles = [
        *(
            Line2D([], [], linestyle="", label=_LIVE_LABELS[mode], **series(key))
            for mode, key in _LIVE.items()
        ),
        Line2D([], [], marker="o", label="hollow: at once, bound by CPU", **hollow),
        Line2D([], [], marker="*", markersize=10, label="paper", **hollow),
        *(
            Line2D([], [], color="black", linestyle=line, label=label)
            for label, line in lines.items()
        ),
    ]
    counts = live(run).cells.groupby(["mode", "agents"]).size().groupby("mode").agg(["min", "max"])
    fleets = ", ".join(f"{mode} {least} to {most}" for mode, least, most in counts.itertuples())
    title = f"{text}\nA dot is an agent. Live fleets of each size: {fleets or 'none'}."
    of: dict[str, Any] = {
        "loc": "outside lower center",
        "ncols": 4,
        "fontsize": 8.5,
        "title_fontsize": 8.5,
    }
    figure.legend(handles=handles, title=title, **of)


def _bytes_text(number: float) -> str:
    for unit, size in (("GB", 1e9), ("MB", 1e6), ("kB", 1e3)):
        if number >= size:
            return f"{number / size:g} {unit}"
    return f"{number:g} B"


@exp.figure("discovery_scale", size=(10.4, 5.4))
def draw_scale(figure: Figure, run: Run[Config]) -> dict[str, Any]:
    """Draw time and traffic over the number of agents, live and simulated, and what shared cores explain."""
    rows = run["simulated"].rename(columns={"rx_bytes": "own_bytes"})
    medians = rows.groupby(KEYS)[list(_PANELS)].median().reset_index()
    for axes, column in zip(figure.subplots(1, 2), _PANELS, strict=True):
        axes.set(xscale="log")
        for mode, style in MODES.items():
            line = medians[medians["mode"] == mode].set_index("agents")[column]
            axes.plot(line[line.index <= EXACT_MOST[mode]], color=COLORS[style])
            axes.plot(line[line.index >= EXACT_MOST[mode]], color=COLORS[style], linestyle="--")
        if not run["cell"].empty:
            _draw_live(axes, run, column)
        first, last = axes.get_xlim()
        _dress(axes, column, [size for size in _SIZES if first <= size <= last])
    cores = f"{_cores(run)} cores"
    text = f"Simulated agents have {CORES} cores each; live ones share {cores}, which is why they take longer."
    _explain(
        figure,
        run,
        text,
        **{"simulated": "-", "counted": "--", f"CPU time at a pace / {cores}": ":"},
    )
    timed = medians.dropna(subset=[_TIME])
    modes_timed = timed.groupby("agents")["mode"].transform("nunique")
    agents = int(timed.loc[modes_timed == modes_timed.max(), "agents"].max())
    largest = timed[timed["agents"] == agents]
    times = dict(zip(largest["mode"], largest[_TIME], strict=True))
    told = {mode: times[mode] for mode in MODES if mode in times}
    how = "simulated" if agents <= EXACT_MOST[ROUTED] else "counted"
    figure.suptitle(_title(agents, how, told))
    return {"live": summary(run).to_dict("records"), "simulated": medians.to_dict("records")}


def _draw_live(axes: Axes, run: Run[Config], column: str) -> None:
    """Draw the live agents and, for times, the least that started at once could take on the shared cores."""
    fleets = live(run)
    for mode, style in _LIVE.items():
        _draw_agents(axes, fleets.of_main_nodes(fleets.hosts, mode), mode, column)
        cells = fleets.of_main_nodes(fleets.cells, mode).query("pace_s > 0")
        least_s = cells.groupby("agents")["cpu_s"].median() / _cores(run)
        if column == _TIME and len(least_s):
            axes.plot(least_s, color=COLORS[style], linestyle=":")


def _cores(run: Run[Config]) -> int:
    return int(run.metadata("run").get("machine", {}).get("usable_cores", 1))


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
        (
            time_axes,
            "resolved_s",
            "time until an agent knows all its peers (s)",
            (0.01, 300),
            "{:.2f}".format,
        ),
        (bytes_axes, "rx_bytes", "received at its interface until then", (1e3, 1e9), _bytes_text),
    ):
        for mode, style in MODES.items():
            values = run["simulated"].query("mode == @mode")[column]
            middle = float(f"{values.median():.3g}")
            axes.barh(LABELS[mode], middle, color=COLORS[style], alpha=0.5)
            axes.plot(
                values,
                [LABELS[mode]] * len(values),
                MARKERS[style],
                color=COLORS[style],
                markersize=4,
            )
            axes.annotate(
                text(middle),
                (middle, LABELS[mode]),
                (6, 0),
                textcoords="offset points",
                va="center",
            )
        axes.set(xscale="log", xlim=limits, xlabel=label)
