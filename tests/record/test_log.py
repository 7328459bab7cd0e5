import math
import threading
import tracemalloc
from dataclasses import dataclass

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.writer import CompressionType
from meter_rows import MeterRow
from reported import STRING as TEXT
from reported import string, write_mcap
from zstandard import ZstdError

from sfglab.messages import (
    CdrError,
    MessageError,
    UnknownTypeError,
    default_message,
    message_type,
    serialize,
)
from sfglab.qos import DEFAULT, LATCHED
from sfglab.record import LogError, LogReader, LogWriter
from sfglab.record.parts import decompress

SECOND = 10**9
WRITER_INTERNALS_FAIL = OSError(28, "No space left on device")


def text(data):
    return message_type(TEXT)(data=data)


@pytest.fixture
def path(tmp_path):
    return tmp_path / "runs" / "run.mcap"


def test_messages_come_back_byte_by_byte_in_the_order_of_log_times(path, image):
    first, second = serialize(image(1)), b"\0\1\0\0 not a string, but kept as it is"
    with LogWriter(path) as log:
        log.write_raw(
            "/camera",
            "sensor_msgs/msg/Image",
            memoryview(first),
            log_time_ns=30,
            publish_time_ns=20,
        )
        log.write_raw("/text", TEXT, second, log_time_ns=10, qos=DEFAULT)
        log.write_raw("/text", TEXT, bytearray(second), log_time_ns=40, qos=LATCHED)
    with LogReader(path) as log:
        assert {topic: (info.type_name, info.count) for topic, info in log.topics.items()} == {
            "/camera": ("sensor_msgs/msg/Image", 1),
            "/text": (TEXT, 2),
        }
        found = [(m.topic, m.type_name, *m[1:]) for m in log.messages()]
        assert found == [
            ("/text", TEXT, 10, 10, second),
            ("/camera", "sensor_msgs/msg/Image", 30, 20, first),
            ("/text", TEXT, 40, 40, second),
        ]
        assert [m.log_time_ns for m in log.messages("/text")] == [10, 40]
        assert [m.log_time_ns for m in log.messages(start_ns=30, end_ns=40)] == [30]


@dataclass(frozen=True)
class AnyRow:
    count: int
    value: float
    label: str
    flag: bool


any_rows = st.builds(AnyRow, count=st.integers(-(2**63), 2**63 - 1))


@settings(max_examples=40, deadline=None)
@given(rows=st.lists(any_rows, min_size=1, max_size=5))
def test_arbitrary_rows_come_back_as_a_dataframe(tmp_path_factory, rows):
    path = tmp_path_factory.mktemp("rows") / "run.mcap"
    with LogWriter(path) as log:
        for i, row in enumerate(rows):
            log.write_row("any", row, log_time_ns=i)
    with LogReader(path) as log:
        assert log.tables == ("any",)
        table = log.table("any")
    assert list(table.columns) == ["log_time_ns", "count", "value", "label", "flag"]
    assert table["log_time_ns"].tolist() == list(range(len(rows)))
    assert [str(table[c].dtype) for c in ("count", "value", "flag")] == ["int64", "float64", "bool"]
    for row, read in zip(rows, table.itertuples(), strict=True):
        assert (row.count, row.label, row.flag) == (read.count, read.label, read.flag)
        assert row.value == read.value or (math.isnan(row.value) and math.isnan(read.value))


def test_metadata_and_attachments_come_back(path):
    with LogWriter(path) as log:
        log.write_metadata("config", {"seed": 3, "name": "smoke", "sizes": [1, 2]})
        log.write_metadata("empty", {})
        log.attach("figure.png", b"\x89PNG", "image/png")
    with LogReader(path) as log:
        assert log.metadata_names == ("config", "empty")
        assert log.metadata("config") == {"seed": 3, "name": "smoke", "sizes": [1, 2]}
        assert log.metadata("empty") == {}
        assert log.attachment("figure.png") == b"\x89PNG"
        assert list(log.messages()) == []


def test_what_is_not_there_is_named_with_what_is(path):
    with LogWriter(path) as log:
        log.write_metadata("config", {})
        log.write("/text", text("x"), log_time_ns=1)
    with LogReader(path) as log:
        for read, name, complaint in (
            (log.metadata, "run", "there is no metadata 'run'; the nearest are config"),
            (log.attachment, "a", "there is no attachment 'a'; it has none"),
            (log.messages, "/txt", "there is no topic '/txt'; the nearest are /text"),
            (log.table, "meter", "no table 'meter'"),
        ):
            with pytest.raises(LogError, match=complaint):
                read(name)


