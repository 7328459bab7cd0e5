"""Interactive picture of a mapped graph: a click moves a node or topic and updates costs and times."""

from __future__ import annotations

from dataclasses import replace
from html import escape
from operator import itemgetter
from typing import TYPE_CHECKING, Any

import numpy as np

from sfglab.errors import SfglabError
from sfglab.lab.explore.press import Pressed, part
from sfglab.soc import mapping
from sfglab.soc.graph import EdgeKind, Graph, Placement, TopicMapping
from sfglab.soc.graph_drawing import CROSSING, FRAME, LEGEND_WIDTH, draw_graph, draw_legend
from sfglab.soc.graph_layout import Box, layered_layout
from sfglab.soc.mapping import map_communication
from sfglab.soc.placement import Platform, assess, check_fixed, place_nodes, topic_load
from sfglab.view.widgets import button, widgets

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from numpy.typing import NDArray

_MS = 1e3
_CYCLE = (TopicMapping.SOFTWARE, TopicMapping.GATEWAY, TopicMapping.HARDWARE)
_NOTE: dict[str, Any] = {
    "ha": "center",
    "fontsize": 7,
    "linespacing": 1.0,
    "zorder": 5,
    "bbox": {"fc": "white", "ec": "none", "pad": 0.5, "alpha": 0.8},
}
_NOTE_LETTER = 0.06  # width of a letter of a note, inches
_NOTE_LINE = 0.12  # height of a line of a note, inches
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
        self._begin, self._platform, self._chain = graph, platform, chain
        self._layout = layered_layout(graph)
        self._asked: dict[str, TopicMapping] = {}
        self.why = kit.HTML()  #: Reasons for the last optimum.
        buttons = [
            button("Optimise", lambda: self.answer(self.optimise)),
            button("Reset", lambda: self.answer(lambda: self._set(self._begin))),
        ]
        most = platform.lut if platform else 0
        #: Number of look-up tables of the platform.
        self.lut = kit.IntSlider(value=most, max=most, description="LUT", layout={"width": "30em"})
        self.lut.observe(lambda change: self.answer(lambda: self._limit(change["new"])), "value")
        above = [kit.HBox([*buttons, *([self.lut] if platform else [])]), self.why]
        width, height = self._layout.size
        size = max(width, LEGEND_WIDTH), height + 1.2
        super().__init__(
            self._picture, size=size, press=self._move, titles=self._sentences, above=above
        )

    def optimise(self) -> None:
        """Map with the least load or time, and show the reasons."""
        if self._platform is None:
            mapped = map_communication(self.graph, gateway=mapping.faster_by_gateway)
            self._set(mapped.gateways)
            self._explain(self._reasons_of_topics())
        else:
            self._set(place_nodes(self.graph, self._platform).graph)
            self._explain(self._reasons())

    def _limit(self, lut: int) -> None:
        assert self._platform is not None, "without one there is no slider"
        self._platform = replace(self._platform, lut=lut)
        assess(self.graph).check_fits(self._platform)

    def _set(self, graph: Graph) -> None:
        if self._platform is not None:
            assess(graph).check_fits(self._platform)
        self.graph = graph
        self._asked.clear()
        self._explain(())

    def _explain(self, reasons: Iterable[str]) -> None:
        self.why.value = "<br>".join(escape(reason) for reason in reasons)

    def _move(self, name: str) -> None:
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

    def _reasons(self) -> Iterator[str]:
        """Yield the load with each node on the other side and each gateway replaced, all else as it is."""
        assert self._platform is not None, "the programme needs one"
        sides = {node.name: node.placement for node in self.graph.nodes}
        least_s = assess(self.graph).total_s
        yield f"Least load: {_MS * least_s:.2f} ms per second. With one change, other nodes as they are:"
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

    def _picture(self, figure: Figure) -> None:
        ax = figure.subplots()
        drawn = draw_graph(ax, self.graph, layout=self._layout)
        for (kind, name), artists in drawn.items():
            part(f"{kind}:{name}", *artists)
        self._note_times(ax, self._note_carriages(ax))
        figure.suptitle(self._cost(), fontsize="medium")
        draw_legend(figure)

    def _note_carriages(self, ax: Axes) -> list[Box]:
        """Write how often a topic's messages are carried below the topic; return the room of the texts."""
        taken = []
        for topic in self.graph.topics:
            times = mapping.carriages_per_message(self.graph, topic)
            if not times:
                continue
            text = f"carried {times:g}x"
            if self._platform:
                text += f"\n{_MS * topic_load(self.graph, topic):.2g} ms/s"
            frame = self._layout.boxes["topic", topic.name]
            top = frame.y - frame.height / 2 - 0.03
            ax.text(frame.x, top, text, color=FRAME, va="top", **_NOTE)
            note = _note(text)
            taken.append(replace(note, x=frame.x, y=top - note.height / 2))
        return taken

    def _note_times(self, ax: Axes, taken: list[Box]) -> None:
        """Write how long a message takes to each subscriber on its edge, where there is room."""
        along = mapping.chain_s(self.graph, self._chain)
        crossing = mapping.crossing_edges(self.graph)
        taken = [*self._layout.boxes.values(), *taken]
        for edge, line in self._layout.lines.items():
            if edge.kind is EdgeKind.PUBLISH or self.graph.topic(edge.topic).size_bytes is None:
                continue
            text = f"{_MS * mapping.arrival_s(self.graph, edge):.2g} ms"
            if edge in along:
                text += f"\n\N{GREEK CAPITAL LETTER SIGMA} {_MS * along[edge]:.1f} ms"
            others = [points for other, points in self._layout.lines.items() if other != edge]
            note = _free_place(_note(text), line, taken, np.vstack([*others, line[:0]]))
            taken.append(note)
            color = CROSSING if edge in crossing else FRAME
            ax.text(note.x, note.y, text, color=color, va="center", **_NOTE)

    def _cost(self) -> str:
        titles = []
        if self._platform:
            load = assess(self.graph)
            times = {
                "software": load.software_s,
                "hardware": load.hardware_s,
                "carriage": load.communication_s,
            }
            parts = ", ".join(f"{name} {_MS * time_s:.1f}" for name, time_s in times.items())
            areas = f"{load.lut} LUT, {load.bram:g} BRAM"
            titles.append(f"load {_MS * load.total_s:.1f} ms per second ({parts}); {areas}")
        if self._chain:
            end_s = max(mapping.chain_s(self.graph, self._chain).values())
            whole_s = end_s + mapping.activation_s(self.graph.node(self._chain[-1]))
            titles.append(f"chain (\N{GREEK CAPITAL LETTER SIGMA}) {_MS * whole_s:.2f} ms")
        return "; ".join(titles)

    def _sentences(self) -> dict[str, str]:
        found = {}
        for node in self.graph.nodes:
            text = f"{node.name} runs in {node.placement.value}: press to move it"
            found[f"node:{node.name}"] = text
        for topic in self.graph.topics:
            text = f"{topic.name} is mapped to {topic.mapping.value}: press for the next"
            found[f"topic:{topic.name}"] = text
        return found


