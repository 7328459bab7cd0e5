"""Registry of checks: a property is written once; tests run a few cases of it, and an experiment many.

The modules of this package have groups of checks: a `Checks` named `checks`, or in `trees` a table. A check
yields cases, each with a description and whether the property holds. Random cases depend on a seed.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any, TypeVar

from sfglab.lab.stats import Estimate, exactly

if TYPE_CHECKING:
    import pandas as pd

    from sfglab.lab.runs import Run

F = TypeVar("F", bound=Callable[..., object])
G = TypeVar("G", bound=Callable[[], "Iterable[Case]"])
T = TypeVar("T")
NOTHING = "nothing to check"  #: The example of a property without a case, which has not held.
#: Description of a case for readers, and whether the property held.
Case = tuple[str, bool]


@dataclass(frozen=True, slots=True, kw_only=True)
class CheckRow:
    """Result of the check of one property in a number of cases."""

    check: str  #: Statement of the property.
    checked: int  #: Number of cases.
    held: int  #: Number of cases in which it held.
    example: str  #: A case in which it did not hold, otherwise one in which it did.


@dataclass(frozen=True, slots=True, kw_only=True)
class Share:
    """Share of the cases in a table of checks that hold."""

    estimate: Estimate  #: The share in the group where it is lowest; NaN: there are no checks.
    groups: dict[str, str]  #: ``held of checked`` by group.
    reason: str  #: The properties that did not always hold, each with an example; empty: none.


def share_of_checks(run: Run[Any], prefix: str) -> Share:
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
    """Return the table of checks for a notebook.

    Args:
        table: Checks of a log, with the columns of `CheckRow`.
        statements: New statements, by the statement of the log that each one replaces.
        examples: New examples, by the example of the log that each one replaces.
    """
    texts = {"check": statements or {}, "example": examples or {}, "how": {"exact": "computed"}}
    shown = table.replace(texts)
    return shown.rename(
        columns={"check": "property", "checked": "cases", "held": "cases that hold"}
    )


def fact_rows(table: pd.DataFrame, facts: Iterable[str]) -> pd.DataFrame:
    """Return facts as a table with the columns of `CheckRow`, one row per fact, in their order.

    Args:
        table: Rows of a log's checks. A fact that is missing there does not hold.
        facts: Names of the facts.
    """
    import pandas as pd

    rows = []
    for fact in facts:
        found = table[table["check"] == fact]
        checked, held = int(found["checked"].sum()), int(found["held"].sum())
        seen = "; ".join(found["example"]) or NOTHING
        rows.append(CheckRow(check=fact, checked=max(1, checked), held=held, example=seen))
    return pd.DataFrame([asdict(row) for row in rows])


def lowest_share(table: pd.DataFrame, group: str) -> Share:
    """Return the share of cases that hold, in the group where it is lowest.

    Args:
        table: Checks with the columns of `CheckRow`, and a column with the group.
        group: Name of the column with the group.
    """
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


class Checks:
    """A group of checks, in the order of their rows."""

    def __init__(self) -> None:
        self._cases: dict[str, Callable[[int, int], Iterable[Case]]] = {}

    def cases(self, name: str) -> Callable[[G], G]:
        """Return a decorator that adds a property with a statement; the decorated function returns its cases."""

        def declare(function: G) -> G:
            self._cases[name] = lambda *_: function()
            return function

        return declare

    def each(self, name: str, of: Callable[[int, int], Iterable[T]]) -> Callable[[F], F]:
        """Return a decorator that adds a property; the decorated function returns whether it holds for one object.

        The function `of` returns the objects, given the number of random ones and a seed.
        """

        def declare(function: F) -> F:
            self._cases[name] = lambda count, seed: (
                (str(thing), bool(function(thing))) for thing in of(count, seed)
            )
            return function

        return declare

    def __len__(self) -> int:
        return len(self._cases)

    def rows(self, count: int, seed: int) -> Iterator[CheckRow]:
        """Yield a row for each property; properties with random cases get `count` of them from a seed."""
        for name, cases_of in self._cases.items():
            yield check_row(name, cases_of(count, seed))


def check_row(check: str, cases: Iterable[Case]) -> CheckRow:
    """Return the row of a property from its cases; without a case, it does not hold.

    The example is the first case that does not hold, otherwise the first one.
    """
    tried = list(cases) or [(NOTHING, False)]
    failed = [text for text, held in tried if not held]
    example = failed[0] if failed else tried[0][0]
    return CheckRow(check=check, checked=len(tried), held=len(tried) - len(failed), example=example)


def facts_row(check: str, facts: Mapping[str, bool]) -> CheckRow:
    """Return the row of a property from facts; the example names those that do not hold, otherwise all."""
    wrong = [fact for fact, held in facts.items() if not held]
    example = ", ".join(wrong or facts)
    return CheckRow(check=check, checked=len(facts), held=len(facts) - len(wrong), example=example)
