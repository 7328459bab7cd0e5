"""Run notebooks with papermill, and make their outputs fit for version control.

papermill only warns about a parameter that a notebook does not declare. Here it is an error, before
anything runs. Fields of the configuration that a parameters cell does not list are passed in its
parameter ``settings``, or ``settings_EXPERIMENT``.

The module `notebook_process` is a process that runs one notebook after the other. There are at most
two: one for notebooks that measure, and one of the lowest priority for those that only compute.
"""

from __future__ import annotations

import asyncio
import os
import re
import sys
import time
from contextlib import suppress
from dataclasses import dataclass, field, fields
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Any

from sfglab.errors import InvalidValueError, SfglabError
from sfglab.lab.experiment import QUICK
from sfglab.lab.experiments import EXPERIMENTS, experiment
from sfglab.lab.progress import is_line
from sfglab.lab.runs import SMOKE
from sfglab.processes import LineProcess, ProcessFailedError

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Mapping, Sequence
    from pathlib import Path

    from nbformat import NotebookNode

    from sfglab.lab.paths import Project

INDEX = "00_index"

KERNEL = {"display_name": "Python 3 (ipykernel)", "language": "python", "name": "python3"}
"""The kernel that notebooks name, so that none asks for one when it is opened."""
SETTINGS = "settings"
_EXPERIMENT = re.compile(r"notebook\.run\((\w+)\.exp\b")
_PARAMETER = re.compile(r"^(\w+) *[:=]", re.MULTILINE)
#: Priority of the process that only computes: the lowest.
_COMPUTING_NICE = 19
#: Time for a process to end its kernel, s.
_END_S = 20.0
#: Assumed duration of a notebook that was not run before, s.
_UNKNOWN_S = 60.0


class NotebookError(SfglabError, ValueError):
    """A notebook that is missing, malformed, or not to be run with these parameters."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Outcome:
    """How one notebook ended."""

    name: str  #: The notebook's name without suffix.
    seconds: float  #: Wall time.
    error: str = ""  #: Reason of its failure, one line; empty when it ran through.
    notebook: Path | None = None  #: The executed copy.
    #: Logs that it shows, by experiment: of this run, or those that it was given.
    logs: Mapping[str, Path] = field(default_factory=dict)


def _say(text: str) -> None:
    sys.stderr.write(f"{text}\n")


def read_parameters(pairs: Iterable[str]) -> dict[str, Any]:
    """Read parameters ``name=value`` of a command line, values as YAML, or raise a `NotebookError`."""
    import yaml

    parameters = {}
    for pair in pairs:
        name, equals, value = pair.partition("=")
        if not equals or not name.isidentifier():
            raise NotebookError(f"parameter: given {pair!r}, needed is name=value")
        parameters[name] = yaml.safe_load(value)
    return parameters


def find_notebooks(project: Project, names: Sequence[str] = ()) -> list[Path]:
    """Return the notebooks to run, in order; the index comes last, since it reports on the others.

    Names are file names, with or without suffix, beginnings of them, or names of experiments;
    without any, all notebooks are meant. Raises `NotebookError` if one fits no notebook, or several.
    """
    every = sorted(p for p in project.notebooks.glob("*.ipynb") if not p.name.startswith("."))
    if not names:
        return sorted(every, key=lambda path: path.stem == INDEX)
    return [_one_notebook(name, every, project) for name in names]


def _one_notebook(name: str, every: Sequence[Path], project: Project) -> Path:
    wanted = name.rpartition("/")[2].removesuffix(".ipynb")
    if wanted in EXPERIMENTS:
        wanted = notebook_of(project, wanted) or wanted
    fitting = [path for path in every if path.stem == wanted]
    if not fitting:
        stems = re.compile(rf"{re.escape(wanted)}.*|.*_{re.escape(wanted)}")
        fitting = [path for path in every if stems.fullmatch(path.stem)]
    if len(fitting) != 1:
        fault = "fits several notebooks" if fitting else "is no notebook"
        there = ", ".join(path.stem for path in every)
        raise NotebookError(f"{name!r} {fault}; there are {there}")
    return fitting[0]


def fit_parameters(path: Path, given: Mapping[str, Any]) -> dict[str, Any]:
    """Return parameters as a notebook's cell declares them, fields of its experiment in its settings.

    Raises:
        NotebookError: The notebook declares no such parameter, or its experiment no such field.
    """
    notebook = read_notebook(path)
    declared = _declared(path, notebook)
    experiments = experiments_of(notebook)
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
    """Return which of a notebook's parameters has the other fields of an experiment."""
    return SETTINGS if SETTINGS in declared else f"{SETTINGS}_{name}"


