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
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import psutil

from sfglab.errors import InvalidValueError, SfglabError
from sfglab.lab.experiment import QUICK
from sfglab.lab.experiments import experiment
from sfglab.lab.progress import is_line
from sfglab.lab.runs import SMOKE

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence
    from multiprocessing.connection import Connection

    from nbformat import NotebookNode

    from sfglab.lab.paths import Project

INDEX = "00_index"

KERNEL = {"display_name": "Python 3 (ipykernel)", "language": "python", "name": "python3"}
"""The kernel that notebooks name, so that none asks for one when it is opened."""
SETTINGS = "settings"
_EXPERIMENT = re.compile(r"notebook\.run\((\w+)\.exp\b")
_CELL_METADATA_KEPT = ("tags",)
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
    experiment: str = ""  #: Name of its experiment; empty: none.
    notebook: Path | None = None  #: The executed copy.
    log: Path | None = None  #: Log of the run; None where the notebook runs no experiment.


def _say(text: str) -> None:
    sys.stderr.write(f"{text}\n")


def read_parameters(pairs: Sequence[str]) -> dict[str, Any]:
    """Read parameters ``name=value`` of a command line, values as YAML, or raise a `NotebookError`."""
    import yaml

    wrong = [p for p in pairs if not p.partition("=")[0].isidentifier() or "=" not in p]
    if wrong:
        raise NotebookError(f"parameter: given {wrong[0]!r}, needed is name=value")
    return {name: yaml.safe_load(value) for name, _, value in (p.partition("=") for p in pairs)}


def find_notebooks(project: Project, names: Sequence[str] = ()) -> list[Path]:
    """Return the notebooks to run, in order; the index comes last, since it reports on the others.

    Names are file names, with or without suffix, or beginnings of them; without any all are meant. Raises
    `NotebookError` if one fits no notebook, or several.
    """
    every = sorted(p for p in project.notebooks.glob("*.ipynb") if not p.name.startswith("."))
    if not names:
        return sorted(every, key=lambda path: path.stem == INDEX)
    return [_one_notebook(name, every) for name in names]


def _one_notebook(name: str, every: Sequence[Path]) -> Path:
    wanted = name.rsplit("/", 1)[-1].removesuffix(".ipynb")
    exact = [p for p in every if p.stem == wanted]
    fitting = exact or [
        p for p in every if p.stem.startswith(wanted) or p.stem.partition("_")[2] == wanted
    ]
    if len(fitting) != 1:
        what = "fits several notebooks" if fitting else "is no notebook"
        raise NotebookError(
            f"{name!r} {what}; there are {', '.join(p.stem for p in every) or 'none'}"
        )
    return fitting[0]


def fit_parameters(path: Path, given: Mapping[str, Any]) -> dict[str, Any]:
    """Return parameters as a notebook's cell declares them, other fields in ``settings``.

    Raises:
        NotebookError: The notebook declares no such parameter, or its experiment no such field.
    """
    notebook = read_notebook(path)
    declared = _declared(path, notebook)
    name = experiment_of(notebook)
    fitted = {parameter: value for parameter, value in given.items() if parameter in declared}
    unknown = {parameter: value for parameter, value in given.items() if parameter not in declared}
    if name and SETTINGS in declared:
        settings = {**fitted.pop(SETTINGS, {}), **unknown}
        _check_fields(path, name, fitted | settings)
        if settings:
            fitted[SETTINGS] = settings
    elif unknown:
        raise NotebookError(
            f"{path.name}: it declares no parameter {', '.join(sorted(unknown))}; "
            f"its parameters are {', '.join(sorted(declared)) or 'none'}"
        )
    return fitted


def _declared(path: Path, notebook: NotebookNode) -> set[str]:
    """Return the names that a notebook's parameters cell assigns."""
    tagged = [cell for cell in notebook.cells if "parameters" in cell.metadata.get("tags", ())]
    if len(tagged) != 1:
        raise NotebookError(
            f"{path.name}: {len(tagged)} cells are tagged 'parameters', needed is exactly one"
        )
    return _assigned(path, tagged[0].source)


