"""Experiments: an experiment declares its parts, its cells return rows, and its live parts write rows.

    exp = Experiment("transmission", Config, where="B 3.1", smoke={"seeds": 1}, paper={"seeds": 30})

declares a configuration, whose defaults are the profile ``quick``. Decorators declare the rest. The module
provides profiles, the log, progress, resumption, typed configurations of logs, sidecars of figures, and
entries of the ledger.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack, nullcontext
from dataclasses import asdict, dataclass, fields, replace
from itertools import product
from typing import TYPE_CHECKING, Any, Generic, TypeVar

from sfglab.errors import InvalidValueError, SfglabError
from sfglab.fields import to_json
from sfglab.lab.bench import Bench, Options, as_row
from sfglab.lab.checks import check_row
from sfglab.lab.claims import Finding, How
from sfglab.lab.figures import add_note, caption_of, default_sidecar, house_style
from sfglab.lab.hosts import HostsUnavailableError
from sfglab.lab.paths import find_project
from sfglab.lab.progress import progress_bar
from sfglab.lab.ros2 import RosMissingError
from sfglab.lab.runs import COMPLETION, SMOKE, Run, new_log, unfinished_of
from sfglab.lab.sweep import Workers, journals, sweep
from sfglab.lab.testbed import Testbed
from sfglab.record import LogError, LogWriter, run_context
from sfglab.tables import Shown
from sfglab.validation import read

if TYPE_CHECKING:
    from pathlib import Path

    from matplotlib.figure import Figure


C = TypeVar("C")
T = TypeVar("T")
F = TypeVar("F", bound=Callable[..., Any])

QUICK, PAPER = "quick", "paper"
#: Names of the profiles. All notebooks together take minutes with the first and up to 45 minutes with the
#: second. With the third, which has the papers' full counts, they take hours.
PROFILES = (SMOKE, QUICK, PAPER)
SMOKE_TITLE = "smoke test: too short for a conclusion"
_OPTIONS = Options()


class SkippedPartError(SfglabError):
    """A part that was not run; the log contains its message."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Profiled(Shown):
    """A configuration that names its profile."""

    profile: str = QUICK  #: Name of its profile.


@dataclass(frozen=True, slots=True)
class Actor:
    """A process or node of an experiment's set-up."""

    name: str  #: Name of the actor; for a group of equal actors, the name of one.
    host: str  #: Host on which it runs.
    does: str = ""  #: Role, in a few words.
    count: str = "1"  #: Number of such actors, as text.


@dataclass(frozen=True, slots=True)
class Link:
    """A link for messages between two actors."""

    source: str  #: Name of the actor that sends.
    target: str  #: Name of the actor that receives.
    carries: str  #: Messages that are sent.
    over: str = "DDS"  #: Transport.
    #: Boundary that it crosses: a domain, the network, the device or the memory interface; empty for none.
    boundary: str = ""


@dataclass(frozen=True, slots=True)
class Setup:
    """Hosts, processes and message links of an experiment, from which a diagram is drawn."""

    actors: tuple[Actor, ...] = ()  #: Processes and nodes.
    links: tuple[Link, ...] = ()  #: Links for messages between the actors.


@dataclass(frozen=True, slots=True)
class _Sweep:
    table: str
    task: Callable[[Any, int], Any]
    over: Callable[[Any], Sequence[Any]]
    seeds: Callable[[Any], Sequence[int]]
    workers: Workers


@dataclass(frozen=True, slots=True)
class _Part:
    name: str
    function: Callable[[Bench[Any]], Any]
    total: int | Callable[[Any], int]
    timed: bool


@dataclass(frozen=True, slots=True)
class _Drawing:
    function: Callable[[Figure, Run[Any]], dict[str, Any] | None]
    size: tuple[float, float]
    when: Callable[[Run[Any]], bool]
    measured: bool | None


def seeded(config: Any, seeds: int) -> range:
    """Return a number of seeds, starting with the configuration's own."""
    return range(config.seed, config.seed + seeds)


