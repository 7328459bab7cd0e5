"""The ledger: every claim of the papers (``data/claims.yaml``), our figure from logs, a computed verdict."""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import (
    Mapping,  # noqa: TC003 - a document's fields are typed at run time
)
from dataclasses import dataclass, field, replace
from enum import Enum
from statistics import median
from typing import TYPE_CHECKING, Annotated, Any, Literal

from sfglab.documents import OR_NULL, Document
from sfglab.errors import InvalidValueError
from sfglab.lab.stats import Estimate, rounded
from sfglab.tables import Shown, columns, html_table, text_table

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from pathlib import Path


class How(Enum):
    """How a figure was obtained."""

    LIVE = "live"
    SIMULATED = "simulated"
    RTL = "rtl"
    EXACT = "exact"


OURS = "-OURS"
COMMITTED_LOGS = "data/reference/"  #: Folder of the committed logs, from the top folder.
_STARTED = re.compile(r"(\d{4})(\d\d)(\d\d)T(\d\d)(\d\d)\d\d-")
_LESS = "% less "
_MORE = "% more "


class Verdict(Enum):
    """What our figure says of the paper's claim."""

    REPRODUCED = "reproduced"
    BETTER = "better"
    #: Our way is as good as the paper says of its own, which another way cannot reproduce.
    AS_GOOD = "as good"
    #: By constants that were fitted to the paper's own figures, which predicts nothing.
    FITTED = "fitted"
    #: By what the paper leaves open or runs differ in, or a part was not measured.
    UNDECIDED = "undecided"
    DEVIATES = "deviates"
    NOT_YET = "not yet"


