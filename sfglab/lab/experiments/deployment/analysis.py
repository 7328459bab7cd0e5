"""The claim A-DEPLOY: the share of checks that hold; the figures: layers as in Fig. 5, and what was checked.

What could not be checked on the machine of the run does not count; it is told beside the share.
"""

from __future__ import annotations

import re
from itertools import groupby
from typing import TYPE_CHECKING, Any

from sfglab.lab.checks import share_of_checks
from sfglab.lab.claims import Finding, How
from sfglab.lab.experiments.deployment.experiment import Config, exp
from sfglab.lab.figures import COLORS

if TYPE_CHECKING:
    from collections.abc import Iterator

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from sfglab.lab.runs import Run


@exp.claim("A-DEPLOY", how=lambda run: How.LIVE if run.config.containers else How.EXACT)
def share_that_holds(run: Run[Config]) -> Finding:
    """Return the share of checks that hold, in the group where it is lowest."""
    share, refused = share_of_checks(run["check"], "group"), run["refused"]["refused"]
    details = {
        **share.groups,
        "agents": ", ".join(dict.fromkeys(run["file"]["agent"])),
        "files of all machines": str(len(run["file"])),
        "broken fleets refused": f"{int(refused.sum())} of {len(refused)}",
        **{f"not checked here: {row.check}": str(row.why) for row in run["unchecked"].itertuples()},
    }
    return Finding(estimate=share.estimate, details=details, reason=share.reason)


_LAYERS = {"base": COLORS["standard"], "adapter": COLORS["proxy"], "application": COLORS["third"]}
"""Paper A, Fig. 5, from the hardware upwards."""


@exp.figure("deployment_layers", size=(6.4, 2.7))
def draw_layers(figure: Figure, run: Run[Config]) -> dict[str, Any]:
    """Draw every agent's image as three layers; what is the same for several is one box."""
    agents = list(dict.fromkeys(run["layer"]["agent"]))
    figure.set_size_inches(1.3 + 0.96 * len(agents), 2.7)
    axes = figure.subplots()
    for row, (layer, color) in enumerate(_LAYERS.items()):
        table = run["layer"][run["layer"]["layer"] == layer].set_index("agent").loc[agents]
        for first, last in _runs(list(table["digest"])):
            _box(axes, (first, last, row), table["says"].iloc[first], color)
    axes.set_xticks(range(len(agents)), agents)
    axes.set_yticks(range(len(_LAYERS)), ["hardware base", "adapter", "application"])
    axes.set(xlim=(-0.55, len(agents) - 0.45), ylim=(-0.5, len(_LAYERS) - 0.5))
    axes.set_title("Each agent's image in three layers; a box across agents is the same layer")
    axes.tick_params(length=0)
    axes.grid(visible=False)
    axes.spines[:].set_visible(False)
    counts = run["layer"].groupby("layer")["digest"].nunique()
    return {"agents": len(agents), **{f"distinct {name}": int(n) for name, n in counts.items()}}


def _runs(digests: list[str]) -> Iterator[tuple[int, int]]:
    """Yield first and last place of each run of equal digests."""
    for _, places in groupby(range(len(digests)), key=digests.__getitem__):
        run = list(places)
        yield run[0], run[-1]


def _box(axes: Axes, place: tuple[int, int, int], text: str, color: str) -> None:
    from matplotlib.patches import FancyBboxPatch

    first, last, row = place
    corner, width, shape = (first - 0.44, row - 0.36), last - first + 0.88, "round,pad=0.02,rounding_size=0.05"
    look: dict[str, Any] = {"facecolor": color, "alpha": 0.28, "linewidth": 0}
    axes.add_patch(FancyBboxPatch(corner, width, 0.72, boxstyle=shape, **look))
    shown = text if last > first else "\n".join(re.findall(r".{1,13}(?:[-:, ]|$)|.{13}", text))
    axes.text((first + last) / 2, row, shown, ha="center", va="center", fontsize=7)


@exp.figure("deployment_checks", size=(6.4, 3.0))
def draw_checks(figure: Figure, run: Run[Config]) -> dict[str, Any]:
    """Draw how many checks of each part of the deployment hold."""
    sums = run["check"].groupby("group", sort=False)[["held", "checked"]].sum().iloc[::-1]
    kinds = run["check"].groupby("group")["check"].nunique()
    labels = [f"{group} ({kinds[group]} properties)" for group in sums.index]
    figure.set_size_inches(6.4, 0.9 + 0.27 * len(labels))
    axes = figure.subplots()
    axes.barh(labels, sums["checked"], color="0.85")
    axes.barh(labels, sums["held"], color=COLORS["proxy"])
    for y, row in enumerate(sums.itertuples()):
        at, text = (row.checked, y), f"{row.held} of {row.checked}"
        axes.annotate(text, at, xytext=(4, 0), textcoords="offset points", va="center", fontsize=8)
    axes.tick_params(axis="y", length=0)
    axes.set(xscale="log", xlim=(1, 2.5 * sums["checked"].max()), xlabel="cases; in colour: those that hold")
    count = len(run["unchecked"])
    rest = f"; {count} properties could not be asked on that machine" if count else ""
    axes.set_title(f"{sums['held'].sum()} of {sums['checked'].sum()} cases hold{rest}")
    return {**{str(row.Index): f"{row.held} of {row.checked}" for row in sums.itertuples()}, "not asked": count}
