"""The way from logs to the ledger and the figures: which log counts, and what is computed from it.

A run's log goes to ``runs/logs/<experiment>/``; ``data/reference/<experiment>.mcap`` is a committed run. What a
log gave is kept in ``runs/cache`` under the hash of all that it hangs on: the log, the claims file and the
other small inputs, every file of the package, and the versions of Python and of the libraries that compute. So
nothing goes stale; verdicts are judged anew each time. A broken file, or one of another hash, is as none.
"""

from __future__ import annotations

import hashlib
import json
import logging
import sys
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Any

from sfglab.errors import SfglabError
from sfglab.fields import from_json, to_json
from sfglab.lab.claims import (
    COMMITTED_LOGS,
    Claim,
    Entry,
    Ledger,
    Measured,
    OwnEntry,
    OwnLedger,
    entry_for,
    joined,
    load_claims,
)
from sfglab.lab.experiments import EXPERIMENTS, experiment
from sfglab.lab.figures import file_sha256, save_figure
from sfglab.lab.notebooks import notebook_of
from sfglab.lab.runs import COMPLETION, Run, Standing, standing
from sfglab.lab.sweep.journal import code_digest
from sfglab.record import LogReader
from sfglab.record.metadata import library_versions

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterator, Sequence
    from pathlib import Path

    from sfglab.lab.paths import Project


@dataclass(frozen=True, slots=True, kw_only=True)
class Findings:
    """What one log gives."""

    measured: dict[str, Measured]  #: Our figures, by claim.
    origin: str  #: Machine, load while measured, versions and commit, as far as the log has them.


@dataclass(frozen=True, slots=True)
class Kept:
    """The findings of a project's logs that are kept."""

    project: Project  #: Whose logs.
    basis: bytes  #: Hash of everything but the log.

    def of(self, log: Path, make: Callable[[], Findings]) -> Findings:
        """Return the findings from a log: those that are kept, else `make`'s, kept from then on."""
        file = self.project.runs / "cache" / f"{log.stem}.json"
        key = hashlib.sha256(self.basis + log.read_bytes()).hexdigest()
        with suppress(OSError, ValueError, LookupError, TypeError, AttributeError, SfglabError):
            kept = json.loads(file.read_text())
            if kept["key"] == key and kept["sum"] == _sum(kept["findings"]):
                found: Findings = from_json(Findings, json.loads(kept["findings"]))
                return found
        found = make()
        with suppress(OSError):  # a folder that cannot be written costs time only
            file.parent.mkdir(parents=True, exist_ok=True)
            part = file.with_suffix(".part")
            text = json.dumps(to_json(found))
            part.write_text(json.dumps({"key": key, "sum": _sum(text), "findings": text}))
            part.replace(file)
        return found


def _sum(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()


def kept_findings(project: Project) -> Kept:
    """Return the findings that a project keeps, for the code and the inputs as they are now."""
    digest = hashlib.sha256(f"{sys.version}\n{code_digest()}\n{library_versions()}\n".encode())
    for file in sorted(project.data.rglob("*")):
        if file.is_file() and project.reference_logs not in file.parents:
            digest.update(f"{file.relative_to(project.data)}\n".encode())
            digest.update(hashlib.sha256(file.read_bytes()).digest())
    return Kept(project, digest.digest())


_LOG = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True, kw_only=True)
class FoundLog:
    """A log of an experiment and what it may be used for."""

    experiment: str  #: The experiment.
    path: Path  #: The log.
    standing: Standing  #: Whether it speaks.
    reference: bool = False  #: Whether it is the committed one.


def logs_of(project: Project, name: str, *, committed: bool = False) -> Iterator[FoundLog]:
    """Yield an experiment's logs: its runs, newest first, unfinished ones too, then the committed reference."""
    runs = () if committed else (project.runs / "logs" / name).glob("*.mcap*")
    for path in sorted(runs, reverse=True):
        yield FoundLog(experiment=name, path=path, standing=standing(path))
    reference = project.reference_logs / f"{name}.mcap"
    if reference.is_file():
        yield FoundLog(
            experiment=name, path=reference, standing=standing(reference), reference=True
        )


def keep_figures(project: Project, name: str, log: Path) -> Path:
    """Keep the figures of a run, by today's analysis, to stand beside the reference; return their file."""
    folder = project.reference_logs / "again"
    file = folder / f"{name}_{len(list(folder.glob(f'{name}_[0-9].json'))) + 1}.json"
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text(json.dumps(to_json(_findings(name, log)), indent=1) + "\n", encoding="utf-8")
    return file


def _kept_again(project: Project, name: str) -> dict[str, list[_Ours]]:
    """Return the figures of the committed runs at other times, by claim."""
    found: dict[str, list[_Ours]] = {}
    for file in sorted((project.reference_logs / "again").glob(f"{name}_[0-9].json")):
        findings: Findings = from_json(Findings, json.loads(file.read_text(encoding="utf-8")))
        for claim_id, figure in findings.measured.items():
            found.setdefault(claim_id, []).append((figure, project.relative(file), findings.origin))
    return found