def test_a_file_is_replaced_only_on_demand(path):
    with LogWriter(path) as log:
        log.write("/text", text("old"), log_time_ns=1)
    with pytest.raises(LogError, match=rf"log {path}: .*overwrite=True"):
        LogWriter(path)
    with LogWriter(path, overwrite=True):
        pass
    with LogReader(path) as log:
        assert log.topics == {}


def test_closing_twice_is_closing_once_and_nothing_follows(path):
    log = LogWriter(path)
    log.write("/text", text("x"), log_time_ns=1)
    log.close()
    log.close()
    with pytest.raises(LogError, match="it is closed"):
        log.write_metadata("late", {})
    reader = LogReader(path)
    reader.close()
    reader.close()
    with pytest.raises(LogError, match="closed"):
        list(reader.messages())


def test_a_topic_keeps_its_type(path):
    with LogWriter(path) as log:
        log.write("/text", text("x"), log_time_ns=1)
        with pytest.raises(
            LogError, match="given std_msgs/msg/Empty, allowed: std_msgs/msg/String"
        ):
            log.write("/text", default_message("std_msgs/msg/Empty"), log_time_ns=1)
        with pytest.raises(UnknownTypeError):
            log.write_raw("/other", "std_msgs/msg/Strin", b"", log_time_ns=1)
        log.write_raw("/other", TEXT, serialize(text("y")), log_time_ns=2)
    with LogReader(path) as log:
        messages = [m.message for t in log.topics for m in log.decoded(t)]
    assert messages == [text("y"), text("x")], "of our own types"


def test_input_that_a_log_cannot_hold_is_refused_before_it_spoils_the_file(path):
    @dataclass
    class ClashRow:
        log_time_ns: int

    with LogWriter(path) as log:
        with pytest.raises(LogError, match="given the time -1 ns"):
            log.write("/text", text("x"), log_time_ns=-1)
        for error, complaint, row in (
            (LogError, "ClashRow has a field log_time_ns; rename it", ClashRow(1)),
            (MessageError, "allowed: dataclasses", {"a": 1}),
        ):
            with pytest.raises(error, match=complaint):
                log.write_row("meter", row, log_time_ns=1)
        log.write("/text", text("good"), log_time_ns=1)
    assert texts(path) == (False, ["good"])


def test_an_exception_in_the_run_still_leaves_a_whole_log(path):
    with pytest.raises(LogError, match=f"given the time {2**64} ns"), LogWriter(path) as log:  # noqa: PT012
        log.write("/text", text("before"), log_time_ns=1)
        log.write("/text", text("x"), log_time_ns=2**64)
    assert texts(path) == (False, ["before"])


def test_bytes_of_another_type_are_an_error_of_that_message_only(path):
    with LogWriter(path) as log:
        log.write_raw("/text", TEXT, b"\0\1\0\0\xff\xff\xff\xff", log_time_ns=1)
    with LogReader(path) as log, pytest.raises(CdrError, match=TEXT):
        list(log.decoded("/text"))


def test_after_a_failed_write_nothing_follows_and_what_was_whole_is_read(path, monkeypatch):
    def fail():
        raise WRITER_INTERNALS_FAIL

    log = LogWriter(path)
    log.write("/text", text("kept"), log_time_ns=1)
    log.write("/text", text("kept"), log_time_ns=SECOND + 1)
    monkeypatch.setattr(log._mcap, "flush", fail)
    log.write("/text", text("lost"), log_time_ns=SECOND + 2)
    with pytest.raises(OSError, match="No space left"):
        log.write("/text", text("lost"), log_time_ns=2 * SECOND + 2)
    with pytest.raises(LogError, match="an earlier write failed"):
        log.write("/text", text("late"), log_time_ns=3)
    log.close()
    with LogReader(path) as read:
        assert read.truncated
        assert [m.message.data for m in read.decoded("/text")] == ["kept", "kept"]


def test_a_full_disk_is_said_at_once_and_leaks_no_file():
    with pytest.raises(OSError, match="No space left"):
        LogWriter("/dev/full", overwrite=True)


