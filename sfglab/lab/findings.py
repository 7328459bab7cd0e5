"""Findings: our values for claims, computed from one log, and their cache.

The cache is in ``runs/cache``. A file holds the findings of one log. Its key is a hash of what the
findings depend on: the log, the YAML files in ``data`` (``claims.yaml`` among them), and sizes and times of the
committed logs. The modules that were loaded count as well, and the versions of Python and of the libraries
that compute. Damaged files and those with another key are ignored.
"""

from __future__ import annotations

import hashlib
import json
import sys
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from sfglab.errors import SfglabError
from sfglab.fields import from_json, to_json
from sfglab.lab.claims import (
    Finding,  # noqa: TC001 - the type of a field that is read from JSON
)
from sfglab.lab.experiments import experiment
from sfglab.lab.figures import file_sha256
from sfglab.lab.runs import COMPLETION
from sfglab.record.metadata import library_versions

if TYPE_CHECKING:
    from collections.abc import Sequence

    from sfglab.lab.paths import Project
    from sfglab.lab.runs import Run


@dataclass(frozen=True, slots=True, kw_only=True)
class Findings:
    """Our measured values for an experiment's claims, from one log."""

    measured: dict[str, Finding]  #: Values by claim.
    origin: str  #: Machine, load while measured, versions and commit, as far as the log has them.


def findings_of(name: str, log: Path) -> Findings:
    """Return the findings of an experiment from a log.

    Raises:
        SfglabError: The log cannot be read, or has changed fields that no longer exist.
        KeyError: A table of the log lacks a column.
    """
    exp = experiment(name)
    run = exp.load(log)
    if run.unread:
        raise SfglabError(run.why_not)
    # The log of an explorer has only the tables that it shows.
    measured = {} if "only" in run.metadata(COMPLETION) else exp.measure(run)
    return Findings(measured=measured, origin=_origin(run))


def _origin(run: Run[Any]) -> str:
    metadata = run.metadata("run")
    hardware = "machine not in the log"
    machine = metadata.get("machine")
    if machine:
        cores = f"{machine['usable_cores']} of {machine['cores']} cores"
        hardware = f"{machine['cpu']}, {cores}, {machine['kernel']}"
    load = "load not in the log"
    for table, row in experiment(run.experiment).tables.items():
        if "load" in row.__dataclass_fields__:
            load = f"load {run[table]['load'].median():.1f}"
    versions = {"sfglab": metadata.get("sfglab"), "Python": metadata.get("python")}
    versions |= metadata.get("libraries", {})
    known = [f"{name} {version}" for name, version in versions.items() if version]
    commit = "commit not in the log"
    source = metadata.get("source")
    if source:
        changed = "" if source.get("git_clean") else " with uncommitted changes"
        commit = f"commit {source['git_commit'][:12]}{changed}"
    return "; ".join(filter(None, [hardware, load, ", ".join(known), commit]))


def kept_findings(project: Project, name: str, log: Path) -> Findings:
    """Return the findings of an experiment from a log, computed once for each state of log, inputs and code.

    Errors are those of `findings_of`.
    """
    file = project.runs / "cache" / name / f"{log.stem}.json"
    inputs = _inputs(project, log)
    # The file is missing or damaged.
    with suppress(OSError, ValueError, LookupError, TypeError):
        kept = json.loads(file.read_text("utf-8"))
        if kept["key"] == _key(inputs, kept["modules"]):
            findings: Findings = from_json(Findings, kept["findings"])
            return findings
    found = findings_of(name, log)
    # The modules of sfglab that are loaded, among them all that computed the findings.
    modules = sorted(module for module in sys.modules if module.partition(".")[0] == "sfglab")
    kept = {"key": _key(inputs, modules), "modules": modules, "findings": to_json(found)}
    # If the folder cannot be written, the findings are only computed again.
    with suppress(OSError):
        file.parent.mkdir(parents=True, exist_ok=True)
        part = file.with_suffix(".part")
        part.write_text(json.dumps(kept), encoding="utf-8")
        part.replace(file)
    return found


def _inputs(project: Project, log: Path) -> str:
    """Return everything but code that findings from a log depend on: hashes, sizes and times of files."""
    inputs = [file_sha256(file) for file in [log, *sorted(project.data.rglob("*.yaml"))]]
    # An experiment may read the committed log of another one.
    for other in sorted(project.reference_logs.glob("*.mcap")):
        state = other.stat()
        inputs.append(f"{other.name} {state.st_size} {state.st_mtime_ns}")
    return " ".join(inputs)


def _key(inputs: str, modules: Sequence[str]) -> str:
    code = [_libraries(), *map(_hash_of, modules)]
    return hashlib.sha256(" ".join([inputs, *code]).encode()).hexdigest()


@cache
def _libraries() -> str:
    return f"{sys.version} {library_versions()}"


@cache
def _hash_of(module: str) -> str:
    """Return the hash of a module's source; empty if there is no such module."""
    path = Path(__file__).parents[2].joinpath(*module.split("."))
    for file in (path / "__init__.py", path.with_suffix(".py")):
        if file.is_file():
            return file_sha256(file)
    return ""
