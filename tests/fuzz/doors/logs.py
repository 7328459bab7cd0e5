"""Logs, and the journals of sweeps."""

import sqlite3
import struct
from functools import partial

import lz4.frame
import zstandard
from mcap.data_stream import RecordBuilder
from mcap.records import Channel, Chunk, Schema

from doors import FOLDER, Door
from sfglab.lab.sweep.journal import SweepError, open_journal
from sfglab.messages import MessageError, message_type
from sfglab.record import LogError, LogReader, LogWriter

JOURNAL = b'{"sfglab_sweep": 1, "task": "t"}\n'
POINT = b'{"point": 0, "seed": 0, "result": {"columns": {"a": 1.5}}}\n'


def log(data, name="a.mcap"):
    (FOLDER / name).write_bytes(data)
    with LogReader(FOLDER / name) as found:
        for topic in found.topics:
            found.first(topic)
            found.knows(topic)
            list(found.decoded(topic))
        for record_name in found.metadata_names:
            found.metadata(record_name)


def journal(data):
    path = FOLDER / "a.journal"
    path.write_bytes(data)
    for aside in FOLDER.glob("a.journal.*"):
        aside.unlink()
    with open_journal(path, {"task": "t"}):
        pass


def written_log():
    with LogWriter(FOLDER / "b.mcap") as made:
        made.write_metadata("config", {"a": [1, {"b": None}]})
        made.attach("a.txt", b"text", "text/plain")
        for number in range(5):
            made.write("/s", message_type("std_msgs/msg/String")(f"{number}"), log_time_ns=number)
    return (FOLDER / "b.mcap").read_bytes()


def log_of(content, kind="", data=None, *, name="std_msgs/msg/String", schema=b"string data\n"):
    """A log without index of one chunk, which claims its content's size."""
    builder = RecordBuilder()
    Schema(1, schema, "ros2msg", name).write(builder)
    Channel(1, "/s", "cdr", {}, 1).write(builder)
    Chunk(kind, content if data is None else data, 1, 1, 0, len(content)).write(builder)
    return b"\x89MCAP0\r\n" + builder.end() + struct.pack("<BQI", 15, 4, 0)


def record(cdr):
    return struct.pack("<BQHIQQ", 5, 22 + len(cdr), 1, 0, 1, 1) + cdr


def bag():
    """A small SQLite file of a rosbag2, in pages of 512 bytes so that changes meet its rows."""
    path = FOLDER / "b.db3"
    database = sqlite3.connect(path)
    database.executescript(
        "PRAGMA page_size=512;"
        "CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT, type TEXT,"
        " serialization_format TEXT, offered_qos_profiles TEXT);"
        "CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER, timestamp INTEGER,"
        " data BLOB);"
        "INSERT INTO topics VALUES(1, '/s', 'std_msgs/msg/String', 'cdr', '');"
        "INSERT INTO messages VALUES(1, 1, 1, x'0001000002000000610000');"
        "INSERT INTO messages VALUES(2, 1, 2, x'0001000002000000620000');"
    )
    database.close()
    return path.read_bytes()


BAG = bag()
DOORS = {
    "log": Door(log, (LogError, MessageError), (written_log(), log_of(record(bytes(8))))),
    "bag": Door(partial(log, name="a.db3"), (LogError, MessageError), (BAG,)),
    "journal": Door(journal, SweepError, (JOURNAL + POINT,)),
}
ZEROS, EMPTY, ONE = bytes(2**26), record(b"") * 10**6, record(bytes(8))
FRAMED = lz4.frame.compress(ONE)
ATTACKS = [
    *(("log", log_of(data, "zstd", zstandard.compress(data))) for data in (ZEROS, EMPTY)),
    *(("log", log_of(data, "lz4", lz4.frame.compress(ZEROS))) for data in (ZEROS, ONE)),
    ("log", log_of(ONE, "zstd", zstandard.compress(ZEROS))),
    ("log", log_of(ONE, "lz4", FRAMED[:20] + b"\xff" + FRAMED[21:])),
    *(
        ("log", log_of(ONE, name=name, schema=b"string[1000000000] x\n"))
        for name in ("p", "p/msg/X")
    ),
    ("log", log_of(ONE, name="p/msg/X", schema=b"\xff\xfe\n")),
    ("journal", JOURNAL + b"[" * 10**5 + b"\n"),
    ("journal", JOURNAL + POINT.replace(b"0", b"[]")),
    (
        "journal",
        JOURNAL + POINT.replace(b'"columns": {"a": 1.5}', b'"row": "this:d", "values": []'),
    ),
]
