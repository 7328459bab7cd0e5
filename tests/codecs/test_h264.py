from dataclasses import replace
from fractions import Fraction
from types import SimpleNamespace

import av
import numpy as np
import pytest
from av.video.reformatter import ColorRange, Colorspace, VideoReformatter
from skimage.metrics import peak_signal_noise_ratio as psnr_db

from sfglab import codecs
from sfglab.codecs import (
    TABLE_2,
    CodecError,
    CodecUnavailableError,
    H264Decoder,
    H264Encoder,
    probe,
)
from sfglab.codecs.libav import VideoEncoder, has_start_code, is_entry_point, nal_unit_types

SMALL = codecs.H264Settings(width=320, height=192, fps=30, bitrate_bps=2_000_000, gop=10)


def patches(rng, *, width: int = 640, height: int = 360) -> np.ndarray:
    colours = rng.integers(0, 256, (height // 40, width // 40, 3))
    return np.kron(colours, np.ones((40, 40, 1))).astype(np.uint8)


def test_each_picture_gives_one_frame_at_once_and_back(pictures, stream):
    decoder = H264Decoder()
    assert [frame.pts for frame in stream] == list(range(len(pictures)))
    for picture, frame in zip(pictures, stream, strict=True):
        (decoded,) = decoder.decode_bgr(frame.data)
        assert decoded.flags.c_contiguous
        assert psnr_db(decoded, picture) > 25


def test_key_frames_stand_at_multiples_of_the_gop_with_their_parameter_sets(stream):
    assert [frame.pts for frame in stream if frame.is_key] == [0, 30, 60]
    for frame in stream:
        kinds = set(nal_unit_types(frame.data, codec="h264"))
        assert kinds >= {5, 7, 8} if frame.is_key else kinds.isdisjoint({5, 7, 8})


@pytest.mark.parametrize(
    ("seconds", "shown"), [(5, 60), (2, 1)], ids=["motion", "a still scene, filled up"]
)
def test_pictures_keep_the_bit_rate_and_every_packet_its_share(pictures, seconds, shown):
    encoder = H264Encoder(TABLE_2)
    sizes = [len(encoder.encode(pictures[index % shown])[0].data) for index in range(30 * seconds)]
    assert sum(sizes) * 8 / seconds == pytest.approx(4_000_000, rel=0.02)
    assert max(sizes) <= 4_000_000 / 8 / 30 * 1.01


def test_a_forced_key_frame_can_be_joined_and_restarts_the_gop(pictures):
    encoder = H264Encoder(TABLE_2)
    frames = [encoder.encode(p, force_key=index == 7)[0] for index, p in enumerate(pictures[:40])]
    assert [frame.pts for frame in frames if frame.is_key] == [0, 7, 37]
    (decoded,) = H264Decoder().decode_bgr(frames[7].data)
    assert psnr_db(decoded, pictures[7]) > 25


def test_widths_that_need_padded_rows_come_out_contiguous(pictures):
    picture = pictures[0][:182, :322]
    (frame,) = H264Encoder(replace(SMALL, width=322, height=182)).encode(picture)
    (decoded,) = H264Decoder().decode_bgr(frame.data)
    assert decoded.shape == (182, 322, 3)
    assert decoded.flags.c_contiguous
    assert psnr_db(decoded, picture) > 25


def test_the_size_may_change_in_mid_stream(pictures, stream):
    decoder = H264Decoder()
    small = H264Encoder(SMALL).encode(np.ascontiguousarray(pictures[0][:192, :320]))
    shapes = [decoder.decode_bgr(f.data)[0].shape for f in (*stream[:2], *small, *stream[:2])]
    assert shapes == [(360, 640, 3)] * 2 + [(192, 320, 3)] + [(360, 640, 3)] * 2


def test_joining_late_refuses_packets_up_to_a_key_frame_and_then_gives_the_same_pixels(stream):
    early, late = H264Decoder(), H264Decoder()
    for frame in stream[:30]:
        early.decode(frame.data)
    assert [late.decode(frame.data) for frame in stream[25:30]] == [()] * 5
    assert late.waiting
    assert late.refused_packets == 5
    for frame in stream[30:40]:
        assert np.array_equal(early.decode_bgr(frame.data)[0], late.decode_bgr(frame.data)[0])
    assert not late.waiting


def test_after_lost_packets_pictures_go_on_and_are_exact_again_at_the_next_key_frame(stream):
    whole, gappy = H264Decoder(), H264Decoder()
    equal = {}
    for frame in stream[:35]:
        (expected,) = whole.decode_bgr(frame.data)
        if frame.pts not in (10, 11, 12):
            (decoded,) = gappy.decode_bgr(frame.data)
            equal[frame.pts] = np.array_equal(decoded, expected)
    assert all(equal[pts] for pts in (*range(10), *range(30, 35)))
    assert not equal[13]


def test_a_broken_packet_is_told_once_and_the_next_key_frame_heals(stream):
    decoder = H264Decoder()
    decoder.decode(stream[0].data)
    with pytest.raises(codecs.BitstreamError) as caught:
        decoder.decode(stream[1].data[: len(stream[1].data) // 3])
    assert caught.value.size_bytes == len(stream[1].data) // 3
    assert caught.value.codec == "h264"
    assert [decoder.decode(frame.data) for frame in stream[2:30]] == [()] * 28
    assert decoder.refused_packets == 28
    assert np.array_equal(
        decoder.decode_bgr(stream[30].data)[0], H264Decoder().decode_bgr(stream[30].data)[0]
    )


@pytest.mark.parametrize("data", [b"", b"\0", b"\0\0\0\x10" + bytes(16), b"jpeg"])
def test_what_is_not_annex_b_is_refused_aloud(data):
    with pytest.raises(codecs.BitstreamError, match="start code"):
        H264Decoder().decode(data)


def test_the_stream_says_which_colours_it_means(stream):
    (frame,) = H264Decoder().decode(stream[0].data)
    assert (frame.colorspace, frame.color_range) == (6, ColorRange.MPEG)  # SMPTE 170M is BT.601


def foreign_stream(image: np.ndarray, *, matrix: Colorspace, tags: dict[str, int]) -> bytes:
    context = av.CodecContext.create("libx264", "w")
    context.width, context.height, context.pix_fmt = image.shape[1], image.shape[0], "yuv420p"
    context.time_base = Fraction(1, 30)
    context.options = {"preset": "ultrafast", "tune": "zerolatency", "qp": "4"}
    for name, value in tags.items():
        setattr(context, name, value)
    source = av.VideoFrame.from_ndarray(image, "bgr24")
    wanted = {"dst_colorspace": matrix, "dst_color_range": ColorRange.MPEG}
    return bytes(context.encode(VideoReformatter().reformat(source, format="yuv420p", **wanted))[0])


def test_colours_survive_the_way_there_and_back():
    image = patches(np.random.default_rng(5))
    (frame,) = H264Encoder(replace(TABLE_2, bitrate_bps=40_000_000)).encode(image)
    difference = colour_difference(frame.data, image)
    assert np.abs(difference).max() <= 6
    assert abs(difference.mean()) < 2


def colour_difference(data: bytes, image: np.ndarray) -> np.ndarray:
    """By how much the middles of the patches differ after decoding."""
    (decoded,) = H264Decoder().decode_bgr(data)
    return decoded[20::40, 20::40].astype(int) - image[20::40, 20::40]


@pytest.mark.parametrize(
    ("matrix", "tags"),
    [
        (
            Colorspace.ITU709,
            {"colorspace": 1, "color_range": 1, "color_primaries": 1, "color_trc": 1},
        ),
        (Colorspace.ITU601, {}),
    ],
    ids=["BT.709 as tagged", "BT.601 if untagged"],
)
def test_foreign_streams_are_converted_by_their_own_matrix(matrix, tags):
    image = patches(np.random.default_rng(6))
    assert (
        np.abs(colour_difference(foreign_stream(image, matrix=matrix, tags=tags), image)).max() <= 8
    )


WRONG = {"fps": 0, "bitrate_bps": -1, "gop": 0}
WRONG_SIZES = (
    {"width": 641},
    {"height": 0},
    {"width": -2, "height": -2},
    {"width": 2**20, "height": 2**10},
)


@pytest.mark.parametrize(
    ("change", "name"),
    [
        *((change, "size") for change in WRONG_SIZES),
        *(({name: WRONG[name]}, name) for name in WRONG),
    ],
)
def test_impossible_settings_are_refused_by_name(change, name):
    with pytest.raises(CodecError, match=name):
        replace(TABLE_2, **change)


@pytest.mark.parametrize(
    "image", [np.zeros((360, 640), "u1"), np.zeros((360, 640, 3), "f4"), np.zeros((2, 2, 3), "u1")]
)
def test_pictures_that_do_not_fit_are_refused(image):
    with pytest.raises(CodecError, match="allowed: uint8 of shape"):
        H264Encoder(TABLE_2).encode(image)


def test_views_encode_like_copies(pictures):
    wide = np.zeros((360, 1280, 3), np.uint8)
    wide[:, ::2] = pictures[0]
    flipped = pictures[0][::-1].copy()
    expected = H264Encoder(TABLE_2).encode(pictures[0])[0].data
    for view in (wide[:, ::2], flipped[::-1]):
        assert H264Encoder(TABLE_2).encode(view)[0].data == expected


def test_a_named_codec_that_does_not_work_is_an_error_with_the_reason():
    with pytest.raises(CodecUnavailableError, match="not in this build") as caught:
        H264Encoder(replace(TABLE_2, encoder="h264_of_nobody"))
    assert caught.value.wanted == "h264_of_nobody"


def test_frames_beyond_the_pixel_limit_are_refused(stream):
    decoder = H264Decoder(most_pixels=640 * 360 - 1)
    with pytest.raises(codecs.BitstreamError, match="libavcodec"):
        decoder.decode(stream[0].data)
    assert decoder.waiting


SPS, PPS, SEI, IDR, P = b"\x67abc", b"\x68abc", b"\x06abc", b"\x65abc", b"\x41abc"


def annexb(*units: bytes, code: bytes = b"\0\0\0\1") -> bytes:
    return b"".join(code + unit for unit in units)


@pytest.mark.parametrize("code", [b"\0\0\1", b"\0\0\0\1"])
def test_units_are_found_behind_either_start_code(code):
    data = annexb(SPS, PPS, SEI, IDR, code=code)
    assert has_start_code(data)
    assert not has_start_code(b"\0\0\0\4" + IDR), "a length"
    assert list(nal_unit_types(data, codec="h264")) == [7, 8, 6, 5]


ENTRIES = [
    *(("h264", annexb(*units)) for units in ((IDR,), (SPS, PPS), (P, IDR))),
    *(("hevc", annexb(bytes([kind << 1, 1]) + b"abc")) for kind in (16, 19, 21, 32)),
]
OTHERS = [
    *(("h264", annexb(*units)) for units in ((P,), (SEI, P), (PPS, P))),
    *(("hevc", annexb(bytes([kind << 1, 1]) + b"abc")) for kind in (0, 1)),
    *(("h264", data) for data in (b"", b"\0", b"\0\0\1", b"\0\0\0\1", b"\0\0\1" * 3 + b"\0\0")),
]


@pytest.mark.parametrize(("codec", "data"), ENTRIES + OTHERS)
def test_a_stream_starts_at_an_idr_or_irap_slice_or_parameter_sets(codec, data):
    assert is_entry_point(data, codec=codec) is ((codec, data) in ENTRIES)


def test_every_candidate_gets_a_verdict_with_a_reason():
    encoders, decoders = codecs.available_encoders(), codecs.available_decoders()
    for probes, names in ((encoders, probe.ENCODERS), (decoders, probe.DECODERS)):
        assert tuple(verdict.name for verdict in probes) == names
        assert all(verdict.reason for verdict in probes)
        assert all(verdict.hardware is (verdict.name not in probe.SOFTWARE) for verdict in probes)
        assert all(verdict.name in av.codecs_available for verdict in probes if verdict.works)
    assert probe.probe_encoder("libx264").works
    assert probe.probe_decoder("h264").works
    assert probe.probe_encoder("libx264") is probe.probe_encoder("libx264"), "reached once"


@pytest.mark.parametrize("count", [0, 2])
def test_an_encoder_that_keeps_a_frame_back_or_gives_more_is_found_out(count):
    encoder = VideoEncoder("libx264", SMALL)
    opened = encoder._context
    encoder._context = SimpleNamespace(
        encode=lambda frame: opened.encode(frame) * count,
        pix_fmt=opened.pix_fmt,
        time_base=opened.time_base,
    )
    with pytest.raises(CodecError, match=f"gave {count} packets for one frame, wanted 1 at once"):
        encoder.encode(np.zeros((192, 320, 3), np.uint8))


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (lambda packet: replace(packet, is_key=True), "forced key"),
        (lambda packet: replace(packet, data=packet.data[4:]), "Annex B"),
        (lambda packet: replace(packet, data=packet.data[:40]), ""),
        (lambda packet: replace(packet, data=b"\0\0\1\x06"), "gave 0 frames"),
    ],
    ids=["all key", "no start code", "cut", "no key frame"],
)
def test_an_encoder_that_opens_but_misbehaves_is_found_out(monkeypatch, change, reason):
    class Broken(VideoEncoder):
        def encode(self, image_bgr, *, force_key=False):
            return tuple(map(change, super().encode(image_bgr, force_key=force_key)))

    monkeypatch.setattr(probe, "VideoEncoder", Broken)
    verdict = probe.probe_encoder.__wrapped__("libx264")
    assert not verdict.works
    assert reason in verdict.reason


def test_wrong_pictures_are_found_out(monkeypatch):
    monkeypatch.setattr(probe.VideoDecoder, "bgr", lambda *_: probe._trial_images()[0] * 0)
    verdict = probe.probe_encoder.__wrapped__("libx264")
    assert "dB" in verdict.reason
    assert not verdict.works


@pytest.fixture
def working(monkeypatch):
    """Let only the named encoders work."""

    def only(*names):
        def verdict(name):
            return probe.CodecProbe(name=name, works=name in names, reason="no device")

        monkeypatch.setattr(probe, "probe_encoder", verdict)

    return only


@pytest.mark.parametrize("first", ["h264_nvmpi", "h264_qsv"])
def test_auto_takes_the_first_that_works(working, first):
    working(first, "libx264")
    assert probe.choose_encoder("auto") == first


def test_without_an_encoder_every_reason_is_named_and_the_software_decoder_taken_untried(working):
    working()
    with pytest.raises(
        CodecUnavailableError, match=r"h264_nvmpi: no device.*libopenh264: no device"
    ):
        probe.choose_encoder("auto")
    probe.probe_decoder.cache_clear()
    try:
        assert probe.choose_decoder() == "h264"
        assert "no software encoder" in probe.probe_decoder("h264_cuvid").reason
    finally:
        probe.probe_decoder.cache_clear()
