"""From logs to the ledger and the figures: which log counts, and what is computed from it.

A run's log goes to ``runs/logs/<experiment>/``; ``data/reference/<experiment>.mcap`` is a committed run, so
that a fresh clone has figures and a filled ledger before it has run anything.
"""

from __future__ import annotations

import logging
import time
from typing import TYPE_CHECKING, Any

from sfglab.errors import SfglabError
from sfglab.lab.claims import Entry, entry_for, load_claims
from sfglab.lab.experiments import EXPERIMENTS, experiment
from sfglab.lab.figures import file_sha256, save_figure
from sfglab.record import LogReader

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from sfglab.lab.claims import Measured
    from sfglab.lab.paths import Project


_LOG = logging.getLogger(__name__)


def new_log(project: Project, name: str, profile: str) -> Path:
    """Return the path of a new run's log, in order of time by its name.

    Args:
        project: The checkout.
        name: The experiment.
        profile: The run's profile.
    """
    stamp = time.strftime("%Y%m%dT%H%M%S", time.gmtime())
    folder = project.runs / "logs" / name
    path = folder / f"{stamp}-{profile}.mcap"
    again = 1
    while path.exists():
        again += 1
        path = folder / f"{stamp}-{profile}-{again}.mcap"
    return path


def find_log(project: Project, name: str, *, profile: str | None = None) -> Path | None:
    """Return the log that speaks for an experiment.

    The newest run of the profile asked for; else the newest run that was not a smoke test; else the
    committed reference; else the newest smoke test; None without any.

    Args:
        project: The checkout.
        name: The experiment.
        profile: Profile that is preferred.
    """
    runs = sorted((project.runs / "logs" / name).glob("*.mcap"))
    asked = [p for p in runs if profile is not None and _profile_of(p) == profile]
    real = [p for p in runs if _profile_of(p) != "smoke"]
    reference = project.reference_logs / f"{name}.mcap"
    ranked = [*runs[-1:], *([reference] if reference.is_file() else []), *real[-1:], *asked[-1:]]
    return ranked[-1] if ranked else None


def _profile_of(log: Path) -> str:
    """Return the profile in a run's name; a reference log has none there."""
    return (*log.stem.split("-"), "")[1]


def compute_ledger(project: Project, *, profile: str | None = None) -> list[Entry]:
    """Return every claim with our figure and verdict, computed from logs.

    A log that cannot be read costs the claims of its experiment only; it is said aloud.

    Args:
        project: The checkout.
        profile: Profile whose runs are preferred.
    """
    measured: dict[str, tuple[Measured, str]] = {}
    for name in EXPERIMENTS:
        log = find_log(project, name, profile=profile)
        if log is None:
            continue
        try:
            found = experiment(name).measure_claims(log)
        except (SfglabError, KeyError) as error:
            _LOG.warning("claims: %s: %s", project.relative(log), error)
            continue
        measured |= {claim: (figure, project.relative(log)) for claim, figure in found.items()}
    entries = []
    for claim in load_claims(project.claims):
        figure, log_name = measured.get(claim.id, (None, ""))
        entries.append(entry_for(claim, figure, log=log_name))
    return entries


def save_figures(project: Project, name: str, log: Path) -> list[Path]:
    """Draw and save every figure of one experiment from a log.

    A smoke test's figures go to ``runs/figures``: they must not replace those of a real run.

    Args:
        project: The checkout.
        name: The experiment.
        log: The run's log.

    Returns:
        The files written.
    """
    origin = _origin(project, name, log)
    folder = project.runs / "figures" if _profile_of(log) == "smoke" else project.figures
    files = []
    for stem, (figure, numbers) in experiment(name).figures(log).items():
        files += save_figure(figure, folder / stem, {**origin, "shown": numbers})
    return files


def _origin(project: Project, name: str, log: Path) -> dict[str, Any]:
    with LogReader(log) as reader:
        run, config = reader.metadata("run"), reader.metadata("config")
    return {
        "experiment": name,
        "log": project.relative(log),
        "log_sha256": file_sha256(log),
        "config": config,
        "run": run,
    }


def redraw_figures(project: Project, names: Sequence[str] = EXPERIMENTS) -> dict[str, list[Path]]:
    """Draw all figures again from logs alone.

    Args:
        project: The checkout.
        names: Experiments.

    Returns:
        The files written, by experiment; an experiment without a log is missing.
    """
    logs = {name: find_log(project, name) for name in names}
    return {name: save_figures(project, name, log) for name, log in logs.items() if log is not None}
