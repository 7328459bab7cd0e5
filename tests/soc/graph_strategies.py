"""Random graphs for Hypothesis."""

from itertools import pairwise
from pathlib import Path

from hypothesis import given, settings
from hypothesis import strategies as st

from sfglab.soc import (
    Graph,
    Implementation,
    Node,
    Placement,
    Topic,
    TopicMapping,
    load_graph,
    map_communication,
)

GRAPHS = Path(__file__).parents[2] / "data" / "graphs"
FIGURE_8 = map_communication(load_graph(GRAPHS / "figure_8.yaml"))
HW, SW = Placement.HARDWARE, Placement.SOFTWARE

names = st.text(st.characters(categories=("L", "N", "P", "S", "Zs")), min_size=1, max_size=8)
texts = st.text(st.characters(exclude_categories=("Cs",)), max_size=30)
numbers = st.floats(0, 1e12, allow_nan=False)
wholes = st.integers(0, 10**12)
implementations = st.builds(Implementation, lut=wholes, bram=numbers, time_s=numbers)


@st.composite
def graphs(draw, most_nodes=8, most_topics=6, names=names):
    """Graphs of all kinds, also with names that YAML would take for numbers, and with mapped topics."""
    node = st.builds(
        Node,
        name=names,
        placement=st.sampled_from(Placement),
        rate_hz=numbers,
        software_s=numbers,
        hardware=st.none() | implementations,
    )
    several = st.lists(node, min_size=1, max_size=most_nodes, unique_by=lambda node: node.name)
    known = {node.name: node for node in draw(several)}
    member = st.sampled_from(list(known))
    some, any_number = (st.lists(member, min_size=n, unique=True).map(tuple) for n in (1, 0))
    topics = []
    for name in draw(st.lists(names, max_size=most_topics, unique=True)):
        publishers, subscribers = draw(some), draw(any_number)
        apart = any(not known[member].in_hardware for member in (*publishers, *subscribers))
        allowed = [m for m in TopicMapping if m is not TopicMapping.HARDWARE or not apart]
        topics.append(
            Topic(
                name=name,
                publishers=publishers,
                subscribers=subscribers,
                type=draw(st.sampled_from(["", "std_msgs/msg/String", "yes"])),
                size_bytes=draw(st.none() | wholes),
                rate_hz=draw(st.none() | numbers),
                mapping=draw(st.sampled_from(allowed)),
            )
        )
    described = {"name": draw(texts), "description": draw(texts)}
    return Graph(nodes=tuple(known.values()), topics=tuple(topics), **described)


def for_every_graph(*more, count=60, **bounds):
    """Run a test with random graphs, and with values of more strategies."""

    def decorated(test):
        return settings(max_examples=count, deadline=None)(given(graphs(**bounds), *more)(test))

    return decorated


def chain(*placements, names="abcdef", topic_mapping=TopicMapping.SOFTWARE):
    """A graph of nodes a, b, ... in a row, with topics ab, bc, ... of 1 MB at 10 Hz between them."""
    nodes = [Node(name=name, placement=at) for name, at in zip(names, placements, strict=False)]
    traffic = {"size_bytes": 1_000_000, "rate_hz": 10.0, "mapping": topic_mapping}
    topics = []
    for one, other in pairwise(node.name for node in nodes):
        topics.append(Topic(name=one + other, publishers=(one,), subscribers=(other,), **traffic))
    return Graph(nodes=tuple(nodes), topics=tuple(topics))
