import array
import struct
import subprocess
import sys
from dataclasses import asdict
from fractions import Fraction
from types import SimpleNamespace

import av
import numpy as np
import pytest

from sfglab import codecs
from sfglab.codecs import (
    COMPRESSED_IMAGE,
    FFMPEG_PACKET,
    CodecUnavailableError,
    H264Decoder,
    image_decoder,
)
from sfglab.codecs.still import encode_png


def message(fields, **changes) -> SimpleNamespace:
    """Return the fields as a message would hold them: bytes as an array, and a header."""
    values = asdict(fields) | {"header": None}
    values["data"] = np.frombuffer(values["data"], np.uint8)
    return SimpleNamespace(**values | changes)


def packets(stream, start=0, stop=None):
    return [
        message(codecs.ffmpeg_packet_fields(frame, codecs.TABLE_2)) for frame in stream[start:stop]
    ]


def test_an_ffmpeg_packet_has_the_fields_of_version_3_and_depth_its_format_and_payload():
    frame = codecs.EncodedPacket(data=b"\0\0\1\x65", pts=7, is_key=True)
    assert asdict(codecs.ffmpeg_packet_fields(frame, codecs.TABLE_2)) == {
        "width": 640,
        "height": 360,
        "encoding": "h264;yuv420p;bgr8;bgr8",
        "pts": 7,
        "flags": 1,
        "is_bigendian": False,
        "data": b"\0\0\1\x65",
    }
    other = codecs.EncodedPacket(data=b"", pts=8, is_key=False)
    assert codecs.ffmpeg_packet_fields(other, codecs.TABLE_2).flags == 0
    fields = codecs.compressed_depth_fields(np.array([[0, 0, 5, 6, 6]], np.uint16))
    assert fields.format == "16UC1; compressedDepth rvl"
    assert fields.data == bytes(12) + struct.pack("<II", 5, 1) + bytes.fromhex("0020a123")
    assert codecs.compressed_depth_fields(np.ones((2, 2), np.uint16), "png").format.endswith("png")


@pytest.mark.parametrize(
    ("text", "codec", "ros_encoding"),
    [
        ("h264;yuv420p;bgr8;bgr8", "h264", "bgr8"),
        ("hevc;yuv420p10le;16UC1;16UC1", "hevc", "16UC1"),
        *(
            (text, "h264", "")
            for text in ("libx264", "libx264rgb", "h264_nvmpi", "h264_nvenc", "H264")
        ),
        *((text, "hevc", "") for text in ("hevc_nvenc", "hevc_vaapi", "libx265")),
        ("libsvtav1", "libsvtav1", ""),
        ("", "", ""),
    ],
)
def test_encodings_of_both_generations_name_their_codec(text, codec, ros_encoding):
    encoding = codecs.parse_ffmpeg_encoding(text)
    assert (encoding.codec, encoding.ros_encoding) == (codec, ros_encoding)


def test_ffmpeg_packets_decode_to_the_decoders_pixels(stream):
    decoder = image_decoder(FFMPEG_PACKET)
    direct = H264Decoder()
    for frame, packet in zip(stream[:35], packets(stream, 0, 35), strict=True):
        (image,) = decoder.feed(packet)
        assert (image.encoding, image.is_key, image.intact) == ("bgr8", frame.is_key, True)
        assert np.array_equal(image.array, direct.decode_bgr(frame.data)[0])


def test_skipped_packets_leave_the_pictures_after_them_as_they_would_be(stream):
    decoder, continuous = image_decoder(FFMPEG_PACKET), H264Decoder()
    expected = [continuous.decode_bgr(frame.data)[0] for frame in stream[:13]]
    for packet in packets(stream, 0, 12):
        decoder.skip(packet)
    (image,) = decoder.feed(packets(stream, 12, 13)[0])
    assert np.array_equal(image.array, expected[-1])
    assert image.intact


