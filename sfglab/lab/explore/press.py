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

from sfglab.lab.explore.form import explorer_box
from sfglab.lab.figures import COLORS, caption_of, drawn, few_colors, house_style, png_of
from sfglab.machine import step
from sfglab.view.widgets import attempt, front_end, widgets

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from matplotlib.artist import Artist
    from matplotlib.figure import Figure


#: Data and metadata of a cell's output, by MIME type.
Bundle: TypeAlias = tuple[dict[str, Any], dict[str, Any]]


def part(name: str, *artists: Artist) -> None:
    """Give artists a name, which a click on them sends; the name is only in the SVG."""
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

    A subclass draws the figure and answers clicks. The first paragraph of its documentation is the
    alternative text of the figure.

    Args:
        size: Width and height of the figure, inches.
        above: Widgets above the figure.

    Raises:
        MissingExtraError: The extra ``view`` is not installed.
    """

    def __init__(self, size: tuple[float, float], above: Sequence[Any] = ()) -> None:
        self._size = size
        self._said = widgets().HTML()
        self._figure = _svg_widget()(alt=caption_of(type(self)))
        self._figure.on_msg(lambda _widget, name, _buffers: self.press(name))
        self.redraw()
        self.widget = explorer_box([*above, self._figure, self._said])

    def draw(self, figure: Figure) -> None:
        """Draw the present state into an empty figure, and name its parts with `part`."""
        raise NotImplementedError

    def take(self, name: str) -> None:
        """Answer a click on a part; the figure is drawn again afterwards, or an error of sfglab is shown."""

    def titles(self) -> dict[str, str]:
        """Return the tooltip of each part, by the part's name."""
        return {}

    def press(self, name: str) -> None:
        """Answer a click on a part, as the page does."""
        self.answer(lambda: self.take(name))

    def answer(self, action: Callable[[], object]) -> None:
        """Call a function that changes the drawn state, print its error below the figure, and draw again."""
        if attempt(action, self._said):
            self.redraw()

    def redraw(self) -> None:
        """Draw the present state again, with the tooltips of its parts."""
        self._figure.titles = self.titles()
        self._figure.svg = self._svg()

    @property
    def said(self) -> str:
        """Error that is shown below the figure, as HTML; empty without an error."""
        return str(self._said.value)

    def _repr_mimebundle_(self, **_: object) -> Bundle:
        png = few_colors(png_of(drawn(self._size, self.draw)))
        return still_bundle(self.widget, png, type(self))

    def _svg(self) -> str:
        import matplotlib as mpl

        buffer = io.StringIO()
        # Text as text is small, and the page's fonts draw it.
        with house_style(), mpl.rc_context({"svg.fonttype": "none"}):
            drawn(self._size, self.draw).savefig(buffer, format="svg")
        return "<svg" + buffer.getvalue().partition("<svg")[2]


@cache
def _svg_widget() -> Any:
    """Return the class of the widget that shows the SVG."""
    traits = {"svg": "Unicode", "titles": "Dict", "alt": "Unicode"}
    return front_end(Path(__file__).with_name("press.js"), traits)


#: A state and an input that is allowed in it: a key of a table.
Transition: TypeAlias = tuple[Enum, Enum]
Parts: TypeAlias = "Mapping[Any, Sequence[Artist]]"
"""Artists of each state, its box first, and of each tuple of transitions that share an arrow."""


def transition_part(source: Enum, given: Enum) -> str:
    """Return the name of the part of a transition; the name of a state's part is the state's name."""
    return f"{source.name}/{given.name}"


@dataclass(frozen=True, slots=True)
class Moment:
    """State of a machine after a click."""

    state: Enum  #: The present state.
    said: str  #: Sentence about the last click.
    #: Transition that led to the state; None at the beginning, and after a click on a state.
    taken: Transition | None = None