HOLDS = frozenset({Verdict.REPRODUCED, Verdict.BETTER, Verdict.AS_GOOD})
"""Verdicts of what the paper says and we find."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Criterion:
    """By what a claim is judged, written down before the runs that it judges exist."""

    sentence: str  #: The paper's own words that it comes from.
    #: Presets of `sfglab.rtps` for the paper's middleware; the lowest figure judges.
    modes: tuple[str, ...]
    #: Least and largest value of each condition, bounds included.
    region: Mapping[str, tuple[float, float]]
    measure: str  #: What is computed in each condition, and of it when the claim holds there.
    unit: str  #: Of the figure.
    band: tuple[float, float]  #: Lowest and highest figure that counts as reproduced.
    experiment: str  #: Name of the experiment whose runs it judges.


@dataclass(frozen=True, slots=True, kw_only=True)
class Claim(Shown):
    """One claim of a paper, as ``data/claims.yaml`` states it."""

    id: str  #: Short, stable name; with `OURS` at its end where it judges our way.
    where: str  #: Paper and place.
    says: str  #: The statement.
    #: The paper's figure in `unit`; None where the statement is not a number.
    paper: Annotated[int | float | None, OR_NULL]
    #: Further numbers that the paper states, by name, for figures and details; no verdict uses them.
    numbers: Mapping[str, float] = field(default_factory=dict)
    unit: str  #: Unit of the paper's figure and of ours.
    band: tuple[float, float]  #: Lowest and highest figure that counts as reproduced.
    better: Literal["above", "below"] | None = None  #: The band's end beyond which ours is better.
    #: The statement's other figures, such as a range's other end: what each is, and its band.
    ends: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    #: Name of the experiment that measures it; None: there is none yet.
    experiment: Annotated[str | None, OR_NULL]
    #: Judges runs on the paper's own middleware; until then `band` does.
    criterion: Criterion | None = None

    def __post_init__(self) -> None:
        for name, (low, high) in {"band": self.band, **self.ends}.items():
            if low > high:
                raise InvalidValueError(name, [low, high], "[low, high]")


@dataclass(frozen=True, slots=True, kw_only=True)
class Finding:
    """Our figure for one claim, computed from a run."""

    #: Median or fitted value with its 95 % interval; NaN where the log lacks it.
    estimate: Estimate
    details: Mapping[str, str] = field(default_factory=dict)  #: Further figures, as text by name.
    reason: str = ""  #: Why it deviates from the paper's, where that is known.
    #: Of the claim's `ends`, those that were measured.
    ends: Mapping[str, float] = field(default_factory=dict)
    #: The same figure under other conditions that the paper leaves open, or in other runs, by what they are.
    under: Mapping[str, Estimate] = field(default_factory=dict)
    fitted: str = ""  #: What was fitted to the claim's own figures; empty: nothing.
    by_criterion: bool = False  #: Whether the claim's criterion judges it, and not its band.


@dataclass(frozen=True, slots=True, kw_only=True)
class Measured(Finding):
    """A finding with how it was obtained."""

    how: How

    def beside(self, other: Measured, log: str) -> Measured:
        """Return it with the figure of another experiment, from this log, among its details."""
        return replace(
            self, details={**self.details, "by the band of other runs": f"{other.estimate} ({log})"}
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class Entry:
    """A line of the ledger: a claim, our figure if there is one, the verdict, and the log behind it."""

    claim: Claim
    verdict: Verdict
    measured: Measured | None = None
    log: str = ""
    origin: str = ""  #: Machine, load, versions and commit of the log.
    missing: str = ""  #: Why there is no figure, as far as a log says.
    figures: tuple[str, ...] = ()  #: Names of the committed figures of its experiment.
    #: The claim by each of several runs at different times, judged for itself.
    runs: tuple[Entry, ...] = ()

    @property
    def experiment(self) -> str | None:
        """Name of the experiment whose figure it is; without a figure, of that which measures it."""
        claim, by_criterion = self.claim, self.measured is not None and self.measured.by_criterion
        return claim.criterion.experiment if claim.criterion and by_criterion else claim.experiment

    @property
    def reason(self) -> str:
        """Why the verdict is none that holds, as far as that is known."""
        m, c = self.measured, self.claim
        if m is None:
            return self.missing
        if self.verdict in HOLDS:
            return ""
        if self.verdict is Verdict.FITTED:
            return m.fitted
        open_ = (
            [f"{name}: {e}, {_in_band(c, e).value}" for name, e in m.under.items()]
            if m.under
            else []
        )
        missing = [f"{name}: not measured" for name in c.ends if name not in m.ends]
        disagree = self.runs if len({run.verdict for run in self.runs}) > 1 else ()
        runs = [f"{run.log}: {run.value}, {run.verdict.value}" for run in disagree]
        return "; ".join(filter(None, [m.reason, *_wrong_ends(c, m), *missing, *open_, *runs]))

    @property
    def source(self) -> str:
        """Origin of the value in words: the committed logs, or the user's run with its time."""
        started = _STARTED.search(self.log)
        if self.log.startswith(COMMITTED_LOGS):
            return "the committed logs"
        if started is None:
            return self.log
        year, month, day, hour, minute = started.groups()
        return f"your run of {year}-{month}-{day} {hour}:{minute} UTC"

    @property
    def value(self) -> str:
        """Value with its interval as text, in `unit`; empty: not measured."""
        if self.measured is None:
            return ""
        estimate = self.measured.estimate
        numbers = [estimate.value, estimate.low, estimate.high]
        if self.unit.startswith(_MORE):
            numbers = [-estimate.value, -estimate.high, -estimate.low]
        value, low, high = map(rounded, numbers)
        return f"{value} [{low}, {high}]" if self.interval else value

    @property
    def unit(self) -> str:
        """Unit of `value`: the claim's, but "% more" where a saving is negative."""
        measured, unit = self.measured, self.claim.unit
        if unit.startswith(_LESS) and measured is not None and measured.estimate.value < 0:
            return unit.replace(_LESS, _MORE, 1)
        return unit

    @property
    def interval(self) -> str:
        """Kind of the interval: of one run, over several runs, or none."""
        if self.measured is None or self.measured.estimate.low == self.measured.estimate.high:
            return ""
        return f"range over {len(self.runs)} runs" if self.runs else "95 % interval"

    @property
    def is_whole(self) -> bool:
        """Whether the figure and all of the claim's ends were measured."""
        return self.measured is not None and self.claim.ends.keys() <= self.measured.ends.keys()

    def __repr__(self) -> str:
        return f"<{self.claim.id}, {self.verdict.value}: {_compared(self)}>"

    def _repr_html_(self) -> str:
        return Ledger([self])._repr_html_()

    def as_json(self) -> dict[str, Any]:
        """Return the line as JSON values; figures are null where nothing was measured."""
        m = self.measured
        estimate = m.estimate if m else None
        return {
            **{name: getattr(self.claim, name) for name in ("id", "where", "says", "paper")},
            **{name: getattr(estimate, name, None) for name in ("value", "low", "high")},
            "unit": self.claim.unit,
            "how": m.how.value if m else None,
            "verdict": self.verdict.value,
            "reason": self.reason,
            "ends": dict(m.ends) if m else {},
            "under": {name: str(estimate) for name, estimate in m.under.items()} if m else {},
            "details": dict(m.details) if m else {},
            "interval": self.interval or None,
            "source": self.source or None,
            "log": self.log or None,
            "origin": self.origin or None,
            "figures": list(self.figures),
            "runs": [run.as_json() for run in self.runs],
        }


