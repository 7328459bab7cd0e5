"""A picture of an experiment's set-up, drawn from what it declares: hosts, processes, who sends what to whom.

Hosts stand from left to right in the order in which messages pass them, processes below one another in theirs.
A link that crosses a boundary is drawn in the boundary's colour and names it.
"""

from __future__ import annotations

from collections import defaultdict
from graphlib import TopologicalSorter
from textwrap import fill
from typing import TYPE_CHECKING

from sfglab.lab.figures import COLORS, house_style

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from sfglab.lab.experiment import Actor, Setup

_WIDE, _HIGH = 2.3, 0.8
"""Size of a process, inches."""
_APART, _BELOW, _BETWEEN = 2.3, 0.75, 0.7
"""Room between columns, between processes of one host, and between hosts of a column, inches."""
_MARGIN = 0.95
_BEND, _ARC = 0.16, 0.4
_LABEL_AT = 0.3
"""Where a link's text stands, as a share of its way: those that cross in the middle keep apart."""


def draw_setup(setup: Setup) -> Figure:
    """Draw a set-up.

    Args:
        setup: The set-up.

    Returns:
        A figure as large as it needs.
    """
    from matplotlib.figure import Figure

    columns = _columns(setup)
    places: dict[str, tuple[float, float]] = {}
    frames: dict[str, tuple[float, float, int]] = {}
    for column, hosts in enumerate(columns):
        y = 0.0
        for host in hosts:
            actors = [actor for actor in setup.actors if actor.host == host]
            frames[host] = column * (_WIDE + _APART), y, len(actors)
            for row, actor in enumerate(actors):
                places[actor.name] = column * (_WIDE + _APART), y - row * (_HIGH + _BELOW)
            y -= len(actors) * (_HIGH + _BELOW) - _BELOW + _BETWEEN
    bottom = min(y for _, y in places.values()) - _HIGH - 0.3
    width = len(columns) * (_WIDE + _APART) - _APART + 2 * _MARGIN
    with house_style():
        figure = Figure(figsize=(width, 0.5 - bottom))
        figure.set_layout_engine("none")
        axes = figure.add_axes((0, 0, 1, 1), xlim=(-_MARGIN, width - _MARGIN), ylim=(bottom, 0.5))
        axes.set_axis_off()
        for host, frame in frames.items():
            _draw_host(axes, host, frame)
        for actor in setup.actors:
            _draw_actor(axes, actor, places[actor.name])
        _draw_links(axes, setup, places)
    return figure


def _columns(setup: Setup) -> list[list[str]]:
    """Return hosts by column, in the order in which messages pass them."""
    host_of = {actor.name: actor.host for actor in setup.actors}
    before: dict[str, set[str]] = {host: set() for host in host_of.values()}
    for link in setup.links:
        source, target = host_of[link.source], host_of[link.target]
        if target not in {source} | before[source]:  # an answer goes back
            for host, earlier in before.items():
                if host == target or target in earlier:
                    earlier.update({source} | before[source])
    sorter = TopologicalSorter(before)
    sorter.prepare()
    columns = []
    while sorter.is_active():
        columns.append(sorted(sorter.get_ready(), key=list(before).index))
        sorter.done(*columns[-1])
    return columns


def _draw_host(axes: Axes, host: str, frame: tuple[float, float, int]) -> None:
    from matplotlib.patches import FancyBboxPatch

    x, y, actors = frame
    high = actors * (_HIGH + _BELOW) - _BELOW
    style = "round,pad=0,rounding_size=0.1"
    corner = x - 0.15, y - high - 0.12
    axes.add_patch(FancyBboxPatch(corner, _WIDE + 0.3, high + 0.5, boxstyle=style, fc="#f4f4f4", ec="#bbb"))
    axes.text(x - 0.05, y + 0.12, host, fontsize=9, color="#555", style="italic")


def _draw_actor(axes: Axes, actor: Actor, place: tuple[float, float]) -> None:
    from matplotlib.patches import FancyBboxPatch

    x, y = place
    style = "round,pad=0,rounding_size=0.06"
    axes.add_patch(FancyBboxPatch((x, y - _HIGH), _WIDE, _HIGH, boxstyle=style, fc="white", ec="#333"))
    count = f" (number: {actor.count})" if actor.count != "1" else ""
    axes.text(x + 0.1, y - 0.2, actor.name, fontsize=8.5, weight="bold", va="center")
    axes.text(x + 0.1, y - 0.53, fill(f"{actor.does}{count}", 38), fontsize=7, color="#333", va="center")


def _draw_links(axes: Axes, setup: Setup, places: dict[str, tuple[float, float]]) -> None:
    """Draw one arrow for all links from one actor to another, with a line of text each."""
    together = defaultdict(list)
    for link in setup.links:
        together[link.source, link.target].append(link)
    for (source, target), links in together.items():
        boundary = next((link.boundary for link in links if link.boundary), "")
        color = COLORS["standard"] if boundary else COLORS["proxy"]
        start, end, bend = _ends(places[source], places[target])
        axes.annotate(
            "",
            end,
            start,
            arrowprops={"arrowstyle": "-|>", "color": color, "connectionstyle": f"arc3,rad={bend}", "lw": 1.3},
        )
        over = {link.over for link in links}
        text = [*(link.carries for link in links), *(sorted(over - {"DDS"}))]
        text += [f"[{boundary}]"] if boundary else []
        lines = "\n".join(fill(line, 28) for line in text)
        x, y = (s + _LABEL_AT * (e - s) for s, e in zip(start, end, strict=True))
        # An arc leaves its chord to the right of its way, most in the middle.
        x, y = x + bend * _ARC * (end[1] - start[1]), y - bend * _ARC * (end[0] - start[0])
        axes.text(x, y, lines, fontsize=6.5, color=color, ha="center", va="center", bbox=_LABEL)


_LABEL = {"boxstyle": "round,pad=0.15", "fc": "white", "ec": "none", "alpha": 0.85}


def _ends(
    source: tuple[float, float], target: tuple[float, float]
) -> tuple[tuple[float, float], tuple[float, float], float]:
    """Return where an arrow begins and ends at two actors' boxes, and its bend: there and back lie apart."""
    (x1, y1), (x2, y2) = source, target
    if x1 != x2:
        right = x2 > x1
        shift = 0.3 if right else 0.7
        start = (x1 + _WIDE if right else x1), y1 - shift * _HIGH
        end = (x2 if right else x2 + _WIDE), y2 - shift * _HIGH
        return start, end, _BEND if abs(x2 - x1) > 1.5 * (_WIDE + _APART) else 0.0
    down = y1 > y2
    if abs(y1 - y2) > 1.5 * (_HIGH + _BELOW):  # past what stands between
        at = x1 if down else x1 + _WIDE
        return (at, y1 - _HIGH / 2), (at, y2 - _HIGH / 2), 0.22
    at = x1 + (0.3 if down else 0.7) * _WIDE
    return (at, y1 - _HIGH if down else y1), (at, y2 if down else y2 - _HIGH), 0.0
