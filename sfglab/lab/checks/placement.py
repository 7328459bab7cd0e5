"""Checks of node mapping on random graphs: against brute force where possible, and timed where not."""

from __future__ import annotations

import math
import time
from dataclasses import replace
from itertools import chain, combinations, compress, product
from typing import TYPE_CHECKING, Any

from sfglab.soc import (
    ZCU104,
    Graph,
    Implementation,
    Node,
    Placement,
    Platform,
    Topic,
    TopicMapping,
    assess,
    map_communication,
    place_nodes,
)
from sfglab.soc.placement import Load, carriage_load, topic_load

if TYPE_CHECKING:
    from collections.abc import Iterator

    import numpy as np

TOPICS_PER_NODE = 0.6
#: The platform holds this share of all nodes' hardware, so that placing is a choice.
AREA_SHARE = 0.5
TIME_LIMIT_S = 10.0  #: For one programme.


def placed_rows(
    rng: np.random.Generator, *, small: tuple[int, int], large: tuple[int, int]
) -> Iterator[dict[str, Any]]:
    """Yield drawn graphs, placed, by how many and of how many nodes; small ones by brute force too."""
    # What only the first programme of a process costs, loading the solver, is not asked here.
    import cvxpy  # noqa: F401 - loaded for its own sake

    for number in range(small[0]):
        yield _placed("small", number, random_graph(rng, int(rng.integers(5, small[1] + 1))))
    for number in range(large[0]):
        yield _placed("large", number, random_graph(rng, large[1]))


def random_graph(rng: np.random.Generator, nodes: int) -> Graph:
    """Draw a graph of so many nodes, most of which could be hardware, and topics from 100 B to 10 MB."""
    made = tuple(_node(rng, f"n{place}") for place in range(nodes))
    names = [node.name for node in made]
    topics = tuple(
        _topic(rng, f"t{place}", names) for place in range(max(1, int(TOPICS_PER_NODE * nodes)))
    )
    return Graph(nodes=made, topics=topics)


def _node(rng: np.random.Generator, name: str) -> Node:
    rate_hz, software_s = float(rng.choice([10, 20, 30])), float(rng.uniform(0.0005, 0.02))
    part = Implementation(
        lut=int(rng.integers(2_000, 40_000)),
        bram=float(rng.integers(0, 60)) / 2,
        time_s=software_s * float(rng.uniform(0.05, 1.2)),
    )
    hardware = part if rng.random() < 0.85 else None
    return Node(name=name, rate_hz=rate_hz, software_s=software_s, hardware=hardware)


def _topic(rng: np.random.Generator, name: str, names: list[str]) -> Topic:
    def some(least: int, most: int) -> tuple[str, ...]:
        count = min(len(names), int(rng.integers(least, most + 1)))
        return tuple(str(chosen) for chosen in rng.choice(names, size=count, replace=False))

    return Topic(
        name=name,
        publishers=some(1, 2),
        subscribers=some(1, 6),
        size_bytes=int(10 ** rng.uniform(2, 7)),
        rate_hz=float(rng.choice([1, 10, 30])),
    )


def platform_for(graph: Graph) -> Platform:
    """Return the paper's board with `AREA_SHARE` of a graph's hardware."""
    parts = [node.hardware for node in graph.nodes if node.hardware]
    lut, bram = sum(part.lut for part in parts), sum(part.bram for part in parts)
    return replace(ZCU104, name="drawn", lut=int(AREA_SHARE * lut), bram=AREA_SHARE * bram)


def _placed(kind: str, number: int, graph: Graph) -> dict[str, Any]:
    platform, began = platform_for(graph), time.perf_counter()
    found = place_nodes(graph, platform, time_limit_s=TIME_LIMIT_S)
    seconds = time.perf_counter() - began
    greedy = greedy_placement(graph, platform)
    return {
        "kind": kind,
        "graph": number,
        "nodes": len(graph.nodes),
        "topics": len(graph.topics),
        "in_hardware": len(found.graph.in_hardware),
        "gateways": len(found.graph.mapped_to(TopicMapping.GATEWAY)),
        "optimal": found.optimal,
        "seconds": seconds,
        "placed": found.load.total_s,
        "brute_force": brute_force_s(graph, platform) if kind == "small" else math.nan,
        "same_without_gateways": cost_s(graph, found.graph.in_hardware, (), platform),
        "greedy": cost_s(graph, greedy, (), platform),
        "greedy_with_gateways": cost_s(graph, greedy, _paying(graph, greedy, platform), platform),
        "software": cost_s(graph, frozenset(), (), platform),
    }


def greedy_placement(graph: Graph, platform: Platform) -> frozenset[str]:
    """Return a placement that knows nothing of topics: by time saved per share of the area, while it fits."""

    def gain(node: Node, part: Implementation) -> float:
        area = part.lut / max(platform.lut, 1) + part.bram / max(platform.bram, 1e-9)
        return node.rate_hz * (node.software_s - part.time_s) / max(area, 1e-9)

    able = [(node, node.hardware) for node in graph.nodes if node.hardware]
    chosen: list[str] = []
    lut, bram = 0, 0.0
    for node, part in sorted(able, key=lambda pair: gain(*pair), reverse=True):
        if (
            gain(node, part) > 0
            and lut + part.lut <= platform.lut
            and bram + part.bram <= platform.bram
        ):
            chosen.append(node.name)
            lut, bram = lut + part.lut, bram + part.bram
    return frozenset(chosen)


def brute_force_s(graph: Graph, platform: Platform) -> float:
    """Return the least cost of all placements with all choices of gateways, without the programme."""
    able = [node.name for node in graph.nodes if node.hardware]
    there = (frozenset(compress(able, sides)) for sides in product((False, True), repeat=len(able)))
    return min(
        cost_s(graph, one, chosen, platform)
        for one in there
        for chosen in gateway_choices(graph, one)
    )


def gateway_choices(graph: Graph, there: frozenset[str]) -> Iterator[tuple[str, ...]]:
    """Return every set of topics that could be at gateways."""
    mixed = [
        t.name for t in graph.topics if 0 < len(there.intersection(t.members)) < len(t.members)
    ]
    return chain.from_iterable(combinations(mixed, count) for count in range(len(mixed) + 1))


def cost_s(
    graph: Graph, there: frozenset[str], gateways: tuple[str, ...], platform: Platform
) -> float:
    """Return what a placement with given gateways costs; infinite where it does not fit."""
    load = assess(_mapped(graph, there, gateways))
    return load.total_s if _fits(load, platform) else math.inf


def _fits(load: Load, platform: Platform) -> bool:
    return load.lut <= platform.lut and load.bram <= platform.bram


def _mapped(graph: Graph, there: frozenset[str], gateways: tuple[str, ...]) -> Graph:
    sides = {
        n.name: Placement.HARDWARE if n.name in there else Placement.SOFTWARE for n in graph.nodes
    }
    placed = graph.with_placements(sides)
    return map_communication(placed, gateway=lambda _, topic: topic.name in gateways).gateways


def _paying(graph: Graph, there: frozenset[str], platform: Platform) -> tuple[str, ...]:
    """Return the topics that are cheaper at a gateway, the best first, while gateways fit."""
    without = _mapped(graph, there, ())
    saved = {
        t.name: topic_load(without, t) - carriage_load(t, TopicMapping.GATEWAY)
        for t in without.topics
    }
    chosen: tuple[str, ...] = ()
    for name in sorted(saved, key=lambda key: saved[key], reverse=True):
        more = (*chosen, name)
        if saved[name] > 0 and _fits(assess(_mapped(graph, there, more)), platform):
            chosen = more
    return chosen