def test_a_skipped_packet_that_is_broken_or_a_still_image_is_treated_as_it_would_be_decoded(stream):
    decoder = image_decoder(FFMPEG_PACKET)
    decoder.skip(packets(stream, 0, 1)[0])
    bad = packets(stream, 1, 2)[0]
    bad.data = bad.data[:100]
    with pytest.raises(codecs.BitstreamError):
        decoder.skip(bad)
    assert decoder._video.waiting
    assert decoder.feed(packets(stream, 30, 31)[0]), "heals"
    image_decoder(COMPRESSED_IMAGE, "png").skip(
        SimpleNamespace(format="bgr8; png compressed bgr8", data=b"")
    )


def test_a_missing_packet_taints_pictures_up_to_the_next_key_frame_also_of_a_sender_that_starts_anew(
    stream,
):
    decoder = image_decoder(FFMPEG_PACKET)
    intact = {p.pts: decoder.feed(p)[0].intact for p in packets(stream, 0, 35) if p.pts != 10}
    assert [pts for pts, whole in intact.items() if not whole] == list(range(11, 30))
    assert [decoder.feed(p)[0].intact for p in packets(stream, 0, 2)] == [True] * 2


@pytest.mark.parametrize(
    "data_type", [bytes, bytearray, memoryview, list, lambda data: array.array("B", data)]
)
def test_data_may_come_in_any_shape_that_message_libraries_use(stream, data_type):
    packet = packets(stream, 0, 1)[0]
    packet.data = data_type(stream[0].data)
    assert image_decoder(FFMPEG_PACKET).feed(packet)


def test_old_and_foreign_encodings_of_h264_decode_and_unknown_or_deep_ones_are_refused(stream):
    fields, decoder = (
        codecs.ffmpeg_packet_fields(stream[0], codecs.TABLE_2),
        image_decoder(FFMPEG_PACKET),
    )
    for encoding in ("libx264", "h264_nvmpi", "h264;yuv420p;bgr8;rgb8"):
        assert decoder.feed(message(fields, encoding=encoding))
    for deep in ("16UC1", "mono16", "32FC1", "bayer_rggb16"):
        with pytest.raises(CodecUnavailableError, match="8 bits"):  # rather than cut
            decoder.feed(message(fields, encoding=f"h264;yuv420p;{deep};{deep}"))
    with pytest.raises(CodecUnavailableError, match=r"libsvtav1.*h264, hevc"):
        decoder.feed(message(fields, encoding="libsvtav1"))


def test_a_hint_helps_where_the_message_names_nothing_known_and_is_overruled_where_it_does(stream):
    packet = message(
        codecs.ffmpeg_packet_fields(stream[0], codecs.TABLE_2), encoding="vendor_encoder"
    )
    assert image_decoder(FFMPEG_PACKET, "h264").feed(packet)
    depth = codecs.compressed_depth_fields(np.array([[3, 4]], np.uint16))
    (image,) = image_decoder(COMPRESSED_IMAGE, "rvl").feed(message(depth, format=""))
    assert image.array.tolist() == [[3, 4]]
    depth = codecs.compressed_depth_fields(np.array([[3, 4]], np.uint16), "png")
    assert image_decoder(COMPRESSED_IMAGE, "rvl").feed(message(depth))[0].array.tolist() == [[3, 4]]
    for hint in ("", None, "libx264"):
        assert image_decoder(FFMPEG_PACKET, hint).feed(packets(stream, 0, 1)[0])


def test_a_hint_loads_the_codec_before_the_first_message():
    code = (
        "import sys; from sfglab.codecs import *; image_decoder(COMPRESSED_IMAGE, 'rvl')\n"
        "print('sfglab.codecs.rvl' in sys.modules)"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=60
    )
    assert done.stdout.strip() == "True"
    assert image_decoder(FFMPEG_PACKET, "h264")._video.waiting
    assert image_decoder(COMPRESSED_IMAGE)._video is None


