"""Interactive diagram of a mapped graph: a click moves a node or topic and updates costs and times."""

from __future__ import annotations

from dataclasses import replace
from html import escape
from typing import TYPE_CHECKING, Any

import numpy as np

from sfglab.errors import SfglabError
from sfglab.lab.explore.press import Pressed, part
from sfglab.soc import mapping
from sfglab.soc.graph import Edge, EdgeKind, Graph, Placement, TopicMapping
from sfglab.soc.graph_drawing import CROSSING, FRAME, LEGEND_WIDTH, draw_graph, draw_legend
from sfglab.soc.graph_layout import layered_layout
from sfglab.soc.mapping import map_communication
from sfglab.soc.placement import Platform, assess, check_fixed, place_nodes, topic_load
from sfglab.view.widgets import button, widgets

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from matplotlib.figure import Figure
    from numpy.typing import NDArray

    from sfglab.soc.graph_layout import Box

    Point = tuple[float, float]

_MS = 1e3
_CYCLE = (TopicMapping.SOFTWARE, TopicMapping.GATEWAY, TopicMapping.HARDWARE)
_NOTE: dict[str, Any] = {
    "ha": "center",
    "va": "center",
    "fontsize": 7,
    "linespacing": 1.0,
    "zorder": 5,
    "bbox": {"fc": "white", "ec": "none", "pad": 0.5, "alpha": 0.8},
}
_CAPTION = (
    "ms: time until the subscriber has a message of the topic's size ({}).\n"
    "Transfers across the boundary: per message, as the mean over the topic's publishers."
)
_NOTE_SIZE = (0.7, 0.3)  # width and height of a note, inches
_OTHER = {Placement.SOFTWARE: Placement.HARDWARE, Placement.HARDWARE: Placement.SOFTWARE}


