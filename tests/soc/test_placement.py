"""Node mapping: HiGHS against brute force, against the paper's rule, and what it refuses."""

from dataclasses import replace
from itertools import compress, product

import numpy as np
import pytest
from graph_strategies import GRAPHS, HW, SW, chain
from hypothesis import given, settings
from hypothesis import strategies as st

from sfglab import soc
from sfglab.errors import InvalidValueError, SfglabError
from sfglab.lab.checks.placement import cost_s, gateway_choices, random_graph
from sfglab.soc.memory import STORED
from sfglab.soc.placement import carriage_load, gateway_load

TIMES = {"bytes_per_s": 388e6, "carriage_s": 80e-6, "gateway_s": 122e-6}
SMALL = soc.Platform(name="small", lut=1000, bram=10.0, gateway_lut=60, gateway_bram=0.5, **TIMES)


def best_of_all(graph, platform, fixed):
    """The least load, by trying every placement with every choice of gateways; without the programme."""
    free = [n.name for n in graph.nodes if n.hardware and n.name not in fixed]
    chosen_there = frozenset(name for name, side in fixed.items() if side is HW)
    there = (
        chosen_there.union(compress(free, sides))
        for sides in product((False, True), repeat=len(free))
    )
    return min(
        cost_s(graph, one, chosen, platform)
        for one in there
        for chosen in gateway_choices(graph, one)
    )


def drawn(rng, nodes, share=0.35):
    """A random graph, and a platform that holds a share of all its hardware."""
    graph = random_graph(rng, nodes)
    parts = [node.hardware for node in graph.nodes if node.hardware]
    lut, bram = sum(part.lut for part in parts), sum(part.bram for part in parts)
    area = {"lut": int(share * lut), "bram": share * bram, "gateway_lut": 690, "gateway_bram": 0.5}
    return graph, soc.Platform(name="drawn", **area, **TIMES)


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 2**32), st.integers(1, 6), st.sampled_from([0.2, 0.5, 0.8]))
def test_no_placement_with_any_gateways_is_better_than_the_one_found(seed, nodes, share):
    rng = np.random.default_rng(seed)
    graph, platform = drawn(rng, nodes, share)
    fixed = {
        n.name: HW if n.hardware and n.hardware.lut < platform.lut / 10 else SW
        for n in graph.nodes
        if rng.random() < 0.15
    }
    found = soc.place_nodes(graph, platform, fixed=fixed)
    assert found.load.total_s == pytest.approx(
        best_of_all(graph, platform, fixed), rel=1e-6, abs=1e-9
    )
    assert found.optimal
    assert found.load.fits(platform)
    assert all(found.graph.node(name).placement is placement for name, placement in fixed.items())
    assert all(node.hardware is not None for node in found.graph.nodes if node.in_hardware)
    assert found.load == soc.assess(found.graph, platform)


def test_the_driving_graph_is_placed_as_by_brute_force_and_fifty_nodes_best_of_all():
    graph = soc.load_graph(GRAPHS / "driving.yaml")
    tight = replace(soc.ZCU104, lut=40_000)
    found = soc.place_nodes(graph, tight)
    assert found.load.total_s == pytest.approx(best_of_all(graph, tight, {}), rel=1e-6)
    assert 0 < len(found.graph.in_hardware) < 7
    graph, platform = drawn(np.random.default_rng(1), 50)
    found = soc.place_nodes(graph, platform, time_limit_s=120)  # quiet, it takes less than ten
    assert found.optimal


def pair(size_bytes, *, gateway_lut=0, lut=1000):
    """A publisher in software, three subscribers in hardware, and a platform."""
    hardware = soc.Implementation(lut=100, time_s=0.0)
    heard = ("h0", "h1", "h2")
    nodes = [soc.Node(name=name, rate_hz=10.0, software_s=1.0, hardware=hardware) for name in heard]
    topic = soc.Topic(
        name="t", publishers=("s",), subscribers=heard, size_bytes=size_bytes, rate_hz=10.0
    )
    times = {"bytes_per_s": 1e8, "carriage_s": 1e-4, "gateway_s": 1e-3}
    platform = soc.Platform(name="p", lut=lut, bram=0.0, gateway_lut=gateway_lut, **times)
    return soc.Graph(nodes=(soc.Node(name="s"), *nodes), topics=(topic,)), platform


