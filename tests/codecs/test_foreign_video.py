"""Streams of drivers that do not number their packets, have B frames, lengths, or no key frame."""

import numpy as np
import pytest
from foreign_video import CLOCKS, COUNT, avcc, clocked, ffmpeg_packet, packets

from sfglab.codecs import (
    COMPRESSED_VIDEO,
    FFMPEG_PACKET,
    BitstreamError,
    H264Decoder,
    image_decoder,
)
from sfglab.messages.packets import PacketOrder


@pytest.mark.parametrize("clock", CLOCKS)
def test_packets_with_a_time_instead_of_a_number_decode_to_intact_images(clock):
    decoder = image_decoder(FFMPEG_PACKET)
    images = [image for message in clocked(clock) for image in decoder.feed(message)]
    assert len(images) == COUNT
    assert [image.is_key for image in images] == [True, False, False, False, False] * 2
    assert all(image.intact for image in images)


def test_milliseconds_are_taken_for_losses_until_the_next_key_frame_only():
    decoder = image_decoder(FFMPEG_PACKET)
    images = []
    for number, packet in enumerate(packets()):
        images += decoder.feed(ffmpeg_packet(packet, pts=33 * number + number % 2))
    assert [image.intact for image in images] == [True] + [False] * 4 + [True] * 5


@pytest.mark.parametrize("steps", [[9, 9, 1, 2], [1, 40, 40, 2], [30, 1, 30, 2]])
def test_losses_of_numbered_packets_stay_losses(steps):
    order = PacketOrder()
    order.missing(100)
    numbers = np.cumsum(steps) + 100
    assert [order.missing(int(number)) for number in numbers] == [step > 1 for step in steps]
    assert not order.is_time


@pytest.mark.parametrize("b_frames", [1, 2])
def test_b_frames_are_refused_by_name_and_a_stream_without_them_follows(b_frames):
    decoder = image_decoder(FFMPEG_PACKET)
    made = packets(12, b_frames=b_frames)
    assert [packet.pts for packet in made] != sorted(packet.pts for packet in made)
    with pytest.raises(BitstreamError, match="B frames, which are not supported"):
        decoder.feed(ffmpeg_packet(made[0]))
    assert [decoder.feed(ffmpeg_packet(packet)) for packet in made[1:]] == [()] * 11
    images = [decoder.feed(ffmpeg_packet(packet)) for packet in packets()]
    assert [len(found) for found in images] == [1] * COUNT


def test_lengths_instead_of_start_codes_are_refused_by_name():
    decoder = image_decoder(COMPRESSED_VIDEO)
    for packet in packets():
        with pytest.raises(BitstreamError, match="AVCC is not supported"):
            decoder.feed(avcc(packet))


def test_a_stream_without_key_frames_gives_an_error_now_and_then():
    decoder = H264Decoder()
    data = packets()[1].data
    errors = []
    for _ in range(900):
        try:
            assert decoder.decode(data) == ()
        except BitstreamError as error:
            errors.append(str(error))
    assert len(errors) == 3
    assert "300 packets were skipped before a key frame" in errors[0]
    assert decoder.refused_packets == 900


def test_frames_come_back_as_libavcodec_gives_them():
    decoder = image_decoder(FFMPEG_PACKET)
    shown = [image.array for packet in packets() for image in decoder.feed(ffmpeg_packet(packet))]
    for number, array in enumerate(shown):
        bright = np.flatnonzero(array[16, :, 0] > 128)
        assert abs(bright[0] - 4 * number) <= 2
