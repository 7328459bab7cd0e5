"""Fig. 3 of paper A, drawn from the discoverer's own table, with how often a run took each transition."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from sfglab.fleet.discovery.lifecycle import ANNOUNCEMENTS, TRANSITIONS, State, diagram
from sfglab.lab.experiments.lifecycle.analysis import transitions
from sfglab.lab.figures import COLORS, house_style

if TYPE_CHECKING:
    from collections.abc import Sequence

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from sfglab.fleet.discovery.lifecycle import Edge, Input, Node
    from sfglab.lab.experiments.lifecycle.results import Results

    Point = tuple[float, float]
    Taken = dict[tuple[State, Input], int]


# Where things stand: presentation only. What there is to draw, and its words, come from the table.
_X = (0.0, 6.6, 13.2)
_Y = (9.6, 4.8, 0.0)
_HALF_WIDTH, _HALF_HEIGHT = 1.55, 0.78
_LANE = 0.3
_ROWS = ("local consumers\nknow nothing of it", "local consumers:\nit is there", "local consumers:\nit is lost")
_COLUMNS = ("nothing to ask", "one query outstanding", "waiting to ask again")
_BANDS = ("#999999", "#009E73", "#D55E00")
_LINE_HEIGHT = 0.36
_BOTTOMS = tuple(y - _HALF_HEIGHT for y in _Y)
_TOPS = tuple(y + _HALF_HEIGHT for y in _Y)
_LEFT = -3.4

# Transitions between rows: the corners of the arrow, and where the label starts.
_BETWEEN_ROWS: dict[tuple[str, str], tuple[tuple[Point, ...], Point]] = {
    ("QUERYING", "ACTIVE"): (((5.7, _BOTTOMS[0]), (5.7, 7.3), (0.6, 7.3), (0.6, _TOPS[1])), (2.0, 7.52)),
    ("ACTIVE", "LOST"): (((-0.9, _BOTTOMS[1]), (-0.9, _TOPS[2])), (-2.75, 2.4)),
    ("LOST", "ACTIVE"): (((-0.4, _TOPS[2]), (-0.4, _BOTTOMS[1])), (-0.3, 3.2)),
    ("LOST", "UNKNOWN"): (
        ((-_HALF_WIDTH, _Y[2]), (_LEFT, _Y[2]), (_LEFT, _Y[0]), (-_HALF_WIDTH, _Y[0])),
        (_LEFT + 0.1, 7.3),
    ),
    ("REFRESHING", "LOST"): (((5.5, _BOTTOMS[1]), (5.5, 2.75), (0.3, 2.75), (0.3, _TOPS[2])), (2.7, 2.97)),
    ("REJOINING", "ACTIVE"): (((6.2, _TOPS[2]), (6.2, 3.45), (1.2, 3.45), (1.2, _BOTTOMS[1])), (6.3, 1.5)),
    ("REFRESH_BACK_OFF", "LOST"): (
        ((12.6, _BOTTOMS[1]), (12.6, 2.1), (1.0, 2.1), (1.0, _TOPS[2])),
        (9.2, 2.32),
    ),
}


def draw_states(results: Results) -> tuple[Figure, dict[str, Any]]:
    """Draw the life cycle of a remote agent and how often the run took each of its transitions.

    Args:
        results: The run.

    Returns:
        The figure and the numbers that it shows.
    """
    from matplotlib.figure import Figure

    found = transitions(results)
    reached = sum(count > 0 for count in found.taken.values())
    with house_style():
        figure = Figure(figsize=(13, 8.6))
        draw_table(figure.subplots(), found.taken)
        figure.suptitle(
            f"Life cycle of a remote agent (after paper A, Fig. 3): {reached} of {len(TRANSITIONS)} "
            f"transitions taken live; {found.doubled} queries while another was outstanding"
        )
    shown = {f"{s.name} {i.name}": count for (s, i), count in found.taken.items()}
    return figure, {"taken": shown, "reached": reached, "doubled": found.doubled}


def draw_table(axes: Axes, taken: Taken) -> None:
    """Draw the states as a grid, and the transitions with how often each was taken.

    Args:
        axes: Where.
        taken: How often, by (state, input).
    """
    nodes, edges = diagram()
    _draw_grid(axes)
    for node in nodes:
        _draw_state(axes, node, [e for e in edges if e.source is e.target is node.state], taken)
    grid = {node.state: node for node in nodes}
    for pair in dict.fromkeys((e.source, e.target) for e in edges if e.source is not e.target):
        _draw_pair(axes, grid, [e for e in edges if (e.source, e.target) == pair], taken)
    axes.set(xlim=(-6.6, 15.0), ylim=(-2.8, 12.4))
    axes.axis("off")


def _draw_grid(axes: Axes) -> None:
    for y, text, color in zip(_Y, _ROWS, _BANDS, strict=True):
        axes.axhspan(y - _HALF_HEIGHT - 0.25, y + _HALF_HEIGHT + 0.25, color=color, alpha=0.07, linewidth=0)
        axes.text(-6.5, y, text, ha="left", va="center", fontsize=9, style="italic")
    for x, text in zip(_X, _COLUMNS, strict=True):
        axes.text(x, 12.1, text, ha="center", va="center", fontsize=9, style="italic")
    key = (
        "input / what is done \u00d7 how often in this run;  \u21ba the state stays;  "
        "CAPITALS: a discovery event is published;  dashed: not taken in this run"
    )
    axes.text(_X[1], -2.55, key, ha="center", va="center", fontsize=8)


def _draw_state(axes: Axes, node: Node, loops: Sequence[Edge], taken: Taken) -> None:
    from matplotlib.patches import FancyBboxPatch

    x, y = _X[node.column], _Y[node.row]
    corner = (x - _HALF_WIDTH, y - _HALF_HEIGHT)
    style = "round,pad=0,rounding_size=0.25"
    axes.add_patch(
        FancyBboxPatch(corner, 2 * _HALF_WIDTH, 2 * _HALF_HEIGHT, boxstyle=style, facecolor="white", zorder=3)
    )
    name = node.state.name.replace("_", " ").lower()
    top = y + 0.5 * _LINE_HEIGHT * len(loops)
    axes.text(x, top, name, ha="center", va="center", fontsize=10, weight="bold", zorder=4)
    for number, loop in enumerate(loops, start=1):
        text = f"\u21ba {_words(loop, taken)}"
        axes.text(
            x,
            top - number * _LINE_HEIGHT,
            text,
            ha="center",
            va="center",
            fontsize=6.8,
            zorder=4,
            color=_color([loop], taken),
        )


def _draw_pair(axes: Axes, grid: dict[State, Node], edges: Sequence[Edge], taken: Taken) -> None:
    """Draw all transitions from one state to another as one arrow with a line of text each."""
    points, label, below = _route(grid[edges[0].source], grid[edges[0].target])
    line: dict[str, Any] = {"color": _color(edges, taken), "linewidth": 1.2}
    line["linestyle"] = "solid" if any(taken[e.source, e.given] for e in edges) else "dashed"
    axes.plot(*zip(*points[:-1], strict=True), **line)
    arrow = {"arrowstyle": "-|>", "shrinkA": 0, "shrinkB": 0, **line}
    axes.annotate("", points[-1], points[-2], arrowprops=arrow)
    step = -_LINE_HEIGHT if below else _LINE_HEIGHT
    for number, edge in enumerate(edges if below else reversed(edges)):
        place = (label[0], label[1] + number * step)
        _write(axes, place, _words(edge, taken), ha="left", fontsize=7.5, color=_color([edge], taken))


def _write(axes: Axes, place: Point, text: str, **style: Any) -> None:
    behind = {"boxstyle": "square,pad=0.1", "facecolor": "white", "edgecolor": "none", "alpha": 0.75}
    axes.text(*place, text, va="center", zorder=5, bbox=behind, **style)


def _route(source: Node, target: Node) -> tuple[Sequence[Point], Point, bool]:
    """Return an arrow's corners, where its label starts, and whether further lines go below the first."""
    if source.row == target.row:
        return _route_in_row(source, target)
    points, label = _BETWEEN_ROWS[source.state.name, target.state.name]
    return points, label, True