def test_threads_may_share_a_writer(path):
    def write(log, agent):
        for i in range(200):
            row = MeterRow(agent=agent, received=i, mean_s=0.0, lossless=True)
            log.write_row("meter", row, log_time_ns=i * 20_000_000)

    with LogWriter(path) as log:
        threads = [threading.Thread(target=write, args=(log, f"r{i}")) for i in range(3)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
    with LogReader(path) as log:
        table = log.table("meter")
    received = table.groupby("agent")["received"].apply(list).to_dict()
    assert received == {f"r{i}": list(range(200)) for i in range(3)}


# --- Logs that were cut off, are damaged, or are still written.

COUNT = 12


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """A complete log with a chunk for every second, as bytes."""
    path = tmp_path_factory.mktemp("whole") / "run.mcap"
    with LogWriter(path) as log:
        log.write_metadata("config", {"seed": 1})
        for i in range(COUNT):
            log.write("/text", text(str(i)), log_time_ns=i * 500_000_000)
        log.attach("note", b"end", "text/plain")
    return path.read_bytes()


def texts(path):
    with LogReader(path) as log:
        return log.truncated, [m.message.data for t in log.topics for m in log.decoded(t)]


def test_a_log_that_is_being_written_is_read_up_to_its_last_chunk(path):
    """And so is that of a writer that was killed: the kernel keeps what it was handed with each chunk."""
    with LogWriter(path) as log:
        log.write_metadata("config", {"seed": 1})
        assert texts(path) == (True, [])
        log.write("/text", text("a"), log_time_ns=0)
        assert texts(path) == (True, [])
        log.write("/text", text("b"), log_time_ns=SECOND)
        log.write("/text", text("c"), log_time_ns=SECOND + 1)
        assert texts(path) == (True, ["a", "b"])
        with LogReader(path) as read:
            assert (read.metadata("config"), read.topics["/text"].count) == ({"seed": 1}, 2)
        log.write("/text", text("x" * 1_000_000), log_time_ns=SECOND + 2)
        assert texts(path) == (True, ["a", "b", "c", "x" * 1_000_000]), "it fills a chunk"
    assert texts(path) == (False, ["a", "b", "c", "x" * 1_000_000])


@settings(max_examples=150, deadline=None)
@given(data=st.data())
def test_every_cut_leaves_the_first_messages(tmp_path_factory, whole, data):
    length = data.draw(st.integers(8, len(whole) - 1))
    path = tmp_path_factory.getbasetemp() / "cut.mcap"
    path.write_bytes(whole[:length])
    _, found = texts(path)
    assert found == [str(i) for i in range(len(found))]


def test_a_lost_index_loses_no_message_and_damage_below_an_index_is_said_when_it_is_read(
    tmp_path, whole
):
    path = tmp_path / "cut.mcap"
    path.write_bytes(whole[:-30])
    assert texts(path) == (False, [str(i) for i in range(COUNT)])
    with LogReader(path) as log:
        assert log.attachment("note") == b"end"
        assert log.metadata("config") == {"seed": 1}
    start = whole.index(b"zstd") + 30
    path = tmp_path / "spoiled.mcap"
    path.write_bytes(whole[:start] + b"\xff\xff" + whole[start + 2 :])
    with LogReader(path) as log, pytest.raises(LogError, match="damaged"):
        list(log.messages())


def test_a_size_in_the_header_of_an_lz4_frame_is_not_believed(tmp_path):
    messages = [("/text", 0, string(b"a"))]
    path = write_mcap(tmp_path / "large.mcap", messages, compression=CompressionType.LZ4)
    content = bytearray(path.read_bytes())
    start = content.index(b"\x04\x22\x4d\x18") + 6
    content[start : start + 8] = (2**30).to_bytes(8, "little")
    tracemalloc.start()
    for checksum in range(256):  # one of them is right
        content[start + 8] = checksum
        path.write_bytes(content)
        with LogReader(path) as log, pytest.raises(LogError, match="damaged"):
            list(log.messages())
    _, most_bytes = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert most_bytes < 2**25


def test_a_size_in_the_header_of_a_zstandard_frame_is_not_believed():
    frame = b"\x28\xb5\x2f\xfd\xe0" + (2**40).to_bytes(8, "little")
    with pytest.raises(ZstdError, match="13 compressed bytes hold more than 1000"):
        decompress(frame, 1000)


@settings(max_examples=150, deadline=None)
@given(data=st.data())
def test_a_damaged_byte_never_shows_as_a_message(tmp_path_factory, whole, data):
    spoiled = bytearray(whole)
    position = data.draw(st.integers(8, len(whole) - 1))
    spoiled[position] ^= data.draw(st.integers(1, 255))
    path = tmp_path_factory.getbasetemp() / "spoiled.mcap"
    path.write_bytes(spoiled)
    try:
        with LogReader(path) as log:
            found = [m.cdr for m in log.messages()]
    except LogError as error:
        assert str(error).startswith(f"log {path}: ")  # noqa: PT017  # either outcome is right
    else:
        assert set(found) <= {serialize(text(str(i))) for i in range(COUNT)}