def _check_fields(path: Path, name: str, given: Mapping[str, Any]) -> None:
    """Refuse a value that the configuration of a notebook's experiment cannot hold."""
    fields = dict(given)
    profile = fields.pop("profile", QUICK)
    fields.pop("log", None)
    try:
        experiment(name).config(profile, **fields)
    except InvalidValueError as error:
        raise NotebookError(f"{path.name}: {error}") from error


def _assigned(path: Path, source: str) -> set[str]:
    """Return the names that a cell assigns at its top level."""
    try:
        nodes = ast.parse(source).body
    except SyntaxError as error:
        raise NotebookError(f"{path.name}: its parameters cell is no Python: {error}") from error
    targets = [t for n in nodes if isinstance(n, ast.Assign) for t in n.targets]
    targets += [n.target for n in nodes if isinstance(n, ast.AnnAssign)]
    return {t.id for t in targets if isinstance(t, ast.Name)}


def experiment_of(notebook: NotebookNode) -> str:
    """Return the name of the experiment that a notebook runs; empty: none."""
    found = _EXPERIMENT.search("\n".join(c.source for c in notebook.cells))
    return found[1] if found else ""


def notebook_of(project: Project, experiment: str) -> str:
    """Return the name of the notebook that runs an experiment; empty: there is none."""
    for path in find_notebooks(project):
        if experiment and experiment_of(read_notebook(path)) == experiment:
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
                on_notebook_start=_lower_kernels,
            )
    except papermill.PapermillExecutionError as error:
        raise NotebookError(
            f"{path.name}: cell {error.exec_count}: {error.ename}: {error.evalue}"
        ) from error
    except RuntimeError as error:  # the kernel died
        raise NotebookError(f"{path.name}: {error}") from error


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
    experiment: str  #: Name of its experiment; empty: none.
    before_s: float  #: Duration of the last run with these parameters, s; 0: unknown.
    write: bool  #: Whether the executed copy replaces the notebook.

    @property
    def name(self) -> str:
        """Name of the notebook without suffix."""
        return self.path.stem

    @property
    def measures(self) -> bool:
        """Whether other work at the same time may change its results."""
        return not self.experiment or experiment(self.experiment).measures

    def logs(self) -> set[Path]:
        """Return the finished logs of its experiment."""
        folder = self.project.runs / "logs" / (self.experiment or "none")
        return set(folder.glob("*.mcap"))


