"""Figures: one style, and one function that saves them.

A figure is written as deterministic SVG and as PNG, with a JSON sidecar. The sidecar has log, parameters
and versions. It also has either the values that the figure shows, or the tables that it was drawn from with
their numbers of rows.
"""

from __future__ import annotations

import hashlib
import inspect
import io
import json
import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from pathlib import Path

    import pandas as pd
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from sfglab.lab.runs import Run


# The palette is based on that of Okabe and Ito, distinct for all common kinds of colour blindness. Blue is
# darker and green is lighter, so that the three methods which are compared most also differ in grey.
COLORS = {
    "standard": "#D55E00",
    "proxy": "#00528A",
    "network": "#999999",
    "third": "#26B58A",
    "fourth": "#CC79A7",
}
METHOD_COLORS = {
    "none": "#000000",
    "LC": COLORS["standard"],
    "OPT": COLORS["proxy"],
    "OPT+LC": COLORS["third"],
}
"""Colours of paper B's methods, the same in every figure."""
MARKERS = {"standard": "o", "proxy": "s", "network": "^", "third": "D", "fourth": "v"}
PAPER_STYLE: dict[str, Any] = {"linestyle": (0, (4, 2)), "linewidth": 1.4, "alpha": 0.75}
"""Style of a line with values of the paper: dashed, in the colour of our values of the same quantity."""

PAGE_DPI = 90  #: Resolution of images in a notebook, dots per inch.


def series(key: str) -> dict[str, Any]:
    """Return the colour and the marker of a series, by its key in `COLORS`."""
    return {"color": COLORS[key], "marker": MARKERS[key]}


def grouped_bars(axes: Axes, table: pd.DataFrame, colors: Iterable[str]) -> None:
    """Draw one group of bars per table row and one bar per column; a fifth of the axis is gaps."""
    count = len(table.columns)
    width = 0.8 / count
    columns = zip(table.columns, colors, strict=False)
    for place, (column, color) in enumerate(columns):
        at = np.arange(len(table)) + (place - (count - 1) / 2) * width
        axes.bar(at, table[column], width, label=column, color=color)
    axes.grid(visible=False, axis="x")


def note(figure: Figure, text: str, live: Run[Any] | None = None) -> None:
    """Write the origin of the values below a figure; for a live run, the note begins with its hosts."""
    where = f"live, {live.metadata('hosts')['description']}; " if live else ""
    figure.supxlabel(where + text, x=0.005, ha="left", fontsize=8.5, color="0.25")


def default_sidecar(run: Run[Any]) -> dict[str, Any]:
    """Return the sidecar of a figure from its run: machine, repetitions, and rows of the tables that were read."""
    machine = run.metadata("run").get("machine", {})
    tables = {}
    repetitions = 1
    for name in sorted(run.used):
        table = run[name]
        tables[name] = len(table)
        if "repeat" in table:
            repetitions = max(repetitions, table["repeat"].nunique())
    cpu = f"{machine.get('cpu', 'unknown')}, {machine.get('usable_cores', '?')} cores"
    return {"machine": cpu, "repetitions": repetitions, "tables": tables}


def add_note(figure: Figure, sidecar: Mapping[str, Any], *, measured: bool) -> None:
    """Append repetitions and machine of a sidecar, or "computed", to the note below a figure.

    A note that begins with "simulated" has its origin.
    """
    parts = [figure.get_supxlabel()]
    if sidecar["repetitions"] > 1:
        parts.append(f"{sidecar['repetitions']} repetitions")
    if measured:
        parts.append(f"run on {sidecar['machine']}")
    elif not parts[0].startswith("simulated"):
        parts.append("computed")
    note(figure, "; ".join(filter(None, parts)))


def lines(
    axes: Axes, frame: pd.DataFrame, styles: Mapping[Any, Mapping[str, Any]], **style: Any
) -> None:
    """Draw one line for each column of a table, over the table's index.

    Args:
        axes: Axes to draw into.
        frame: The values.
        styles: Properties of matplotlib's lines by column; other columns get matplotlib's defaults.
        style: Properties of all lines; they override `styles`.
    """
    for column in frame:
        properties = {**styles.get(column, {}), **style}
        axes.plot(frame.index, frame[column], **properties)


def bytes_axis(axes: Axes) -> None:
    """Make the x axis a logarithmic one of message sizes, with ticks such as ``10 kB``."""
    from matplotlib.ticker import EngFormatter, NullLocator

    axes.set(xscale="log", xlabel="message size")
    axes.xaxis.set_major_formatter(EngFormatter(unit="B"))
    axes.xaxis.set_minor_locator(NullLocator())


