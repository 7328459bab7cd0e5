"""Doors that bytes of strangers come through: what is read there, what refuses it, and with what to begin.

A door answers or raises its one class of error, within a second of processor time and in little memory.
`ATTACKS` are inputs with which one of them once did not.
"""

import gzip
import struct
import tarfile
import tempfile
import zlib
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import NamedTuple

import lz4.frame
import numpy as np
import zstandard
from mcap.data_stream import RecordBuilder
from mcap.records import Channel, Chunk, Schema

from sfglab import codecs
from sfglab.bus.api import entries
from sfglab.bus.dds.discovery import NodeInfo, pack_nodes, unpack_nodes
from sfglab.bus.errors import BusError
from sfglab.bus.shm import wire
from sfglab.deploy.bundle import Bundle, Member, pack, unpack
from sfglab.deploy.errors import DeployError
from sfglab.deploy.rollout import plan_changes
from sfglab.deploy.routers.dds_router_check import check_dds_router
from sfglab.deploy.routers.zenoh_check import check_zenoh
from sfglab.deploy.transport import Ssh, accelerator_of
from sfglab.documents import DocumentError
from sfglab.errors import SfglabError
from sfglab.fleet.decoder.streams import routes_of_agent
from sfglab.fleet.discovery.screening import Limits, Screen
from sfglab.fleet.fleet_file import read_fleet
from sfglab.fleet.router.frames import Frames, TransformGate
from sfglab.fleet.status.description import AgentDescription, SensorDescription, StreamDescription
from sfglab.fleet.status.heartbeat import Heartbeat
from sfglab.lab.sweep.journal import Journal, JournalError, result_from_text
from sfglab.messages import MessageError, default_message, deserialize, message_type, serialize
from sfglab.messages.cdr import decoder_from_definition
from sfglab.messages.services import unframe_service
from sfglab.messages.type_names import dds_type_name, ros_type_name
from sfglab.names import FqnError, parse
from sfglab.record import LogError, LogReader, LogWriter
from sfglab.spatial.frames.buffer import FrameBuffer
from sfglab.spatial.frames.listener import TransformIntake
from sfglab.spatial.scene.files import read_scene
from sfglab.spatial.trajectory.exchange import COLUMNS, trajectory_from_csv

ROOT = Path(__file__).parents[2]
FOLDER = Path(tempfile.mkdtemp(prefix="sfglab-fuzz-", dir="/dev/shm"))
TF, MARKERS = "tf2_msgs/msg/TFMessage", "visualization_msgs/msg/MarkerArray"
RULE = "=" * 80


class Door(NamedTuple):
    """A place where strangers' bytes are read."""

    read: Callable[[bytes], object]
    refuses: type[SfglabError] | tuple[type[SfglabError], ...]
    begins: tuple[bytes, ...]  # what is sent by friends


def text(read):
    return lambda data: read(data.decode("utf-8", "surrogateescape"))


def message(type_name, handle=lambda _: None):
    return lambda data: handle(deserialize(data, type_name))


def picture(kind, begin, **fields):
    """One stream of a small announced size; after each input the next good one must show."""
    decoder, good = (
        codecs.image_decoder(kind, most_pixels=640 * 360),
        SimpleNamespace(pts=1, **fields, data=begin),
    )

    def read(data):
        try:
            decoder.feed(SimpleNamespace(pts=0, **fields, data=data))
        finally:
            assert decoder.feed(good)

    return Door(read, codecs.CodecError, (begin,))


def log(data):
    (FOLDER / "a.mcap").write_bytes(data)
    with LogReader(FOLDER / "a.mcap") as found:
        found.overview()
        for topic in found.topics:
            found.knows(topic)
            list(found.decoded(topic))
        for name in found.metadata_names:
            found.metadata(name)


def journal(data):
    path = FOLDER / "a.journal"
    path.write_bytes(data)
    with Journal(path, {"task": "t"}) as found:
        for result in found.finished.values():
            result_from_text(result)


class Answering(Ssh):
    """A machine with a given answer."""

    def run(self, _script, **_):
        return self.program


def shared_memory(data):
    for unpacked in (wire.unpack_hello, wire.unpack_welcome, wire.unpack_returns):
        try:
            unpacked(data)
        except wire.ProtocolError:
            continue
    wire.unpack_announcement(data, 2**20)


def transforms(data):
    TransformGate(Frames(agent="own")).inward("other")(data)
    TransformIntake(FrameBuffer(), agent="own").take(deserialize(data, TF), static=False)


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


def png(width, height):
    """A depth picture of zeros that is small as a file."""
    rows = zlib.compress(bytes(height * (2 * width + 1)), 9)
    parts = (b"IHDR", struct.pack(">IIBBBBB", width, height, 16, 0, 0, 0, 0)), (b"IDAT", rows), (b"IEND", b"")
    blocks = (struct.pack(">I", len(d)) + n + d + struct.pack(">I", zlib.crc32(n + d)) for n, d in parts)
    return bytes(12) + b"\x89PNG\r\n\x1a\n" + b"".join(blocks)


