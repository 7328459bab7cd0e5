"""Pictures of graphs: nothing on top of anything else, crossing edges in colour, dashed parts in hardware."""

from io import BytesIO
from itertools import combinations, pairwise

import networkx as nx
import numpy as np
import pytest
from graph_strategies import FIGURE_8, HW, SW, chain, for_every_graph
from matplotlib.colors import to_rgb
from matplotlib.contour import ContourSet
from matplotlib.figure import Figure
from matplotlib.patches import FancyArrowPatch

from sfglab import soc
from sfglab.errors import InvalidValueError
from sfglab.soc.graph_drawing import CROSSING
from sfglab.soc.graph_layout import layered_layout
from sfglab.soc.mapping import hardware_parts


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
def test_a_picture_has_as_many_coloured_edges_as_cross_and_a_dashed_outline_per_part(graph):
    ax = Figure().subplots()
    soc.draw_graph(ax, graph)
    colors = [p.get_edgecolor()[:3] for p in ax.patches if isinstance(p, FancyArrowPatch)]
    assert len(colors) == len(list(graph.edges()))
    assert colors.count(to_rgb(CROSSING)) == len(soc.crossing_edges(graph))
    outlines = [c for c in ax.collections if isinstance(c, ContourSet)]
    assert len(outlines) == len(hardware_parts(graph))
    assert all(outline.get_linestyle()[0][1] is not None for outline in outlines)


def titles_of(mapped, *stage):
    """The titles of a mapping's pictures, and whether they have one legend."""
    figure = Figure(layout="constrained")
    soc.draw_mapping(mapped, figure, *stage)
    assert len(figure.legends) == 1
    return [ax.get_title() for ax in figure.axes]


def test_three_pictures_say_ten_eight_and_three_and_one_stage_is_drawn_by_choice():
    titles = titles_of(FIGURE_8)
    assert [int(title.split(": ")[1].split()[0]) for title in titles] == [10, 8, 3]
    hardware = "topics in hardware: 8 edges across the boundary"
    assert titles_of(FIGURE_8, "hardware") == [hardware]
    with pytest.raises(InvalidValueError, match="stage: given 'fast', allowed: software, hardware"):
        titles_of(FIGURE_8, "fast")


def test_a_graph_of_fifty_nodes_fits_a_page_as_a_matrix():
    graph = chain(*[SW, HW] * 25, names=[f"perception_node_{i}" for i in range(50)])
    figure = Figure(layout="constrained")
    soc.draw_mapping(soc.map_communication(graph), figure, "gateways")
    assert figure.get_size_inches().max() < 12
    figure.savefig(BytesIO(), format="png")
    (ax,) = figure.axes
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
