"""Plots of explorers as values: panels of lines and points on fixed axes.

An explorer's function returns a `Picture`. `sfglab.lab.explore.vega` draws it.
"""

from __future__ import annotations

from dataclasses import KW_ONLY, dataclass
from typing import TYPE_CHECKING, Any, Literal

from sfglab.errors import InvalidValueError

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    import pandas as pd


@dataclass(frozen=True, slots=True)
class Axis:
    """An axis. Finite limits are fixed, so that plots of different settings can be compared.

    A linear axis without an upper limit ends at the highest value of the plot and its outlines.
    """

    quantity: str  #: Name of the quantity.
    unit: str  #: Unit of the quantity; empty: none.
    low: float  #: Lowest value that is shown.
    high: float  #: Highest value that is shown; infinite: no upper limit.
    _: KW_ONLY
    log: bool = False  #: Whether the axis is logarithmic.
    ticks: tuple[float, ...] = ()  #: Values with a label; empty: Vega chooses them.
    si: bool = False  #: Whether labels have SI prefixes, as ``10k``.

    @property
    def label(self) -> str:
        """Name and unit of the quantity."""
        return f"{self.quantity} ({self.unit})" if self.unit else self.quantity

    def text(self, value: float) -> str:
        """Return a value with its unit, to four significant digits, or as a whole number."""
        number = f"{value:,}" if isinstance(value, int) else f"{value:.4g}"
        return f"{number} {self.unit}".strip()


Kind = Literal["line", "path", "dot"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Series:
    """Values of one name and colour."""

    name: str  #: Name in the legend.
    color: str  #: Colour, as ``#RRGGBB``.
    x: Sequence[float]  #: Positions; whole numbers are shown with all their digits.
    y: Sequence[float]  #: Values.
    #: Kind of the marks: a line joins the values from left to right, a path joins them in their order, dots
    #: are not joined.
    kind: Kind = "line"


def curve(name: str, color: str, x: Sequence[float], y: Sequence[float]) -> tuple[Series, Series]:
    """Return a line through all values except the last, and a dot at the last."""
    line = Series(name=name, color=color, x=x[:-1], y=y[:-1])
    return line, Series(name=name, color=color, x=x[-1:], y=y[-1:], kind="dot")


def lines(
    table: pd.DataFrame, colors: Mapping[str, str], kind: Kind = "line"
) -> tuple[Series, ...]:
    """Return a series for each column of a table, over the table's index, without missing values."""
    series = []
    for name in table:
        values = table[name].dropna()
        x, y = values.index.tolist(), values.tolist()
        series.append(Series(name=str(name), color=colors[str(name)], x=x, y=y, kind=kind))
    return tuple(series)


@dataclass(frozen=True, slots=True, kw_only=True)
class Panel:
    """Series on the same axes."""

    title: str  #: Title, unique in the plot.
    x: Axis  #: Horizontal axis.
    y: Axis  #: Vertical axis.
    series: tuple[Series, ...]  #: Series; lines first.
    note: str = ""  #: Line below the title.


@dataclass(frozen=True, slots=True, kw_only=True)
class Picture:
    """Plot of an explorer for one setting.

    Panels, their titles, axes, and the names, kinds and colours of series are the same for all
    settings of an explorer.
    """

    said: str  #: Sentence that describes the plot; it is also the plot's alternative text.
    panels: tuple[Panel, ...]  #: Panels, from left to right.

    def at(self, panel: str, x: float) -> pd.DataFrame:
        """Return the values of a panel at a position, one row per series; a path has none.

        Raises:
            InvalidValueError: There is no such panel, or no series has a value at that position.
        """
        import pandas as pd

        table = pd.DataFrame(self.values())
        is_value = table["kind"] != "path"
        chosen = table[is_value & (table["panel"] == panel) & (table["x"] == x)]
        if chosen.empty:
            titles = ", ".join(one.title for one in self.panels)
            raise InvalidValueError("panel and position", (panel, x), f"a value of {titles}")
        # A position is often both on a line and a dot of the same name.
        columns = ["panel", "x", "series", "y", "unit"]
        return chosen[columns].drop_duplicates(ignore_index=True)

    def values(self) -> Iterator[dict[str, Any]]:
        """Yield all values, with the numbers of panel, series and value, and a sentence for each."""
        for place, panel in enumerate(self.panels):
            for part, series in enumerate(panel.series):
                for number, (x, y) in enumerate(zip(series.x, series.y, strict=True)):
                    yield {
                        "place": place,
                        "part": part,
                        "number": number,
                        "panel": panel.title,
                        "kind": series.kind,
                        "series": series.name,
                        "x": x,
                        "y": float(y),
                        "unit": panel.y.unit,
                        "words": f"{series.name}: {panel.y.text(y)} at {panel.x.text(x)}",
                    }
