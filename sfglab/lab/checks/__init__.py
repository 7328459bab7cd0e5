"""The registry of checks: a property is written once, tests run a few cases of it, an experiment many.

Modules of this package have groups of checks: a `Checks` named `checks`, or in `trees` a table.
A check gives cases, each with what was tried and whether the property held; what it draws comes from a seed.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any, TypeVar

from sfglab.lab.stats import Estimate, exactly

if TYPE_CHECKING:
    import pandas as pd

    from sfglab.lab.runs import Run

NOTHING = "nothing to check"  #: The example of a property without a case, which has not held.
#: What was tried, as a reader wants to see it, and whether the property held.
Case = tuple[str, bool]


@dataclass(frozen=True, slots=True, kw_only=True)
class CheckRow:
    """How often one property was checked and how often it held."""

    check: str  #: The property.
    checked: int  #: Cases it was checked on.
    held: int  #: Cases in which it held.
    example: str  #: A case in which it did not; else one in which it did.


@dataclass(frozen=True, slots=True, kw_only=True)
class Share:
    """Share of the cases in a table of checks that hold."""

    estimate: Estimate  #: The share in the group where it is lowest; NaN: there are no checks.
    groups: dict[str, str]  #: ``held of checked`` by group.
    reason: str  #: The properties that did not always hold, each with an example; empty: none.


def share_of_checks(run: Run[Any], prefix: str = "") -> Share:
    """Return the share of cases that hold in a run's table ``check``, in the check where it is lowest.

    Only checks count whose name begins with the prefix.
    """
    table = run["check"]
    return lowest_share(table[table["check"].astype(str).str.startswith(prefix)], "check")


def shown_checks(
    table: pd.DataFrame,
    statements: Mapping[str, str] | None = None,
    examples: Mapping[str, str] | None = None,
) -> pd.DataFrame:
    """Return checks as a notebook shows them, with the sentence that each states, by its name in the log."""
    shown = table.replace({"check": statements or {}, "example": examples or {}})
    return shown.rename(
        columns={"check": "property", "checked": "cases", "held": "cases that hold"}
    )


def fact_rows(table: pd.DataFrame, sources: Mapping[str, tuple[str, ...]]) -> pd.DataFrame:
    """Return facts as a table with the columns of `CheckRow`, one row per fact, in their order.

    Args:
        table: Rows of a log's checks. A fact that is missing there does not hold.
        sources: Names of the facts, each with the checks that stand for it in logs from before there were facts.
    """
    import pandas as pd

    rows = []
    for fact, checks in sources.items():
        found = table[table["check"].isin((fact, *checks))]
        checked, held = int(found["checked"].sum()), int(found["held"].sum())
        seen = "; ".join(found["example"]) or NOTHING
        rows.append(CheckRow(check=fact, checked=max(1, checked), held=held, example=seen))
    return pd.DataFrame([asdict(row) for row in rows])


def lowest_share(table: pd.DataFrame, group: str) -> Share:
    """Return the share of checks that hold; columns are those of `CheckRow`, and one that groups."""
    sums = table.groupby(group, sort=False)[["held", "checked"]].sum()
    lowest = float((sums["held"] / sums["checked"]).min())
    wrong = table[table["held"] < table["checked"]]
    return Share(
        estimate=exactly(lowest, "share of checks that hold"),
        groups={str(row.Index): f"{row.held} of {row.checked}" for row in sums.itertuples()},
        reason="; ".join(
            f"{r.check}: {r.held} of {r.checked}: {r.example}" for r in wrong.itertuples()
        ),
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class Sample:
    """What a check draws its cases from."""

    count: int  #: How many cases are wanted, where they are drawn.
    seed: int  #: The run's seed, for what several checks share.


F = TypeVar("F", bound=Callable[..., object])
T = TypeVar("T")
ALL = "all of them"  #: The example of a trial that always held.


class Checks:
    """A group of checks, in the order of their rows."""

    def __init__(self, name: str) -> None:
        self.name = name
        self._cases: dict[str, Callable[[Sample], Iterable[Case]]] = {}

    @property
    def names(self) -> tuple[str, ...]:
        """The properties."""
        return tuple(self._cases)

    def cases(self, name: str) -> Callable[[F], F]:
        """Add a property whose function takes a `Sample` and gives cases."""

        def declare(function: F) -> F:
            self._cases[name] = function  # type: ignore[assignment]  # F keeps the function's own type
            return function

        return declare

    def each(self, name: str, of: Callable[[int, int], Iterable[T]]) -> Callable[[F], F]:
        """Add a property whose function says whether it holds for a thing, one of those of a count and seed."""

        def declare(function: F) -> F:
            self._cases[name] = lambda sample: (
                (str(thing), bool(function(thing))) for thing in of(sample.count, sample.seed)
            )
            return function

        return declare

    def rows(self, count: int, seed: int) -> Iterator[CheckRow]:
        """Yield a row for every property: `count` cases where they are drawn."""
        return (self.row(name, count=count, seed=seed) for name in self._cases)

    def row(self, name: str, *, count: int, seed: int) -> CheckRow:
        """Return one property's row."""
        return check_row(name, self._cases[name](Sample(count=count, seed=seed)))


def check_row(check: str, cases: Iterable[Case]) -> CheckRow:
    """Return what a property's cases came to, none: not held; the example is the first to fail or to hold."""
    tried = list(cases) or [(NOTHING, False)]
    failed = [text for text, held in tried if not held]
    example = failed[0] if failed else tried[0][0]
    return CheckRow(check=check, checked=len(tried), held=len(tried) - len(failed), example=example)


def facts_row(check: str, facts: Mapping[str, bool]) -> CheckRow:
    """Return what came of one property's facts; the example names those that do not hold, else all."""
    wrong = [fact for fact, held in facts.items() if not held]
    example = ", ".join(wrong or facts)
    return CheckRow(check=check, checked=len(facts), held=len(facts) - len(wrong), example=example)


def refusal(act: Callable[[], object], kind: type[Exception]) -> str:
    """Return in which words an act is refused by an error of a kind; empty where it is done."""
    try:
        act()
    except kind as error:
        return str(error)
    return ""
