"""Run notebooks with papermill, and make their outputs fit for version control.

papermill only warns about a parameter that a notebook does not declare. Here it is an error, before
anything runs. Fields of the configuration that a parameters cell does not list are passed in its
parameter ``settings``.
"""

from __future__ import annotations

import ast
import io
import multiprocessing
import multiprocessing.connection
import os
import re
import signal
import sys
import tempfile
import threading
import time
from contextlib import ExitStack, suppress
from dataclasses import dataclass, field, fields
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

import psutil

from sfglab.errors import InvalidValueError, SfglabError
from sfglab.lab.experiment import QUICK
from sfglab.lab.experiments import EXPERIMENTS, experiment
from sfglab.lab.progress import is_line
from sfglab.lab.runs import SMOKE
from sfglab.lab.sweep.run import on_interrupt

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Mapping, Sequence
    from multiprocessing.connection import Connection
    from multiprocessing.process import BaseProcess

    from nbformat import NotebookNode

    from sfglab.lab.paths import Project

INDEX = "00_index"

KERNEL = {"display_name": "Python 3 (ipykernel)", "language": "python", "name": "python3"}
"""The kernel that notebooks name, so that none asks for one when it is opened."""
SETTINGS = "settings"
_EXPERIMENT = re.compile(r"notebook\.run\((\w+)\.exp\b")
#: Priority of the process that only computes: the lowest.
_COMPUTING_NICE = 19
#: Time for a process to end its kernel, s.
_END_S = 20.0


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
        for path in every:
            topic = path.stem.partition("_")[2]
            if topic == wanted or path.stem.startswith(wanted):
                fitting.append(path)
    if len(fitting) != 1:
        what = "fits several notebooks" if fitting else "is no notebook"
        there = ", ".join(path.stem for path in every) or "none"
        raise NotebookError(f"{name!r} {what}; there are {there}")
    return fitting[0]


def fit_parameters(path: Path, given: Mapping[str, Any], owner: str = "") -> dict[str, Any]:
    """Return parameters as a notebook's cell declares them, other fields in its settings.

    Args:
        path: The notebook.
        given: The parameters, and fields of an experiment.
        owner: The experiment that the fields belong to; empty: the notebook's only one.

    Raises:
        NotebookError: The notebook declares no such parameter, or its experiment no such field.
    """
    notebook = read_notebook(path)
    declared = _declared(path, notebook)
    experiments = experiments_of(notebook)
    fitted = {name: value for name, value in given.items() if name in declared}
    others = {name: value for name, value in given.items() if name not in declared}
    if len(experiments) == 1:
        owner = experiments[0]
    settings = settings_name(owner, declared)
    if others and settings not in declared:
        raise NotebookError(
            f"{path.name}: it declares no parameter {', '.join(sorted(others))}; "
            f"its parameters are {', '.join(sorted(declared)) or 'none'}"
        )
    if others:
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
    try:
        return _names(tagged[0].source, ast.Store)
    except SyntaxError as error:
        raise NotebookError(f"{path.name}: its parameters cell is no Python: {error}") from error


def _names(source: str, context: type[ast.expr_context]) -> set[str]:
    """Return the names that a cell reads (`ast.Load`) or assigns (`ast.Store`)."""
    found = set()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Name) and isinstance(node.ctx, context):
            found.add(node.id)
    return found


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


class _Steps(io.TextIOBase):
    """A stream that hands a notebook's lines of progress on to standard error."""

    def write(self, text: str) -> int:
        sys.stderr.writelines(line for line in text.splitlines(keepends=True) if is_line(line))
        return len(text)


