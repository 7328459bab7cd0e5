"""Logs and bags of public bug reports, with what rclpy, sqlite3 or the format's specification say of them."""

import re
import shutil
import struct
import time

import numpy as np
import pytest
import zstandard
from commands import called
from mcap.data_stream import RecordBuilder
from mcap.reader import make_reader
from mcap.records import Channel, Chunk, Message, Schema
from mcap.writer import IndexType
from reported import STRING, string, write_db3, write_mcap, write_metadata

from sfglab.qos import QoSProfile
from sfglab.record import LogError, LogReader
from sfglab.record.metadata import offered_qos_profiles

THREE = [("/a", 1, string(b"1")), ("/a", 2, string(b"2")), ("/a", 3, string(b"3"))]
MIXED = [*THREE, ("/b", 2, string(b"b"))]
QOS = "- history: 3\\n  depth: 0\\n"


def texts(path, topic="/a"):
    with LogReader(path) as log:
        return [entry.message.data for entry in log.decoded(topic)]


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "bag").mkdir()
    return tmp_path / "bag"


# --- A command reports what it delivers.


@pytest.mark.parametrize("place", ["bag", "bag/killed.db3", "link ü?.db3"])
def test_messages_in_the_write_ahead_log_of_a_killed_recorder_are_read(tmp_path, folder, place):
    recorder = write_db3(folder / "live.db3", THREE, journal="WAL")
    for name in ("live.db3", "live.db3-wal"):
        shutil.copy(folder / name, folder / name.replace("live", "killed"))
    recorder.close()
    (folder / "live.db3").unlink()
    (tmp_path / "link ü?.db3").symlink_to(folder / "killed.db3")
    write_metadata(folder, ["killed.db3"], [], storage="sqlite3")
    before = {path: path.read_bytes() for path in folder.iterdir()}
    assert texts(tmp_path / place) == ["1", "2", "3"]
    assert {path: path.read_bytes() for path in folder.iterdir()} == before


NO_REPETITION = {"repeat_channels": False, "repeat_schemas": False}
NO_SUMMARY = {"use_statistics": False, "use_summary_offsets": False, "index_types": IndexType.NONE}


@pytest.mark.parametrize("options", [{}, NO_SUMMARY, NO_SUMMARY | {"use_chunking": False}])
def test_a_file_with_a_part_of_an_index_or_without_one_loses_no_message(tmp_path, options):
    messages = [THREE[1], THREE[0], THREE[2]]
    path = write_mcap(tmp_path / "a.mcap", messages, **NO_REPETITION, **options)
    assert re.search(rf"\n +/a +{STRING} +3 .* cdr\n", called("log", "info", str(path)))
    assert texts(path) == ["1", "2", "3"]


def test_a_count_that_differs_from_the_index_is_a_warning(tmp_path, caplog):
    path = write_mcap(tmp_path / "a.mcap", THREE)
    data = path.read_bytes()
    head, tail = data.rsplit(struct.pack("<HQ", 1, 3), 1)  # the count of channel 1 in Statistics
    path.write_bytes(head + struct.pack("<HQ", 1, 6) + tail)
    with LogReader(path) as log:
        assert log.topics["/a"].count == 3, "its checksum says that the summary is damaged"
    checked = tail[:-12] + bytes(4) + tail[-8:]  # without the checksum of the summary
    path.write_bytes(head + struct.pack("<HQ", 1, 6) + checked)
    with LogReader(path) as log:
        assert log.topics["/a"].count == 6
        assert len(list(log.messages())) == 3
    assert "the index names 6 messages, 3 were read" in caplog.text


# --- One part that cannot be read leaves the rest.


FILES = "rosbag2_bagfile_information: {relative_file_paths: [rec_0.db3], message_count: "
WRONG = ["", "rosbag2_bagfile_information: {version: 9}", "{", FILES + "[1]}"]


