"""Bags as rosbag2 writes them, from a log."""

from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from rosbags.rosbag2.metadata import parse_qos
from rosbags.typesys import Stores, get_typestore

from sfglab.messages.store import parse_definition
from sfglab.record import LogReader
from sfglab.record.metadata import offered_qos_profiles


def hash_of(type_name, definition):
    """The hash of a type by its definition (REP 2016)."""
    store = get_typestore(Stores.EMPTY)
    store.register(parse_definition(type_name, definition))
    return store.hash_rihs01(type_name)


def write_bag(log, folder, storage=StoragePlugin.MCAP, compression=CompressionMode.NONE):
    """Write the messages of a log into a rosbag2 folder."""
    writer = Writer(folder, version=9, storage_plugin=storage)
    writer.set_compression(compression, CompressionFormat.ZSTD)
    with LogReader(log) as reader, writer:
        connections = {}
        for topic, info in reader.topics.items():
            connections[topic] = writer.add_connection(
                topic,
                info.type_name,
                msgdef=info.definition,
                rihs01=hash_of(info.type_name, info.definition),
                offered_qos_profiles=parse_qos(offered_qos_profiles(reader.offered_qos(topic))),
            )
        for message in reader.messages():
            writer.write(connections[message.topic], message.log_time_ns, message.cdr)
    return folder
