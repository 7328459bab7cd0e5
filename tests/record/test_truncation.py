import signal
import subprocess
import sys

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.writer import IndexType, Writer

from sfglab.messages import definition, message_type, serialize
from sfglab.record import LogError, LogReader, LogWriter

TEXT = "std_msgs/msg/String"
COUNT = 12

VICTIM = """
import sys
from sfglab.messages import message_type
from sfglab.record import LogWriter

log = LogWriter(sys.argv[1])
log.write_metadata("config", {"seed": 1})
text = message_type("std_msgs/msg/String")
for i in range(1000):
    log.write("/text", text(data=str(i)), log_time_ns=i * 250_000_000)
    print(i, flush=True)
    if i == 10:
        sys.stdin.readline()
"""


def string(data):
    return message_type(TEXT)(data=data)


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """A complete log with a chunk for every second, as bytes."""
    path = tmp_path_factory.mktemp("whole") / "run.mcap"
    with LogWriter(path) as log:
        log.write_metadata("config", {"seed": 1})
        for i in range(COUNT):
            log.write("/text", string(str(i)), log_time_ns=i * 500_000_000)
        log.attach("note", b"end", "text/plain")
    return path.read_bytes()


def texts(path):
    with LogReader(path) as log:
        return log.truncated, [m.message.data for t in log.topics for m in log.decoded(t)]


@pytest.mark.live
def test_a_killed_writer_leaves_a_log_up_to_its_last_chunk(tmp_path):
    path = tmp_path / "run.mcap"
    with subprocess.Popen(
        [sys.executable, "-c", VICTIM, str(path)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as victim:
        try:
            assert all(int(victim.stdout.readline()) == i for i in range(11))
        finally:
            victim.send_signal(signal.SIGKILL)
    with LogReader(path) as log:
        assert log.truncated
        assert log.metadata("config") == {"seed": 1}
        assert log.topics["/text"].count == 10
        # Chunks end at 1 s and 2.25 s of log time; message 10 at 2.5 s was in the one that was lost.
        assert [m.message.data for m in log.decoded("/text")] == [str(i) for i in range(10)]


def test_a_log_that_is_being_written_is_read_up_to_its_last_chunk(tmp_path):
    path = tmp_path / "run.mcap"
    with LogWriter(path) as log:
        assert texts(path) == (True, [])
        log.write("/text", string("a"), log_time_ns=0)
        assert texts(path) == (True, [])
        log.flush()
        assert texts(path) == (True, ["a"])
        log.write("/text", string("b"), log_time_ns=0)
        log.write("/text", string("c"), log_time_ns=1_000_000_000)
        assert texts(path) == (True, ["a", "b", "c"])
    assert texts(path) == (False, ["a", "b", "c"])


def test_a_big_message_is_a_chunk_of_its_own(tmp_path):
    path = tmp_path / "run.mcap"
    with LogWriter(path) as log:
        log.write("/text", string("x" * 1_000_000), log_time_ns=0)
        assert texts(path) == (True, ["x" * 1_000_000])


@settings(max_examples=150, deadline=None)
@given(data=st.data())
def test_every_cut_leaves_the_first_messages(tmp_path_factory, whole, data):
    length = data.draw(st.integers(8, len(whole) - 1))
    path = tmp_path_factory.getbasetemp() / "cut.mcap"
    path.write_bytes(whole[:length])
    _, found = texts(path)
    assert found == [str(i) for i in range(len(found))]


def test_a_lost_index_loses_no_message_and_damage_below_an_index_is_said_when_it_is_read(tmp_path, whole):
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
        assert set(found) <= {serialize(string(str(i))) for i in range(COUNT)}


@pytest.mark.parametrize("chunked", [True, False])
def test_a_file_without_any_index_is_scanned_if_it_has_chunks(tmp_path, chunked):
    path = tmp_path / "plain.mcap"
    with path.open("wb") as stream:
        unused = ("repeat_channels", "repeat_schemas", "use_statistics", "use_summary_offsets")
        bare = dict.fromkeys(unused, False)
        writer = Writer(stream, index_types=IndexType.NONE, use_chunking=chunked, **bare)
        writer.start("ros2")
        schema = writer.register_schema(TEXT, "ros2msg", definition(TEXT).encode())
        channel = writer.register_channel("/text", "cdr", schema)
        for i in (2, 1):
            writer.add_message(channel, log_time=i, publish_time=i, data=serialize(string(str(i))))
        writer.finish()
    if chunked:
        assert texts(path) == (False, ["1", "2"])
    else:
        with pytest.raises(LogError, match="mcap recover"):
            LogReader(path)