@pytest.mark.parametrize("metadata", [None, *WRONG, FILES + "3, compression_mode: [message]}"])
def test_a_folder_without_metadata_is_all_its_files(folder, metadata, caplog):
    write_db3(folder / "rec_0.db3", THREE[:1]).close()
    write_mcap(folder / "rec_1.mcap", THREE[1:])
    if metadata is not None:
        (folder / "metadata.yaml").write_text(metadata)
    assert texts(folder) == ["1", "2", "3"]
    assert len(caplog.records) == (metadata is not None)


DAMAGED = [
    "UPDATE topics SET name = CAST(name AS BLOB), offered_qos_profiles = x'ff'",
    "UPDATE messages SET timestamp = 'soon' WHERE id = 1",
    "UPDATE messages SET data = 'text' WHERE id = 2",
]
BEFORE_FOXY = ["ALTER TABLE topics DROP COLUMN offered_qos_profiles"]


@pytest.mark.parametrize(("changes", "first"), [(DAMAGED, 3), (BEFORE_FOXY, 1)])
def test_values_of_a_wrong_kind_and_missing_columns_leave_the_other_messages(
    tmp_path, changes, first, caplog
):
    database = write_db3(tmp_path / "a.db3", THREE, qos=QOS)
    for change in changes:
        database.execute(change)
    database.commit()
    database.close()
    found = texts(tmp_path / "a.db3")
    assert found == ["1", "2", "3"][first - 1 :]
    with LogReader(tmp_path / "a.db3") as log:
        assert log.topics["/a"].count == len(found)
        assert log.offered_qos("/a") == QoSProfile()
        assert log.span_ns == (first * 10**9, 3 * 10**9)
    assert caplog.text == ""


def test_a_file_that_the_metadata_names_twice_is_read_once(folder, caplog):
    write_mcap(folder / "bag_0.mcap", MIXED)
    # Its profiles are others than those of the file.
    write_metadata(folder, ["bag_0.mcap", "bag/bag_0.mcap"], MIXED, qos=f'"{QOS}"')
    assert texts(folder) == ["1", "2", "3"]
    assert texts(folder, "/b") == ["b"]
    assert caplog.text == ""


def test_profile_and_definition_of_a_topic_are_the_first_that_a_file_has(folder):
    profile = offered_qos_profiles(QoSProfile(depth=7))
    write_db3(folder / "a_0.db3", THREE).close()
    definition = ("ros2msg", "string data")
    write_db3(folder / "a_1.db3", THREE, qos=profile, definition=definition).close()
    write_db3(folder / "a_2.db3", THREE).close()
    with LogReader(folder) as log:
        assert log.offered_qos("/a").depth == 7
        assert log.topics["/a"].definition == "string data"


def test_a_file_that_was_cut_off_is_damaged_or_missing_leaves_the_others(folder, caplog):
    path = write_mcap(folder / "rec_0.mcap", THREE, chunk_size=1)
    with path.open("rb") as stream:
        *_, last = make_reader(stream).get_summary().chunk_indexes
    path.write_bytes(path.read_bytes()[: last.chunk_start_offset + 20])
    (folder / "rec_1.mcap").write_bytes(b"nothing")
    write_metadata(folder, ["rec_0.mcap", "rec_1.mcap", "rec_2.mcap"], THREE)
    assert texts(folder) == ["1", "2"]
    assert "rec_1.mcap: this is no log" in caplog.text
    assert "rec_2.mcap: no such file" in caplog.text
    assert "metadata.yaml names 3 messages, the files hold 2" in caplog.text
    with LogReader(folder) as log:
        assert log.truncated


def test_a_topic_without_a_known_definition_leaves_the_others(folder):
    schemas = {"/b": ("own_msgs/msg/Own", "unknown", b"")}
    write_mcap(folder / "rec_0.mcap", MIXED, schemas=schemas)
    assert texts(folder) == ["1", "2", "3"]
    with LogReader(folder) as log:
        assert [message.cdr for message in log.messages("/b")] == [string(b"b")]
        with pytest.raises(LogError, match="topic /b: given messages 'cdr', definition 'unknow"):
            next(log.decoded("/b"))