def run_notebooks(
    paths: Iterable[Path],
    *,
    project: Project,
    parameters: Mapping[str, Any],
    write: bool = False,
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

    Raises:
        NotebookError: Before anything runs: parameters that do not fit a notebook.
    """
    tasks = [_task(path, project, parameters, write=write) for path in dict.fromkeys(paths)]
    tasks.sort(key=lambda task: task.name == INDEX)
    report = _Report(tasks)
    others = [task for task in tasks if task.name != INDEX]
    measuring = [task for task in others if task.measures]
    computing = [task for task in others if not task.measures]
    if measuring and computing and len(os.sched_getaffinity(0)) > 1:
        _run_in_processes(measuring, computing, report)
    else:
        _run_here(others, report)
    _run_here(tasks[len(others) :], report)
    return report.in_order()


def _task(path: Path, project: Project, parameters: Mapping[str, Any], *, write: bool) -> _Task:
    fitted = fit_parameters(path, parameters)
    return _Task(
        path=path,
        project=project,
        parameters=fitted,
        copy=_executed_copy(path, project, parameters),
        experiment=experiment_of(read_notebook(path)),
        before_s=seconds_before(path, project, fitted),
        write=write,
    )


class _Report:
    """Progress on standard error: a line for each begin and each end of a notebook."""

    def __init__(self, tasks: Sequence[_Task]) -> None:
        self._places = {
            task.name: f"[{place}/{len(tasks)}] {task.name}"
            for place, task in enumerate(tasks, start=1)
        }
        self._before_s = {task.name: task.before_s for task in tasks}
        self._outcomes: dict[str, Outcome] = {}
        self._begun_s = time.monotonic()

    def begin(self, task: _Task) -> None:
        """Report that a notebook begins."""
        _say(f"{self._places[task.name]} ...")

    def end(self, outcome: Outcome) -> None:
        """Report that a notebook has ended."""
        self._outcomes[outcome.name] = outcome
        line = f"{self._places[outcome.name]} "
        line += f"failed: {outcome.error}" if outcome.error else "done"
        line += f" after {outcome.seconds:.0f} s"
        if len(self._outcomes) < len(self._places):
            line += f", about {self._left_s() / 60:.0f} min left"
        _say(line)

    def _left_s(self) -> float:
        done = list(self._outcomes.values())
        # Two notebooks at once take less time than their sum.
        elapsed_s = time.monotonic() - self._begun_s
        overlap = elapsed_s / sum(outcome.seconds for outcome in done)
        return seconds_left(done, self._before_s) * min(1.0, overlap)

    def in_order(self) -> list[Outcome]:
        """Return the outcomes in the order of the notebooks."""
        return [self._outcomes[name] for name in self._places]


def _run_here(tasks: Iterable[_Task], report: _Report) -> None:
    for task in tasks:
        report.begin(task)
        report.end(_run_task(task))


def _run_in_processes(
    measuring: Sequence[_Task], computing: Sequence[_Task], report: _Report
) -> None:
    workers = [_Worker(measuring, report), _Worker(computing, report, nice=_COMPUTING_NICE)]
    try:
        while running := {worker.outcomes: worker for worker in workers if worker.tasks}:
            for ready in multiprocessing.connection.wait(running):
                worker = running[ready]  # type: ignore[index]  # only connections are waited for
                worker.receive()
    finally:
        for worker in workers:
            worker.end()


class _Worker:
    """A process that runs notebooks one after the other."""

    def __init__(self, tasks: Sequence[_Task], report: _Report, nice: int = 0) -> None:
        self.tasks = list(tasks)  #: The notebooks that have not ended; the first one runs.
        self._report = report
        self._nice = nice
        self._start()

    def _start(self) -> None:
        context = multiprocessing.get_context("spawn")
        self.outcomes, there = context.Pipe(duplex=False)
        self._process = context.Process(target=_run_list, args=(self.tasks, self._nice, there))
        self._process.start()
        there.close()
        self._begin()

    def _begin(self) -> None:
        self._begun_s = time.monotonic()
        self._report.begin(self.tasks[0])

    def receive(self) -> None:
        """Receive the outcome of the first notebook; if the process ended, start another one."""
        task = self.tasks.pop(0)
        try:
            outcome: Outcome = self.outcomes.recv()
        except EOFError:
            self.end()
            seconds = time.monotonic() - self._begun_s
            self._report.end(Outcome(name=task.name, seconds=seconds, error="its process ended"))
            if self.tasks:
                self._start()
        else:
            self._report.end(outcome)
            if self.tasks:
                self._begin()

    def end(self) -> None:
        """End the process, by force if it does not end in time."""
        self._process.terminate()
        self._process.join(_END_S)
        self._process.kill()
        self._process.join()
        self.outcomes.close()


def _run_list(tasks: Sequence[_Task], nice: int, outcomes: Connection) -> None:
    # The process that started this one receives Ctrl-C, too, and terminates this one. Kernels would
    # inherit SIG_IGN; they do not inherit a handler.
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

    logs_before = task.logs()
    begun_s = time.monotonic()
    try:
        run_notebook(task.path, task.copy, task.parameters)
    except NotebookError as error:
        seconds = time.monotonic() - begun_s
        return Outcome(name=task.name, seconds=seconds, error=str(error), notebook=task.copy)
    seconds = time.monotonic() - begun_s
    if task.write:
        nbformat.write(normalise(read_notebook(task.copy), task.project), task.path)
    log = max(task.logs() - logs_before, default=None)
    if task.parameters.get("log"):
        given = task.project.root / task.parameters["log"]
        log = given if given.is_file() else None
    return Outcome(
        name=task.name, seconds=seconds, experiment=task.experiment, notebook=task.copy, log=log
    )


def seconds_left(done: Sequence[Outcome], before: Mapping[str, float]) -> float:
    """Return how long the other notebooks may take, s.

    Args:
        done: The notebooks that have ended.
        before: Duration of the last run of every notebook, s; 0: unknown.
    """
    took = {outcome.name: outcome.seconds for outcome in done}
    mean = sum(took.values()) / len(took)
    known = [name for name in took if before[name]]
    pace = 1.0
    if known:
        pace = sum(took[name] for name in known) / sum(before[name] for name in known)
    left = 0.0
    for name, seconds in before.items():
        if name not in took:
            left += pace * seconds if seconds else mean
    return left


def seconds_before(path: Path, project: Project, parameters: Mapping[str, Any]) -> float:
    """Return how long a notebook took when it was last run with these parameters, s; 0: unknown."""
    folder = project.runs / "notebooks"
    variations = sorted(folder.glob(f"{path.stem}-*.ipynb"))
    for copy in [*variations[-1:], folder / path.name]:
        seconds = _seconds_of(copy, parameters)
        if seconds:
            return seconds
    return 0.0


def _seconds_of(path: Path, parameters: Mapping[str, Any]) -> float:
    """Return how long the run took of which this is the copy; 0 if it is another run."""
    try:
        copy = read_notebook(path)
    except NotebookError:
        return 0.0
    run = copy.metadata.get("papermill", {})
    if run.get("parameters") != parameters or run.get("exception"):
        return 0.0
    return float(run.get("duration") or 0.0)


def is_variation(parameters: Mapping[str, Any]) -> bool:
    """Return whether a run with these parameters counts for no claim, or reads a log."""
    return parameters.get("profile") == SMOKE or not parameters.keys() <= {"profile", "seed"}


def _executed_copy(path: Path, project: Project, parameters: Mapping[str, Any]) -> Path:
    """Return where the executed copy goes; that of a variation replaces no other one."""
    folder = project.runs / "notebooks"
    if not is_variation(parameters):
        return folder / path.name
    stamp = time.strftime("%Y%m%dT%H%M%S", time.gmtime())
    stem = f"{path.stem}-{stamp}-{parameters.get('profile', QUICK)}"
    copy = folder / f"{stem}.ipynb"
    again = 1
    while copy.exists():
        again += 1
        copy = folder / f"{stem}-{again}.ipynb"
    return copy


def normalise(notebook: NotebookNode, project: Project) -> NotebookNode:
    """Return an executed notebook, changed in place, without what differs for no reason and our path."""
    notebook.metadata = {"kernelspec": dict(KERNEL), "language_info": {"name": "python"}}
    notebook.cells = [
        c for c in notebook.cells if "injected-parameters" not in c.metadata.get("tags", ())
    ]
    count = 0
    for cell in notebook.cells:
        cell.metadata = {k: v for k, v in cell.metadata.items() if k in _CELL_METADATA_KEPT}
        if cell.cell_type != "code":
            continue
        count += 1
        cell.execution_count = count
        kept = [_normal_output(output, project, count) for output in cell.outputs]
        cell.outputs = [output for output in kept if output.get("text") != ""]
    return notebook


def _normal_output(output: NotebookNode, project: Project, count: int) -> NotebookNode:
    root = f"{project.root.resolve().as_posix()}/"
    if output.output_type == "execute_result":
        output.execution_count = count
    if "metadata" in output:  # what is kept are pictures' texts
        alts = {
            kind: m["alt"]
            for kind, m in output.metadata.items()
            if isinstance(m, dict) and "alt" in m
        }
        output.metadata = {kind: {"alt": alt} for kind, alt in alts.items()}
    if output.output_type == "stream":
        lines = output.text.replace(root, "").splitlines(keepends=True)
        output.text = "".join(line for line in lines if not is_line(line))
    for kind, content in output.get("data", {}).items():
        if kind.startswith("text/"):
            output.data[kind] = content.replace(root, "")
    return output
