"""The ledger: every claim of the three papers beside our own figure and a computed verdict.

``data/claims.yaml`` holds the papers' side only. Our side is computed from logs each time it is asked for,
so that no figure and no verdict is ever typed or goes stale. Knows the ledger's form and the rule for
verdicts; refuses to know how a figure is measured: the experiments do.
"""

from __future__ import annotations

from collections.abc import Mapping  # noqa: TC003 - a document's fields are typed at run time
from dataclasses import dataclass, field
from enum import Enum
from typing import TYPE_CHECKING, Any, Literal

from sfglab.documents import OR_NULL, Document, Section, read_by
from sfglab.errors import InvalidValueError
from sfglab.tables import Shown, columns, html_table

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from sfglab.lab.stats import Estimate


class How(Enum):
    """How a figure was obtained."""

    LIVE = "live"
    SIMULATED = "simulated"
    RTL = "rtl"
    EXACT = "exact"


class Verdict(Enum):
    """What our figure says of the paper's claim."""

    REPRODUCED = "reproduced"
    BETTER = "better"
    DEVIATES = "deviates"
    NOT_YET = "not yet"


@dataclass(frozen=True, slots=True, kw_only=True)
class Criterion:
    """By what a claim is judged, written down before the runs that it judges exist."""

    sentence: str  #: The paper's own words that it comes from.
    #: Presets of `sfglab.rtps` that may stand for the paper's middleware; the lowest figure of them judges.
    modes: tuple[str, ...]
    region: Mapping[str, tuple[float, float]]  #: Least and largest value of each condition, bounds included.
    measure: str  #: What is computed in each condition, and of it when the claim holds there.
    unit: str  #: Of the figure.
    band: tuple[float, float]  #: Lowest and highest figure that counts as reproduced.


@dataclass(frozen=True, slots=True, kw_only=True)
class Claim(Shown):
    """One claim of a paper, as ``data/claims.yaml`` states it."""

    id: str  #: Short, stable name.
    where: str  #: Paper and place.
    says: str  #: The statement.
    #: The paper's figure in `unit`; None where the statement is not a number.
    paper: float | None = field(metadata=read_by(Section.get))
    unit: str  #: Unit of the paper's figure and of ours.
    band: tuple[float, float]  #: Lowest and highest figure that counts as reproduced.
    #: The end of the band beyond which our figure is better; None: neither.
    better: Literal["above", "below"] | None = None
    #: Name of the experiment that measures it; None: there is none yet.
    experiment: str | None = field(metadata=OR_NULL)
    #: What judges runs on the paper's own middleware, once there are any; until then `band` judges.
    criterion: Criterion | None = None

    def __post_init__(self) -> None:
        low, high = self.band
        if low > high:
            raise InvalidValueError("band", [low, high], "[low, high]")


@dataclass(frozen=True, slots=True, kw_only=True)
class Finding:
    """Our figure for one claim, computed from a run."""

    estimate: Estimate  #: Median or fitted value with its 95 % interval.
    details: Mapping[str, str] = field(default_factory=dict)  #: Further figures, as text by name.
    reason: str = ""  #: Why it deviates from the paper's, where that is known.


@dataclass(frozen=True, slots=True, kw_only=True)
class Measured(Finding):
    """A finding with how it was obtained."""

    how: How


@dataclass(frozen=True, slots=True, kw_only=True)
class Entry:
    """A line of the ledger: a claim, our figure if there is one, the verdict, and the log behind it."""

    claim: Claim
    verdict: Verdict
    measured: Measured | None = None
    log: str = ""

    def __repr__(self) -> str:
        name, paper, ours, unit, *_ = _row(self)
        said = f"paper {paper or 'without a number'}, ours {ours or 'none'} {unit}"
        return f"<{name}, {self.verdict.value}: {said}>"

    def _repr_html_(self) -> str:
        return Ledger([self])._repr_html_()

    def as_json(self) -> dict[str, Any]:
        """Return the line as JSON values; figures are null where nothing was measured."""
        m = self.measured
        return {
            "id": self.claim.id,
            "where": self.claim.where,
            "says": self.claim.says,
            "paper": self.claim.paper,
            "value": m.estimate.value if m else None,
            "low": m.estimate.low if m else None,
            "high": m.estimate.high if m else None,
            "unit": self.claim.unit,
            "how": m.how.value if m else None,
            "verdict": self.verdict.value,
            "reason": m.reason if m and self.verdict is Verdict.DEVIATES else "",
            "details": dict(m.details) if m else {},
            "log": self.log or None,
        }


class Ledger(list[Entry]):
    """All claims, judged."""

    def __repr__(self) -> str:
        counts = {v: sum(e.verdict is v for e in self) for v in Verdict}
        return f"<ledger: {', '.join(f'{n} {v.value}' for v, n in counts.items() if n) or 'empty'}>"

    def _repr_html_(self) -> str:
        head = "claim", "where", "says", "paper", "ours (median, 95 % interval)", "unit", "how", "verdict"
        return html_table([head, *map(_full_row, self)], repr(self)[1:-1])


def _full_row(entry: Entry) -> tuple[str, ...]:
    name, *figures = _row(entry)
    return name, entry.claim.where, entry.claim.says, *figures


def load_claims(path: Path) -> list[Claim]:
    """Read and check the papers' side of the ledger, ``data/claims.yaml``.

    Raises:
        DocumentError: The file is missing or an entry is wrong; says where and what is allowed.
    """
    claims: dict[str, Claim] = {}
    for entry in Document.of_file(path).items():
        claim = entry.read(Claim)
        if claim.id in claims:
            raise entry.refusal("id", claim.id, "each claim once")
        claims[claim.id] = claim
    return list(claims.values())


def judge(claim: Claim, measured: Measured | None) -> Verdict:
    """Compute the verdict from our figure: the ledger's only rule.

    Better asks that the whole interval lies beyond the band's end, reproduced that the figure lies in the
    band.
    """
    if measured is None:
        return Verdict.NOT_YET
    low, high = claim.band
    estimate = measured.estimate
    if claim.better == "above" and estimate.low > high:
        return Verdict.BETTER
    if claim.better == "below" and estimate.high < low:
        return Verdict.BETTER
    beyond = (claim.better == "above" and estimate.value > high) or (
        claim.better == "below" and estimate.value < low
    )
    if beyond or low <= estimate.value <= high:
        return Verdict.REPRODUCED
    return Verdict.DEVIATES


def render(entries: Sequence[Entry]) -> str:
    """Return the ledger as a table for a terminal, a line a claim."""
    rows: list[tuple[str, ...]] = [("claim", "paper", "ours (median, 95 % interval)", "unit", "how", "verdict")]
    rows += [_row(entry) for entry in entries]
    lines = columns(rows)
    lines.insert(1, "-" * len(lines[0]))
    lines += ["", repr(Ledger(entries)).removeprefix("<ledger: ").removesuffix(">")]
    return "\n".join(lines)


def _row(entry: Entry) -> tuple[str, ...]:
    m, c = entry.measured, entry.claim
    paper = "" if c.paper is None else f"{c.paper:g}"
    ours = f"{m.estimate.value:.3g} [{m.estimate.low:.3g}, {m.estimate.high:.3g}]" if m else ""
    return c.id, paper, ours, c.unit, m.how.value if m else "", entry.verdict.value


def entry_for(claim: Claim, measured: Measured | None, *, log: str = "") -> Entry:
    """Join a claim with our figure and judge it."""
    return Entry(claim=claim, verdict=judge(claim, measured), measured=measured, log=log if measured else "")
