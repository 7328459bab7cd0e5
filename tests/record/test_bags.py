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
    """Also with a type that is not known here, and with one that has other fields here."""
    with LogReader(bag) as log:
        assert {topic: (info.type_name, info.count) for topic, info in log.topics.items()} == {
            "/tf_static": (TRANSFORMS, 3),
            "/tf": (TRANSFORMS, 3),
            "/range": (RANGE, 3),
            "/thing": (OWN, 3),
        }
        assert type(next(log.decoded("/tf")).message) is message_type(TRANSFORMS)
        assert [entry.message.range for entry in log.decoded("/range")] == [2.5] * 3
        assert next(log.decoded("/thing")).message.what == "cup"
        assert log.metadata_names in {(), ("rosbag2",)}
        assert not log.truncated
    with pytest.raises(LogError, match="closed"):
        next(log.messages())


def test_commands_take_bags(bag, tmp_path):
    for target in (bag, *bag.glob("*.db3"), *bag.glob("*.mcap")):
        linted = called("frames", "lint", str(target), "--root-frame", "map", "--agent", "go2")
        assert "3 frames" in linted
        assert f"/thing      {OWN}" in called("log", "info", str(target))
        called("map", str(target), "--output", str(tmp_path / "graph.yaml"))
        drawn = yaml.safe_load((tmp_path / "graph.yaml").read_text())["topics"]
        assert (drawn["/range"]["type"], drawn["/range"]["rate_hz"]) == (RANGE, 1)
        seen = called("view", str(target), "--to", str(tmp_path / "seen.rrd"))
        assert "2 displays, 6 updates shown" in seen.split("\n")


WRONG = {
    "a.mcap": (b"", "this is no log; give an MCAP file"),
    "b.mcap": (b"SQLite format 3\0" * 10, "this is no log; give an MCAP file"),
    "a.db3": (b"SQLite format 3\0" * 10, "damaged or not readable"),
    "a.bag": (b"#ROSBAG V2.0\n", "this is a bag of ROS 1; convert it with rosbags-convert"),
    "folder/note.txt": (b"", "the folder has no .mcap or .db3 file"),
    "damaged/a.mcap": (b"nothing", "this is no log; give an MCAP file"),
}


@pytest.mark.parametrize("name", WRONG)
def test_what_is_no_log_is_one_sentence(tmp_path, name, caplog):
    content, said = WRONG[name]
    file = tmp_path / name
    file.parent.mkdir(exist_ok=True)
    file.write_bytes(content)
    path = tmp_path / name.partition("/")[0]
    with pytest.raises(LogError, match=rf"log {path}\S*: {said}"):
        LogReader(path)
    assert caplog.text == ""


def test_a_file_that_is_missing_or_was_cut_off_is_one_sentence(tmp_path):
    path = tmp_path / "cut.db3"
    with pytest.raises(LogError, match=f"log {path}: no such file"):
        LogReader(path)
    write_db3(path, [("/a", second, bytes(99)) for second in range(2000)]).close()
    path.write_bytes(path.read_bytes()[:99_999])
    with pytest.raises(LogError, match=f"log {path}: damaged"), LogReader(path) as log:
        list(log.messages())
