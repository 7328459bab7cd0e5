"""Pictures of paper C that answer: the core's table and the programme of node mapping have the say."""

from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from sfglab.errors import SfglabError
from sfglab.lab.experiments import gateways
from sfglab.lab.paths import find_project
from sfglab.soc import ZCU104, assess, chain_s, load_graph, map_communication, place_nodes
from sfglab.soc.driving import CHAIN, Chain
from sfglab.soc.exploration import walk
from sfglab.soc.gateway import TABLE, State, Table
from sfglab.soc.gateway_world import Bound, is_finished
from sfglab.soc.graph import TopicMapping

pytest.importorskip("anywidget")
from sfglab.lab.explore.mapping import PressedMapping

DATA = find_project(Path(__file__)).data
DRIVING = load_graph(DATA / "graphs/driving.yaml")
FIGURE_8 = load_graph(DATA / "graphs/figure_8.yaml")


@pytest.fixture(autouse=True)
def undrawn(monkeypatch):
    """What the pictures look like is the browser's test; drawing a thousand of them takes minutes."""
    monkeypatch.setattr("sfglab.lab.explore.press.Pressed._svg", lambda _: "<svg/>")


def test_a_walk_is_stepped_through_by_the_cores_inputs_and_one_that_comes_to_a_fault_says_so():
    run = walk(Bound(), np.random.default_rng(1))
    assert is_finished(run[-1].after, Bound())
    given = gateways.inputs_of(run)
    assert [i.name for i in given] == [
        step.what.split("--")[1] for step in run if "-->" in step.what
    ]
    core = gateways.press_core(run)
    core.at.value = len(given)
    assert core.moment.state is run[-1].after.state
    broken: Table = {**TABLE, State.FILTER_HMT: TABLE[State.FILTER_HMT_HOLDING]}
    with pytest.raises(SfglabError, match="walk of"):
        walk(Bound(), np.random.default_rng(0), broken)


REFUSED = {
    "node:camera": "no implementation",
    "topic:/A": "given &#x27;hardware&#x27;, allowed: software or gateway, as &#x27;visual_odometry&#x27;",
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_cannot_be_is_refused_by_the_graph_or_the_programme(name):
    begin = map_communication(DRIVING).gateways
    picture = PressedMapping(begin, ZCU104, chain=CHAIN)
    picture.press(name)
    assert REFUSED[name] in picture.said
    assert picture.graph == begin
    if name.startswith("topic"):  # the next press passes it over
        picture.press(name)
        assert picture.graph.topic("/A").mapping is TopicMapping.SOFTWARE


def test_a_node_that_moves_takes_its_topics_along_and_what_does_not_fit_is_refused():
    picture = PressedMapping(map_communication(DRIVING).gateways, ZCU104, chain=CHAIN)
    picture.press("node:polyfit")
    assert "polyfit" not in picture.graph.in_hardware
    assert picture.graph.topic("/lane_mask").mapping is TopicMapping.SOFTWARE
    assert picture.graph.topic("/A").mapping is TopicMapping.GATEWAY
    picture.lut.value = assess(picture.graph).lut
    before = picture.graph
    picture.press("node:polyfit")
    assert "ZCU104 has" in picture.said
    assert picture.graph == before


def test_optimise_is_what_the_programme_chooses_with_what_other_choices_would_cost():
    picture = PressedMapping(FIGURE_8)
    picture.answer(picture.optimise)
    assert picture.graph.mapped_to(TopicMapping.GATEWAY) == ("A", "C", "E")
    assert "D to software: 2.04 ms with software, 2.25 ms with gateway" in picture.why.value
    picture = PressedMapping(DRIVING, ZCU104)
    picture.answer(picture.optimise)
    found = place_nodes(DRIVING, ZCU104)
    assert picture.graph == found.graph
    assert f"{1e3 * found.load.total_s:.2f} ms per second" in picture.why.value
    assert "/A without a gateway" in picture.why.value


def test_a_chains_time_is_that_of_its_transfers_and_nodes():
    stages, chain = map_communication(DRIVING), Chain(DRIVING)
    along = [*chain_s(stages.gateways, CHAIN).values()]
    nodes = [DRIVING.node(name).hardware.time_s for name in CHAIN[:-1]]
    assert along[-1] == pytest.approx(chain.gateway_s + sum(chain.fixed_s.values()) + sum(nodes))
    assert all(a < b for a, b in pairwise(along))
    with pytest.raises(SfglabError, match="chain: given 'camera, polyfit'"):
        chain_s(DRIVING, ("camera", "polyfit"))
