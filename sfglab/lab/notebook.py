"""Notebook helpers: one line each for a run, a picture, the claims of an experiment.

What is behind it is in the modules that it imports, but for the picture of a set-up: processes side by side in
their hosts' frames, and below them a line for each link, so that no words cross: an arrow, and above it what is
sent, over what, and what is crossed, in the colour of the standard path where anything is.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from textwrap import fill
from typing import TYPE_CHECKING, Any

import pandas as pd

from sfglab.errors import InvalidValueError, SfglabError
from sfglab.lab import ledger
from sfglab.lab.claims import Entry, How, Ledger, OwnLedger
from sfglab.lab.experiments import experiment
from sfglab.lab.figures import COLORS, few_colors, house_style, png_of
from sfglab.lab.paths import find_project
from sfglab.lab.runs import SMOKE, C, Run
from sfglab.record import LogReader

if TYPE_CHECKING:
    from IPython.display import Image, Video
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from pandas.io.formats.style import Styler

    from sfglab.lab.experiment import Experiment, Link, Setup
    from sfglab.lab.index import IndexPage

_LARGE_BYTES = 200_000
pd.set_option("display.max_colwidth", None)  # tables show their sentences whole


class ExperimentError(SfglabError):
    """An experiment that failed; a notebook shows the sentence without a traceback."""

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
        log: Path of a log to read, from the working folder or the top folder; empty: run.
        settings: Fields of the configuration; they override `changes`. The setting ``path`` is the
            path of the new log, from the top folder.
        changes: Fields of the configuration.

    Raises:
        InvalidValueError: The settings are no mapping.
        ExperimentError: The run failed, the log cannot be read, or a field cannot hold its value.
    """
    if not isinstance(settings or {}, Mapping):
        raise InvalidValueError(
            "settings", settings, "fields of the configuration and their values"
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
    path = Path(log) if Path(log).exists() else find_project().root / log
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
    """Return one of a run's figures as a picture for the notebook."""
    exp = experiment(run.experiment)
    return image_of(exp.draw(name, run)[0], exp.caption(name))


def image_of(figure: Figure, text: str = "") -> Image:
    """Return a figure as a picture, with a text for those who do not see it; a large one gets 256 colours."""
    from IPython.display import Image

    png = png_of(figure)
    small = png if len(png) < _LARGE_BYTES else few_colors(png, colors=256)
    return Image(small, format="png", alt=text or None)


def video(mp4: bytes, width: int) -> Video:
    """Return a film for the notebook, so many pixels wide."""
    from IPython.display import Video

    return Video(mp4, embed=True, mimetype="video/mp4", width=width)


def setup(exp: Experiment[Any]) -> Image:
    """Return a picture of what an experiment runs: hosts, processes, who sends what to whom."""
    return image_of(draw_setup(exp.setup), f"Hosts, processes and messages of {exp.name}")


def words(frame: pd.DataFrame) -> Styler:
    """Return a table whose texts are shown in full, for those that are made to be read."""
    style = frame.style.format(escape="html").hide(axis="index")
    style.set_table_styles(
        [{"selector": "td, th", "props": "text-align: left; white-space: normal"}]
    )
    return style.set_uuid("words")  # equal tables are equal output


def save_figures(run: Run[Any]) -> str:
    """Draw and save every figure of a run, and return their folder and names.

    The folder is ``runs/figures``. Of a run that counts for no claim, and of a log from elsewhere,
    it is one below, so that no figure of another run is replaced.
    """
    project = find_project()
    folder = ledger.figures_folder(project, run.log)
    files = ledger.save_figures(project, run, folder)
    names = dict.fromkeys(file.stem for file in files)
    return f"{project.relative(folder)}: {', '.join(names)} (SVG, PNG and JSON)"


def claims_of(run: Run[Any]) -> OwnLedger:
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
    """Assert that every claim of a run has one of these verdicts, and say so.

    Of a run with changed fields nothing is asserted. Verdicts are ``reproduced``, ``better`` (and with it ``as good``), or those that are known: ``fitted``,
    ``undecided``. Claims of `may_deviate` may deviate if the experiment gives the reason, and those measured
    live in a smoke test, which is too short to measure by; it is said.

    Raises:
        AssertionError: A claim has another verdict; says which.
    """
    if run.is_changed:
        return f"nothing is asserted: this run counts for no claim ({run.why_not})"
    entries = ledger.entries_of(find_project(), run)
    asked = {*verdicts, *(["as good"] if "better" in verdicts else [])}
    wrong = [e for e in entries if e.verdict.value not in asked]
    said = {e.claim.id: _excuse(e, run, may_deviate) for e in wrong}
    failed = [f"{e.claim.id}: {e.verdict.value}" for e in wrong if not said[e.claim.id]]
    if failed:
        raise AssertionError(
            f"{run.experiment}: {', '.join(failed)}; expected {' or '.join(verdicts)}"
        )
    held = [e.claim.id for e in entries if e not in wrong]
    reasons = [f"{claim} deviates: {reason}" for claim, reason in said.items()]
    one, held_by = len(held) == 1, {"reproduced", "better"}.issuperset(verdicts)
    verb = (
        ("holds" if one else "hold")
        if held_by
        else f"{'is' if one else 'are'} {' or '.join(verdicts)}"
    )
    count = f"{len(held)} claim{'' if one else 's'}"
    return "\n".join([f"by this run {count} {verb}: {', '.join(held)}", *reasons])


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
    """Return the whole ledger, computed from the logs that are there; runs of the profile are preferred."""
    return ledger.compute_ledger(find_project(), profile=profile)


def claims_page(whole: Ledger) -> IndexPage:
    """Return every claim of a ledger with the paper's words, our criterion and its last change, and figures."""
    from sfglab.lab.index import make_claims_page

    return make_claims_page(whole)


def index(whole: Ledger) -> IndexPage:
    """Return the index of everything by paper and section, with the verdicts of a ledger and a figure each."""
    from sfglab.lab.index import make_index

    return make_index(find_project(), whole)


_WIDE, _HIGH, _APART = 1.75, 0.85, 0.2  #: A process, and half the room between two hosts', inches.
#: Height of a line of words, and what an arrow takes beside its words, inches.
_LINE, _ROW = 0.13, 0.2
_LETTERS = 27  #: How many letters a process is wide.


def draw_setup(setup: Setup) -> Figure:
    """Draw a set-up, in a figure as large as it needs."""
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
    """Return what stands above an arrow of a length, inches."""
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