MEMBERS = {"manifest.json": b'{"tag": "a", "files": {"b": {"sha256": "0"}}}', "b": b"x"}
MEMBERS = {name: Member(data=data, mode=0o644) for name, data in MEMBERS.items()}
BUNDLE = Bundle(agent="a", tag="t", image="i", members=MEMBERS)
STREAM = {"type": codecs.FFMPEG_PACKET, "codec": "h264", "width": 640, "height": 360, "rate_hz": 30.0}
STREAMS = (StreamDescription(topic="/global/go2/camera_front/color/ffmpeg", **STREAM),)
AGENT = AgentDescription(sensors=(SensorDescription(name="camera", streams=STREAMS),))
METADATA = serialize(AGENT.to_message("go2", incarnation=1, revision=1, stamp_ns=1))
BEAT = Heartbeat(agent="go2", incarnation=1, revision=1, phase=1, period_s=1.0, version="1").to_message(1)
PLACED = default_message("geometry_msgs/msg/TransformStamped")
PLACED.header.frame_id, PLACED.child_frame_id, PLACED.transform.rotation.w = "other/odom", "other/base", 1.0
PLACES = serialize(message_type(TF)([PLACED, PLACED]))
DEPTH = np.arange(48 * 64, dtype=np.uint16).reshape(48, 64)
COLOURS = np.arange(360 * 640 * 3, dtype=np.uint8).reshape(360, 640, 3)
VIDEO = codecs.H264Encoder(codecs.TABLE_2).encode(COLOURS)[0].data
RVL, MED, PNG = (codecs.compressed_depth_fields(DEPTH, codec).data for codec in ("rvl", "med", "png"))
JPEG = codecs.compressed_image_fields(COLOURS[:48, :64].copy()).data
NODES = (NodeInfo(namespace="/", name="n", participant=bytes(16), readers=(bytes(16),), writers=()),)
NESTED = f"p/Y[3] a\nstring[2] b\n{RULE}\nMSG: p/Y\nint8 x 3\nfloat64[<=4] y\n".encode()
ZENOH = b"// x\n{mode: 'peer', plugins: {ros2dds: {domain: 1, allow: {publishers: [\"/a/.*\"], }, },},}\n"
ROUTER = b"version: v5.0\nparticipants:\n  - name: a\n    kind: local\n    domain: 1\n"
JOURNAL = b'{"sfglab_sweep": 1, "task": "t"}\n'
POINT = b'{"point": 0, "seed": 0, "result": {"columns": {"a": 1.5}}}\n'
FACTS = b"/dev/dri/card0\n/etc/group dmlkZW86eDo0NDo=\n/proc/device-tree/model YQ==\n"
CSV = f"{','.join(COLUMNS)}\n0.0,1,2,3,0,0,0,1\n".encode()
FLEET, SCENE = ((ROOT / f"data/{name}.yaml").read_bytes()[:1500] for name in ("fleets/lab", "scenes/hall"))
INFO = "sfglab_interfaces/msg/Agent"


def beat(found):
    Screen("own", Limits()).check(Heartbeat.from_message(found), bytes(16), now_ns=1)


def types(name):
    return ros_type_name(name), dds_type_name(name)


DOORS: dict[str, Door] = {
    "cdr": Door(message(MARKERS), MessageError, (serialize(default_message(MARKERS)),)),
    "heartbeat": Door(message(f"{INFO}Heartbeat", beat), MessageError, (serialize(BEAT),)),
    "metadata": Door(message(f"{INFO}Metadata", routes_of_agent), MessageError, (METADATA,)),
    "transforms": Door(transforms, MessageError, (PLACES,)),
    "service frame": Door(unframe_service, MessageError, (bytes(24),)),
    "graph": Door(lambda data: unpack_nodes(data, 16), BusError, (pack_nodes(bytes(16), NODES, 16),)),
    "user data": Door(entries, (), (b"a=b;c=d;",)),
    "shared memory": Door(shared_memory, BusError, (wire.pack_hello(wire.Hello(1, True)), bytes(32))),
    "names": Door(text(parse), FqnError, (b"/global/go2/camera_front/color/ffmpeg",)),
    "type names": Door(text(types), MessageError, (b"std_msgs::msg::dds_::String_",)),
    "h264": picture(codecs.FFMPEG_PACKET, VIDEO, encoding="h264"),
    "foxglove": picture(codecs.COMPRESSED_VIDEO, VIDEO, format="h264"),
    "rvl": picture(codecs.COMPRESSED_IMAGE, RVL, format="16UC1; compressedDepth rvl"),
    "med": picture(codecs.COMPRESSED_IMAGE, MED, format="16UC1; compressedDepth med"),
    "png": picture(codecs.COMPRESSED_IMAGE, PNG, format="16UC1; compressedDepth png"),
    "jpeg": picture(codecs.COMPRESSED_IMAGE, JPEG, format="jpeg"),
    "definition": Door(text(lambda t: decoder_from_definition("p/msg/X", t)), MessageError, (NESTED,)),
    "log": Door(log, (LogError, MessageError), (written_log(), log_of(record(bytes(8))))),
    "journal": Door(journal, JournalError, (JOURNAL + POINT,)),
    "fleet": Door(text(read_fleet), DocumentError, (FLEET,)),
    "scene": Door(text(read_scene), SfglabError, (SCENE,)),
    "trajectory": Door(text(trajectory_from_csv), SfglabError, (CSV,)),
    "zenoh": Door(text(check_zenoh), SfglabError, (ZENOH,)),
    "dds router": Door(text(check_dds_router), SfglabError, (ROUTER,)),
    "archive": Door(lambda data: plan_changes(BUNDLE, unpack(data)), DeployError, (pack(BUNDLE),)),
    "machine": Door(lambda d: accelerator_of(Answering(address="m", program=d)), DeployError, (FACTS,)),
}

