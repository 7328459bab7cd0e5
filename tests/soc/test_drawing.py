"""Pictures of graphs: nothing on top of anything else, crossing edges in colour, parts in hardware on blue."""

from io import BytesIO
from itertools import combinations, pairwise

import networkx as nx
import numpy as np
from graph_strategies import HW, SW, chain, for_every_graph
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.patches import FancyArrowPatch

from sfglab import soc
from sfglab.soc.graph_drawing import CROSSING, LOGIC
from sfglab.soc.graph_layout import layered_layout

SOFTWARE = soc.TopicMapping.SOFTWARE


@for_every_graph()
def test_frames_stand_apart_and_lines_lead_between_them_through_none_and_onward_without_cycles(
    graph,
):
    layout = layered_layout(graph)
    assert len(layout.boxes) == len(graph.nodes) + len(graph.topics)
    for one, other in combinations(layout.boxes.values(), 2):
        is_beside = abs(one.x - other.x) > (one.width + other.width) / 2
        assert is_beside or abs(one.y - other.y) > (one.height + other.height) / 2
    assert set(layout.lines) == set(graph.edges())
    for edge, line in layout.lines.items():
        assert ((line > 0) & (line < layout.size)).all()
        for vertex, box in layout.boxes.items():
            x, y = np.abs(line - (box.x, box.y)).T
            assert not ((x < box.width / 2 - 1e-6) & (y < box.height / 2)).any()
            touches = (x < box.width / 2 + 1e-6) & (y < box.height / 2)
            assert (touches[0], touches[-1]) == tuple(vertex == end for end in edge.ends)
    is_onward = all(line[0, 0] < line[-1, 0] for line in layout.lines.values())
    assert is_onward is nx.is_directed_acyclic_graph(
        nx.DiGraph(edge.ends for edge in graph.edges())
    )


@for_every_graph(count=15, most_nodes=5, most_topics=4)
def test_a_picture_has_as_many_coloured_edges_as_cross_and_a_background_for_what_is_in_hardware(
    graph,
):
    ax = Figure().subplots()
    soc.draw_graph(ax, graph)
    colors = [p.get_edgecolor()[:3] for p in ax.patches if isinstance(p, FancyArrowPatch)]
    assert len(colors) == len(list(graph.edges()))
    crossing = soc.crossing_edges(graph)
    assert colors.count(to_rgb(CROSSING)) == len(crossing)
    in_logic = [topic.name for topic in graph.topics if topic.mapping is not SOFTWARE]
    bands = [patch for patch in ax.patches if to_rgb(patch.get_edgecolor()) == to_rgb(LOGIC)]
    assert len(bands) == len(graph.hardware_nodes) + len(in_logic)
    within = [e for e in graph.edges() if e.node in graph.hardware_nodes and e.topic in in_logic]
    assert sum(line.get_color() == LOGIC for line in ax.lines) == len(within)


def test_a_graph_of_fifty_nodes_fits_a_page_as_a_matrix():
    graph = chain(*[SW, HW] * 25, names=[f"perception_node_{i}" for i in range(50)])
    figure = Figure(layout="constrained")
    soc.draw_mapping(soc.map_communication(graph), figure)
    assert figure.get_size_inches()[0] < 12
    assert [ax.get_title().split(": ")[0] for ax in figure.axes] == list(soc.STAGES)
    figure.savefig(BytesIO(), format="png")
    *_, ax = figure.axes
    assert len(ax.lines) == 2 * 49
    for labels in (ax.get_xticklabels(), ax.get_yticklabels()):
        frames = [label.get_window_extent() for label in labels]
        assert not any(one.overlaps(other) for one, other in pairwise(frames))


def test_long_names_stay_in_their_frames_and_names_in_dollars_are_drawn_as_they_are():
    names = ["publisher of /camera/depth_registered/image_raw", "x" * 200, "lane_planner", "$x^{$"]
    topic = soc.Topic(name="a$_b", publishers=(names[0],), subscribers=tuple(names[1:]))
    graph = soc.Graph(nodes=tuple(soc.Node(name=name) for name in names), topics=(topic,))
    figure = Figure(figsize=layered_layout(graph).size)
    drawn = soc.draw_graph(figure.add_axes((0, 0, 1, 1)), graph)
    figure.savefig(BytesIO(), format="png")
    for frame, text in drawn.values():
        room, extent = frame.get_extents().padded(1), text.get_window_extent()
        assert room.containsx(extent.x1)
        assert room.containsy(extent.y1)
    texts = [text.get_text() for _, text in drawn.values()]
    assert texts[0].split("\n") == ["publisher of", "/camera/", "depth_", "registered/\u2026"]
    assert texts[1].endswith("\u2026")
    assert texts[2:] == ["lane_planner", "$x^{$", "a$_b"]
