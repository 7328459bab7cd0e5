"""The module `gateway_drawing` draws the gateway core's transition table as a state diagram (paper C, Fig. 4)."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from sfglab.soc.gateway import ADDED_STATES, TABLE, Action, Input, State, transitions
from sfglab.soc.graph_drawing import FRAME, GATEWAY, HARDWARE, add_frame
from sfglab.soc.graph_layout import Box

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes

Part: TypeAlias = State | tuple[tuple[State, Input]]
"""A `Part` of the diagram is a state, or an arrow with its only transition, a state and an input."""

LAYOUT = """
-                TO_HMT             -                    REQUEST   START       -
-                CLAIM              FILTER_SMT           POLL_OSIF DROP_HMT    PUBLISH_WAIT
DROP_HMT_HOLDING FILTER_HMT_HOLDING -                    POLL_HMT  FILTER_HMT  -
-                -                  PUBLISH_WAIT_HOLDING TO_MEMORY CANCEL      PUBLISH
-                TO_MEMORY_HOLDING  PUBLISH_HOLDING      -         CANCEL_WAIT -
"""
"""`LAYOUT` places the states in columns and rows, with the polling states in the middle."""

COLUMN_WIDTH = 1.76  #: Distance between columns, inches.
ROW_HEIGHT = 0.95  #: Distance between rows, inches.
BOX_WIDTH = 1.02  #: Width of a state's box, inches.
BOX_HEIGHT = 0.54  #: Height of a state's box, inches.
BEND = 0.3  #: Bend of each of two opposite arrows, as a share of the length of the arrow.

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
    """Draw the core into axes of 10 by 5 inches with yellow OSIF states, blue HMT states and dashed `ADDED_STATES`.

    Returns:
        The artists of each state, with the state's box first, and the artists of each arrow.
    """
    from matplotlib.patches import FancyArrowPatch

    centres = positions()
    arrows = transitions()
    connected = {(state, target) for (state, _), target in arrows.items()}
    artists: dict[Part, list[Artist]] = {}
    boxes = {}
    for state, row in TABLE.items():
        x, y = centres[state]
        box = Box(x=x, y=y, width=BOX_WIDTH, height=BOX_HEIGHT)
        look: dict[str, Any] = {"facecolor": _fill(row.action), "edgecolor": FRAME}
        if state in ADDED_STATES:
            look |= {"linestyle": (0, (4, 2)), "linewidth": 1.6}
        boxes[state] = add_frame(axes, box, "round,pad=0,rounding_size=0.08", **look)
        artists[state] = [boxes[state], *_draw_names(axes, state, row.action, centres[state])]
    for (state, given), target in arrows.items():
        start, end = np.array([centres[state], centres[target]])
        bend = BEND if (target, state) in connected else 0.0
        arrow = FancyArrowPatch(start, end, patchA=boxes[state], patchB=boxes[target], zorder=0)
        arrow.set(arrowstyle="-|>", mutation_scale=10, color=FRAME, linewidth=0.9)
        arrow.set_connectionstyle("arc3", rad=bend)
        axes.add_patch(arrow)
        across = (end - start)[::-1] * (1, -1)
        x, y = (start + end) / 2 + bend * across
        text = _words(given.name)
        label = axes.text(x, y, text, ha="center", va="center", fontsize=7, zorder=1)
        label.set_bbox({"facecolor": "white", "edgecolor": "none", "pad": 0.4})
        artists[((state, given),)] = [arrow, label]
    axes.set(xlim=(-0.6, 9.4), ylim=(-4.2, 0.4), aspect="equal")
    axes.axis("off")
    return artists


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
