"""The gateway core's table drawn as paper C's Fig. 4: states as boxes with what they drive, inputs on arrows.

What there is to draw, and its words, come from the table; only places are given here. Knows axes; refuses to
know what a state means.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from sfglab.soc.gateway.core import TABLE, State

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from numpy.typing import NDArray

    from sfglab.soc.gateway.core import Input, Table

    Points = NDArray[np.float64]


PLACES: dict[State, tuple[int, int]] = {
    State.START: (2, 0),
    State.REQUEST: (2, 1),
    State.POLL_OSIF: (2, 2),
    State.POLL_HMT: (2, 3),
    State.FILTER_SMT: (1, 2),
    State.CLAIM: (0, 2),
    State.TO_HMT: (0, 1),
    State.FILTER_HMT: (3, 3),
    State.DROP_HMT: (3, 2),
    State.TO_MEMORY: (4, 3),
    State.CANCEL: (4, 2),
    State.CANCEL_WAIT: (4, 1),
    State.PUBLISH: (4, 0),
    State.PUBLISH_WAIT: (3, 0),
    State.FILTER_HMT_HOLDING: (0, 3),
    State.DROP_HMT_HOLDING: (-1, 3),
    State.TO_MEMORY_HOLDING: (0, 4),
    State.PUBLISH_HOLDING: (1, 4),
    State.PUBLISH_WAIT_HOLDING: (1, 3),
}
"""Column and row of each state: polling amid, software to hardware left, hardware to software right."""
# Corners of the one arrow that would cross states, and its other end.
_DETOURS = {(State.CANCEL_WAIT, State.PUBLISH_HOLDING): ((4.8, 1), (4.8, 4))}
# Inches: from column to column and from row to row, half a box, and between two arrows that meet.
_PITCH = np.array([2.5, 1.0])
_HALF = np.array([0.9, 0.24])
_APART = 0.16
# Okabe and Ito's palette: software's side, hardware's side, neither.
_OSIF, _HMT, _INNER = "#F5D67B", "#A8D4F0", "#FFFFFF"


@dataclass(frozen=True, slots=True, kw_only=True)
class Arrow:
    """One arrow of the figure."""

    source: State  #: Where it starts.
    given: Input  #: The input on it.
    target: State  #: Where it ends.


def arrows(table: Table = TABLE) -> list[Arrow]:
    """Return the table's arrows, in its order."""
    return [
        Arrow(source=state, given=given, target=move.to)
        for state, row in table.items()
        for given, move in row.moves.items()
    ]


def draw_core(ax: Axes, table: Table = TABLE) -> None:
    """Draw the core: calls and answers of its delegate yellow, uses of the stream blue.

    Args:
        ax: Where; its letters fit from about 14 by 5 inches on.
        table: The core's behaviour.
    """
    drawn = arrows(table)
    for arrow in drawn:
        meets = any((a.source, a.target) == (arrow.target, arrow.source) for a in drawn)
        _draw_arrow(ax, arrow, _APART / 2 if meets else 0.0)
    for state, row in table.items():
        _draw_state(ax, state, row.drive.name)
    places = np.array([*PLACES.values(), *(p for corners in _DETOURS.values() for p in corners)])
    low, high = _inches(places.min(axis=0)), _inches(places.max(axis=0))
    ax.set_xlim(low[0] - 1.1, high[0] + 0.2)
    ax.set_ylim(high[1] - 0.4, low[1] + 0.4)
    ax.set_aspect("equal")
    ax.axis("off")


def _inches(place: Points | tuple[float, float]) -> Points:
    """Return where a place is; rows run downwards."""
    x, y = np.asarray(place, dtype=np.float64) * _PITCH
    return np.array([x, -y])


def _draw_state(ax: Axes, state: State, drive: str) -> None:
    from matplotlib.patches import FancyBboxPatch

    fill = _HMT if "HMT" in drive else _OSIF if "OSIF" in drive or "CALL" in drive else _INNER
    centre = _inches(PLACES[state])
    left, bottom = centre - _HALF
    width, height = 2 * _HALF
    box = FancyBboxPatch((left, bottom), width, height, "round,pad=0,rounding_size=0.08", fc=fill, ec="#333333")
    ax.add_patch(box)
    x, y = centre
    ax.text(x, y + 0.09, _words(state.name), ha="center", va="center", fontsize=7, weight="bold")
    ax.text(x, y - 0.1, _words(drive), ha="center", va="center", fontsize=6, style="italic")


def _words(name: str) -> str:
    """Return a name of the table in words; abbreviations stay in capitals."""
    return " ".join(w if w in {"HMT", "SMT", "OSIF"} else w.lower() for w in name.split("_"))


def _draw_arrow(ax: Axes, arrow: Arrow, aside: float) -> None:
    corners = _DETOURS.get((arrow.source, arrow.target), ())
    way = np.array([_inches(p) for p in (PLACES[arrow.source], *corners, PLACES[arrow.target])])
    first, last = way[1] - way[0], way[-1] - way[-2]
    way = way + aside * np.array([last[1], -last[0]]) / np.hypot(*last)
    way[0] = way[0] + first * _inside(first)
    way[-1] = way[-1] - last * _inside(last)
    for start, end in list(pairwise(way))[:-1]:
        ax.plot(*zip(start, end, strict=True), color="#333333", lw=0.9, zorder=0)
    ends = {"arrowstyle": "-|>", "color": "#333333", "lw": 0.9, "shrinkA": 0, "shrinkB": 0}
    ax.annotate("", way[-1], way[-2], arrowprops=ends, zorder=0)
    x, y = (way[0] + way[1]) / 2 + 2.6 * aside * np.array([last[1], -last[0]]) / np.hypot(*last)
    y += 0.1 * (first[1] == 0)  # level arrows are short: their label stands above
    white = {"fc": "white", "ec": "none", "pad": 0.4}
    ax.text(x, y, _words(arrow.given.name), ha="center", va="center", fontsize=6.5, bbox=white, zorder=1)


def _inside(direction: Points) -> float:
    """Return the part of an arrow that lies within the box at its end."""
    with np.errstate(divide="ignore"):
        return float(np.min(_HALF / np.abs(direction)))
