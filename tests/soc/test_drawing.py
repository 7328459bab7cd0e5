"""Pictures of graphs: nothing on top of anything else, crossing edges in colour, dashed parts in hardware."""

from io import BytesIO
from itertools import combinations

import networkx as nx
import numpy as np
import pytest
from graph_strategies import GRAPHS, HW, SW, chain, graphs
from hypothesis import given, settings
from matplotlib.colors import to_rgb
from matplotlib.contour import ContourSet
from matplotlib.figure import Figure
from matplotlib.patches import FancyArrowPatch, FancyBboxPatch

from sfglab import soc
from sfglab.errors import InvalidValueError
from sfglab.soc.graph_drawing import CROSSING
from sfglab.soc.layout import ends_of, layered_layout, node_vertex, topic_vertex
from sfglab.soc.mapping import hardware_subgraphs

FIGURE_8 = soc.map_communication(soc.load_graph(GRAPHS / "figure_8.yaml"))


def drawn(graph):
    ax = Figure(layout="constrained").subplots()
    soc.draw_graph(ax, graph)
    return ax


@settings(max_examples=60, deadline=None)
@given(graphs())
def test_all_stand_apart_and_edges_lead_from_end_to_end(graph):
    layout = layered_layout(graph)
    assert len(layout.places) == len(graph.nodes) + len(graph.topics)
    for one, other in combinations(layout.places.values(), 2):
        assert one[0] != other[0] or abs(one[1] - other[1]) > 1 - 1e-9
    for edge, route in layout.routes.items():
        source, target = ends_of(edge)
        assert (route[0], route[-1]) == (layout.places[source], layout.places[target])
    assert set(layout.routes) == set(graph.edges())


@settings(max_examples=60, deadline=None)
@given(graphs())
def test_a_graph_without_cycles_runs_from_left_to_right(graph):
    directed = nx.DiGraph([ends_of(edge) for edge in graph.edges()])
    layout = layered_layout(graph)
    onward = [
        layout.places[target][0] > layout.places[source][0] for source, target in directed.edges
    ]
    assert all(onward) is nx.is_directed_acyclic_graph(directed)


def test_a_chain_is_drawn_in_one_line():
    layout = layered_layout(chain(SW, HW, SW))
    assert [layout.places[node_vertex(name)] for name in "abc"] == [(0, 0), (2, 0), (4, 0)]
    assert layout.places[topic_vertex("ab")] == (1, 0)
    assert layered_layout(chain(SW, HW, SW)) == layout, "the same every time"


@pytest.mark.parametrize("name", ["figure_8", "driving"])
def test_no_line_runs_through_a_frame_that_is_not_its_end(name):
    graph = soc.load_graph(GRAPHS / f"{name}.yaml")
    ax = drawn(graph)
    frames = [patch.get_extents() for patch in ax.patches if isinstance(patch, FancyBboxPatch)]
    lines = [
        patch.get_path().vertices for patch in ax.patches if isinstance(patch, FancyArrowPatch)
    ]
    assert (len(frames), len(lines)) == (
        len(graph.nodes) + len(graph.topics),
        len(list(graph.edges())),
    )
    boxes = [ax.transData.inverted().transform_bbox(frame) for frame in frames]
    for line in lines:
        points = line[2:-12] if len(line) > 20 else line[:0]  # without the arrow's head
        held = [sum(box.contains(x, y) for x, y in points) for box in boxes]
        assert sum(held) == 0, held


@settings(max_examples=15, deadline=None)
@given(graphs(most_nodes=5, most_topics=4))
def test_every_graph_can_be_drawn_with_as_many_coloured_edges_as_cross(graph):
    arrows = [patch for patch in drawn(graph).patches if isinstance(patch, FancyArrowPatch)]
    count = sum(np.allclose(arrow.get_edgecolor()[:3], to_rgb(CROSSING)) for arrow in arrows)
    assert count == len(soc.crossing_edges(graph))


def test_each_part_in_hardware_has_a_dashed_outline():
    for graph in FIGURE_8.stages:
        outlines = [c for c in drawn(graph).collections if isinstance(c, ContourSet)]
        assert len(outlines) == len(hardware_subgraphs(graph))
        assert all(outline.get_linestyle()[0][1] is not None for outline in outlines)


def test_three_pictures_say_ten_eight_and_three_and_one_stage_is_drawn_by_choice():
    figure = Figure(layout="constrained")
    soc.draw_mapping(FIGURE_8, figure)
    titles = [ax.get_title() for ax in figure.axes]
    assert [int(title.split(": ")[1].split()[0]) for title in titles] == [10, 8, 3]
    assert len(figure.legends) == 1
    figure.savefig(BytesIO(), format="png")
    figure = Figure(layout="constrained")
    soc.draw_mapping(FIGURE_8, figure, "hardware")
    assert [ax.get_title() for ax in figure.axes] == [
        "topics in hardware: 8 edges across the boundary"
    ]
    with pytest.raises(
        InvalidValueError, match="stage: given 'fast', allowed: software, hardware, gateways"
    ):
        soc.draw_mapping(FIGURE_8, Figure(), "fast")


def test_a_graph_of_fifty_nodes_fits_a_page_with_names_that_stand_apart():
    nodes = tuple(
        soc.Node(name=f"perception_node_{i}", placement=(SW, HW)[i % 3 == 0]) for i in range(50)
    )
    names = [node.name for node in nodes]
    topics = tuple(
        soc.Topic(
            name=f"topic_{i}", publishers=(names[i],), subscribers=(names[i + 1], names[i + 4])
        )
        for i in range(45)
    )
    figure = Figure(layout="constrained")
    soc.draw_mapping(
        soc.map_communication(soc.Graph(nodes=nodes, topics=topics)), figure, "gateways"
    )
    assert figure.get_size_inches().max() < 11
    figure.savefig(BytesIO(), format="png")
    (ax,) = figure.axes
    for labels in (ax.get_xticklabels(), ax.get_yticklabels()):
        frames = [label.get_window_extent() for label in labels]
        assert len(frames) >= 45
        assert not any(one.overlaps(other) for one, other in combinations(frames, 2))
    assert len(ax.lines) == 3 * 45


def test_frames_of_long_names_stand_apart_and_names_in_dollars_are_drawn_as_they_are():
    names = [
        "publisher of /camera/depth_registered/image_raw",
        "participant " + "ab" * 16,
        "x" * 200,
        "n",
    ]
    topics = tuple(
        soc.Topic(
            name=f"/a_rather_long/name_of_a_topic_{i}",
            publishers=(names[0],),
            subscribers=tuple(names[1:]),
        )
        for i in range(3)
    )
    ax = drawn(soc.Graph(nodes=tuple(soc.Node(name=name) for name in names), topics=topics))
    frames = [patch.get_extents() for patch in ax.patches if isinstance(patch, FancyBboxPatch)]
    assert not any(one.overlaps(other) for one, other in combinations(frames, 2))
    texts = [text.get_text() for text in ax.texts]
    assert "n" in texts
    assert any(text.endswith("\u2026") for text in texts)
    topic = soc.Topic(name="a$_b", publishers=("$x^{$",), subscribers=("$x^{$",))
    ax = drawn(soc.Graph(nodes=(soc.Node(name="$x^{$"),), topics=(topic,)))
    ax.figure.savefig(BytesIO(), format="png")
