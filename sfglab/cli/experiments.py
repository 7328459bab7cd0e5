"""Commands of researchers: run experiments, look at figures, claims and logs."""

from __future__ import annotations

import json
import os
import sys
from pathlib import Path
from typing import Annotated

import typer
from typer import Argument, Option

import sfglab.lab
from sfglab.cli.buses import Json, say
from sfglab.lab.paths import find_project


def doctor(as_json: Json = False) -> None:
    """Say in plain words what this machine can do, and what an experiment will do instead.

    Example:
      sfglab doctor
    """
    from sfglab.lab.doctor import diagnose, render

    say(diagnose(), render, as_json=as_json)


def reproduce(
    notebooks: Annotated[
        list[str] | None, Argument(help="Notebooks by name; all when none.")
    ] = None,
    profile: Annotated[str, Option(help="smoke (seconds), quick (minutes) or paper.")] = "quick",
    seed: Annotated[int, Option(min=0, help="Seed of everything that is drawn.")] = 0,
    parameter: Annotated[
        list[str] | None,
        Option("-p", "--parameter", help="A field of the configuration, as name=value."),
    ] = None,
    write: Annotated[
        bool, Option("--write", help="Also replace the notebooks by their executed copies.")
    ] = False,
    ahead: Annotated[
        bool,
        Option(help="Compute sweeps of notebooks to come, and draw figures, while live parts run."),
    ] = True,
) -> None:
    """Run notebooks headless: logs, figures and, at the end, the ledger of claims.

    Examples:
      sfglab reproduce
      sfglab reproduce 03_decode_once --profile smoke
      sfglab reproduce 03_decode_once -p source=drive.mp4   # or a log or bag with pictures
    """
    from sfglab.lab.claims import render
    from sfglab.lab.experiment import PROFILES
    from sfglab.lab.ledger import compute_ledger
    from sfglab.lab.notebooks import NotebookError, find_notebooks, read_parameters, run_notebooks
    from sfglab.lab.runs import SMOKE

    if profile not in PROFILES:
        raise NotebookError(f"--profile: given {profile!r}, allowed are {', '.join(PROFILES)}")
    project = find_project()
    given = read_parameters(parameter or ())
    if isinstance(source := given.get("source"), str):
        from sfglab.lab.sources import absolute, is_there

        if said := is_there(source):
            typer.echo(said, err=True)
        given["source"] = absolute(source)
    outcomes = run_notebooks(
        find_notebooks(project, notebooks or ()),
        project=project,
        parameters={"profile": profile, "seed": seed, **given},
        write=write,
        ahead=ahead
        and profile != SMOKE,  # whose sweeps are over before a process would have started
    )
    typer.echo(render(compute_ledger(project, profile=profile)))
    failed = [o for o in outcomes if o.error]
    for outcome in failed:
        typer.echo(f"failed: {outcome.name}: {outcome.error}", err=True)
    typer.echo(f"{len(outcomes) - len(failed)} of {len(outcomes)} notebooks ran through", err=True)
    raise typer.Exit(code=1 if failed else 0)


def lab(
    options: Annotated[list[str] | None, Argument(help="JupyterLab's own, after --.")] = None,
) -> None:
    """Open JupyterLab on the index notebook, with the repository beside it.

    Examples:
      sfglab lab
      sfglab lab -- --no-browser --ServerApp.base_url=/user/a/
    """
    argv = [
        sys.executable,
        "-m",
        "jupyterlab",
        f"--ServerApp.root_dir={find_project().root.resolve()}",
    ]
    argv += ["--allow-root"] * (os.getuid() == 0)  # in a container everybody is
    argv += ["--LabApp.default_url=/lab/tree/notebooks/00_index.ipynb", *(options or ())]
    # Its configuration switches the part off that asks a public site for news.
    paths = [
        str(Path(sfglab.lab.__file__).parent / "jupyter"),
        os.environ.get("JUPYTER_CONFIG_PATH", ""),
    ]
    environment = os.environ | {"JUPYTER_CONFIG_PATH": os.pathsep.join(filter(None, paths))}
    os.execve(argv[0], argv, environment)  # noqa: S606  # one process, whose signals are JupyterLab's


def figures() -> None:
    """Draw all figures of the repository again, from committed logs alone; a run's own are in runs/figures.

    Example:
      sfglab figures
    """
    from sfglab.lab.ledger import redraw_figures
    from sfglab.lab.summary import save_summary

    project = find_project()
    for name, files in {**redraw_figures(project), "summary": save_summary(project)}.items():
        typer.echo(f"{name}: {', '.join(project.relative(f) for f in files)}")


def claims(
    as_json: Annotated[bool, Option("--json", help="Print JSON instead of a table.")] = False,
    verbose: Annotated[
        bool, Option(help="Say of each what it is judged by, and where it is from.")
    ] = False,
    every: Annotated[
        bool,
        Option("--all", help="Every run's figures, a line a log, also of those that do not speak."),
    ] = False,
) -> None:
    """Print the ledger: what the papers said, what we measured, and the verdict.

    Examples:
      sfglab claims
      sfglab claims --json
    """
    from sfglab.lab.claims import render, render_in_full
    from sfglab.lab.ledger import compute_ledger, history

    entries = (history if every else compute_ledger)(find_project())
    if as_json:
        typer.echo(json.dumps([e.as_json() for e in entries], indent=2))
    else:
        typer.echo(render_in_full(entries) if verbose else render(entries, with_logs=every))


def list_runs() -> None:
    """List the runs' logs, and which of them speak for the claims."""
    from sfglab.lab.experiments import EXPERIMENTS
    from sfglab.lab.ledger import find_log, logs_of
    from sfglab.tables import text_table

    project = find_project()
    rows = [("log", "profile", "speaks for the claims")]
    for name in EXPERIMENTS:
        chosen = find_log(project, name)
        for log in logs_of(project, name):
            spoken = f"no: {log.standing.why_not}" if log.standing.why_not else "a newer one does"
            said = "yes" if log.path == chosen else spoken
            rows.append((project.relative(log.path), log.standing.profile, said))
    typer.echo(text_table(rows))
