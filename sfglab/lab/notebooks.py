"""Notebooks: find, read and run them.

papermill only warns about a parameter that a notebook does not declare. Here it is an error, before
anything runs. Fields of the configuration that a parameters cell does not list are passed in its
parameter ``settings``, or ``settings_EXPERIMENT``.

Each notebook runs in a process of its own, see `notebook_process`. There are at most two at a time: one
for a notebook that measures, and one of the lowest priority for a notebook that only computes.
"""

from __future__ import annotations

import asyncio
import json
import os
import re
import sys
import time
from dataclasses import dataclass, fields
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Any

from sfglab.errors import InvalidValueError, SfglabError
from sfglab.lab.experiment import QUICK
from sfglab.lab.experiments import EXPERIMENTS, experiment
from sfglab.lab.iri_grammars import without_iri_grammars
from sfglab.lab.runs import SMOKE
from sfglab.processes import LineProcess, ProcessFailedError

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Mapping, Sequence
    from pathlib import Path

    from sfglab.lab.paths import Project

START = "00_start"  #: Notebook with the most important results.
LEDGER = "01_ledger"  #: Notebook with all claims.
#: Notebooks that report on the others and run after them.
REPORTS = (START, LEDGER)
SETTINGS = "settings"
COPIES = "lab"  #: Folder of the working copies in `runs`.
#: Values of a notebook's parameter `log`: the committed log, and the newest run that counts.
REFERENCE = "reference"
NEWEST = "newest"
#: New names of notebooks by their former names.
RENAMED = {
    "00_index": "00_start",
    "01_naming": "11_names_and_border",
    "01_names_and_border": "11_names_and_border",
    "02_depth_codecs": "13_decode_once",
    "03_decode_once": "13_decode_once",
    "04_routing": "11_names_and_border",
    "05_discovery": "12_discovery",
    "05_lifecycle": "12_discovery",
    "06_discovery": "12_discovery",
    "07_latency": "14_latency",
    "08_balancing": "21_caches_and_qos",
    "08_caches_and_qos": "21_caches_and_qos",
    "09_loss": "22_loss",
    "09_transmission": "22_loss",
    "10_cooperation": "23_hallway",
    "10_hallway": "23_hallway",
    "11_gateways": "31_mapping_and_gateway",
    "11_mapping_and_gateway": "31_mapping_and_gateway",
    "12_transfer": "32_transfer",
    "13_driving": "33_driving",
    "14_frames": "15_frames",
    "14_mocap": "15_frames",
    "15_planning": "16_planning",
    "16_visualisation": "17_viewer",
    "17_deployment": "18_deployment",
    "19_phases": "22_loss",
}
#: Commands for topics without a notebook, by the name or the former name of the notebook.
COMMANDS = {"ros2": "make ros2", "18_ros2": "make ros2"}
#: Environment variable of a kernel: path of the executed copy that its outputs go to.
COPY_VARIABLE = "SFGLAB_NOTEBOOK_COPY"
_EXPERIMENT = re.compile(r"notebook\.run\((\w+)\.exp\b")
_PARAMETER = re.compile(r"^(\w+) *[:=]", re.MULTILINE)
#: Priority of the process that only computes: the lowest.
_COMPUTING_NICE = 19
#: Time for a process to end its kernel, s.
_END_S = 20.0


