"""The gateway core as one table, drawn from it: what it drives in each state, where each input takes it.

Paper C, section 3, Fig. 4: request a message of the software-mapped topic (SMT), poll the delegate's interface
(OSIF) and the hardware-mapped topic (HMT) in turn, forward what came, and cancel the request before publishing,
because a message may have come in between. Refuses to know clocks, beats and how topics deliver: the same table
drives the exploration and becomes the hardware's control. Ours, as the text leaves it open:

- A delegate gives exactly one answer per request; a cancel forces it (empty) or lets it through (a message).
- Before it sends to the HMT the core claims it (`CLAIM`). A hardware node's message may occupy the topic and
  wait for the core itself, so the core serves that message first, still holding its own: else both wait for
  ever, unless its port can store every message that hardware may send meanwhile.
- A publication is awaited (`PUBLISH_WAIT`): the core has one output message and must not overwrite it.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import Enum, auto
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Mapping

    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from numpy.typing import NDArray

    Points = NDArray[np.float64]


class State(Enum):
    """Where the core stands; `_HOLDING`: while it also holds a message of the SMT that the HMT has not seen."""

    START = auto()  #: Waits for the location of its output message.
    REQUEST = auto()  #: Asks the delegate for the next message of the SMT.
    POLL_OSIF = auto()  #: Looks whether the delegate has answered.
    POLL_HMT = auto()  #: Looks whether a message stands at its port of the HMT.
    FILTER_SMT = auto()  #: Compares the publisher of the message it holds with itself.
    CLAIM = auto()  #: Wants the HMT for itself, to send the message it holds.
    TO_HMT = auto()  #: Copies the message it holds from memory to the HMT.
    FILTER_HMT = auto()  #: Compares the publisher of the message at its port with itself.
    DROP_HMT = auto()  #: Discards the message at its port.
    TO_MEMORY = auto()  #: Copies the message at its port to its output message in memory.
    CANCEL = auto()  #: Takes the request back.
    #: Waits for the request's one answer: empty, or a message that came first.
    CANCEL_WAIT = auto()
    PUBLISH = auto()  #: Asks the delegate to publish the output message on the SMT.
    PUBLISH_WAIT = auto()  #: Waits until the output message is out and may be overwritten.
    FILTER_HMT_HOLDING = auto()  #: As `FILTER_HMT`.
    DROP_HMT_HOLDING = auto()  #: As `DROP_HMT`.
    #: As `TO_MEMORY`; no request is outstanding, so there is nothing to cancel.
    TO_MEMORY_HOLDING = auto()
    PUBLISH_HOLDING = auto()  #: As `PUBLISH`.
    PUBLISH_WAIT_HOLDING = auto()  #: As `PUBLISH_WAIT`.


OURS = {
    State.CLAIM,
    State.PUBLISH_WAIT,
    *(state for state in State if state.name.endswith("_HOLDING")),
}
"""States that the paper's text does not have."""


class Input(Enum):
    """What a state waits for; a state without the input it waits for stays as it is."""

    LOCATED = auto()  #: OSIF: the output message's address.
    SENT = auto()  #: OSIF: the call was accepted.
    EMPTY = auto()  #: OSIF or HMT, whichever is polled: nothing there.
    ANSWERED = auto()  #: OSIF: the request's answer is the address of a message.
    CANCELLED = auto()  #: OSIF: the request's answer is that it was cancelled.
    PUBLISHED = auto()  #: OSIF: the publication is done.
    OFFERED = auto()  #: HMT: the first word of a message stands at the core's port.
    GRANTED = auto()  #: HMT: the topic is the core's until it has sent its message.
    OWN = auto()  #: Filter: the core itself published this message.
    FOREIGN = auto()  #: Filter: somebody else did.
    DONE = auto()  #: The last beat of the transfer is through.


class Drive(Enum):
    """What the core's outputs do while it stands in a state."""

    LISTEN_OSIF = auto()  #: Ready for the delegate's next word.
    CALL_TAKE = auto()  #: OSIF call: take the next message of the SMT.
    CALL_CANCEL = auto()  #: OSIF call: cancel the take.
    CALL_PUBLISH = auto()  #: OSIF call: publish the output message on the SMT.
    PEEK_HMT = auto()  #: Looks at its port of the HMT without taking a beat.
    COMPARE_HELD = auto()  #: Compares the held message's publisher with itself; takes nothing.
    #: Compares the publisher of the message at its port with itself; takes nothing.
    COMPARE_PORT = auto()
    CLAIM_HMT = auto()  #: Asks the topic's arbiter, and looks at its port meanwhile.
    #: Reads the held message and sends it, ignoring what its own port echoes.
    MEMORY_TO_HMT = auto()
    HMT_TO_MEMORY = auto()  #: Takes the message at its port and writes the output message.
    HMT_TO_NOWHERE = auto()  #: Takes the message at its port and forgets it.


