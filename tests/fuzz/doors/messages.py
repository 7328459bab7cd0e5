"""Messages of DDS, by their types, and what their types say they are."""

from doors import RULE, Door, text
from sfglab.codecs import FFMPEG_PACKET
from sfglab.fleet.decoder.streams import routes_of_agent
from sfglab.fleet.discovery.registry import Registry
from sfglab.fleet.router.frames import Frames, TransformGate
from sfglab.fleet.status.description import AgentDescription, SensorDescription, StreamDescription
from sfglab.fleet.status.heartbeat import Heartbeat
from sfglab.messages import MessageError, default_message, deserialize, message_type, serialize
from sfglab.messages.cdr import decoder_from_definition
from sfglab.messages.services import unframe_service
from sfglab.spatial.frames.buffer import FrameBuffer
from sfglab.spatial.frames.listener import TransformIntake

TF, MARKERS = "tf2_msgs/msg/TFMessage", "visualization_msgs/msg/MarkerArray"
POINTS = "sensor_msgs/msg/PointCloud2"
INFO = "sfglab_interfaces/msg/Agent"
STREAM = {"type": FFMPEG_PACKET, "codec": "h264", "width": 640, "height": 360, "rate_hz": 30.0}
STREAMS = (StreamDescription(topic="/global/go2/camera_front/color/ffmpeg", **STREAM),)
AGENT = AgentDescription(sensors=(SensorDescription(name="camera", streams=STREAMS),))
METADATA = serialize(AGENT.to_message("go2", incarnation=1, revision=1, stamp_ns=1))
BEAT = Heartbeat(
    agent="go2", incarnation=1, revision=1, phase=1, period_s=1.0, version="1"
).to_message(1)
PLACED = default_message("geometry_msgs/msg/TransformStamped")
PLACED.header.frame_id, PLACED.child_frame_id, PLACED.transform.rotation.w = (
    "other/odom",
    "other/base",
    1.0,
)
PLACES = serialize(message_type(TF)([PLACED, PLACED]))
NESTED = f"p/Y[3] a\nstring[2] b\n{RULE}\nMSG: p/Y\nint8 x 3\nfloat64[<=4] y\n".encode()
CHAIN = (
    "".join(f"{RULE}\nMSG: p/T{i}\nT{i + 1}[100] a\n" for i in range(20))
    + f"{RULE}\nMSG: p/T20\nint8 x\n"
)
WIDE = (
    "string[1000000000] x\n",
    f"p/E[2000000000] a\n{RULE}\nMSG: p/E\n\n",
    f"T0 a\n{CHAIN}",
    "int8[0] a\n",
)
FIELDS = "".join(f"int8 a{i}\n" for i in range(20000))


def message(type_name, handle=lambda _: None):
    return lambda data: handle(deserialize(data, type_name))


def transforms(data):
    TransformGate(Frames(agent="own")).inward("other")(data)
    TransformIntake(FrameBuffer()).take(deserialize(data, TF), static=False)


def beat(found):
    Registry("own").heard(Heartbeat.from_message(found), bytes(16), now_ns=1)


DOORS = {
    "cdr": Door(message(MARKERS), MessageError, (serialize(default_message(MARKERS)),)),
    "points": Door(message(POINTS), MessageError, (serialize(default_message(POINTS)),)),
    "heartbeat": Door(message(f"{INFO}Heartbeat", beat), MessageError, (serialize(BEAT),)),
    "metadata": Door(message(f"{INFO}Metadata", routes_of_agent), MessageError, (METADATA,)),
    "transforms": Door(transforms, MessageError, (PLACES,)),
    "service frame": Door(unframe_service, MessageError, (bytes(24),)),
    "definition": Door(
        text(lambda t: decoder_from_definition("p/msg/X", t)), MessageError, (NESTED,)
    ),
}
ATTACKS = [
    ("definition", data.encode())
    for data in (*WIDE, "p/X a\n", "p/X[] a\n", f"int8 A={'9' * 5000}\n", FIELDS)
]
