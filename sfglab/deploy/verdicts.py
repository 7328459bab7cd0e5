"""Verdicts of checks, as a table for a terminal, and rules as data, which find where they are broken."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from enum import Enum
from textwrap import TextWrapper
from typing import TYPE_CHECKING, Any, Generic, NamedTuple, TypeVar

from sfglab.deploy.errors import MissingProgramError
from sfglab.errors import SfglabError
from sfglab.fleet.lint import Finding, Severity
from sfglab.tables import columns

if TYPE_CHECKING:
    from sfglab.documents import Place

# Names such as dds-router stay whole, so that they can be searched for.
_WORDS = TextWrapper(110, initial_indent=" " * 4, subsequent_indent=" " * 4, break_on_hyphens=False)


class State(Enum):
    """What became of a check, the worst first."""

    FAILS = "fails"
    SKIPPED = "skipped"
    HOLDS = "holds"


@dataclass(frozen=True, slots=True, kw_only=True)
class Verdict:
    """What one check says of one subject."""

    check: str  #: What was asked.
    subject: str  #: Of what, a file of the folder.
    state: State  #: What became of it.
    says: str = ""  #: What is wrong, or what is missing to ask; mostly empty where it holds.


def verdict_of(check: str, subject: str, ask: Callable[..., Iterable[str]], *about: Any) -> Verdict:
    """Return the verdict of a check about a subject.

    `ask`, called with `about`, yields one sentence for each thing that is wrong; it raises
    `MissingProgramError` when it cannot be asked, and another error of ours when that is what is wrong.
    """
    try:
        wrong = tuple(ask(*about))
    except MissingProgramError as error:
        return Verdict(check=check, subject=subject, state=State.SKIPPED, says=str(error))
    except SfglabError as error:
        wrong = (str(error),)
    state = State.FAILS if wrong else State.HOLDS
    return Verdict(check=check, subject=subject, state=state, says="; ".join(wrong))


def render_verdicts(verdicts: Iterable[Verdict], *, every: bool = True) -> str:
    """Return verdicts as a table, the failing first, and their numbers; `every` lists what holds too."""
    order = list(State)
    verdicts = tuple(verdicts)
    shown = (verdict for verdict in verdicts if every or verdict.state is not State.HOLDS)
    rows = sorted(shown, key=lambda verdict: order.index(verdict.state))
    lines: list[str] = []
    for row, line in zip(
        rows, columns((r.state.value, r.subject, r.check) for r in rows), strict=True
    ):
        lines += [line, *_WORDS.wrap(row.says)]
    count = Counter(verdict.state for verdict in verdicts)
    lines.append(
        f"{count[State.HOLDS]} held, {count[State.FAILS]} failed, {count[State.SKIPPED]} skipped"
    )
    return "\n".join(lines)


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


def error_sentences(findings: Iterable[Finding]) -> Iterator[str]:
    """Yield each error in one sentence, with its key or line."""
    for finding in findings:
        if finding.severity is Severity.ERROR:
            line = f"line {finding.place.line}" if finding.place.line else ""
            yield f"{finding.place.key or line}: {finding.what}".removeprefix(": ")
