"""Node placement: HiGHS against brute force, and what it refuses."""

from dataclasses import replace
from itertools import chain as joined
from itertools import combinations, product

import numpy as np
import pytest
from graph_strategies import HW, SW, chain
from hypothesis import given, settings
from hypothesis import strategies as st

from sfglab import soc
from sfglab.errors import InvalidValueError, SfglabError
from sfglab.soc.memory import STORED
from sfglab.soc.placement import GATEWAY_LUT, carriage_load

SMALL = soc.Platform(name="small", lut=1000, bram=10.0)


def best_of_all_s(graph, platform, fixed):
    """The least load, by trying every placement with every choice of gateways; without the programme."""
    names = [node.name for node in graph.nodes]
    sides = [
        [fixed[node.name]] if node.name in fixed else [SW, HW] if node.hardware else [SW]
        for node in graph.nodes
    ]
    loads = []
    for placements in product(*sides):
        placed = graph.with_placements(dict(zip(names, placements, strict=True)))
        topics = [topic.name for topic in graph.topics]
        for chosen in joined(*(combinations(topics, n) for n in range(len(topics) + 1))):
            mapped = soc.map_communication(placed, gateway=lambda _, t, at=chosen: t.name in at)
            load = soc.assess(mapped.gateways)
            if load.lut <= platform.lut and load.bram <= platform.bram:
                loads.append(load.total_s)
    return min(loads)


def drawn(rng, nodes, share):
    """A random graph, and a platform that holds about a share of all its hardware."""
    made, topics = [], []
    for number in range(nodes):
        times_s = rng.uniform(0, 0.02, 2).tolist()
        lut, bram = int(rng.integers(2_000, 40_000)), float(rng.integers(30))
        part = soc.Implementation(lut=lut, bram=bram, time_s=times_s[0]) if number % 6 else None
        work = {"rate_hz": 20.0, "software_s": times_s[1], "hardware": part}
        made.append(soc.Node(name=f"n{number}", **work))
    for number in range(1 + nodes // 2):
        names = [f"n{place}" for place in rng.permutation(nodes)[: rng.integers(1, 8)]]
        ends = {"publishers": tuple(names[: 1 + number % 2]), "subscribers": tuple(names[1:])}
        traffic = {"size_bytes": int(10 ** rng.uniform(2, 7)), "rate_hz": 10.0}
        topics.append(soc.Topic(name=f"t{number}", **ends, **traffic))
    platform = soc.Platform(name="drawn", lut=int(share * 20_000 * nodes), bram=share * 15 * nodes)
    return soc.Graph(nodes=tuple(made), topics=tuple(topics)), platform


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 2**32), st.integers(1, 6), st.sampled_from([0.2, 0.5, 0.8]))
def test_no_placement_with_any_gateways_is_better_than_the_one_found(seed, nodes, share):
    rng = np.random.default_rng(seed)
    graph, platform = drawn(rng, nodes, share)
    fixed = {node.name: SW for node in graph.nodes if rng.random() < 0.2}
    found = soc.place_nodes(graph, platform, fixed=fixed)
    best_s = best_of_all_s(graph, platform, fixed)
    assert found.load.total_s == pytest.approx(best_s, rel=1e-6, abs=1e-9)
    assert found.optimal
    found.load.check_fits(platform)
    assert all(found.graph.node(name).placement is placement for name, placement in fixed.items())
    assert all(node.hardware is not None for node in found.graph.nodes if node.in_hardware)
    assert found.load == soc.assess(found.graph)


def test_fifty_nodes_are_placed_best_and_a_search_that_a_limit_stops_has_a_gap():
    found = soc.place_nodes(*drawn(np.random.default_rng(1), 50, 0.35), time_limit_s=120)
    assert found.optimal
    graph, platform = drawn(np.random.default_rng(1), 300, 0.35)
    found = soc.place_nodes(graph, platform, time_limit_s=1e-3)
    found.load.check_fits(platform)
    assert 0 <= found.bound_s < found.load.total_s
    assert 0 < found.gap <= 1
    assert not found.optimal