class NotebookError(SfglabError, ValueError):
    """Error of a notebook that is missing, malformed, or cannot be run with these parameters."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Outcome:
    """Result of running one notebook."""

    name: str  #: The notebook's name without suffix.
    error: str  #: Cause of the failure, one line; empty after success.
    notebook: Path  #: Path of the executed copy.
    #: Logs that it shows, by experiment: of this run, or given ones.
    logs: Mapping[str, Path]


def _say(text: str) -> None:
    sys.stderr.write(f"{text}\n")


def read_parameters(pairs: Iterable[str]) -> dict[str, Any]:
    """Return parameters from texts ``name=value`` of a command line, with values in YAML.

    Raises:
        NotebookError: A text has another form, or its value is not YAML.
    """
    import yaml

    parameters = {}
    for pair in pairs:
        name, equals, value = pair.partition("=")
        if not equals or not name.isidentifier():
            raise NotebookError(
                f"parameter: given {pair!r}, allowed: FIELD=VALUE, such as frames=10"
            )
        parameters[name] = yaml.safe_load(value)
    return parameters


def find_notebooks(project: Project, names: Sequence[str] = ()) -> list[Path]:
    """Return the notebooks to run, in order; the reports on the others come last.

    Names are file names, with or without suffix, beginnings of them, or names of experiments; without any,
    all notebooks are returned.

    Raises:
        NotebookError: A name matches no notebook, or several.
    """
    every = sorted(p for p in project.notebooks.glob("*.ipynb") if not p.name.startswith("."))
    if not names:
        return sorted(every, key=lambda path: path.stem in REPORTS)
    return [_one_notebook(name, every, project) for name in names]


def _one_notebook(name: str, every: Sequence[Path], project: Project) -> Path:
    wanted = name.rpartition("/")[2].removesuffix(".ipynb")
    if wanted in EXPERIMENTS:
        wanted = notebook_of(project, wanted) or wanted
    fitting: list[Path] = []
    for pattern in (wanted, f"*_{wanted}", f"{wanted}*"):
        fitting = fitting or [path for path in every if path.match(f"{pattern}.ipynb")]
    if not fitting and wanted in RENAMED:
        raise NotebookError(f"notebook {wanted} is now called {RENAMED[wanted]}; use this name")
    if not fitting and wanted in COMMANDS:
        raise NotebookError(f"{wanted} has no notebook: {COMMANDS[wanted]} runs and records it")
    if len(fitting) != 1:
        fault = "fits several notebooks" if fitting else "is no notebook and no experiment"
        there = ", ".join(path.stem for path in every)
        raise NotebookError(f"notebook: given {name!r}, which {fault}; allowed: {there}")
    return fitting[0]


def fit_parameters(path: Path, given: Mapping[str, Any]) -> dict[str, Any]:
    """Return parameters as a notebook declares them, fields of its experiment in its settings.

    Raises:
        NotebookError: The notebook declares no such parameter, or its experiment no such field.
    """
    declared = _declared(path)
    experiments = experiments_of(path)
    fitted = {name: value for name, value in given.items() if name in declared}
    others = {name: value for name, value in given.items() if name not in declared}
    if others:
        settings = settings_name(experiments[0], declared) if len(experiments) == 1 else ""
        if settings not in declared:
            raise NotebookError(
                f"{path.name}: it declares no parameter {', '.join(sorted(others))}; "
                f"its parameters are {', '.join(sorted(declared)) or 'none'}"
            )
        fitted[settings] = {**fitted.get(settings, {}), **others}
    for name in experiments:
        _check_fields(path, name, fitted)
    return fitted


def settings_name(name: str, declared: Collection[str]) -> str:
    """Return the name of the parameter with the other fields of an experiment, among a notebook's parameters."""
    return SETTINGS if SETTINGS in declared else f"{SETTINGS}_{name}"


def _declared(path: Path) -> set[str]:
    """Return the names that a notebook's parameters cell assigns."""
    tagged = [cell for cell in cells_of(path) if "parameters" in cell["metadata"].get("tags", ())]
    if len(tagged) != 1:
        raise NotebookError(
            f"{path.name}: {len(tagged)} cells have the tag 'parameters', allowed: exactly one"
        )
    return set(_PARAMETER.findall(tagged[0]["source"]))


def _check_fields(path: Path, name: str, fitted: Mapping[str, Any]) -> None:
    """Refuse a value that the configuration of a notebook's experiment cannot hold."""
    exp = experiment(name)
    settings = fitted.get(settings_name(name, fitted), {})
    if not isinstance(settings, dict):
        raise NotebookError(
            f"{path.name}: settings: given {settings!r}, allowed: a mapping of fields to values"
        )
    own = {field.name for field in fields(exp.config_class)} - {"profile"}
    given = {parameter: value for parameter, value in fitted.items() if parameter in own}
    try:
        exp.config(fitted.get("profile", QUICK), **{**given, **settings})
    except InvalidValueError as error:
        raise NotebookError(f"{path.name}: {error}") from error


def experiments_of(path: Path) -> tuple[str, ...]:
    """Return the names of the experiments that a notebook runs, in order.

    Raises:
        NotebookError: The file is no notebook.
    """
    sources = "\n".join(cell["source"] for cell in cells_of(path))
    return tuple(dict.fromkeys(_EXPERIMENT.findall(sources)))


def notebook_of(project: Project, experiment: str) -> str:
    """Return the name of the notebook that runs an experiment; empty: there is none."""
    for path in find_notebooks(project):
        if experiment in experiments_of(path):
            return path.stem
    return ""


