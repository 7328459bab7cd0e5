"""Places of a graph's nodes and topics in its picture: in layers, from the first publisher on.

Sugiyama's method: edges that close a cycle are turned round, layers follow the longest path, edges that pass
layers bend there, each layer is ordered by the medians of its neighbours, swept forth and back, and the order
with the fewest crossings is kept; then neighbours are drawn level. The same graph has one layout.
"""

from __future__ import annotations

from dataclasses import dataclass
from graphlib import TopologicalSorter
from itertools import combinations, pairwise
from statistics import fmean, median
from typing import TYPE_CHECKING

from sfglab.soc.graph import Edge, EdgeKind, Graph

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

Vertex = tuple[str, ...]
"""``("node", name)`` or ``("topic", name)``: a node and a topic may have the same name."""

_Ends = tuple[Vertex, Vertex]

_SWEEPS = 12
_BEND_ROOM = 0.6


@dataclass(frozen=True, slots=True, kw_only=True)
class Layout:
    """Places in a plane; the unit is the distance of two layers, and of two neighbours in one."""

    #: Of each node and topic: x, its layer from 0; y, upwards.
    places: Mapping[Vertex, tuple[float, float]]
    #: Of each edge: where it starts, bends and ends.
    routes: Mapping[Edge, tuple[tuple[float, float], ...]]


def node_vertex(name: str) -> Vertex:
    """Return a ROS node's place in V."""
    return ("node", name)


def topic_vertex(name: str) -> Vertex:
    """Return a topic's place in V."""
    return ("topic", name)


def ends_of(edge: Edge) -> _Ends:
    """Return where an edge comes from and where it leads."""
    ends = (node_vertex(edge.node), topic_vertex(edge.topic))
    return ends if edge.kind is EdgeKind.PUBLISH else ends[::-1]


def layered_layout(graph: Graph) -> Layout:
    """Return where everything stands."""
    vertices = [node_vertex(node.name) for node in graph.nodes]
    vertices += [topic_vertex(topic.name) for topic in graph.topics]
    downhill = _turned({edge: ends_of(edge) for edge in graph.edges()}, vertices)
    layer_of = _layers(vertices, downhill.values())
    layers: list[list[Vertex]] = [[] for _ in range(max(layer_of.values(), default=-1) + 1)]
    for vertex in vertices:
        layers[layer_of[vertex]].append(vertex)
    chains = {edge: _chain(edge, ends, layer_of) for edge, ends in downhill.items()}
    for chain in chains.values():
        for bend in chain[1:-1]:
            layers[int(bend[1])].append(bend)
    lanes = [pair for chain in chains.values() for pair in pairwise(chain)]
    places = _places(_ordered(layers, lanes), lanes)
    routes = {
        edge: tuple(places[v] for v in (chain if downhill[edge] == ends_of(edge) else chain[::-1]))
        for edge, chain in chains.items()
    }
    return Layout(places={vertex: places[vertex] for vertex in vertices}, routes=routes)


def _turned(edges: Mapping[Edge, _Ends], vertices: list[Vertex]) -> dict[Edge, _Ends]:
    """Turn the edges round that lead back to where a walk in depth came from."""
    leaving: dict[Vertex, list[Edge]] = {vertex: [] for vertex in vertices}
    for edge, (source, _) in edges.items():
        leaving[source].append(edge)
    reached = {target for _, target in edges.values()}
    turned, entered, left = dict(edges), set[Vertex](), set[Vertex]()
    for start in sorted(vertices, key=lambda vertex: vertex in reached):
        walk = [] if start in entered else [(start, iter(leaving[start]))]
        entered.add(start)
        while walk:
            vertex, rest = walk[-1]
            following = next(rest, None)
            if following is None:
                left.add(vertex)
                walk.pop()
            elif (target := edges[following][1]) not in entered:
                entered.add(target)
                walk.append((target, iter(leaving[target])))
            elif target not in left:
                turned[following] = (target, vertex)
    return turned


def _layers(vertices: list[Vertex], edges: Iterable[_Ends]) -> dict[Vertex, int]:
    """Return each vertex's longest path from a start; a start stands just before what it leads to."""
    before: dict[Vertex, list[Vertex]] = {vertex: [] for vertex in vertices}
    behind: dict[Vertex, list[Vertex]] = {vertex: [] for vertex in vertices}
    for source, target in edges:
        before[target].append(source)
        behind[source].append(target)
    layer: dict[Vertex, int] = {}
    for vertex in TopologicalSorter(before).static_order():
        layer[vertex] = max((layer[source] + 1 for source in before[vertex]), default=0)
    for start in (vertex for vertex in vertices if not before[vertex]):
        layer[start] = min((layer[target] - 1 for target in behind[start]), default=0)
    return layer


