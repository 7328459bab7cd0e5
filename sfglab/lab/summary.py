"""Summary figure: the papers' four boundaries, each with its proxy, a plot, a value and verdicts."""

from __future__ import annotations

from dataclasses import dataclass
from textwrap import fill
from typing import TYPE_CHECKING, Any

import pandas as pd

from sfglab.arp.robots import BEST
from sfglab.lab.claims import stated
from sfglab.lab.experiments import decode_once, discovery, experiment
from sfglab.lab.experiments.phases import results
from sfglab.lab.figures import drawn, file_sha256, save_figure, series
from sfglab.lab.ledger import compute_ledger
from sfglab.lab.ledger_page import COLORS
from sfglab.lab.stats import rounded

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping
    from pathlib import Path

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from sfglab.lab.claims import Entry
    from sfglab.lab.paths import Project
    from sfglab.lab.runs import Run

CAPTION = "Four boundaries: cost without and with the proxy, and the claim of the ledger for each."


@dataclass(frozen=True, slots=True, kw_only=True)
class Boundary:
    """A boundary with its proxy, which is one panel of the figure."""

    experiment: str  #: Name of the experiment whose log is plotted.
    claim: str  #: Id of the claim that the panel shows.
    method: str  #: Method of this claim.
    papers: str  #: Id of the claim about the paper's method if the panel has the sfglab variant.
    proxy: str  #: Name of the proxy and title of the panel.
    cost: str  #: Quantity on the vertical axis with its unit.
    #: Function that returns the cost without and with the proxy, by the index.
    table: Callable[[Run[Any]], pd.DataFrame]


def _decoding(run: Run[Any]) -> pd.DataFrame:
    loads = decode_once.results.cells(run)
    table = loads.pivot_table("cpu", "subscribers", "mode")[["standard", "proxy"]].dropna()
    return table.rename_axis("subscribers")


def _discovery(run: Run[Any]) -> pd.DataFrame:
    """Return the traffic that the claim compares; plain ROS 2's is extrapolated from agents with few nodes."""
    finding = discovery.exp.measure(run)[_BYTES]
    received_mb = finding.ends["MB received by standard"]
    saved = 10**finding.estimate.value
    agents = discovery.PAPERS_LARGEST
    nodes = discovery.main_nodes(run)
    return pd.DataFrame(
        {"without": [received_mb], "with": [received_mb / saved]},
        index=pd.Index(
            [agents], name=f"{agents} agents of {nodes} nodes each\n(plain ROS 2: extrapolated)"
        ),
    )


def _losing(run: Run[Any]) -> pd.DataFrame:
    """Return the share of messages lost by Rmax: the mean over the plausible conditions.

    The share without the proxy is that of the history depth with the lowest loss.
    """
    tables = results.judged(run)
    assert tables is not None, "the committed log has every plausible condition"
    lost = results.summary(tables[0])
    mean = lost.groupby(["method", "depth", "rate_max_hz"])["lost"].mean()
    best = mean[BEST].groupby("rate_max_hz").min()
    plain = mean["none"].groupby("rate_max_hz").min()
    table = pd.DataFrame({"without": plain, "with": best})
    return 100 * table.rename_axis("Rmax (Hz)\n(claim: conditions that agree)")


def _mapping(run: Run[Any]) -> pd.DataFrame:
    edges = run["stage"]["carriages"].to_list()
    return pd.DataFrame(
        {"without": [edges[0]], "with": [edges[-1]]},
        index=pd.Index([0], name="application of paper C, Fig. 8"),
    )


_WIDE_RANGE = 10  #: Ratio of values above which an axis is logarithmic.
_BYTES = "A-DISC-BYTES-OURS"
BOUNDARIES = (
    Boundary(
        experiment="decode_once",
        claim="A-CPU-OURS",
        method="sfglab variant:\nshared memory",
        papers="A-CPU-SFG",
        proxy="Decoder",
        cost="CPU load (% of one core)",
        table=_decoding,
    ),
    Boundary(
        experiment="discovery",
        claim=_BYTES,
        method="sfglab variant",
        papers="A-DISC-BYTES",
        proxy="Router",
        cost="received per agent (MB)",
        table=_discovery,
    ),
    Boundary(
        experiment="phases",
        claim="B-LOSS",
        method="OPT+LC",
        papers="",
        proxy="Caches and balanced QoS",
        cost="messages lost (%), mean over\nplausible conditions, best DEPTH",
        table=_losing,
    ),
    Boundary(
        experiment="gateways",
        claim="C-MAP",
        method="gateways",
        papers="",
        proxy="Gateway",
        cost="edges across the boundary",
        table=_mapping,
    ),
)
"""Boundaries, in the order of README.md."""