def _declared(path: Path, notebook: NotebookNode) -> set[str]:
    """Return the names that a notebook's parameters cell assigns."""
    tagged = [cell for cell in notebook.cells if "parameters" in cell.metadata.get("tags", ())]
    if len(tagged) != 1:
        raise NotebookError(
            f"{path.name}: {len(tagged)} cells are tagged 'parameters', needed is exactly one"
        )
    return set(_PARAMETER.findall(tagged[0].source))


def _check_fields(path: Path, name: str, fitted: Mapping[str, Any]) -> None:
    """Refuse a value that the configuration of a notebook's experiment cannot hold."""
    exp = experiment(name)
    settings = fitted.get(settings_name(name, fitted), {})
    if not isinstance(settings, dict):
        raise NotebookError(f"{path.name}: settings: given {settings!r}, needed are fields")
    own = {field.name for field in fields(exp.config_class)} - {"profile"}
    given = {parameter: value for parameter, value in fitted.items() if parameter in own}
    try:
        exp.config(fitted.get("profile", QUICK), **{**given, **settings})
    except InvalidValueError as error:
        raise NotebookError(f"{path.name}: {error}") from error


def experiments_of(notebook: NotebookNode) -> tuple[str, ...]:
    """Return the names of the experiments that a notebook runs, in order."""
    source = "\n".join(cell.source for cell in notebook.cells)
    return tuple(dict.fromkeys(_EXPERIMENT.findall(source)))


def notebook_of(project: Project, experiment: str) -> str:
    """Return the name of the notebook that runs an experiment; empty: there is none."""
    for path in find_notebooks(project):
        if experiment in experiments_of(read_notebook(path)):
            return path.stem
    return ""


def read_notebook(path: Path) -> NotebookNode:
    """Return a notebook, or raise `NotebookError` if there is none, or it is none."""
    import nbformat

    try:
        notebook: NotebookNode = nbformat.read(path, as_version=4)
    except FileNotFoundError:
        raise NotebookError(f"{path.name}: no such notebook") from None
    except (
        nbformat.reader.NotJSONError,
        nbformat.validator.NotebookValidationError,
        ValueError,
    ) as error:
        raise NotebookError(f"{path.name}: not a notebook: {str(error)[:200]}") from error
    return notebook


@dataclass(frozen=True, slots=True, kw_only=True)
class _Task:
    """A notebook that is to be run."""

    path: Path  #: The notebook.
    copy: Path  #: Path of the executed copy.
    parameters: Mapping[str, Any]  #: Values for its parameters cell.
    experiments: Sequence[str]  #: Names of its experiments.
    place: str  #: Its number among those that are run, and its name.
    before_s: float = 0.0  #: Duration of its last run, s.

    @property
    def measures(self) -> bool:
        """Whether other work at the same time may change its results."""
        return not self.experiments or any(experiment(name).measures for name in self.experiments)


