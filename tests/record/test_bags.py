"""Bags of every ROS 2 from Humble to Kilted, in its own format, as logs; and ROS 1's."""

import itertools
import sqlite3

import numpy as np
import pytest
import yaml
from commands import called
from rosbags.rosbag2 import Reader, StoragePlugin, Writer
from rosbags.rosbag2.metadata import parse_qos
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from sfglab.messages import default_message, message_type, serialize
from sfglab.qos import LATCHED
from sfglab.record import LogError, LogReader, LogWriter
from sfglab.record.metadata import offered_qos_profiles
from sfglab.spatial import Pose, StampedTransform
from sfglab.view.arrivals import arrivals_of, decoded

STRING = "std_msgs/msg/String"
TRANSFORMS = "tf2_msgs/msg/TFMessage"
RANGE = "sensor_msgs/msg/Range"
OWN = "bag_msgs/msg/Thing"
# Formats of metadata.yaml (rosbag2_storage, bag_metadata.hpp), and of the tables in SQLite.
FORMATS = {"humble": 5, "iron": 8, "jazzy": 9, "kilted": 9}
BAGS = list(itertools.product(FORMATS, StoragePlugin))
SECOND = 10**9


def transforms(parent, child):
    one = StampedTransform(parent=parent, child=child, stamp_ns=0, pose=Pose())
    return message_type(TRANSFORMS)(transforms=[one.to_msg()])


def as_humble_has_it(path, storage):
    """Take out what came after Humble: hashes, definitions, what wrote it."""
    metadata = yaml.safe_load((path / "metadata.yaml").read_text())
    bag = metadata["rosbag2_bagfile_information"]
    bag["version"] = FORMATS["humble"]
    for later in ("custom_data", "ros_distro"):
        del bag[later]
    for topic in bag["topics_with_message_count"]:
        del topic["topic_metadata"]["type_description_hash"]
    (path / "metadata.yaml").write_text(yaml.safe_dump(metadata))
    if storage is StoragePlugin.SQLITE3:
        with sqlite3.connect(path / f"{path.name}.db3") as database:
            for table in ("message_definitions", "schema", "metadata"):
                database.execute(f"DROP TABLE {table}")
            database.execute("ALTER TABLE topics DROP COLUMN type_description_hash")


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
    with Writer(path, version=max(FORMATS[name], 8), storage_plugin=storage) as writer:
        for topic, kind, cdr, qos in given:
            connection = writer.add_connection(
                topic, kind, typestore=store, offered_qos_profiles=qos
            )
            for second in range(3):
                writer.write(connection, second * SECOND, cdr)
    if name == "humble":
        as_humble_has_it(path, storage)
    return path, name == "humble" and storage is StoragePlugin.SQLITE3


def test_a_bag_is_a_log(bag):
    path, undefined = bag
    with LogReader(path) as log:
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
        if undefined:
            with pytest.raises(
                LogError, match=r"/thing: given .*types known here and by --interfaces"
            ):
                next(log.decoded("/thing"))
        else:
            assert next(log.decoded("/thing")).message.what == "cup"
    with pytest.raises(LogError, match="closed"):
        next(log.messages())


def test_commands_take_bags(bag, tmp_path):
    path, _ = bag
    for target in (path, *path.glob("*.db3"), *path.glob("*.mcap")):
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


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("empty", "given a folder without .mcap or .db3 files"),
        ("a.db3", "damaged or not readable"),
        ("a.bag", "a bag of ROS 1: convert it with rosbags-convert"),
        ("cut", "damaged or not readable"),
    ],
)
def test_what_is_no_bag_is_one_sentence(tmp_path, name, said):
    path = tmp_path / name
    if name == "empty":
        path.mkdir()
    elif name == "cut":
        with Writer(path, version=9) as writer:
            connection = writer.add_connection(
                "/words", STRING, typestore=get_typestore(Stores.ROS2_JAZZY)
            )
            for time_ns in range(2000):
                writer.write(connection, time_ns, serialize(message_type(STRING)("x" * 100)))
        data = (path / "cut.db3").read_bytes()
        (path / "cut.db3").write_bytes(data[: len(data) // 2])
    else:
        path.write_bytes(b"SQLite format 3\0" * 10)
    with pytest.raises(LogError, match=said) as raised, LogReader(path) as log:
        list(log.messages())
    assert str(path) in str(raised.value)


def test_what_we_record_is_read_with_the_types_of_jazzy(tmp_path):
    """`test_interoperation` has the definitions of the log; these are a distribution's own."""
    rng = np.random.default_rng(3)
    image = default_message("sensor_msgs/msg/Image", data=rng.integers(0, 256, 99, np.uint8))
    given = {"/tf": transforms("map", "go2/odom"), "/image": image}
    with LogWriter(tmp_path / "run.mcap") as log:
        for topic, message in given.items():
            log.write(topic, message, log_time_ns=5)
    store = get_typestore(Stores.ROS2_JAZZY)
    with Reader(tmp_path / "run.mcap") as reader:
        cdr = {c.topic: (c.msgtype, data) for c, _, data in reader.messages()}
        read = {
            topic: (kind, store.deserialize_cdr(data, kind)) for topic, (kind, data) in cdr.items()
        }
    assert read.keys() == given.keys()
    for topic, (kind, message) in read.items():
        again = bytes(store.serialize_cdr(message, kind))
        assert again == serialize(given[topic])[: len(again)]
