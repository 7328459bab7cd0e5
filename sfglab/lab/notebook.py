"""What notebooks call: one line each for a log to write, a picture, the claims of an experiment.

Keeps the notebooks thin; everything behind it is in the modules that it imports.
"""

from __future__ import annotations

import io
from typing import TYPE_CHECKING, Any

import pandas as pd

from sfglab.lab import ledger
from sfglab.lab.claims import Entry, entry_for, load_claims
from sfglab.lab.experiments import experiment
from sfglab.lab.figures import house_style
from sfglab.lab.paths import find_project

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from IPython.display import Image
    from matplotlib.figure import Figure
    from pandas.io.formats.style import Styler

_COLUMNS = ["claim", "where", "paper", "ours", "unit", "how", "verdict"]


def new_log(name: str, profile: str) -> Path:
    """Return the path of a new run's log.

    Args:
        name: The experiment.
        profile: The run's profile.
    """
    return ledger.new_log(find_project(), name, profile)


def picture(figure: Figure) -> Image:
    """Return a figure as a picture for the notebook."""
    from IPython.display import Image

    buffer = io.BytesIO()
    with house_style():
        figure.savefig(buffer, format="png", dpi=90)
    return Image(buffer.getvalue(), format="png")


def words(frame: pd.DataFrame) -> Styler:
    """Return a table whose texts are shown in full, for those that are made to be read.

    Args:
        frame: The table.
    """
    style = frame.style.format(escape="html").hide(axis="index")
    style.set_table_styles([{"selector": "td, th", "props": "text-align: left; white-space: normal"}])
    return style.set_uuid("words")  # equal tables are equal output


def save_figures(name: str, log: Path) -> str:
    """Draw and save every figure of an experiment, and return their names."""
    project = find_project()
    return ", ".join(project.relative(path) for path in ledger.save_figures(project, name, log))


def claims_of(name: str, log: Path) -> pd.DataFrame:
    """Return the claims that an experiment answers, judged by one log: paper said, we measured.

    Args:
        name: The experiment.
        log: The run's log.
    """
    return _table(_entries(name, log))


def check(name: str, log: Path, *verdicts: str, may_deviate: Sequence[str] = ()) -> str:
    """Assert that every claim of an experiment has one of these verdicts, and say so.

    Args:
        name: The experiment.
        log: The run's log.
        verdicts: ``reproduced``, ``better``.
        may_deviate: Claims that may deviate, if the experiment gives the reason; it is said.

    Raises:
        AssertionError: A claim has another verdict; says which.
    """
    entries = _entries(name, log)
    wrong = [e for e in entries if e.verdict.value not in verdicts]
    explained = [e for e in wrong if e.claim.id in may_deviate and e.measured and e.measured.reason]
    failed = [f"{e.claim.id}: {e.verdict.value}" for e in wrong if e not in explained]
    if failed:
        raise AssertionError(f"{name}: {', '.join(failed)}; expected {' or '.join(verdicts)}")
    held = [e.claim.id for e in entries if e not in wrong]
    reasons = [f"{e.claim.id} deviates: {e.measured.reason}" for e in explained if e.measured]
    return "\n".join([f"{len(held)} claims hold: {', '.join(held)}", *reasons])


def ledger_table(profile: str | None = None) -> pd.DataFrame:
    """Return the whole ledger, computed from the logs that are there.

    Args:
        profile: Profile whose runs are preferred.
    """
    return _table(ledger.compute_ledger(find_project(), profile=profile))


def _entries(name: str, log: Path) -> list[Entry]:
    project = find_project()
    measured = experiment(name).measure_claims(log)
    return [
        entry_for(claim, measured[claim.id], log=project.relative(log))
        for claim in load_claims(project.claims)
        if claim.id in measured
    ]


def _table(entries: Sequence[Entry]) -> pd.DataFrame:
    # A smoke test may answer no claim at all: the columns are there nevertheless.
    return pd.DataFrame([_line(entry) for entry in entries], columns=_COLUMNS).set_index("claim")


def _line(entry: Entry) -> dict[str, Any]:
    m = entry.measured
    return {
        "claim": entry.claim.id,
        "where": entry.claim.where,
        "paper": "" if entry.claim.paper is None else f"{entry.claim.paper:g}",
        "ours": f"{m.estimate.value:.3g} [{m.estimate.low:.3g}, {m.estimate.high:.3g}]" if m else "",
        "unit": entry.claim.unit,
        "how": m.how.value if m else "",
        "verdict": entry.verdict.value,
    }