class Ledger(list[Entry]):
    """All claims, judged."""

    @property
    def source(self) -> str:
        """Origin of the values in words; of several origins how many claims each has."""
        counts = Counter(entry.source for entry in self if entry.source)
        if len(counts) > 1:
            return " and ".join(f"{source} ({count})" for source, count in counts.items())
        return "".join(counts)

    def __repr__(self) -> str:
        counts = {v: sum(e.verdict is v for e in self) for v in Verdict}
        verdicts = ", ".join(f"{n} {v.value}" for v, n in counts.items() if n) or "empty"
        origin = f" from {self.source}" if self.source else ""
        return f"<ledger{origin}: {verdicts}>"

    def _repr_html_(self) -> str:
        head, *rows = _rows(self)
        words = [("where", "says"), *((e.claim.where, e.claim.says) for e in self)]
        table = [(row[0], *said, *row[1:]) for row, said in zip([head, *rows], words, strict=True)]
        return html_table(table, repr(self)[1:-1])


HEAD = ("claim", "paper", "sfglab", "interval", "unit", "how", "verdict", "from")
"""Names of the columns of a ledger."""


@dataclass(frozen=True, slots=True, kw_only=True)
class OwnEntry:
    """A claim as the ledger has it, and by one run where that differs."""

    ledger: Entry
    own: Entry | None = None  #: The claim by this run alone; None if the ledger has its value.
    reason: str = ""  #: Reason for the difference.


class OwnLedger(list[OwnEntry]):
    """The claims that a run answers: each as the ledger has it, and below it by this run."""

    def __repr__(self) -> str:
        return repr(Ledger(each.ledger for each in self))

    def _repr_html_(self) -> str:
        rows: list[tuple[str, ...]] = [HEAD]
        for each in self:
            rows.append(_row(each.ledger))
            if each.own is not None:
                rows.append((f"this run: {each.reason}", *_row(each.own)[1:]))
        return html_table(rows, repr(self)[1:-1])


def render_own(claims: OwnLedger) -> str:
    """Return the claims by a run as a table for a terminal, with the ledger's value beside them."""
    rows = [("claim", "paper", "this run", "interval", "unit", "verdict", "ledger", "from")]
    for each in claims:
        name, paper, value, interval, unit, _, verdict, _ = _row(each.own or each.ledger)
        ledger = f"{each.ledger.value or 'no value'}, {each.ledger.verdict.value}"
        if each.ledger.unit != unit:
            ledger = f"{each.ledger.value} {each.ledger.unit}, {each.ledger.verdict.value}"
        rows.append((name, paper, value, interval, unit, verdict, ledger, each.ledger.source))
    return text_table(rows)


def load_claims(path: Path | str) -> list[Claim]:
    """Read and check ``data/claims.yaml``; a `DocumentError` says where it is wrong and what is allowed."""
    claims: dict[str, Claim] = {}
    document = Document.of_file(path)
    for position, claim in enumerate(document.read(list[Claim])):
        if claim.id in claims:
            raise document.refusal((position, "id"), claim.id, "each claim once")
        claims[claim.id] = claim
    return list(claims.values())


def judge(claim: Claim, measured: Measured | None) -> Verdict:
    """Compute the verdict from our figures: the ledger's only rule.

    Better asks that the whole interval lies beyond the band's end, reproduced that the figure lies in the
    band, which is called as good where it is our way's; all ask that every one of the claim's ends lies in its
    own. Undecided is what was not measured whole, or gets another verdict under conditions that the paper
    leaves open, or in another run.
    """
    if measured is None:
        return Verdict.NOT_YET
    found = {_in_band(claim, e) for e in (measured.estimate, *measured.under.values())}
    if _wrong_ends(claim, measured) or found == {Verdict.DEVIATES}:
        return Verdict.DEVIATES
    if len(found) > 1 or claim.ends.keys() - measured.ends.keys():
        return Verdict.UNDECIDED
    return Verdict.FITTED if measured.fitted else found.pop()


def _wrong_ends(claim: Claim, measured: Measured) -> list[str]:
    """Return what is out of its band of the claim's ends."""
    return [
        f"{name}: {measured.ends[name]:.3g}, asked {low:g} to {high:g}"
        for name, (low, high) in claim.ends.items()
        if name in measured.ends and not low <= measured.ends[name] <= high
    ]


def _in_band(claim: Claim, estimate: Estimate) -> Verdict:
    (low, high), above, below = claim.band, claim.better == "above", claim.better == "below"
    if (above and estimate.low > high) or (below and estimate.high < low):
        return Verdict.BETTER
    beyond = (above and estimate.value > high) or (below and estimate.value < low)
    if beyond or low <= estimate.value <= high:
        return Verdict.AS_GOOD if claim.id.endswith(OURS) else Verdict.REPRODUCED
    return Verdict.DEVIATES


def render(entries: Sequence[Entry], *, with_logs: bool = False) -> str:
    """Return the ledger as a table for a terminal, a line a claim, or with its log a line a log."""
    rows = _rows(entries)
    if with_logs:
        rows = [
            (*row, log)
            for row, log in zip(rows, ["log", *(entry.log for entry in entries)], strict=True)
        ]
    lines = columns(rows)
    lines.insert(1, "-" * len(lines[0]))
    lines += ["", repr(Ledger(entries)).removeprefix("<").removesuffix(">")]
    return "\n".join(lines)