def paper_line(axes: Axes, value: float, *, at: float, below: bool) -> None:
    """Draw a value that the paper states as a dashed line across the y axis, with its number.

    Args:
        axes: Axes to draw into.
        value: The value.
        at: Place of the number along the line, from 0, left, to 1, right.
        below: Whether the number is below the line.
    """
    axes.axhline(value, color="black", **PAPER_STYLE)
    axes.annotate(
        f"paper: {value:g}",
        (at, value),
        xycoords=axes.get_yaxis_transform(),
        xytext=(0, -8 if below else 1),
        textcoords="offset points",
        ha="right",
        va="top" if below else "bottom",
        color="black",
    )


_RC: dict[Any, Any] = {
    "figure.dpi": 110,
    "savefig.dpi": 130,
    "font.size": 9.5,
    "axes.grid": True,
    "axes.axisbelow": True,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "grid.alpha": 0.25,
    "legend.frameon": False,
    "figure.constrained_layout.use": True,
    "svg.hashsalt": "sfglab",
    "svg.fonttype": "path",
}


@contextmanager
def house_style() -> Iterator[None]:
    """Draw in the project's style; matplotlib's own settings are restored afterwards."""
    import matplotlib as mpl

    with mpl.rc_context(_RC):
        yield


def drawn(size: tuple[float, float], draw: Callable[..., object], *args: Any) -> Figure:
    """Return a figure of a size in inches, into which a function has drawn in the project's style."""
    from matplotlib.figure import Figure

    with house_style():
        figure = Figure(figsize=size)
        draw(figure, *args)
    return figure


def save_figure(figure: Figure, stem: Path, twin: Mapping[str, Any]) -> list[Path]:
    """Write a figure as SVG and PNG, with its sidecar as JSON, to a path without suffix; return the files."""
    stem.parent.mkdir(parents=True, exist_ok=True)
    svg, png, note = (stem.with_name(stem.name + suffix) for suffix in (".svg", ".png", ".json"))
    with house_style():
        figure.savefig(svg, metadata={"Date": None, "Creator": "sfglab"})
        figure.savefig(png, metadata={"Software": "sfglab"})
    svg.write_text(_numbered(svg.read_text(encoding="utf-8")), encoding="utf-8")
    note.write_text(json.dumps(settled(twin), indent=2, sort_keys=True) + "\n", encoding="utf-8")
    return [svg, png, note]


def _numbered(svg: str) -> str:
    """Return an SVG with numbered marks and clips: their hashes depend on a coordinate's last digit."""
    hashed = re.findall(r'id="([a-z]+?)([0-9a-f]{10})"', svg)
    names = {
        kind + digest: f"{kind}{place}"
        for place, (kind, digest) in enumerate(dict.fromkeys(hashed), 1)
    }
    return re.sub(
        r'(?<=[#"])[a-z]+[0-9a-f]{10}(?=[")])', lambda found: names.get(found[0], found[0]), svg
    )


def settled(value: Any) -> Any:
    """Return a sidecar's values, with as many digits of each number as are equal on all processors."""
    if isinstance(value, Mapping):
        return {key: settled(each) for key, each in value.items()}
    if isinstance(value, list | tuple):
        return [settled(each) for each in value]
    return float(f"{round(value, 12):.10g}") if isinstance(value, float) else value


def png_of(figure: Figure) -> bytes:
    """Return a figure as PNG, in the size of a page."""
    buffer = io.BytesIO()
    with house_style():
        figure.savefig(buffer, format="png", dpi=PAGE_DPI)
    return buffer.getvalue()


def few_colors(png: bytes, size: tuple[int, int] = (4096, 4096), colors: int = 128) -> bytes:
    """Return an image with few colours, no larger than a size in pixels: a quarter of the bytes or less."""
    from PIL import Image

    buffer = io.BytesIO()
    with Image.open(io.BytesIO(png)) as picture:
        small = picture.convert("RGB")
        small.thumbnail(size)
        small.quantize(colors).save(buffer, "png", optimize=True)
    return buffer.getvalue()


def caption_of(thing: object) -> str:
    """Return the caption of a function or a class: the first paragraph of its documentation."""
    text = (inspect.getdoc(thing) or "").partition("\n\n")[0]
    said = " ".join(text.removeprefix("Draw ").split())
    return said[:1].upper() + said[1:]


def file_sha256(path: Path) -> str:
    """Return the SHA-256 of a file as hexadecimal digits."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
