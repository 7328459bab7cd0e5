"""Claims of the papers (``data/claims.yaml``), the verdicts on our values, and the ledger as text."""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import (
    Mapping,  # noqa: TC003 - a document's fields are typed at run time
)
from dataclasses import dataclass, field, replace
from enum import Enum
from html import escape
from statistics import median
from typing import TYPE_CHECKING, Annotated, Any, Literal

from sfglab.documents import OR_NULL, Document
from sfglab.errors import InvalidValueError
from sfglab.fields import to_json
from sfglab.lab.stats import Estimate, rounded
from sfglab.tables import Shown, columns, html_table

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence
    from pathlib import Path

COMMITTED_LOGS = "data/reference/"  #: Folder of the committed logs, from the top folder.
COLUMNS: tuple[str, ...] = (
    "claim",
    "paper",
    "sfglab",
    "interval",
    "unit",
    "how",
    "verdict",
)
"""Names of the columns of a ledger."""
_HTML_COLUMNS = ("claim", "statement", "paper", "accepted", *COLUMNS[2:])
VARIANT = "-OURS"  #: End of the id of a claim that judges a sfglab variant.
_LESS = "% less "
_MORE = "% more "
_START_TIME = re.compile(r"(\d{4})(\d\d)(\d\d)T(\d\d)(\d\d)\d\d-")


class How(Enum):
    """Origin of a value: measurement, simulation or computation."""

    LIVE = "live"
    SIMULATED = "simulated"
    RTL = "rtl"
    EXACT = "exact"

    @property
    def shown(self) -> str:
        """Word for texts. Logs have the value: *exact* for computed values."""
        return "computed" if self is How.EXACT else self.value


class Verdict(Enum):
    """Result of comparing our value with the claim of the paper."""

    REPRODUCED = "reproduced"
    BETTER = "better"
    #: The sfglab variant is in the acceptance range. It is another method, so it cannot reproduce the
    #: claim.
    AS_GOOD = "as good"
    #: The value is in the acceptance range, but depends on constants that were fitted to the same numbers.
    FITTED = "fitted"
    #: The verdict differs between runs or between conditions that the paper leaves open, or a part is
    #: missing.
    UNDECIDED = "undecided"
    DEVIATES = "deviates"
    NOT_YET = "not yet"


_MEANINGS = {
    Verdict.REPRODUCED: "the value and the claim's other values are accepted; an interval may reach further.",
    Verdict.BETTER: "the whole interval is beyond the acceptance range, on the side that counts as better.",
    Verdict.AS_GOOD: "the value of the sfglab variant, which is another method, is accepted.",
    Verdict.FITTED: "the value is accepted, but constants were fitted to the same numbers.",
    Verdict.UNDECIDED: "runs, or conditions that the paper leaves open, have different verdicts, or a part "
    "was not measured.",
    Verdict.DEVIATES: "the value, or another value that the reason names, is not accepted; it may be "
    "better than the paper's.",
    Verdict.NOT_YET: "no run has measured it.",
}
_FAVOURABLE = (Verdict.REPRODUCED, Verdict.BETTER, Verdict.AS_GOOD)


@dataclass(frozen=True, slots=True, kw_only=True)
class Criterion:
    """The rule that judges a claim, written down before the runs that it judges."""

    sentence: str  #: Sentence of the paper that the rule is derived from.
    #: Presets of `sfglab.rtps` for the paper's middleware. The lowest value judges.
    modes: tuple[str, ...]
    #: Smallest and largest value of each condition, bounds included.
    region: Mapping[str, tuple[float, float]]
    #: Quantity computed in each condition, and the rule by which the claim holds there.
    measure: str
    unit: str  #: Unit of the value.
    #: Acceptance range: lowest and highest value that count as reproduced.
    band: tuple[float, float]
    experiment: str  #: Name of the experiment whose runs it judges.


