"""Bags of ROS 2 from Iron to Kilted as logs, and what is none; `test_reported_logs` has Humble's format."""

import itertools

import pytest
import yaml
from commands import called
from reported import write_db3
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.rosbag2.metadata import parse_qos
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from sfglab.messages import message_type, serialize
from sfglab.qos import LATCHED
from sfglab.record import LogError, LogReader
from sfglab.record.metadata import offered_qos_profiles
from sfglab.spatial import Pose, StampedTransform
from sfglab.view.arrivals import arrivals_of, decoded

STRING = "std_msgs/msg/String"
TRANSFORMS = "tf2_msgs/msg/TFMessage"
RANGE = "sensor_msgs/msg/Range"
OWN = "bag_msgs/msg/Thing"
# Formats of metadata.yaml (rosbag2_storage, bag_metadata.hpp).
FORMATS = {"iron": 8, "jazzy": 9, "kilted": 9}
BAGS = list(itertools.product(FORMATS, StoragePlugin))
SECOND = 10**9


def transforms(parent, child):
    one = StampedTransform(parent=parent, child=child, stamp_ns=0, pose=Pose())
    return message_type(TRANSFORMS)(transforms=[one.to_msg()])


@pytest.fixture(params=BAGS, ids=[f"{name}-{storage.name.lower()}" for name, storage in BAGS])
def bag(request, tmp_path):
    """A bag of a distribution, in one of its two storages: frames, a type of its own, one that changed."""
    name, storage = request.param
    path = tmp_path / name
    store = get_typestore(Stores(f"ros2_{name}"))
    store.register(get_types_from_msg("string what\nbuiltin_interfaces/Time when\n", OWN))
    values = store.types[RANGE].__dataclass_fields__.keys() - {"header", "__msgtype__"}
    zeros = {value: 0 for value in values if not value.isupper()}
    header = store.types["std_msgs/msg/Header"](
        store.types["builtin_interfaces/msg/Time"](3, 0), "sonar"
    )
    far = store.types[RANGE](header=header, **zeros | {"range": 2.5})
    thing = store.types[OWN]("cup", header.stamp)
    given = [
        (
            "/tf_static",
            TRANSFORMS,
            serialize(transforms("map", "go2/odom")),
            parse_qos(offered_qos_profiles(LATCHED)),
        ),
        ("/tf", TRANSFORMS, serialize(transforms("go2/odom", "go2/base")), []),
        ("/range", RANGE, store.serialize_cdr(far, RANGE), []),
        ("/thing", OWN, store.serialize_cdr(thing, OWN), []),
    ]
    with Writer(path, version=FORMATS[name], storage_plugin=storage) as writer:
        for topic, kind, cdr, qos in given:
            connection = writer.add_connection(
                topic, kind, typestore=store, offered_qos_profiles=qos
            )
            for second in range(3):
                writer.write(connection, second * SECOND, cdr)
    return path


def test_a_bag_is_a_log(bag):
    with LogReader(bag) as log:
        assert {topic: (info.type_name, info.count) for topic, info in log.topics.items()} == {
            "/tf_static": (TRANSFORMS, 3),
            "/tf": (TRANSFORMS, 3),
            "/range": (RANGE, 3),
            "/thing": (OWN, 3),
        }
        assert [entry.log_time_ns for entry in log.messages("/tf")] == [0, SECOND, 2 * SECOND]
        assert [
            entry.log_time_ns for entry in log.messages("/tf", start_ns=1, end_ns=2 * SECOND)
        ] == [SECOND]
        times = [entry.log_time_ns for entry in log.messages()]
        assert len(times) == 12
        assert times == sorted(times)
        assert [type(entry.message) for entry in log.decoded("/tf")] == [
            message_type(TRANSFORMS)
        ] * 3
        assert [entry.message.range for entry in log.decoded("/range")] == [2.5] * 3
        assert log.metadata_names in {(), ("rosbag2",)}
        assert not log.truncated
        assert next(log.decoded("/thing")).message.what == "cup"
    with pytest.raises(LogError, match="closed"):
        next(log.messages())


def test_commands_take_bags(bag, tmp_path):
    for target in (bag, *bag.glob("*.db3"), *bag.glob("*.mcap")):
        linted = called("frames", "lint", str(target), "--root", "map", "--agents", "go2")
        assert "3 frames" in linted
        assert f"/thing      {OWN}" in called("log", "info", str(target))
        called("map", str(target), "--out", str(tmp_path / "graph.yaml"))
        drawn = yaml.safe_load((tmp_path / "graph.yaml").read_text())["topics"]
        assert drawn["/range"]["type"] == RANGE
        assert drawn["/range"]["rate_hz"] == 1
        seen = called("view", str(target), "--to", str(tmp_path / "seen.rrd"))
        assert "2 displays, 6 updates shown" in seen.split("\n")
        with LogReader(target) as log:
            arrivals = arrivals_of(log, ["/tf", "/range"])
            shown = [(arrival.topic, decoded(arrival)) for arrival in arrivals]
        assert [topic for topic, _ in shown].count("/tf") == 3
        assert {message.range for topic, message in shown if topic == "/range"} == {2.5}


WRONG = {
    "none.mcap": (None, "no such file"),
    "a.mcap": (b"", "not an MCAP file"),
    "b.mcap": (b"\x89MCAP", "not an MCAP file"),
    "c.mcap": (b"SQLite format 3\0" * 10, "not an MCAP file"),
    "a.db3": (b"SQLite format 3\0" * 10, "damaged or not readable"),
    "a.bag": (b"#ROSBAG V2.0\n", "a bag of ROS 1: convert it with rosbags-convert"),
    "folder": (None, "given a folder without .mcap or .db3 files"),
    "damaged": (None, "not an MCAP file"),
    "cut.db3": (None, "damaged or not readable"),
}


@pytest.mark.parametrize("name", WRONG)
def test_what_is_no_log_is_one_sentence(tmp_path, name, caplog):
    path = tmp_path / name
    content, said = WRONG[name]
    if name == "folder":
        path.mkdir()
    elif name == "damaged":
        path.mkdir()
        (path / "a.mcap").write_bytes(b"nothing")
    elif name == "cut.db3":
        write_db3(path, [("/a", second, bytes(99)) for second in range(2000)]).close()
        content = path.read_bytes()[:99_999]
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(LogError, match=rf"log {path}\S*: {said}"), LogReader(path) as log:
        list(log.messages())
    assert caplog.text == ""
