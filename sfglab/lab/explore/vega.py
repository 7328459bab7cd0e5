"""Plots drawn by Vega: in the page through anywidget, and as a still image without a browser.

Altair writes the specification once from a `Picture`; afterwards only values are sent. The script
of Vega comes from vl-convert-python, which also draws the still. Nothing here computes a value.
"""

from __future__ import annotations

import gzip
import math
import os
from contextlib import suppress
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any

from sfglab.lab.figures import COLORS, few_colors
from sfglab.lab.iri_grammars import without_iri_grammars
from sfglab.view.widgets import front_end

if TYPE_CHECKING:
    from sfglab.lab.pictures import Axis, Panel, Picture

    Rows = dict[str, list[dict[str, Any]]]

_PANEL_SIZE = 200  # width and height of a panel in the still; the page sets the width
_MARGIN = 64  # between two panels, for an axis: a long title or note does not move them
_STILL_SCALE = 1.5
_GHOST = {"opacity": 0.45, "aria": False, "clip": True}
_DARK_COLORS = {
    "standard": "#FF8A3D",
    "proxy": "#58A9E0",
    "network": "#999999",
    "third": "#3CCB9C",
    "fourth": "#E39CC4",
}
"""Colours of `COLORS` on a dark background."""
_POINT = ("place", "series", "x", "y", "words")
_PATH = ("part", "number", "series", "x", "y")
REFERENCE = "reference"  #: Name of the outlines of the setting at the start.
LAST = "last"  #: Name of the outlines of the previous setting.


# --- Values -----------------------------------------------------------------------------------


def rows_of(picture: Picture) -> Rows:
    """Return the rows of a plot by data set: lines, paths, dots and notes of each panel."""
    rows: Rows = {}
    for place, panel in enumerate(picture.panels):
        rows |= {f"line{place}": [], f"path{place}": [], f"dot{place}": []}
        rows[f"note{place}"] = [{"note": panel.note}]
    for value in picture.values():
        kind = value["kind"]
        names = _PATH if kind == "path" else _POINT
        rows[f"{kind}{value['place']}"].append({name: value[name] for name in names})
    return rows


def ghosts_of(picture: Picture, name: str) -> Rows:
    """Return the rows of a plot's lines as faint outlines, in the data set `name`."""
    rows = rows_of(picture)
    return {f"{name}{place}": rows[f"line{place}"] for place in range(len(picture.panels))}


# --- The specification ------------------------------------------------------------------------


def specification(picture: Picture) -> dict[str, Any]:
    """Return the Vega-Lite specification of plots with the panels of this one, without rows."""
    with without_iri_grammars():
        import altair as alt

    colors = {}
    for panel in picture.panels:
        colors.update({series.name: series.color for series in panel.series})
    color = (
        alt.Color("series:N")
        .scale(domain=list(colors), range=list(colors.values()))
        .legend(title=None, orient="bottom", symbolOpacity=1)
    )
    charts = []
    for place, panel in enumerate(picture.panels):
        charts.append(_panel_chart(place, panel, color))
    ink = "currentColor"  # the text colour of JupyterLab's theme
    lines = dict.fromkeys(
        ("labelColor", "titleColor", "domainColor", "tickColor", "gridColor"), ink
    )
    chart = (
        alt.hconcat(*charts, background="transparent", spacing=_MARGIN, bounds="flush")
        .configure_view(stroke=None)
        .configure_axis(**lines, gridOpacity=0.15, titleFontWeight="normal")
        .configure_legend(labelColor=ink)
        .configure_title(color=ink, fontSize=11, offset=16)
    )
    made: dict[str, Any] = chart.to_dict(validate=False)
    return made


def _panel_chart(place: int, panel: Panel, color: Any) -> Any:
    import altair as alt

    x = _channel(alt.X("x:Q"), panel.x)
    y = _channel(alt.Y("y:Q"), panel.y)

    def layer(name: str) -> Any:
        return alt.Chart(alt.NamedData(f"{name}{place}"))

    words = {"tooltip": "words:N", "description": "words:N"}
    dot = layer("dot")
    layers = [
        layer(REFERENCE).mark_line(strokeDash=[2, 3], **_GHOST).encode(x, y, color),
        layer(LAST).mark_line(strokeWidth=1, **_GHOST).encode(x, y, color),
        layer("line").mark_line(clip=True, aria=False).encode(x, y, color),
        layer("path")
        .mark_line(clip=True, aria=False, strokeWidth=1.5)
        .encode(x, y, color, detail="part:N", order="number:Q"),
        # A line has one tooltip for all its points. So the page fills invisible points for the mouse.
        layer("hover")
        .mark_circle(size=250, opacity=0, aria=False, cursor="pointer", clip=True)
        .encode(x, y, tooltip="words:N"),
        dot.mark_circle(size=70, opacity=1, cursor="pointer", clip=True).encode(
            x, y, color, **words
        ),
        layer("note")
        .mark_text(align="left", baseline="bottom", dy=-4, color="currentColor")
        .encode(x=alt.value(0), y=alt.value(0), text="note:N"),
    ]
    title = alt.Title(panel.title, anchor="start", frame="group")
    return alt.layer(*layers).properties(width=_PANEL_SIZE, height=_PANEL_SIZE, title=title)


