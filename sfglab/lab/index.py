"""Index of all experiments, by paper and section: a figure, its caption, and the verdicts of the ledger."""

from __future__ import annotations

import base64
from dataclasses import dataclass
from html import escape
from typing import TYPE_CHECKING, Any

from sfglab.lab.claims import Entry, Ledger, criterion_of
from sfglab.lab.experiments import experiment
from sfglab.lab.figures import few_colors
from sfglab.lab.notebooks import INDEX, experiments_of, find_notebooks, read_notebook

if TYPE_CHECKING:
    from collections.abc import Iterable
    from pathlib import Path

    from sfglab.lab.experiment import Experiment
    from sfglab.lab.paths import Project

PAPERS = {
    "A": "SFG-ROS: A Resource-Aware Framework for Dense Multi-Agent Perception",
    "B": "Performance Improvement of Multi-Robot Data Transmission in Aggregated Robot Processing Architecture "
    "with Caches and QoS Balancing Optimization",
    "C": "Mapping and Optimizing Communication in ROS 2-based Applications on Configurable System-on-Chip "
    "Platforms",
}
COLORS = {
    "reproduced": "#00664B",
    "better": "#00558A",
    "as good": "#00558A",
    "fitted": "#6B4E9B",
    "undecided": "#7A6000",
    "deviates": "#A04000",
    "not yet": "#666666",
}
_WIDTH_PX = 240
_CELL = 'style="text-align: left; vertical-align: top; white-space: normal"'


@dataclass(frozen=True, slots=True)
class IndexPage:
    """HTML page of the index in a notebook."""

    html: str  #: One table per paper.

    def __repr__(self) -> str:
        what = "claims" if "<th " in self.html else "notebooks"
        return f"<index of {self.html.count('</td></tr>')} {what}>"

    def _repr_html_(self) -> str:
        return self.html


def make_index(project: Project, ledger: Ledger) -> IndexPage:
    """Return the index of a checkout's notebooks, by paper and section."""
    rows = []
    for path in find_notebooks(project):
        if path.stem != INDEX:
            rows += _rows(project, path, ledger)
    rows.sort()
    html = _source(ledger)
    for paper, title in PAPERS.items():
        lines = "".join(row for where, row in rows if where.startswith(paper))
        html += f"<h3>Paper {paper}: {title}</h3><table><tbody>{lines}</tbody></table>"
    return IndexPage(html)


def make_claims_page(ledger: Ledger) -> IndexPage:
    """Return a page with every claim: the paper's words, our criterion, our value, verdict and figures."""
    head = (
        "claim",
        "the paper",
        "our criterion",
        "ours",
        "figures",
    )
    html = "<tr>" + "".join(f"<th {_CELL}>{escape(one)}</th>" for one in head) + "</tr>"
    rows = "".join(map(_claim_row, ledger))
    return IndexPage(f"{_source(ledger)}<table><tbody>{html}{rows}</tbody></table>")


def _source(ledger: Ledger) -> str:
    """Return the sentence that names the logs of the values."""
    return f"<p>Values and verdicts are from {escape(ledger.source)}.</p>" if ledger.source else ""


def _ours(entry: Entry) -> str:
    if not entry.value:
        return entry.missing
    interval = f" ({entry.interval})" if entry.interval else ""
    return f"{entry.value} {entry.unit}{interval}"


def _claim_row(entry: Entry) -> str:
    claim = entry.claim
    cells = (
        verdicts_html([entry]),
        escape(f"{claim.where}: {claim.criterion.sentence if claim.criterion else claim.says}"),
        "<br>".join(map(escape, criterion_of(claim))),
        escape(_ours(entry)),
        "<br>".join(f'<a href="../figures/{name}.png">{name}</a>' for name in entry.figures),
    )
    return _line(cells)


def _line(cells: Iterable[str]) -> str:
    return "<tr>" + "".join(f"<td {_CELL}>{cell}</td>" for cell in cells) + "</tr>"


def _rows(project: Project, path: Path, ledger: Ledger) -> list[tuple[str, str]]:
    """Return paper with section and the table line of each experiment of a notebook."""
    title = read_notebook(path).cells[0].source.splitlines()[0].removeprefix("# ")
    experiments = map(experiment, experiments_of(path))
    return [_row(project, path, title, exp, ledger) for exp in experiments]


def _row(
    project: Project, path: Path, title: str, exp: Experiment[Any], ledger: Ledger
) -> tuple[str, str]:
    """Return an experiment's paper with section, and its table line."""
    committed = [n for n in exp.drawings if (project.figures / f"{n}.png").is_file()]
    name = committed[0] if committed else ""
    caption = exp.caption(name) if name else ""
    picture = _thumbnail(project.figures / f"{name}.png", caption) if name else ""
    claims = verdicts_html(entry for entry in ledger if entry.claim.experiment == exp.name)
    link = f'<b><a href="{path.name}">{path.stem}</a></b> {escape(exp.where)}<br>{escape(title)}'
    return exp.where, _line((picture, link, escape(caption), claims))


def verdicts_html(entries: Iterable[Entry], between: str = "<br>") -> str:
    """Return HTML of claims with their verdicts in colour, joined by a separator."""
    return between.join(
        f'<span style="white-space: nowrap">{e.claim.id} '
        f'<b style="color: {COLORS[e.verdict.value]}">{e.verdict.value}</b></span>'
        for e in entries
    )


def _thumbnail(png: Path, text: str) -> str:
    """Return HTML that contains a figure in small size, so that it is visible wherever the notebook is."""
    small = few_colors(png.read_bytes(), (2 * _WIDTH_PX, 2 * _WIDTH_PX), 64)
    data = base64.b64encode(small).decode()
    return f'<img alt="{escape(text)}" width="{_WIDTH_PX}" src="data:image/png;base64,{data}">'