def test_an_impossible_hint_and_an_unreadable_type_are_refused_at_once():
    with pytest.raises(CodecUnavailableError, match="vp9"):
        image_decoder(FFMPEG_PACKET, "vp9")
    with pytest.raises(CodecUnavailableError, match="CompressedImage"):
        image_decoder("sensor_msgs/msg/PointCloud2")


@pytest.mark.parametrize("codec", ["JPEG", "PNG"])
@pytest.mark.parametrize("rename", ["{}", "rgb8; {} compressed bgr8"])
def test_compressed_colour_is_found_by_a_part_of_its_format(pictures, codec, rename):
    fields = codecs.compressed_image_fields(pictures[0])
    assert fields.format == "bgr8; jpeg compressed bgr8"
    data = fields.data if codec == "JPEG" else encode_png(pictures[0], level=1)
    (image,) = image_decoder(COMPRESSED_IMAGE).feed(
        message(fields, format=rename.format(codec), data=data)
    )
    assert image.encoding == "bgr8"
    assert np.abs(image.array.astype(int) - pictures[0]).mean() < (1e-9 if codec == "PNG" else 8)


@pytest.mark.parametrize(
    ("dtype", "text", "encoding"),
    [
        (np.uint8, "mono8; png compressed ", "mono8"),
        (np.uint8, "8UC1; png compressed 8UC1", "8UC1"),
        (np.uint16, "16UC1; png compressed 16UC1", "16UC1"),
        (np.uint16, "png", "mono16"),
        (np.uint16, "mono8; png", "mono16"),
    ],
)
def test_grey_pictures_are_named_by_their_bits(dtype, text, encoding):
    picture = np.arange(12, dtype=dtype).reshape(3, 4)
    message = SimpleNamespace(format=text, data=encode_png(picture, level=1))
    (image,) = image_decoder(COMPRESSED_IMAGE).feed(message)
    assert image.encoding == encoding
    assert np.array_equal(image.array, picture)


def test_h264_decodes_in_a_compressed_image_or_video_and_another_kind_is_refused(stream):
    (expected,) = H264Decoder().decode_bgr(stream[0].data)
    for type_name in (COMPRESSED_IMAGE, codecs.COMPRESSED_VIDEO):
        (image,) = image_decoder(type_name).feed(
            SimpleNamespace(format="h264", data=stream[0].data)
        )
        assert np.array_equal(image.array, expected)
    for text in ("", "tiff", "bgr8; tiff compressed "):
        with pytest.raises(CodecUnavailableError):
            image_decoder(COMPRESSED_IMAGE).feed(SimpleNamespace(format=text, data=b"abc"))


@pytest.mark.skipif(
    "libx265" not in av.codecs_available, reason="this build of FFmpeg cannot make H.265"
)
def test_h265_decodes_from_its_key_frame(pictures):
    context = av.CodecContext.create("libx265", "w")
    context.width, context.height, context.pix_fmt, context.time_base = (
        640,
        360,
        "yuv420p",
        Fraction(1, 30),
    )
    context.options = {
        "preset": "ultrafast",
        "tune": "zerolatency",
        "x265-params": "log-level=none:keyint=4",
    }
    data = []
    for index, picture in enumerate(pictures[:6]):
        frame = av.VideoFrame.from_ndarray(picture, "bgr24").reformat(format="yuv420p")
        frame.pts = index
        data += [bytes(packet) for packet in context.encode(frame)]
    data += [bytes(packet) for packet in context.encode(None)]
    decoder = image_decoder(codecs.COMPRESSED_VIDEO)
    shown = [decoder.feed(SimpleNamespace(format="h265", data=packet)) for packet in data[1:]]
    assert [len(images) for images in shown] == [0, 0, 0, 1, 1]
    assert np.abs(shown[-1][0].array.astype(int) - pictures[5]).mean() < 12


@pytest.mark.parametrize("image", [np.zeros((4, 4), "u1"), np.zeros((4, 4, 3), "u2")])
def test_other_colour_images_are_refused(image):
    with pytest.raises(codecs.CodecError, match="colour image"):
        codecs.compressed_image_fields(image)