@pytest.mark.parametrize(
    ("size_bytes", "lut", "gateway"),
    [
        (19_500, 10_000, ()),
        (
            20_500,
            10_000,
            ("t",),
        ),  # from here on a carriage by the core takes less than three others
        (20_500, 300 + GATEWAY_LUT, ("t",)),
        (20_500, 299 + GATEWAY_LUT, ()),
    ],
)
def test_a_gateway_is_taken_where_it_pays_and_there_is_room(size_bytes, lut, gateway):
    heard = ("h0", "h1", "h2")
    hardware = soc.Implementation(lut=100)
    nodes = [soc.Node(name=name, rate_hz=10.0, software_s=1.0, hardware=hardware) for name in heard]
    traffic = {"size_bytes": size_bytes, "rate_hz": 10.0}
    topic = soc.Topic(name="t", publishers=("s",), subscribers=heard, **traffic)
    graph = soc.Graph(nodes=(soc.Node(name="s"), *nodes), topics=(topic,))
    found = soc.place_nodes(graph, soc.Platform(name="p", lut=lut, bram=0.0))
    assert found.graph.in_hardware == set(heard)
    assert found.graph.mapped_to(soc.TopicMapping.GATEWAY) == gateway


def test_the_load_is_the_sum_of_work_and_of_carriages_at_the_memory_interface_s_times():
    graph = chain(SW, HW, SW)
    topic = graph.topics[0]
    read_s = STORED.memory.read_s(1_000_000) + 1_000_000 * STORED.deliver_s_per_byte
    one_s = STORED.delegate_s + STORED.deliver_s + read_s
    assert carriage_load(topic, soc.TopicMapping.SOFTWARE) == pytest.approx(10 * one_s, rel=1e-3)
    gateway_s = carriage_load(topic, soc.TopicMapping.GATEWAY)
    assert gateway_s == pytest.approx(10 * (one_s + STORED.endpoint_s), rel=1e-3)
    assert soc.assess(graph).communication_s == pytest.approx(20 * one_s, rel=1e-3)
    gateway = soc.assess(chain(SW, HW, topic_mapping=soc.TopicMapping.GATEWAY))
    assert (gateway.lut, gateway.communication_s) == (GATEWAY_LUT, gateway_s)
    inside = soc.assess(chain(HW, HW, topic_mapping=soc.TopicMapping.HARDWARE))
    assert (inside.lut, inside.communication_s) == (0, 0)
    part = soc.Implementation(lut=7, bram=1.5, time_s=0.25)
    node = soc.Node(name="a", rate_hz=2.0, software_s=1.0, hardware=part)
    load = soc.assess(soc.Graph(nodes=(node, replace(node, name="b", placement=HW))))
    assert (load.software_s, load.hardware_s, load.lut, load.bram) == (2.0, 0.5, 7, 1.5)


@pytest.mark.parametrize("key", ["size_bytes", "rate_hz"])
def test_a_topic_of_unknown_size_or_rate_is_refused_by_name(key):
    graph = chain(SW, HW)
    unknown = replace(graph, topics=(replace(graph.topics[0], **{key: None}),))
    for function in (soc.assess, lambda graph: soc.place_nodes(graph, soc.ZCU104)):
        with pytest.raises(InvalidValueError, match=rf"topics\.ab\.{key}: nothing is given"):
            function(unknown)


def test_fixed_nodes_that_are_not_there_or_do_not_fit_are_refused():
    part = soc.Implementation(lut=2000)
    graph = soc.Graph(nodes=(soc.Node(name="a", hardware=part), soc.Node(name="b")))
    refused = {
        "a": (HW, "take 2000 LUT and 0 BRAM, small has 1000 and 10"),
        "b": (HW, "'b': fixed in hardware, where it has no implementation"),
        "z": (SW, "nodes: given 'z'"),
    }
    for name, (placement, said) in refused.items():
        with pytest.raises(SfglabError, match=said):
            soc.place_nodes(graph, SMALL, fixed={name: placement})
    with pytest.raises(InvalidValueError, match=r"platform\.lut: given -1"):
        replace(SMALL, lut=-1)