def cells_of(path: Path) -> list[dict[str, Any]]:
    """Return the cells of a notebook, each with its source as one text.

    Raises:
        NotebookError: The file is no notebook.
    """
    cells: list[dict[str, Any]] = read_notebook(path)["cells"]
    return cells


def read_notebook(path: Path) -> dict[str, Any]:
    """Return a notebook, each cell with its source as one text.

    The header of every notebook needs it, and `nbformat` takes seconds to import.

    Raises:
        NotebookError: The file is no notebook.
    """
    try:
        notebook = json.loads(path.read_text("utf-8"))
        for part in (notebook, *notebook["cells"]):
            part["metadata"].keys()
        for cell in notebook["cells"]:
            cell["source"] = "".join(cell["source"])
    except (ValueError, LookupError, TypeError, AttributeError) as error:
        raise NotebookError(f"{path.name}: not a notebook: {error}") from error
    return dict(notebook)


def run_notebooks(
    paths: Iterable[Path],
    *,
    project: Project,
    parameters: Mapping[str, Any],
    write: bool = False,
    only: Collection[str] = (),
) -> list[Outcome]:
    """Run notebooks, at most two at once; a failure does not stop the others.

    The reports on the others come last. Executed copies go to
    ``runs/notebooks``.

    Args:
        paths: The notebooks.
        project: The checkout.
        parameters: Values for the ``parameters`` cell of every notebook, or fields of its
            configuration.
        write: Whether the executed copies, normalised, also replace the notebooks.
        only: Names of experiments. A notebook that has one of them reads its other experiments
            from their committed logs. Empty: all run.

    Raises:
        NotebookError: Before anything runs: parameters that do not fit a notebook.
    """
    tasks = []
    for path in sorted(dict.fromkeys(paths), key=lambda path: path.stem in REPORTS):
        fitted = fit_parameters(path, parameters) | _reference_logs(path, project, only)
        copy = _executed_copy(path, project, parameters)
        tasks.append(_Task(path, copy, fitted))
    return asyncio.run(_run_all(project, tasks, write=write))


def try_experiment(
    name: str, folder: Path, *, project: Project, parameters: Mapping[str, Any]
) -> Outcome:
    """Run the notebook of an experiment, with the executed copy, log and figures in a folder.

    Args:
        name: Name of the experiment.
        folder: Path of the folder, in ``runs/try``. An interrupted sweep in it continues.
        project: The checkout.
        parameters: Profile and fields of the configuration.

    Raises:
        InvalidValueError: Before anything runs: fields that the experiment does not have.
        NotebookError: Before anything runs: its notebook declares no settings.
    """
    fields = dict(parameters)
    profile = fields.pop("profile")
    experiment(name).config(profile, **fields)
    [path] = find_notebooks(project, [name])
    declared = _declared(path)
    settings = settings_name(name, declared)
    if settings not in declared:
        raise NotebookError(
            f"{path.name}: its parameters cell must declare {settings}: dict = {{}}"
        )
    fields["path"] = project.relative(folder / f"{name}.mcap")
    fitted = {"profile": profile, settings: fields} | _reference_logs(path, project, [name])
    task = _Task(path, folder / path.name, fitted)
    [outcome] = asyncio.run(_run_all(project, [task]))
    return outcome


def _reference_logs(path: Path, project: Project, only: Collection[str]) -> dict[str, str]:
    """Return the parameters with the logs of the experiments that must not run."""
    experiments = set(experiments_of(path))
    logs: dict[str, str] = {}
    if experiments.isdisjoint(only):
        return logs
    for name in experiments.difference(only):
        log = project.reference_logs / f"{name}.mcap"
        if not log.is_file():
            raise NotebookError(
                f"{path.name}: {name}: there is no log {project.relative(log)}; restore it with git"
            )
        logs[f"log_{name}"] = project.relative(log)
    return logs


