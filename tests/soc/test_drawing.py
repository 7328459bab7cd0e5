"""Pictures of graphs: nothing on top of anything else, crossing edges in colour, dashed parts in hardware."""

from io import BytesIO
from itertools import combinations

import networkx as nx
import numpy as np
import pytest
from graph_strategies import FIGURE_8, HW, SW, chain, graphs
from hypothesis import given, settings
from matplotlib.colors import to_rgb
from matplotlib.contour import ContourSet
from matplotlib.figure import Figure
from matplotlib.patches import FancyArrowPatch

from sfglab import soc
from sfglab.errors import InvalidValueError
from sfglab.soc.graph_drawing import CROSSING
from sfglab.soc.graph_layout import layered_layout
from sfglab.soc.mapping import hardware_parts


@settings(max_examples=60, deadline=None)
@given(graphs())
def test_frames_stand_apart_and_lines_lead_between_them_and_through_none(graph):
    layout = layered_layout(graph)
    assert len(layout.boxes) == len(graph.nodes) + len(graph.topics)
    for one, other in combinations(layout.boxes.values(), 2):
        is_beside = abs(one.x - other.x) > (one.width + other.width) / 2
        assert is_beside or abs(one.y - other.y) > (one.height + other.height) / 2
    assert set(layout.lines) == set(graph.edges())
    for edge, line in layout.lines.items():
        assert (line > 0).all()
        assert (line < layout.size).all()
        for vertex, box in layout.boxes.items():
            x, y = np.abs(line - (box.x, box.y)).T
            assert not ((x < box.width / 2 - 1e-6) & (y < box.height / 2)).any()
            touches = (x < box.width / 2 + 1e-6) & (y < box.height / 2)
            assert touches[0] == (vertex == edge.ends[0])
            assert touches[-1] == (vertex == edge.ends[1])


@settings(max_examples=60, deadline=None)
@given(graphs())
def test_a_graph_without_cycles_runs_from_left_to_right(graph):
    directed = nx.DiGraph([edge.ends for edge in graph.edges()])
    lines = layered_layout(graph).lines.values()
    onward = all(line[0, 0] < line[-1, 0] for line in lines)
    assert onward is nx.is_directed_acyclic_graph(directed)


def test_a_chain_is_drawn_in_one_line():
    boxes = layered_layout(chain(SW, HW, SW)).boxes.values()
    assert len({box.y for box in boxes}) == 1


@settings(max_examples=15, deadline=None)
@given(graphs(most_nodes=5, most_topics=4))
def test_a_picture_has_as_many_coloured_edges_as_cross_and_a_dashed_outline_per_part(graph):
    ax = Figure().subplots()
    soc.draw_graph(ax, graph)
    arrows = [patch for patch in ax.patches if isinstance(patch, FancyArrowPatch)]
    coloured = [arrow for arrow in arrows if arrow.get_edgecolor()[:3] == to_rgb(CROSSING)]
    assert len(arrows) == len(list(graph.edges()))
    assert len(coloured) == len(soc.crossing_edges(graph))
    outlines = [c for c in ax.collections if isinstance(c, ContourSet)]
    assert len(outlines) == len(hardware_parts(graph))
    assert all(outline.get_linestyle()[0][1] is not None for outline in outlines)


def test_three_pictures_say_ten_eight_and_three_and_one_stage_is_drawn_by_choice():
    figure = Figure(layout="constrained")
    soc.draw_mapping(FIGURE_8, figure)
    titles = [ax.get_title() for ax in figure.axes]
    assert [int(title.split(": ")[1].split()[0]) for title in titles] == [10, 8, 3]
    assert len(figure.legends) == 1
    figure = Figure()
    soc.draw_mapping(FIGURE_8, figure, "hardware")
    (ax,) = figure.axes
    assert ax.get_title() == "topics in hardware: 8 edges across the boundary"
    with pytest.raises(InvalidValueError, match="stage: given 'fast', allowed: software, hardware"):
        soc.draw_mapping(FIGURE_8, Figure(), "fast")


def test_a_graph_of_fifty_nodes_fits_a_page_with_names_that_stand_apart():
    names = [f"perception_node_{i}" for i in range(50)]
    nodes = [soc.Node(name=name, placement=(SW, HW)[i % 3 == 0]) for i, name in enumerate(names)]
    topics = [
        soc.Topic(name=f"topic_{i}", publishers=(names[i],), subscribers=(names[i + 1], names[-1]))
        for i in range(45)
    ]
    figure = Figure(layout="constrained")
    graph = soc.Graph(nodes=tuple(nodes), topics=tuple(topics))
    soc.draw_mapping(soc.map_communication(graph), figure, "gateways")
    assert figure.get_size_inches().max() < 11
    figure.savefig(BytesIO(), format="png")
    (ax,) = figure.axes
    for labels in (ax.get_xticklabels(), ax.get_yticklabels()):
        frames = [label.get_window_extent() for label in labels]
        assert len(frames) >= 45
        assert not any(one.overlaps(other) for one, other in combinations(frames, 2))
    assert len(ax.lines) == 3 * 45


def test_long_names_stay_in_their_frames_and_names_in_dollars_are_drawn_as_they_are():
    names = ["publisher of /camera/depth_registered/image_raw", "x" * 200, "lane_planner", "$x^{$"]
    topic = soc.Topic(name="a$_b", publishers=(names[0],), subscribers=tuple(names[1:]))
    graph = soc.Graph(nodes=tuple(soc.Node(name=name) for name in names), topics=(topic,))
    figure = Figure(figsize=layered_layout(graph).size)
    ax = figure.add_axes((0, 0, 1, 1))
    drawn = soc.draw_graph(ax, graph)
    figure.savefig(BytesIO(), format="png")
    for frame, text in drawn.values():
        assert frame.get_extents().padded(1).containsx(text.get_window_extent().x1)
        assert frame.get_extents().padded(1).containsy(text.get_window_extent().y1)
    texts = [text.get_text() for _, text in drawn.values()]
    assert texts[0].split("\n") == ["publisher of", "/camera/", "depth_", "registered/\u2026"]
    assert texts[1].endswith("\u2026")
    assert texts[2:] == ["lane_planner", "$x^{$", "a$_b"]


def test_a_graph_without_nodes_is_an_empty_picture():
    figure = Figure()
    soc.draw_mapping(soc.map_communication(soc.Graph(nodes=())), figure)
    assert figure.axes[0].get_title().endswith(": 0 edges across the boundary")