def find_log(
    project: Project, name: str, *, profile: str | None = None, committed: bool = False
) -> Path | None:
    """Return the log that speaks for an experiment, of all or of the committed ones; None when none does.

    The newest run of the profile asked for that speaks, else the newest that speaks; the committed reference
    comes last. Unfinished, changed and explored runs and smoke tests do not speak.
    """
    newest = None
    for log in logs_of(project, name, committed=committed):
        if not log.standing.speaks:
            continue
        newest = newest or log
        if profile in (None, log.standing.profile):
            return log.path
    return newest.path if newest else None


def compute_ledger(
    project: Project,
    *,
    profile: str | None = None,
    committed: bool = False,
    only: Collection[str] = (),
) -> Ledger:
    """Return the claims with our values and verdicts, from logs.

    A log that cannot be read costs the claims of its experiment only; a warning names it.

    Args:
        project: The checkout.
        profile: Profile whose runs are preferred.
        committed: Whether the committed logs count alone, and not the user's runs.
        only: Ids of the claims; empty: all.
    """
    kept = kept_findings(project)
    claims = [claim for claim in load_claims(project.claims) if not only or claim.id in only]
    ours: dict[str, _Ours] = {}
    again: dict[str, list[_Ours]] = {}
    for name in _experiments_of(claims):
        log = find_log(project, name, profile=profile, committed=committed)
        if log is None:
            for silent in logs_of(project, name, committed=True):
                _LOG.warning(
                    "claims: %s: %s", project.relative(silent.path), silent.standing.why_not
                )
            continue
        for claim_id, figure in _found(project, kept, name, log).items():
            ours[claim_id] = _stronger(ours[claim_id], figure) if claim_id in ours else figure
        if project.reference_logs in log.parents:
            again |= _kept_again(project, name)
    drawn = _committed_figures(project)
    entries = Ledger()
    for claim in claims:
        figures = (
            [ours[claim.id], *again.get(claim.id, ())] if claim.id in ours else [(None, "", "")]
        )
        entry = joined(
            [entry_for(claim, one, log=log, origin=origin) for one, log, origin in figures]
        )
        shown = tuple(drawn.get(entry.experiment, ()) if entry.experiment else ())
        entries.append(replace(entry, figures=shown))
    return entries


def history(project: Project) -> Ledger:
    """Return every claim by every log that there is, also those that do not speak, a line each."""
    kept, claims = kept_findings(project), load_claims(project.claims)
    found: dict[str, list[_Ours]] = {}
    for name in _experiments_of(claims):
        speaks = find_log(project, name)
        for log in logs_of(project, name):
            mark = "speaks" if log.path == speaks else log.standing.why_not or "a newer one speaks"
            for claim_id, (figure, path, origin) in _found(project, kept, name, log.path).items():
                found.setdefault(claim_id, []).append((figure, f"{path}: {mark}", origin))
        for claim_id, figures in _kept_again(project, name).items():
            found.setdefault(claim_id, []).extend(figures)
    return Ledger(
        entry_for(claim, figure, log=log, origin=origin)
        for claim in claims
        for figure, log, origin in found.get(claim.id, [(None, "", "")])
    )


def _experiments_of(claims: Sequence[Claim]) -> list[str]:
    names = (
        name
        for c in claims
        for name in (c.experiment, c.criterion and c.criterion.experiment)
        if name
    )
    return list(dict.fromkeys(names))


def _found(project: Project, kept: Kept, name: str, log: Path) -> dict[str, _Ours]:
    """Return an experiment's figures from a log, by claim; nothing of one that cannot be read."""
    log_name = project.relative(log)
    try:
        found = kept.of(log, partial(_findings, name, log))
    except SfglabError as error:
        _LOG.warning("claims: %s: %s", log_name, error)
        return {}
    except KeyError as error:
        _LOG.warning("claims: %s: its tables do not suffice for the claims (%s)", log_name, error)
        return {}
    return {
        claim_id: (figure, log_name, found.origin) for claim_id, figure in found.measured.items()
    }


def _committed_figures(project: Project) -> dict[str, list[str]]:
    """Return the names of the figures by experiment, as their twins say."""
    figures: dict[str, list[str]] = {}
    for twin in sorted(project.figures.glob("*.json")):
        name = json.loads(twin.read_text(encoding="utf-8")).get(
            "experiment", ""
        )  # "": of the ledger itself
        figures.setdefault(name, []).append(twin.stem)
    return figures


def _findings(name: str, log: Path) -> Findings:
    run = experiment(name).load(log)
    if run.unread:
        raise SfglabError(run.why_not)
    is_part = "only" in run.metadata(COMPLETION)  # an explorer kept the tables that it shows
    measured = {} if is_part else experiment(name).measure(run)
    return Findings(measured=measured, origin=_circumstances(run))


