"""The naming schema checked name by name: paper A, section 4.1, Fig. 2.

Exact, not measured: the log holds one row for each property, as `sfglab.lab.checks.naming` states it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise
from textwrap import fill
from typing import TYPE_CHECKING, Any

from sfglab import names
from sfglab.errors import InvalidValueError, SfglabError
from sfglab.fleet.policy import Crossing, Direction, ForwardRule, Policy
from sfglab.lab.checks import CheckRow
from sfglab.lab.checks.naming import checks
from sfglab.lab.claims import Finding, How
from sfglab.lab.experiment import Experiment
from sfglab.lab.explore.press import Pressed, part
from sfglab.lab.figures import COLORS
from sfglab.lab.stats import exactly
from sfglab.tables import Shown
from sfglab.view.widgets import widgets

if TYPE_CHECKING:
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
    """Draw the naming schema (Fig. 2): the chain of segments and the ways into the resource."""
    permitted = draw_schema(figure.subplots())
    held, checked = int(run["check"]["held"].sum()), int(run["check"]["checked"].sum())
    figure.suptitle(f"The naming schema (paper A, Fig. 2): {held} of {checked} checks hold")
    return {"permitted": permitted, "held": held, "checked": checked}


SEGMENTS = ("scope", "agent", "component", "stream", "resource")  #: In the order of a name.
MANDATORY = frozenset({"scope", "resource"})  #: Segments that every name has.
EXTENSIBLE = frozenset({"component", "stream", "resource"})  #: They take suffixes and `Custom`.


def permitted() -> dict[str, list[Resource]]:
    """Return the standard resources that may follow each segment, by the segment: Fig. 2."""
    found: dict[str, list[Resource]] = {}
    for segment, flag in zip(SEGMENTS, names.After, strict=False):
        found[segment] = [resource for resource in names.Resource if flag in resource.after]
    return found


def draw_schema(axes: Axes, fqn: RosFqn | None = None) -> dict[str, Any]:
    """Draw Fig. 2; return the standard resources that may follow each segment.

    The segments of a given name can be pressed, and the edge that the name takes is highlighted.
    """
    places = {label: 2.2 * i for i, label in enumerate(SEGMENTS)}
    ways = permitted()
    for label, x in places.items():
        _draw_segment(axes, label, x, fqn)
    for source, target in pairwise(ways):
        _arrow(axes, places[source] + 0.75, places[target] - 0.75, height=0.0)
    for lane, (source, resources) in enumerate(ways.items()):
        taken = fqn is not None and fqn.segments[-2][0] == source
        height = 1.1 + 0.45 * (len(ways) - lane)
        _arrow(axes, places[source], places["resource"], height=height, taken=taken)
        label = f"after {source}: {len(resources)} resources"
        axes.text(places[source] + 0.1, height + 0.06, label, fontsize=8)
    axes.set(xlim=(-1, places["resource"] + 1), ylim=(-1.6, 3.3))
    axes.axis("off")
    return {source: [resource.value for resource in found] for source, found in ways.items()}


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
    shown = axes.text(x, 0, content, ha="center", va="center", bbox=box)
    values = _SETS.get(label)
    if values and fqn:
        part(label, shown)
    below = f"{len(values)} values" if values else "SFG_AGENT_NAME,\nelse host name"
    if label in EXTENSIBLE:
        below += "\n+ suffix, Custom"
    if text:
        below = f"{label}: {_origin(getattr(fqn, label))}"
    axes.text(x, -0.55, below, ha="center", va="top", fontsize=8)


def _origin(value: Any) -> str:
    """Return where a segment's text comes from."""
    if isinstance(value, names.Suffixed):
        return f"standard\n{value.base.text!r} with {value.suffix!r}"
    return (
        "custom"
        if isinstance(value, names.Custom)
        else "given"
        if isinstance(value, str)
        else "standard"
    )


def _arrow(axes: Axes, start: float, end: float, *, height: float, taken: bool = False) -> None:
    color = COLORS["standard" if taken else "proxy"] if height else "black"
    arrow = {"arrowstyle": "->", "color": color}
    if not height:
        axes.annotate("", xy=(end, 0), xytext=(start, 0), arrowprops=arrow)
        return
    line: dict[str, Any] = {"linewidth": 2.5, "zorder": 3} if taken else {"linewidth": 1}
    axes.plot([start, start, end], [0.4, height, height], color=color, **line)
    axes.annotate("", xy=(end, 0.4), xytext=(end, height), arrowprops=arrow | line)


# --- A name to type -------------------------------------------------------------------------------------------

_CAMERA, _TABLE_1 = "/global/go2/camera_front/color/ffmpeg", Policy()
_LEFT, _GATES, _RIGHT = 4.3, (5.4, 7.9), 9.0
"""Where names end before the border, where its rules stand, and where names begin behind it."""
_SETS = {
    kind.__name__.lower(): kind
    for kind in (names.Scope, names.Component, names.Stream, names.Resource)
}
_SAID = {
    Crossing.WHOLE: "crosses",
    Crossing.HALF: "crosses only in part, so that callers wait for ever",
    Crossing.NONE: "stays",
}


