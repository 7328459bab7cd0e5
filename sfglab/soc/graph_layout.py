"""The module `graph_layout` places nodes, topics and edges in layers of a picture, from publishers to subscribers.

The module uses Sugiyama's method with networkx. The layer of a vertex follows from the longest path to the vertex.
An edge that passes a layer has a bend point in the layer. Sweeps over the layers sort the vertices of each layer by
the heights of their neighbours. Edges that close a cycle run backwards. The layout does not depend on placements and
mappings, so that readers can compare pictures of one graph.
"""

from __future__ import annotations

import re
import textwrap
from dataclasses import dataclass, replace
from itertools import pairwise
from operator import itemgetter
from statistics import fmean
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    import networkx as nx
    from numpy.typing import NDArray

    from sfglab.soc.graph import Edge, Graph, Vertex

# All lengths of the layout are in inches.
_LETTER = 0.072  # A letter is this wide.
_LINE = 0.142  # A line is this high.
_PAD = 0.07  # A name has this room around it.
_LETTERS = 12  # A line of a name has at most this number of letters.
_LINES = 4  # A name has at most this number of lines.
_COLUMN_GAP = 0.65  # Two layers have this gap between them.
_BOX_GAP = 0.4  # A frame has this gap to its neighbours in the layer.
_BEND_GAP = 0.25  # Two bend points of a layer have this gap.
_BACKWARDS = 0.08  # An edge that runs backwards is this far below the middle of its frames.
_MARGIN = 0.2  # The picture has this margin for outlines and notes.
_SWEEPS = 48


@dataclass(frozen=True, slots=True, kw_only=True)
class Box:
    """A `Box` is the frame of a node's or topic's name, or a bend point if the text is empty; lengths in inches."""

    text: str = ""  #: Name, broken into lines.
    width: float = 0.0  #: Width of the frame.
    height: float = 0.0  #: Height of the frame.
    x: float = 0.0  #: Centre, from the left of the picture.
    y: float = 0.0  #: Centre, from the bottom of the picture.


@dataclass(frozen=True, slots=True, kw_only=True)
class Layout:
    """A `Layout` has the places of boxes and lines in a picture; lengths in inches."""

    boxes: Mapping[Vertex, Box]  #: Frames of nodes and topics.
    #: Curve of each edge, shape (n, 2), in its direction.
    lines: Mapping[Edge, NDArray[np.float64]]
    size: tuple[float, float]  #: Width and height of the picture.


def layered_layout(graph: Graph) -> Layout:
    """Return the places of a graph's nodes, topics and edges, inches, in layers from left to right."""
    import networkx as nx

    layer_of = _layers(graph)
    boxes = {vertex: _box(vertex[1]) for vertex in layer_of}
    framed = list(boxes)
    lanes = nx.Graph()
    lanes.add_nodes_from(boxes)
    chains = {}
    for edge in graph.edges():
        left, right = sorted(edge.ends, key=layer_of.__getitem__)
        bends = {(edge, layer): layer for layer in range(layer_of[left] + 1, layer_of[right])}
        layer_of |= bends
        boxes |= dict.fromkeys(bends, Box())
        chains[edge] = [left, *bends, right]
        nx.add_path(lanes, chains[edge])
    columns: list[list[Any]] = [[] for _ in set(layer_of.values())]
    for vertex, layer in layer_of.items():
        columns[layer].append(vertex)
    y_of = _heights(columns, lanes, boxes)
    low = min((y_of[vertex] - box.height / 2 for vertex, box in boxes.items()), default=0.0)
    end = _MARGIN
    for column in columns:
        width = max(boxes[vertex].width for vertex in column)
        for vertex in column:
            y = y_of[vertex] - low + _MARGIN
            boxes[vertex] = replace(boxes[vertex], width=width, x=end + width / 2, y=y)
        end += width + _COLUMN_GAP
    lines = {}
    for edge, chain in chains.items():
        line = _line([boxes[vertex] for vertex in chain])
        if chain[0] != edge.ends[0]:
            line = line[::-1] - (0.0, _BACKWARDS)
        lines[edge] = line
    top = max((box.y + box.height / 2 for box in boxes.values()), default=_MARGIN)
    frames = {vertex: boxes[vertex] for vertex in framed}
    size = (max(end - _COLUMN_GAP, _MARGIN) + _MARGIN, top + _MARGIN)
    return Layout(boxes=frames, lines=lines, size=size)


