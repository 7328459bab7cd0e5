"""Make committed logs: run experiments, check the logs, copy them, and draw the figures.

With ``--notebooks`` it executes notebooks from the committed logs and replaces them.

    .venv/bin/python tools/reference.py naming gateways
    .venv/bin/python tools/reference.py decode_once --from runs/logs/decode_once/LOG.mcap
    .venv/bin/python tools/reference.py --notebooks 11_names_and_border 01_ledger 00_start

A committed log is evidence, so its code must be identified by a commit: a working tree with
changes is refused unless ``--dirty`` is given. Logs are compressed when they are written; packing
them again would save less than one per cent.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import math
import shutil
import subprocess
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from sfglab.errors import SfglabError
from sfglab.fields import to_json
from sfglab.lab.experiments import EXPERIMENTS, experiment
from sfglab.lab.findings import findings_of
from sfglab.lab.ledger import redraw_figures
from sfglab.lab.notebooks import (
    REFERENCE,
    NotebookError,
    experiments_of,
    find_notebooks,
    notebook_of,
    run_notebooks,
)
from sfglab.lab.paths import Project, find_project
from sfglab.lab.runs import standing
from sfglab.lab.summary import BOUNDARIES, save_summary

if TYPE_CHECKING:
    from collections.abc import Sequence

    from sfglab.lab.runs import Run

MOST_BYTES = 5_000_000
"""Size of all committed logs together, which tests/test_project.py bounds."""


class LogRefusedError(SfglabError):
    """Error because of a log that must not be committed, or a tree in which none must be made."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Make the committed logs of experiments, then execute notebooks; return the exit status."""
    parser = _parser()
    given = parser.parse_args(arguments)
    if not given.experiments and not given.notebooks:
        parser.error("name experiments, or notebooks with --notebooks")
    if unknown := [name for name in given.experiments if name not in EXPERIMENTS]:
        parser.error(f"no experiment {', '.join(unknown)}; choose from {', '.join(EXPERIMENTS)}")
    try:
        project = find_project()
        if not given.dirty:
            _require_clean(project)
        for name in given.experiments:
            make_reference(project, name, given)
        if given.notebooks:
            for notebook in find_notebooks(project, given.notebooks):
                execute(project, notebook)
    except SfglabError as error:
        print(f"reference: {error}", file=sys.stderr)
        return 2
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("experiments", nargs="*", metavar="EXPERIMENT")
    parser.add_argument(
        "--notebooks", nargs="+", default=[], help="execute these with the committed logs"
    )
    parser.add_argument("--profile", choices=("quick", "paper"), default="quick")
    parser.add_argument("--from", dest="log", type=Path, help="take this finished log, run nothing")
    parser.add_argument("--dirty", action="store_true", help="also in a tree with changes")
    parser.add_argument(
        "--keep-previous",
        action="store_true",
        help="keep the claims of the log that is replaced, in data/reference/again",
    )
    return parser


def _require_clean(project: Project) -> None:
    done = subprocess.run(
        ["git", "status", "--porcelain"],
        cwd=project.root,
        capture_output=True,
        text=True,
        check=False,
    )
    if done.returncode:
        raise LogRefusedError(f"{project.root.name} is no git repository; give --dirty")
    if done.stdout:
        changed = len(done.stdout.splitlines())
        raise LogRefusedError(
            f"the working tree has {changed} changed files; commit them, or give --dirty"
        )


def make_reference(project: Project, name: str, given: argparse.Namespace) -> None:
    """Make the committed log of one experiment."""
    log = given.log or asyncio.run(experiment(name).run(given.profile)).log
    print(f"{name}: ran, {project.relative(log)}")
    reference = project.reference_logs / f"{name}.mcap"
    check_log(name, log, reference, dirty=given.dirty)
    check_size(project, name, log)
    print(f"{name}: checked, {log.stat().st_size / 1000:.0f} kB")
    if given.keep_previous and reference.is_file():
        kept = keep_findings(project, name, reference)
        print(f"{name}: claims of the log before are in {project.relative(kept)}")
    reference.parent.mkdir(parents=True, exist_ok=True)
    shutil.copyfile(log, reference)
    files = redraw_figures(project, [name])[name]
    if all((project.reference_logs / f"{b.experiment}.mcap").is_file() for b in BOUNDARIES):
        files += save_summary(project)
    print(f"{name}: copied to {project.relative(reference)}, {len(files)} files of figures drawn")
    print(f"{name}: commit, then --notebooks {notebook_of(project, name)} 01_ledger 00_start")


def execute(project: Project, path: Path) -> None:
    """Execute a notebook with the committed logs of its experiments, and replace it."""
    names = experiments_of(path)
    parameters = {"profile": "quick"}
    for name in names:
        parameters[f"log_{name}" if len(names) > 1 else "log"] = REFERENCE
    [outcome] = run_notebooks([path], project=project, parameters=parameters, write=True)
    if outcome.error:
        raise NotebookError(f"{path.name}: {outcome.error}")
    print(f"{path.name}: executed")


def keep_findings(project: Project, name: str, log: Path) -> Path:
    """Keep the findings of a run at another time beside the committed log; return their file."""
    folder = project.reference_logs / "again"
    folder.mkdir(parents=True, exist_ok=True)
    number = len(list(folder.glob(f"{name}_[0-9].json"))) + 1
    file = folder / f"{name}_{number}.json"
    text = json.dumps(to_json(findings_of(name, log)), indent=1)
    file.write_text(f"{text}\n", encoding="utf-8")
    return file


def check_log(name: str, log: Path, reference: Path, *, dirty: bool) -> None:
    """Refuse a log that counts for no claim, or has less than the one that it replaces."""
    why_not = standing(log).why_not
    if why_not:
        raise LogRefusedError(f"{log.name}: {why_not}")
    run = experiment(name).load(log)
    if run.experiment != name:
        raise LogRefusedError(f"{log.name}: a log of {run.experiment}, needed is one of {name}")
    if not (dirty or run.metadata("run").get("source", {}).get("git_clean")):
        raise LogRefusedError(f"{log.name}: made by code with changes that no commit holds")
    if not reference.is_file():
        return
    former = experiment(name).load(reference)
    lacking = sorted(_filled_tables(former) - _filled_tables(run))
    if lacking:
        raise LogRefusedError(f"{log.name}: no rows in {', '.join(lacking)}, which {name} has now")
    lacking = sorted(_measured_claims(former) - _measured_claims(run))
    if lacking:
        raise LogRefusedError(f"{log.name}: no value for {', '.join(lacking)}")


def check_size(project: Project, name: str, log: Path) -> None:
    """Refuse a log with which all committed logs would be too large."""
    others = (path for path in project.reference_logs.glob("*.mcap") if path.stem != name)
    total = log.stat().st_size + sum(path.stat().st_size for path in others)
    if total >= MOST_BYTES:
        raise LogRefusedError(
            f"{log.name}: all committed logs would have {total} bytes, allowed: {MOST_BYTES}"
        )


def _filled_tables(run: Run[Any]) -> set[str]:
    return {table for table in experiment(run.experiment).tables if len(run[table])}


def _measured_claims(run: Run[Any]) -> set[str]:
    found = experiment(run.experiment).measure(run)
    return {claim for claim, m in found.items() if not math.isnan(m.estimate.value)}


if __name__ == "__main__":
    sys.exit(main())
