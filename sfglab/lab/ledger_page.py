"""The ledger as a page: a line for each claim with an interval plot and the verdict, and details to unfold.

The page needs no script: details are ``<details>`` elements, and the citation is text to copy. In
JupyterLab it has filters. In the book a script makes them, by the attributes ``data-paper`` and
``data-verdict`` of the rows.
"""

from __future__ import annotations

import base64
from html import escape
from typing import TYPE_CHECKING, Any

import sfglab
from sfglab.lab.claims import Entry, Ledger, Verdict, accepted, criterion_of, stated
from sfglab.lab.figures import file_sha256
from sfglab.lab.notebooks import notebook_of

if TYPE_CHECKING:
    from collections.abc import Iterable

    from sfglab.lab.paths import Project

COLORS = {
    Verdict.REPRODUCED: "#00664B",
    Verdict.BETTER: "#00558A",
    Verdict.AS_GOOD: "#00558A",
    Verdict.FITTED: "#6B4E9B",
    Verdict.UNDECIDED: "#7A6000",
    Verdict.DEVIATES: "#A04000",
    Verdict.NOT_YET: "#666666",
}
"""Colour of each verdict."""
PAPERS = {
    "A": "SFG-ROS: A Resource-Aware Framework for Dense Multi-Agent Perception",
    "B": "Performance Improvement of Multi-Robot Data Transmission in Aggregated Robot Processing Architecture "
    "with Caches and QoS Balancing Optimization",
    "C": "Mapping and Optimizing Communication in ROS 2-based Applications on Configurable System-on-Chip "
    "Platforms",
}
"""Titles of the papers."""
_AUTHORS = {
    "A": "Blessing et al., 2026",
    "B": "Jalil, Kobayashi and Saitoh, 2023",
    "C": "Lienen, Nowosad and Platzner, 2023",
}
ALL = "all"  #: Choice of a filter that hides nothing.
LEGEND = (
    "The grey bar is the acceptance range, the line is the paper's number, and the dot is sfglab's value with its "
    "interval. Each claim has a scale of its own. Click a statement for its acceptance range, reasons and a citation."
)
_WIDTH = 100  #: Width of an interval plot without its edges, px.
_HEIGHT = 20  #: Height of an interval plot, px.
_EDGE = 6  #: Space for half a dot on both sides, px.
_HASH_LETTERS = 16
_CELL = "text-align: left; vertical-align: top; white-space: normal; padding: 2px 8px 2px 0"


class LedgerPage:
    """Page of the ledger, with filters in a running notebook.

    Args:
        project: The checkout.
        ledger: The claims.
        top: Path of the top folder in links.
    """

    def __init__(self, project: Project, ledger: Ledger, top: str) -> None:
        self._project = project
        self._ledger = ledger
        self._top = top
        self.html = page_html(project, ledger, top)  #: The whole page.

    def __repr__(self) -> str:
        return repr(self._ledger)

    def _repr_mimebundle_(self, **_: object) -> tuple[dict[str, Any], dict[str, Any]]:
        from sfglab.view.widgets import widgets

        made = widgets()
        verdicts = dict.fromkeys(entry.verdict.value for entry in self._ledger)
        paper = made.Dropdown(options=[ALL, *PAPERS], description="paper")
        verdict = made.Dropdown(options=[ALL, *verdicts], description="verdict")
        shown = made.HTML(self.html)

        def show(_: object) -> None:
            chosen = chosen_of(self._ledger, paper.value, verdict.value)
            shown.value = page_html(self._project, chosen, self._top)

        paper.observe(show, "value")
        verdict.observe(show, "value")
        page = made.VBox([made.HBox([paper, verdict]), shown])
        return {**page._repr_mimebundle_(), "text/html": self.html, "text/plain": repr(self)}, {}


def chosen_of(ledger: Ledger, paper: str = ALL, verdict: str = ALL) -> Ledger:
    """Return the claims of one paper and one verdict; `ALL` stands for every one."""
    return Ledger(
        entry
        for entry in ledger
        if paper in (ALL, paper_of(entry)) and verdict in (ALL, entry.verdict.value)
    )


def paper_of(entry: Entry) -> str:
    """Return the letter of a claim's paper."""
    return entry.claim.where[0]


def page_html(project: Project, ledger: Ledger, top: str = "..") -> str:
    """Return the page as HTML; `top` is the path of the top folder in links."""
    columns = ("claim", "the paper's statement", "paper and sfglab")
    head = "".join(f'<th style="{_CELL}">{name}</th>' for name in columns)
    lines = ""
    for letter, title in PAPERS.items():
        of_paper = [entry for entry in ledger if paper_of(entry) == letter]
        if of_paper:
            name = f'<th colspan="{len(columns)}" style="{_CELL}">Paper {letter}: {title}</th>'
            lines += f'<tr data-paper="{letter}">{name}</tr>'
        lines += "".join(_line(project, entry, top) for entry in of_paper)
    table = f"<table><thead><tr>{head}</tr></thead><tbody>{lines}</tbody></table>"
    meanings = "<br>".join(map(escape, ledger.legend()))
    summary = f"{len(ledger)} claims, {repr(ledger).strip('<>')}."
    return f"<p>{escape(summary)}</p><p>{LEGEND}</p><p>{meanings}</p>{table}"


def verdict_html(entry: Entry) -> str:
    """Return a claim's verdict in its colour."""
    return f'<b style="color: {COLORS[entry.verdict]}">{entry.verdict.value}</b>'


