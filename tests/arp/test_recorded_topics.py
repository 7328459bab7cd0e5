"""Topics of a recording as a plan of QoS wants them: from our logs and from other people's bags."""

import sys
from itertools import product

import pytest
from commands import called
from rosbags.rosbag2 import Writer
from rosbags.typesys import Stores, get_typestore
from waiting import program

from sfglab.arp.recorded import topics_from_log, topics_text
from sfglab.arp.topics import load_topics, read_topics
from sfglab.documents import Document
from sfglab.errors import SfglabError
from sfglab.qos import Durability, QoSProfile, Reliability
from sfglab.record import LogReader, LogWriter
from sfglab.record.traffic import COMPUTATION_GRAPH
from sfglab.soc import load_graph

JAZZY = get_typestore(Stores.ROS2_JAZZY)
POINT = "geometry_msgs/msg/PointStamped"


def reading(number: int) -> bytes:
    """Return a reading at 20 Hz that changes with every fifth; its time is always another."""
    kinds = JAZZY.types
    stamp = kinds["builtin_interfaces/msg/Time"](sec=number, nanosec=number)
    header = kinds["std_msgs/msg/Header"](stamp=stamp, frame_id="front")
    point = kinds["geometry_msgs/msg/Point"](x=number // 5, y=0.0, z=0.0)
    return JAZZY.serialize_cdr(kinds[POINT](header=header, point=point), POINT)


def test_a_bag_of_ros_2_gives_rate_size_and_how_often_the_value_changes(tmp_path):
    bag_path = tmp_path / "bag"
    with Writer(bag_path, version=9) as bag:
        once = bag.add_connection("/once", POINT, typestore=JAZZY)
        place = bag.add_connection("/global/go2/place", POINT, typestore=JAZZY)
        bag.write(once, 0, reading(0))
        for number in range(101):
            bag.write(place, number * 50_000_000, reading(number))
    with LogReader(bag_path) as log:
        (topic,), left_out = topics_from_log(log)
    assert (topic.name, topic.source, topic.target) == ("/global/go2/place", "go2", "station")
    assert (topic.rate_max_hz, topic.change_s) == (20, 0.25)
    assert topic.size_bytes == len(reading(0))
    assert left_out == {"/once": "it has too few messages to tell a rate"}
    called("qos", str(bag_path), "--format", "topics", "--output", str(tmp_path))
    assert load_topics(tmp_path / "topics.yaml").topics == (topic,)


RECORDED = QoSProfile(reliability=Reliability.BEST_EFFORT, durability=Durability.TRANSIENT_LOCAL)
SIDES = {  # publishers and subscribers
    "/a": (["/go2/cam"], ["/spot/map", "/base/map", "/go2/own"]),
    "/b: {": (["/go2/cam"], ["/base/map"]),
    "/own": (["/go2/cam"], ["/go2/own"]),
    "/global/go2/scan": (["/camera"], ["/rviz"]),
    "/both": (["/go2/cam", "/spot/cam"], ["/base/map"]),
    "/heard": ([], ["/base/map"]),
    "/silent": (None, ["/base/map"]),
}


def test_who_publishes_and_subscribes_decides_what_crosses_with_the_recorded_qos(tmp_path):
    graph = {t: {"publishers": p, "subscribers": s} for t, (p, s) in SIDES.items()}
    del graph["/silent"]["publishers"]
    with LogWriter(tmp_path / "a.mcap") as log:
        log.write_metadata(COMPUTATION_GRAPH, graph)
        for topic, at in product(SIDES, range(0, 11 * 10**8, 10**8)):
            given = {"log_time_ns": at, "qos": RECORDED}
            log.write_raw(topic, "std_msgs/msg/UInt8", b"\0\1\0\0\7", **given)
    with LogReader(tmp_path / "a.mcap") as log:
        topics, left_out = topics_from_log(log)
    assert [(t.name, t.source, t.target, t.change_s) for t in topics] == [
        ("/a", "go2", ("base", "spot"), 1.0),
        ("/global/go2/scan", "go2", "station", 1.0),
    ]
    assert topics[0].reliability is RECORDED.reliability
    assert topics[0].durability is RECORDED.durability
    assert read_topics(Document(topics_text(topics, "a\n.mcap"), "a.yaml")).topics == topics
    assert left_out == {
        "/b: {": "it has no topic name of ROS 2",
        "/own": "it stays on go2",
        "/both": "more than one host publishes it: go2, spot",
        "/heard": "nobody publishes it",
        "/silent": "nobody publishes it",
    }


@pytest.mark.live
def test_what_runs_is_recorded_for_a_plan_and_for_a_mapping(domain_id, tmp_path):
    """A publisher and a subscription of other processes, from a domain's graph and messages."""
    at = ("--domain", str(domain_id), "--interface", "lo")
    name, kind = "/global/go2/word", "std_msgs/msg/String"
    topic = (sys.executable, "-m", "sfglab", "topic")
    speaks = ("pub", "-r", "20", name, kind, "{data: hello}")
    with program(*topic, *speaks, *at), program(*topic, "echo", name, kind, *at) as hearer:
        hearer.stdout.readline()  # it hears
        called("qos", *at, "--duration", "4", "--format", "topics", "--output", str(tmp_path))
        called("map", *at, "--duration", "4", "--output", str(tmp_path / "graph.yaml"))
    (found,) = load_topics(tmp_path / "topics.yaml").topics
    assert (found.name, found.source, found.target) == (name, "go2", "station")
    assert found.rate_max_hz == pytest.approx(20, rel=0.3)
    (mapped,) = load_graph(tmp_path / "graph.yaml").topics
    assert (len(mapped.publishers), len(mapped.subscribers)) == (1, 1)


def test_a_file_and_a_domain_are_refused():
    with pytest.raises(SfglabError, match="a file and --domain exclude each other"):
        called("map", "a.yaml", "--domain", "3")