class Latch(Enum):
    """The register that a move loads with the value beside the input."""

    OUTPUT = auto()  #: Where the output message lies.
    HELD = auto()  #: Where the message to forward lies.


@dataclass(frozen=True, slots=True)
class Move:
    """Where an input leads."""

    to: State  #: The next state.
    #: The register that takes the input's value; None: the input has none.
    latch: Latch | None = None


@dataclass(frozen=True, slots=True)
class Row:
    """One state of the table."""

    drive: Drive  #: What the outputs do in this state.
    #: Where an input leads; one not listed cannot occur here.
    moves: Mapping[Input, Move] = field(hash=False)


Table = dict[State, Row]  #: A gateway core's whole behaviour.

_S, _I, _D, _L = State, Input, Drive, Latch

TABLE: Table = {
    _S.START: Row(_D.LISTEN_OSIF, {_I.LOCATED: Move(_S.REQUEST, _L.OUTPUT)}),
    _S.REQUEST: Row(_D.CALL_TAKE, {_I.SENT: Move(_S.POLL_OSIF)}),
    _S.POLL_OSIF: Row(
        _D.LISTEN_OSIF, {_I.ANSWERED: Move(_S.FILTER_SMT, _L.HELD), _I.EMPTY: Move(_S.POLL_HMT)}
    ),
    _S.POLL_HMT: Row(_D.PEEK_HMT, {_I.OFFERED: Move(_S.FILTER_HMT), _I.EMPTY: Move(_S.POLL_OSIF)}),
    # From software to hardware.
    _S.FILTER_SMT: Row(_D.COMPARE_HELD, {_I.FOREIGN: Move(_S.CLAIM), _I.OWN: Move(_S.REQUEST)}),
    _S.CLAIM: Row(
        _D.CLAIM_HMT, {_I.GRANTED: Move(_S.TO_HMT), _I.OFFERED: Move(_S.FILTER_HMT_HOLDING)}
    ),
    _S.TO_HMT: Row(_D.MEMORY_TO_HMT, {_I.DONE: Move(_S.REQUEST)}),
    # From hardware to software: a request is outstanding and is taken back before the publication.
    _S.FILTER_HMT: Row(
        _D.COMPARE_PORT, {_I.FOREIGN: Move(_S.TO_MEMORY), _I.OWN: Move(_S.DROP_HMT)}
    ),
    _S.DROP_HMT: Row(_D.HMT_TO_NOWHERE, {_I.DONE: Move(_S.POLL_OSIF)}),
    _S.TO_MEMORY: Row(_D.HMT_TO_MEMORY, {_I.DONE: Move(_S.CANCEL)}),
    _S.CANCEL: Row(_D.CALL_CANCEL, {_I.SENT: Move(_S.CANCEL_WAIT)}),
    _S.CANCEL_WAIT: Row(
        _D.LISTEN_OSIF,
        {_I.CANCELLED: Move(_S.PUBLISH), _I.ANSWERED: Move(_S.PUBLISH_HOLDING, _L.HELD)},
    ),
    _S.PUBLISH: Row(_D.CALL_PUBLISH, {_I.SENT: Move(_S.PUBLISH_WAIT)}),
    _S.PUBLISH_WAIT: Row(_D.LISTEN_OSIF, {_I.PUBLISHED: Move(_S.REQUEST)}),
    # The same while a message for the HMT is held: nothing to cancel, and the held message comes after.
    _S.FILTER_HMT_HOLDING: Row(
        _D.COMPARE_PORT, {_I.FOREIGN: Move(_S.TO_MEMORY_HOLDING), _I.OWN: Move(_S.DROP_HMT_HOLDING)}
    ),
    _S.DROP_HMT_HOLDING: Row(_D.HMT_TO_NOWHERE, {_I.DONE: Move(_S.CLAIM)}),
    _S.TO_MEMORY_HOLDING: Row(_D.HMT_TO_MEMORY, {_I.DONE: Move(_S.PUBLISH_HOLDING)}),
    _S.PUBLISH_HOLDING: Row(_D.CALL_PUBLISH, {_I.SENT: Move(_S.PUBLISH_WAIT_HOLDING)}),
    _S.PUBLISH_WAIT_HOLDING: Row(_D.LISTEN_OSIF, {_I.PUBLISHED: Move(_S.FILTER_SMT)}),
}
"""The gateway core (paper C, Fig. 4)."""


def transitions(table: Table = TABLE) -> dict[tuple[State, Input], State]:
    """Return a table as (state, input) -> the next state, for `sfglab.machine.step`."""
    return {
        (state, given): move.to for state, row in table.items() for given, move in row.moves.items()
    }


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
_PITCH = np.array([1.6, 0.95])
_HALF = np.array([0.51, 0.27])
_APART = 0.16
# Okabe and Ito's palette: software's side, hardware's side, neither.
_OSIF, _HMT, _INNER = "#F7DD92", "#85BCE6", "#FFFFFF"
_LINE = "#333333"