@dataclass(frozen=True, slots=True, kw_only=True)
class Claim(Shown):
    """One claim of a paper, as ``data/claims.yaml`` states it.

    Raises:
        InvalidValueError: The lower end of a range is above its upper end.
    """

    id: str  #: Short, stable name. It ends in ``-OURS`` if the claim judges the sfglab variant.
    where: str  #: Paper and section.
    says: str  #: Statement of the paper.
    #: The paper's value in `unit`; null if the statement is not a number.
    paper: Annotated[int | float | None, OR_NULL]
    #: Further numbers that the paper states, by name, for figures and details; no verdict uses them.
    numbers: Mapping[str, float] = field(default_factory=dict)
    unit: str  #: Unit of the paper's value and of ours.
    #: Acceptance range: lowest and highest value that count as reproduced.
    band: tuple[float, float]
    #: Side of the range on which a value is better.
    better: Literal["above", "below"] | None = None
    #: Acceptance ranges of the statement's other values, such as the other end of a range, by name.
    ends: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    #: Name of the experiment that measures it; null if there is none yet.
    experiment: Annotated[str | None, OR_NULL]
    #: Rule for runs with the paper's own middleware. Other runs are judged by `band`.
    criterion: Criterion | None = None

    def __post_init__(self) -> None:
        for name, (low, high) in {"band": self.band, **self.ends}.items():
            if low > high:
                raise InvalidValueError(name, [low, high], "[low, high] with low <= high")


@dataclass(frozen=True, slots=True, kw_only=True)
class Finding:
    """Our value for one claim, computed from a run."""

    #: Median or fitted value with its 95 % interval; NaN if the log lacks it.
    estimate: Estimate
    details: Mapping[str, str] = field(default_factory=dict)  #: Further values, as text by name.
    reason: str = ""  #: Reason for a difference from the paper, if known.
    #: Values of the claim's `ends` that were measured.
    ends: Mapping[str, float] = field(default_factory=dict)
    #: Alternatives: the value under other conditions that the paper leaves open, by condition.
    under: Mapping[str, Estimate] = field(default_factory=dict)
    count: str = ""  #: Number of facts behind a share, as ``6 facts``; empty: it is no such share.
    fitted: str = ""  #: Constants that were fitted to the claim's own numbers; empty: none.
    #: Whether the claim's criterion judges the value, instead of its `band`.
    by_criterion: bool = False
    how: How = How.LIVE  #: Origin of the value; `Experiment.measure` fills it in.
    also: How | None = None  #: Origin of other checks that the value covers, filled in like `how`.

    @property
    def origins(self) -> str:
        """Words for the origins of the value."""
        if self.also in (None, self.how):
            return self.how.shown
        return f"{self.how.shown} and {self.also.shown}"


