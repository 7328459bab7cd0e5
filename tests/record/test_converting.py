"""Logs and bags written into each other, judged by rosbags and mcap; and what cannot be written."""

import json
import os
import shlex
import subprocess
import sys

import numpy as np
import pytest
from commands import called
from mcap.reader import make_reader
from rosbags.highlevel import AnyReader
from rosbags.interfaces import QosDurability, QosHistory, QosReliability

from sfglab.errors import SfglabError
from sfglab.record import LogReader, LogWriter

FOLDERS = [("mcap", mode) for mode in ("none", "file", "message", "storage")]
FOLDERS += [("sqlite3", mode) for mode in ("none", "file", "message")]


def entries(path):
    with LogReader(path) as log:
        return [(m.topic, m.type_name, m.log_time_ns, m.cdr) for m in log.messages()]


@pytest.mark.parametrize(("storage", "mode"), FOLDERS)
def test_a_log_becomes_a_bag_and_again_the_same_log(tmp_path, given, storage, mode):
    bag = tmp_path / "bag"
    called("log", "convert", str(given), "-o", str(bag), "-s", storage, "--compression-mode", mode)
    for path in (given, bag):
        with AnyReader([path]) as reader:
            theirs = [(c.topic, c.msgtype, time_ns, data) for c, time_ns, data in reader.messages()]
            (latched,) = (c for c in reader.connections if c.topic == "/tf_static")
            (qos,) = latched.ext.offered_qos_profiles
            row = next(c for c in reader.connections if c.topic == "/table/meter")
            read = reader.deserialize(next(reader.messages([row]))[2], row.msgtype)
        assert (qos.history, qos.depth, qos.reliability) == (
            QosHistory.KEEP_LAST,
            1,
            QosReliability.RELIABLE,
        )
        assert qos.durability is QosDurability.TRANSIENT_LOCAL
        assert (read.received, read.samples_s.tolist()) == (4, [0.25, 0.75])
        assert theirs == entries(path) == entries(given)
    back = tmp_path / "back.mcap"
    called("log", "convert", str(bag), "-o", str(back))
    assert entries(back) == entries(given)
    with LogReader(back) as log, LogReader(given) as before:
        assert all(
            log.offered_qos(topic) == before.offered_qos(topic)
            for topic in ("/image", "/tf_static")
        )
        assert log.table("meter").equals(before.table("meter"))
    said = json.loads(called("log", "info", str(bag), "--json"))
    assert (said["storage"], said["messages"], said["start_ns"], said["end_ns"]) == (
        storage,
        6,
        0,
        3 * 10**9,
    )


def test_several_logs_become_one_and_a_filter_takes_topics_and_times(tmp_path, given):
    bag, part = tmp_path / "bag", tmp_path / "part.mcap"
    wanted = ("--topics", "/image", "--start-offset", "1", "--duration", "1.5")
    called("log", "filter", str(given), "-o", str(bag), *wanted)
    taken = [(topic, time_ns) for topic, _, time_ns, _ in entries(bag)]
    assert taken == [("/image", 10**9), ("/image", 2 * 10**9)]
    assert "Duration:          1.000000000s\n" in called("log", "info", str(bag))
    called("log", "filter", str(given), "-o", str(part), "-x", "image|table")
    called("log", "convert", str(part), str(bag), "-o", str(tmp_path / "both.mcap"))
    assert [topic for topic, *_ in entries(tmp_path / "both.mcap")] == [
        "/tf_static",
        "/image",
        "/image",
    ]
    with (tmp_path / "both.mcap").open("rb") as stream:
        reader = make_reader(stream)
        assert [record.name for record in reader.iter_attachments()] == ["note"]
        assert [record.name for record in reader.iter_metadata()] == ["config"]
        assert len(reader.get_summary().chunk_indexes) == 1, "a second apart, and in one chunk"


