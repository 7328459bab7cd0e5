"""The naming schema checked name by name: paper A, section 4.1, Fig. 2.

The properties are computed, not measured: the log has one row for each property of `sfglab.lab.checks.naming`.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from textwrap import fill
from typing import TYPE_CHECKING, Any

from sfglab import names
from sfglab.fleet.policy import Direction, Policy
from sfglab.lab.checks import CheckRow, shown_checks
from sfglab.lab.checks.naming import checks
from sfglab.lab.claims import Finding, How
from sfglab.lab.experiment import Experiment
from sfglab.lab.explore.press import Pressed
from sfglab.lab.figures import COLORS, note
from sfglab.lab.stats import exactly
from sfglab.tables import Shown
from sfglab.view.widgets import widgets

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from sfglab.lab.bench import Bench
    from sfglab.lab.runs import Run
    from sfglab.names import Resource, RosFqn


@dataclass(frozen=True, slots=True, kw_only=True)
class Config(Shown):
    """How much is checked."""

    samples: int = 2000  #: Random names with suffixes and custom segments.
    seed: int = 0  #: Seed of the sample.


exp = Experiment("naming", Config, where="A 4.1", smoke={"samples": 200}, paper={"samples": 20000})
exp.table("check")(CheckRow)


@exp.part("checks", total=len(checks), timed=False)
def check_names(bench: Bench[Config]) -> None:
    """Check the schema and write one row per property."""
    for row in checks.rows(bench.config.samples, bench.config.seed):
        bench.write("check", row)
        bench.advance(row.check)


#: Sentence that each check states, by its name in the log.
STATEMENTS = {
    "parses back to the tuple it was built from": "A tuple, built to a name and parsed, is the same tuple again.",
    "builds back to the string it was parsed from": "A name, parsed to a tuple and built, is the same name again.",
    "is a valid ROS 2 name": "A name of the schema is a valid ROS 2 name.",
    "has a resource that Fig. 2 allows after its last segment": "A name ends with a resource that Fig. 2 allows "
    "after the segment before it.",
    "resources where Fig. 2 does not allow them are refused": "The builder refuses a resource after a segment "
    "after which Fig. 2 does not allow it.",
    "a segment without the one that it is part of is refused": "A component without an agent and a stream "
    "without a component are refused.",
    "a host name becomes a valid agent": "A host name is converted to a valid agent name.",
    "standard names differ from each other": "Different tuples of standard values have different names.",
    "is printed in the paper, and is in the schema": "A name that the paper prints is a name of the schema.",
}
_EXAMPLES = {
    "agent None, component Component.CAMERA, stream None": "component camera without an agent",
}


def check_table(run: Run[Config]) -> pd.DataFrame:
    """Return the checks of a run, with the sentence that each states."""
    return shown_checks(run["check"], STATEMENTS, _EXAMPLES)


@exp.claim("A-FQN", how=How.EXACT)
def share_of_names(run: Run[Config]) -> Finding:
    """Return the share of names on which all properties hold."""
    share = float(run["check"]["held"].sum() / run["check"]["checked"].sum())
    return Finding(estimate=exactly(share, "share of names that hold"))


@exp.figure("naming_schema", size=(10, 3.6))
def draw_naming(figure: Figure, run: Run[Config]) -> None:
    """Draw the naming schema (Fig. 2): its five segments, and after which of them a resource may follow."""
    draw_schema(figure.subplots())
    held = int((run["check"]["held"] == run["check"]["checked"]).sum())
    names_checked = run["check"]["checked"].max()
    figure.suptitle(
        f"{held} of {len(run['check'])} properties of the naming schema (Fig. 2) hold for up to "
        f"{names_checked:,} names"
    )
    note(figure, "dashed: optional segment; blue: a resource may follow this segment directly")


#: Segments of a name, first to last.
SEGMENTS = ("scope", "agent", "component", "stream", "resource")
MANDATORY = frozenset({"scope", "resource"})  #: Segments that every name has.
EXTENSIBLE = frozenset({"component", "stream", "resource"})  #: Segments with suffixes and `Custom`.


def permitted() -> dict[str, list[Resource]]:
    """Return the standard resources that may follow each segment, by the segment: Fig. 2."""
    found: dict[str, list[Resource]] = {}
    for segment, flag in zip(SEGMENTS, names.After, strict=False):
        found[segment] = [resource for resource in names.Resource if flag in resource.after]
    return found


def draw_schema(axes: Axes, fqn: RosFqn | None = None) -> None:
    """Draw Fig. 2; of a given name draw its segments, and only the exit that it takes."""
    places = {label: 2.2 * i for i, label in enumerate(SEGMENTS)}
    for label, x in places.items():
        _draw_segment(axes, label, x, fqn)
    for start, end in pairwise([*places.values()][:-1]):
        axes.annotate("", (end - 0.75, 0), (start + 0.75, 0), arrowprops={"arrowstyle": "->"})
    into = places["resource"]
    for lane, (source, resources) in enumerate(permitted().items()):
        if fqn is not None and fqn.segments[-2][0] != source:
            continue
        x, height = places[source], 1.1 if fqn else 2.9 - 0.45 * lane
        line: dict[str, Any] = {"color": COLORS["standard" if fqn else "proxy"], "linewidth": 1}
        axes.plot([x, x, into], [0.4, height, height], **line)
        axes.annotate("", (into, 0.4), (into, height), arrowprops={"arrowstyle": "->", **line})
        label = f"after {source}: {len(resources)} resources"
        axes.text(x + 0.1, height + 0.06, label, fontsize=8)
    axes.set(xlim=(-1, into + 1), ylim=(-1.6, 1.5 if fqn else 3.3))
    axes.axis("off")


def _draw_segment(axes: Axes, label: str, x: float, fqn: RosFqn | None) -> None:
    text = dict(fqn.segments).get(label) if fqn else None
    is_solid = text or label in MANDATORY
    box = {
        "boxstyle": "round,pad=0.5",
        "facecolor": "white",
        "edgecolor": COLORS["standard"] if text else "black",
        "linestyle": "solid" if is_solid else "dashed",
    }
    content = fill(text, 16) if text else f"<{label}>"
    axes.text(x, 0, content, ha="center", va="center", bbox=box)
    values = _SETS.get(label)
    below = f"{len(values)} values" if values else "SFG_AGENT_NAME,\nelse host name"
    if label in EXTENSIBLE:
        below += "\nor custom, + suffix"
    if text:
        below = label
    axes.text(x, -0.55, below, ha="center", va="top", fontsize=8)


# --- A name to type ---

_CAMERA = "/global/go2/camera_front/color/ffmpeg"
_SETS = {
    kind.__name__.lower(): kind
    for kind in (names.Scope, names.Component, names.Stream, names.Resource)
}


class NamePicture(Pressed):
    """A ROS name to type: its segments in Fig. 2, and the rule by which each of its DDS topics is forwarded.

    Raises:
        FqnError: The text is no ROS name.
        MissingExtraError: The extra ``view`` is not installed.
    """

    def __init__(self, name: str = _CAMERA) -> None:
        layout = {"width": "40em"}
        self.field = widgets().Text(value=name, description="name", layout=layout)
        self._read()
        super().__init__((11, 3), [self.field])
        self.field.observe(lambda _: self.answer(self._read), "value")

    def _read(self) -> None:
        """Read the field; a text that is no ROS name at all is refused."""
        name = self.field.value
        fqn, why = None, ""
        try:
            fqn = names.parse(name)
        except names.FqnError as error:
            why = str(error)
            names.validate_ros_name(name, names.ResourceKind.TOPIC)
        self.name = name  #: The name that is shown.
        #: Reason why the name is outside of the schema; empty if it is in the schema.
        self.why = why
        self.fqn: RosFqn | None = fqn  #: Segments of the name; None if it is outside of the schema.

    def draw(self, figure: Figure) -> None:
        """Draw the segments of the name, and note the rule of each DDS topic."""
        draw_schema(figure.subplots(), self.fqn)
        kind = self.fqn.kind if self.fqn else names.ResourceKind.TOPIC
        read = "a name of the schema" if self.fqn else f"no name of the schema: {self.why}"
        figure.suptitle(fill(f"The {kind.value} {self.name} is {read}.", 130), fontsize=10)
        lines = []
        for dds in names.dds_names(self.name, kind):
            rule = Policy().deciding(dds, Direction.OUTWARD)
            lines.append(
                f"{dds}: forwarded by the rule {rule.pattern}" if rule else f"{dds}: not forwarded"
            )
        note(figure, "\n".join(lines))
