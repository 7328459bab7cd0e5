"""Pictures of a mapped graph as in paper C, Fig. 8: edges across the boundary in colour, dashed parts in hardware."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from sfglab.errors import InvalidValueError
from sfglab.soc.graph import EdgeKind, Graph, TopicMapping, Vertex
from sfglab.soc.graph_layout import Box, Layout, layered_layout
from sfglab.soc.mapping import CommunicationMapping, crossing_edges, hardware_parts

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from numpy.typing import NDArray

# Okabe and Ito's palette, distinct for all common kinds of colour blindness; light where text stands on it.
CROSSING = "#D55E00"  #: Edges across the boundary.
PLAIN = "#666666"  #: Other edges.
OUTLINE = "#0072B2"  #: Dashed outlines of parts in hardware.
FRAME = "#333333"  #: Frames and texts.
SOFTWARE = "#FFFFFF"
HARDWARE = "#85BCE6"
GATEWAY = "#F7DD92"
_FILLS = {
    TopicMapping.SOFTWARE: SOFTWARE,
    TopicMapping.HARDWARE: HARDWARE,
    TopicMapping.GATEWAY: GATEWAY,
}
STAGES = {
    "software": "all topics in software",
    "hardware": "topics in hardware",
    "gateways": "topics in hardware and gateways",
}
# Lengths in inches.
LEGEND_WIDTH = 7.6
_PAGE = 15.0  # width of the widest layered picture
_TITLE = 0.3  # height of a title
_CELL = 0.17  # side of a cell of a matrix
_NAMES = 1.8  # room for the names beside a matrix
_APART = 0.1  # distance of an outline from its part
_STEP = 0.02  # pitch of the grid on which an outline is found
_HOLE = 0.15  # square inches: a smaller hole in an outline is closed


def draw_graph(
    ax: Axes, graph: Graph, *, layout: Layout | None = None, title: str = ""
) -> dict[Vertex, tuple[Artist, Artist]]:
    """Draw a mapped graph: nodes round, topics angular; blue in hardware, yellow at a gateway.

    Args:
        ax: Axes to draw on.
        graph: Graph with its mapping.
        layout: Places, so that several pictures agree; by default those of `layered_layout`.
        title: Text above the picture, before the number of crossing edges.

    Returns:
        Frame and text of each node and topic.
    """
    from matplotlib.patches import FancyArrowPatch
    from matplotlib.path import Path

    layout = layout or layered_layout(graph)
    crossing = crossing_edges(graph)
    for part in hardware_parts(graph):
        boxes = [layout.boxes[vertex] for vertex in part]
        inside = [line for edge, line in layout.lines.items() if part.issuperset(edge.ends)]
        _draw_outline(ax, boxes, inside)
    for edge, line in layout.lines.items():
        color, width = (CROSSING, 1.8) if edge in crossing else (PLAIN, 1.0)
        look: dict[str, Any] = {"color": color, "linewidth": width, "mutation_scale": 9}
        ax.add_patch(FancyArrowPatch(path=Path(line), arrowstyle="-|>", zorder=2, **look))
    drawn = {}
    for node in graph.nodes:
        vertex = ("node", node.name)
        fill = HARDWARE if node.in_hardware else SOFTWARE
        drawn[vertex] = _draw_box(ax, layout.boxes[vertex], fill, "round,pad=0,rounding_size=0.13")
    for topic in graph.topics:
        vertex = ("topic", topic.name)
        drawn[vertex] = _draw_box(ax, layout.boxes[vertex], _FILLS[topic.mapping], "square,pad=0")
    width, height = layout.size
    ax.set(xlim=(0, width), ylim=(0, height), aspect="equal", title=_title(title, len(crossing)))
    ax.set_axis_off()
    return drawn


def _title(title: str, count: int) -> str:
    edges = "1 edge" if count == 1 else f"{count} edges"
    return f"{title}{': ' if title else ''}{edges} across the boundary"


def _draw_box(ax: Axes, box: Box, fill: str, style: str) -> tuple[Artist, Artist]:
    from matplotlib.patches import FancyBboxPatch

    corner = (box.x - box.width / 2, box.y - box.height / 2)
    look: dict[str, Any] = {"facecolor": fill, "edgecolor": FRAME, "linewidth": 0.8, "zorder": 3}
    frame = FancyBboxPatch(corner, box.width, box.height, boxstyle=style, **look)
    centred: dict[str, Any] = {"ha": "center", "va": "center", "fontsize": 8, "linespacing": 1.1}
    text = ax.text(box.x, box.y, box.text, parse_math=False, zorder=4, **centred)
    return ax.add_patch(frame), text


def _draw_outline(ax: Axes, boxes: list[Box], lines: list[NDArray[np.float64]]) -> None:
    """Draw a dashed line around frames and lines; what lies between them stays outside."""
    from scipy.ndimage import distance_transform_edt, label

    solid = list(lines)
    for box in boxes:
        x, y = box.width / 2, box.height / 2
        grid = np.mgrid[box.x - x : box.x + x : _STEP, box.y - y : box.y + y : _STEP]
        solid.append(grid.reshape(2, -1).T)
    points = np.vstack(solid)
    low = points.min(axis=0) - 3 * _APART
    cells = ((points - low) / _STEP).astype(int)
    outside = np.ones(cells.max(axis=0) + int(3 * _APART / _STEP), dtype=bool)
    outside[tuple(cells.T)] = False
    distance = distance_transform_edt(outside, sampling=_STEP)
    holes, _ = label(distance > _APART)
    small = np.bincount(holes.ravel()) * _STEP**2 < _HOLE
    distance[small[holes] & (holes > 0)] = 0.0
    across, up = (start + _STEP * np.arange(n) for start, n in zip(low, outside.shape, strict=True))
    look: dict[str, Any] = {"colors": OUTLINE, "linestyles": "dashed", "linewidths": 1.2}
    ax.contour(across, up, distance.T, levels=[_APART], zorder=1, **look)


def draw_mapping(mapping: CommunicationMapping, figure: Figure, stage: str = "") -> None:
    """Draw the stages of a communication mapping below each other, with a legend: Fig. 8 (b) to (d).

    Args:
        mapping: Mapping to draw. A graph that is wider than a page is drawn as a matrix.
        figure: Empty figure; it gets the size that the pictures need.
        stage: ``software``, ``hardware`` or ``gateways``; by default all three.

    Raises:
        InvalidValueError: There is no such stage.
    """
    if stage and stage not in STAGES:
        raise InvalidValueError("stage", stage, ", ".join(STAGES))
    stages = [stage] if stage else list(STAGES)
    graph = mapping.gateways
    layout = layered_layout(graph)
    width, height = layout.size
    is_wide = width > _PAGE
    if is_wide:
        width, height = _NAMES + _CELL * len(graph.nodes), _NAMES + _CELL * len(graph.topics)
    figure.set_size_inches(max(LEGEND_WIDTH, width), len(stages) * (height + _TITLE) + 0.6)
    axes = figure.subplots(len(stages), squeeze=False)
    graphs = dict(zip(STAGES, mapping.stages, strict=True))
    for ax, name in zip(axes.flat, stages, strict=True):
        if is_wide:
            _draw_matrix(ax, graphs[name], title=STAGES[name])
        else:
            draw_graph(ax, graphs[name], layout=layout, title=STAGES[name])
    draw_legend(figure)


def _draw_matrix(ax: Axes, graph: Graph, *, title: str = "") -> None:
    """Draw a large graph: one row per topic, one column per node; triangles publish, circles subscribe."""
    nodes = sorted(graph.nodes, key=lambda node: node.in_hardware)
    topics = sorted(graph.topics, key=lambda topic: list(TopicMapping).index(topic.mapping))
    column = {node.name: number for number, node in enumerate(nodes)}
    row = {topic.name: number for number, topic in enumerate(topics)}
    last, bottom = len(nodes) - 0.5, len(topics) - 0.5
    ax.axvspan(last - len(graph.in_hardware), last, color=HARDWARE, alpha=0.4, linewidth=0)
    for number, topic in enumerate(topics):
        if topic.mapping is not TopicMapping.SOFTWARE:
            color = _FILLS[topic.mapping]
            ax.axhspan(number - 0.5, number + 0.5, color=color, alpha=0.6, linewidth=0)
    crossing = crossing_edges(graph)
    for edge in graph.edges():
        marker = ">" if edge.kind is EdgeKind.PUBLISH else "o"
        color = CROSSING if edge in crossing else PLAIN
        ax.plot(column[edge.node], row[edge.topic], marker, color=color, markersize=5)
    names: dict[str, Any] = {"fontsize": 7, "parse_math": False}
    ax.set_xticks(range(len(nodes)), column, rotation=90, **names)
    ax.set_yticks(range(len(topics)), row, **names)
    ax.set(xlim=(-0.5, last), ylim=(bottom, -0.5), title=_title(title, len(crossing)))
    ax.set_xlabel("triangles publish, circles subscribe", fontsize=8)


def draw_legend(figure: Figure) -> None:
    """Draw what shapes, fills and lines mean, below a figure."""
    from matplotlib.lines import Line2D

    shapes = [
        ("node in software", "o", SOFTWARE),
        ("node in hardware", "o", HARDWARE),
        ("topic in software", "s", SOFTWARE),
        ("topic in hardware", "s", HARDWARE),
        ("gateway", "s", GATEWAY),
    ]
    handles = []
    for label, marker, fill in shapes:
        look: dict[str, Any] = {"marker": marker, "ms": 9, "mfc": fill, "mec": FRAME}
        handles.append(Line2D([], [], ls="", label=label, **look))
    handles += [
        Line2D([], [], color=CROSSING, lw=1.8, label="edge across the boundary"),
        Line2D([], [], color=PLAIN, lw=1.0, label="other edge"),
        Line2D([], [], color=OUTLINE, lw=1.2, ls="--", label="part in hardware"),
    ]
    figure.legend(handles=handles, loc="outside lower center", ncols=4, frameon=False, fontsize=8)
