"""A figure whose parts are pressed: artists that `part` has named send their name when the mouse is on them.

Every press is answered by Python, which draws the figure anew: no rule is repeated in the page. Where no kernel
runs, the same output shows the figure as a still.
"""

from __future__ import annotations

import base64
import io
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from sfglab.lab.figures import caption_of, drawn, few_colors, house_style, png_of
from sfglab.view.widgets import attempt, front_end, widgets

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from matplotlib.artist import Artist
    from matplotlib.figure import Figure


def part(name: str, *artists: Artist) -> None:
    """Make artists a part of the figure that can be pressed under a name; it is in the SVG alone."""
    for artist in artists:
        artist.set_gid(f"press:{name}")


def still_bundle(widget: Any, png: bytes, about: object) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return what a cell shows: the widget, and in the same output a picture for those who have no kernel.

    The picture's text, in the output's metadata, is what documents the thing that it is about.
    """
    picture = {"image/png": base64.b64encode(png).decode()}
    return widget._repr_mimebundle_() | picture, {"image/png": {"alt": caption_of(about)}}


class Pressed:
    """A figure to press. `widget` is what a cell shows.

    Args:
        draw: Draws the present state into an empty figure, its parts marked by `part`.
        size: Width and height of the figure, inches.
        press: Called with the name of the part that was pressed; the figure is drawn anew afterwards. What it
            raises, if it is ours, stands below the figure.
        titles: Returns the sentence that a part shows under the mouse, by part.
        above: Widgets above the figure.

    Raises:
        MissingExtraError: The extra ``view`` is not installed.
    """

    def __init__(
        self,
        draw: Callable[[Figure], object],
        *,
        size: tuple[float, float],
        press: Callable[[str], object],
        titles: Callable[[], Mapping[str, str]] = dict,
        above: Sequence[Any] = (),
    ) -> None:
        self._draw, self._size, self._press, self._titles = draw, size, press, titles
        self._said = widgets().HTML()
        self._figure = _svg_widget()(svg=self._svg(), titles=dict(titles()), alt=caption_of(type(self)))
        self._figure.observe(lambda change: self.press(change["new"]["part"]), "pressed")
        self.widget = widgets().VBox([*above, self._figure, self._said])

    def press(self, name: str) -> None:
        """Press a part, as the mouse does."""
        self.answer(lambda: self._press(name))

    def answer(self, action: Callable[[], object]) -> None:
        """Do something that changes what is drawn, say what it refuses, and draw anew."""
        if attempt(action, self._said):
            self.redraw()

    def redraw(self) -> None:
        """Draw the present state."""
        self._figure.titles = dict(self._titles())
        self._figure.svg = self._svg()

    @property
    def said(self) -> str:
        """The sentence below the figure, as HTML; empty: nothing was refused."""
        text: str = self._said.value
        return text

    def _repr_mimebundle_(self, **_: object) -> tuple[dict[str, Any], dict[str, Any]]:
        return still_bundle(self.widget, few_colors(png_of(drawn(self._size, self._draw))), type(self))

    def _svg(self) -> str:
        import matplotlib as mpl

        buffer = io.StringIO()
        # Text as text is small, and the page's fonts draw it.
        with house_style(), mpl.rc_context({"svg.fonttype": "none"}):
            drawn(self._size, self._draw).savefig(buffer, format="svg")
        return "<svg" + buffer.getvalue().partition("<svg")[2]


@cache
def _svg_widget() -> Any:
    """Return the class of the front-end part."""
    traits = {"svg": "Unicode", "titles": "Dict", "pressed": "Dict", "alt": "Unicode"}
    return front_end(Path(__file__).with_name("press.js"), traits)
