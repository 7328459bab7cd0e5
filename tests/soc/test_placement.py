"""Node placement: HiGHS against brute force, and what it refuses."""

from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from graph_strategies import HW, SW, chain
from hypothesis import given, settings
from hypothesis import strategies as st

from sfglab import soc
from sfglab.errors import InvalidValueError, SfglabError
from sfglab.soc.memory import STORED
from sfglab.soc.placement import GATEWAY_LUT


def best_of_all_s(graph, platform, in_software):
    """The least load, by trying every placement with every choice of gateways; without the programme."""
    movable = [node.hardware and node.name not in in_software for node in graph.nodes]
    sides = [[SW, HW] if moves else [SW] for moves in movable]
    topics = [topic.name for topic in graph.topics]
    loads = []
    for placements in product(*sides):
        names = [node.name for node in graph.nodes]
        placed = graph.with_placements(dict(zip(names, placements, strict=True)))
        for chosen in product([False, True], repeat=len(topics)):
            wanted = dict(zip(topics, chosen, strict=True))
            mapped = soc.map_communication(placed, gateway=lambda _, t, at=wanted: at[t.name])
            load = soc.assess(mapped.gateways)
            if load.lut <= platform.lut and load.bram <= platform.bram:
                loads.append(load.total_s)
    return min(loads)


def drawn(seed, nodes, share):
    """A random graph, and a platform that holds about a share of all its hardware."""
    rng = np.random.default_rng(seed)
    made, topics = [], []
    for number in range(nodes):
        area = {"lut": int(rng.integers(2_000, 40_000)), "bram": rng.uniform(0, 30)}
        part = soc.Implementation(**area, time_s=rng.uniform(0, 0.02)) if number % 6 else None
        work = {"rate_hz": 20.0, "software_s": rng.uniform(0, 0.02), "hardware": part}
        made.append(soc.Node(name=f"n{number}", **work))
    for number in range(1 + nodes // 2):
        names = tuple(f"n{place}" for place in rng.permutation(nodes)[: rng.integers(1, 8)])
        ends = {"publishers": names[: 1 + number % 2], "subscribers": names[1:]}
        traffic = {"size_bytes": int(10 ** rng.uniform(2, 7)), "rate_hz": 10.0}
        topics.append(soc.Topic(name=f"t{number}", **ends, **traffic))
    platform = soc.Platform(name="drawn", lut=int(share * 20_000 * nodes), bram=share * 15 * nodes)
    return soc.Graph(nodes=tuple(made), topics=tuple(topics)), platform


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 2**32), st.integers(1, 6), st.sampled_from([0.2, 0.5, 0.8]))
def test_no_placement_with_any_gateways_is_better_than_the_one_found(seed, nodes, share):
    graph, platform = drawn(seed, nodes, share)
    fixed = dict.fromkeys([f"n{seed % 10}"] if seed % 10 < nodes else [], SW)
    found = soc.place_nodes(graph, platform, fixed=fixed)
    best_s = best_of_all_s(graph, platform, fixed)
    assert found.load.total_s == pytest.approx(best_s, rel=1e-6, abs=1e-9)
    assert found.optimal
    found.load.check_fits(platform)
    assert found.graph.hardware_nodes.isdisjoint(fixed)
    assert found.load == soc.assess(found.graph)


def test_fifty_nodes_are_placed_best_and_a_search_that_a_limit_stops_has_a_gap():
    assert soc.place_nodes(*drawn(1, 50, 0.35), time_limit_s=120).optimal
    graph, platform = drawn(1, 300, 0.35)
    found = soc.place_nodes(graph, platform, time_limit_s=1e-3)
    found.load.check_fits(platform)
    assert 0 < found.gap <= 1
    assert not found.optimal


@pytest.mark.parametrize(
    ("mapping", "extra_s", "lut"),
    [
        (soc.TopicMapping.SOFTWARE, 0.0, 0),
        (soc.TopicMapping.GATEWAY, STORED.endpoint_s, GATEWAY_LUT),
    ],
)
def test_the_load_is_the_sum_of_work_and_of_carriages_at_the_memory_interface_s_times(
    mapping, extra_s, lut
):
    part = soc.Implementation(lut=7, bram=1.5, time_s=0.25)
    work = {"rate_hz": 2.0, "software_s": 1.0, "hardware": part}
    graph = chain(SW, HW, HW)
    nodes = tuple(replace(node, **work) for node in graph.nodes)
    mappings = {"ab": mapping, "bc": soc.TopicMapping.HARDWARE}
    load = soc.assess(replace(graph, nodes=nodes).with_mappings(mappings))
    one_s = STORED.delegate_s + STORED.delivery_s(1_000_000) + STORED.read_s(1_000_000)
    assert (load.software_s, load.hardware_s) == (2.0, 2 * 0.5)
    assert (load.lut, load.bram) == (2 * 7 + lut, 2 * 1.5)
    assert load.communication_s == pytest.approx(10 * (one_s + extra_s), rel=1e-3)


@pytest.mark.parametrize(("spare", "topics"), [(0, ("t",)), (-1, ())])
def test_a_gateway_that_pays_is_taken_if_its_last_table_fits(spare, topics):
    part = soc.Implementation(lut=100)
    work = {"rate_hz": 10.0, "software_s": 1.0, "hardware": part}
    heard = ("h0", "h1", "h2")
    nodes = [soc.Node(name="s"), *[soc.Node(name=name, **work) for name in heard]]
    traffic = {"size_bytes": 20_500, "rate_hz": 10.0}
    topic = soc.Topic(name="t", publishers=("s",), subscribers=heard, **traffic)
    platform = soc.Platform(name="p", lut=300 + GATEWAY_LUT + spare, bram=0.0)
    found = soc.place_nodes(soc.Graph(nodes=tuple(nodes), topics=(topic,)), platform)
    assert found.graph.hardware_nodes == set(heard)
    assert found.graph.mapped_to(soc.TopicMapping.GATEWAY) == topics


def test_an_empty_graph_is_placed():
    empty = soc.place_nodes(soc.Graph(nodes=()), soc.ZCU104)
    assert (empty.load.total_s, empty.gap, empty.optimal) == (0, 0, True)


def test_a_topic_of_unknown_rate_is_refused_by_name():
    graph = chain(SW, HW)
    unknown = replace(graph, topics=(replace(graph.topics[0], rate_hz=None),))
    with pytest.raises(InvalidValueError, match=r"topics\.ab\.rate_hz: nothing is given"):
        soc.place_nodes(unknown, soc.ZCU104)


@pytest.mark.parametrize(
    ("name", "placement", "lut", "said"),
    [
        ("a", HW, 1000, "nodes fixed in hardware do not fit small"),
        ("b", HW, 1000, "'b': fixed in hardware, where it has no implementation"),
        ("z", SW, 1000, "nodes: given 'z'"),
    ],
)
def test_fixed_nodes_that_are_not_there_or_do_not_fit_are_refused(name, placement, lut, said):
    part = soc.Implementation(lut=2000)
    graph = soc.Graph(nodes=(soc.Node(name="a", hardware=part), soc.Node(name="b")))
    with pytest.raises(SfglabError, match=said):
        soc.place_nodes(
            graph, soc.Platform(name="small", lut=lut, bram=10.0), fixed={name: placement}
        )