@dataclass(frozen=True, slots=True, kw_only=True)
class Entry:
    """A row of the ledger: a claim, our value if there is one, the verdict, and its log."""

    claim: Claim  #: The claim, with acceptance range, unit and experiment of the judging rule.
    verdict: Verdict
    measured: Finding | None = None
    log: str = ""  #: Path of the log, from the top folder.
    origin: str = ""  #: Machine, load, versions and commit of the log.
    missing: str = ""  #: Reason why there is no value, if the log has one.
    figures: tuple[str, ...] = ()  #: Names of the committed figures of the experiment.
    #: The claim by each of several runs at different times.
    runs: tuple[Entry, ...] = ()
    #: Side of the range on which the sfglab variant of this claim is better, which the claim on the
    #: paper's method does not say; None if there is no variant.
    variant_better: str | None = None
    own: Entry | None = None  #: The claim by one run alone, in the ledger of that run.
    own_reason: str = ""  #: Reason why this run differs from the ledger; empty: it does not.

    @property
    def reason(self) -> str:
        """Reasons for an unfavourable verdict, if known."""
        measured = self.measured
        if measured is None:
            return self.missing
        if self.verdict in _FAVOURABLE:
            return ""
        if self.verdict is Verdict.FITTED:
            return measured.fitted
        reasons = [measured.reason, *self.failing_ends]
        reasons += [f"{name}: not measured" for name in self.missing_ends]
        for name, estimate in measured.under.items():
            reasons.append(f"{name}: {estimate}, {_compare(self.claim, estimate).value}")
        if len({run.verdict for run in self.runs}) > 1:
            reasons += [f"{run.log}: {run.value}, {run.verdict.value}" for run in self.runs]
        return "; ".join(filter(None, reasons))

    @property
    def direction(self) -> str:
        """Whether a deviation means a smaller cost or a larger gain than the paper's.

        It is ``favourable``, ``unfavourable``, ``mixed`` if values deviate to both sides, or empty if the
        claim does not deviate.
        """
        measured = self.measured
        if measured is None or self.verdict is not Verdict.DEVIATES:
            return ""
        better = self.claim.better or self.variant_better
        values = [(measured.estimate.value, self.claim.band)]
        values += [(measured.ends[n], self.claim.ends[n]) for n in _outside(self.claim, measured)]
        sides = {value > high for value, (low, high) in values if not low <= value <= high}
        if len(sides) > 1:
            return "mixed"
        return "favourable" if better and sides == {better == "above"} else "unfavourable"

    @property
    def failing_ends(self) -> list[str]:
        """Measured `ends` of the claim that are not accepted, each with its value and its range."""
        measured = self.measured
        if measured is None:
            return []
        lines = []
        for name in _outside(self.claim, measured):
            accepted_range = _range(self.claim.ends[name])
            lines.append(f"{name}: {measured.ends[name]:.3g} (accepted: {accepted_range})")
        return lines

    @property
    def missing_ends(self) -> list[str]:
        """Names of the claim's `ends` that were not measured."""
        ends = self.measured.ends if self.measured else {}
        return [name for name in self.claim.ends if name not in ends]

    @property
    def source(self) -> str:
        """Origin of the value in words: the committed logs, or the user's run with its time."""
        if self.log.startswith(COMMITTED_LOGS):
            return "the committed logs"
        start = _START_TIME.search(self.log)
        return start.expand(r"your run of \1-\2-\3 \4:\5 UTC") if start else self.log

    @property
    def shown(self) -> Estimate | None:
        """Value as the ledger prints it: a negative saving ("% less") is a cost ("% more")."""
        if self.measured is None:
            return None
        found = replace(self.measured.estimate, unit=self.claim.unit)
        if found.value >= 0 or not found.unit.startswith(_LESS):
            return found
        unit = _MORE + found.unit.removeprefix(_LESS)
        return Estimate(value=-found.value, low=-found.high, high=-found.low, unit=unit)

    @property
    def value(self) -> str:
        """Value with its interval as text, in `unit`; empty: not measured."""
        shown = self.shown
        if shown is None:
            return ""
        value = rounded(shown.value)
        return f"{value} [{rounded(shown.low)}, {rounded(shown.high)}]" if self.interval else value

    @property
    def unit(self) -> str:
        """Unit of `value`, with the number of facts behind a share."""
        unit = self.shown.unit if self.shown else self.claim.unit
        count = self.measured.count if self.measured else ""
        return f"{unit} ({count})" if count else unit

    @property
    def interval(self) -> str:
        """Kind of the value and its interval: median of several runs, one run, or no interval."""
        shown = self.shown
        if shown is None or shown.low == shown.high:
            return ""
        return f"median of {len(self.runs)} runs" if self.runs else "95 % interval"

    def __repr__(self) -> str:
        return f"<{self.claim.id}, {self.verdict.value}: {_comparison(self)}>"

    def _repr_html_(self) -> str:
        return Ledger([self])._repr_html_()

    def as_json(self) -> dict[str, Any]:
        """Return the row as JSON values. Without a value, numbers are null."""
        claim = self.claim
        found = to_json(self.measured) or {}
        estimate = found.get("estimate", {})
        alternatives = self.measured.under if self.measured else {}
        return {
            "id": claim.id,
            "where": claim.where,
            "says": claim.says,
            "paper": claim.paper,
            "value": estimate.get("value"),
            "low": estimate.get("low"),
            "high": estimate.get("high"),
            "unit": claim.unit,
            "how": found.get("how"),
            "also": found.get("also"),
            "verdict": self.verdict.value,
            "reason": self.reason,
            "ends": found.get("ends", {}),
            "under": {name: str(alternative) for name, alternative in alternatives.items()},
            "details": found.get("details", {}),
            "interval": self.interval or None,
            "source": self.source or None,
            "log": self.log or None,
            "origin": self.origin or None,
            "figures": list(self.figures),
            "runs": [run.as_json() for run in self.runs],
        }