class Experiment(Generic[C]):
    """An experiment; `setup` shows its actors and the links between them.

    Args:
        name: Name in `EXPERIMENTS`, in logs and in journals.
        config: Frozen dataclass with documentation and bounds on its fields. Its defaults are the profile
            ``quick``. A field `profile` is filled in, and a changed field `seed` makes no variation.
        where: Paper and section.
        smoke: Fields that the profile ``smoke`` changes.
        paper: Fields that the profile ``paper`` changes.
        hosts: Names of the test hosts of a run, or a function of the configuration that returns them.
        actors: Processes and nodes of the set-up.
        links: Links for messages between the actors.
        removed: Fields of older logs with their values by profile. A log with another value, or of a profile
            that is not named, counts for no claim.
    """

    def __init__(  # noqa: PLR0913  # what an experiment declares in one place
        self,
        name: str,
        config: type[C],
        *,
        where: str,
        smoke: Mapping[str, Any],
        paper: Mapping[str, Any],
        hosts: Sequence[str] | Callable[[C], Sequence[str]] = (),
        actors: Sequence[Actor] = (),
        links: Sequence[Link] = (),
        removed: Mapping[str, Mapping[str, Any]] | None = None,
    ) -> None:
        self.name, self.where, self.config_class = name, where, config
        self._hosts, self.setup = hosts, Setup(tuple(actors), tuple(links))
        self._removed = removed or {}
        self._profiles: dict[str, Mapping[str, Any]] = {SMOKE: smoke, QUICK: {}, PAPER: paper}
        self.tables: dict[str, type[Any]] = {}
        self._sweeps: list[_Sweep] = []
        self._parts: list[_Part] = []
        #: Functions that answer its claims, with the way in which each is measured, by id.
        self.claims: dict[
            str,
            tuple[Callable[[Run[C]], Finding | None], How | Callable[[Run[C]], How], How | None],
        ] = {}
        self.drawings: dict[str, _Drawing] = {}  #: Declared figures, by name.
        self.explorers: dict[str, Callable[..., Any]] = {}

    def __repr__(self) -> str:
        return f"<experiment {self.name}: paper {self.where}>"

    # Declarations of an experiment.

    def table(self, *names: str) -> Callable[[type[T]], type[T]]:
        """Declare the class of tables' rows, as a dataclass. The names and texts of its fields go into the log.

        In a subclass of `TableRow`, mypy finds missing and unknown fields and wrong types.
        """

        def declare(row_class: type[T]) -> type[T]:
            if "__dataclass_fields__" not in vars(row_class):  # its own one, not an inherited one
                row_class = dataclass(frozen=True, slots=True, kw_only=True)(row_class)
            self.tables |= dict.fromkeys(names, row_class)
            return row_class

        return declare

    def sweep(
        self,
        table: str,
        *,
        over: Callable[[C], Sequence[Any]],
        seeds: Callable[[Any], Sequence[int]] = lambda config: seeded(config, config.seeds),
        workers: Workers = Workers(),  # noqa: B008  # frozen
    ) -> Callable[[F], F]:
        """Declare a sweep with a table of rows; an interrupted sweep continues. The function itself is not changed.

        The function takes a point and a seed, and returns a row, a mapping, or a tuple of them. Mappings
        get the point's fields and the seed. The table's name is also that of the journal. A row's time in
        the log is its number in the table, so that equal seeds give equal logs.

        Args:
            table: Name of the table.
            over: Returns the points.
            seeds: Returns the seeds. By default, their number is the configuration's `seeds`.
            workers: Workers of the sweep.
        """

        def declare(task: F) -> F:
            self._sweeps.append(_Sweep(table, task, over, seeds, workers))
            return task

        return declare

    def part(
        self,
        name: str,
        *,
        total: int | Callable[[C], int] = 1,
        timed: bool = True,
    ) -> Callable[[F], F]:
        """Declare a part: a function, sync or async, that takes a `Bench` and writes rows. Parts run in this order.

        If the part raises a `SkippedPartError`, or the machine lacks test hosts or ROS 2, the run
        continues, and the reason goes into the metadata with the part's name.

        Args:
            name: Name of the part.
            total: Number of its steps, or a function of the configuration that returns it.
            timed: Whether rows have the time of writing; otherwise they have their number in the table, so that
                equal seeds give equal logs.
        """

        def declare(function: F) -> F:
            self._parts.append(_Part(name, function, total, timed))
            return function

        return declare

    def claim(
        self, claim: str, *, how: How | Callable[[Run[C]], How], also: How | None = None
    ) -> Callable[[F], F]:
        """Declare the claim that a function of a run answers, and how it is measured.

        `also` is the origin of other checks that the value covers, if they are not measured alike.
        The function returns None if the run cannot answer the claim.
        """

        def declare(function: F) -> F:
            self.claims[claim] = function, how, also
            return function

        return declare

    def figure(
        self,
        name: str,
        *,
        size: tuple[float, float],
        when: Callable[[Run[C]], bool] = lambda _: True,
        measured: bool | None = None,
    ) -> Callable[[F], F]:
        """Declare a figure with its size in inches. The function takes an empty figure and a run, and draws.

        By default, the sidecar comes from the run: machine, repetitions and the tables that were read. The
        note then begins with the words that the function passes to `note`. It ends with repetitions and
        machine. If nothing is measured, it ends with *computed*, unless it begins with *simulated*. If the
        function returns a dictionary of JSON values, dataclasses and tables, this is the sidecar, and the
        function alone writes the note.

        Args:
            name: Name of the figure.
            size: Width and height, inches.
            when: Returns whether a run has the figure.
            measured: Whether the figure shows measured values; None: as the experiment.
        """

        def declare(function: F) -> F:
            self.drawings[name] = _Drawing(function, size, when, measured)
            return function

        return declare

    def explorer(self, function: F) -> F:
        """Declare an explorer: a function that returns the plot for a setting.

        Its parameters have default values, and types with bounds, such as ``Annotated[float, Bounds(1,
        9)]``. Their texts, with units in brackets, are in the section ``Args`` of its documentation. The
        function itself is not changed. A simulation is a generator of plots, coarse ones first.
        """
        self.explorers[function.__name__] = function
        return function

    # Use of the declarations.

    @property
    def measures(self) -> bool:
        """Whether it has a live or timed part, whose results depend on other work on the machine."""
        return bool(self._hosts) or any(
            p.timed or inspect.iscoroutinefunction(p.function) for p in self._parts
        )

    def caption(self, name: str) -> str:
        """Return the sentence that describes a figure, from the documentation of the function that draws it."""
        return caption_of(self.drawings[name].function) or name

    def config(self, profile: str = QUICK, **changes: Any) -> C:
        """Return the configuration of a profile with changed fields.

        Args:
            profile: ``smoke``, ``quick`` or ``paper``.
            changes: Values of fields; values of JSON are converted to the fields' types.

        Raises:
            InvalidValueError: There is no such profile or field, or a field cannot hold its value.
        """
        if profile not in self._profiles:
            raise InvalidValueError("profile", profile, ", ".join(self._profiles))
        names = [f.name for f in fields(self.config_class)]  # type: ignore[arg-type]
        own = {"profile": profile} if "profile" in names else {}
        values = {**own, **self._profiles[profile], **changes}
        if isinstance(values.get("seed"), int) and values["seed"] < 0:
            raise InvalidValueError(f"{self.name}: seed", values["seed"], "at least 0")
        config: C = read(self.config_class, values, f"{self.name}: ")
        return config

    def load(self, log: Path) -> Run[C]:
        """Return a finished run from its log."""
        return Run(log, self.config_class, self.tables, self._removed, self._profiles)

    async def run(
        self,
        profile: str = QUICK,
        *,
        path: Path | None = None,
        options: Options = _OPTIONS,
        **changes: Any,
    ) -> Run[C]:
        """Run the experiment into one log.

        Sweeps run first, then the parts in their order. After an interruption, the same run continues its
        sweeps. A run with changed fields counts for no claim, unless only the seed differs.

        Args:
            profile: ``smoke``, ``quick`` or ``paper``.
            path: Log to write; None for a new one below ``runs/``.
            options: Options of the run.
            changes: Values of fields, as `config` has them.

        Raises:
            InvalidValueError: A field cannot hold its value.
            LogError: The log exists.
            SfglabError: A part failed. Rows written before are in ``<log>.part``.
        """
        config = self.config(profile, **changes)
        path = path or new_log(find_project(), self.name, profile)
        if path.exists():
            raise LogError(f"log {path}: there is a file already; choose another path")
        path.parent.mkdir(parents=True, exist_ok=True)
        given = asdict(config)  # type: ignore[call-overload]
        usual = asdict(self.config(profile))  # type: ignore[call-overload]
        changed = [name for name in usual if usual[name] != given[name] and name != "seed"]
        done = {"experiment": self.name, "profile": profile, "changed": changed}
        if options.only is not None:
            done["only"] = sorted(options.only)
        with journals(path, f"{self.name}-{profile}") as journal:
            rows: dict[str, list[Any]] = {}
            for one in self._sweeps:
                if options.wants(one.table):
                    # In a smoke test, sweeps take less time than starting processes would.
                    workers = Workers(threads=True) if profile == SMOKE else one.workers
                    rows[one.table] = self._swept(one, config, journal(one.table), workers)
            unfinished = unfinished_of(path)
            await self._write(config, unfinished, rows, options, done)
            unfinished.rename(path)
        return self.load(path)

    def _swept(self, one: _Sweep, config: C, journal: Path, workers: Workers) -> list[Any]:
        points, seeds = one.over(config), one.seeds(config)
        if not points or not seeds:
            return []
        results = sweep(one.task, points, seeds, journal=journal, workers=workers)
        rows = []
        for (point, seed), result in zip(product(points, seeds), results, strict=True):
            made = result if isinstance(result, tuple) else (result,)
            rows += [as_row(self.tables[one.table], row, {"seed": seed}, point) for row in made]
        return rows

    async def _write(
        self,
        config: C,
        path: Path,
        rows: Mapping[str, list[Any]],
        options: Options,
        done: Mapping[str, Any],
    ) -> None:
        """Write a log: the rows of the sweeps by table, the output of the parts, and the completion record."""
        with ExitStack() as stack:
            parts = [part for part in self._parts if options.wants(part.name)]
            names = self._hosts(config) if callable(self._hosts) else self._hosts
            hosts = None
            if names and parts:
                hosts = stack.enter_context(Testbed(*names, separate=options.separate))
            log = stack.enter_context(LogWriter(path, overwrite=True))
            log.write_metadata("run", run_context())
            log.write_metadata("config", {"experiment": self.name, **to_json(config)})
            if hosts:
                log.write_metadata(
                    "hosts", {"description": hosts.description, "separate": hosts.separate}
                )
            bench = Bench(
                experiment=self.name,
                config=config,
                options=options,
                log=log,
                row_classes=self.tables,
                rows=rows,
                stack=stack,
                hosts=hosts,
            )
            for table, swept in rows.items():
                bench.write_all(table, swept)
            for part in parts:
                await self._run_part(part, bench)
            log.write_metadata(COMPLETION, done)

    async def _run_part(self, part: _Part, bench: Bench[C]) -> None:
        total = part.total if isinstance(part.total, int) else part.total(bench.config)
        bench.timed = part.timed
        bar = (
            progress_bar(total, f"{self.name}: {part.name}")
            if total
            else nullcontext(lambda _: None)
        )
        bench.cases.clear()
        with bar as advance:
            bench.advance = advance
            try:
                result = part.function(bench)
                if inspect.isawaitable(result):
                    await result
                for check, cases in bench.cases.items():
                    bench.write(check_row(check, cases))
                if total == 1:
                    advance("done")
            except (SkippedPartError, HostsUnavailableError, RosMissingError) as error:
                bench.metadata(part.name, {"hindrance": getattr(error, "reason", str(error))})

    def measure(self, run: Run[C]) -> dict[str, Finding]:
        """Return our values for the claims that a run answers, by claim."""
        found = {}
        for name, (answer, how, also) in self.claims.items():
            finding = answer(run)
            if finding is not None:
                origin = how if isinstance(how, How) else how(run)
                found[name] = replace(finding, how=origin, also=also or finding.also)
        return found

    def draw(self, name: str, run: Run[C]) -> tuple[Figure, dict[str, Any]]:
        """Draw a figure of a run, and return it with its sidecar.

        Raises:
            InvalidValueError: The experiment has no such figure, or the run does not have it.
        """
        from matplotlib.figure import Figure

        if name not in self.drawings:
            raise InvalidValueError(f"{self.name}: figure", name, ", ".join(self.drawings))
        drawing = self.drawings[name]
        with house_style():
            figure = Figure(figsize=drawing.size)
            run.used = set()
            shown = drawing.function(figure, run)
            if shown is None:
                shown = default_sidecar(run)
                measured = self.measures if drawing.measured is None else drawing.measured
                add_note(figure, shown, measured=measured)
            if run.profile == SMOKE:
                figure.suptitle(f"{SMOKE_TITLE}\n{figure.get_suptitle()}".strip())
        numbers = {}
        for key, value in shown.items():
            is_table = hasattr(value, "columns")
            numbers[key] = value.to_dict(orient="list") if is_table else to_json(value)
        return figure, numbers

    def figures(self, run: Run[C]) -> dict[str, tuple[Figure, dict[str, Any]]]:
        """Draw every figure that a run has, by name."""
        return {
            name: self.draw(name, run)
            for name, drawing in self.drawings.items()
            if drawing.when(run)
        }
