"""A picture of an experiment's set-up, drawn from what it declares: hosts, processes, who sends what to whom.

Processes stand side by side in their hosts' frames, in the order in which they are declared. Each link has a
line of its own below them, so that no words cross: an arrow from process to process, and above it what is sent,
over what, and what is crossed, in the colour of the standard path where anything is.
"""

from __future__ import annotations

from textwrap import fill
from typing import TYPE_CHECKING

from sfglab.lab.figures import COLORS, house_style

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from sfglab.lab.experiment import Link, Setup

_WIDE, _HIGH, _APART = 1.75, 0.85, 0.2
"""Size of a process, and half the room between two of different hosts, inches."""
_LINE, _ROW = 0.13, 0.2  #: Height of a line of words, and what an arrow takes beside its words, inches.
_LETTERS = 27  #: How many letters a process is wide.


def draw_setup(setup: Setup) -> Figure:
    """Draw a set-up, in a figure as large as it needs."""
    from matplotlib.figure import Figure

    hosts = list(dict.fromkeys(actor.host for actor in setup.actors))
    actors = sorted(setup.actors, key=lambda actor: hosts.index(actor.host))
    columns = {
        actor.name: i * (_WIDE + _APART) + hosts.index(actor.host) * _APART for i, actor in enumerate(actors)
    }
    said = [_words(link, abs(columns[link.target] - columns[link.source])) for link in setup.links]
    bottom = -_HIGH - sum(_ROW + _LINE * (1 + text.count("\n")) for text in said) - 0.15
    width = columns[actors[-1].name] + _WIDE
    with house_style():
        figure = Figure(figsize=(width + 0.4, 0.65 - bottom))
        figure.set_layout_engine("none")
        axes = figure.add_axes((0, 0, 1, 1), xlim=(-0.2, width + 0.2), ylim=(bottom - 0.1, 0.55))
        axes.set_axis_off()
        for host in hosts:
            own = [columns[actor.name] for actor in actors if actor.host == host]
            _draw_box(axes, (own[0] - 0.1, bottom), (own[-1] - own[0] + _WIDE + 0.2, 0.45 - bottom), "#f4f4f4")
            title = fill(host, _LETTERS * len(own))
            axes.text(own[0], 0.24, title, fontsize=8, color="#555", style="italic", va="center")
        for actor in actors:
            x = columns[actor.name]
            axes.plot([x + _WIDE / 2] * 2, [-_HIGH, bottom + 0.1], color="#aaa", lw=0.8, zorder=1)
            _draw_box(axes, (x, -_HIGH), (_WIDE, _HIGH), "white")
            count = f" (number: {actor.count})" if actor.count != "1" else ""
            axes.text(x + 0.08, -0.18, actor.name, fontsize=8.5, weight="bold", va="center")
            does = fill(f"{actor.does}{count}", _LETTERS)
            axes.text(x + 0.08, -0.34, does, fontsize=7, color="#333", va="top")
        y = -_HIGH
        for link, text in zip(setup.links, said, strict=True):
            y -= _ROW + _LINE * (1 + text.count("\n"))
            _draw_link(axes, link, text, y, [columns[end] + _WIDE / 2 for end in (link.source, link.target)])
    return figure


def _words(link: Link, length: float) -> str:
    """Return what stands above an arrow of a length, inches."""
    over = "" if link.over == "DDS" else f" over {link.over}"
    crossed = f" [{link.boundary}]" if link.boundary else ""
    return fill(f"{link.carries}{over}{crossed}", int(_LETTERS * max(length / _WIDE, 1)))


def _draw_box(axes: Axes, corner: tuple[float, float], size: tuple[float, float], color: str) -> None:
    from matplotlib.patches import FancyBboxPatch

    style = "round,pad=0,rounding_size=0.06"
    axes.add_patch(FancyBboxPatch(corner, *size, boxstyle=style, fc=color, ec="#888", zorder=1))


def _draw_link(axes: Axes, link: Link, text: str, y: float, ends: list[float]) -> None:
    color = COLORS["standard"] if link.boundary else COLORS["proxy"]
    arrow = {"arrowstyle": "-|>", "color": color, "lw": 1.3, "shrinkA": 0, "shrinkB": 0}
    axes.annotate("", (ends[1], y), (ends[0], y), arrowprops=arrow)
    white = {"boxstyle": "round,pad=0.1", "fc": "#f4f4f4", "ec": "none"}
    axes.text(sum(ends) / 2, y + 0.05, text, fontsize=7, color=color, ha="center", va="bottom", bbox=white)