class _Task:
    """A notebook and the conditions of its run."""

    def __init__(self, path: Path, copy: Path, parameters: Mapping[str, Any]) -> None:
        self.path = path
        self.copy = copy  #: Path of the executed copy.
        self.parameters = parameters  #: Values for the parameters cell.
        self.experiments = experiments_of(path)
        #: Whether it reports on the other notebooks.
        self.reports = path.stem in REPORTS
        kinds = [experiment(name).measures for name in self.experiments]
        #: Whether other work at the same time cannot change the results.
        self.computes = not self.reports and bool(kinds) and not any(kinds)

    def logs(self, project: Project, before: Collection[Path]) -> dict[str, Path]:
        """Return the logs that it has read or written, by experiment, given all logs before."""
        logs = {}
        for name in self.experiments:
            settings = self.parameters.get(settings_name(name, self.parameters), {})
            given = self.parameters.get("log") or self.parameters.get(f"log_{name}")
            given = given or settings.get("path")
            new = [log for log in _own_logs(project, name) if log not in before]
            log = project.root / given if given else max(new, default=None)
            if log and log.is_file():
                logs[name] = log
        return logs


def _own_logs(project: Project, name: str) -> list[Path]:
    """Return the logs in the folder of an experiment."""
    return [*(project.runs / "logs" / name).glob("*.mcap")]


async def _run_all(
    project: Project, tasks: Sequence[_Task], *, write: bool = False
) -> list[Outcome]:
    """Run notebooks; return their outcomes in order."""
    outcomes: dict[Path, Outcome] = {}

    async def run_in_turn(own: Sequence[_Task], nice: int = 0) -> None:
        for task in own:
            place = f"[{tasks.index(task) + 1}/{len(tasks)}] {task.path.stem}"
            _say(f"{place} ...")
            begun_s = time.monotonic()
            outcome = await _run_task(project, task, nice)
            if write and not outcome.error:
                _replace(task, project)
            outcomes[task.path] = outcome
            result = f"failed: {outcome.error}" if outcome.error else "done"
            _say(f"{place} {result} after {time.monotonic() - begun_s:.0f} s")

    computing = [task for task in tasks if task.computes]
    measuring = [task for task in tasks if not task.computes and not task.reports]
    if not measuring or len(os.sched_getaffinity(0)) == 1:
        measuring = [task for task in tasks if not task.reports]
        computing = []
    async with asyncio.TaskGroup() as group:
        group.create_task(run_in_turn(measuring))
        group.create_task(run_in_turn(computing, _COMPUTING_NICE))
    await run_in_turn([task for task in tasks if task.reports])
    return [outcomes[task.path] for task in tasks]


async def _run_task(project: Project, task: _Task, nice: int) -> Outcome:
    before = {log for name in task.experiments for log in _own_logs(project, name)}
    error = await _run_papermill(task, nice)
    logs = task.logs(project, before)
    return Outcome(name=task.path.stem, error=error, notebook=task.copy, logs=logs)


async def _run_papermill(task: _Task, nice: int) -> str:
    """Run a notebook; return why it failed, or an empty text."""
    given = {"path": str(task.path), "copy": str(task.copy), "parameters": task.parameters}
    # In a session of its own it receives no Ctrl-C, not even while it starts.
    argv = ["setsid", sys.executable, "-m", "sfglab.lab.notebook_process"]
    process = await LineProcess.start("papermill", [*argv, str(nice), json.dumps(given)])
    try:
        report = await process.expect("done", timeout_s=None)
    except ProcessFailedError as failure:
        return str(failure)
    finally:
        await process.close(grace_s=_END_S)
    return str(report["error"])


def _replace(task: _Task, project: Project) -> None:
    """Replace a notebook by its executed copy."""
    with without_iri_grammars():
        import nbformat

    from sfglab.lab.notebook_outputs import normalise

    try:
        executed = nbformat.read(task.copy, as_version=4)
    except Exception as error:  # nbformat has no class for its errors
        raise NotebookError(f"{task.copy.name}: not a notebook: {str(error)[:200]}") from error
    nbformat.write(normalise(executed, project), task.path)


def is_variation(parameters: Mapping[str, Any]) -> bool:
    """Return whether a run with these parameters counts for no claim, or reads a log."""
    return parameters.get("profile") == SMOKE or not parameters.keys() <= {"profile", "seed"}


def _executed_copy(path: Path, project: Project, parameters: Mapping[str, Any]) -> Path:
    """Return the path of the executed copy; that of a variation replaces no other one."""
    folder = project.runs / "notebooks"
    if not is_variation(parameters):
        return folder / path.name
    stamp = datetime.now(UTC).strftime("%Y%m%dT%H%M%S-%f")
    return folder / f"{path.stem}-{stamp}-{parameters.get('profile', QUICK)}.ipynb"
