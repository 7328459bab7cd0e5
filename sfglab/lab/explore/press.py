"""Interactive figures: a click on an artist that `part` has named sends this name to Python.

Python answers each click and draws the figure again. Without a kernel, the output is a static image. In the
figure of an `Automaton`, a click on an edge applies the edge's input to the machine's table, and the
transition is highlighted.
"""

from __future__ import annotations

import base64
import io
from dataclasses import dataclass
from enum import Enum
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

from sfglab.lab.figures import COLORS, caption_of, drawn, few_colors, house_style, png_of
from sfglab.machine import step
from sfglab.view.widgets import attempt, button, front_end, widgets

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Mapping, Sequence

    from matplotlib.artist import Artist
    from matplotlib.figure import Figure


#: Data and metadata of a cell's output, by MIME type.
Bundle: TypeAlias = tuple[dict[str, Any], dict[str, Any]]


def part(name: str, *artists: Artist) -> None:
    """Name artists, so that a click on them sends the name; the name is in the SVG alone."""
    for artist in artists:
        artist.set_gid(f"press:{name}")


def still_bundle(widget: Any, png: bytes, about: object) -> Bundle:
    """Return the output of a cell: the widget, and an image for a page without a kernel.

    The alternative text of the image is `about` if it is a text, or the first paragraph of its documentation.
    """
    alt = about if isinstance(about, str) else caption_of(about)
    picture = {"image/png": base64.b64encode(png).decode()}
    return widget._repr_mimebundle_() | picture, {"image/png": {"alt": alt}}


class Pressed:
    """A figure with parts to click; a cell shows its `widget`.

    Args:
        draw: Function that draws the present state into an empty figure, and names parts with `part`.
        size: Width and height of the figure, inches.
        press: Function that takes the name of the clicked part; the figure is drawn again afterwards. Errors of
            sfglab are printed below the figure. A figure without parts needs none.
        titles: Function that returns the tooltip of each part.
        above: Widgets above the figure.

    Raises:
        MissingExtraError: The extra ``view`` is not installed.
    """

    def __init__(
        self,
        draw: Callable[[Figure], object],
        *,
        size: tuple[float, float],
        press: Callable[[str], object] = lambda _: None,
        titles: Callable[[], Mapping[str, str]] = dict,
        above: Sequence[Any] = (),
    ) -> None:
        self._draw, self._size, self._press, self._titles = draw, size, press, titles
        self._said = widgets().HTML()
        self._figure = _svg_widget()(
            svg=self._svg(), titles=dict(titles()), alt=caption_of(type(self))
        )
        self._figure.observe(lambda change: self.press(change["new"]["part"]), "pressed")
        self.widget = widgets().VBox([*above, self._figure, self._said])

    def press(self, name: str) -> None:
        """Answer a click on a part."""
        self.answer(lambda: self._press(name))

    def answer(self, action: Callable[[], object]) -> None:
        """Call a function that changes the drawn state, print its error below the figure, and draw again."""
        if attempt(action, self._said):
            self.redraw()

    def redraw(self) -> None:
        """Draw the present state."""
        self._figure.titles = dict(self._titles())
        self._figure.svg = self._svg()

    @property
    def said(self) -> str:
        """Error below the figure, as HTML; empty: none."""
        return str(self._said.value)

    def _repr_mimebundle_(self, **_: object) -> Bundle:
        return still_bundle(
            self.widget, few_colors(png_of(drawn(self._size, self._draw))), type(self)
        )

    def _svg(self) -> str:
        import matplotlib as mpl

        buffer = io.StringIO()
        # Text as text is small, and the page's fonts draw it.
        with house_style(), mpl.rc_context({"svg.fonttype": "none"}):
            drawn(self._size, self._draw).savefig(buffer, format="svg")
        return "<svg" + buffer.getvalue().partition("<svg")[2]


@cache
def _svg_widget() -> Any:
    """Return the class of the widget that shows the SVG."""
    traits = {"svg": "Unicode", "titles": "Dict", "pressed": "Dict", "alt": "Unicode"}
    return front_end(Path(__file__).with_name("press.js"), traits)


#: A state and an input that is allowed in it: a key of a table.
Transition: TypeAlias = tuple[Enum, Enum]
Parts: TypeAlias = "Mapping[Any, Sequence[Artist]]"
"""Artists of each state, its box first, and of each tuple of transitions that share an arrow."""


def transition_part(source: Enum, given: Enum) -> str:
    """Return the name of the part of a transition; the name of a state's part is the state's name."""
    return f"{source.name}/{given.name}"


