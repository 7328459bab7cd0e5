"""Notebook helpers: one line each for a run, a figure, or the claims of an experiment.

This module draws the diagram of a set-up. Processes are side by side in the frames of their hosts. Below
them each link has a row, so that no texts overlap. A row has an arrow, and above it the messages, the
transport and the boundary. A link that crosses a boundary has the colour of the standard path.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from textwrap import fill
from typing import TYPE_CHECKING, Any

import pandas as pd

from sfglab.errors import InvalidValueError, SfglabError
from sfglab.lab import ledger
from sfglab.lab.claims import Entry, How, Ledger
from sfglab.lab.experiments import experiment
from sfglab.lab.figures import COLORS, few_colors, house_style, png_of
from sfglab.lab.notebooks import (
    COPIES,
    COPY_VARIABLE,
    LEDGER,
    NEWEST,
    REFERENCE,
    START,
    find_notebooks,
    notebook_of,
)
from sfglab.lab.paths import Project, find_project
from sfglab.lab.runs import SMOKE, C, Run
from sfglab.record import LogReader
from sfglab.tables import html_table

if TYPE_CHECKING:
    from IPython.display import HTML, Image
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from sfglab.lab.experiment import Experiment, Link, Setup
    from sfglab.lab.index import IndexPage
    from sfglab.lab.ledger_page import LedgerPage

_LARGE_BYTES = 200_000
#: Number of rows of a table that are always shown.
_SHOWN_ROWS = 10
#: Numbers from here on are shown without a fraction.
_WHOLE_FROM = 100
#: Path of the glossary from the top folder.
GLOSSARY = "book/glossary.md"
pd.set_option("display.max_colwidth", None)  # tables show texts in full


class ExperimentError(SfglabError):
    """Error of an experiment, which a notebook shows without a traceback."""

    def _render_traceback_(self) -> list[str]:  # called by IPython
        return [str(self)]


async def run(
    exp: Experiment[C],
    profile: str,
    log: str = "",
    settings: Mapping[str, Any] | None = None,
    **changes: Any,
) -> Run[C]:
    """Run an experiment with a profile, or read the log of an earlier run.

    Args:
        exp: The experiment.
        profile: Name of the profile.
        log: Path of a log to read, from the working folder or the top folder; ``reference`` is the
            committed log, and ``newest`` the newest run that counts. Empty: run.
        settings: Fields of the configuration; they override `changes`. The setting ``path`` is the
            path of the new log, from the top folder.
        changes: Fields of the configuration.

    Raises:
        InvalidValueError: The settings are no mapping.
        ExperimentError: The run failed, the log cannot be read, or a field cannot hold its value.
    """
    if not isinstance(settings or {}, Mapping):
        raise InvalidValueError(
            "settings", settings, "a mapping of fields to values, such as {'frames': 10}"
        )
    fields = {**changes, **(settings or {})}
    path = fields.pop("path", None)
    new_log = find_project().root / path if path else None
    try:
        if log:
            return _load(exp, log)
        return await exp.run(profile, path=new_log, **fields)
    except SfglabError as error:
        raise ExperimentError(f"{exp.name} failed: {error}") from error


def _load(exp: Experiment[C], log: str) -> Run[C]:
    project = find_project()
    path = Path(log) if Path(log).exists() else project.root / log
    if log in (REFERENCE, NEWEST):
        found = ledger.find_log(project, exp.name, committed=log == REFERENCE)
        if found is None:
            raise InvalidValueError(
                "log", log, f"a path, or '' to run the experiment, because there is no {log} log"
            )
        path = found
    with LogReader(path) as reader:
        made_by = (
            reader.metadata("config").get("experiment")
            if "config" in reader.metadata_names
            else None
        )
    if made_by != exp.name:
        raise InvalidValueError("log", log, f"a log of the experiment {exp.name}")
    return exp.load(path)


def picture(run: Run[Any], name: str) -> Image:
    """Return a figure of a run as an image for the notebook."""
    exp = experiment(run.experiment)
    return image_of(exp.draw(name, run)[0], exp.caption(name))


def image_of(figure: Figure, text: str = "") -> Image:
    """Return a figure as an image with an alternative text; a large image gets 256 colours."""
    from IPython.display import Image

    png = png_of(figure)
    small = png if len(png) < _LARGE_BYTES else few_colors(png, colors=256)
    return Image(small, format="png", alt=text or None)


def setup(exp: Experiment[Any]) -> Image:
    """Return a diagram of an experiment: its hosts, processes and messages."""
    links = [f"{link.source} to {link.target}: {link.carries}" for link in exp.setup.links]
    text = f"Hosts, processes and messages of {exp.name}. {'; '.join(links)}."
    return image_of(draw_setup(exp.setup), text)


def table(frame: pd.DataFrame) -> HTML:
    """Return a table without its index; rows after the tenth are behind "show all".

    Texts are shown in full. Numbers have three significant digits, and missing ones are empty. The
    fold needs no script, so that it works in saved notebooks and in the book.
    """
    from IPython.display import HTML

    head = [": ".join(name).strip(": ") if isinstance(name, tuple) else name for name in frame]
    rows = frame.astype(object).where(frame.notna(), "").map(_cell).to_numpy().tolist()
    right = {i for i, kind in enumerate(frame.dtypes) if pd.api.types.is_numeric_dtype(kind)}
    html = html_table([head, *rows[:_SHOWN_ROWS]], right=right)
    if len(rows) > _SHOWN_ROWS:
        whole = html_table([head, *rows], right=right)
        html += f"<details><summary>show all {len(rows)} rows</summary>{whole}</details>"
    return HTML(html)


def _cell(value: object) -> object:
    """Return a float as a short text, and any other value as it is."""
    if not isinstance(value, float):
        return value
    return f"{value:.0f}" if abs(value) >= _WHOLE_FROM else f"{value:.3g}"


def header(exp: Experiment[Any], *others: Experiment[Any]) -> HTML:
    """Return links to other pages, and the verdicts on the experiments' claims by committed logs.

    Links go to the first page, the previous and the next notebook, the ledger and the glossary.
    They are relative to the notebook, or to its executed copy. An experiment without a notebook has
    no previous and next one.
    """
    from IPython.display import HTML

    from sfglab.lab.index import verdicts_html

    project = find_project()
    names = sorted(path.stem for path in find_notebooks(project))
    own = notebook_of(project, exp.name)
    before = [name for name in names if name < own]
    after = [name for name in names if name > own]
    pages = {"start": START}
    if own and before:
        pages[f"previous: {before[-1]}"] = before[-1]
    if own and after:
        pages[f"next: {after[0]}"] = after[0]
    pages["ledger"] = LEDGER
    is_copy = Path.cwd().resolve() == (project.runs / COPIES).resolve()
    top = "../.." if is_copy else _top(project)
    folder = "." if is_copy else f"{top}/notebooks"
    links = [f'<a href="{folder}/{name}.ipynb">{text}</a>' for text, name in pages.items()]
    links.append(f'<a href="{top}/{GLOSSARY}">glossary</a>')
    text = f"<p>{' | '.join(links)}</p>"
    claims = [claim for one in (exp, *others) for claim in one.claims]
    if claims:
        whole = ledger.compute_ledger(project, committed=True, only=claims)
        verdicts = verdicts_html(whole, ", ")
        text += f"<p><b>Verdicts</b> from the committed logs: {verdicts}</p>"
    return HTML(text)


def _top(project: Project) -> str:
    """Return the path of the top folder from a notebook, or from its executed copy."""
    copy = os.environ.get(COPY_VARIABLE)
    return os.path.relpath(project.root, Path(copy).parent if copy else None)


def save_figures(run: Run[Any]) -> str:
    """Draw and save every figure of a run, and return their folder and names.

    The folder is ``runs/figures``. A run that counts for no claim, and a log from elsewhere, has a
    folder of its own in it, so that no figure of another run is replaced.
    """
    project = find_project()
    copy = os.environ.get(COPY_VARIABLE)
    folder = ledger.figures_folder(project, run.log, Path(copy) if copy else run.log)
    files = ledger.save_figures(project, run, folder)
    names = dict.fromkeys(file.stem for file in files)
    return f"{project.relative(folder)}: {', '.join(names)} (SVG, PNG and JSON)"


def claims_of(run: Run[Any]) -> Ledger:
    """Return the claims that a run answers, as the ledger has them and by this run."""
    return ledger.own_ledger(find_project(), run)


def require(run: Run[Any], condition: object, what: str = "") -> None:
    """Assert a condition on a run, unless its configuration was changed.

    Raises:
        AssertionError: The condition does not hold, and the run has the fields of its profile.
    """
    if not run.is_changed and not condition:
        raise AssertionError(what or "a condition of this notebook does not hold")


def check(run: Run[Any], *verdicts: str, may_deviate: Sequence[str] = ()) -> str:
    """Assert that each claim of a run has one of the verdicts; return a sentence about the claims.

    Nothing is asserted about a run with changed fields. A claim that is measured live may have any
    verdict in a smoke test, which is too short for it.

    Args:
        run: The run.
        verdicts: Allowed verdicts; ``better`` allows ``as good`` too.
        may_deviate: Claims that may deviate if the experiment gives a reason.

    Raises:
        AssertionError: A claim has another verdict.
    """
    if run.is_changed:
        return f"nothing is asserted: this run counts for no claim ({run.why_not})"
    allowed = {*verdicts, "as good"} if "better" in verdicts else set(verdicts)
    held, failed, reasons = [], [], []
    for entry in ledger.entries_of(find_project(), run):
        claim = entry.claim.id
        if entry.verdict.value in allowed:
            held.append(claim)
        elif excuse := _excuse(entry, run, may_deviate):
            reasons.append(f"{claim} deviates: {excuse}")
        else:
            failed.append(f"{claim}: {entry.verdict.value}")
    if failed:
        raise AssertionError(
            f"{run.experiment}: {', '.join(failed)}; expected {' or '.join(verdicts)}"
        )
    is_success = {"reproduced", "better"}.issuperset(verdicts)
    verb = "hold" if is_success else f"are {' or '.join(verdicts)}"
    return "\n".join([f"Claims that {verb} in this run: {', '.join(held) or 'none'}", *reasons])


def _excuse(entry: Entry, run: Run[Any], may_deviate: Sequence[str]) -> str:
    """Return why a claim may deviate; empty: it may not."""
    measured = entry.measured
    if measured is None:
        return ""
    if entry.claim.id in may_deviate and measured.reason:
        return measured.reason
    if run.profile == SMOKE and measured.how is How.LIVE:
        return f"{measured.estimate}, in a smoke test, which is too short to measure by"
    return ""


def whole_ledger(profile: str | None = None) -> Ledger:
    """Return the ledger of all claims; runs of the profile are preferred."""
    return ledger.compute_ledger(find_project(), profile=profile)


def claims_page(whole: Ledger) -> LedgerPage:
    """Return a page of all claims with filters, interval plots, details and citations."""
    from sfglab.lab.ledger_page import LedgerPage

    project = find_project()
    return LedgerPage(project, whole, _top(project))


def result(whole: Ledger, says: str, figure: str) -> IndexPage:
    """Return a result with its figure, verdicts and citations; ``{ID}`` in the sentence is a claim's value."""
    from sfglab.lab.index import make_result

    return make_result(find_project(), whole, says, figure)