def run_notebooks(
    paths: Iterable[Path],
    *,
    project: Project,
    parameters: Mapping[str, Any],
    write: bool = False,
    only: Collection[str] = (),
) -> list[Outcome]:
    """Run notebooks, at most two at once; a failure does not stop the others.

    The index comes last, because it reports on the others. Executed copies go to
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
    ordered = sorted(dict.fromkeys(paths), key=lambda path: path.stem == INDEX)
    tasks = []
    for number, path in enumerate(ordered, start=1):
        logs = _reference_logs(path, project, only)
        fitted = fit_parameters(path, parameters) | logs
        task = _Task(
            path=path,
            copy=_executed_copy(path, project, parameters),
            parameters=fitted,
            experiments=experiments_of(read_notebook(path)),
            place=f"[{number}/{len(ordered)}] {path.stem}",
            before_s=seconds_before(path, project, fitted),
        )
        tasks.append(task)
    outcomes = asyncio.run(_Runner(project, tasks).run())
    if write:
        for outcome in outcomes:
            if not outcome.error:
                _replace(outcome, project)
    return outcomes


def try_experiment(
    name: str, folder: Path, *, project: Project, parameters: Mapping[str, Any]
) -> Outcome:
    """Run the notebook of an experiment, with the executed copy, log and figures in a folder.

    Args:
        name: The experiment.
        folder: The folder, in ``runs/try``. An interrupted sweep in it is continued.
        project: The checkout.
        parameters: Profile and fields of the configuration.

    Raises:
        InvalidValueError: Before anything runs: fields that the experiment does not have.
    """
    fields = dict(parameters)
    profile = fields.pop("profile")
    experiment(name).config(profile, **fields)
    [path] = find_notebooks(project, [name])
    notebook = read_notebook(path)
    settings = settings_name(name, _declared(path, notebook))
    fields["path"] = project.relative(folder / f"{name}.mcap")
    logs = _reference_logs(path, project, [name])
    task = _Task(
        path=path,
        copy=folder / path.name,
        parameters={"profile": profile, settings: fields, **logs},
        experiments=experiments_of(notebook),
        place=path.stem,
    )
    [outcome] = asyncio.run(_Runner(project, [task]).run())
    return outcome


def _reference_logs(path: Path, project: Project, only: Collection[str]) -> dict[str, str]:
    """Return the parameters that name the logs of experiments which are not to be run."""
    experiments = experiments_of(read_notebook(path))
    logs: dict[str, str] = {}
    if set(experiments).isdisjoint(only):
        return logs
    for name in set(experiments).difference(only):
        log = project.reference_logs / f"{name}.mcap"
        if not log.is_file():
            raise NotebookError(f"{path.name}: {name}: there is no log {project.relative(log)}")
        logs[f"log_{name}"] = project.relative(log)
    return logs


class _Runner:
    """Runs notebooks in processes, and reports their progress."""

    def __init__(self, project: Project, tasks: Sequence[_Task]) -> None:
        self._project = project
        self._tasks = tasks
        self._outcomes: dict[Path, Outcome] = {}
        self._begun_s = time.monotonic()

    async def run(self) -> list[Outcome]:
        """Run all notebooks; return their outcomes in order."""
        others = [task for task in self._tasks if task.path.stem != INDEX]
        computing = [task for task in others if not task.measures]
        measuring = [task for task in others if task.measures]
        if not measuring or len(os.sched_getaffinity(0)) == 1:
            measuring, computing = others, []
        async with asyncio.TaskGroup() as group:
            group.create_task(self._run_in_turn(measuring, 0))
            group.create_task(self._run_in_turn(computing, _COMPUTING_NICE))
        await self._run_in_turn([task for task in self._tasks if task not in others], 0)
        return [self._outcomes[task.path] for task in self._tasks]

    async def _run_in_turn(self, tasks: Sequence[_Task], nice: int) -> None:
        """Run notebooks in one process, and after its death in another one."""
        process = None
        try:
            for task in tasks:
                if process is None or process.status is not None:
                    process = await _start_process(nice)
                await self._run_task(task, process)
        finally:
            if process is not None:
                await process.close(grace_s=_END_S)

    async def _run_task(self, task: _Task, process: LineProcess) -> None:
        _say(f"{task.place} ...")
        before = {name: self._logs(name) for name in task.experiments}
        begun_s = time.monotonic()
        process.order(path=str(task.path), copy=str(task.copy), parameters=task.parameters)
        try:
            report = await process.expect("done", timeout_s=None)
            error = report["error"]
        except ProcessFailedError as failure:
            error = str(failure)
        seconds = time.monotonic() - begun_s
        logs = {}
        for name, old in before.items():
            log = self._given_log(task, name) or max(self._logs(name) - old, default=None)
            if log and log.is_file():
                logs[name] = log
        self._outcomes[task.path] = Outcome(
            name=task.path.stem, seconds=seconds, error=error, notebook=task.copy, logs=logs
        )
        result = f"failed: {error}" if error else "done"
        _say(f"{task.place} {result} after {seconds:.0f} s{self._time_left()}")

    def _logs(self, name: str) -> set[Path]:
        """Return the logs in the folder of an experiment."""
        return set((self._project.runs / "logs" / name).glob("*.mcap"))

    def _given_log(self, task: _Task, name: str) -> Path | None:
        """Return the log that an experiment is told to read or to write."""
        parameters = task.parameters
        settings = parameters.get(settings_name(name, parameters), {})
        read = parameters.get("log") or parameters.get(f"log_{name}")
        given = read or settings.get("path")
        return self._project.root / given if given else None

    def _time_left(self) -> str:
        """Return the time left at today's pace, as words that end a line; empty: all are done."""
        left_s = sum(task.before_s for task in self._tasks if task.path not in self._outcomes)
        if not left_s:
            return ""
        done_s = sum(task.before_s for task in self._tasks if task.path in self._outcomes)
        elapsed_s = time.monotonic() - self._begun_s
        return f", about {elapsed_s * left_s / done_s / 60:.0f} min left"


