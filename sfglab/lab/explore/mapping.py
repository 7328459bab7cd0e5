"""A picture of a mapped graph to press: a node or topic moves, and costs and times follow."""

from __future__ import annotations

from dataclasses import replace
from html import escape
from typing import TYPE_CHECKING, Any

from sfglab.errors import SfglabError
from sfglab.lab.explore.press import Pressed, part
from sfglab.soc import mapping
from sfglab.soc.graph import EdgeKind, Graph, Placement, TopicMapping
from sfglab.soc.graph_drawing import CROSSING, FRAME, LEGEND_WIDTH, draw_graph, draw_legend
from sfglab.soc.graph_layout import layered_layout
from sfglab.soc.mapping import map_communication
from sfglab.soc.placement import Platform, assess, check_fixed, place_nodes, topic_load
from sfglab.view.widgets import button, widgets

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_MS = 1e3
_CYCLE = (TopicMapping.SOFTWARE, TopicMapping.GATEWAY, TopicMapping.HARDWARE)
_NOTE: dict[str, Any] = {
    "ha": "center",
    "fontsize": 6.5,
    "linespacing": 1.0,
    "zorder": 5,
    "bbox": {"fc": "white", "ec": "none", "pad": 0.5, "alpha": 0.8},
}
_OTHER = {Placement.SOFTWARE: Placement.HARDWARE, Placement.HARDWARE: Placement.SOFTWARE}


