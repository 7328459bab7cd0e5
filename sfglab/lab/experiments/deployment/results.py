"""Claim and figure on deployment."""

from __future__ import annotations

from itertools import groupby
from textwrap import fill
from typing import TYPE_CHECKING

from sfglab.lab.claims import Finding, How
from sfglab.lab.experiments.deployment.experiment import LAYERS, Config, exp
from sfglab.lab.experiments.deployment.facts import DISCOVERY, Outcome
from sfglab.lab.figures import COLORS, note
from sfglab.lab.runs import Run, derived, lines_of
from sfglab.lab.stats import exactly

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

_CONFIRMED, _REFUSED, _MISSING = (outcome.value for outcome in Outcome)


@derived
def facts_of(run: Run[Config]) -> pd.DataFrame:
    """Return the facts of a run, with the columns of `FactRow`."""
    return run["fact"]


def _how(run: Run[Config]) -> How:
    """Return live if containers' commands ran; the other facts are about files and folders."""
    facts = facts_of(run).set_index("fact")
    return How.EXACT if facts.loc[DISCOVERY, "outcome"] == _MISSING else How.LIVE


@exp.claim("A-DEPLOY", how=_how, also=How.EXACT)
def share_confirmed(run: Run[Config]) -> Finding:
    """Return the share of confirmed facts among the checked facts, in the part of the claim where it is lowest.

    A part of the claim counts as measured if no program was missing for any of its facts.
    """
    facts = facts_of(run)
    shares = []
    ends = {}
    reasons = []
    for end, rows in facts.groupby("end", sort=False):
        missing = rows[rows["outcome"] == _MISSING]
        asked = rows.drop(missing.index)
        refused = lines_of(asked[asked["outcome"] == _REFUSED])
        reasons += [f"{row.fact}: {row.program}: {row.detail}" for row in refused]
        if len(asked):
            shares.append(float((asked["outcome"] == _CONFIRMED).mean()))
        if len(missing):
            programs = ", ".join(missing["program"].unique())
            reasons.append(f"{end} cannot be confirmed without {programs}")
        else:
            ends[str(end)] = shares[-1]
    return Finding(
        estimate=exactly(min(shares), "share of checks that hold"),
        reason="; ".join(reasons),
        ends=ends,
        count=f"{int((facts['outcome'] != _MISSING).sum())} of {len(facts)} facts judged",
    )


_NAMES = ("hardware base", "adapter", "application")
_COLORS = (COLORS["standard"], COLORS["proxy"], COLORS["third"])


@exp.figure("deployment_layers", size=(10, 2.7), measured=False)
def draw_layers(figure: Figure, run: Run[Config]) -> None:
    """Draw the three layers of each agent's image; a layer that several agents share is one box."""
    layers = run["layer"]
    agents = layers["agent"].unique()
    axes = figure.subplots()
    for height, (layer, color) in enumerate(zip(LAYERS, _COLORS, strict=True)):
        first = 0
        rows = lines_of(layers[layers["layer"] == layer])
        for (_, says), same in groupby(rows, lambda row: (row.digest, row.says)):
            width = len(list(same))
            left = first - 0.44
            bars = axes.barh(height, width - 0.12, 0.72, left, color=color, alpha=0.28)
            text = fill(says, 15) if width == 1 else says
            if layer == LAYERS[-1]:
                text = agents[first]  # the instructions of one agent
            axes.bar_label(bars, [text], label_type="center", fontsize=7)
            first += width
    axes.set_xticks(range(len(agents)), agents)
    axes.set_yticks(range(len(LAYERS)), _NAMES)
    axes.set(xlim=(-0.55, len(agents) - 0.45), ylim=(-0.5, len(LAYERS) - 0.5))
    counts = layers.groupby("layer")["digest"].nunique()
    axes.set_title(
        f"{len(agents)} agents need {counts['base']} hardware bases and {counts['adapter']} adapters; "
        "a box spans the agents that share it"
    )
    note(
        figure,
        "rendered from the fleet file (paper A, Fig. 5); boxes with equal text are separate builds",
    )
    axes.tick_params(length=0)
    axes.grid(visible=False)
    axes.spines[:].set_visible(False)