def _channel(channel: Any, axis: Axis) -> Any:
    """Return a channel of positions with the limits and ticks of an axis."""
    kind = "log" if axis.log else "linear"
    if math.isinf(axis.high):
        scale = channel.scale(domainMin=axis.low, nice=True)
    else:
        scale = channel.scale(type=kind, domain=[axis.low, axis.high], nice=False)
    ticks = {"values": list(axis.ticks)} if axis.ticks else {}
    return scale.axis(format="~s" if axis.si else ".6~g", **ticks).title(axis.label)


# --- The page and the still -------------------------------------------------------------------

_TRAITS = {
    "library": "Unicode",  # reference to the model that holds the script
    "spec": "Dict",
    "rows": "Dict",
    "ghosts": "Dict",
    "said": "Unicode",
    "asked": "Int",  # number of the newest request
    "answer": "Dict",  # its number, and whether the figure is the whole one, coarse, or refused
}


def figure_widget(picture: Picture) -> Any:
    """Return the widget that draws a plot in the page.

    Raises:
        MissingExtraError: The extra ``view`` is not installed.
    """
    return _figure_class()(
        library=f"anywidget:{_script_model().model_id}",
        spec=specification(picture),
        rows=rows_of(picture),
        ghosts=ghosts_of(picture, REFERENCE),
        said=picture.said,
        answer={"of": 0, "is": "whole"},
    )


def still_png(spec: dict[str, Any], rows: Rows) -> bytes:
    """Return a figure as PNG, drawn without a browser."""
    from vl_convert import vegalite_to_png

    whole = {**spec, "datasets": rows, "background": "white"}
    return few_colors(vegalite_to_png(whole, scale=_STILL_SCALE), colors=64)


@cache
def _figure_class() -> Any:
    return front_end(Path(__file__).with_name("vega.js"), _TRAITS, _css())


@cache
def _script_model() -> Any:
    """Return the widget model that loads Vega's script into the page, once for all figures of a kernel."""
    traits = {"key": "Unicode", "packed": "Bytes"}
    widget = front_end(Path(__file__).with_name("vega.js"), traits)
    return widget(key=_script_key(), packed=_packed_script())


def _script_key() -> str:
    return f"vega-vl-convert-{version('vl-convert-python')}"


def _packed_script() -> bytes:
    """Return the ES module of Vega, packed. It is kept in the user's cache, because making it is slow."""
    cache_folder = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    path = Path(cache_folder, "sfglab", f"{_script_key()}.js.gz")
    if path.is_file():
        return path.read_bytes()
    from vl_convert import javascript_bundle

    code = javascript_bundle("export default vegaEmbed;")
    packed = gzip.compress(code.encode(), mtime=0)
    with suppress(OSError):  # a read-only home: the script is made again for each kernel
        path.parent.mkdir(parents=True, exist_ok=True)
        part = path.with_suffix(f".{os.getpid()}")
        part.write_bytes(packed)
        part.replace(path)
    return packed


def _css() -> str:
    """Return style rules, some of which give marks other colours in a dark theme, whenever the theme changes."""
    css = _STYLE
    for name, light in COLORS.items():
        for attribute in ("fill", "stroke"):
            mark = f'[data-jp-theme-light="false"] .sfglab-vega [{attribute}="{light}"]'
            css += f"{mark} {{ {attribute}: {_DARK_COLORS[name]} }}\n"
    return css


_STYLE = """
.sfglab-vega { position: relative; overflow-x: clip; color: var(--jp-content-font-color1, currentColor) }
.sfglab-vega svg { display: block; overflow: visible }
.sfglab-vega.stale svg { opacity: 0.5 }
.sfglab-vega [role="status"] { min-height: 1.4em }
.sfglab-vega [tabindex]:focus-visible { outline: 2px solid currentColor }
.jupyter-widgets-disconnected .sfglab-vega::after {
  content: "The kernel has ended: run the cell again." }
#vg-tooltip-element.sfglab-theme {
  background: var(--jp-layout-color1, white); color: var(--jp-content-font-color1, black);
  border: 1px solid currentColor }
"""
