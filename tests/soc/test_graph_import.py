"""Graphs from logs."""

from itertools import product

import pytest
from graph_strategies import GRAPHS

from sfglab import soc
from sfglab.errors import InvalidValueError
from sfglab.messages import default_message
from sfglab.record import LogReader, LogWriter

STRING = "std_msgs/msg/String"


def imported(folder, topics, **records):
    """The graph of a log with eleven messages of each topic, 100 ms apart."""
    message = default_message(STRING, data="x" * 100)
    with LogWriter(folder / "run.mcap") as log:
        for i, topic in product(range(11), topics):
            log.write(topic, message, log_time_ns=i * 100_000_000)
        for name, record in records.items():
            log.write_metadata(name, record)
    with LogReader(folder / "run.mcap") as log:
        return soc.graph_from_log(log)


def test_a_log_gives_topics_with_types_sizes_and_rates(tmp_path):
    found = imported(tmp_path, ["/a", "/b"])
    topic = soc.Topic(
        name="/a",
        publishers=("publisher of /a",),
        type=STRING,
        size_bytes=4 + 4 + 100 + 1 + 3,  # header, length, text, its end, padding
        rate_hz=pytest.approx(10),
    )
    assert found.graph.topic("/a") == topic
    assert (found.left_out, found.graph.name) == ({}, "run.mcap")


def test_a_record_of_the_graph_gives_the_nodes_too_and_leaves_out_topics_without_publisher(
    tmp_path,
):
    record = {
        "/seen": {"publishers": ["camera"], "subscribers": ["viewer"]},
        "/no": {"publishers": [], "subscribers": ["viewer"]},
    }
    found = imported(tmp_path, ["/seen", "/x", "/no"], computation_graph=record)
    edges = {str(edge) for edge in found.graph.edges()}
    assert edges == {"publisher of /x -> /x", "camera -> /seen", "/seen -> viewer"}
    assert not found.graph.hardware_nodes
    assert found.left_out == {"/no": "no publisher in the record 'computation_graph'"}


def test_a_record_of_another_kind_is_refused(tmp_path):
    said = r"run\.mcap: computation_graph\./a\.publishers: given 'me', allowed: a list"
    with pytest.raises(InvalidValueError, match=said):
        imported(tmp_path, ["/a"], computation_graph={"/a": {"publishers": "me"}})


def test_a_graph_of_an_experiment_s_log_has_none_of_its_tables():
    with LogReader(GRAPHS.parent / "reference" / "decode_once.mcap") as log:
        found = soc.graph_from_log(log)
        assert log.tables
    assert not any(topic.name.startswith("/table/") for topic in found.graph.topics)