@dataclass(frozen=True, slots=True, kw_only=True)
class Moment:
    """State of a machine after a click."""

    state: Enum  #: The present state.
    #: Transition that led to the state; None at the beginning, and after a click on a state.
    taken: Transition | None = None
    said: str = ""  #: Sentence about the last click.

    def color(self, moves: Collection[Transition]) -> str:
        """Return the colour of transitions that share an arrow: just taken, allowed now, or neither."""
        if self.taken in moves:
            return COLORS["standard"]
        return COLORS["proxy"] if any(source is self.state for source, _ in moves) else "#6F6F6F"

    def show(self, drawn: Parts) -> None:
        """Highlight the state and its transition in the drawn table, and name all parts."""
        from matplotlib.text import Text

        for of, artists in drawn.items():
            if isinstance(of, Enum):
                part(of.name, *artists)
                if of is self.state:
                    artists[0].set(edgecolor=COLORS["standard"], linewidth=3.0)
                continue
            part(transition_part(*of[0]), *artists)
            for artist in artists:
                artist.set(color=self.color(of))
                unseen = artist.get_alpha() == 0  # a broad line that is easier to click
                if self.taken in of and not unseen and not isinstance(artist, Text):
                    artist.set(linewidth=3.0)


class Automaton(Pressed):
    """An interactive state machine: a click on an edge applies its input, a click on a state sets the state.

    Args:
        name: Name of the machine in messages.
        table: Next state by state and input, or a pair of the next state and its actions.
        start: First state.
        draw: Function that draws the table into an empty figure, and returns the artists.
        size: Width and height of the figure, inches.
        runs: Recorded runs by name, as their inputs from the first state on.

    Raises:
        MissingExtraError: The extra ``view`` is not installed.
    """

    def __init__(  # noqa: PLR0913  # a machine, how it is drawn, what is stepped through
        self,
        name: str,
        table: Mapping[Any, Any],
        start: Enum,
        draw: Callable[[Figure], Parts],
        *,
        size: tuple[float, float],
        runs: Mapping[str, Sequence[Enum]] | None = None,
    ) -> None:
        self._name, self._begin = name, Moment(state=start, said=f"begins in {start.name}")
        self._table = {
            key: to if isinstance(to, tuple) else (to, None) for key, to in table.items()
        }
        self._runs = {**(runs or {}), "by hand": ()}
        self._past = [self._begin]
        self._states = {state.name: state for state in type(start)}
        self._moves = {transition_part(*key): key for key in table}
        kit = widgets()
        self.choice = kit.Dropdown(options=list(self._runs), description="run")
        self.at = kit.IntSlider(max=0, description="step", layout={"width": "30em"})
        self.back = button("Back", lambda: self.answer(self._undo), "As it was before")
        self._news = kit.HTML()
        self._choose()
        self._tell()
        super().__init__(
            lambda figure: self.moment.show(draw(figure)),
            size=size,
            press=self._take,
            titles=self._titled,
            above=[kit.HBox([self.choice, self.at, self.back]), self._news],
        )
        self.choice.observe(lambda _: self.answer(self._choose), "value")
        self.at.observe(lambda _: self.answer(self._replay), "value")

    @property
    def moment(self) -> Moment:
        """Present state of the machine."""
        return self._past[-1]

    def redraw(self) -> None:
        """Draw the present state."""
        self._tell()
        super().redraw()

    def _tell(self) -> None:
        self._news.value = f"{len(self._past) - 1}: {self.moment.said}"

    def feed(self, given: Enum) -> None:
        """Apply an input, or raise an `IllegalInputError`."""
        key = self.moment.state, given
        after, _ = step(self._name, self._table, *key)
        self._past.append(Moment(state=after, taken=key, said=self._words(key)))

    def _words(self, key: Transition) -> str:
        """Return a sentence about a transition: next state and actions."""
        (source, given), (after, done) = key, self._table[key]
        actions = [
            action.name for action in (done if isinstance(done, tuple) else (done,)) if action
        ]
        said = f"{given.name} in {source.name} leads to {after.name}"
        return said + (f": {'; '.join(actions)}" if actions else "")

    def _take(self, name: str) -> None:
        if name in self._moves:
            self.feed(self._moves[name][1])
        else:
            state = self._states[name]
            self._past.append(Moment(state=state, said=f"put into {state.name}"))

    def _titled(self) -> dict[str, str]:
        moves = {name: self._words(key) for name, key in self._moves.items()}
        return moves | {name: f"Put the machine into {name}" for name in self._states}

    def _choose(self) -> None:
        self.at.value, self.at.max = 0, len(self._runs[self.choice.value])
        self.at.disabled = not self.at.max
        self._replay()

    def _replay(self) -> None:
        self._past = [self._begin]
        for given in self._runs[self.choice.value][: self.at.value]:
            self.feed(given)

    def _undo(self) -> None:
        if len(self._past) > 1:
            self._past.pop()