@pytest.mark.parametrize(
    ("size_bytes", "room", "gateway"),
    [
        *((100, {}, ()), (34_999, {}, ()), (35_001, {}, ("t",)), (10**6, {}, ("t",))),
        *(
            (10**6, {"gateway_lut": 50, "lut": lut}, gateway)
            for lut, gateway in ((349, ()), (350, ("t",)))
        ),
    ],
)
def test_a_gateway_is_taken_from_the_size_on_from_which_it_pays_where_there_is_room(
    size_bytes, room, gateway
):
    found = soc.place_nodes(
        *pair(size_bytes, **room)
    )  # 3 (100 us + s / B) = 1 ms + s / B at s = 35 kB
    assert found.graph.in_hardware == {"h0", "h1", "h2"}
    assert found.graph.mapped_to(soc.TopicMapping.GATEWAY) == gateway


def test_the_load_of_a_chain_is_the_sum_of_its_carriages_at_the_fitted_interfaces_times():
    platform = replace(soc.ZCU104, bytes_per_s=1e8, carriage_s=1e-3, gateway_s=2e-3)
    load = soc.assess(chain(SW, HW, SW), platform)
    assert load.communication_s == pytest.approx(2 * 10 * (1e-3 + 1e6 / 1e8))
    assert (
        soc.assess(chain(HW, HW, topic_mapping=soc.TopicMapping.HARDWARE), platform).communication_s
        == 0
    )
    gateway = soc.assess(chain(SW, HW, topic_mapping=soc.TopicMapping.GATEWAY), platform)
    assert gateway.communication_s == pytest.approx(10 * (2e-3 + 1e6 / 1e8))
    assert (gateway.lut, load.lut) == (platform.gateway_lut, 0)
    one, other = (
        replace(chain(SW, HW).topics[0], size_bytes=size, rate_hz=1.0) for size in (0, 256_000)
    )
    assert carriage_load(one, soc.ZCU104) == pytest.approx(STORED.delegate_s + STORED.deliver_s)
    added = carriage_load(other, soc.ZCU104) - carriage_load(one, soc.ZCU104)
    assert added == pytest.approx(
        STORED.memory.read_s(256_000) + 256_000 * STORED.deliver_s_per_byte
    )
    assert gateway_load(one, soc.ZCU104) > carriage_load(one, soc.ZCU104)


def test_a_topic_of_unknown_size_or_rate_is_refused_by_name():
    graph = chain(SW, HW)
    for key in ("size_bytes", "rate_hz"):
        unknown = replace(graph, topics=(replace(graph.topics[0], **{key: None}),))
        with pytest.raises(InvalidValueError, match=rf"topics\.ab\.{key}: nothing is given"):
            soc.place_nodes(unknown, soc.ZCU104)
        with pytest.raises(InvalidValueError, match=rf"topics\.ab\.{key}"):
            soc.assess(unknown, soc.ZCU104)


def test_fixed_nodes_that_are_not_there_or_do_not_fit_are_refused():
    graph = soc.Graph(
        nodes=(soc.Node(name="a", hardware=soc.Implementation(lut=2000)), soc.Node(name="b"))
    )
    with pytest.raises(SfglabError, match="take 2000 LUT and 0 BRAM, small has 1000 and 10"):
        soc.place_nodes(graph, SMALL, fixed={"a": HW})
    with pytest.raises(SfglabError, match="'b': fixed in hardware, where it has no implementation"):
        soc.place_nodes(graph, SMALL, fixed={"b": HW})
    with pytest.raises(InvalidValueError, match="nodes: given 'z'"):
        soc.place_nodes(graph, SMALL, fixed={"z": SW})
    with pytest.raises(InvalidValueError, match=r"platform\.bytes_per_s: given 0"):
        replace(SMALL, bytes_per_s=0)
    with pytest.raises(InvalidValueError, match=r"platform\.lut: given -1"):
        replace(SMALL, lut=-1)


def test_a_search_that_a_limit_stops_leaves_a_mapping_with_its_gap():
    graph, platform = drawn(np.random.default_rng(1), 300)
    found = soc.place_nodes(
        graph, platform, time_limit_s=1e-3
    )  # what HiGHS's heuristics find at once
    assert found.load.fits(platform)
    assert 0 <= found.bound_s < found.load.total_s
    assert 0 < found.gap <= 1
    assert not found.optimal