ZEROS, EMPTY, ONE = bytes(2**26), record(b"") * 10**6, record(bytes(8))
FRAMED = lz4.frame.compress(ONE)
CHAIN = "".join(f"{RULE}\nMSG: p/T{i}\nT{i + 1}[100] a\n" for i in range(20)) + f"{RULE}\nMSG: p/T20\nint8 x\n"
YAML = ("!!int ''", "!!bool maybe", "!!timestamp x", '"\\U00110000"', "0x" + "f" * 5000, ":".join("1" * 10**5))
WIDE = ("string[1000000000] x\n", f"p/E[2000000000] a\n{RULE}\nMSG: p/E\n\n", f"T0 a\n{CHAIN}", "int8[0] a\n")
FIELDS = "".join(f"int8 a{i}\n" for i in range(20000))
SPARSE = tarfile.TarInfo("b")
SPARSE.size = 2**33
BENT = tarfile.TarInfo("../b")

ATTACKS: list[tuple[str, bytes]] = [
    *(("fleet", f"fleet: {value}\nagents: {value}\n".encode()) for value in YAML),
    *(
        ("zenoh", data)
        for data in (b"{a: 1," + b"/* x */ " * 40 + b"3}", b"/*" * 2**15, b'"\\' * 2**15, b"1" * 2**16)
    ),
    *(("type names", b"a" * 60 + end) for end in (b"", b"::msg::dds_::A!", b"/msg/A!")),
    *(
        ("definition", data.encode())
        for data in (*WIDE, "p/X a\n", "p/X[] a\n", f"int8 A={'9' * 5000}\n", FIELDS)
    ),
    *(("log", log_of(data, "zstd", zstandard.compress(data))) for data in (ZEROS, EMPTY)),
    *(("log", log_of(data, "lz4", lz4.frame.compress(ZEROS))) for data in (ZEROS, ONE)),
    ("log", log_of(ONE, "zstd", zstandard.compress(ZEROS))),
    ("log", log_of(ONE, "lz4", FRAMED[:20] + b"\xff" + FRAMED[21:])),
    *(("log", log_of(ONE, name=name, schema=b"string[1000000000] x\n")) for name in ("p", "p/msg/X")),
    ("log", log_of(ONE, name="p/msg/X", schema=b"\xff\xfe\n")),
    ("journal", JOURNAL + b"[" * 10**5 + b"\n"),
    ("journal", JOURNAL + POINT.replace(b"0", b"[]")),
    ("journal", JOURNAL + POINT.replace(b'"columns": {"a": 1.5}', b'"row": "this:d", "values": []')),
    *(("archive", data) for data in (SPARSE.tobuf(), BENT.tobuf(), b"x" * 600, gzip.compress(bytes(2**28)))),
    *(
        ("machine", data)
        for data in (b"/etc/group a\n", b"/a\0b YQ==\n", b"/etc\n/etc/group\n", b"/" + b"a" * 300)
    ),
    ("rvl", bytes(12) + struct.pack("<II", 8192, 8192) + bytes(8)),
    *(
        ("med", bytes(12) + struct.pack("<II", 8192, 8192) + zstandard.compress(data))
        for data in (ZEROS, ZEROS + ZEROS, b"\xff" * len(ZEROS))
    ),
    ("png", png(8000, 8000)),
    ("graph", bytes(20) + b"\xff\xff\xff\xff"),
    ("trajectory", CSV.replace(b"0.0", b"1e99999999")),
    ("trajectory", CSV.replace(b"x_m", b"\r_m")),
]
