"""The ledger from logs: which log counts for the claims of an experiment, and its figures.

The log of a run is in ``runs/logs/<experiment>/``. ``data/reference/<experiment>.mcap`` is a committed
run, and ``data/reference/again`` has the findings of further runs at other times.
"""

from __future__ import annotations

import json
import logging
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from sfglab.errors import SfglabError
from sfglab.fields import from_json
from sfglab.lab.claims import (
    COMMITTED_LOGS,
    VARIANT,
    Claim,
    Entry,
    Ledger,
    entry_for,
    joined,
    load_claims,
)
from sfglab.lab.experiments import EXPERIMENTS, experiment
from sfglab.lab.figures import file_sha256, save_figure
from sfglab.lab.findings import Findings, kept_findings
from sfglab.lab.notebooks import notebook_of
from sfglab.lab.runs import Run, standing

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Sequence
    from pathlib import Path

    from sfglab.lab.paths import Project

_LOG = logging.getLogger(__name__)


def logs_of(project: Project, name: str, *, committed: bool = False) -> list[Path]:
    """Return an experiment's logs: its runs, newest first, unfinished ones included, then the committed log."""
    logs: list[Path] = []
    if not committed:
        logs += sorted((project.runs / "logs" / name).glob("*.mcap*"), reverse=True)
    logs += project.reference_logs.glob(f"{name}.mcap")
    return logs


def find_log(
    project: Project, name: str, *, profile: str | None = None, committed: bool = False
) -> Path | None:
    """Return the log that counts for an experiment's claims; None if there is none.

    It is the newest run of the profile, otherwise the newest run, otherwise the committed log. Unfinished, changed
    and explored runs and smoke tests do not count.
    """
    newest = None
    for log in logs_of(project, name, committed=committed):
        found = standing(log)
        if not found.counts:
            continue
        if profile in (None, found.profile):
            return log
        newest = newest or log
    return newest


def compute_ledger(
    project: Project,
    *,
    profile: str | None = None,
    committed: bool = False,
    only: Collection[str] | None = None,
) -> Ledger:
    """Return the claims with our values and verdicts, from logs.

    A log that cannot be read costs only the claims of its experiment; a warning names it.

    Args:
        project: The checkout.
        profile: Profile whose runs are preferred.
        committed: Whether only the committed logs count, and not the user's runs.
        only: Ids of the claims; None: all.
    """
    claims = load_claims(project.claims)
    better = {claim.id: claim.better for claim in claims}
    if only is not None:
        claims = [claim for claim in claims if claim.id in only]
    answers: dict[str, list[Entry]] = {claim.id: [] for claim in claims}
    for name in _experiments_of(claims):
        log = find_log(project, name, profile=profile, committed=committed)
        if log is None:
            for silent in logs_of(project, name, committed=True):
                _LOG.warning("claims: %s: %s", project.relative(silent), standing(silent).why_not)
            continue
        again = _kept_again(project, claims, name) if project.reference_logs in log.parents else []
        for entry in _read(project, claims, name, log):
            answers[entry.claim.id].append(joined([entry, *_of(again, entry.claim)]))
    figures = _committed_figures(project)
    ledger = Ledger()
    for claim in claims:
        entry = _judging(answers[claim.id] or [entry_for(claim, None)])
        drawn = figures.get(entry.claim.experiment or "", [])
        variant = better.get(claim.id + VARIANT)
        ledger.append(replace(entry, figures=tuple(drawn), variant_better=variant))
    return ledger


def history(project: Project) -> Ledger:
    """Return an entry for every claim and log, also for logs that do not count; without logs, one without value."""
    claims = load_claims(project.claims)
    entries: list[Entry] = []
    for name in _experiments_of(claims):
        counting = find_log(project, name)
        for log in logs_of(project, name):
            mark = standing(log).why_not or "a newer log counts"
            if log == counting:
                mark = "counts"
            entries += _read(project, claims, name, log, f": {mark}")
        entries += _kept_again(project, claims, name)
    ledger = Ledger()
    for claim in claims:
        ledger += _of(entries, claim) or [entry_for(claim, None)]
    return ledger


def _experiments_of(claims: Sequence[Claim]) -> list[str]:
    """Return the names of the experiments that answer claims, each once."""
    rules = [rule for claim in claims for rule in (claim, claim.criterion) if rule]
    return list(dict.fromkeys(rule.experiment for rule in rules if rule.experiment))


def _of(entries: Iterable[Entry], claim: Claim) -> list[Entry]:
    return [entry for entry in entries if entry.claim.id == claim.id]


def _read(
    project: Project, claims: Sequence[Claim], name: str, log: Path, mark: str = ""
) -> list[Entry]:
    """Return the claims that a log answers; none if it cannot be read, with a warning."""
    path = project.relative(log)
    try:
        return _entries(claims, kept_findings(project, name, log), path + mark)
    except SfglabError as error:
        _LOG.warning("claims: %s: %s", path, error)
    except KeyError as error:
        _LOG.warning("claims: %s: its tables do not suffice for the claims (%s)", path, error)
    return []


