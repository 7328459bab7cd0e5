"""A graph drawn as in paper C's Fig. 8: dashed parts in hardware, edges across the boundary in colour.

Knows axes and mapped graphs. Refuses to know how a graph was mapped, and how figures are saved.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from itertools import pairwise
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np

from sfglab.errors import InvalidValueError
from sfglab.soc.graph import Edge, EdgeKind, Graph, TopicMapping
from sfglab.soc.layout import Layout, Vertex, ends_of, layered_layout, node_vertex, topic_vertex
from sfglab.soc.mapping import CommunicationMapping, crossing_edges, hardware_subgraphs

if TYPE_CHECKING:
    from collections.abc import Mapping

    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from numpy.typing import NDArray


# Okabe and Ito's palette, distinct for all common kinds of colour blindness; light where text stands on it.
CROSSING, PLAIN, OUTLINE, FRAME = "#D55E00", "#666666", "#0072B2", "#333333"
FILLS = {
    "node in software": "#FFFFFF",
    "node in hardware": "#85BCE6",
    "topic in software": "#FFFFFF",
    "topic in hardware": "#85BCE6",
    "gateway": "#F7DD92",
}
_TOPIC_FILLS = {
    TopicMapping.SOFTWARE: FILLS["topic in software"],
    TopicMapping.HARDWARE: FILLS["topic in hardware"],
    TopicMapping.GATEWAY: FILLS["gateway"],
}
# Inches: the least pitch of layers and of neighbours, the gaps that frames leave between them at least, the
# size of a letter, the room around names and parts; square inches: the pocket of an outline that is too small
# for a vertex.
_PITCH, _GAP = np.array([1.0, 0.72]), np.array([0.35, 0.22])
_LETTER, _LINE, _PAD, _MARGIN, _STEP = 0.072, 0.142, 0.07, 0.1, 0.015
_POCKET = 0.15
_LETTERS, _LINES = 12, 4
_LEGEND_WIDTH, _PAGE_WIDTH, _CELL = 7.6, 15.0, 0.17
"""Inches: of the legend, of the widest picture in lines, of a matrix's cells."""
STAGES = {
    "software": "all topics in software",
    "hardware": "topics in hardware",
    "gateways": "topics in hardware and gateways",
}


