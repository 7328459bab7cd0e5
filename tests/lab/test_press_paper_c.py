"""Pictures of paper C that answer: the core's table and the programme of node mapping have the say."""

from itertools import combinations, pairwise

import numpy as np
import pytest
from made_logs import DATA
from matplotlib.backends.backend_agg import FigureCanvasAgg

from sfglab.errors import SfglabError
from sfglab.lab.experiments import gateways
from sfglab.lab.figures import drawn
from sfglab.soc import ZCU104, assess, chain_s, load_graph, map_communication, place_nodes
from sfglab.soc.driving import CHAIN, Chain
from sfglab.soc.exploration import walk
from sfglab.soc.gateway import TABLE, State, Table
from sfglab.soc.gateway_world import Bound, is_finished
from sfglab.soc.graph import Graph, Node, Topic, TopicMapping

pytest.importorskip("anywidget")
from sfglab.lab.explore.mapping import PressedMapping

DRIVING = load_graph(DATA / "graphs/driving.yaml")
BEGIN = map_communication(DRIVING).gateways


@pytest.fixture(autouse=True)
def undrawn(monkeypatch):
    """No plot is drawn: a thousand take minutes, and the browser's test sees how they look."""
    monkeypatch.setattr("sfglab.lab.explore.press.Pressed._svg", lambda _: "<svg/>")


def test_the_core_to_press_follows_a_walk_and_one_that_comes_to_a_fault_says_so():
    run = walk(Bound(), np.random.default_rng(1))
    assert is_finished(run[-1].after, Bound())
    core = gateways.press_core()
    for step in run:
        if "-->" in step.what:
            core.press(f"{core.moment.state.name}/{step.what.split('--')[1]}")
            assert core.moment.state is step.after.state
    assert not core.said
    broken: Table = {**TABLE, State.FILTER_HMT: TABLE[State.FILTER_HMT_HOLDING]}
    with pytest.raises(SfglabError, match="walk of"):
        walk(Bound(), np.random.default_rng(0), broken)


def pressed():
    return PressedMapping(BEGIN, ZCU104, chain=CHAIN)


def test_a_node_without_an_implementation_stays_in_software():
    picture = pressed()
    picture.press("node:camera")
    assert "no implementation" in picture.said
    assert picture.graph == BEGIN


def test_a_mapping_that_cannot_be_is_refused_and_passed_over_by_the_next_press():
    picture = pressed()
    picture.press("topic:/A")
    assert "allowed: software or gateway, as &#x27;visual_odometry&#x27;" in picture.said
    assert picture.graph == BEGIN
    picture.press("topic:/A")
    assert picture.graph.topic("/A").mapping is TopicMapping.SOFTWARE


def test_a_node_that_moves_takes_its_topics_along_and_what_does_not_fit_is_refused():
    picture = pressed()
    picture.press("node:polyfit")
    assert "polyfit" not in picture.graph.hardware_nodes
    assert picture.graph.topic("/lane_mask").mapping is TopicMapping.SOFTWARE
    picture.lut.value = assess(picture.graph).lut
    before = picture.graph
    picture.press("node:polyfit")
    assert "on ZCU104" in picture.said
    assert picture.graph == before


def test_optimise_is_what_the_programme_chooses_with_what_other_choices_would_cost():
    picture = PressedMapping(DRIVING, ZCU104)
    picture.answer(picture.optimise)
    found = place_nodes(DRIVING, ZCU104)
    assert picture.graph == found.graph
    assert f"{1e3 * found.load.total_s:.2f} ms per second" in picture.why.value
    assert "/A without a gateway" in picture.why.value


def test_a_chains_time_is_that_of_its_transfers_and_nodes():
    chain = Chain(DRIVING)
    along = [*chain_s(BEGIN, CHAIN).values()]
    nodes = [DRIVING.node(name).hardware.time_s for name in CHAIN[:-1]]
    assert along[-1] == pytest.approx(chain.gateway_s + sum(chain.fixed_s.values()) + sum(nodes))
    assert all(a < b for a, b in pairwise(along))


def test_a_chain_that_goes_round_ends_with_its_last_transfer():
    topics = []
    for before, after in ("ab", "ba"):
        ends = {"publishers": (before,), "subscribers": (after,)}
        topics.append(Topic(name=f"/{after}", size_bytes=10**6, **ends))
    graph = Graph(nodes=(Node(name="a"), Node(name="b")), topics=tuple(topics))
    once_s, thrice_s = (max(chain_s(graph, chain).values()) for chain in ("ab", "abab"))
    assert thrice_s == pytest.approx(3 * once_s)


def test_notes_of_the_driving_graph_are_apart():
    pressed = PressedMapping(BEGIN, ZCU104, chain=CHAIN)
    figure = drawn(pressed._size, pressed.draw)
    renderer = FigureCanvasAgg(figure).get_renderer()
    figure.draw(renderer)
    notes = [text for text in figure.axes[0].texts if text.get_bbox_patch()]
    boxes = [note.get_bbox_patch().get_window_extent(renderer) for note in notes]
    assert len(boxes) > 10
    for one, other in combinations(boxes, 2):
        assert not one.padded(4).overlaps(other), "two notes touch"