def test_a_type_that_only_the_log_defines_goes_along(tmp_path):
    """As its recorder defined it, with what it depends on."""
    text = f"geometry_msgs/Point where\n{80 * '='}\nMSG: geometry_msgs/Point\nfloat64 x\nfloat64 y\nfloat64 z\n"
    with LogWriter(tmp_path / "a.mcap") as log:
        log.define("strange_msgs/msg/Thing", text)
        log.write_raw(
            "/thing",
            "strange_msgs/msg/Thing",
            b"\0\1\0\0" + np.arange(3.0).tobytes(),
            log_time_ns=1,
        )
    called("log", "convert", str(tmp_path / "a.mcap"), "-o", str(tmp_path / "bag"))
    with AnyReader([tmp_path / "bag"]) as reader:
        [(connection, _, data)] = reader.messages()
        assert reader.deserialize(data, connection.msgtype).where.z == 2.0
        assert connection.digest != "RIHS01_" + 64 * "0"


MISTAKES = {
    ("convert", "{given}", "-o", "{given}"): "nothing is yet",
    ("convert", "{given}", "-o", "{tmp}/no/bag"): "can be written",
    ("convert", "{given}", "-o", "/proc/bag"): "can be written",
    (
        "convert",
        "{given}",
        "-o",
        "{tmp}/bag",
        "-s",
        "sqlite3",
        "--compression-mode",
        "storage",
    ): "message",
    ("convert", "{given}", "-o", "{tmp}/bag", "-s", "db3"): "sqlite3",
    ("convert", "{given}", "-o", "{tmp}/b.mcap", "-s", "sqlite3"): "MCAP with zstd",
    ("convert", "{tmp}/typo", "-o", "{tmp}/bag"): "no such file",
    ("filter", "{given}", "-o", "{tmp}/bag", "--topics", "/imag"): "/image",
    ("filter", "{given}", "-o", "{tmp}/bag", "-e", "("): "regular expression",
    ("record", "-o", "{tmp}/bag"): "--all",
    ("{tmp}/typo",): "no such file",
}


@pytest.mark.parametrize("arguments", MISTAKES)
def test_a_mistake_is_one_sentence_and_leaves_nothing(tmp_path, given, arguments):
    before = sorted(tmp_path.rglob("*"))
    with pytest.raises(SfglabError, match=MISTAKES[arguments]):
        called("log", *(word.format(given=given, tmp=tmp_path) for word in arguments))
    assert sorted(tmp_path.rglob("*")) == before


@pytest.mark.parametrize("name", ["out.mcap", "out"])
def test_what_breaks_off_leaves_nothing(tmp_path, given, name):
    """A log that is damaged behind its beginning, and a disk that is full."""
    damaged = tmp_path / "damaged.mcap"
    data = bytearray(given.read_bytes())
    data[len(data) // 3] ^= 0xFF
    damaged.write_bytes(data)
    before = sorted(tmp_path.rglob("*"))
    with pytest.raises(SfglabError, match="damaged"):
        called("log", "convert", str(damaged), "-o", str(tmp_path / name))
    long = tmp_path / (os.pathconf(tmp_path, "PC_NAME_MAX") * "x" + name)
    with pytest.raises(SfglabError, match="can be written"):
        called("log", "convert", str(given), "-o", str(long))
    for more in ([], ["-s", "sqlite3"] if name == "out" else []):
        argv = [
            sys.executable,
            "-m",
            "sfglab",
            "log",
            "convert",
            str(given),
            "-o",
            str(tmp_path / name),
            *more,
        ]
        script = f"ulimit -f 1; exec {shlex.join(argv)}"
        full = subprocess.run(["bash", "-c", script], capture_output=True, check=False)
        assert full.returncode != 0
        assert full.stderr.decode().startswith("sfglab: --output: given ")
        assert full.stderr.count(b"\n") == 1
    assert sorted(tmp_path.rglob("*")) == before


def test_without_a_command_it_lists_what_a_log_holds_and_runs_without_a_log(given):
    assert "/table/meter" in called("log", str(given))
    assert json.loads(called("log", str(given), "--json"))["metadata"] == {"config": {"seed": 1}}
    assert "speaks for the claims" in called("log")