def _note(text: str) -> Box:
    """Return the room that a note takes, about."""
    lines = text.split("\n")
    width = _NOTE_LETTER * max(map(len, lines))
    return Box(text=text, width=width, height=_NOTE_LINE * len(lines))


def _free_place(
    note: Box, line: NDArray[np.float64], taken: Sequence[Box], others: NDArray[np.float64]
) -> Box:
    """Return a note on its edge, where it covers the fewest frames, notes and other edges, near the middle.

    Args:
        note: Room of the note.
        line: Curve of its edge, shape (n, 2).
        taken: Frames and notes.
        others: Points of other edges, shape (m, 2).
    """
    middle = len(line) / 2
    found = []
    for place, (x, y) in enumerate(line.tolist()):
        here = replace(note, x=x, y=y)
        covered = sum(_overlap(here, other) for other in taken)
        near = np.abs(others - (x, y)) < (note.width / 2, note.height / 2)
        crossed = int(near.all(axis=1).sum())
        found.append((covered, crossed, abs(place - middle), here))
    return min(found, key=itemgetter(0, 1, 2))[3]


def _overlap(one: Box, other: Box) -> bool:
    beside = abs(one.x - other.x) >= (one.width + other.width) / 2
    return not beside and abs(one.y - other.y) < (one.height + other.height) / 2
