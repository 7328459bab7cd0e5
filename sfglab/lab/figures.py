"""Figures: one style, one `save`, one JSON twin beside each picture.

A picture is written as deterministic SVG and as PNG; the twin says from which log, parameters and versions
it comes and which numbers it shows, so that nobody has to guess whether a figure is current. Drawing itself
is done by the experiments, in functions that take axes.
"""

from __future__ import annotations

import hashlib
import json
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping
    from pathlib import Path

    from matplotlib.figure import Figure


# Okabe and Ito's palette, distinct for all common kinds of colour blindness; ordered by lightness so that
# the two first differ in grey as well.
COLORS = {
    "standard": "#D55E00",
    "proxy": "#0072B2",
    "network": "#999999",
    "third": "#009E73",
    "fourth": "#CC79A7",
}
MARKERS = {"standard": "o", "proxy": "s", "network": "^", "third": "D", "fourth": "v"}
PAPER_STYLE: dict[str, Any] = {"linestyle": (0, (4, 2)), "linewidth": 1.4, "alpha": 0.75}
"""How a paper's own line is drawn beside ours: dashed, in the colour of what it states."""

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
    """Draw in the project's style; matplotlib's own settings are as before afterwards."""
    import matplotlib as mpl

    with mpl.rc_context(_RC):
        yield


def save_figure(figure: Figure, stem: Path, twin: Mapping[str, Any]) -> list[Path]:
    """Write a figure as SVG and PNG, with its twin as JSON.

    Args:
        figure: The figure.
        stem: Path without suffix, as in ``figures/decode_once``.
        twin: What the figure shows and where from: JSON values only.

    Returns:
        The three files.
    """
    stem.parent.mkdir(parents=True, exist_ok=True)
    svg, png, note = (stem.with_name(stem.name + suffix) for suffix in (".svg", ".png", ".json"))
    with house_style():
        figure.savefig(svg, metadata={"Date": None, "Creator": "sfglab"})
        figure.savefig(png, metadata={"Software": "sfglab"})
    note.write_text(json.dumps(twin, indent=2, sort_keys=True) + "\n", encoding="utf-8")
    return [svg, png, note]


def file_sha256(path: Path) -> str:
    """Return the SHA-256 of a file as hexadecimal digits."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