def _circumstances(run: Run[Any]) -> str:
    """Return machine, load while measured, versions and commit, as far as a log has them."""
    said = run.metadata("run")
    machine, source = said.get("machine", {}), said.get("source", {})
    rows = experiment(run.experiment).tables
    loads = [
        run[table]["load"].median() for table in rows if "load" in rows[table].__dataclass_fields__
    ]
    versions = {
        "sfglab": said.get("sfglab"),
        "Python": said.get("python"),
        **said.get("libraries", {}),
    }
    changed = "" if source.get("git_clean") else " with uncommitted changes"
    parts = (
        f"{machine['cpu']}, {machine['usable_cores']} of {machine['cores']} cores, {machine['kernel']}"
        if machine
        else "machine not in the log",
        f"load {max(loads):.1f}" if loads else "load not in the log",
        ", ".join(f"{name} {version}" for name, version in versions.items() if version),
        f"commit {source['git_commit'][:12]}{changed}" if source else "commit not in the log",
    )
    return "; ".join(filter(None, parts))


_Ours = tuple[Measured, str, str]


def _stronger(one: _Ours, other: _Ours) -> _Ours:
    """Return what counts of two experiments' figures: what a criterion judges, the other beside it."""
    first, second = (other, one) if other[0].by_criterion else (one, other)
    return first[0].beside(*second[:2]), *first[1:]


def entries_of(project: Project, run: Run[Any]) -> Ledger:
    """Return the claims that one run answers, judged, whether or not its log speaks."""
    measured = run.once("claims", lambda: experiment(run.experiment).measure(run))
    claims = [claim for claim in load_claims(project.claims) if claim.id in measured]
    return Ledger(
        entry_for(claim, measured[claim.id], log=project.relative(run.log)) for claim in claims
    )


def own_ledger(project: Project, run: Run[Any]) -> OwnLedger:
    """Return the claims that one run answers, as the ledger has them and by this run.

    The ledger is that of the committed logs where the run is one of them, else that of the
    user's runs, with the committed logs where there is no run.
    """
    own = {entry.claim.id: entry for entry in entries_of(project, run)}
    if not own:
        return OwnLedger()
    committed = project.relative(run.log).startswith(COMMITTED_LOGS)
    ledger = compute_ledger(project, profile=run.profile, committed=committed, only=own)
    return OwnLedger(_own_entry(project, entry, own[entry.claim.id], run) for entry in ledger)


def _own_entry(project: Project, ledger: Entry, own: Entry, run: Run[Any]) -> OwnEntry:
    if (ledger.value, ledger.verdict) == (own.value, own.verdict):
        return OwnEntry(ledger=ledger)
    why_not = run.why_not
    if why_not:
        reason = f"it counts for no claim: {why_not}"
    elif ledger.experiment != run.experiment:
        judge = notebook_of(project, ledger.experiment or "")
        reason = f"by the acceptance range of this run; the criterion is judged in notebook {judge}"
    elif ledger.runs:
        reason = f"one of the {len(ledger.runs)} runs whose median and range the ledger has"
    else:
        reason = f"the ledger has the value of {ledger.log}"
    return OwnEntry(ledger=ledger, own=own, reason=reason)


def figures_folder(project: Project, log: Path) -> Path:
    """Return the folder for the figures of a log: shared only by runs that count for claims."""
    if log.resolve().is_relative_to(project.tries.resolve()):
        return log.parent / "figures"
    folder = project.runs / "figures"
    logs = project.runs / "logs"
    if not log.resolve().is_relative_to(logs.resolve()):
        return folder / log.stem
    return folder if standing(log).speaks else folder / f"{log.parent.name}-{log.stem}"


def save_figures(project: Project, run: Run[Any], folder: Path) -> list[Path]:
    """Draw and save every figure of a run into a folder; return the files."""
    origin = _origin(project, run.log)
    files = []
    for stem, (figure, numbers) in experiment(run.experiment).figures(run).items():
        files += save_figure(figure, folder / stem, {**origin, "shown": numbers})
    return files


def _origin(project: Project, log: Path) -> dict[str, Any]:
    with LogReader(log) as reader:
        run, config = reader.metadata("run"), reader.metadata("config")
    return {
        "experiment": config["experiment"],
        "log": project.relative(log),
        "log_sha256": file_sha256(log),
        "config": config,
        "run": run,
    }


def redraw_figures(project: Project, names: Sequence[str] = EXPERIMENTS) -> dict[str, list[Path]]:
    """Draw the figures of experiments again into ``figures/``, from committed logs alone; return files."""
    logs = {
        name: log for name in names if (log := project.reference_logs / f"{name}.mcap").is_file()
    }
    return {
        n: save_figures(project, experiment(n).load(log), project.figures)
        for n, log in logs.items()
    }
