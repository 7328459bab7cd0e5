"""The page that says it all: the papers' four boundaries, each with its proxy, a figure and a number."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from sfglab.lab.experiments import balancing, decode_once, discovery, experiment, transfer
from sfglab.lab.figures import drawn, file_sha256, save_figure, series
from sfglab.lab.index import COLORS
from sfglab.lab.ledger import compute_ledger

if TYPE_CHECKING:
    from pathlib import Path

    from matplotlib.figure import Figure

    from sfglab.lab.claims import Entry
    from sfglab.lab.paths import Project
    from sfglab.lab.runs import Run

CAPTION = "The four boundaries: what they cost without and with their proxy, and what the ledger says of it."


def _decoding(run: Run[Any]) -> pd.DataFrame:
    loads = decode_once.analysis.cells(run).query("codec == 'h264'")
    return loads.pivot_table("cpu", "subscribers", "mode")[["standard", "dds"]].dropna()


def _discovery(run: Run[Any]) -> pd.DataFrame:
    """By an agent's nodes, because larger standard fleets than these keep all cores busy, which adds bytes."""
    fleets, agents = discovery.analysis.live(run), discovery.analysis.PAPERS_LARGEST
    routed = fleets.by_pace("routed", agents, "own_bytes")[0]
    columns = {
        "standard": {nodes: np.median(sample) / 1e6 for nodes, sample in fleets.by_density(agents)},
        "routed": {sum(fleets.main_nodes()): np.median(routed) / 1e6},
    }
    return pd.DataFrame(columns).rename_axis(f"nodes of each of {agents} agents")


def _caching(run: Run[Any]) -> pd.DataFrame:
    sent = (
        (1 - balancing.analysis.saved(run))
        .mean()
        .to_frame("cached")
        .rename_axis("readings a second")
    )
    return sent.assign(all=1.0)[["all", "cached"]].mul(sent.index, axis=0)


def _transfer(run: Run[Any]) -> pd.DataFrame:
    table = transfer.analysis.bars(run).query(
        "panel == 'hardware to hardware' and model == 'stored'"
    )
    return (
        table.query("message_bytes == 10**7").set_index("subscribers")[["smt_s", "gateway_s"]] * 1e3
    )


BOUNDARIES = (
    (
        "decode_once",
        "A-CPU-SFG",
        "network, device:\ndecoder, on demand",
        "CPU (% of a core)",
        _decoding,
    ),
    (
        "discovery",
        "A-DISC-BYTES",
        "agent, global domain:\nrouter",
        "an agent receives (MB)",
        _discovery,
    ),
    (
        "balancing",
        "B-COOP",
        "robot, processing station:\ncaches and QoS",
        "sent a second (mean)",
        _caching,
    ),
    ("transfer", "C-HWHW", "software, hardware:\ngateway", "10 MB to all take (ms)", _transfer),
)
"""As README.md lists them: whose figure, claim, boundary and proxy, what is drawn: by x without and with it."""


def save_summary(project: Project) -> list[Path]:
    """Draw the page into ``figures/summary``, from committed logs alone; return the files."""
    ledger = {entry.claim.id: entry for entry in compute_ledger(project, committed=True)}
    logs = {name: project.reference_logs / f"{name}.mcap" for name, *_ in BOUNDARIES}
    tables = [draw(experiment(name).load(logs[name])) for name, *_, draw in BOUNDARIES]
    entries = [ledger[claim] for _, claim, *_ in BOUNDARIES]
    shown = {entry.claim.id: f"{_number(entry)}: {entry.verdict.value}" for entry in entries}
    origin = {project.relative(log): file_sha256(log) for log in logs.values()}
    figure = drawn((10, 4.2), _draw, tables, entries)
    return save_figure(
        figure, project.figures / "summary", {"experiment": "", "logs": origin, "shown": shown}
    )


def _draw(figure: Figure, tables: list[pd.DataFrame], entries: list[Entry]) -> None:
    figure.set_layout_engine("constrained", rect=(0, 0.24, 1, 0.76))  # below: numbers and verdicts
    parts = zip(figure.subplots(1, 4), BOUNDARIES, tables, entries, strict=True)
    for axes, (_, _, title, cost, _), table, entry in parts:
        for column, key in zip(table.columns, ("standard", "proxy"), strict=True):
            label = {"standard": "without", "proxy": "with its proxy"}[key]
            axes.plot(table.index, table[column], markersize=4, label=label, **series(key))
        axes.set(xlabel=table.index.name, ylabel=cost, ylim=(0, 1.35 * float(table.max().max())))
        axes.set_title(title, fontsize=9.5, weight="bold")
        axes.legend(fontsize=8, loc="upper left")
        style: dict[str, Any] = {
            "xycoords": "axes fraction",
            "ha": "center",
            "va": "top",
            "in_layout": False,
        }
        axes.annotate(_number(entry), (0.5, -0.24), **style)
        verdict, style["color"] = (
            f"{entry.claim.id}: {entry.verdict.value}",
            COLORS[entry.verdict.value],
        )
        axes.annotate(verdict, (0.5, -0.5), weight="bold", **style)
        axes.locator_params(axis="x", nbins=5, integer=True)
    figure.suptitle(
        "A message crosses each boundary once: what was paid per subscriber is paid per message"
    )


def _number(entry: Entry) -> str:
    """Return our figure with its interval, beside the paper's."""
    paper = entry.claim.paper
    beside = "paper: no number" if paper is None else f"paper: {paper:.3g}"
    if entry.measured is None:
        return f"to be recorded, {beside}\n{entry.claim.unit}"
    ours = entry.measured.estimate
    spread = f" [{ours.low:.3g}, {ours.high:.3g}]" if ours.low < ours.high else ""
    return f"{ours.value:.3g}{spread}, {beside}\n{entry.claim.unit}\n({entry.measured.how.value})"
