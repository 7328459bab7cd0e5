"""Rules as data: each finds where it is broken; the table beside says what follows from it and what to do.

One table serves any kind of file: what a rule is asked about and how it names a place are its own.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Generic, NamedTuple, TypeVar

from sfglab.fleet.lint import Finding, Severity

if TYPE_CHECKING:
    from sfglab.documents import Place


Asked = TypeVar("Asked")
Where = TypeVar("Where")


class Broken(NamedTuple, Generic[Where]):
    """One place where a rule is broken."""

    where: Where  #: The place, as a key path or a line.
    what: str  #: What stands there.
    remedy: str = ""  #: What to do; empty: what the rule says.


Find = Callable[[Asked], Iterable[Broken[Where]]]


@dataclass(frozen=True, slots=True)
class Rule(Generic[Asked, Where]):
    """One rule."""

    code: str  #: Its short stable name.
    why: str  #: What follows where it is broken.
    find: Find[Asked, Where]  #: Yields where it is broken.
    remedy: str = ""  #: What to do.
    severity: Severity = Severity.ERROR  #: How bad that is.


class Rules(Generic[Asked, Where]):
    """A table of rules, each declared at the function that finds where it is broken."""

    def __init__(self) -> None:
        self.rules: list[Rule[Asked, Where]] = []

    def add(
        self, code: str, why: str, remedy: str = "", severity: Severity = Severity.ERROR
    ) -> Callable[[Find[Asked, Where]], Find[Asked, Where]]:
        """Return a decorator that adds a rule; see `Rule`."""

        def added(find: Find[Asked, Where]) -> Find[Asked, Where]:
            self.rules.append(Rule(code, why, find, remedy, severity))
            return find

        return added

    def broken(self, asked: Asked, place: Callable[[Where], Place]) -> Iterator[Finding]:
        """Yield a finding for each place where a rule is broken, which `place` turns into one of a file."""
        for rule in self.rules:
            for where, what, remedy in rule.find(asked):
                yield Finding(
                    severity=rule.severity,
                    code=rule.code,
                    place=place(where),
                    what=what,
                    why=rule.why,
                    remedy=remedy or rule.remedy,
                )


def worst_first(findings: Iterable[Finding]) -> tuple[Finding, ...]:
    """Return findings by their severity, else in their order."""
    order = list(Severity)
    return tuple(sorted(findings, key=lambda finding: order.index(finding.severity)))


def has_errors(findings: Iterable[Finding]) -> bool:
    """Tell whether a finding is an error."""
    return any(finding.severity is Severity.ERROR for finding in findings)


def error_sentences(findings: Iterable[Finding]) -> Iterator[str]:
    """Yield each error in one sentence, with its key or line."""
    for finding in findings:
        if finding.severity is Severity.ERROR:
            line = f"line {finding.place.line}" if finding.place.line else ""
            yield f"{finding.place.key or line}: {finding.what}".removeprefix(": ")