class Ledger(list[Entry]):
    """List of judged claims, as a notebook or the ledger page shows it."""

    @property
    def source(self) -> str:
        """Origins of all values, each once, joined by "and"."""
        sources = dict.fromkeys(entry.source for entry in self if entry.source)
        return " and ".join(sources)

    def __repr__(self) -> str:
        counts = Counter(entry.verdict for entry in self)
        verdicts = [f"{counts[each]} {each.value}" for each in Verdict if counts[each]]
        origin = f" from {self.source}" if self.source else ""
        return f"<ledger{origin}: {', '.join(verdicts) or 'empty'}>"

    def _repr_html_(self) -> str:
        rows = [_HTML_COLUMNS]
        reasons: dict[str, list[str]] = {}
        for entry in self:
            claim, *cells = _row(entry)
            rows.append((claim, entry.claim.says, cells[0], accepted(entry.claim), *cells[1:]))
            if entry.own and entry.own_reason:
                rows.append(("", "in this run alone", "", "", *_row(entry.own)[2:]))
                reasons.setdefault(entry.own_reason, []).append(claim)
        notes = [f"In this run alone ({', '.join(of)}): {why}." for why, of in reasons.items()]
        notes += self.legend()
        lines = "<br>".join(escape(note) for note in notes)
        return f"{html_table(rows, repr(self)[1:-1])}<p>{lines}</p>"

    def legend(self) -> list[str]:
        """Return the meanings of the verdicts and intervals of these entries, one line each."""
        shown = [*self, *(entry.own for entry in self if entry.own)]
        verdicts = {entry.verdict for entry in shown}
        lines = [f"{each.value}: {_MEANINGS[each]}" for each in Verdict if each in verdicts]
        if any(entry.runs and entry.interval for entry in self):
            lines.append(
                "Median of several runs: the bracket reaches from the lowest lower to the highest upper limit of the "
                "runs' 95 % intervals."
            )
        return lines


def load_claims(path: Path | str) -> list[Claim]:
    """Read and check ``data/claims.yaml``.

    Raises:
        DocumentError: The file is wrong; names the place and the allowed values.
    """
    document = Document.of_file(path)
    claims: list[Claim] = document.read(list[Claim])
    ids = set()
    for position, claim in enumerate(claims):
        if claim.id in ids:
            raise document.refusal((position, "id"), claim.id, "each claim once")
        ids.add(claim.id)
        if claim.where[:1] not in {"A", "B", "C"}:
            raise document.refusal(
                (position, "where"), claim.where, "paper A, B or C and its section, such as 'A 4.3'"
            )
    return claims


def judge(claim: Claim, measured: Finding | None) -> Verdict:
    """Compute the verdict on a claim, with the only rule of the ledger.

    A value is better if its whole interval is beyond the acceptance range, on the better side.
    It is reproduced (the sfglab variant: as good) if it is in the range. In both cases all `ends`
    must be in their ranges. A claim is undecided if an end is missing, or if the verdict differs
    under conditions that the paper leaves open.
    """
    if measured is None:
        return Verdict.NOT_YET
    found = {_compare(claim, measured.estimate)}
    found.update(_compare(claim, estimate) for estimate in measured.under.values())
    if found == {Verdict.DEVIATES} or _outside(claim, measured):
        return Verdict.DEVIATES
    if len(found) > 1 or claim.ends.keys() - measured.ends.keys():
        return Verdict.UNDECIDED
    return Verdict.FITTED if measured.fitted else found.pop()


def _compare(claim: Claim, estimate: Estimate) -> Verdict:
    """Return the verdict on a value alone."""
    low, high = claim.band
    if claim.better == "above":
        if estimate.low > high:
            return Verdict.BETTER
        high = math.inf
    if claim.better == "below":
        if estimate.high < low:
            return Verdict.BETTER
        low = -math.inf
    if not low <= estimate.value <= high:
        return Verdict.DEVIATES
    return Verdict.AS_GOOD if claim.id.endswith(VARIANT) else Verdict.REPRODUCED


def _outside(claim: Claim, measured: Finding) -> list[str]:
    """Return the names of the measured ends that are outside their ranges."""
    return [
        name
        for name, (low, high) in claim.ends.items()
        if name in measured.ends and not low <= measured.ends[name] <= high
    ]


def entry_for(claim: Claim, measured: Finding | None, *, log: str = "", origin: str = "") -> Entry:
    """Return the row for a claim and our value, judged by `band` or by the claim's criterion."""
    if measured is None:
        return Entry(claim=claim, verdict=Verdict.NOT_YET)
    if math.isnan(measured.estimate.value):
        return Entry(claim=claim, verdict=Verdict.NOT_YET, missing=measured.reason)
    rule = claim.criterion
    if rule and measured.by_criterion:
        claim = replace(claim, band=rule.band, unit=rule.unit, experiment=rule.experiment)
    verdict = judge(claim, measured)
    return Entry(claim=claim, verdict=verdict, measured=measured, log=log, origin=origin)