def test_a_definition_with_lines_and_characters_as_on_windows_is_read(tmp_path):
    rule = b"=" * 80
    text = (
        b"std_msgs/Header header\r\nfloat64 value  # \xb0\r\n"
        + rule
        + b"\r\nMSG: std_msgs/Header\r\n"
    )
    text += b"builtin_interfaces/Time stamp\r\nstring frame_id\r\n" + rule
    text += b"\r\nMSG: builtin_interfaces/Time\r\nint32 sec\r\nuint32 nanosec\r\n"
    cdr = b"\0\1\0\0" + bytes(8) + b"\5\0\0\0base\0" + bytes(7) + b"\0\0\0\0\0\0\4\x40"
    schemas = {"/a": ("own_msgs/msg/Reading", "ros2msg", text)}
    path = write_mcap(tmp_path / "a.mcap", [("/a", 1, cdr)], schemas=schemas)
    with LogReader(path) as log:
        [entry] = log.decoded("/a")
    assert (entry.message.header.frame_id, entry.message.value) == ("base", 2.5)


# --- What was named or defined is what is used.


def test_one_file_of_a_bag_is_that_file_and_no_other(folder):
    for number, message in enumerate(THREE):
        write_db3(folder / f"run_{number}.db3", [message]).close()
    write_metadata(folder, [f"run_{n}.db3" for n in range(3)], THREE, storage="sqlite3")
    assert texts(folder) == ["1", "2", "3"]
    assert texts(folder / "run_1.db3") == ["2"]


@pytest.mark.parametrize("in_one_file", [True, False])
def test_two_definitions_of_one_type_are_kept_apart(folder, in_one_file):
    # Both have other fields than the type of this name here.
    old = STRING, "ros2msg", b"float64 x\n"
    new = STRING, "ros2msg", b"string mode\nfloat64 x\n"
    x = b"\0\0\0\0\0\0\xf0\x3f"
    messages = [
        ("/a|old", 1, b"\0\1\0\0" + x),
        ("/a|new", 2, b"\0\1\0\0\5\0\0\0auto\0" + bytes(7) + x),
    ]
    schemas = {"/a|old": old, "/a|new": new}
    if in_one_file:
        write_mcap(folder / "rec_0.mcap", messages, schemas=schemas)
    else:
        for number, message in enumerate(messages):
            write_mcap(folder / f"rec_{number}.mcap", [message], schemas=schemas)
    with LogReader(folder) as log:
        first, second = (entry.message for entry in log.decoded("/a"))
    assert (first.x, second.mode, second.x) == (1.0, "auto", 1.0)


@pytest.mark.parametrize("encoding", ["", "unknown", "ros2idl", "ros2msg"])
def test_a_known_type_without_a_definition_is_read(folder, encoding):
    write_mcap(folder / "a.mcap", THREE[:1], schemas={"/a": (STRING, encoding, b"")})
    write_db3(folder / "b.db3", THREE[1:], definition=(encoding, "")).close()
    assert texts(folder) == ["1", "2", "3"]


# --- Order, and encodings.


def test_files_that_overlap_in_time_are_read_in_the_order_of_time(folder):
    write_mcap(folder / "bag_0.mcap", [THREE[0], ("/a", 5, string(b"5")), THREE[1]])
    write_mcap(folder / "bag_1.mcap", [THREE[2], ("/a", 4, string(b"4"))])
    assert texts(folder) == ["1", "2", "3", "4", "5"]