def _route_in_row(source: Node, target: Node) -> tuple[list[Point], Point, bool]:
    y = _Y[source.row]
    steps = target.column - source.column
    if abs(steps) == 1:
        way = 1 if steps > 0 else -1
        lane = y + way * _LANE
        start, end = _X[source.column] + way * _HALF_WIDTH, _X[target.column] - way * _HALF_WIDTH
        label = (min(start, end) + 0.25, lane + way * 0.22)
        return [(start, lane), (end, lane)], label, way < 0
    way = 1 if source.row == 0 else -1  # around the state between them, on the outer side of the grid
    outer = y + way * 1.5
    edge = y + way * _HALF_HEIGHT
    points = [
        (_X[source.column], edge),
        (_X[source.column], outer),
        (_X[target.column], outer),
        (_X[target.column], edge),
    ]
    return points, (_X[1] + 1.9, outer + way * 0.22), way < 0


def _words(edge: Edge, taken: Taken) -> str:
    label = edge.label
    for action in ANNOUNCEMENTS.intersection(edge.actions):
        given, done = label.split(" / ")
        label = f"{given} / {done.replace(action.name.lower(), action.name)}"
    return f"{label}  \u00d7{taken[edge.source, edge.given]}"


def _color(edges: Sequence[Edge], taken: Taken) -> str:
    """Return one colour for what was taken in the run and another for what was not."""
    return COLORS["proxy"] if all(taken[e.source, e.given] for e in edges) else COLORS["standard"]
