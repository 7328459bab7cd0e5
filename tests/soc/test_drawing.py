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


def corners(box):
    return np.array([box.x - box.width / 2, box.y - box.height / 2]), np.array(
        [box.x + box.width / 2, box.y + box.height / 2]
    )


def arrows(ax):
    return [patch for patch in ax.patches if isinstance(patch, FancyArrowPatch)]


@settings(max_examples=60, deadline=None)
@given(graphs())
def test_frames_stand_apart_and_lines_lead_between_them_and_through_none(graph):
    layout = layered_layout(graph)
    assert len(layout.boxes) == len(graph.nodes) + len(graph.topics)
    frames = {vertex: corners(box) for vertex, box in layout.boxes.items()}
    for (low, high), (other_low, other_high) in combinations(frames.values(), 2):
        assert (high < other_low).any() or (other_high < low).any()
    assert set(layout.lines) == set(graph.edges())
    for edge, line in layout.lines.items():
        assert (line > 0).all()
        assert (line < layout.size).all()
        for end, vertex in ((line[0], edge.ends[0]), (line[-1], edge.ends[1])):
            low, high = frames[vertex]
            assert (low - 1e-9 <= end).all()
            assert (end <= high + 1e-9).all()
        for low, high in frames.values():
            assert not ((low + 1e-6 < line) & (line < high - 1e-6)).all(axis=1).any()


@settings(max_examples=60, deadline=None)
@given(graphs())
def test_a_graph_without_cycles_runs_from_left_to_right(graph):
    directed = nx.DiGraph([edge.ends for edge in graph.edges()])
    lines = layered_layout(graph).lines.values()
    onward = all(line[0, 0] < line[-1, 0] for line in lines)
    assert onward is nx.is_directed_acyclic_graph(directed)


def test_a_chain_is_drawn_in_one_line_and_few_edges_cross():
    places = layered_layout(chain(SW, HW, SW)).boxes
    assert len({box.y for box in places.values()}) == 1
    steps = np.diff(sorted(box.x for box in places.values()))
    assert np.allclose(steps, steps[0], rtol=0.1)
    lines = layered_layout(FIGURE_8.gateways).lines.values()
    for one, other in combinations(lines, 2):
        x = np.linspace(max(one[0, 0], other[0, 0]), min(one[-1, 0], other[-1, 0]), 50)
        apart = np.interp(x, *one.T) - np.interp(x, *other.T)
        assert x[0] > x[-1] or not (apart.min() < -1e-3 and apart.max() > 1e-3)


@settings(max_examples=15, deadline=None)
@given(graphs(most_nodes=5, most_topics=4))
def test_a_picture_has_as_many_coloured_edges_as_cross_and_a_dashed_outline_per_part(graph):
    ax = Figure().subplots()
    soc.draw_graph(ax, graph)
    coloured = [np.allclose(a.get_edgecolor()[:3], to_rgb(CROSSING)) for a in arrows(ax)]
    assert sum(coloured) == len(soc.crossing_edges(graph))
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
