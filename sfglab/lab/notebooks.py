"""Run notebooks headless, stricter than papermill, and make their outputs fit for version control.

papermill only warns about a parameter that a notebook does not declare; here it is an error, before anything
runs. Fields of the configuration that a parameters cell does not list travel in its parameter ``settings``.
"""

from __future__ import annotations

import ast
import asyncio
import io
import multiprocessing.connection
import re
import sys
import tempfile
import time
from collections.abc import Callable
from contextlib import ExitStack, suppress
from dataclasses import dataclass, replace
from functools import partial
from importlib import import_module
from typing import TYPE_CHECKING, Any

import psutil

from sfglab.errors import InvalidValueError, SfglabError
from sfglab.lab.ahead import end_process, give_way, sweeps_ahead
from sfglab.lab.experiment import QUICK
from sfglab.lab.experiments import experiment
from sfglab.lab.progress import is_line
from sfglab.lab.runs import SMOKE
from sfglab.lab.sweep.run import begin_worker

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence
    from multiprocessing.connection import Connection
    from pathlib import Path

    from nbformat import NotebookNode

    from sfglab.lab.paths import Project

INDEX = "00_index"

KERNEL = {"display_name": "Python 3 (ipykernel)", "language": "python", "name": "python3"}
"""The kernel that notebooks name, so that none asks for one when it is opened."""
SETTINGS = "settings"
_EXPERIMENT = re.compile(r"notebook\.run\((\w+)\.exp\b")
_ANY = re.compile("")
_CELL_METADATA_KEPT = ("tags",)


class NotebookError(SfglabError, ValueError):
    """A notebook that is missing, malformed, or not to be run with these parameters."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Outcome:
    """How one notebook ended."""

    name: str  #: The notebook's name without suffix.
    seconds: float  #: Wall time.
    error: str = ""  #: What went wrong, one line; empty when it ran through.
    experiment: str = ""  #: Name of the experiment that it runs; empty: none.
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
    """Return parameters as a notebook's cell declares them, others in ``settings``; or `NotebookError`."""
    notebook = read_notebook(path)
    tagged = [c for c in notebook.cells if "parameters" in c.metadata.get("tags", ())]
    if len(tagged) != 1:
        raise NotebookError(
            f"{path.name}: {len(tagged)} cells are tagged 'parameters', needed is exactly one"
        )
    declared = _assigned(path, tagged[0].source)
    unknown = sorted(set(given) - declared)
    runs = experiment_of(notebook)
    if runs and SETTINGS in declared:
        settings = dict(given.get(SETTINGS, {})) | {name: given[name] for name in unknown}
        listed = {
            name: value for name, value in given.items() if name in declared and name != SETTINGS
        }
        _check_fields(path, runs, listed | settings)
        return listed | ({SETTINGS: settings} if settings else {})
    if unknown:
        raise NotebookError(
            f"{path.name}: it declares no parameter {', '.join(unknown)}; "
            f"its parameters are {', '.join(sorted(declared)) or 'none'}"
        )
    return dict(given)


def _check_fields(path: Path, name: str, given: Mapping[str, Any]) -> None:
    """Refuse what the configuration of a notebook's experiment cannot hold, in one sentence."""
    profile = given.get("profile", QUICK)
    try:
        experiment(name).config(
            profile, **{k: v for k, v in given.items() if k not in ("profile", "log")}
        )
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


def run_notebook(
    path: Path, output: Path, parameters: Mapping[str, Any], **hooks: Callable[..., Any]
) -> None:
    """Run one notebook with hooks of nbclient; a copy is kept also if it fails, which is a `NotebookError`."""
    import papermill
    from traitlets.config import Config

    parameters = fit_parameters(path, parameters)
    output.parent.mkdir(parents=True, exist_ok=True)
    try:
        with tempfile.TemporaryDirectory() as folder:
            # A kernel is reached by this user only, and not over TCP.
            sockets = {"transport": "ipc", "ip": f"{folder}/kernel"}
            papermill.execute_notebook(
                str(path),
                str(output),
                parameters=parameters,
                kernel_name="python3",
                language="python",
                cwd=str(path.parent),
                progress_bar=False,
                stdout_file=_Steps(),
                stderr_file=sys.stderr,
                config=Config({"KernelManager": sockets}),
                **hooks,
            )
    except papermill.PapermillExecutionError as error:
        raise NotebookError(
            f"{path.name}: cell {error.exec_count}: {error.ename}: {error.evalue}"
        ) from error


