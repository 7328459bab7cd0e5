"""Drawing of the life cycle of a remote agent, Fig. 3 of paper A, from the discoverer's table.

The states form a grid: a row is the last announcement to local consumers, a column the state of the query.
"""

from __future__ import annotations

from collections import defaultdict
from textwrap import fill
from typing import TYPE_CHECKING, Any

from sfglab.fleet.discovery.lifecycle import (
    ANNOUNCEMENTS,
    STATED,
    TRANSITIONS,
    Announced,
    Input,
    QueryState,
    State,
)
from sfglab.lab.figures import COLORS

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from sfglab.lab.explore import Parts

    Transition = tuple[State, Input]
    Point = tuple[float, float]

X = dict(zip(QueryState, (0.0, 7.0, 14.0), strict=True))
Y = dict(zip(Announced, (9.6, 4.8, 0.0), strict=True))
ROWS = {
    Announced.NOTHING: "agent not\nannounced",
    Announced.PRESENT: "announced\nas present",
    Announced.LOST: "announced\nas lost",
}
COLUMNS = {
    QueryState.NONE: "no query",
    QueryState.QUERYING: "one query outstanding",
    QueryState.BACKING_OFF: "waiting to query again",
}
COLORS_OF_ROWS = dict(zip(Announced, ("#999999", "#009E73", "#D55E00"), strict=True))
HALF_WIDTH, HALF_HEIGHT = 1.75, 0.85
LANE = 0.3  #: Distance of an arrow from the middle of its row.
LEFT = -3.7  #: Place of the arrow along the left side.
LINE = 0.5  #: Distance of two lines of text.

#: Arrows between rows: places of their start, their end, their horizontal part, and their text.
BETWEEN_ROWS: dict[tuple[State, State], tuple[float, float, float, Point]] = {
    (State.QUERYING, State.ACTIVE): (6.0, 0.6, 7.3, (1.7, 7.55)),
    (State.ACTIVE, State.LOST): (-0.6, -0.6, 3.95, (-3.2, 2.4)),
    (State.LOST, State.ACTIVE): (-0.2, -0.2, 0.85, (-0.1, 3.12)),
    (State.REFRESHING, State.LOST): (6.3, 0.3, 2.7, (2.7, 2.94)),
    (State.REJOINING, State.ACTIVE): (6.8, 1.2, 3.4, (6.9, 1.55)),
    (State.REFRESH_BACK_OFF, State.LOST): (12.8, 1.0, 2.1, (9.2, 2.34)),
}
KEY = (
    "\u21ba: the state stays. CAPITALS: discovery event. Bold: stated by the paper.\n"
    "Texts above a line belong to the arrow to the right, texts below it to that to the left."
)
KEY_OF_RUN = f"input / actions \u00d7 number in this run. {KEY}"
KEY_OF_MOMENT = (
    f"input / actions. {KEY}\nOrange: present state and last transition. Blue: possible now."
)


def draw_run(axes: Axes, taken: Mapping[Transition, int]) -> None:
    """Draw the table with the number of times that each transition was taken."""
    _Table(axes, taken).draw(
        KEY_OF_RUN if all(taken.values()) else f"{KEY_OF_RUN}\nGrey: not taken."
    )


def draw_to_press(figure: Figure) -> Parts:
    """Draw the transition table without counts, and return the artists of its clickable parts."""
    figure.set_layout_engine("none")  # it would draw everything twice
    return _Table(figure.add_axes((0, 0, 1, 1)), None).draw(KEY_OF_MOMENT)