def joined(runs: Sequence[Entry]) -> Entry:
    """Return one row for a claim's runs at different times, based on the first.

    The value is the median over the runs, and the interval covers theirs, because an interval
    over the repetitions of one run does not contain the differences between runs. If verdicts
    differ, the claim is undecided. Later runs without the value or one of its ends are left out,
    because they are older than this part of the claim.
    """
    first, *others = runs
    runs = [first, *(run for run in others if run.measured and not run.missing_ends)]
    found = [run.measured.estimate for run in runs if run.measured]
    if first.measured is None or len(found) == 1:
        return first
    estimate = replace(
        found[0],
        value=median(each.value for each in found),
        low=min(each.low for each in found),
        high=max(each.high for each in found),
    )
    verdicts = {run.verdict for run in runs}
    return replace(
        first,
        verdict=first.verdict if len(verdicts) == 1 else Verdict.UNDECIDED,
        measured=replace(first.measured, estimate=estimate),
        runs=tuple(runs),
    )


def render(entries: Sequence[Entry], *, with_logs: bool = False) -> str:
    """Return the ledger as a table for a terminal.

    Below a claim in the ledger of a run is the claim by this run. The last column is the origin,
    if there are several; with `with_logs` it is the log.
    """
    rows = [(*COLUMNS, "log" if with_logs else "from")]
    for entry in entries:
        rows.append((*_row(entry), entry.log if with_logs else entry.source))
        if entry.own:
            rows.append(("  this run", *_row(entry.own)[1:], entry.own.source))
    origins = {row[-1] for row in rows[1:]} - {""}
    lines = columns(rows if len(origins) > 1 else [row[:-1] for row in rows])
    lines.insert(1, "-" * len(lines[0]))
    lines += ["", repr(Ledger(entries))[1:-1]]
    return "\n".join(lines)


def render_in_full(entries: Iterable[Entry]) -> str:
    """Return a paragraph for each claim: statement, verdict, reason, further values and origin."""
    return "\n\n".join("\n  ".join(_paragraph(entry)) for entry in entries)


def _paragraph(entry: Entry) -> list[str]:
    claim = entry.claim
    measured = entry.measured
    how = f", {measured.origins}" if measured else ""
    interval = f" ({entry.interval})" if entry.interval else ""
    lines = [
        f"{claim.id}: {entry.verdict.value}{how}",
        f"{claim.where}: {claim.says}",
        f"{_comparison(entry)}{interval}; acceptance range {_range(claim.band)}",
    ]
    parts: dict[str, object] = {"figures": ", ".join(entry.figures), "why": entry.reason}
    for run in entry.runs:
        parts[f"run {run.log}"] = f"{run.value}, {run.verdict.value}; {run.origin}"
    if measured:
        for name, value in measured.ends.items():
            parts[name] = f"{value:.3g}"
            if name in claim.ends:
                parts[name] = f"{value:.3g}; acceptance range {_range(claim.ends[name])}"
        parts |= {**measured.under, **measured.details}
        parts["log"] = f"{entry.log}; {entry.origin}"
    return lines + [f"{name}: {part}" for name, part in parts.items() if part]


def criterion_of(entry: Entry) -> list[str]:
    """Return the rules that judge a claim, one line each: its range with the quantity, and its ends."""
    claim = entry.claim
    rule = claim.criterion
    by_criterion = entry.measured is not None and entry.measured.by_criterion
    quantity = rule.measure if rule and by_criterion else claim.unit
    rules = {quantity: claim.band, **claim.ends}
    return [f"{_range(band)}: {name}" for name, band in rules.items()]


def _row(entry: Entry) -> tuple[str, ...]:
    """Return the cells of `COLUMNS` for an entry."""
    return (
        entry.claim.id,
        stated(entry.claim),
        entry.value,
        entry.interval,
        entry.unit,
        entry.measured.origins if entry.measured else "",
        entry.verdict.value,
    )


def stated(claim: Claim) -> str:
    """Return the paper's value as text, or "no number" if the claim has none."""
    return "no number" if claim.paper is None else f"{claim.paper:g}"


def accepted(claim: Claim) -> str:
    """Return the values that are accepted, and those that are better."""
    low, high = claim.band
    if claim.better == "above":
        return f"at least {low:g}; better: above {high:g}"
    if claim.better == "below":
        return f"at most {high:g}; better: below {low:g}"
    return f"{low:g}" if low == high else _range(claim.band)


def _comparison(entry: Entry) -> str:
    paper = "without a number" if entry.claim.paper is None else f"{entry.claim.paper:g}"
    return f"paper {paper}, sfglab {entry.value or 'no value'} {entry.unit}"


def _range(band: tuple[float, float]) -> str:
    return f"{band[0]:g} to {band[1]:g}"