def run_notebook(path: Path, output: Path, parameters: Mapping[str, Any]) -> None:
    """Run one notebook; a copy is kept also if it fails, which is a `NotebookError`."""
    import papermill
    from traitlets.config import Config

    output.parent.mkdir(parents=True, exist_ok=True)
    dependents = _Dependents()
    try:
        with tempfile.TemporaryDirectory() as folder:
            # A kernel is reached by this user only, and not over TCP.
            sockets = {"transport": "ipc", "ip": f"{folder}/kernel"}
            papermill.execute_notebook(
                str(path),
                str(output),
                parameters=dict(parameters),
                kernel_name="python3",
                language="python",
                cwd=str(path.parent),
                progress_bar=False,
                stdout_file=_Steps(),
                stderr_file=sys.stderr,
                config=Config({"KernelManager": sockets}),
                allow_errors=True,
                on_notebook_start=_lower_kernels,
                on_cell_start=dependents.skip,
                on_cell_error=dependents.note,
            )
    except papermill.PapermillExecutionError as error:
        raise NotebookError(
            f"{path.name}: cell {error.exec_count}: {error.ename}: {error.evalue}"
        ) from error
    except RuntimeError as error:  # the kernel died
        raise NotebookError(f"{path.name}: {error}") from error


class _Dependents:
    """Skips cells that use what a failed cell was to assign, so that the other cells run."""

    def __init__(self) -> None:
        self._missing: set[str] = set()

    def note(self, cell: NotebookNode, **_: Any) -> None:
        """Note what a failed cell was to assign."""
        with suppress(SyntaxError):
            self._missing |= _names(cell.source, ast.Store)

    def skip(self, cell: NotebookNode, **_: Any) -> None:
        """Skip a cell that uses what is missing."""
        if cell.cell_type != "code" or not self._missing:
            return
        with suppress(SyntaxError):
            assigned = _names(cell.source, ast.Store)
            if self._missing & (_names(cell.source, ast.Load) - assigned):
                cell.metadata.tags = [*cell.metadata.get("tags", ()), "skip-execution"]
                self._missing |= assigned
            else:
                self._missing -= assigned


def _lower_kernels(**_: Any) -> None:
    """Give the kernels of this process its priority.

    A kernel has a session of its own. Where Linux schedules by session, the priority of the session
    counts, and not that of its processes.
    """
    nice = os.getpriority(os.PRIO_PROCESS, 0)
    for child in psutil.Process().children():
        with suppress(OSError):
            if os.getsid(child.pid) == child.pid:
                Path(f"/proc/{child.pid}/autogroup").write_text(f"{nice}", encoding="ascii")


@dataclass(frozen=True, slots=True, kw_only=True)
class _Task:
    """A notebook that is to be run."""

    path: Path  #: The notebook.
    project: Project  #: The checkout.
    parameters: Mapping[str, Any]  #: Values for its parameters cell.
    copy: Path  #: Path of the executed copy.
    experiments: Sequence[str]  #: Names of its experiments.
    place: str = ""  #: Its number among those that are run, and its name.
    write: bool = False  #: Whether the executed copy replaces the notebook.
    folder: Path | None = None  #: Folder of its logs; None: that of its experiment.

    @property
    def measures(self) -> bool:
        """Whether other work at the same time may change its results."""
        return not self.experiments or any(experiment(name).measures for name in self.experiments)

    def logs(self, name: str) -> set[Path]:
        """Return the finished logs of one of its experiments."""
        folder = self.folder or self.project.runs / "logs" / name
        return set(folder.glob("*.mcap"))

    def given_log(self, name: str) -> Path | None:
        """Return the log that an experiment is read from; None: it runs."""
        given = self.parameters.get("log") or self.parameters.get(f"log_{name}")
        return self.project.root / given if given else None