def _layers(graph: Graph) -> dict[Any, int]:
    """Return the layer of each vertex: the length of the longest path to the vertex, with edges of cycles reversed."""
    import networkx as nx

    onward = nx.DiGraph()
    onward.add_nodes_from(("node", node.name) for node in graph.nodes)
    onward.add_nodes_from(("topic", topic.name) for topic in graph.topics)
    for edge in graph.edges():
        source, target = edge.ends
        if nx.has_path(onward, target, source):
            source, target = target, source
        onward.add_edge(source, target)
    layer_of: dict[Any, int] = {}
    for layer, generation in enumerate(nx.topological_generations(onward)):
        layer_of |= dict.fromkeys(generation, layer)
    return layer_of


def _heights(
    columns: list[list[Any]], lanes: nx.Graph, boxes: Mapping[Any, Box]
) -> dict[Any, float]:
    """Return the heights of all vertices from the sweep with the shortest edges."""
    y_of: dict[Any, float] = {}
    for column in columns:
        y_of |= _apart(dict.fromkeys(column, 0.0), boxes)
    found = []
    for _ in range(_SWEEPS):
        before: dict[Any, float] = {}
        for column in columns:
            wanted = {}
            for vertex in column:
                near = [y_of[neighbour] for neighbour in lanes[vertex] if neighbour in before]
                wanted[vertex] = fmean(near or [y_of[vertex]])
            before = _apart(wanted, boxes)
            y_of |= before
        columns.reverse()
        length = sum(abs(y_of[one] - y_of[other]) for one, other in lanes.edges)
        found.append((length, dict(y_of)))
    return min(found, key=itemgetter(0))[1]


def _apart(wanted: Mapping[Any, float], boxes: Mapping[Any, Box]) -> dict[Any, float]:
    """Return the heights nearest to the wanted heights at which the vertices of a layer do not overlap."""
    from scipy.optimize import isotonic_regression

    order = sorted(wanted, key=wanted.__getitem__, reverse=True)
    below = [0.0]
    for one, other in pairwise(boxes[vertex] for vertex in order):
        gap = _BOX_GAP if one.text and other.text else _BEND_GAP
        below.append(below[-1] + (one.height + other.height) / 2 + gap)
    level = np.add([wanted[vertex] for vertex in order], below)
    heights = isotonic_regression(level, increasing=False).x - below
    return dict(zip(order, heights.tolist(), strict=True))


def _line(chain: Sequence[Box]) -> NDArray[np.float64]:
    """Return a curve from left to right; the curve is level beside frames and at bends, to pass between frames."""
    along = np.linspace(0, 1, 30)
    eased = along * along * (3 - 2 * along)
    pieces = []
    for one, other in pairwise(chain):
        start = one.x + one.width / 2
        end = other.x - other.width / 2
        x = start + (end - start) * along
        y = one.y + (other.y - one.y) * eased
        pieces.append(np.column_stack([x, y]))
    return np.vstack(pieces)


def _box(name: str) -> Box:
    """Return the box of a name in the drawing.

    The function breaks a long name into lines, if possible after a dot, slash, dash or underscore, and cuts a name
    that has too many lines.
    """
    # A tab marks each place where a line may end.
    marked = re.sub(r"(?<=[_./-])(?=[^_./-])", "\t", name)
    lines = textwrap.wrap(
        marked,
        _LETTERS + 1,
        max_lines=_LINES,
        placeholder="\u2026",
        expand_tabs=False,
        replace_whitespace=False,
    )
    lines = [line.replace("\t", "") for line in lines] or [name]
    width = max(_LETTER * max(map(len, lines)), _LINE) + 2 * _PAD
    return Box(text="\n".join(lines), width=width, height=_LINE * len(lines) + 2 * _PAD)