def _kept_again(project: Project, claims: Sequence[Claim], name: str) -> list[Entry]:
    """Return the claims that an experiment's committed runs at other times answer."""
    entries = []
    for file in sorted((project.reference_logs / "again").glob(f"{name}_[0-9].json")):
        findings = from_json(Findings, json.loads(file.read_text("utf-8")))
        entries += _entries(claims, findings, project.relative(file))
    return entries


def _entries(claims: Iterable[Claim], findings: Findings, log: str) -> list[Entry]:
    """Return a row for each claim that has a value in findings."""
    entries = []
    for claim in claims:
        measured = findings.measured.get(claim.id)
        if measured is not None:
            entries.append(entry_for(claim, measured, log=log, origin=findings.origin))
    return entries


def _judging(answers: Sequence[Entry]) -> Entry:
    """Return the row for a claim from one row for each experiment that answers it, at least one.

    The experiment of the claim's criterion judges, if it has a value. The value of the other
    experiment is then among the details.
    """
    judging, *others = sorted(answers, key=_is_by_criterion, reverse=True)
    if judging.measured is None:
        return judging
    details = dict(judging.measured.details)
    for other in others:
        if other.measured:
            details["by the band of other runs"] = f"{other.measured.estimate} ({other.log})"
    return replace(judging, measured=replace(judging.measured, details=details))


def _is_by_criterion(entry: Entry) -> bool:
    return entry.measured is not None and entry.measured.by_criterion


def _committed_figures(project: Project) -> dict[str, list[str]]:
    """Return the names of the committed figures by experiment, from their metadata files."""
    figures: dict[str, list[str]] = {}
    for file in sorted(project.figures.glob("*.json")):
        metadata = json.loads(file.read_text("utf-8"))
        figures.setdefault(metadata["experiment"], []).append(file.stem)
    return figures


def entries_of(project: Project, run: Run[Any]) -> Ledger:
    """Return the claims that a run answers, judged by this run alone, even if the run does not count."""
    measured = run.once("claims", lambda: experiment(run.experiment).measure(run))
    findings = Findings(measured=measured, origin="")
    return Ledger(_entries(load_claims(project.claims), findings, project.relative(run.log)))


def own_ledger(project: Project, run: Run[Any]) -> Ledger:
    """Return the claims that a run answers, as the ledger has them, each with its row by this run.

    The ledger is that of the committed logs if the run is one of them, else that of the user's
    runs, with the committed logs where there is no run.
    """
    own = {entry.claim.id: entry for entry in entries_of(project, run)}
    committed = project.relative(run.log).startswith(COMMITTED_LOGS)
    ledger = Ledger()
    for entry in compute_ledger(project, profile=run.profile, committed=committed, only=own):
        by_run = own[entry.claim.id]
        reason = _difference(project, entry, by_run, run)
        ledger.append(replace(entry, own=by_run, own_reason=reason))
    return ledger


def _difference(project: Project, entry: Entry, own: Entry, run: Run[Any]) -> str:
    """Return the reason why the ledger's row for a claim differs from a run's; empty if it does not."""
    if (entry.value, entry.verdict) == (own.value, own.verdict):
        return ""
    if run.why_not:
        return f"it counts for no claim: {run.why_not}"
    judge = entry.claim.experiment or ""
    if judge != run.experiment:
        notebook = notebook_of(project, judge)
        return (
            f"by the acceptance range of this run; the criterion is judged in notebook {notebook}"
        )
    if entry.runs:
        return f"one of the {len(entry.runs)} runs whose median and envelope the ledger has"
    return f"the ledger has the value of {entry.log}"


def figures_folder(project: Project, log: Path, notebook: Path) -> Path:
    """Return the folder for the figures of a log; runs that count for claims share one folder.

    `notebook` is the executed copy that draws them. A copy of `sfglab try` has a folder of its own.
    """
    if notebook.resolve().is_relative_to(project.tries.resolve()):
        return notebook.parent / "figures"
    folder = project.runs / "figures"
    logs = project.runs / "logs"
    if not log.resolve().is_relative_to(logs.resolve()):
        return folder / log.stem
    return folder if standing(log).counts else folder / f"{log.parent.name}-{log.stem}"


def save_figures(project: Project, run: Run[Any], folder: Path) -> list[Path]:
    """Draw and save every figure of a run into a folder; return the files."""
    origin = {
        "experiment": run.experiment,
        "log": project.relative(run.log),
        "log_sha256": file_sha256(run.log),
        "config": run.metadata("config"),
        "run": run.metadata("run"),
    }
    files = []
    for name, (figure, numbers) in experiment(run.experiment).figures(run).items():
        files += save_figure(figure, folder / name, {**origin, "shown": numbers})
    return files


def redraw_figures(project: Project, names: Sequence[str] = EXPERIMENTS) -> dict[str, list[Path]]:
    """Draw the figures of experiments again, from the committed logs; return the files by name."""
    files = {}
    for name in names:
        log = project.reference_logs / f"{name}.mcap"
        if log.is_file():
            files[name] = save_figures(project, experiment(name).load(log), project.figures)
    return files