def save_summary(project: Project) -> list[Path]:
    """Draw the figure ``figures/summary`` from committed logs alone; return its files."""
    ledger = {entry.claim.id: entry for entry in compute_ledger(project, committed=True)}
    panels = []
    shown = {}
    logs = {}
    for one in BOUNDARIES:
        entry, papers = ledger[one.claim], ledger.get(one.papers)
        log = project.reference_logs / f"{one.experiment}.mcap"
        panels.append((one, one.table(experiment(one.experiment).load(log)), entry, papers))
        for each in filter(None, (entry, papers)):
            shown[each.claim.id] = f"{each.value} {each.unit}: {each.verdict.value}"
        logs[project.relative(log)] = file_sha256(log)
    figure = drawn((10.5, 4.6), _draw, panels)
    sidecar = {"experiment": "", "logs": logs, "shown": shown}
    return save_figure(figure, project.figures / "summary", sidecar)


def _draw(figure: Figure, panels: list[tuple[Boundary, pd.DataFrame, Entry, Entry | None]]) -> None:
    # values and verdicts are below
    figure.set_layout_engine("constrained", rect=(0, 0.28, 1, 0.72))
    for axes, (boundary, table, entry, papers) in zip(figure.subplots(1, 4), panels, strict=True):
        labels = {"plain ROS 2": series("standard"), boundary.method: series("proxy")}
        if len(table) > 1:
            _draw_lines(axes, table, labels)
        else:
            _draw_points(axes, table, labels)
        axes.set(ylabel=boundary.cost, title=boundary.proxy)
        axes.title.set(fontsize=9.5, weight="bold")
        text = {"xycoords": "axes fraction", "ha": "center", "va": "top", "in_layout": False}
        axes.annotate(_number(entry), (0.5, -0.31), fontsize=8.5, **text)
        verdict = f"{entry.claim.id}: {entry.verdict.value}"
        color = COLORS[entry.verdict]
        axes.annotate(verdict, (0.5, -0.66), weight="bold", color=color, **text)
        if papers:
            said = f"paper's method: {papers.value}\n{papers.claim.id}: {papers.verdict.value}"
            axes.annotate(said, (0.5, -0.74), fontsize=8.5, **text)
    figure.suptitle("Cost at four boundaries without and with a proxy (selected claims)")


def _draw_lines(axes: Axes, table: pd.DataFrame, labels: Mapping[str, dict[str, Any]]) -> None:
    for column, (label, style) in zip(table.columns, labels.items(), strict=True):
        axes.plot(table.index, table[column], markersize=4, label=label, **style)
    axes.set(xlabel=table.index.name, ylim=(0, 1.35 * float(table.max().max())))
    axes.legend(fontsize=8, loc="upper left")
    axes.locator_params(axis="x", nbins=5, integer=True)


def _draw_points(axes: Axes, table: pd.DataFrame, labels: Mapping[str, dict[str, Any]]) -> None:
    """Draw a table with one row: a labelled point for each column."""
    for place, (column, style) in enumerate(zip(table.columns, labels.values(), strict=True)):
        value = float(table[column].iloc[0])
        axes.plot(place, value, markersize=7, linestyle="", **style)
        axes.annotate(
            rounded(value), (place, value), (0, 8), textcoords="offset points", ha="center"
        )
    axes.set(xlabel=table.index.name, xlim=(-0.6, 1.6))
    axes.set_xticks([0, 1], [*labels])
    if table.max().max() > _WIDE_RANGE * table.min().min():
        axes.set_yscale("log")
        axes.margins(y=0.2)
    else:
        axes.set_ylim(0, 1.3 * float(table.max().max()))


def _number(entry: Entry) -> str:
    """Return the value with its interval, the paper's value, and how the value was obtained."""
    how = entry.measured.origins if entry.measured else "not measured"
    kind = f", {entry.interval}" if entry.interval else ""
    unit = fill(entry.unit, 30)
    return f"{entry.value} (paper: {stated(entry.claim)})\n{unit}\n{how}{kind}"
