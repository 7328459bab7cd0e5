"""Computation graphs: what they refuse, and how they go into YAML and come back."""

import re
import string
from contextlib import suppress

import pytest
from graph_strategies import GRAPHS, HW, SW, chain, for_every_graph
from hypothesis import example
from hypothesis import strategies as st

from sfglab import soc
from sfglab.documents import Document
from sfglab.errors import InvalidValueError


def read(text):
    return Document(text, "g.yaml").read(soc.Graph)


@for_every_graph()
@example(
    soc.Graph(
        nodes=(soc.Node(name="1"), soc.Node(name="no")), description="a\x85b\u2028c\u2029d\ne"
    )
)
def test_a_graph_is_read_back_as_it_was_written_and_written_again_byte_by_byte(graph):
    text = soc.graph_text(graph)
    assert read(text) == graph
    assert soc.graph_text(read(text)) == text


@pytest.mark.parametrize("path", sorted(GRAPHS.glob("*.yaml")), ids=lambda path: path.name)
def test_the_graphs_of_this_repository_are_written_as_they_stand_in_their_files(path):
    assert soc.graph_text(soc.load_graph(path)) == path.read_text()


def test_what_stands_in_a_file_once_has_its_default_elsewhere():
    topic = soc.Topic(name="t", publishers=("a",), mapping=soc.TopicMapping.SOFTWARE)
    graph = soc.Graph(nodes=(soc.Node(name="a", placement=SW),), topics=(topic,))
    assert read("nodes: {a: {}}\ntopics: {t: {publishers: [a]}}") == graph


MISTAKES = [
    (
        "nodes: {camera: {}}\ntopics: {t: {publishers: [camera], subscribers: [camra]}}",
        "g.yaml:2: topics.t.subscribers: given 'camra', allowed: one of camera; did you mean 'camera'?",
    ),
    (
        "nodes: {a: {}}\ntopics: {t: {subscribers: [a]}}",
        "g.yaml:2: topics.t.publishers: nothing is given, needed: the key 'publishers'",
    ),
    (
        "nodes: {a: {}}\ntopics: {t: {publishers: []}}",
        "topics.t.publishers: nothing is given, needed: at least one node that publishes the topic",
    ),
    (
        "nodes: {a: {}}\ntopics: {t: {publishers: [a, a]}}",
        "topics.t.publishers: given 'a', allowed: each name once, and it is there 2 times",
    ),
    ("nodes: {a: {rate_hz: -1}}", "nodes.a.rate_hz: given -1, allowed: a finite number from 0"),
    (
        "nodes: {a: {}}\ntopics: {t: {publishers: [a], mapping: hardware}}",
        "topics.t.mapping: given 'hardware', allowed: software or gateway, as 'a' is placed in software",
    ),
    ("topics: {}", "g.yaml:1: nodes: nothing is given, needed: the key 'nodes'"),
    (
        f"nodes: { {name: {} for name in string.ascii_lowercase[:13]} }\ntopics: {{t: {{publishers: [z]}}}}",
        "given 'z', allowed: one of a, b, c, d, e, f, g, h, i, j, k, l, ...",
    ),
    ("nodes: {'': {}}", "nodes: given '', allowed: names that are not empty"),
]


@pytest.mark.parametrize(("text", "said"), MISTAKES)
def test_a_mistake_is_named_with_file_key_what_is_given_and_what_is_allowed(text, said):
    with pytest.raises(InvalidValueError, match=re.escape(said)):
        read(text)


@for_every_graph(st.data())
def test_no_change_of_a_word_makes_another_error_than_ours(graph, data):
    text = soc.graph_text(graph)
    start = data.draw(st.integers(0, len(text)))
    end = data.draw(st.integers(start, len(text)))
    put = data.draw(st.sampled_from(["", "x", "[", "{}", ": ", "\n", "null", "- "]))
    with suppress(InvalidValueError):
        read(text[:start] + put + text[end:])


INSIDE = chain(HW, HW, topic_mapping=soc.TopicMapping.HARDWARE)


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (
            lambda: soc.Graph(nodes=INSIDE.nodes[:1] * 2),
            "nodes: given 'a', allowed: each name once, .* 2 times",
        ),
        (
            lambda: soc.Graph(nodes=INSIDE.nodes, topics=INSIDE.topics * 2),
            "topics: given 'ab', allowed: each name once",
        ),
        (lambda: INSIDE.with_placements({"z": HW}), "nodes: given 'z', allowed: one of a, b"),
        (
            lambda: INSIDE.with_mappings({"bb": soc.TopicMapping.GATEWAY}),
            "topics: given 'bb', allowed: one of ab",
        ),
    ],
)
def test_the_graph_itself_refuses_what_its_file_would_and_names_that_are_not_there(make, said):
    with pytest.raises(InvalidValueError, match=said):
        make()
