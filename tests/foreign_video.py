"""Small H.264 streams as drivers other than ffmpeg_image_transport write them, made here."""

from fractions import Fraction
from types import SimpleNamespace

import av
import numpy as np

from sfglab.codecs import COMPRESSED_VIDEO, FFMPEG_PACKET
from sfglab.messages import default_message

GOP = 5
COUNT = 10

#: `pts` of a packet by its number; ffmpeg_image_transport writes the number itself.
CLOCKS = {
    "nanoseconds": lambda number: 1_700_000_000_000_000_000 + 100_000_000 * number,
    "90 kHz": lambda number: 9000 * number,
    "zero": lambda _: 0,
}


def packets(count=COUNT, *, b_frames=0) -> list:
    """Return packets of 64 x 48 pixels in the order of decoding, a key frame every five without B frames."""
    context = av.CodecContext.create("libx264", "w")
    context.width, context.height, context.pix_fmt = 64, 48, "yuv420p"
    context.time_base = Fraction(1, 30)
    context.max_b_frames = b_frames
    context.gop_size = 50 if b_frames else GOP
    tune = {} if b_frames else {"tune": "zerolatency"}
    context.options = {"preset": "veryfast", "x264-params": "scenecut=0:b-adapt=0", **tune}
    made = []
    for number in range(count):
        image = np.full((48, 64, 3), 40, np.uint8)
        image[8:24, 4 * number : 4 * number + 16] = 220
        frame = av.VideoFrame.from_ndarray(image, "bgr24").reformat(format="yuv420p")
        frame.pts, frame.time_base = number, context.time_base
        made += context.encode(frame)
    made += context.encode(None)
    return [SimpleNamespace(data=bytes(p), pts=p.pts, is_key=p.is_keyframe) for p in made]


def ffmpeg_packet(packet, *, pts=None):
    """Return a packet as a message, with another `pts` if one is given."""
    return default_message(
        FFMPEG_PACKET,
        width=64,
        height=48,
        encoding="h264;yuv420p;bgr8;bgr8",
        pts=packet.pts if pts is None else pts,
        flags=int(packet.is_key),
        data=np.frombuffer(packet.data, np.uint8),
    )


def clocked(clock) -> list:
    """Return the messages of ten packets whose `pts` a driver's clock gives."""
    return [ffmpeg_packet(p, pts=CLOCKS[clock](number)) for number, p in enumerate(packets())]


def avcc(packet):
    """Return a packet as CompressedVideo in AVCC: each NAL unit behind its length instead of a start code."""
    units = packet.data.replace(b"\0\0\0\1", b"\0\0\1").split(b"\0\0\1")[1:]
    data = b"".join(len(unit).to_bytes(4, "big") + unit for unit in units)
    return default_message(COMPRESSED_VIDEO, format="h264", data=np.frombuffer(data, np.uint8))
