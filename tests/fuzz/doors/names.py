"""Names, and what endpoints say of themselves in the graph and in shared memory."""

from doors import Door, text
from sfglab.bus.api import entries
from sfglab.bus.dds.discovery import NodeInfo, pack_nodes, unpack_nodes
from sfglab.bus.errors import BusError
from sfglab.bus.shm import wire
from sfglab.messages import MessageError
from sfglab.messages.type_names import dds_type_name, ros_type_name
from sfglab.names import FqnError, parse

NODES = (
    NodeInfo(namespace="/", name="n", participant=bytes(16), readers=(bytes(16),), writers=()),
)


def shared_memory(data):
    for unpacked in (wire.unpack_hello, wire.unpack_welcome, wire.unpack_returns):
        try:
            unpacked(data)
        except wire.ProtocolError:
            continue
    wire.unpack_announcement(data, 2**20)


def types(name):
    return ros_type_name(name), dds_type_name(name)


DOORS = {
    "graph": Door(
        lambda data: unpack_nodes(data, 16), BusError, (pack_nodes(bytes(16), NODES, 16),)
    ),
    "user data": Door(entries, (), (b"a=b;c=d;",)),
    "shared memory": Door(
        shared_memory, BusError, (wire.pack_hello(wire.Hello(1, True)), bytes(32))
    ),
    "names": Door(text(parse), FqnError, (b"/global/go2/camera_front/color/ffmpeg",)),
    "type names": Door(text(types), MessageError, (b"std_msgs::msg::dds_::String_",)),
}
ATTACKS = [
    ("graph", bytes(20) + b"\xff\xff\xff\xff"),
    *(("type names", b"a" * 60 + end) for end in (b"", b"::msg::dds_::A!", b"/msg/A!")),
]