class _Table:
    """The table, drawn into axes; without numbers it can be clicked."""

    def __init__(self, axes: Axes, taken: Mapping[Transition, int] | None) -> None:
        self._axes = axes
        self._taken = taken
        self._parts: dict[Any, list[Artist]] = defaultdict(list)

    def draw(self, key: str) -> Parts:
        """Draw states, transitions and the key, and return the artists of each part."""
        axes = self._axes
        for announced, text in ROWS.items():
            y = Y[announced]
            half = HALF_HEIGHT + 0.25
            color = COLORS_OF_ROWS[announced]
            axes.axhspan(y - half, y + half, color=color, alpha=0.07, linewidth=0)
            axes.text(-5.8, y, text, va="center", fontsize=9, style="italic")
        for query, text in COLUMNS.items():
            axes.text(X[query], 12.2, text, ha="center", fontsize=9, style="italic")
        axes.text(X[QueryState.QUERYING], -2.6, key, ha="center", va="center", fontsize=8.5)
        arrows: dict[tuple[State, State], list[Transition]] = defaultdict(list)
        for transition, (target, _) in TRANSITIONS.items():
            arrows[transition[0], target].append(transition)
        for state in State:
            self._draw_state(state, arrows.pop((state, state), []))
        for (source, target), transitions in arrows.items():
            corners, at, goes_up = _route(source, target)
            self._draw_arrow(transitions, corners, at, up=goes_up)
        axes.set(xlim=(-5.9, 16.0), ylim=(-3.3, 12.7))
        axes.axis("off")
        return self._parts

    def _draw_state(self, state: State, loops: Sequence[Transition]) -> None:
        """Draw a state as a box with the transitions that do not leave it."""
        from matplotlib.patches import FancyBboxPatch

        x, y = X[state.query], Y[state.announced]
        style = "round,pad=0,rounding_size=0.25"
        box = FancyBboxPatch(
            (x - HALF_WIDTH, y - HALF_HEIGHT),
            2 * HALF_WIDTH,
            2 * HALF_HEIGHT,
            boxstyle=style,
            facecolor="white",
            edgecolor="black",
            zorder=3,
        )
        self._axes.add_patch(box)
        texts = [fill(f"\u21ba {self._words(loop)}", 27) for loop in loops]
        heights = [0.32 * (text.count("\n") + 1) for text in texts]
        top = y + sum(heights) / 2
        place: dict[str, Any] = {"ha": "center", "va": "center", "zorder": 4}
        name = state.name.replace("_", " ").lower()
        title = self._axes.text(x, top, name, fontsize=9, weight="bold", **place)
        self._parts[state] += [box, title]
        top -= 0.16
        for loop, text, height in zip(loops, texts, heights, strict=True):
            self._write(loop, text, (x, top - height / 2), **place)
            top -= height

    def _draw_arrow(
        self, transitions: Sequence[Transition], corners: Sequence[Point], at: Point, *, up: bool
    ) -> None:
        """Draw the transitions from one state to another as one arrow; each has a line of text."""
        key = tuple(transitions)
        style = self._style(transitions)
        arrow = {"arrowstyle": "-|>", "shrinkA": 0, "shrinkB": 0, **style}
        head = self._axes.annotate("", corners[-1], corners[-2], arrowprops=arrow).arrow_patch
        assert head is not None, "the annotation has an arrow"
        self._parts[key] += [*self._axes.plot(*zip(*corners[:-1], strict=True), **style), head]
        if self._taken is None:  # a broad line to be clicked
            broad: dict[str, Any] = {"alpha": 0, "linewidth": 9, "zorder": 3.5}
            self._parts[key] += self._axes.plot(*zip(*corners, strict=True), **broad)
        white = {"boxstyle": "square,pad=0.1", "fc": "white", "ec": "none", "alpha": 0.75}
        lines = reversed(transitions) if up else transitions
        for number, transition in enumerate(lines):
            place = (at[0], at[1] + (LINE if up else -LINE) * number)
            words = self._words(transition)
            self._write(transition, words, place, va="center", ha="left", bbox=white)

    def _write(self, transition: Transition, text: str, place: Point, **style: Any) -> None:
        weight = "bold" if transition in STATED else "normal"
        color = self._style([transition])["color"]
        style = {"zorder": 5, "fontsize": 8, "weight": weight, "color": color, **style}
        self._parts[(transition,)].append(self._axes.text(*place, text, **style))

    def _words(self, transition: Transition) -> str:
        """Return a transition in UML's syntax, "event / action; action"."""
        actions = []
        for action in TRANSITIONS[transition][1]:
            name = action.name.replace("_", " ")
            actions.append(name if action in ANNOUNCEMENTS else name.lower())
        text = transition[1].name.lower().replace("_", " ")
        if actions:
            text += f" / {'; '.join(actions)}"
        return text if self._taken is None else f"{text} \u00d7{self._taken[transition]}"

    def _style(self, transitions: Sequence[Transition]) -> dict[str, Any]:
        """Return the style of an arrow: grey if one of its transitions was not taken."""
        taken = self._taken
        is_whole = taken is None or all(taken[transition] for transition in transitions)
        return {"color": COLORS["proxy"] if is_whole else "0.45", "linewidth": 1.2}


def _route(source: State, target: State) -> tuple[Sequence[Point], Point, bool]:
    """Return an arrow's corners, the place of its first line of text, and whether further lines go up."""
    row = Y[source.announced]
    to_row = Y[target.announced]
    x, to_x = X[source.query], X[target.query]
    if source is State.LOST and target is State.UNKNOWN:
        corners = [(x - HALF_WIDTH, row), (LEFT, row), (LEFT, to_row), (x - HALF_WIDTH, to_row)]
        return corners, (LEFT + 0.1, 7.3), False
    if row != to_row:
        start, end, level, at = BETWEEN_ROWS[source, target]
        edge = HALF_HEIGHT if row < to_row else -HALF_HEIGHT
        corners = [(start, row + edge), (start, level), (end, level), (end, to_row - edge)]
        return corners, at, False
    is_right = x < to_x
    if abs(to_x - x) > X[QueryState.QUERYING]:  # around the state between them
        way = 1 if source.announced is Announced.NOTHING else -1
        edge, outer = row + way * HALF_HEIGHT, row + way * 1.5
        corners = [(x, edge), (x, outer), (to_x, outer), (to_x, edge)]
        return corners, (X[QueryState.QUERYING] + 1.6, outer + way * 0.25), way > 0
    way = 1 if is_right else -1
    lane = row + way * LANE
    start, end = x + way * HALF_WIDTH, to_x - way * HALF_WIDTH
    return [(start, lane), (end, lane)], (min(start, end) + 0.2, lane + way * 0.25), is_right
