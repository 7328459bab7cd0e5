"""Drawing of the gateway core's transition table as a state diagram (paper C, Fig. 4)."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from sfglab.soc.gateway import ADDED_STATES, TABLE, Action, Input, State, transitions
from sfglab.soc.graph_drawing import FRAME, GATEWAY, HARDWARE

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.patches import FancyBboxPatch
    from numpy.typing import NDArray

Part: TypeAlias = State | tuple[State, Input]
"""A state of the diagram, or the transition of a state by an input."""

LAYOUT = """
-                -                  -                    START    PUBLISH_WAIT PUBLISH
-                TO_HMT             -                    REQUEST  -            CANCEL_WAIT
-                CLAIM              FILTER_SMT           POLL_OSIF DROP_HMT    CANCEL
DROP_HMT_HOLDING FILTER_HMT_HOLDING PUBLISH_WAIT_HOLDING POLL_HMT FILTER_HMT   TO_MEMORY
-                TO_MEMORY_HOLDING  PUBLISH_HOLDING      -        -            -
"""
"""Places of the states in columns and rows: polling in the middle, software to hardware left of it."""

COLUMN_WIDTH = 1.6  #: Distance between columns, inches.
ROW_HEIGHT = 0.95  #: Distance between rows, inches.
BOX_WIDTH = 1.02  #: Width of a state's box, inches.
BOX_HEIGHT = 0.54  #: Height of a state's box, inches.
ASIDE = 0.08  #: Shift of each of two opposite arrows to its right, inches.
DETOURS = {(State.CANCEL_WAIT, State.PUBLISH_HOLDING): [(9.28, -0.95), (9.28, -3.8)]}
"""Corners, inches, of the only arrow that would otherwise pass over states."""

OSIF_COLOR = GATEWAY  #: Fill of states that use the delegate's interface.
HMT_COLOR = HARDWARE  #: Fill of states that use the hardware-mapped topic.
ABBREVIATIONS = {"HMT", "SMT", "OSIF"}


def positions() -> dict[State, tuple[float, float]]:
    """Return the centre of each state's box, inches, as `LAYOUT` places it."""
    found = {}
    for row, line in enumerate(LAYOUT.strip().splitlines()):
        for column, name in enumerate(line.split()):
            if name != "-":
                found[State[name]] = (column * COLUMN_WIDTH, -row * ROW_HEIGHT)
    return found


def draw_core(axes: Axes) -> dict[Part, list[Artist]]:
    """Draw the core into axes of 10 by 5 inches: OSIF yellow, HMT blue, `ADDED_STATES` dashed.

    Returns:
        The artists of each state, its box first, and of each transition.
    """
    centres = positions()
    arrows = transitions()
    connected = {(state, target) for (state, _), target in arrows.items()}
    artists: dict[Part, list[Artist]] = {}
    boxes = {}
    for state, row in TABLE.items():
        boxes[state] = _draw_box(axes, state, row.action, centres[state])
        artists[state] = [boxes[state], *_draw_names(axes, state, row.action, centres[state])]
    for (state, given), target in arrows.items():
        points = [centres[state], *DETOURS.get((state, target), []), centres[target]]
        aside = ASIDE if (target, state) in connected else 0.0
        artists[state, given] = _draw_arrow(axes, np.array(points), boxes[target], given, aside)
    axes.set(xlim=(-0.65, 9.65), ylim=(-4.2, 0.4), aspect="equal")
    axes.axis("off")
    return artists


def _draw_box(
    axes: Axes, state: State, action: Action, centre: tuple[float, float]
) -> FancyBboxPatch:
    from matplotlib.patches import FancyBboxPatch

    corner = (centre[0] - BOX_WIDTH / 2, centre[1] - BOX_HEIGHT / 2)
    box = FancyBboxPatch(corner, BOX_WIDTH, BOX_HEIGHT, "round,pad=0,rounding_size=0.08")
    box.set(facecolor=_fill(action), edgecolor=FRAME)
    if state in ADDED_STATES:
        box.set(linestyle=(0, (4, 2)), linewidth=1.6)
    axes.add_patch(box)
    return box


def _fill(action: Action) -> str:
    if "HMT" in action.name:
        return HMT_COLOR
    if "OSIF" in action.name or "CALL" in action.name:
        return OSIF_COLOR
    return "white"


def _draw_names(
    axes: Axes, state: State, action: Action, centre: tuple[float, float]
) -> list[Artist]:
    """Write the names of a state and of its action into the state's box."""
    x, y = centre
    name = _words(state.name).replace(" holding", "\nholding")
    centred: dict[str, Any] = {"ha": "center", "va": "center", "fontsize": 7}
    upper = axes.text(x, y + 0.08, name, weight="bold", linespacing=1.0, **centred)
    lower = axes.text(x, y - 0.17, _words(action.name), style="italic", **centred)
    return [upper, lower]


def _words(name: str) -> str:
    """Return a name of the table in words; abbreviations stay in capitals."""
    words = [word if word in ABBREVIATIONS else word.lower() for word in name.split("_")]
    return " ".join(words)


def _draw_arrow(
    axes: Axes, points: NDArray[np.float64], box: FancyBboxPatch, given: Input, aside: float
) -> list[Artist]:
    """Draw an arrow along points to a box, behind all boxes, with its input in the middle."""
    from matplotlib.patches import FancyArrowPatch

    dx, dy = points[-1] - points[-2]
    to_the_right = np.array([dy, -dx]) / np.hypot(dx, dy)
    points = points + aside * to_the_right
    lines: list[Artist] = []
    if len(points) > 2:
        lines += axes.plot(*points[:-1].T, color=FRAME, linewidth=0.9, zorder=0)
    head = FancyArrowPatch(points[-2], points[-1], patchB=box, shrinkA=0, shrinkB=0, zorder=0)
    head.set(arrowstyle="-|>", mutation_scale=10, color=FRAME, linewidth=0.9)
    axes.add_patch(head)
    middle = len(points) // 2
    x, y = (points[middle - 1] + points[middle]) / 2 + 2.6 * aside * to_the_right
    if points[middle - 1][1] == points[middle][1]:
        y += 0.1  # Horizontal arrows are shorter than their labels.
    text = _words(given.name)
    label = axes.text(x, y, text, ha="center", va="center", fontsize=7, zorder=1)
    label.set_bbox({"facecolor": "white", "edgecolor": "none", "pad": 0.4})
    return [*lines, head, label]
