"""Commands of researchers: run experiments, redraw figures and print claims."""

from __future__ import annotations

import os
import sys
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer
from typer import Argument, Option

import sfglab.lab
from sfglab.cli.buses import say, unused
from sfglab.cli.options import Json
from sfglab.errors import InvalidValueError, SfglabError
from sfglab.lab.paths import find_project

if TYPE_CHECKING:
    from collections.abc import Sequence

    from sfglab.lab.notebooks import Outcome
    from sfglab.lab.paths import Project

_Profile = Annotated[
    Literal["smoke", "quick", "paper"],
    Option(
        help="Size of runs. All notebooks take minutes with smoke, 20 to 45 minutes with quick, and hours with paper."
    ),
]


def doctor(as_json: Json = False) -> None:
    """Check the capabilities that experiments need, and print the consequence of each missing one.

    Example:
      sfglab doctor
    """
    from sfglab.lab.doctor import diagnose, render

    found = diagnose()
    say(found, render(found), as_json=as_json)


def reproduce(
    notebooks: Annotated[
        list[str] | None,
        Argument(
            metavar="NOTEBOOK", help="Name of a notebook or experiment. [default: all notebooks]"
        ),
    ] = None,
    profile: _Profile = "quick",
    seed: Annotated[int, Option(min=0, help="Seed of all random numbers.")] = 0,
    parameter: Annotated[list[str] | None, Option("-p", "--parameter", hidden=True)] = None,
    write: Annotated[
        bool, Option("--write", help="Also replace the notebooks by their executed copies.")
    ] = False,
) -> None:
    """Run the notebooks of experiments, and print the verdicts on the claims of the papers.

    Logs, figures and executed notebooks go into the folder runs. If NOTEBOOK is the name of an
    experiment, only this experiment runs. Its notebook reads the others from committed logs.
    Runs with --profile smoke count for no claim, and replace no file of another run. Their own
    claims are printed below those of the ledger.

    Examples:
      sfglab reproduce
      sfglab reproduce 13_decode_once --profile smoke
      sfglab reproduce transmission
    """
    from sfglab.lab.experiments import EXPERIMENTS
    from sfglab.lab.notebooks import find_notebooks, is_variation, run_notebooks

    if parameter:
        typer.echo("warning: reproduce -p is now called sfglab try", err=True)
    project = find_project()
    parameters = {"seed": seed, **_parameters(profile, parameter or ())}
    outcomes = run_notebooks(
        find_notebooks(project, notebooks or ()),
        project=project,
        parameters=parameters,
        write=write,
        only=[name for name in notebooks or () if name in EXPERIMENTS],
    )
    if is_variation(parameters):
        typer.echo(_variations(project, outcomes))
    else:
        typer.echo(_counted(project, outcomes, profile=profile, all_claims=not notebooks))
    failed = _failed(outcomes)
    typer.echo(f"{len(outcomes) - failed} of {len(outcomes)} notebooks ran through", err=True)
    raise typer.Exit(bool(failed))


def try_experiment(
    name: Annotated[
        str, Argument(metavar="EXPERIMENT", help="Name of the experiment, e.g. gateways.")
    ],
    fields: Annotated[
        list[str] | None,
        Argument(
            metavar="FIELD=VALUE", help="Field of its settings with its value, e.g. frames=10."
        ),
    ] = None,
    profile: _Profile = "quick",
    folder_name: Annotated[
        str,
        Option("--name", metavar="NAME", help="Folder in runs/try. [default: EXPERIMENT-NUMBER]"),
    ] = "",
) -> None:
    """Run an experiment with other settings than those of its profile.

    The folder runs/try/NAME gets the notebook, the log, the figures and summary.txt: the claims by
    this run below those by the committed logs and your other runs. A try counts for no claim and
    replaces no file of another run. After an interruption, the same command with --name continues.
    The page "Experiments" of the book (make book) lists all fields.

    Examples:
      sfglab try gateways --profile smoke
      sfglab try depth_codecs frames=10 png_level=3 --name fast
      sfglab try decode_once source=drive.mp4   # or a log, a bag or a camera: camera:0
    """
    from sfglab.lab import notebooks
    from sfglab.lab.experiments import experiment

    experiment(name)  # This refuses an unknown name.
    project = find_project()
    parameters = _parameters(profile, fields or ())
    folder = _new_folder(project, name, folder_name)
    outcomes = [notebooks.try_experiment(name, folder, project=project, parameters=parameters)]
    given = ", ".join([f"profile {profile}", *(fields or ())])
    summary = f"{name}: {given}\n{_variations(project, outcomes)}"
    failed = _failed(outcomes)
    if not failed:
        file = folder / "summary.txt"
        file.write_text(f"{summary}\n", encoding="utf-8")
        summary += f"\n  summary: {project.relative(file)}"
    typer.echo(summary)
    raise typer.Exit(failed)


def _failed(outcomes: Sequence[Outcome]) -> int:
    """Print which notebooks failed; return how many."""
    failed = [outcome for outcome in outcomes if outcome.error]
    for outcome in failed:
        typer.echo(f"failed: {outcome.name}: {outcome.error}", err=True)
    return len(failed)


def _new_folder(project: Project, experiment: str, name: str) -> Path:
    """Return the folder of a try that has no finished log yet."""
    numbered = (f"{experiment}-{number}" for number in count(1))
    name = name or next(new for new in numbered if not (project.tries / new).exists())
    folder = project.tries / name
    if folder.parent != project.tries or name.startswith("."):
        raise InvalidValueError("--name", name, "the name of a folder, without / and leading dot")
    if any(folder.glob("*.mcap")):
        raise InvalidValueError("--name", name, "another name, because this one has a finished try")
    return folder