def _rows(entries: Sequence[Entry]) -> list[tuple[str, ...]]:
    """Return `HEAD` and a row for each entry; without the column "from" if all have one origin."""
    rows: list[tuple[str, ...]] = [HEAD, *map(_row, entries)]
    if len({entry.source for entry in entries if entry.source}) > 1:
        return rows
    return [row[:-1] for row in rows]


def _row(entry: Entry) -> tuple[str, ...]:
    """Return the cells of `HEAD` for an entry."""
    claim, measured = entry.claim, entry.measured
    paper = "" if claim.paper is None else f"{claim.paper:g}"
    value = entry.value, entry.interval, entry.unit
    how = measured.how.value if measured else ""
    return claim.id, paper, *value, how, entry.verdict.value, entry.source


def _compared(entry: Entry) -> str:
    paper = "without a number" if entry.claim.paper is None else f"{entry.claim.paper:g}"
    return f"paper {paper}, sfglab {entry.value or 'no value'} {entry.unit}"


def render_in_full(entries: Sequence[Entry]) -> str:
    """Return the ledger as paragraphs: of each claim statement, verdict and reason, further figures, origin."""
    return "\n\n".join("\n  ".join(_paragraph(entry)) for entry in entries)


def _paragraph(entry: Entry) -> Iterator[str]:
    how = f", {entry.measured.how.value}" if entry.measured else ""
    yield f"{entry.claim.id}: {entry.verdict.value}{how}"
    yield f"{entry.claim.where}: {entry.claim.says}"
    interval = f" ({entry.interval})" if entry.interval else ""
    yield f"{_compared(entry)}{interval}; acceptance range {_band(entry.claim.band)}"
    yield from [f"figures: {', '.join(entry.figures)}"] * bool(entry.figures)
    if entry.reason:
        yield f"why: {entry.reason}"
    m = entry.measured
    if m is None:
        return
    yield from (
        f"run {run.log}: {run.value}, {run.verdict.value}; {run.origin}" for run in entry.runs
    )
    asked = {name: f"; acceptance range {_band(b)}" for name, b in entry.claim.ends.items()}
    yield from (f"{name}: {value:.3g}{asked.get(name, '')}" for name, value in m.ends.items())
    yield from (f"{key}: {value}" for key, value in {**m.under, **m.details}.items())
    yield f"log: {entry.log}; {entry.origin}"


def criterion_of(claim: Claim) -> list[str]:
    """Return by what a claim is judged, a line each: its criterion, if it has one, its band and its ends."""
    first = (
        [f"{c.measure}: {_band(c.band)}; until there is such a run:"]
        if (c := claim.criterion)
        else []
    )
    return [
        *first,
        *(f"{what}: {_band(b)}" for what, b in {claim.unit: claim.band, **claim.ends}.items()),
    ]


def _band(band: tuple[float, float]) -> str:
    return f"{band[0]:g} to {band[1]:g}"


def entry_for(claim: Claim, measured: Measured | None, *, log: str = "", origin: str = "") -> Entry:
    """Join a claim with our figure and judge it, by the criterion's band where that gave the figure."""
    missing = ""
    if measured is not None and math.isnan(measured.estimate.value):
        missing, measured = measured.reason, None
    if measured is None:
        log = origin = ""
    elif measured.by_criterion and claim.criterion:
        claim = replace(claim, band=claim.criterion.band, unit=claim.criterion.unit)
    verdict = judge(claim, measured)
    return Entry(
        claim=claim, verdict=verdict, measured=measured, log=log, origin=origin, missing=missing
    )


def joined(runs: Sequence[Entry]) -> Entry:
    """Return one line of a ledger for a claim's runs at different times, the one that speaks first.

    What does not get the same verdict in all of them is undecided. The figure is their median, and the interval
    covers theirs: one over the repeats of a single run is not what a reader takes it for.
    """
    first, *others = runs
    # What was measured before a figure, or an end of it, was asked says nothing of it.
    runs = [first, *(run for run in others if run.is_whole)]
    found = [run.measured.estimate for run in runs if run.measured]
    if len(runs) == 1 or first.measured is None:
        return first
    low, high = min(e.low for e in found), max(e.high for e in found)
    estimate = replace(found[0], value=median(e.value for e in found), low=low, high=high)
    verdict = first.verdict if len({run.verdict for run in runs}) == 1 else Verdict.UNDECIDED
    measured = replace(first.measured, estimate=estimate)
    return replace(first, verdict=verdict, measured=measured, runs=tuple(runs))
