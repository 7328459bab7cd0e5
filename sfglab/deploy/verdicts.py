"""Verdicts of checks: one about one subject, and all of them as a table for a terminal."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from enum import Enum
from textwrap import TextWrapper
from typing import TYPE_CHECKING, Any

from sfglab.deploy.errors import MissingProgramError
from sfglab.errors import SfglabError
from sfglab.tables import columns

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable


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
    """Return verdicts as a table, the failing first with their words, and how many there are of each.

    With `every`, what holds is listed as well; it is counted anyway.
    """
    order = list(State)
    verdicts = tuple(verdicts)
    shown = (verdict for verdict in verdicts if every or verdict.state is not State.HOLDS)
    rows = sorted(shown, key=lambda verdict: order.index(verdict.state))
    lines: list[str] = []
    for row, line in zip(rows, columns((r.state.value, r.subject, r.check) for r in rows), strict=True):
        lines += [line, *_WORDS.wrap(row.says)]
    count = Counter(verdict.state for verdict in verdicts)
    lines.append(f"{count[State.HOLDS]} held, {count[State.FAILS]} failed, {count[State.SKIPPED]} skipped")
    return "\n".join(lines)