class Automaton(Pressed):
    """An interactive state machine: a click on an edge applies its input, a click on a state sets the state.

    Args:
        name: Name of the machine in messages.
        table: Next state and actions by state and input.
        start: First state.
        draw_table: Function that draws the table into an empty figure, and returns the artists.
        size: Width and height of the figure, inches.
        runs: Recorded runs by name, as their inputs from the first state on.

    Raises:
        MissingExtraError: The extra ``view`` is not installed.
    """

    def __init__(  # noqa: PLR0913  # a machine, how it is drawn, what is stepped through
        self,
        name: str,
        table: Mapping[Any, tuple[Any, Sequence[Enum]]],
        start: Enum,
        draw_table: Callable[[Figure], Parts],
        *,
        size: tuple[float, float],
        runs: Mapping[str, Sequence[Enum]] | None = None,
    ) -> None:
        self._name = name
        self._table = table
        self._start = start
        self._draw_table = draw_table
        self._runs = {**(runs or {}), "by hand": ()}
        self._states = {state.name: state for state in type(start)}
        self._moves = {transition_part(*key): key for key in table}
        self._moments: list[Moment] = []  # of the run, and of the clicks after a step of it
        kit = widgets()
        self.choice = kit.Dropdown(options=list(self._runs), description="run")
        #: Slider over the steps of the run, and over the clicks after them.
        self.at = kit.IntSlider(description="step", layout={"width": "30em"})
        self._news = kit.HTML()
        self._choose()
        super().__init__(size, [kit.HBox([self.choice, self.at]), self._news])
        self.choice.observe(lambda _: self.answer(self._choose), "value")
        self.at.observe(lambda _: self.answer(lambda: None), "value")

    @property
    def moment(self) -> Moment:
        """Present state of the machine."""
        number: int = self.at.value
        return self._moments[number]

    def redraw(self) -> None:
        """Draw the present state."""
        self._news.value = f"{self.at.value}: {self.moment.said}"
        super().redraw()

    def draw(self, figure: Figure) -> None:
        """Draw the table, highlight the state and its transition, and name all parts."""
        from matplotlib.text import Text

        moment = self.moment
        for of, artists in self._draw_table(figure).items():
            if isinstance(of, Enum):
                part(of.name, *artists)
                if of is moment.state:
                    artists[0].set(edgecolor=COLORS["standard"], linewidth=3.0)
                continue
            part(transition_part(*of[0]), *artists)
            is_taken = moment.taken in of
            color = "#6F6F6F"
            if is_taken:
                color = COLORS["standard"]
            elif any(source is moment.state for source, _ in of):
                color = COLORS["proxy"]
            for artist in artists:
                artist.set(color=color)
                unseen = artist.get_alpha() == 0  # a broad line that is easier to click
                if is_taken and not unseen and not isinstance(artist, Text):
                    artist.set(linewidth=3.0)

    def press(self, name: str) -> None:
        """Apply the input of an edge, or set a state; the slider moves, and steps after it go."""
        attempt(lambda: self.take(name), self._said)

    def take(self, name: str) -> None:
        """Continue with the moment after a click."""
        if name in self._moves:
            moment = self._fed(self.moment.state, self._moves[name][1])
        else:
            moment = Moment(self._states[name], f"put into {name}")
        self._moments = [*self._moments[: self.at.value + 1], moment]
        self.at.max = len(self._moments) - 1
        self.at.value = self.at.max

    def titles(self) -> dict[str, str]:
        """Return the effect of a click on each part."""
        titles = {name: f"Put the machine into {name}" for name in self._states}
        return titles | {name: self._words(key) for name, key in self._moves.items()}

    def _choose(self) -> None:
        """Begin the chosen run."""
        self._moments = [Moment(self._start, f"begins in {self._start.name}")]
        for given in self._runs[self.choice.value]:
            state = self._moments[-1].state
            self._moments.append(self._fed(state, given))
        self.at.value = 0
        self.at.max = len(self._moments) - 1

    def _fed(self, state: Enum, given: Enum) -> Moment:
        """Return the moment after an input in a state.

        Raises:
            IllegalInputError: The table has no transition for the input in this state.
        """
        after, _ = step(self._name, self._table, state, given)
        return Moment(after, self._words((state, given)), (state, given))

    def _words(self, key: Transition) -> str:
        """Return a sentence about a transition: next state and actions."""
        source, given = key
        after, actions = self._table[key]
        names = ": " + "; ".join(action.name for action in actions) if actions else ""
        return f"{given.name} in {source.name} leads to {after.name}{names}"