class NamePicture(Pressed):
    """A ROS name to type, as the schema reads it, and which of its DDS topics cross the border by which rule.

    A press on a segment puts the next standard value there that the schema allows.

    Raises:
        FqnError: It is no ROS name.
        MissingExtraError: The extra ``view`` is not installed.
    """

    def __init__(self, name: str = _CAMERA, policy: Policy = _TABLE_1) -> None:
        self._policy, kit = policy, widgets()
        kinds = {"what it is by its name": None} | {kind.value: kind for kind in names.ResourceKind}
        self.field = kit.Text(value=name, description="name", layout={"width": "40em"})
        self.choice = kit.Dropdown(options=kinds, layout={"width": "15em"})
        self._read()
        above = [kit.HBox([self.field, self.choice])]
        titles = {kind: f"The next {kind} that the schema allows" for kind in _SETS}
        super().__init__(
            self._draw_name, size=(11, 6), press=self._turn, titles=lambda: titles, above=above
        )
        for control in (self.field, self.choice):
            control.observe(lambda _: self.answer(self._read), "value")

    def _read(self) -> None:
        """Read what is in the field; what is no ROS name at all is refused."""
        name, kind = self.field.value, self.choice.value
        fqn, why = None, ""
        try:
            fqn = names.parse(name, kind)
        except names.FqnError as error:
            why = str(error)
            names.validate_ros_name(name, kind or names.ResourceKind.TOPIC)
        self.name, self.why = name, why  #: The name, and why the schema does not know it.
        #: The name as the schema reads it; None: it is none of its names.
        self.fqn: RosFqn | None = fqn
        self.kind = fqn.kind if fqn else kind or names.ResourceKind.TOPIC

    def _turn(self, label: str) -> None:
        """Put the next standard value into a segment.

        Raises:
            InvalidValueError: The segment has none, or the schema allows none of them here.
        """
        fqn = self.fqn or names.parse(self.name, self.choice.value)
        value, values = getattr(fqn, label), list[Any](_SETS.get(label, ()))
        base = value.base if isinstance(value, names.Suffixed) else value
        refused: SfglabError = InvalidValueError(
            label, base, "what you type: it has no standard values"
        )
        after = values.index(base) + 1 if base in values else 0
        for standard in (*values[after:], *values[:after]):
            changed: dict[str, Any] = {label: standard}
            try:
                self.field.value = str(replace(fqn, **changed))
            except names.FqnError as error:
                refused = error
            else:
                return
        raise refused

    def _draw_name(self, figure: Figure) -> None:
        schema, border = figure.subplots(2, 1, height_ratios=(3, 2.6))
        draw_schema(schema, self.fqn)
        ways = {way: self._policy.crossing(self.name, self.kind, way) for way in Direction}
        said = {_SAID[crossing] for crossing in ways.values()}
        verdict = (
            said.pop()
            if len(said) == 1
            else ", ".join(f"{_SAID[c]} {w.value}" for w, c in ways.items())
        )
        read = "a name of the schema" if self.fqn else f"no name of the schema: {self.why}"
        figure.suptitle(
            fill(f"The {self.kind.value} {self.name} is {read}; it {verdict}.", 130), fontsize=10
        )
        self._draw_border(border)

    def _draw_border(self, axes: Axes) -> None:
        """Draw every DDS topic's way to the rule that decides, and on."""
        topics, rules = names.dds_names(self.name, self.kind), self._policy.rules
        gates = {rule: 8.0 * (i + 0.5) / len(rules) for i, rule in enumerate(reversed(rules))}
        axes.axvspan(*_GATES, color=COLORS["network"], alpha=0.15, linewidth=0)
        crossed: set[ForwardRule] = set()
        for row, dds in enumerate(topics):
            y = 8.0 - 8.0 * (row + 0.5) / len(topics)
            axes.text(_LEFT, y, dds, ha="right", va="center", fontsize=8)
            found = {way: rule for way in Direction if (rule := self._policy.deciding(dds, way))}
            crossed.update(found.values())
            if found:
                axes.text(_RIGHT + 0.1, y, dds, ha="left", va="center", fontsize=8)
            else:
                axes.plot(
                    [_LEFT + 0.1, _GATES[0]],
                    [y, y],
                    "x-",
                    color="#777777",
                    markevery=[1],
                    linewidth=1,
                )
            for way, rule in found.items():
                _draw_way(axes, y, gates[rule], way)
        for rule, y in gates.items():
            color, weight = (
                (COLORS["standard"], "bold") if rule in crossed else ("#777777", "normal")
            )
            axes.text(
                sum(_GATES) / 2,
                y,
                rule.pattern,
                ha="center",
                va="center",
                color=color,
                weight=weight,
            )
        for x, text in (
            (_LEFT - 2, "own domain"),
            (sum(_GATES) / 2, "border"),
            (_RIGHT + 2, "global domain"),
        ):
            axes.text(x, 8.5, text, ha="center", fontsize=9, style="italic")
        axes.set(xlim=(0, 13.3), ylim=(-0.2, 9.2))
        axes.axis("off")


def _draw_way(axes: Axes, y: float, gate: float, way: Direction) -> None:
    """Draw a topic's way through its rule; the arrow's head is where samples come out."""
    outward = way is Direction.OUTWARD
    for (place, edge), head in (
        ((_LEFT + 0.1, _GATES[0]), not outward),
        ((_RIGHT, _GATES[1]), outward),
    ):
        arrow = {"arrowstyle": "->" if head else "-", "color": COLORS["standard"], "shrinkA": 0}
        axes.annotate("", (place, y), (edge, gate), arrowprops=arrow)