def run_notebooks(
    paths: Iterable[Path],
    *,
    project: Project,
    parameters: Mapping[str, Any],
    write: bool = False,
    only: Collection[str] = (),
) -> list[Outcome]:
    """Run notebooks, at most two at once; a failure does not stop the others.

    One process runs the notebooks that measure, one after the other. The other process runs those
    that only compute, at the lowest priority. The index comes last, because it reports on the
    others. Executed copies go to ``runs/notebooks``.

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
        task = _Task(
            path=path,
            project=project,
            parameters=fit_parameters(path, parameters) | logs,
            copy=_executed_copy(path, project, parameters),
            experiments=experiments_of(read_notebook(path)),
            place=f"[{number}/{len(ordered)}] {path.stem}",
            write=write,
        )
        tasks.append(task)
    report = _Report(tasks)
    others = [task for task in tasks if task.path.stem != INDEX]
    measuring = [task for task in others if task.measures]
    computing = [task for task in others if not task.measures]
    if measuring and computing and len(os.sched_getaffinity(0)) > 1:
        _run_in_processes({0: measuring, _COMPUTING_NICE: computing}, report)
    for task in tasks:
        if task.path.stem not in report.outcomes:
            report.end(_run_task(task))
    return [report.outcomes[path.stem] for path in ordered]


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
    experiment(name).config(fields.pop("profile"), **fields)
    [path] = find_notebooks(project, [name])
    notebook = read_notebook(path)
    fitted = fit_parameters(path, parameters, name) | _reference_logs(path, project, [name])
    settings = settings_name(name, _declared(path, notebook))
    log = project.relative(folder / f"{name}.mcap")
    fitted[settings] = {**fitted.get(settings, {}), "path": log}
    task = _Task(
        path=path,
        project=project,
        parameters=fitted,
        copy=folder / path.name,
        experiments=experiments_of(notebook),
        place=path.stem,
        folder=folder,
    )
    outcome = _run_task(task)
    _Report([task]).end(outcome)
    return outcome


def _reference_logs(path: Path, project: Project, only: Collection[str]) -> dict[str, str]:
    """Return the parameters that name the logs of experiments which are not to be run."""
    experiments = experiments_of(read_notebook(path))
    others = [name for name in experiments if name not in only]
    logs: dict[str, str] = {}
    if len(others) == len(experiments):
        return logs
    for name in others:
        log = project.reference_logs / f"{name}.mcap"
        if not log.is_file():
            raise NotebookError(f"{path.name}: {name}: there is no log {project.relative(log)}")
        logs[f"log_{name}"] = project.relative(log)
    return logs


class _Report:
    """The outcomes, and a line of progress for each."""

    def __init__(self, tasks: Iterable[_Task]) -> None:
        self.outcomes: dict[str, Outcome] = {}  #: By name of the notebook.
        self._places = {task.path.stem: task.place for task in tasks}
        self._before_s = {
            task.path.stem: seconds_before(task.path, task.project, task.parameters)
            for task in tasks
        }
        self._begun_s = time.monotonic()

    def end(self, outcome: Outcome) -> None:
        """Report that a notebook has ended."""
        self.outcomes[outcome.name] = outcome
        result = f"failed: {outcome.error}" if outcome.error else "done"
        left = ""
        if len(self.outcomes) < len(self._places):
            elapsed_s = time.monotonic() - self._begun_s
            left_s = seconds_left(elapsed_s, self.outcomes, self._before_s)
            left = f", about {left_s / 60:.0f} min left"
        took = f" after {outcome.seconds:.0f} s" if outcome.seconds else ""
        _say(f"{self._places[outcome.name]} {result}{took}{left}")


def _run_in_processes(lists: Mapping[int, Sequence[_Task]], report: _Report) -> None:
    """Run a list of notebooks in a process of each priority."""
    spawn = multiprocessing.get_context("spawn")
    running: dict[Any, tuple[int, Sequence[_Task]]] = {}
    with ExitStack() as stack:

        def start(nice: int, tasks: Sequence[_Task]) -> None:
            outcomes, there = spawn.Pipe(duplex=False)
            process = spawn.Process(target=_run_list, args=(nice, tasks, there))
            # A process that still starts inherits this and does not receive Ctrl-C.
            with on_interrupt(signal.SIG_IGN):
                process.start()
            stack.callback(_end_process, process)
            there.close()
            running[outcomes] = nice, tasks

        for nice, tasks in lists.items():
            start(nice, tasks)
        while running:
            ready: list[Any] = multiprocessing.connection.wait(list(running))
            for outcomes in ready:
                nice, tasks = running.pop(outcomes)
                try:
                    report.end(outcomes.recv())
                    running[outcomes] = nice, tasks[1:]
                except EOFError:
                    if tasks:
                        name = tasks[0].path.stem
                        report.end(Outcome(name=name, seconds=0.0, error="its process ended"))
                        start(nice, tasks[1:])


def _end_process(process: BaseProcess) -> None:
    process.terminate()
    process.join(_END_S)
    process.kill()
    process.join()


def _run_list(nice: int, tasks: Sequence[_Task], outcomes: Connection) -> None:
    # After Ctrl-C the process that started this one terminates it. Kernels would inherit SIG_IGN;
    # they do not inherit a handler.
    signal.signal(signal.SIGINT, lambda *_: None)
    signal.signal(signal.SIGTERM, lambda *_: sys.exit())
    threading.Thread(target=_end_with_parent, daemon=True).start()
    os.nice(nice)
    for task in tasks:
        outcomes.send(_run_task(task))


def _end_with_parent() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os.kill(os.getpid(), signal.SIGTERM)


def _run_task(task: _Task) -> Outcome:
    import nbformat

    _say(f"{task.place} ...")
    before = {name: task.logs(name) for name in task.experiments}
    error = ""
    begun_s = time.monotonic()
    try:
        run_notebook(task.path, task.copy, task.parameters)
    except NotebookError as failure:
        error = str(failure)
    seconds = time.monotonic() - begun_s
    if task.write and not error:
        nbformat.write(normalise(read_notebook(task.copy), task.project), task.path)
    logs = {}
    for name in task.experiments:
        log = task.given_log(name) or max(task.logs(name) - before[name], default=None)
        if log and log.is_file():
            logs[name] = log
    return Outcome(name=task.path.stem, seconds=seconds, error=error, notebook=task.copy, logs=logs)


def seconds_left(elapsed_s: float, done: Collection[str], before_s: Mapping[str, float]) -> float:
    """Return how long the other notebooks may take at the pace of those that are done, s.

    Args:
        elapsed_s: Time since the first one began, s.
        done: Names of the notebooks that are done.
        before_s: Duration of the last run of every notebook, s; 0: unknown.
    """
    known = [seconds for seconds in before_s.values() if seconds]
    usual = sum(known) / len(known) if known else 1.0
    expected = {name: seconds or usual for name, seconds in before_s.items()}
    expected_of_done = sum(expected[name] for name in done)
    return elapsed_s * (sum(expected.values()) / expected_of_done - 1)


def seconds_before(path: Path, project: Project, parameters: Mapping[str, Any]) -> float:
    """Return how long a notebook took when it was last run with these parameters, s; 0: unknown."""
    folder = project.runs / "notebooks"
    variations = sorted(folder.glob(f"{path.stem}-*.ipynb"))
    for copy in [*variations[-1:], folder / path.name]:
        with suppress(NotebookError):
            run = read_notebook(copy).metadata.get("papermill", {})
            if run.get("parameters") == parameters and not run.get("exception"):
                return float(run.get("duration") or 0.0)
    return 0.0


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
        tags = cell.metadata.get("tags")
        if "injected-parameters" in (tags or ()):
            continue
        cells.append(cell)
        cell.metadata = {} if tags is None else {"tags": tags}
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
    if "metadata" in output:
        texts = {}
        for kind, metadata in output.metadata.items():
            if isinstance(metadata, dict) and "alt" in metadata:
                texts[kind] = {"alt": metadata["alt"]}
        output.metadata = texts
    if output.output_type == "stream":
        lines = output.text.replace(root, "").splitlines(keepends=True)
        output.text = "".join(line for line in lines if not is_line(line))
    for kind, content in output.get("data", {}).items():
        if kind.startswith("text/"):
            output.data[kind] = content.replace(root, "")