def test_messages_of_one_time_come_in_the_order_of_the_file(tmp_path):
    messages = [("/a", 5, string(b"1")), ("/a", 9, string(b"2")), ("/a", 9, string(b"3"))]
    early = [("/a", 1, string(b"0"))]
    # The first chunk begins later than the second one, which holds the early message.
    path = write_mcap(tmp_path / "a.mcap", [*messages[:2], *early, messages[2]], chunk_size=100)
    with path.open("rb") as stream:
        chunks = make_reader(stream).get_summary().chunk_indexes
    assert [chunk.message_start_time // 10**9 for chunk in chunks] == [5, 1]
    assert texts(path) == ["0", "1", "2", "3"]


def test_the_encoding_of_messages_is_named(tmp_path):
    schemas = {"/json": ("demo.Pose", "jsonschema", b"{}")}
    path = write_mcap(tmp_path / "a.mcap", [*THREE, ("/json", 1, b"{}")], schemas=schemas)
    said = called("log", "info", str(path))
    assert re.search(r"^ +/json +demo\.Pose +1 .* json$", said, re.MULTILINE)
    with LogReader(path) as log, pytest.raises(LogError, match="given messages 'json'"):
        next(log.decoded("/json"))


# --- Found by trying to break the reader.


def test_bounds_may_be_numpys_and_beyond_what_sqlite_holds(tmp_path):
    write_db3(tmp_path / "a.db3", THREE).close()
    with LogReader(tmp_path / "a.db3") as log:
        for bounds, found in (
            ({"start_ns": np.int64(2 * 10**9)}, 2),
            ({"end_ns": np.int64(2 * 10**9)}, 1),
            ({"start_ns": 2**63}, 0),
            ({"end_ns": 2**64}, 3),
        ):
            assert len(list(log.messages(**bounds))) == found


def test_what_was_not_committed_is_not_read(tmp_path):
    recorder = write_db3(tmp_path / "a.db3", THREE)
    recorder.execute("PRAGMA cache_size=1")
    recorder.execute("BEGIN")
    row = "INSERT INTO messages(topic_id, timestamp, data) VALUES(1, ?, ?)"
    recorder.executemany(row, ((number, bytes(900)) for number in range(100)))
    for name in ("a.db3", "a.db3-journal"):
        shutil.copy(tmp_path / name, tmp_path / name.replace("a.", "killed."))
    recorder.close()
    assert texts(tmp_path / "killed.db3") == ["1", "2", "3"]


def test_a_compressed_file_of_several_frames_is_read_whole_and_once(folder):
    data = write_mcap(folder / "a.mcap", THREE).read_bytes()
    (folder / "a.mcap.zstd").write_bytes(
        zstandard.compress(data[:40]) + zstandard.compress(data[40:])
    )
    assert texts(folder) == ["1", "2", "3"], "the recorder was killed while it compressed"
    (folder / "a.mcap").unlink()
    assert texts(folder) == ["1", "2", "3"]


def test_messages_outside_chunks_take_time_in_proportion_to_their_number(tmp_path):
    messages = [("/a", 0, string(b"0"))] * 20_000
    path = write_mcap(tmp_path / "a.mcap", messages, use_chunking=False)
    begun_s = time.process_time()
    assert len(texts(path)) == len(messages)
    assert time.process_time() - begun_s < 5


@pytest.mark.parametrize("cut", [True, False])
def test_records_of_unknown_kinds_are_passed_over_and_a_chunk_is_read_once(tmp_path, cut):
    unknown = struct.pack("<BQ", 0x90, 3) + b"???"
    builder = RecordBuilder()
    Schema(1, b"string data\n", "ros2msg", STRING).write(builder)
    Channel(1, "/a", "cdr", {}, 1).write(builder)
    Message(1, 5, string(b"1"), 5, 0).write(builder)
    content = builder.end() + unknown
    chunk = RecordBuilder()
    Chunk("", content, 5, 5, 0, len(content)).write(chunk)
    data = b"\x89MCAP0\r\n" + chunk.end()
    (tmp_path / "a.mcap").write_bytes(data + (b"" if cut else unknown))
    assert texts(tmp_path / "a.mcap") == ["1"]


@pytest.mark.parametrize("qos", ["- depth: many", "- 2026-01-01", "[" * 3000, "- history: 1"])
def test_an_offered_profile_that_cannot_be_read_is_the_usual_one(tmp_path, qos):
    write_db3(tmp_path / "a.db3", THREE, qos=qos).close()
    with LogReader(tmp_path / "a.db3") as log:
        assert log.offered_qos("/a") == QoSProfile()