def _chain(edge: Edge, ends: _Ends, layer_of: Mapping[Vertex, int]) -> tuple[Vertex, ...]:
    """Return an edge's way through the layers; a bend is named for its layer and its edge."""
    passed = range(layer_of[ends[0]] + 1, layer_of[ends[1]])
    return (ends[0], *(("bend", str(layer), str(edge)) for layer in passed), ends[1])


def _ordered(layers: list[list[Vertex]], lanes: list[_Ends]) -> list[list[Vertex]]:
    """Return the layers, each in an order with few crossings."""
    best, fewest = layers, _crossings(layers, lanes)
    for sweep in range(_SWEEPS):
        layers = _swept(layers, lanes, forth=sweep % 2 == 0)
        if (crossings := _crossings(layers, lanes)) < fewest:
            best, fewest = layers, crossings
    return best


def _swept(layers: list[list[Vertex]], lanes: list[_Ends], *, forth: bool) -> list[list[Vertex]]:
    """Order each layer by the median place of its neighbours in the layer before it, or behind it."""
    near: dict[Vertex, list[Vertex]] = {}
    for source, target in lanes:
        one, other = (target, source) if forth else (source, target)
        near.setdefault(one, []).append(other)
    swept: dict[int, list[Vertex]] = {}
    place: dict[Vertex, float] = {}
    for index in range(len(layers)) if forth else reversed(range(len(layers))):
        key = {vertex: i - (len(layers[index]) - 1) / 2 for i, vertex in enumerate(layers[index])}
        key |= {v: median(place[other] for other in near[v]) for v in layers[index] if v in near}
        swept[index] = sorted(layers[index], key=key.__getitem__)
        place |= {vertex: i - (len(key) - 1) / 2 for i, vertex in enumerate(swept[index])}
    return [swept[index] for index in range(len(layers))]


def _crossings(layers: list[list[Vertex]], lanes: list[_Ends]) -> int:
    place = {vertex: (x, i) for x, layer in enumerate(layers) for i, vertex in enumerate(layer)}
    gaps: dict[int, list[tuple[int, int]]] = {}
    for source, target in lanes:
        gaps.setdefault(place[source][0], []).append((place[source][1], place[target][1]))
    return sum(
        (a[0] - b[0]) * (a[1] - b[1]) < 0
        for pairs in gaps.values()
        for a, b in combinations(pairs, 2)
    )


def _places(layers: list[list[Vertex]], lanes: list[_Ends]) -> dict[Vertex, tuple[float, float]]:
    """Keep the order in each layer, and draw each vertex towards the mean of its neighbours."""
    near: dict[Vertex, list[Vertex]] = {}
    for source, target in lanes:
        near.setdefault(source, []).append(target)
        near.setdefault(target, []).append(source)
    height = {
        vertex: (len(layer) - 1) / 2 - i for layer in layers for i, vertex in enumerate(layer)
    }
    for sweep in range(_SWEEPS):
        for layer in layers if sweep % 2 == 0 else reversed(layers):
            wanted = [fmean(height[o] for o in near[v]) if v in near else height[v] for v in layer]
            height |= dict(zip(layer, _apart(wanted, _room(layer)), strict=True))
    return {
        vertex: (float(x), height[vertex]) for x, layer in enumerate(layers) for vertex in layer
    }


def _room(layer: list[Vertex]) -> list[float]:
    """Return how far below the first each vertex of a layer must stand at least."""
    room = [0.0]
    for pair in pairwise(layer):
        room.append(room[-1] + (_BEND_ROOM if any(vertex[0] == "bend" for vertex in pair) else 1.0))
    return room[: len(layer)]


def _apart(wanted: list[float], room: list[float]) -> list[float]:
    """Return the heights nearest to the wanted ones in order and apart, by pooling adjacent violators."""
    blocks: list[list[float]] = []
    for height, below in zip(wanted, room, strict=True):
        blocks.append([height + below])
        while len(blocks) > 1 and fmean(blocks[-2]) < fmean(blocks[-1]):
            last = blocks.pop()
            blocks[-1] += last
    level = [mean for block in blocks for mean in [fmean(block)] * len(block)]
    return [height - below for height, below in zip(level, room, strict=True)]
