"""The bench of a run: the place where parts of an experiment write rows, messages and files."""

from __future__ import annotations

import time
from collections import ChainMap, Counter, defaultdict
from collections.abc import Callable, Iterable, Mapping
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any, Generic, TypeVar, dataclass_transform

if TYPE_CHECKING:
    from contextlib import ExitStack

    from sfglab.lab.checks import Case
    from sfglab.lab.testbed import Testbed
    from sfglab.record import LogWriter

C = TypeVar("C")
Row = Any  #: Instance of a table's class, or its fields as a mapping.


@dataclass_transform(frozen_default=True, kw_only_default=True)
class TableRow:
    """Base of a table's rows: `Experiment.table` makes a subclass a frozen dataclass, which mypy can check."""

    __slots__ = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class Options:
    """Options of a run on this machine; they are not part of the run's configuration."""

    #: Whether hosts are separate; None: they are where the machine can do that.
    separate: bool | None = None
    #: Tables of sweeps and names of parts that run; None: all.
    only: frozenset[str] | None = None

    def wants(self, name: str) -> bool:
        """Return whether a sweep, given by its table, or a part, given by its name, is to run."""
        return self.only is None or name in self.only


def as_row(row_class: type[Any], row: Row, *origins: Any) -> Any:
    """Return a row; a mapping gets each missing field from the first origin that has it."""
    if not isinstance(row, Mapping):
        return row
    known: ChainMap[str, Any] = ChainMap({})
    for origin in origins:
        known.maps.append(dict(origin) if isinstance(origin, Mapping) else asdict(origin))
    given = {f.name: known[f.name] for f in fields(row_class) if f.name in known}
    return row_class(**{**given, **row})


@dataclass(slots=True, kw_only=True)
class Bench(Generic[C]):
    """Context of a run: configuration, log and hosts, which the run's parts use."""

    experiment: str  #: Name of the experiment.
    config: C  #: The configuration.
    options: Options  #: Options of the run.
    log: LogWriter  #: The log, for messages that are no rows.
    row_classes: Mapping[str, type[Any]]  #: Classes of rows by table.
    rows: Mapping[str, list[Any]]  #: Rows of the sweeps, by table.
    stack: ExitStack  #: Contexts that end with the run.
    hosts: Testbed | None = None  #: The experiment's hosts, if it declares any.
    #: Whether rows have the time of writing; otherwise they have their number in the table.
    timed: bool = False
    #: Function that reports a step of the current part.
    advance: Callable[[str], None] = lambda _: None
    #: Cases by check; when a part ends, each check is written as a `CheckRow`.
    cases: defaultdict[str, list[Case]] = field(default_factory=lambda: defaultdict(list))
    _places: Counter[str] = field(default_factory=Counter)

    @property
    def testbed(self) -> Testbed:
        """The experiment's hosts; the experiment must declare them."""
        assert self.hosts is not None, "the experiment declares hosts"
        return self.hosts

    def write(self, table: Row, row: Row = None, *, at_ns: int | None = None) -> None:
        """Write one row: `write(row)` into the table of the row's class, or `write(table, row)`.

        Args:
            table: Name of the table. If `row` is missing: the row, whose class only one table has.
            row: An instance of the table's class, or its fields by name.
            at_ns: Time of the row in the log, ns. None: the current time, or in a part that is not timed the
                number of rows before it in its table.

        Raises:
            KeyError: There is no such table.
            ValueError: Not exactly one table has the row's class.
        """
        if row is None:
            row = table
            [table] = [name for name, known in self.row_classes.items() if known is type(row)]
        if at_ns is None:
            at_ns = time.time_ns() if self.timed else self._places[table]
        self._places[table] += 1
        self.log.write_row(table, as_row(self.row_classes[table], row), log_time_ns=at_ns)

    def write_all(self, table: str, rows: Iterable[Row]) -> None:
        """Write rows one after the other, as `write` does."""
        for row in rows:
            self.write(table, row)

    def metadata(self, name: str, values: Mapping[str, Any]) -> None:
        """Write a named mapping into the log; a name can be used once."""
        self.log.write_metadata(name, values)

    def attach(self, name: str, data: bytes, media_type: str = "application/octet-stream") -> None:
        """Attach a file to the log; a name can be used once."""
        self.log.attach(name, data, media_type)

    def folder(self, name: str) -> Path:
        """Return a new folder, which is removed at the end of the run."""
        path = Path(self.stack.enter_context(TemporaryDirectory(prefix="sfglab-run-")), name)
        path.mkdir()
        return path