def run_notebooks(
    paths: Sequence[Path],
    *,
    project: Project,
    parameters: Mapping[str, Any],
    write: bool = False,
    ahead: bool = False,
) -> list[Outcome]:
    """Run notebooks one after the other; a failure does not stop the rest.

    Executed copies go to ``runs/notebooks``, and with `write` normalised in place of the notebooks. Parameters
    are values for every notebook's ``parameters`` cell, or fields of its configuration. If others may go
    `ahead`, sweeps of notebooks to come are computed beside the others, and a notebook begins when nothing
    is measured any more in the one before, whose figures are drawn meanwhile.

    Raises:
        NotebookError: Before anything runs: parameters that do not fit a notebook.
    """
    paths = list(dict.fromkeys(paths))  # one that is named twice runs once
    for path in paths:
        fit_parameters(path, parameters)
    before = {path.stem: seconds_before(path, project, parameters) for path in paths}
    names = {path: experiment_of(read_notebook(path)) for path in paths}
    places = {
        path.stem: f"[{place}/{len(paths)}] {path.stem}"
        for place, path in enumerate(paths, start=1)
    }
    outcomes: list[Outcome] = []
    started_s = time.monotonic()

    def ended(outcome: Outcome) -> None:
        outcomes.append(outcome)
        said = f"failed: {outcome.error}" if outcome.error else "done"
        overlap = (time.monotonic() - started_s) / sum(one.seconds for one in outcomes)
        left_min = seconds_left(outcomes, before) * min(1.0, overlap) / 60
        left = f", about {left_min:.0f} min left" if len(outcomes) < len(paths) else ""
        _say(f"{places[outcome.name]} {said} after {outcome.seconds:.0f} s{left}")

    with ExitStack() as stack:
        leave = stack.enter_context(sweeps_ahead(_sweeping(names, parameters) if ahead else {}))
        runs = {path: partial(_run_one, path, project, parameters, write=write) for path in paths}
        measure = {path: not name or experiment(name).measures for path, name in names.items()}
        every = (
            (path.stem, run, _EXPERIMENT if measure[path] else _ANY) for path, run in runs.items()
        )
        turns = _Turns(every if ahead else (), ended, stack)
        for path, run in runs.items():
            if path.stem == INDEX:
                turns.end_all()
            leave(names[path])
            _say(f"{places[path.stem]} ...")
            if ahead:
                turns.take()
            else:
                ended(run())
        turns.end_all()
    return sorted(outcomes, key=lambda outcome: list(places).index(outcome.name))


_Turn = tuple[
    str, Callable[..., Outcome], re.Pattern[str]
]  # name, how it is run, its last cell that measures


class _Turns:
    """Notebooks in processes, which end with a stack: one begins when nothing is measured in the one before."""

    def __init__(
        self, turns: Iterable[_Turn], ended: Callable[[Outcome], None], stack: ExitStack
    ) -> None:
        import_module("papermill")  # once, and not in each process
        self._turns, self._ended, self._stack = iter(turns), ended, stack
        self._running: dict[Any, tuple[str, float]] = {}  # name and begin, by connection
        self._measured: Any = None
        self._make_ready()

    def take(self) -> None:
        """Let the next begin, beside which one other may end; return when its last measuring cell has run."""
        while len(self._running) > 1:
            self._hear()
        name, self._measured = self._ready
        self._running[self._measured] = name, time.monotonic()
        with suppress(BrokenPipeError):  # it has ended, which is heard
            self._measured.send(None)
        self._make_ready()
        while self._measured is not None:
            self._hear()

    def end_all(self) -> None:
        """Return when all have ended."""
        while self._running:
            self._hear()

    def _make_ready(self) -> None:
        """Start the next one's kernel, as far as there is one."""
        for name, run, last in self._turns:
            here, there = multiprocessing.Pipe()
            # Forked, because all is imported, and this process has no threads.
            process = multiprocessing.get_context("fork").Process(
                target=_take_turn, args=(run, last, there)
            )
            process.start()
            self._stack.callback(end_process, process)
            there.close()
            self._ready = name, here
            return

    def _hear(self) -> None:
        ready: list[Any] = multiprocessing.connection.wait(list(self._running))
        for connection in ready:
            name, started_s = self._running[connection]
            try:
                outcome: Outcome | None = connection.recv()
            except (EOFError, OSError):
                outcome = Outcome(name=name, seconds=0.0, error="its process ended")
            self._measured = None if self._measured is connection else self._measured
            if outcome is not None:
                del self._running[connection]
                self._ended(replace(outcome, seconds=time.monotonic() - started_s))


