"""Joined anywhere in a group, pictures are those of a decoder that was there from the start, bit for bit."""

from types import SimpleNamespace

import numpy as np
import pytest

from sfglab.codecs import FFMPEG_PACKET, H264Encoder, H264Settings, ffmpeg_packet_fields, image_decoder
from sfglab.fleet.decoder.splicer import Source, Splicer
from sfglab.fleet.gop_cache import FLAG_DISCARD, FLAG_KEY, GopCache

GOP = 12
SETTINGS = H264Settings(width=320, height=192, fps=30, bitrate_bps=600_000, gop=GOP, encoder="libx264")


@pytest.fixture(scope="module")
def packets():
    encoder, rng = H264Encoder(SETTINGS), np.random.default_rng(0)
    still = rng.integers(0, 255, (24, 40, 3), np.uint8).repeat(8, 0).repeat(8, 1)
    frames = [frame for n in range(3 * GOP) for frame in encoder.encode(np.roll(still, 3 * n, axis=1))]
    return [ffmpeg_packet_fields(frame, SETTINGS) for frame in frames]


@pytest.fixture(scope="module")
def pictures(packets):
    decoder = image_decoder(FFMPEG_PACKET)
    return [decoder.feed(packet)[0].array for packet in packets]


def replay(packets, joined: int) -> list:
    """What a keeper sends to a reader that appears after `joined` packets."""
    cache: GopCache = GopCache()
    for packet in packets[:joined]:
        cache.add(packet, pts=packet.pts, is_key=bool(packet.flags & FLAG_KEY), size_bytes=len(packet.data))
    *old, newest = cache.packets
    return [
        SimpleNamespace(pts=p.pts, flags=p.flags | FLAG_DISCARD, encoding=p.encoding, data=p.data) for p in old
    ] + [newest]


@pytest.mark.parametrize("lag", [0, 2], ids=["live at once", "live later"])
def test_at_every_point_of_a_group_the_first_picture_and_all_after_it_are_exact(packets, pictures, lag):
    for joined in range(1, 2 * GOP):
        decoder, splicer = image_decoder(FFMPEG_PACKET), Splicer(replay=True)
        shown = {}
        arrivals = [(Source.REPLAY, p) for p in replay(packets, joined) + packets[joined : joined + lag]]
        arrivals += [(Source.LIVE, p) for p in packets[joined : joined + 5]]
        for source, packet in arrivals:
            is_key, wanted = bool(packet.flags & FLAG_KEY), not packet.flags & FLAG_DISCARD
            splicer.take(packet, source, pts=packet.pts, is_key=is_key, shown=wanted)
        while (step := splicer.next()) is not None:
            if step.show:
                shown[step.packet.pts] = decoder.feed(step.packet)[0]
            else:
                decoder.skip(step.packet)
        assert max(shown) == joined + 4
        for number, image in shown.items():
            assert image.intact
            assert np.array_equal(image.array, pictures[number])