@dataclass(frozen=True, slots=True, kw_only=True)
class Arrow:
    """One arrow of the figure."""

    source: State  #: Where it starts.
    given: Input  #: The input on it.
    target: State  #: Where it ends.


def arrows() -> list[Arrow]:
    """Return the arrows of `TABLE`, in its order."""
    return [
        Arrow(source=state, given=given, target=move.to)
        for state, row in TABLE.items()
        for given, move in row.moves.items()
    ]


def draw_core(ax: Axes) -> dict[State | Arrow, list[Artist]]:
    """Draw the core, OSIF yellow, HMT blue, `OURS` dashed, 10 by 5 inches; return each artist."""
    drawn = arrows()
    artists: dict[State | Arrow, list[Artist]] = {}
    for arrow in drawn:
        meets = any((a.source, a.target) == (arrow.target, arrow.source) for a in drawn)
        artists[arrow] = _draw_arrow(ax, arrow, _APART / 2 if meets else 0.0)
    for state, row in TABLE.items():
        artists[state] = _draw_state(ax, state, row.drive.name)
    places = np.array([*PLACES.values(), *(p for corners in _DETOURS.values() for p in corners)])
    low, high = _inches(places.min(axis=0)), _inches(places.max(axis=0))
    ax.set(xlim=(low[0] - 0.65, high[0] + 0.1), ylim=(high[1] - 0.4, low[1] + 0.4), aspect="equal")
    ax.axis("off")
    return artists


def _inches(place: Points | tuple[float, float]) -> Points:
    """Return where a place is; rows run downwards."""
    x, y = np.asarray(place, dtype=np.float64) * _PITCH
    return np.array([x, -y])


def _draw_state(ax: Axes, state: State, drive: str) -> list[Artist]:
    from matplotlib.patches import FancyBboxPatch

    fill = _HMT if "HMT" in drive else _OSIF if "OSIF" in drive or "CALL" in drive else _INNER
    centre = _inches(PLACES[state])
    left, bottom = centre - _HALF
    width, height = 2 * _HALF
    line: dict[str, Any] = {"ls": (0, (4, 2)), "lw": 1.6} if state in OURS else {}
    box = FancyBboxPatch(
        (left, bottom), width, height, "round,pad=0,rounding_size=0.08", fc=fill, ec=_LINE, **line
    )
    x, y = centre
    middle: dict[str, Any] = {"ha": "center", "va": "center"}
    said = _words(state.name).replace(" holding", "\nholding")
    name = ax.text(x, y + 0.08, said, fontsize=7, weight="bold", linespacing=1.0, **middle)
    return [
        ax.add_patch(box),
        name,
        ax.text(x, y - 0.17, _words(drive), fontsize=7, style="italic", **middle),
    ]


def _words(name: str) -> str:
    """Return a name of the table in words; abbreviations stay in capitals."""
    return " ".join(w if w in {"HMT", "SMT", "OSIF"} else w.lower() for w in name.split("_"))


def _draw_arrow(ax: Axes, arrow: Arrow, aside: float) -> list[Artist]:
    corners = _DETOURS.get((arrow.source, arrow.target), ())
    way = np.array([_inches(p) for p in (PLACES[arrow.source], *corners, PLACES[arrow.target])])
    first, last = way[1] - way[0], way[-1] - way[-2]
    way = way + aside * np.array([last[1], -last[0]]) / np.hypot(*last)
    way[0] = way[0] + first * _inside(first)
    way[-1] = way[-1] - last * _inside(last)
    drawn: list[Artist] = []
    for ends in list(pairwise(way))[:-1]:
        drawn += ax.plot(*zip(*ends, strict=True), color=_LINE, lw=0.9, zorder=0)
    look: dict[str, Any] = {
        "arrowstyle": "-|>",
        "color": _LINE,
        "lw": 0.9,
        "shrinkA": 0,
        "shrinkB": 0,
    }
    head = ax.annotate("", way[-1], way[-2], arrowprops=look, zorder=0).arrow_patch
    assert head is not None, "it was asked for"
    x, y = (way[0] + way[1]) / 2 + 2.6 * aside * np.array([last[1], -last[0]]) / np.hypot(*last)
    y += 0.1 * (first[1] == 0)  # level arrows are short: their label stands above
    white = {"fc": "white", "ec": "none", "pad": 0.4}
    said = ax.text(
        x, y, _words(arrow.given.name), ha="center", va="center", fontsize=7, bbox=white, zorder=1
    )
    return [*drawn, head, said]


def _inside(direction: Points) -> float:
    """Return the part of an arrow that lies within the box at its end."""
    with np.errstate(divide="ignore"):
        return float(np.min(_HALF / np.abs(direction)))
