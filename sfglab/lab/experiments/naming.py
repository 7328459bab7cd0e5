"""The naming schema checked name by name: paper A, section 4.1, Fig. 2.

Exact, not measured: the log holds one row for each property, as `sfglab.lab.checks.naming` states it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from sfglab.lab.checks import CheckRow
from sfglab.lab.checks.naming import checks
from sfglab.lab.claims import Finding, How
from sfglab.lab.experiment import Experiment
from sfglab.lab.figures import COLORS
from sfglab.lab.stats import exactly
from sfglab.names import schema_table
from sfglab.tables import Shown

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from sfglab.lab.bench import Bench
    from sfglab.lab.runs import Run
    from sfglab.names import SchemaNode


@dataclass(frozen=True, slots=True, kw_only=True)
class Config(Shown):
    """How much is checked."""

    samples: int = 2000  #: Random names with suffixes and custom segments.
    seed: int = 0  #: Seed of the sample.


exp = Experiment("naming", Config, where="A 4.1", smoke={"samples": 200}, paper={"samples": 20000})
exp.table("check")(CheckRow)


@exp.part("checks", total=len(checks.names), timed=False)
def check_names(bench: Bench[Config]) -> None:
    """Check the schema and write one row a property."""
    for row in checks.rows(bench.config.samples, bench.config.seed):
        bench.write("check", row)
        bench.advance(row.check)


@exp.claim("A-FQN", how=How.EXACT)
def share_of_names(run: Run[Config]) -> Finding:
    """Return the share of names on which all properties hold."""
    table = run["check"]
    checked = int(table["checked"].sum())
    return Finding(
        estimate=exactly(float(table["held"].sum() / checked), "share of names that hold"),
        details={"checks": str(checked), "properties": str(len(table))},
    )


@exp.figure("naming_schema", size=(10, 3.6))
def draw_naming(figure: Figure, run: Run[Config]) -> dict[str, Any]:
    """Draw the schema; the log only says which run it belongs to."""
    permitted = draw_schema(figure.subplots())
    held, checked = int(run["check"]["held"].sum()), int(run["check"]["checked"].sum())
    figure.suptitle(f"The naming schema (paper A, Fig. 2): {held} of {checked} checks hold")
    return {"permitted": permitted, "held": held, "checked": checked}


def draw_schema(axes: Axes) -> dict[str, Any]:
    """Draw Fig. 2 from the schema's own table: the chain of segments and the ways into the resource.

    Returns:
        How many standard resources each way permits.
    """
    table = schema_table()
    places = {node.name: 2.2 * i for i, node in enumerate(table.nodes)}
    ways = [edge for edge in table.edges if edge.after is not None]
    for node in table.nodes:
        _draw_segment(axes, node, places[node.name])
    for edge in table.edges:
        if edge.after is None:
            _arrow(axes, places[edge.source] + 0.75, places[edge.target] - 0.75, height=0.0)
    for lane, edge in enumerate(ways):
        label = f"after {edge.source}: {len(edge.resources)} resources"
        _arrow(axes, places[edge.source], places["resource"], height=1.1 + 0.45 * (len(ways) - lane))
        axes.text(places[edge.source] + 0.1, 1.16 + 0.45 * (len(ways) - lane), label, fontsize=8)
    axes.set(xlim=(-1, places["resource"] + 1), ylim=(-1.6, 3.3))
    axes.axis("off")
    return {edge.source: [resource.value for resource in edge.resources] for edge in ways}


def _draw_segment(axes: Axes, node: SchemaNode, x: float) -> None:
    style = "solid" if node.mandatory else "dashed"
    box = {"boxstyle": "round,pad=0.5", "facecolor": "white", "edgecolor": "black", "linestyle": style}
    axes.text(x, 0, f"<{node.name}>", ha="center", va="center", bbox=box)
    values = f"{len(node.values)} values" if node.values else "SFG_AGENT_NAME,\nelse host name"
    more = "\n+ suffix, Custom" if node.extensible else ""
    axes.text(x, -0.55, values + more, ha="center", va="top", fontsize=8)


def _arrow(axes: Axes, start: float, end: float, *, height: float) -> None:
    arrow = {"arrowstyle": "->", "color": COLORS["proxy"] if height else "black"}
    if not height:
        axes.annotate("", xy=(end, 0), xytext=(start, 0), arrowprops=arrow)
        return
    axes.plot([start, start, end], [0.4, height, height], color=COLORS["proxy"], linewidth=1)
    axes.annotate("", xy=(end, 0.4), xytext=(end, height), arrowprops=arrow)
