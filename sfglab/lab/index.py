"""The first page: results with their figures, and all experiments by paper and section with verdicts."""

from __future__ import annotations

import base64
import re
from dataclasses import dataclass
from html import escape
from typing import TYPE_CHECKING, Any

from sfglab.lab.claims import accepted, stated
from sfglab.lab.experiments import EXPERIMENTS, experiment
from sfglab.lab.figures import few_colors
from sfglab.lab.ledger_page import PAPERS, cited_html, verdict_html
from sfglab.lab.notebooks import REPORTS, cells_of, experiments_of, find_notebooks, notebook_of

if TYPE_CHECKING:
    from collections.abc import Iterable
    from pathlib import Path

    from sfglab.lab.claims import Entry, Ledger
    from sfglab.lab.experiment import Experiment
    from sfglab.lab.paths import Project

_WIDTH_PX = 240
_RESULT_PX = 640
_CELL = 'style="text-align: left; vertical-align: top; white-space: normal"'


@dataclass(frozen=True, slots=True)
class IndexPage:
    """A part of the first page, as a notebook shows it."""

    html: str
    text: str  #: Content of the part as plain text.

    def __repr__(self) -> str:
        return self.text

    def _repr_html_(self) -> str:
        return self.html


def make_index(project: Project, ledger: Ledger) -> IndexPage:
    """Return the index of a checkout's notebooks, by paper and section."""
    rows = []
    for path in find_notebooks(project):
        if path.stem in REPORTS:
            continue
        title = cells_of(path)[0]["source"].splitlines()[0].removeprefix("# ")
        experiments = map(experiment, experiments_of(path))
        rows += [(exp.where, _row(project, path, title, exp, ledger)) for exp in experiments]
    html = f"<p>Verdicts are from {escape(ledger.source)}.</p>" if ledger.source else ""
    for paper, title in PAPERS.items():
        lines = "".join(row for where, row in rows if where.startswith(paper))
        html += f"<h3>Paper {paper}: {title}</h3><table><tbody>{lines}</tbody></table>"
    return IndexPage(html, f"<index of {len(rows)} experiments>")


def make_result(project: Project, ledger: Ledger, says: str, figure: str) -> IndexPage:
    """Return one result: a sentence with values of the ledger, its figure, verdicts, links and citations.

    Args:
        project: The checkout.
        ledger: The claims.
        says: The sentence. ``{ID}`` is replaced by the value of the claim `ID` with its interval, and
            ``{ID:.0%}`` by the same numbers in this format.
        figure: Name of a committed figure.
    """
    sentence = says
    entries = []
    for entry in ledger:
        for place, form in re.findall(rf"({{{entry.claim.id}(?::(.+?))?}})", says):
            entries.append(entry)
            sentence = sentence.replace(place, _formatted(entry, form))
    exp = next(exp for exp in map(experiment, EXPERIMENTS) if figure in exp.drawings)
    notebook = notebook_of(project, exp.name)
    png = project.figures / f"{figure}.png"
    most_runs = max((len(entry.runs) for entry in entries), default=0)
    runs = f"The figure shows one of the {most_runs} runs.<br>" if most_runs else ""
    parts = (
        f"<p>{escape(sentence)}</p>",
        _thumbnail(png, exp.caption(figure), _RESULT_PX),
        f"<p>{runs}{'<br>'.join(_judged(entry) for entry in entries)}<br>",
        f'Go deeper: <a href="{notebook}.ipynb">{notebook}</a></p>',
        f"<details><summary>Cite this</summary>{cited_html(project, entries)}</details>",
    )
    return IndexPage("".join(parts), sentence)


def _formatted(entry: Entry, form: str) -> str:
    """Return a claim's value and interval in a format; an empty format stands for the ledger's."""
    shown = entry.shown
    if not form or shown is None:
        return entry.value or "no value"
    value = format(shown.value, form)
    if entry.interval:
        value += f" [{shown.low:{form}}, {shown.high:{form}}]"
    return value.replace("%", " %")


def _judged(entry: Entry) -> str:
    """Return HTML of a claim's verdict, with its direction, the paper's number and the accepted values."""
    facts = [entry.direction, f"paper: {stated(entry.claim)}"]
    facts.append(f"accepted: {accepted(entry.claim)}")
    return f"{verdicts_html([entry])} ({escape('; '.join(filter(None, facts)))})"


def _row(project: Project, path: Path, title: str, exp: Experiment[Any], ledger: Ledger) -> str:
    """Return the table line of an experiment."""
    name = next(iter(exp.drawings), "")
    caption = exp.caption(name) if name else ""
    picture = _thumbnail(project.figures / f"{name}.png", caption)
    claims = verdicts_html(entry for entry in ledger if entry.claim.id in exp.claims)
    link = f'<b><a href="{path.name}">{path.stem}</a></b> {escape(exp.where)}<br>{escape(title)}'
    cells = (picture, link, escape(caption), claims)
    return "<tr>" + "".join(f"<td {_CELL}>{cell}</td>" for cell in cells) + "</tr>"


def verdicts_html(entries: Iterable[Entry], between: str = "<br>") -> str:
    """Return HTML of claims with their verdicts in colour, joined by a separator."""
    return between.join(
        f'<span style="white-space: nowrap">{entry.claim.id} {verdict_html(entry)}</span>'
        for entry in entries
    )


def _thumbnail(png: Path, text: str, width: int = _WIDTH_PX) -> str:
    """Return HTML that contains a figure in small size, so that it is visible wherever the notebook is.

    A figure that was not drawn is left out.
    """
    if not png.is_file():
        return ""
    small = few_colors(png.read_bytes(), (2 * width, 2 * width), 64)
    data = base64.b64encode(small).decode()
    return f'<img alt="{escape(text)}" width="{width}" src="data:image/png;base64,{data}">'
