"""Small logs and bags as public bug reports describe them; see `test_reported_logs`."""

import sqlite3
import struct
from pathlib import Path

from mcap.writer import CompressionType, Writer

STRING = "std_msgs/msg/String"
SECOND = 10**9


def string(value: bytes) -> bytes:
    """Return text as CDR of a string, also text that is not UTF-8."""
    return struct.pack("<4sI", b"\0\1\0\0", len(value) + 1) + value + b"\0"


def write_mcap(path, messages, *, schemas=None, chunk_size=2**20, **options):
    """Write (topic, seconds, CDR) of strings, or of the schema of the topic: name, encoding, text."""
    defaults = {"compression": CompressionType.ZSTD, "use_chunking": True}
    with path.open("wb") as stream:
        writer = Writer(stream, chunk_size=chunk_size, **defaults | options)
        writer.start("ros2")
        channels = {}
        for topic, seconds, data in messages:
            name, encoding, text = (schemas or {}).get(topic, (STRING, "ros2msg", b"string data\n"))
            if topic not in channels:
                schema = writer.register_schema(name, encoding, text)
                kind = "json" if encoding == "jsonschema" else "cdr"
                # A channel is `topic|number` where one topic has several.
                channels[topic] = writer.register_channel(topic.partition("|")[0], kind, schema)
            time_ns = int(seconds * SECOND)
            writer.add_message(channels[topic], time_ns, data, time_ns)
        writer.finish()
    return path


def write_db3(path, messages, *, qos="", definition=None, journal="DELETE"):
    """Write (topic, seconds, CDR) of strings into an SQLite file of a rosbag2; return it open."""
    database = sqlite3.connect(path)
    database.execute(f"PRAGMA journal_mode={journal}")
    database.execute("PRAGMA wal_autocheckpoint=0")
    database.executescript(
        "CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT NOT NULL, type TEXT NOT NULL,"
        " serialization_format TEXT NOT NULL, offered_qos_profiles TEXT NOT NULL);"
        "CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER NOT NULL,"
        " timestamp INTEGER NOT NULL, data BLOB NOT NULL);"
        "CREATE INDEX timestamp_idx ON messages (timestamp ASC);"
    )
    topics = sorted({topic for topic, *_ in messages})
    for topic in topics:
        database.execute(
            "INSERT INTO topics(name, type, serialization_format, offered_qos_profiles)"
            " VALUES(?, ?, 'cdr', ?)",
            (topic, STRING, qos),
        )
    if definition:
        database.execute(
            "CREATE TABLE message_definitions(id INTEGER PRIMARY KEY, topic_type TEXT NOT NULL,"
            " encoding TEXT NOT NULL, encoded_message_definition TEXT NOT NULL,"
            " type_description_hash TEXT NOT NULL)"
        )
        row = "INSERT INTO message_definitions VALUES(1, ?, ?, ?, '')"
        database.execute(row, (STRING, *definition))
    for topic, seconds, data in messages:
        database.execute(
            "INSERT INTO messages(topic_id, timestamp, data) VALUES(?, ?, ?)",
            (topics.index(topic) + 1, int(seconds * SECOND), data),
        )
    database.commit()
    return database


def write_metadata(folder: Path, files, messages, *, storage="mcap", qos='""'):
    """Write the metadata.yaml of a rosbag2."""
    counts = {}
    for topic, *_ in messages:
        counts[topic] = counts.get(topic, 0) + 1
    topics = "".join(
        f"    - topic_metadata:\n        name: {topic}\n        type: {STRING}\n"
        f"        serialization_format: cdr\n        offered_qos_profiles: {qos}\n"
        f"      message_count: {count}\n"
        for topic, count in counts.items()
    )
    names = "".join(f"    - {name}\n" for name in files)
    (folder / "metadata.yaml").write_text(
        "rosbag2_bagfile_information:\n"
        f'  version: 5\n  storage_identifier: "{storage}"\n'
        f"  duration:\n    nanoseconds: {SECOND}\n"
        f"  starting_time:\n    nanoseconds_since_epoch: {SECOND}\n"
        f"  message_count: {len(messages)}\n  topics_with_message_count:\n{topics}"
        f'  compression_format: ""\n  compression_mode: ""\n  relative_file_paths:\n{names}'
    )