@dataclass(frozen=True, slots=True, kw_only=True)
class _Box:
    """A name's frame: centre and half its size, inches."""

    text: str
    centre: NDArray[np.float64]
    half: NDArray[np.float64]

    def holds(self, points: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Return which of some points, shape (n, 2), lie within the frame or touch it."""
        inside = np.abs(points - self.centre) <= self.half + 0.02
        return np.logical_and(inside[:, 0], inside[:, 1])


def draw_graph(
    ax: Axes,
    graph: Graph,
    *,
    layout: Layout | None = None,
    title: str = "",
    notes: Mapping[Edge | Vertex, str] = MappingProxyType({}),
) -> dict[Vertex, tuple[Artist, ...]]:
    """Draw a graph as it is mapped: nodes round, topics angular, what runs in hardware blue, gateways yellow.

    The title stands above, before the number of crossing edges; notes on an edge, and below a node or topic.
    Places are given so that several pictures agree; else they are those of `layered_layout`. It returns the
    artists of each node and topic.
    """
    layout = layout or layered_layout(graph)
    pitch = _pitch(layout)
    boxes = {
        vertex: _box(vertex[1], np.array(place) * pitch) for vertex, place in layout.places.items()
    }
    routes = {edge: _route(edge, layout, boxes) for edge in graph.edges()}
    crossing = crossing_edges(graph)
    for nodes, topics in hardware_subgraphs(graph):
        inner = [boxes[v] for v in (*map(node_vertex, nodes), *map(topic_vertex, topics))]
        _draw_outline(
            ax, inner, [r for e, r in routes.items() if e.node in nodes and e.topic in topics]
        )
    for edge, route in routes.items():
        _draw_route(ax, route, crosses=edge in crossing)
    drawn = {}
    for node in graph.nodes:
        fill = FILLS["node in hardware" if node.in_hardware else "node in software"]
        vertex = node_vertex(node.name)
        drawn[vertex] = _draw_box(ax, boxes[vertex], fill, rounding=0.13)
    for topic in graph.topics:
        vertex = topic_vertex(topic.name)
        drawn[vertex] = _draw_box(ax, boxes[vertex], _TOPIC_FILLS[topic.mapping], rounding=0.0)
    for at, note in notes.items():
        _draw_note(
            ax, note, routes[at] if isinstance(at, Edge) else boxes[at], crosses=at in crossing
        )
    _frame(ax, layout)
    ax.set_title(_counted(title, len(crossing)))
    return drawn


def _draw_note(ax: Axes, note: str, place: NDArray[np.float64] | _Box, *, crosses: bool) -> None:
    below = isinstance(place, _Box)
    x, y = (
        place.centre - (0.0, place.half[1] + 0.03)
        if isinstance(place, _Box)
        else place[len(place) // 2]
    )
    white: dict[str, Any] = {"fc": "white", "ec": "none", "pad": 0.5, "alpha": 0.8}
    color = CROSSING if crosses else FRAME
    look: dict[str, Any] = {"color": color, "fontsize": 6.5, "linespacing": 1.0, "zorder": 5}
    ax.text(x, y, note, ha="center", va="top" if below else "center", bbox=white, **look)


def draw_mapping(mapping: CommunicationMapping, figure: Figure, stage: str = "") -> None:
    """Draw the states of a communication mapping one below the other, with a legend: Fig. 8 (b) to (d).

    The figure must be empty and gets the size that it needs. A graph wider than a page is drawn as a matrix.
    Stages are ``software``, ``hardware`` or ``gateways``, else InvalidValueError; none: all three.
    """
    if stage and stage not in STAGES:
        raise InvalidValueError("stage", stage, ", ".join(STAGES))
    stages = [stage] if stage else list(STAGES)
    layout = layered_layout(mapping.gateways)
    width, height = size_of(layout)
    wide = width > _PAGE_WIDTH
    if wide:
        width, height = (
            1.8 + _CELL * len(part) for part in (mapping.gateways.nodes, mapping.gateways.topics)
        )
    figure.set_size_inches(max(_LEGEND_WIDTH, width), len(stages) * height + 0.6)
    for ax, name in zip(figure.subplots(len(stages), squeeze=False).flat, stages, strict=True):
        if wide:
            draw_matrix(ax, getattr(mapping, name), title=STAGES[name])
        else:
            draw_graph(ax, getattr(mapping, name), layout=layout, title=STAGES[name])
    draw_legend(figure)


def draw_matrix(ax: Axes, graph: Graph, *, title: str = "") -> None:
    """Draw a large graph: a row a topic, a column a node; triangles publish, circles subscribe."""
    nodes = [node.name for node in sorted(graph.nodes, key=lambda node: node.in_hardware)]
    topics = sorted(graph.topics, key=lambda topic: list(TopicMapping).index(topic.mapping))
    rows, crossing = [topic.name for topic in topics], crossing_edges(graph)
    first = len(nodes) - len(graph.in_hardware) - 0.5
    ax.axvspan(first, len(nodes) - 0.5, color=FILLS["node in hardware"], alpha=0.4, linewidth=0)
    for row, topic in enumerate(topics):
        if topic.mapping is not TopicMapping.SOFTWARE:
            ax.axhspan(
                row - 0.5, row + 0.5, color=_TOPIC_FILLS[topic.mapping], alpha=0.6, linewidth=0
            )
    for edge in graph.edges():
        marker = ">" if edge.kind is EdgeKind.PUBLISH else "o"
        color = CROSSING if edge in crossing else PLAIN
        ax.plot(nodes.index(edge.node), rows.index(edge.topic), marker, color=color, markersize=5)
    names: dict[str, Any] = {"fontsize": 7, "parse_math": False}
    ax.set_xticks(range(len(nodes)), nodes, rotation=90, **names)
    ax.set_yticks(range(len(rows)), rows, **names)
    ax.set(xlim=(-0.5, len(nodes) - 0.5), ylim=(len(rows) - 0.5, -0.5))
    ax.set_xlabel("triangles publish, circles subscribe", fontsize=8)
    ax.set_title(_counted(title, len(crossing)))


def _counted(title: str, count: int) -> str:
    return f"{title + ': ' if title else ''}{count} edge{'s' * (count != 1)} across the boundary"


def size_of(layout: Layout) -> tuple[float, float]:
    """Return width and height, inches, that a graph's picture needs with its title; a legend takes 0.6 more."""
    (left, right), (low, high) = _limits(layout)
    return max(_LEGEND_WIDTH, right - left), high - low + 0.3


def draw_legend(figure: Figure) -> None:
    """Say below a figure what its shapes, fills and lines mean."""
    from matplotlib.lines import Line2D

    kinds: list[Any] = [
        Line2D(
            [],
            [],
            ls="",
            marker="o" if "node" in name else "s",
            ms=9,
            mfc=fill,
            mec=FRAME,
            label=name,
        )
        for name, fill in FILLS.items()
    ]
    kinds += [
        Line2D([], [], color=CROSSING, lw=1.8, label="edge across the boundary"),
        Line2D([], [], color=PLAIN, lw=1.0, label="other edge"),
        Line2D([], [], color=OUTLINE, lw=1.2, ls="--", label="part in hardware"),
    ]
    figure.legend(handles=kinds, loc="outside lower center", ncols=4, frameon=False, fontsize=8)


def _box(name: str, centre: NDArray[np.float64]) -> _Box:
    lines = _lines(name)
    half = np.array([max(_LETTER * max(map(len, lines)), _LINE), _LINE * len(lines)]) / 2 + _PAD
    return _Box(text="\n".join(lines), centre=centre, half=half)


def _lines(name: str) -> list[str]:
    """Break a long name, after its marks where it has any, and cut what is longer than a frame should be."""
    lines = [""]
    for part in re.findall(r"[^_./ -]+[_./ -]*|[_./ -]+", name):
        for piece in (part[i : i + _LETTERS] for i in range(0, len(part), _LETTERS)):
            if lines[-1] and len(lines[-1]) + len(piece.rstrip()) > _LETTERS:
                lines.append("")
            lines[-1] += piece
    if len(lines) > _LINES:
        lines[_LINES - 1 :] = [lines[_LINES - 1].rstrip()[: _LETTERS - 1] + "\u2026"]
    return [line.strip() for line in lines]


def _pitch(layout: Layout) -> NDArray[np.float64]:
    """Return the distances of layers and neighbours that keep the largest frames apart."""
    sizes = [2 * _box(vertex[1], np.zeros(2)).half + _GAP for vertex in layout.places]
    largest: NDArray[np.float64] = np.max([_PITCH, *sizes], axis=0)
    return largest


def _route(edge: Edge, layout: Layout, boxes: Mapping[Vertex, _Box]) -> NDArray[np.float64]:
    """Return an edge's line between the frames of its ends, shape (n, 2), inches."""
    points = np.array(layout.routes[edge]) * _pitch(layout)
    back = replace(
        edge, kind=EdgeKind.SUBSCRIBE if edge.kind is EdgeKind.PUBLISH else EdgeKind.PUBLISH
    )
    if back in layout.routes:  # there and back: each keeps to its side
        way = points[-1] - points[0]
        points = points + 0.09 * np.array([-way[1], way[0]]) / np.hypot(*way)
    line = _smooth(points)
    ends = [boxes[vertex] for vertex in ends_of(edge)]
    outside = ~(ends[0].holds(line) | ends[1].holds(line))
    return line[outside] if outside.sum() > 1 else line


def _smooth(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return a curve through points that leaves and meets each bend level: cubic in x between neighbours."""
    share = np.linspace(0.0, 1.0, 40)[:, None]
    if len(points) == 2:
        straight: NDArray[np.float64] = points[0] + share * (points[1] - points[0])
        return straight
    level = 3 * share**2 - 2 * share**3
    return np.vstack(
        [
            np.hstack([a[:1] + share * (b - a)[:1], a[1:] + level * (b - a)[1:]])
            for a, b in pairwise(points)
        ]
    )


def _draw_route(ax: Axes, line: NDArray[np.float64], *, crosses: bool) -> None:
    from matplotlib.patches import FancyArrowPatch
    from matplotlib.path import Path

    colour, width = (CROSSING, 1.8) if crosses else (PLAIN, 1.0)
    arrow = FancyArrowPatch(
        path=Path(line),
        arrowstyle="-|>",
        mutation_scale=9,
        color=colour,
        linewidth=width,
        fill=True,
        zorder=2,
    )
    ax.add_patch(arrow)


def _draw_box(ax: Axes, box: _Box, fill: str, *, rounding: float) -> tuple[Artist, ...]:
    from matplotlib.patches import FancyBboxPatch

    low, size = box.centre - box.half, 2 * box.half
    style = f"round,pad=0,rounding_size={rounding}" if rounding else "square,pad=0"
    look: dict[str, Any] = {"facecolor": fill, "edgecolor": FRAME, "linewidth": 0.8, "zorder": 3}
    frame = ax.add_patch(FancyBboxPatch((low[0], low[1]), size[0], size[1], boxstyle=style, **look))
    x, y = box.centre
    text: dict[str, Any] = {
        "ha": "center",
        "va": "center",
        "fontsize": 8,
        "linespacing": 1.1,
        "zorder": 4,
    }
    return frame, ax.text(x, y, box.text, parse_math=False, **text)


def _draw_outline(ax: Axes, boxes: list[_Box], routes: list[NDArray[np.float64]]) -> None:
    """Draw a dashed line at an even distance around frames and lines; what lies between them stays outside."""
    solid = [(box.centre, box.half) for box in boxes]
    solid += [(point, np.zeros(2)) for route in routes for point in route[::2]]
    centres, halves = (np.array(part) for part in zip(*solid, strict=True))
    low, high = (
        (centres - halves).min(axis=0) - 3 * _MARGIN,
        (centres + halves).max(axis=0) + 3 * _MARGIN,
    )
    x, y = (np.arange(low[i], high[i] + _STEP, _STEP) for i in (0, 1))
    distance = np.full(
        (len(y), len(x)), 3 * _MARGIN
    )  # or more: only what is near decides where the line runs
    for centre, half in solid:
        begin, end = ((centre + sign * (half + 3 * _MARGIN) - low) / _STEP for sign in (-1, 1))
        columns, rows = (slice(max(int(begin[i]), 0), int(end[i]) + 1) for i in (0, 1))
        beyond_x = np.maximum(np.abs(x[columns] - centre[0]) - half[0], 0.0)
        beyond_y = np.maximum(np.abs(y[rows] - centre[1]) - half[1], 0.0)
        near = distance[rows, columns]
        np.minimum(near, np.hypot(beyond_x[None, :], beyond_y[:, None]), out=near)
    _fill_pockets(distance)
    ax.contour(
        x,
        y,
        distance,
        levels=[_MARGIN],
        colors=OUTLINE,
        linestyles="dashed",
        linewidths=1.2,
        zorder=1,
    )


def _fill_pockets(distance: NDArray[np.float64]) -> None:
    """Take small pockets between lines into the part; nothing could stand in them."""
    from scipy.ndimage import label

    pockets, _ = label(distance > _MARGIN)
    small = np.bincount(pockets.ravel()) * _STEP**2 < _POCKET
    distance[small[pockets] & (pockets > 0)] = 0.0


def _limits(layout: Layout) -> tuple[tuple[float, float], tuple[float, float]]:
    points = np.array(
        [*layout.places.values(), *(p for route in layout.routes.values() for p in route)]
    )
    pitch = _pitch(layout)
    low, high = (points.min(axis=0) - 0.5) * pitch, (points.max(axis=0) + 0.5) * pitch
    return (float(low[0]), float(high[0])), (float(low[1]), float(high[1]))


def _frame(ax: Axes, layout: Layout) -> None:
    horizontal, vertical = _limits(layout)
    ax.set(xlim=horizontal, ylim=vertical, aspect="equal")
    ax.set_axis_off()
