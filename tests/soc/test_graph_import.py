"""Graphs from logs and from live DDS domains."""

import asyncio

import pytest
from graph_strategies import GRAPHS, chain

from sfglab import bus, soc
from sfglab.errors import InvalidValueError
from sfglab.messages import default_message
from sfglab.qos import QoSProfile
from sfglab.record import LogReader, LogWriter
from sfglab.record.traffic import COMPUTATION_GRAPH

STRING = "std_msgs/msg/String"
IMAGE = "sensor_msgs/msg/Image"
SW = soc.Placement.SOFTWARE


@pytest.fixture
def imported(tmp_path):
    """The graph of a log with eleven messages of each topic, 100 ms apart."""

    def write_and_read(topics, metadata=None):
        with LogWriter(tmp_path / "run.mcap") as log:
            for i in range(11):
                for topic in topics:
                    message = default_message(STRING)
                    message.data = "x" * 100
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
    assert (topic.subscribers, found.left_out, found.graph.name) == ((), (), "run.mcap")
    assert soc.read_graph(soc.graph_text(found.graph)) == found.graph


def test_a_log_that_says_who_publishes_gives_the_nodes_too(imported):
    graph = chain(SW, SW, SW)
    found = imported(["ab", "bc", "/x"], soc.graph_metadata(graph)).graph
    assert list(found.edges())[-4:] == list(graph.edges())
    assert found.topic("/x").publishers == ("publisher of /x",)
    assert set(found.in_hardware) == set()


def test_a_topic_that_the_record_gives_no_publisher_is_left_out_with_the_reason(imported):
    record = {"/a": {"publishers": [], "subscribers": ["s"]}}
    found = imported(["/a"], record)
    (left,) = found.left_out
    assert (left.topic, left.why) == ("/a", "no publisher in the record 'computation_graph'")
    assert found.graph.topics == ()


def test_a_record_of_another_kind_is_refused(imported):
    with pytest.raises(InvalidValueError, match=r"run\.mcap: computation_graph\./a: given .* allowed: lists"):
        imported(["/a"], {"/a": {"publishers": "me"}})


def test_the_reference_logs_of_this_repository_have_graphs_without_their_tables():
    with LogReader(GRAPHS.parent / "reference" / "decode_once.mcap") as log:
        found = soc.graph_from_log(log)
        assert log.tables
    assert not any(topic.name.startswith("/table/") for topic in found.graph.topics)


def endpoint(kind, topic, node="", type_name=STRING, dds_topic=None, participant=b"\1" * 16):
    return bus.EndpointInfo(
        kind=bus.EndpointKind[kind],
        topic=topic,
        type=type_name,
        gid=bytes(16),
        qos=QoSProfile(),
        node=node,
        dds_topic=f"rt{topic}" if dds_topic is None else dds_topic,
        participant=participant,
    )


def test_endpoints_become_a_graph_of_the_nodes_that_own_them():
    found = soc.graph_from_endpoints(
        [
            endpoint("PUBLISHER", "/image", "/camera", IMAGE),
            endpoint("PUBLISHER", "/image", "/camera", IMAGE),  # in shared memory beside DDS
            endpoint("SUBSCRIPTION", "/image", "/blur", IMAGE),
            endpoint("SUBSCRIPTION", "/image", "", IMAGE),
            endpoint("PUBLISHER", "/rosout", "/camera"),
            endpoint("PUBLISHER", "rq/sumRequest", "/camera", dds_topic="rq/sumRequest"),
        ],
        name="here",
    )
    assert found.left_out == ()
    assert [topic.name for topic in found.graph.topics] == ["/image"]
    topic = found.graph.topic("/image")
    assert topic.publishers == ("/camera",)
    assert topic.subscribers == ("/blur", "participant " + "01" * 16)
    assert (topic.type, topic.size_bytes, topic.rate_hz, found.graph.name) == (IMAGE, None, None, "here")


def test_a_topic_without_publishers_or_with_two_types_is_left_out_with_the_reason():
    found = soc.graph_from_endpoints(
        [
            endpoint("SUBSCRIPTION", "/lone", "/a"),
            endpoint("PUBLISHER", "/two", "/a"),
            endpoint("SUBSCRIPTION", "/two", "/b", IMAGE),
        ]
    )
    assert [(left.topic, left.why) for left in found.left_out] == [
        ("/lone", "nobody publishes it"),
        ("/two", f"it has more than one type: {IMAGE}, {STRING}"),
    ]
    assert found.graph.nodes == ()


@pytest.mark.live
def test_the_graph_of_a_live_domain_names_the_nodes_on_both_sides(domain_id):
    async def scenario():
        def node(name):
            return bus.Node(name, domain_id=domain_id, interface="lo")

        async with node("camera") as camera, node("blur") as blur, node("looker") as looker:
            camera.create_publisher(IMAGE, "/image")
            blur.create_subscription(IMAGE, "/image")
            blur.create_publisher(STRING, "/note")
            ready = await looker.graph.wait_for(lambda: len(looker.graph.endpoints()) >= 3)
            assert ready
            return await soc.watch_graph(looker)

    found = asyncio.run(scenario()).graph
    assert [str(edge) for edge in found.edges()] == ["/camera -> /image", "/image -> /blur", "/blur -> /note"]
    assert found.topic("/image").type == IMAGE
    assert found.name == "seen by looker"


@pytest.mark.live
async def test_owners_that_stay_unknown_are_named_after_their_participant(domain_id):
    quiet = bus.Node("quiet", domain_id=domain_id, interface="lo", discovery_info=False)
    async with quiet, bus.Node("looker", domain_id=domain_id, interface="lo") as looker:
        quiet.create_publisher(STRING, "/t")
        assert await looker.graph.wait_for(lambda: looker.graph.publishers("/t") != ())
        guid, found = quiet.guid, await soc.watch_graph(looker, timeout_s=0.3)
    assert found.graph.topic("/t").publishers in (("/quiet",), (f"participant {guid.hex()}",))