def _parameters(profile: str, pairs: Sequence[str]) -> dict[str, Any]:
    """Return a profile and fields as parameters of a notebook, the source as an absolute path."""
    from sfglab.lab.notebooks import read_parameters
    from sfglab.lab.sources import absolute, is_there

    parameters = {"profile": profile, **read_parameters(pairs)}
    source = parameters.get("source")
    if isinstance(source, str):
        change = is_there(source)
        if change:
            typer.echo(change, err=True)
        parameters["source"] = absolute(source)
    return parameters


def _counted(
    project: Project, outcomes: Sequence[Outcome], *, profile: str, all_claims: bool
) -> str:
    """Return the ledger: all claims, or those of the experiments that were run."""
    from sfglab.lab.claims import render
    from sfglab.lab.experiments import experiment
    from sfglab.lab.ledger import compute_ledger

    names = [name for outcome in outcomes for name in outcome.logs]
    only = {claim for name in names for claim in experiment(name).claims}
    ledger = compute_ledger(project, profile=profile, only=None if all_claims else only)
    return render(ledger) if ledger else "No claim of the ledger was measured."


def _variations(project: Project, outcomes: Sequence[Outcome]) -> str:
    """Return the claims by each run below those of the ledger, and the paths of its files."""
    from sfglab.lab.claims import Ledger, render
    from sfglab.lab.experiments import experiment
    from sfglab.lab.ledger import figures_folder, own_ledger

    claims = Ledger()
    lines = []
    for outcome in outcomes:
        lines += ["", outcome.name, f"  notebook: {project.relative(outcome.notebook)}"]
        for name, log in outcome.logs.items():
            run = experiment(name).load(log)
            claims += own_ledger(project, run)
            lines.append(f"  log: {project.relative(log)}")
            folder = figures_folder(project, log, outcome.notebook)
            lines.append(f"  figures: {project.relative(folder)}")
            if run.why_not:
                lines.append(f"  This run counts for no claim: {run.why_not}.")
    return "\n".join([render(claims) if claims else "", *lines])


def lab(
    options: Annotated[
        list[str] | None, Argument(metavar="OPTION", help="Option of JupyterLab, after --.")
    ] = None,
) -> None:
    """Open working copies of the notebooks in JupyterLab.

    The copies are in runs/lab, and show the committed runs until you choose other logs. A copy that
    you changed is kept. Only Ctrl+S saves a notebook: automatic saving is off.

    Examples:
      sfglab lab
      sfglab lab -- --no-browser --ServerApp.base_url=/user/a/
    """
    from sfglab.lab.copies import copy_notebooks

    project = find_project()
    folder = "runs/lab"
    try:
        for sentence in copy_notebooks(project):
            typer.echo(sentence, err=True)
    except (OSError, SfglabError) as error:
        folder = "notebooks"
        typer.echo(f"no working copies, so the notebooks themselves open: {error}", err=True)
    argv = [
        sys.executable,
        "-m",
        "jupyterlab",
        f"--ServerApp.root_dir={project.root.resolve()}",
        "--ServerApp.contents_manager_class=sfglab.lab.contents.Contents",
        "--ServerApp.kernel_websocket_connection_class=sfglab.lab.connection.PromptConnection",
    ]
    if os.getuid() == 0:  # in a container every user is root
        argv.append("--allow-root")
    argv += [f"--LabApp.default_url=/lab/tree/{folder}/00_start.ipynb", *(options or ())]
    # Its configuration switches off saving by itself, and the part that asks a public site for news.
    paths = [
        str(Path(sfglab.lab.__file__).parent / "jupyter"),
        os.environ.get("JUPYTER_CONFIG_PATH", ""),
    ]
    environment = os.environ | {"JUPYTER_CONFIG_PATH": os.pathsep.join(filter(None, paths))}
    os.execve(argv[0], argv, environment)  # noqa: S606  # one process, whose signals are JupyterLab's


def figures() -> None:
    """Redraw the figures of the repository from the committed logs.

    The figures of your runs are in runs/figures.

    Example:
      sfglab figures
    """
    from sfglab.lab.ledger import redraw_figures
    from sfglab.lab.summary import save_summary

    project = find_project()
    for name, files in {**redraw_figures(project), "summary": save_summary(project)}.items():
        typer.echo(f"{name}: {', '.join(project.relative(f) for f in files)}")


def claims(
    as_json: Json = False,
    verbose: Annotated[
        bool,
        Option("--verbose", help="Also print the acceptance range and the source of each claim."),
    ] = False,
    reference: Annotated[
        bool, Option("--reference", help="Read the committed logs only, not your runs.")
    ] = False,
    every: Annotated[
        bool,
        Option(
            "--all", help="Print a row for each log, also for logs that do not count for a claim."
        ),
    ] = False,
) -> None:
    """Print each claim of the papers with its value in the paper, our value and the verdict.

    The verdict compares our value with the acceptance range in data/claims.yaml.

    Examples:
      sfglab claims
      sfglab claims --reference   # what README and the committed notebooks print
      sfglab claims --json
    """
    from sfglab.lab.claims import render, render_in_full
    from sfglab.lab.ledger import compute_ledger, history

    if every:
        unused("with --all, which prints all logs", "reference")
    project = find_project()
    entries = history(project) if every else compute_ledger(project, committed=reference)
    values = [entry.as_json() for entry in entries]
    text = render_in_full(entries) if verbose else render(entries, with_logs=every)
    say(values, text, as_json=as_json)