def index(whole: Ledger) -> IndexPage:
    """Return all experiments by paper and section, each with a figure and its verdicts."""
    from sfglab.lab.index import make_index

    return make_index(find_project(), whole)


#: Width and height of a process, inches.
_WIDE = 1.75
_HIGH = 0.85
#: Distance of two processes, and half the distance of two hosts, inches.
_APART = 0.2
#: Height of a line of text, inches.
_LINE = 0.13
#: Height of a link without its text, inches.
_ROW = 0.2
#: Width of a process in letters.
_LETTERS = 27


def draw_setup(setup: Setup) -> Figure:
    """Draw a set-up in a figure of the size that it needs."""
    from matplotlib.figure import Figure

    hosts = list(dict.fromkeys(actor.host for actor in setup.actors))
    actors = sorted(setup.actors, key=lambda actor: hosts.index(actor.host))
    columns = {
        a.name: i * (_WIDE + _APART) + hosts.index(a.host) * _APART for i, a in enumerate(actors)
    }
    said = [_words(link, abs(columns[link.target] - columns[link.source])) for link in setup.links]
    bottom = -_HIGH - sum(_ROW + _LINE * (1 + text.count("\n")) for text in said) - 0.15
    width = columns[actors[-1].name] + _WIDE
    with house_style():
        figure = Figure(figsize=(width + 0.4, 0.65 - bottom))
        figure.set_layout_engine("none")
        axes = figure.add_axes((0, 0, 1, 1), xlim=(-0.2, width + 0.2), ylim=(bottom - 0.1, 0.55))
        axes.set_axis_off()
        for host in hosts:
            own = [columns[actor.name] for actor in actors if actor.host == host]
            _draw_box(
                axes,
                (own[0] - 0.1, bottom),
                (own[-1] - own[0] + _WIDE + 0.2, 0.45 - bottom),
                "#f4f4f4",
            )
            title = fill(host, _LETTERS * len(own))
            axes.text(own[0], 0.24, title, fontsize=8, color="#555", style="italic", va="center")
        for actor in actors:
            x = columns[actor.name]
            axes.plot([x + _WIDE / 2] * 2, [-_HIGH, bottom + 0.1], color="#aaa", lw=0.8, zorder=1)
            _draw_box(axes, (x, -_HIGH), (_WIDE, _HIGH), "white")
            count = f" (number: {actor.count})" if actor.count != "1" else ""
            axes.text(x + 0.08, -0.18, actor.name, fontsize=8.5, weight="bold", va="center")
            does = fill(f"{actor.does}{count}", _LETTERS)
            axes.text(x + 0.08, -0.34, does, fontsize=7, color="#333", va="top")
        y = -_HIGH
        for link, text in zip(setup.links, said, strict=True):
            y -= _ROW + _LINE * (1 + text.count("\n"))
            _draw_link(
                axes,
                link,
                text,
                y,
                [columns[end] + _WIDE / 2 for end in (link.source, link.target)],
            )
    return figure


