"""Claim and figure on deployment."""

from __future__ import annotations

import re
from itertools import groupby
from typing import TYPE_CHECKING, Any

import pandas as pd

from sfglab.lab.claims import Finding, How
from sfglab.lab.experiments.deployment.experiment import LAYERS, Config, exp
from sfglab.lab.experiments.deployment.facts import DISCOVERY, FACTS, Outcome
from sfglab.lab.figures import COLORS, note
from sfglab.lab.runs import Run, derived, lines_of
from sfglab.lab.stats import exactly

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_CONFIRMED, _REFUSED, _MISSING = (outcome.value for outcome in Outcome)


@derived
def facts_of(run: Run[Config]) -> pd.DataFrame:
    """Return the facts of a run, with the columns of `FactRow`."""
    return run["fact"] if len(run["fact"]) else _facts_of_checks(run)


def _facts_of_checks(run: Run[Config]) -> pd.DataFrame:
    """Return the facts of a log with the table ``check``."""
    table = run["check"]
    rows = []
    for fact in FACTS:
        outcome, detail = _MISSING, ""
        for check in lines_of(table[table["check"].isin(fact.was)]):
            if check.held < check.checked:
                outcome, detail = _REFUSED, check.example
            elif outcome == _MISSING:
                outcome = _CONFIRMED
        rows.append((fact.end, fact.name, fact.program, outcome, detail))
    return pd.DataFrame(rows, columns=["end", "fact", "program", "outcome", "detail"])


def _how(run: Run[Config]) -> How:
    """Return live if containers' commands ran; the other facts are about files and folders."""
    facts = facts_of(run).set_index("fact")
    return How.EXACT if facts.loc[DISCOVERY, "outcome"] == _MISSING else How.LIVE


@exp.claim("A-DEPLOY", how=_how)
def share_confirmed(run: Run[Config]) -> Finding:
    """Return the share of the facts that were asked about and confirmed, in the part where it is lowest.

    A part of the claim counts as measured if no program was missing for any of its facts.
    """
    facts = facts_of(run)
    shares, ends, reasons = [], {}, []
    details = {"facts": _counts(facts)}
    for end, rows in facts.groupby("end", sort=False):
        missing = rows[rows["outcome"] == _MISSING]
        asked = rows[rows["outcome"] != _MISSING]
        details[str(end)] = _counts(rows)
        refused = lines_of(asked[asked["outcome"] == _REFUSED])
        reasons += [f"{row.fact}: {row.program}: {row.detail}" for row in refused]
        if len(asked):
            shares.append(float((asked["outcome"] == _CONFIRMED).mean()))
        if len(missing):
            programs = ", ".join(missing["program"].unique())
            reasons.append(f"{end} cannot be confirmed without {programs}")
        else:
            ends[str(end)] = shares[-1]
    estimate = exactly(min(shares), "share of checks that hold")
    reason = "; ".join(reasons)
    count = f"{len(facts)} facts"
    return Finding(estimate=estimate, details=details, reason=reason, ends=ends, count=count)


def _counts(facts: pd.DataFrame) -> str:
    """Return the number of facts by outcome, as text."""
    counts = facts["outcome"].value_counts()
    confirmed, refused = counts.get(_CONFIRMED, 0), counts.get(_REFUSED, 0)
    missing = counts.get(_MISSING, 0)
    return f"{confirmed} confirmed, {refused} refused, {missing} without a program to ask"


_COLORS = dict(zip(LAYERS, (COLORS["standard"], COLORS["proxy"], COLORS["third"]), strict=True))


@exp.figure("deployment_layers", size=(6.4, 2.7))
def draw_layers(figure: Figure, run: Run[Config]) -> dict[str, Any]:
    """Draw every agent's image as three layers; what is the same for several is one box."""
    layers = run["layer"]
    agents = list(layers["agent"].unique())
    figure.set_size_inches(1.3 + 0.96 * len(agents), 2.7)
    axes = figure.subplots()
    for height, (layer, color) in enumerate(_COLORS.items()):
        table = layers[layers["layer"] == layer].set_index("agent").loc[agents]
        digests = list(table["digest"])
        for _, same in groupby(range(len(agents)), key=digests.__getitem__):
            places = list(same)
            text = table["says"].iloc[places[0]]
            _draw_box(axes, (places[0], places[-1]), height, text, color)
    axes.set_xticks(range(len(agents)), agents)
    axes.set_yticks(range(len(LAYERS)), ["hardware base", "adapter", "application"])
    axes.set(xlim=(-0.55, len(agents) - 0.45), ylim=(-0.5, len(LAYERS) - 0.5))
    counts = layers.groupby("layer")["digest"].nunique()
    said = f"{counts['base']} hardware bases and {counts['adapter']} adapters carry {len(agents)} agents"
    axes.set_title(f"{said}; a box across agents is the same layer")
    note(figure, "exact: as rendered from the fleet file (paper A, Fig. 5)")
    axes.tick_params(length=0)
    axes.grid(visible=False)
    axes.spines[:].set_visible(False)
    return {"agents": len(agents), **{f"distinct {name}": int(n) for name, n in counts.items()}}


def _draw_box(axes: Axes, ends: tuple[int, int], height: int, text: str, color: str) -> None:
    from matplotlib.patches import FancyBboxPatch

    first, last = ends
    box = FancyBboxPatch(
        (first - 0.44, height - 0.36),
        last - first + 0.88,
        0.72,
        boxstyle="round,pad=0.02,rounding_size=0.05",
        facecolor=color,
        alpha=0.28,
        linewidth=0,
    )
    axes.add_patch(box)
    if first == last:
        text = "\n".join(re.findall(r".{1,13}(?:[-:, ]|$)|.{13}", text))
    axes.text((first + last) / 2, height, text, ha="center", va="center", fontsize=7)