def _take_turn(run: Callable[..., Outcome], last: re.Pattern[str], there: Connection) -> None:
    begin_worker()
    told = asyncio.Event()

    async def before_cell(**_: Any) -> None:
        if not told.is_set():
            asyncio.get_running_loop().add_reader(there.fileno(), told.set)
            await told.wait()
            asyncio.get_running_loop().remove_reader(there.fileno())
            there.recv()

    def after_cell(cell: NotebookNode, **_: Any) -> None:
        if last.search(cell.source):
            for kernel in psutil.Process().children():
                give_way(kernel.pid)
            there.send(None)

    there.send(run(on_cell_start=before_cell, on_cell_executed=after_cell))


def _sweeping(
    names: Mapping[Path, str], parameters: Mapping[str, Any]
) -> dict[str, dict[str, Any]]:
    """Return the profile and the fields of the runs that have sweeps, by experiment."""
    runs = {}
    for path, name in names.items():
        if name and experiment(name).sweeps and "log" not in parameters:
            settings = (given := fit_parameters(path, parameters)).pop(SETTINGS, {})
            runs[name] = given | settings
    return runs


def seconds_left(done: Sequence[Outcome], before: Mapping[str, float]) -> float:
    """Return how long the others may take, s, by what they took before (0: unknown), at today's pace."""
    took = {outcome.name: outcome.seconds for outcome in done}
    known = [before[name] for name in took if before[name]]
    paced = [took[name] for name in took if before[name]]
    pace, usual = (sum(paced) / sum(known) if known else 1.0), sum(took.values()) / len(took)
    return sum(pace * s if s else usual for name, s in before.items() if name not in took)


def seconds_before(path: Path, project: Project, parameters: Mapping[str, Any]) -> float:
    """Return how long a notebook took when it was last run with these parameters, s; 0: unknown."""
    folder = project.runs / "notebooks"
    variations = sorted(folder.glob(f"{path.stem}-*.ipynb"))
    for copy in [*variations[-1:], folder / path.name]:
        seconds = _seconds_of(copy, fit_parameters(path, parameters))
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
    title = copy.cells[0].metadata.get("papermill", {}) if copy.cells else {}
    waited_s = title.get("duration") or 0.0  # the title's cell waits for the notebook's turn
    return float(run.get("duration") or waited_s) - waited_s


def _run_one(
    path: Path,
    project: Project,
    parameters: Mapping[str, Any],
    *,
    write: bool,
    **hooks: Callable[..., Any],
) -> Outcome:
    import nbformat

    output = _executed_copy(path, project, parameters)
    name = experiment_of(read_notebook(path))
    logs = project.runs / "logs" / (name or "none")
    before = set(logs.glob("*.mcap"))
    started = time.monotonic()
    try:
        run_notebook(path, output, parameters, **hooks)
    except NotebookError as error:
        seconds = time.monotonic() - started
        return Outcome(name=path.stem, seconds=seconds, error=str(error), notebook=output)
    seconds = time.monotonic() - started
    if write:
        nbformat.write(normalise(read_notebook(output), project), path)
    made = max(set(logs.glob("*.mcap")) - before, default=None)
    given = project.root / parameters["log"] if parameters.get("log") else made
    log = given if given is not None and given.is_file() else None
    return Outcome(name=path.stem, seconds=seconds, experiment=name, notebook=output, log=log)


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
