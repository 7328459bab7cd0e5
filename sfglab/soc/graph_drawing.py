"""The module `graph_drawing` draws a mapped graph like paper C, Fig. 8: crossing edges in colour, hardware on blue."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from sfglab.soc.graph import EdgeKind, Graph, TopicMapping, Vertex
from sfglab.soc.graph_layout import Box, Layout, layered_layout
from sfglab.soc.mapping import STAGES, CommunicationMapping, crossing_edges

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.patches import FancyBboxPatch

# The palette is that of Okabe and Ito, which suits people with common kinds of colour blindness. The colours behind
# texts are light.
CROSSING = "#D55E00"  #: Colour of edges across the boundary.
PLAIN = "#666666"  #: Colour of edges that do not cross the boundary.
LOGIC = "#DCECF8"  #: Background colour of the parts in hardware.
OUTLINE = "#0072B2"  #: Outline colour of the background of parts in hardware.
FRAME = "#333333"  #: Colour of frames and texts.
SOFTWARE = "#FFFFFF"
HARDWARE = "#85BCE6"
GATEWAY = "#F7DD92"
_FILLS = {
    TopicMapping.SOFTWARE: SOFTWARE,
    TopicMapping.HARDWARE: HARDWARE,
    TopicMapping.GATEWAY: GATEWAY,
}
# All lengths of the drawing are in inches.
LEGEND_WIDTH = 7.6
_PAGE = 15.0  # A layered picture is at most this wide.
_TITLE = 0.3  # A title is this high.
_CELL = 0.17  # A cell of a matrix has sides of this length.
_NAMES = 1.8  # The names beside a matrix have this room.
_BAND_PT = 15.0  # The background along lines and frames is this wide, in points.


def draw_graph(
    ax: Axes, graph: Graph, *, layout: Layout | None = None, title: str = ""
) -> dict[Vertex, tuple[Artist, Artist]]:
    """Draw a mapped graph with round nodes and angular topics: hardware is blue, a gateway is yellow.

    Args:
        ax: Axes to draw on.
        graph: Graph with its mapping.
        layout: Places of the vertices, so that several drawings agree. [default: the places of `layered_layout`]
        title: Text above the drawing. The function adds the number of crossing edges to the text.

    Returns:
        The frame and the text of each node and topic.
    """
    from matplotlib.patches import FancyArrowPatch
    from matplotlib.path import Path

    layout = layout or layered_layout(graph)
    crossing = crossing_edges(graph)
    fills = {("node", n.name): HARDWARE if n.in_hardware else SOFTWARE for n in graph.nodes}
    fills |= {("topic", topic.name): _FILLS[topic.mapping] for topic in graph.topics}
    _draw_parts(ax, layout, {vertex for vertex, fill in fills.items() if fill != SOFTWARE})
    for edge, line in layout.lines.items():
        color, width = (CROSSING, 1.8) if edge in crossing else (PLAIN, 1.0)
        look: dict[str, Any] = {"color": color, "linewidth": width, "mutation_scale": 9}
        ax.add_patch(FancyArrowPatch(path=Path(line), arrowstyle="-|>", zorder=2, **look))
    centred: dict[str, Any] = {"ha": "center", "va": "center", "fontsize": 8, "linespacing": 1.1}
    drawn: dict[Vertex, tuple[Artist, Artist]] = {}
    for vertex, fill in fills.items():
        box = layout.boxes[vertex]
        style = "round,pad=0,rounding_size=0.13" if vertex[0] == "node" else "square,pad=0"
        frame = add_frame(ax, box, style, facecolor=fill, edgecolor=FRAME, linewidth=0.8, zorder=3)
        text = ax.text(box.x, box.y, box.text, parse_math=False, zorder=4, **centred)
        drawn[vertex] = frame, text
    width, height = layout.size
    ax.set(xlim=(0, width), ylim=(0, height), aspect="equal", title=_title(title, len(crossing)))
    ax.set_axis_off()
    return drawn


def _draw_parts(ax: Axes, layout: Layout, logic: set[Vertex]) -> None:
    """Draw the background of the parts in the logic: a wide band and, on top, a slightly narrower band."""
    for width, color in ((_BAND_PT + 2, OUTLINE), (_BAND_PT, LOGIC)):
        band: dict[str, Any] = {"color": color, "linewidth": width, "zorder": 1}
        for vertex in sorted(logic):
            add_frame(ax, layout.boxes[vertex], "square,pad=0", joinstyle="round", **band)
        for edge, line in layout.lines.items():
            if logic.issuperset(edge.ends):
                ax.plot(*line.T, **band)


def add_frame(ax: Axes, box: Box, style: str, **look: Any) -> FancyBboxPatch:
    """Add a box's frame with one of Matplotlib's box styles and with properties of a patch."""
    from matplotlib.patches import FancyBboxPatch

    corner = (box.x - box.width / 2, box.y - box.height / 2)
    frame = FancyBboxPatch(corner, box.width, box.height, boxstyle=style, **look)
    ax.add_patch(frame)
    return frame


def _title(title: str, count: int) -> str:
    edges = "1 edge" if count == 1 else f"{count} edges"
    return f"{title}{': ' if title else ''}{edges} across the boundary"


def draw_mapping(mapping: CommunicationMapping, figure: Figure) -> None:
    """Draw the three stages of a communication mapping below each other, with a legend, as in Fig. 8 (b) to (d).

    Args:
        mapping: Mapping to draw. A graph that is wider than a page is drawn as a matrix.
        figure: Empty figure; the function sets the figure's size to the size of the pictures.
    """
    graph = mapping.gateways
    layout = layered_layout(graph)
    width, height = layout.size
    is_wide = width > _PAGE
    if is_wide:
        width, height = _NAMES + _CELL * len(graph.nodes), _NAMES + _CELL * len(graph.topics)
    figure.set_size_inches(max(LEGEND_WIDTH, width), len(STAGES) * (height + _TITLE) + 0.6)
    axes = figure.subplots(len(STAGES))
    for ax, title, stage in zip(axes, STAGES, mapping.stages, strict=True):
        if is_wide:
            _draw_matrix(ax, stage, title=title)
        else:
            draw_graph(ax, stage, layout=layout, title=title)
    draw_legend(figure)


def _draw_matrix(ax: Axes, graph: Graph, *, title: str) -> None:
    """Draw a large graph with one row per topic and one column per node; triangles publish, circles subscribe."""
    nodes = sorted(graph.nodes, key=lambda node: node.in_hardware)
    column = {node.name: number for number, node in enumerate(nodes)}
    row = {topic.name: number for number, topic in enumerate(graph.topics)}
    last = len(column) - 0.5
    ax.axvspan(last - len(graph.hardware_nodes), last, color=HARDWARE, alpha=0.4, linewidth=0)
    for topic in graph.topics:
        if topic.mapping is not TopicMapping.SOFTWARE:
            top = row[topic.name] - 0.5
            ax.axhspan(top, top + 1, color=_FILLS[topic.mapping], alpha=0.6, linewidth=0)
    crossing = crossing_edges(graph)
    for edge in graph.edges():
        marker = ">" if edge.kind is EdgeKind.PUBLISH else "o"
        color = CROSSING if edge in crossing else PLAIN
        ax.plot(column[edge.node], row[edge.topic], marker, color=color, markersize=5)
    names: dict[str, Any] = {"fontsize": 7, "parse_math": False}
    ax.set_xticks(range(len(column)), column, rotation=90, **names)
    ax.set_yticks(range(len(row)), row, **names)
    ax.set(xlim=(-0.5, last), ylim=(len(row) - 0.5, -0.5), title=_title(title, len(crossing)))
    ax.set_xlabel("triangles publish, circles subscribe", fontsize=8)


def draw_legend(figure: Figure) -> None:
    """Draw a legend of shapes, fills and lines below a figure."""
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
    for label, color, width in (
        ("edge across the boundary", CROSSING, 1.8),
        ("other edge", PLAIN, 1.0),
        ("part in hardware", LOGIC, 9.0),
    ):
        handles.append(Line2D([], [], color=color, lw=width, label=label))
    figure.legend(handles=handles, loc="outside lower center", ncols=4, frameon=False, fontsize=8)