class PressedMapping(Pressed):
    """A mapped ROS graph with round nodes, angular topics and transfer times; a click moves a node or a topic.

    A click moves a node to the other side, and the paper's three cases then map the topics. A click on a topic
    moves it from software to a gateway, to hardware and back. Each subscription is labelled with the time that
    a message takes to it.

    Args:
        graph: Graph with the mapping that is shown first.
        platform: Area for nodes and gateways; *Optimise* then solves the node placement. None: there is no limit
            of area, and *Optimise* maps only the topics, by predicted time.
        chain: Names of nodes, each of which publishes to the next; their edges show the accumulated time.

    Raises:
        MissingExtraError: The extra ``view`` is not installed.
    """

    def __init__(
        self, graph: Graph, platform: Platform | None = None, *, chain: Sequence[str] = ()
    ) -> None:
        kit = widgets()
        self.graph = graph  #: Graph with its present mapping.
        self._begin = graph
        self._platform = platform
        self._chain = chain
        self._layout = layered_layout(graph)
        self._asked: dict[str, TopicMapping] = {}
        self.why = kit.HTML()  #: Reasons for the last optimum.
        row = [
            button("Optimise", lambda: self.answer(self.optimise)),
            button("Reset", lambda: self.answer(lambda: self._set(self._begin))),
        ]
        if platform is not None:
            #: Number of look-up tables of the platform.
            self.lut = kit.IntSlider(
                value=platform.lut, max=platform.lut, description="LUT", layout={"width": "30em"}
            )
            self.lut.observe(lambda _: self.answer(lambda: self._limit(platform)), "value")
            row.append(self.lut)
        width, height = self._layout.size
        size = max(width, LEGEND_WIDTH), height + 1.2
        super().__init__(size, [kit.HBox(row), self.why])

    def optimise(self) -> None:
        """Map with the least load or time, and show the reasons."""
        if self._platform is None:
            self._set(map_communication(self.graph, gateway=mapping.faster_by_gateway).gateways)
            reasons = self._reasons_of_topics()
        else:
            self._set(place_nodes(self.graph, self._platform).graph)
            reasons = self._reasons(self._platform)
        self.why.value = "<br>".join(map(escape, reasons))

    def _limit(self, platform: Platform) -> None:
        self._platform = replace(platform, lut=self.lut.value)
        assess(self.graph).check_fits(self._platform)

    def _set(self, graph: Graph) -> None:
        if self._platform is not None:
            assess(graph).check_fits(self._platform)
        self.graph = graph
        self._asked.clear()
        self.why.value = ""

    def take(self, name: str) -> None:
        """Move a node to the other side, or give a topic its next mapping."""
        kind, _, what = name.partition(":")
        if kind == "topic":
            asked = self._asked.get(what, self.graph.topic(what).mapping)
            # The next click skips a refused mapping.
            self._asked[what] = _CYCLE[(_CYCLE.index(asked) + 1) % len(_CYCLE)]
            self._set(self.graph.with_mappings({what: self._asked[what]}))
            return
        side = _OTHER[self.graph.node(what).placement]
        if self._platform is not None:
            check_fixed(self.graph, {what: side})
        at = self.graph.mapped_to(TopicMapping.GATEWAY)
        placed = self.graph.with_placements({what: side})
        self._set(map_communication(placed, gateway=lambda _, topic: topic.name in at).gateways)

    # Reasons for the optimum.

    def _reasons(self, platform: Platform) -> Iterator[str]:
        """Yield the load with each node on the other side and each gateway replaced, all else as it is."""
        sides = {node.name: node.placement for node in self.graph.nodes}
        least_s = assess(self.graph).total_s
        if not any(node.hardware for node in self.graph.nodes):
            yield "No node states a hardware implementation, so no node can be placed in hardware."
            return
        yield f"Least load: {_MS * least_s:.2f} ms per second. With one change, other nodes as they are:"
        for node in self.graph.nodes:
            if node.hardware is None:
                continue
            other = _OTHER[node.placement]
            try:
                found = place_nodes(self.graph, platform, fixed=sides | {node.name: other})
                yield f"{node.name} in {other.value}: {_MS * found.load.total_s:.2f} ms"
            except SfglabError as error:
                yield f"{node.name} in {other.value}: {error}"
        for name in self.graph.mapped_to(TopicMapping.GATEWAY):
            without = self.graph.with_mappings({name: TopicMapping.SOFTWARE})
            yield f"{name} without a gateway: {_MS * assess(without).total_s:.2f} ms"

    def _reasons_of_topics(self) -> Iterator[str]:
        yield "A topic has a gateway if its last subscriber then receives a message earlier:"
        for topic in self.graph.topics:
            if topic.mapping is TopicMapping.HARDWARE:
                continue
            times = []
            for kind in (TopicMapping.SOFTWARE, TopicMapping.GATEWAY):
                time_s = mapping.transfer_s(self.graph, replace(topic, mapping=kind))
                times.append(f"{_MS * time_s:.2f} ms with {kind.value}")
            yield f"{topic.name} to {topic.mapping.value}: {', '.join(times)}"

    # Drawing.

    def titles(self) -> dict[str, str]:
        """Return place or mapping of each node and topic."""
        nodes = {
            f"node:{node.name}": f"{node.name} runs in {node.placement.value}: click to move it"
            for node in self.graph.nodes
        }
        topics = {
            f"topic:{one.name}": f"{one.name} is mapped to {one.mapping.value}: click for the next mapping"
            for one in self.graph.topics
        }
        return nodes | topics

    def draw(self, figure: Figure) -> None:
        """Draw the graph with times on its edges, and costs in the title."""
        ax = figure.subplots()
        for (kind, name), artists in draw_graph(ax, self.graph, layout=self._layout).items():
            part(f"{kind}:{name}", *artists)
        places = []
        crossing = mapping.crossing_edges(self.graph)
        lines = self._layout.lines
        boxes = np.array([(box.x, box.y) for box in self._layout.boxes.values()])
        for box, text in self._carriages():
            # Below the topic, or above it if there is more room.
            away = box.height / 2 + _NOTE_SIZE[1] / 2
            sides = np.array([(box.x, box.y - away), (box.x, box.y + away)])
            x, y = _free_place(sides, np.vstack([*lines.values(), boxes]))
            ax.text(x, y, text, color=FRAME, **_NOTE)
            # The second point, towards the subscribers, keeps the times on their edges farther away.
            places += [(x, y), (x + _NOTE_SIZE[0] / 3, y)]
        for edge, text in self._times().items():
            others = [line for other, line in lines.items() if other != edge]
            ends = lines[edge][[0, -1]]
            place = _free_place(lines[edge], np.vstack([*others, *places, ends]))
            places.append(place)
            color = CROSSING if edge in crossing else FRAME
            ax.text(*place, text, color=color, **_NOTE)
        figure.suptitle(f"{self._cost()}\n{self._caption()}".strip(), fontsize="medium")
        draw_legend(figure)

    def _carriages(self) -> Iterator[tuple[Box, str]]:
        """Yield the frame of each topic, and the text of its note: number of transfers per message."""
        for topic in self.graph.topics:
            times = mapping.carriages_per_message(self.graph, topic)
            if not times:
                continue
            text = f"{times:g} transfer" + ("" if times == 1 else "s")
            if self._platform:
                text += f"\n{_MS * topic_load(self.graph, topic):.2g} ms/s"
            yield self._layout.boxes["topic", topic.name], text

    def _times(self) -> dict[Edge, str]:
        """Return how long a message takes on the edge to each subscriber."""
        along = mapping.chain_s(self.graph, self._chain)
        texts = {}
        for edge in self.graph.edges():
            if edge.kind is EdgeKind.PUBLISH or self.graph.topic(edge.topic).size_bytes is None:
                continue
            texts[edge] = f"{_MS * mapping.arrival_s(self.graph, edge):.2g} ms"
            if edge in along:
                texts[edge] += f"\n\N{GREEK CAPITAL LETTER SIGMA} {_MS * along[edge]:.1f} ms"
        return texts

    def _caption(self) -> str:
        sizes = {topic.size_bytes for topic in self.graph.topics if topic.size_bytes is not None}
        ends = dict.fromkeys(f"{end(sizes):,} B" for end in (min, max)) if sizes else ["unknown"]
        return _CAPTION.format(" to ".join(ends))

    def _cost(self) -> str:
        titles = []
        if self._platform:
            load = assess(self.graph)
            titles.append(
                f"load {_MS * load.total_s:.1f} ms per second (software {_MS * load.software_s:.1f}, "
                f"hardware {_MS * load.hardware_s:.1f}, transfers {_MS * load.communication_s:.1f}); "
                f"{load.lut} LUT, {load.bram:g} BRAM"
            )
        if self._chain:
            end_s = max(mapping.chain_s(self.graph, self._chain).values())
            whole_s = end_s + mapping.activation_s(self.graph.node(self._chain[-1]))
            titles.append(f"chain (\N{GREEK CAPITAL LETTER SIGMA}) {_MS * whole_s:.2f} ms")
        return "; ".join(titles)


def _free_place(line: NDArray[np.float64], others: NDArray[np.float64]) -> Point:
    """Return the point of a line that is farthest from other points.

    Args:
        line: Points to choose from, such as the curve of an edge, shape (n, 2).
        others: Points to keep away from, such as other edges, notes, and the ends of the edge, shape (m, 2).
    """
    # In sizes of a note: two notes that are one size apart do not overlap.
    distances = np.abs(line[:, None] - others) / _NOTE_SIZE
    x, y = line[distances.max(axis=2).min(axis=1).argmax()]
    return float(x), float(y)