def _line(project: Project, entry: Entry, top: str) -> str:
    claim = entry.claim
    details = {
        "paper": f"{claim.where}; {stated(claim)}",
        "the paper's words": claim.criterion.sentence if claim.criterion else "",
        "accepted": "; ".join(criterion_of(entry)),
        "interval": uncertainty(entry),
        "reason": entry.reason,
    }
    lines = [f"<b>{name}</b>: {escape(text)}" for name, text in details.items() if text]
    notebook = notebook_of(project, claim.experiment or "")
    if notebook:
        link = f'<a href="{top}/notebooks/{notebook}.ipynb">{notebook}</a>'
        lines.append(f"<b>explained in</b>: {link}")
    links = [f'<a href="{top}/figures/{name}.png">{name}</a>' for name in entry.figures]
    if links:
        lines.append(f"<b>figures</b>: {', '.join(links)}")
    # The book adds a button to copy to elements of this class.
    lines.append(f'<b>to cite</b>:<div class="highlight">{cited_html(project, [entry])}</div>')
    numbers = f"sfglab: {entry.value or 'no value'}"
    if claim.paper is not None:
        numbers = f"paper: {stated(claim)}; {numbers}"
    values = [numbers, entry.unit, *entry.failing_ends]
    cells = (
        (_CELL, f"{claim.id}<br>{verdict_html(entry)}<br>{entry.direction}"),
        (
            f"{_CELL}; overflow-wrap: anywhere",  # a path in a text may be long
            f"<details><summary>{escape(claim.says)}</summary>{'<br>'.join(lines)}</details>",
        ),
        (
            f"{_CELL}; min-width: 9em",
            f"{interval_plot(entry)}<br>{'<br>'.join(map(escape, values))}",
        ),
    )
    row = "".join(f'<td style="{style}">{cell}</td>' for style, cell in cells)
    return f'<tr data-paper="{paper_of(entry)}" data-verdict="{entry.verdict.value}">{row}</tr>'


def interval_plot(entry: Entry) -> str:
    """Return an image of the acceptance range, the paper's number, and our value with its interval.

    It is an image and no SVG element, because JupyterLab removes those from pages that it does not trust.
    """
    claim = entry.claim
    shown = entry.measured.estimate if entry.measured else None
    low, high = claim.band
    marks = [low, high]
    if claim.paper is not None:
        marks.append(claim.paper)
    if shown:
        marks += [shown.low, shown.high]
    first = min(marks)
    span = max(marks) - first

    def x(value: float) -> float:
        share = (value - first) / span if span else 0.5
        return round(_EDGE + _WIDTH * share, 1)

    middle = _HEIGHT // 2
    wide = max(x(high) - x(low), 2)
    parts = [f'<rect x="{x(low)}" y="4" width="{wide}" height="{_HEIGHT - 8}" fill="#bbb"/>']
    if claim.paper is not None:
        place = x(claim.paper)
        parts.append(f'<path d="M{place} 1V{_HEIGHT - 1}" stroke="#777" stroke-width="2"/>')
    if shown:
        color = COLORS[entry.verdict]
        line = f"M{x(shown.low)} {middle}H{x(shown.high)}"
        parts.append(f'<path d="{line}" stroke="{color}" stroke-width="3"/>')
        parts.append(f'<circle cx="{x(shown.value)}" cy="{middle}" r="4.5" fill="{color}"/>')
    size = f'width="{_WIDTH + 2 * _EDGE}" height="{_HEIGHT}"'
    svg = f'<svg xmlns="http://www.w3.org/2000/svg" {size}>{"".join(parts)}</svg>'
    data = base64.b64encode(svg.encode()).decode()
    text = f"accepted: {accepted(claim)}; sfglab: {entry.value or 'no value'} {entry.unit}"
    style = 'style="max-width: none"'
    return f'<img {size} {style} alt="{escape(text)}" src="data:image/svg+xml;base64,{data}">'


def cited_html(project: Project, entries: Iterable[Entry]) -> str:
    """Return the citations of claims as a text to copy."""
    text = "\n\n".join(citation(project, entry) for entry in entries)
    return f'<pre style="white-space: pre-wrap; text-align: left">{escape(text)}</pre>'


def uncertainty(entry: Entry) -> str:
    """Return what a value is, and what its interval is; empty if the value has no interval."""
    if not entry.interval:
        return ""
    if entry.runs:
        return f"median of {len(entry.runs)} runs; the bracket spans their 95 % intervals"
    if entry.measured and entry.measured.by_criterion:
        return "one run; 95 % interval that counts its trials as independent"
    return "one run; 95 % interval"


def citation(project: Project, entry: Entry) -> str:
    """Return a text that cites a claim's value with its uncertainty, log and paper."""
    claim = entry.claim
    letter = paper_of(entry)
    source = f"{_AUTHORS[letter]}, {PAPERS[letter]}, {claim.where.removeprefix(letter).strip()}"
    sentences = [
        f"sfglab {sfglab.__version__}, claim {claim.id}: {claim.says} ({source})",
        f"Paper: {stated(claim)}; accepted: {accepted(claim)}",
    ]
    value = f"{entry.value} {entry.unit}" if entry.value else "no value"
    kind = f" ({uncertainty(entry)})" if entry.interval else ""
    sentences.append(f"sfglab: {value}{kind}; verdict: {entry.verdict.value}")
    log = project.root / entry.log
    if entry.measured and entry.log and log.is_file():
        machine, *_, commit = entry.origin.split("; ")
        digest = file_sha256(log)[:_HASH_LETTERS]
        origins = entry.measured.origins.capitalize()
        sentences.append(f"{origins} on {machine}; log {entry.log}, SHA-256 {digest}..., {commit}")
    return ". ".join(sentences) + "."
