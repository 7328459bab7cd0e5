"""Commands on logs and bags, the reading of bags judged by rosbags; and what cannot be read or written."""

import itertools
import re

import pytest
from bags import write_bag
from commands import called
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import CompressionMode, StoragePlugin

from sfglab.errors import SfglabError
from sfglab.record import LogReader

FOLDERS = [
    (storage, mode)
    for storage, mode in itertools.product(StoragePlugin, CompressionMode)
    if mode is not CompressionMode.STORAGE or storage is StoragePlugin.MCAP
]
SUFFIXES = {StoragePlugin.MCAP: ".mcap", StoragePlugin.SQLITE3: ".db3"}


def entries(path):
    with LogReader(path) as log:
        return [(m.topic, m.type_name, m.log_time_ns, m.cdr) for m in log.messages()]


@pytest.mark.parametrize(("storage", "mode"), FOLDERS)
def test_a_bag_of_each_storage_and_compression_holds_what_the_log_holds(
    tmp_path, given, storage, mode, caplog
):
    bag = write_bag(given, tmp_path / "bag", storage, mode)
    with AnyReader([bag]) as reader:
        theirs = [(c.topic, c.msgtype, time_ns, data) for c, time_ns, data in reader.messages()]
    assert entries(bag) == theirs == entries(given)
    with LogReader(bag) as log, LogReader(given) as before:
        for topic in ("/image", "/tf_static"):
            assert log.offered_qos(topic) == before.offered_qos(topic)
        assert log.table("meter").equals(before.table("meter"))
    said = called("log", "info", str(bag))
    assert caplog.text == ""
    assert re.search(rf"^files +\S+{SUFFIXES[storage]}", said)
    assert "\nduration  3.000 s\nmessages  6\n" in said


MISTAKES = {
    ("record", "-o", "{tmp}/bag.mcap"): "--all",
    ("record", "-a", "-o", "{tmp}/bag"): "ends in .mcap",
    ("record", "-a", "-o", "{given}"): "a new file",
    ("record", "-a", "-o", "/proc/bag.mcap"): "needed: a writable file",
    ("record", "-e", "(", "-o", "{tmp}/bag.mcap"): "regular expression",
    ("play", "{tmp}/typo"): "no such file",
}


@pytest.mark.parametrize("arguments", MISTAKES)
def test_a_mistake_is_one_sentence_and_leaves_nothing(tmp_path, given, arguments):
    before = sorted(tmp_path.rglob("*"))
    with pytest.raises(SfglabError, match=MISTAKES[arguments]):
        called("log", *(word.format(given=given, tmp=tmp_path) for word in arguments))
    assert sorted(tmp_path.rglob("*")) == before


def test_info_prints_what_a_log_holds_and_the_group_alone_lists_runs(given):
    said = called("log", "info", str(given))
    assert re.search(r"^ +/image +sensor_msgs/msg/Image +4 +1 +\d+ +cdr$", said, re.MULTILINE)
    assert '\nmetadata  config: {"seed": 1}\n' in said
    assert "counts for the claims" in called("log")