def _words(link: Link, length: float) -> str:
    """Return the text above an arrow; its length is in inches."""
    over = "" if link.over == "DDS" else f" over {link.over}"
    crossed = f" [{link.boundary}]" if link.boundary else ""
    return fill(f"{link.carries}{over}{crossed}", int(_LETTERS * max(length / _WIDE, 1)))


def _draw_box(
    axes: Axes, corner: tuple[float, float], size: tuple[float, float], color: str
) -> None:
    from matplotlib.patches import FancyBboxPatch

    style = "round,pad=0,rounding_size=0.06"
    axes.add_patch(FancyBboxPatch(corner, *size, boxstyle=style, fc=color, ec="#888", zorder=1))


def _draw_link(axes: Axes, link: Link, text: str, y: float, ends: list[float]) -> None:
    color = COLORS["standard"] if link.boundary else COLORS["proxy"]
    arrow = {"arrowstyle": "-|>", "color": color, "lw": 1.3, "shrinkA": 0, "shrinkB": 0}
    axes.annotate("", (ends[1], y), (ends[0], y), arrowprops=arrow)
    white = {"boxstyle": "round,pad=0.1", "fc": "#f4f4f4", "ec": "none"}
    axes.text(
        sum(ends) / 2, y + 0.05, text, fontsize=7, color=color, ha="center", va="bottom", bbox=white
    )
