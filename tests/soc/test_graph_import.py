"""Graphs from logs."""

import pytest
from graph_strategies import GRAPHS, SW, chain

from sfglab import soc
from sfglab.documents import Document
from sfglab.errors import InvalidValueError
from sfglab.messages import default_message
from sfglab.record import LogReader, LogWriter
from sfglab.record.traffic import COMPUTATION_GRAPH

STRING = "std_msgs/msg/String"


@pytest.fixture
def imported(tmp_path):
    """The graph of a log with eleven messages of each topic, 100 ms apart."""

    def write_and_read(topics, metadata=None):
        message = default_message(STRING, data="x" * 100)
        with LogWriter(tmp_path / "run.mcap") as log:
            for i in range(11):
                for topic in topics:
                    log.write(topic, message, log_time_ns=i * 100_000_000)
            if metadata is not None:
                log.write_metadata(COMPUTATION_GRAPH, metadata)
        with LogReader(tmp_path / "run.mcap") as log:
            return soc.graph_from_log(log)

    return write_and_read


def test_a_log_gives_topics_with_types_sizes_and_rates(imported):
    found = imported(["/a", "/b"])
    topic = found.graph.topic("/a")
    assert (topic.type, topic.rate_hz) == (STRING, pytest.approx(10))
    assert topic.size_bytes == 4 + 4 + 100 + 1 + 3  # header, length, text, its end, padding
    assert topic.publishers == ("publisher of /a",)
    assert (topic.subscribers, found.left_out, found.graph.name) == ((), {}, "run.mcap")
    assert Document(soc.graph_text(found.graph), "g.yaml").read(soc.Graph) == found.graph


def test_a_record_of_the_graph_gives_the_nodes_too_and_leaves_out_topics_without_publisher(
    imported,
):
    graph = chain(SW, SW, SW)
    record = {"/no": {"publishers": [], "subscribers": ["s"]}}
    for topic in graph.topics:
        ends = {"publishers": [*topic.publishers], "subscribers": [*topic.subscribers]}
        record[topic.name] = ends
    found = imported(["ab", "bc", "/x", "/no"], record)
    assert list(found.graph.edges())[-4:] == list(graph.edges())
    assert found.graph.topic("/x").publishers == ("publisher of /x",)
    assert not found.graph.in_hardware
    assert found.left_out == {"/no": "no publisher in the record 'computation_graph'"}


def test_a_record_of_another_kind_is_refused(imported):
    place = r"run\.mcap: computation_graph\./a\.publishers"
    with pytest.raises(InvalidValueError, match=rf"{place}: given 'me', allowed: a list"):
        imported(["/a"], {"/a": {"publishers": "me"}})


def test_a_graph_of_an_experiment_s_log_has_none_of_its_tables():
    with LogReader(GRAPHS.parent / "reference" / "decode_once.mcap") as log:
        found = soc.graph_from_log(log)
        assert log.tables
    assert not any(topic.name.startswith("/table/") for topic in found.graph.topics)