class PressedMapping(Pressed):
    """A mapped graph as a picture to press.

    A node goes to the other side, and the topics follow by the paper's three cases; a topic goes from software
    to a gateway, to hardware and back. On a subscription stands how long a message takes to it.

    Args:
        graph: The graph as it is mapped to begin with.
        platform: Where it runs; its areas are kept, and the programme of node mapping optimises. None: nodes
            may stand anywhere, and topics alone are optimised, by predicted time.
        chain: Names of nodes, each of which publishes to the next, whose time is told along their edges.

    Raises:
        MissingExtraError: The extra ``view`` is not installed.
    """

    def __init__(
        self, graph: Graph, platform: Platform | None = None, *, chain: Sequence[str] = ()
    ) -> None:
        kit = widgets()
        self.graph = graph  #: As it is mapped now.
        self._begin, self._platform, self._chain = graph, platform, chain
        self._layout = layered_layout(graph)
        self._asked: dict[str, TopicMapping] = {}
        self.why = kit.HTML()  #: What the last optimum's reasons are.
        buttons = [
            button("Optimise", lambda: self.answer(self.optimise)),
            button("Reset", lambda: self.answer(lambda: self._set(self._begin))),
        ]
        most = platform.lut if platform else 0
        #: The look-up tables that there are.
        self.lut = kit.IntSlider(value=most, max=most, description="LUT", layout={"width": "30em"})
        self.lut.observe(lambda change: self.answer(lambda: self._limit(change["new"])), "value")
        above = [kit.HBox([*buttons, *([self.lut] if platform else [])]), self.why]
        width, height = self._layout.size
        size = max(width, LEGEND_WIDTH), height + 1.2
        super().__init__(
            self._picture, size=size, press=self._move, titles=self._sentences, above=above
        )

    def optimise(self) -> None:
        """Map as the programme does, and say why."""
        if self._platform is None:
            mapped = map_communication(self.graph, gateway=mapping.faster_by_gateway)
            self._set(mapped.gateways, self._reasons_of_topics)
        else:
            self._set(place_nodes(self.graph, self._platform).graph, self._reasons)

    def _limit(self, lut: int) -> None:
        assert self._platform is not None, "without one there is no slider"
        self._platform = replace(self._platform, lut=lut)
        assess(self.graph).check_fits(self._platform)

    def _set(self, graph: Graph, reasons: Any = tuple) -> None:
        if self._platform is not None:
            assess(graph).check_fits(self._platform)
        self.graph = graph
        self._asked.clear()
        self.why.value = "<br>".join(escape(reason) for reason in reasons())

    def _move(self, name: str) -> None:
        kind, _, what = name.partition(":")
        if kind == "topic":
            asked = self._asked.get(what, self.graph.topic(what).mapping)
            # What is refused is passed over by the next press.
            self._asked[what] = _CYCLE[(_CYCLE.index(asked) + 1) % len(_CYCLE)]
            self._set(self.graph.with_mappings({what: self._asked[what]}))
            return
        side = _OTHER[self.graph.node(what).placement]
        if self._platform is not None:
            check_fixed(self.graph, self._platform, {what: side})
        at = self.graph.mapped_to(TopicMapping.GATEWAY)
        placed = self.graph.with_placements({what: side})
        self._set(map_communication(placed, gateway=lambda _, topic: topic.name in at).gateways)

    # Why it is best.

    def _reasons(self) -> Iterator[str]:
        """Yield what a second's work would take with each choice the other way, all else at its best."""
        assert self._platform is not None, "the programme needs one"
        sides = {node.name: node.placement for node in self.graph.nodes}
        least_s = assess(self.graph).total_s
        yield f"Least work and carriage: {_MS * least_s:.2f} ms each second. Others, all else at its best:"
        for node in self.graph.nodes:
            if node.hardware is None:
                continue
            other = _OTHER[node.placement]
            try:
                found = place_nodes(
                    self.graph, self._platform, fixed=sides | {node.name: other}
                ).load.total_s
            except SfglabError as error:
                yield f"{node.name} in {other.value}: {error}"
                continue
            yield f"{node.name} in {other.value}: {_MS * found:.2f} ms"
        for name in self.graph.mapped_to(TopicMapping.GATEWAY):
            without = self.graph.with_mappings({name: TopicMapping.SOFTWARE})
            yield f"{name} without a gateway: {_MS * assess(without).total_s:.2f} ms"

    def _reasons_of_topics(self) -> Iterator[str]:
        yield "Gateways where a message is with its last subscriber earlier:"
        for topic in self.graph.topics:
            both = {m: self.graph.with_mappings({topic.name: m}) for m in _CYCLE[:2]}
            if topic.mapping in both:
                times = {
                    m.value: _MS * mapping.transfer_s(g, g.topic(topic.name))
                    for m, g in both.items()
                }
                told = ", ".join(f"{time:.2f} ms at {name}" for name, time in times.items())
                yield f"{topic.name} to {topic.mapping.value}: {told}"

    # How it looks.

    def _picture(self, figure: Figure) -> None:
        ax = figure.subplots()
        drawn = draw_graph(ax, self.graph, layout=self._layout)
        for (kind, name), artists in drawn.items():
            part(f"{kind}:{name}", *artists)
        self._note_times(ax)
        self._note_carriages(ax)
        figure.suptitle(self._cost(), fontsize="medium")
        draw_legend(figure)

    def _note_times(self, ax: Axes) -> None:
        """Write how long a message takes to each subscriber on the middle of its edge."""
        along = mapping.chain_s(self.graph, self._chain)
        crossing = mapping.crossing_edges(self.graph)
        for edge, line in self._layout.lines.items():
            if edge.kind is EdgeKind.PUBLISH or self.graph.topic(edge.topic).size_bytes is None:
                continue
            text = f"{_MS * mapping.arrival_s(self.graph, edge):.2g} ms"
            if edge in along:
                text += f"\n\N{GREEK CAPITAL LETTER SIGMA} {_MS * along[edge]:.1f}"
            x, y = line[len(line) // 2]
            color = CROSSING if edge in crossing else FRAME
            ax.text(x, y, text, color=color, va="center", **_NOTE)

    def _note_carriages(self, ax: Axes) -> None:
        """Write how often a topic's messages are carried below the topic."""
        for topic in self.graph.topics:
            times = mapping.carriages_per_message(self.graph, topic)
            if not times:
                continue
            text = f"carried {times:g}x"
            if self._platform:
                text += f", {_MS * topic_load(self.graph, topic):.2g} ms/s"
            box = self._layout.boxes["topic", topic.name]
            ax.text(box.x, box.y - box.height / 2 - 0.03, text, color=FRAME, va="top", **_NOTE)

    def _cost(self) -> str:
        told = []
        if self._platform:
            load = assess(self.graph)
            times = {
                "software": load.software_s,
                "hardware": load.hardware_s,
                "carriage": load.communication_s,
            }
            parts = ", ".join(f"{name} {_MS * time_s:.1f}" for name, time_s in times.items())
            told.append(
                f"each second {_MS * load.total_s:.1f} ms ({parts}); {load.lut} LUT, {load.bram:g} BRAM"
            )
        if self._chain:
            end_s = [*mapping.chain_s(self.graph, self._chain).values()][-1]
            whole_s = end_s + mapping.activation_s(self.graph.node(self._chain[-1]))
            told.append(f"chain (\N{GREEK CAPITAL LETTER SIGMA}) {_MS * whole_s:.2f} ms")
        return "; ".join(told)

    def _sentences(self) -> dict[str, str]:
        said = {}
        for node in self.graph.nodes:
            text = f"{node.name} runs in {node.placement.value}: press to move it"
            said[f"node:{node.name}"] = text
        for topic in self.graph.topics:
            text = f"{topic.name} is mapped to {topic.mapping.value}: press for the next"
            said[f"topic:{topic.name}"] = text
        return said