async def _start_process(nice: int) -> LineProcess:
    # In a session of its own it does not receive Ctrl-C, also while it starts.
    module = "sfglab.lab.notebook_process"
    return await LineProcess.start(
        "its process", ["setsid", sys.executable, "-m", module, str(nice)]
    )


def _replace(outcome: Outcome, project: Project) -> None:
    """Replace a notebook by its executed copy."""
    import nbformat

    assert outcome.notebook is not None
    executed = normalise(read_notebook(outcome.notebook), project)
    nbformat.write(executed, project.notebooks / f"{outcome.name}.ipynb")


def seconds_before(path: Path, project: Project, parameters: Mapping[str, Any]) -> float:
    """Return how long a notebook took when it was last run with these parameters, s."""
    copies = sorted((project.runs / "notebooks").glob(f"{path.stem}[-.]*"))
    for copy in copies[-2:]:
        with suppress(NotebookError):
            run = read_notebook(copy).metadata.get("papermill", {})
            if run.get("parameters") == parameters and not run.get("exception"):
                return run.get("duration") or _UNKNOWN_S
    return _UNKNOWN_S


def is_variation(parameters: Mapping[str, Any]) -> bool:
    """Return whether a run with these parameters counts for no claim, or reads a log."""
    return parameters.get("profile") == SMOKE or not parameters.keys() <= {"profile", "seed"}


def _executed_copy(path: Path, project: Project, parameters: Mapping[str, Any]) -> Path:
    """Return where the executed copy goes; that of a variation replaces no other one."""
    folder = project.runs / "notebooks"
    if not is_variation(parameters):
        return folder / path.name
    stamp = datetime.now(UTC).strftime("%Y%m%dT%H%M%S-%f")
    return folder / f"{path.stem}-{stamp}-{parameters.get('profile', QUICK)}.ipynb"


def normalise(notebook: NotebookNode, project: Project) -> NotebookNode:
    """Return an executed notebook, changed in place, without traces of its run.

    Without are times, progress, counts of other runs, the cell of injected parameters and the path
    of the checkout.
    """
    notebook.metadata = {"kernelspec": dict(KERNEL), "language_info": {"name": "python"}}
    cells = []
    count = 0
    for cell in notebook.cells:
        if "injected-parameters" in cell.metadata.get("tags", ()):
            continue
        cells.append(cell)
        cell.metadata = {key: kept for key, kept in cell.metadata.items() if key == "tags"}
        if cell.cell_type == "code":
            count += 1
            cell.execution_count = count
            for output in cell.outputs:
                _normalise_output(output, project, count)
            cell.outputs = [output for output in cell.outputs if output.get("text") != ""]
    notebook.cells = cells
    return notebook


def _normalise_output(output: NotebookNode, project: Project, count: int) -> None:
    root = f"{project.root.resolve().as_posix()}/"
    if output.output_type == "execute_result":
        output.execution_count = count
    if output.output_type == "stream":
        lines = output.text.replace(root, "").splitlines(keepends=True)
        output.text = "".join(line for line in lines if not is_line(line))
    for kind, content in output.get("data", {}).items():
        if kind.startswith("text/"):
            output.data[kind] = content.replace(root, "")
