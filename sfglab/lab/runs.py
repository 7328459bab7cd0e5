"""Runs on disk: a log with its tables and typed configuration, and whether it counts for claims.

A log has the name ``*.mcap.part`` until its run is finished. The log of a finished run ends with a
completion record.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, fields
from functools import wraps
from typing import TYPE_CHECKING, Any, Concatenate, Generic, ParamSpec, TypeVar, cast

from sfglab.errors import SfglabError
from sfglab.fields import to_json
from sfglab.record import DecodedMessage, LogReader
from sfglab.tables import field_rows, html_table
from sfglab.validation import Source, lost_values, read

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping
    from pathlib import Path

    import pandas as pd

    from sfglab.lab.paths import Project

C = TypeVar("C")
P = ParamSpec("P")
T = TypeVar("T")

COMPLETION = "completion"  #: Metadata at the end of a finished run's log.
#: Key of a part's metadata with the cells that failed, and the reasons. Such a run counts for no claim.
FAILED_CELLS = "failed"
PART_SUFFIX = ".part"
SMOKE = "smoke"
_NOTHING = object()


class Run(Generic[C]):
    """A finished run, read from its log; ``run["cell"]`` is a table, empty if the log does not have it."""

    def __init__(
        self,
        log: Path,
        config_class: type[C],
        row_classes: Mapping[str, type[Any]],
        removed: Mapping[str, Mapping[str, Any]],
        profiles: Mapping[str, Mapping[str, Any]],
    ) -> None:
        self.log = log  #: Path of the log.
        self._row_classes = row_classes
        self._known: dict[Any, tuple[Any, set[str]]] = {}
        #: Names of the tables that were read so far, directly or in a derived value.
        self.used: set[str] = set()
        with LogReader(log) as reader:
            self._tables = reader.tables
            self._metadata = {name: reader.metadata(name) for name in reader.metadata_names}
        logged = self._metadata["config"]
        usual = profiles.get(str(logged.get("profile")), {})
        #: Configuration of the run. A field that is newer than the log has the value of its profile.
        self.config: C = read(config_class, {**usual, **logged}, source=Source.LOG)
        lost = lost_values(logged, {"experiment": "", **to_json(self.config)})
        #: Fields of the log's configuration that no longer exist and had another value than their profile.
        self.unread = tuple(
            name
            for name, given in lost.items()
            if removed.get(name, {}).get(self.profile, _NOTHING) != given
        )

    def __repr__(self) -> str:
        return f"<run of {self.experiment}: {self.log.name}>"

    @property
    def why_not(self) -> str:
        """Reason why the run counts for no claim; empty if it counts."""
        why_not = standing(self.log).why_not
        if self.unread and not why_not:
            return f"its configuration has fields that no longer exist: {', '.join(self.unread)}"
        return why_not

    def _repr_html_(self) -> str:
        why = self.why_not
        counts = f"it counts for no claim: {why}" if why else "it counts for its claims"
        fields_html = html_table(field_rows(self.config), f"{repr(self)[1:-1]}, {counts}")
        tables = [("table", "rows"), *((name, len(self.table(name))) for name in self._tables)]
        return fields_html + html_table(tables)

    def __getitem__(self, table: str) -> pd.DataFrame:
        """Return a table without the times of its rows.

        Raises:
            KeyError: The experiment has no table with this name.
        """
        return self.table(table).drop(columns="log_time_ns")

    def table(self, name: str) -> pd.DataFrame:
        """Return a table with the times of its rows in the column `log_time_ns`."""
        return self.once(("table", name), lambda: self._read(name))

    def _read(self, name: str) -> pd.DataFrame:
        import pandas as pd

        self.used.add(name)
        if name not in self._tables:
            return pd.DataFrame(
                columns=["log_time_ns", *(f.name for f in fields(self._row_classes[name]))]
            )
        with LogReader(self.log) as reader:
            return reader.table(name)

    @property
    def experiment(self) -> str:
        """Name of the experiment."""
        return str(self._metadata["config"]["experiment"])

    @property
    def profile(self) -> str:
        """Profile of the run; empty in a log without completion record."""
        return str(self.metadata(COMPLETION).get("profile", ""))

    @property
    def is_changed(self) -> bool:
        """Whether the run is a variation: fields differ from those of the profile, or the run was explored."""
        done = self.metadata(COMPLETION)
        return bool(done.get("changed")) or bool(done.get("explored"))

    def metadata(self, name: str) -> dict[str, Any]:
        """Return a metadata record; empty if the log does not have it."""
        return dict(self._metadata.get(name, {}))

    def skipped(self, part: str) -> str:
        """Return the reason why a part was skipped; empty if it was not."""
        return str(self.metadata(part).get("hindrance", ""))

    def attachment(self, name: str) -> bytes:
        """Return the content of an attached file.

        Raises:
            LogError: There is no such file.
        """
        with LogReader(self.log) as reader:
            return reader.attachment(name)

    def messages(self, topic: str) -> Iterator[DecodedMessage]:
        """Yield the recorded messages of a topic, deserialised."""
        with LogReader(self.log) as reader:
            yield from reader.decoded(topic)

    def once(self, key: Any, make: Callable[[], T]) -> T:
        """Return the value that `make` made for a key before, or make it now."""
        if key not in self._known:
            outer = self.used
            self.used = set()
            try:
                value = make()
                self._known[key] = (value, self.used)
            finally:
                self.used = outer
        found: T
        found, used = self._known[key]
        self.used |= used
        return found


def derived(function: Callable[Concatenate[Run[C], P], T]) -> Callable[Concatenate[Run[C], P], T]:
    """Make a function of a run compute once for each run and arguments; callers must not change its result."""

    @wraps(function)
    def once(run: Run[C], *args: P.args, **kwargs: P.kwargs) -> T:
        key = (function, args, tuple(sorted(kwargs.items())))
        return run.once(key, lambda: function(run, *args, **kwargs))

    return cast("Callable[Concatenate[Run[C], P], T]", once)


def lines_of(table: pd.DataFrame) -> list[Any]:
    """Return the rows of a table, each with its columns as attributes."""
    return list(table.itertuples())


def new_log(project: Project, name: str, profile: str) -> Path:
    """Return the path of a new run's log; the names of an experiment's logs are in order of time."""
    stamp = time.strftime("%Y%m%dT%H%M%S", time.gmtime())
    folder = project.runs / "logs" / name
    stem, again = f"{stamp}-{profile}", 1
    while any(folder.glob(f"{stem}.mcap*")):
        again += 1
        stem = f"{stamp}-{profile}-{again}"
    return folder / f"{stem}.mcap"


def unfinished_of(log: Path) -> Path:
    """Return the path of a log while it is written."""
    return log.with_name(log.name + PART_SUFFIX)


@dataclass(frozen=True, slots=True, kw_only=True)
class Standing:
    """Whether a log counts for the claims of its experiment, and the reason if it does not."""

    profile: str  #: Profile of the run; empty if the log does not state it.
    why_not: str  #: Reason why the log counts for no claim; empty if it counts.

    @property
    def counts(self) -> bool:
        """Whether the log counts for its experiment's claims."""
        return not self.why_not


def standing(log: Path) -> Standing:
    """Return whether a run's log counts for claims.

    A log counts if it is finished, no smoke test and not explored, if no field is changed, and if no cell failed.
    """
    if log.name.endswith(PART_SUFFIX):
        return Standing(profile="", why_not="it is not finished")
    try:
        with LogReader(log) as reader:
            records = {name: reader.metadata(name) for name in reader.metadata_names}
    except SfglabError as error:
        return Standing(profile="", why_not=str(error))
    profile = str(records.get(COMPLETION, {}).get("profile", ""))
    return Standing(profile=profile, why_not=_why_not(records))


def _why_not(records: Mapping[str, Mapping[str, Any]]) -> str:
    done = records.get(COMPLETION)
    if not done:
        return "it has no completion record"
    if done.get("explored"):  # by an earlier version
        return "it was explored"
    if done["profile"] == SMOKE:
        return "it is a smoke test"
    if done["changed"]:
        return f"changed: {', '.join(done['changed'])}"
    failed = [part for part, record in records.items() if record.get(FAILED_CELLS)]
    return f"cells failed in {', '.join(failed)}" if failed else ""
