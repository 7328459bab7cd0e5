"""The rules of the wireless channel, each by itself."""

import math
from itertools import accumulate

import numpy as np
import pytest

from sfglab.errors import InvalidValueError
from sfglab.rtps import Frame, Medium
from sfglab.rtps.channel import (
    BLOCK,
    DISPLACES,
    HEAD,
    JOINS,
    REFUSED,
    TAIL,
    admission,
    after_stall_ns,
    airtime_ns,
    is_blocked,
    is_lost,
    next_sender,
)
from sfglab.rtps.frames import fragments, frame_bytes


def test_a_frame_takes_its_bits_and_the_overhead_and_more_with_others():
    assert airtime_ns(1000, 1, 300_000, 8e6, 0.15) == 1_300_000
    assert airtime_ns(1000, 3, 300_000, 8e6, 0.15) == 1_690_000


def test_hosts_take_turns_or_chance_passes_some_over():
    waiting = [1, 0, 2, 1]
    assert [next_sender(waiting, turn, 0)[0] for turn in range(5)] == [0, 2, 2, 3, 0]
    assert [next_sender(waiting, 1, passed) for passed in range(3)] == [(2, 3), (3, 3), (0, 3)]
    assert next_sender([0, 0], 1, 0) == (-1, 0)


def test_a_full_queue_drops_its_oldest_frame_or_the_one_that_comes():
    for rule, full in ((TAIL, REFUSED), (HEAD, DISPLACES), (BLOCK, REFUSED)):
        assert [admission(rule, waiting, 5) for waiting in (4, 5)] == [JOINS, full]


def test_a_queue_that_blocks_lets_go_once_half_has_left():
    waiting = [9, 10, 9, 6, 5, 9]
    seen = accumulate(
        waiting, lambda blocked, frames: is_blocked(blocked, frames, 10), initial=False
    )
    assert [*seen][1:] == [False, True, True, True, False, False]


def test_nothing_begins_while_the_medium_stalls():
    times = [0, 19, 20, 99, 100, 105]
    assert [after_stall_ns(now, 100, 20) for now in times] == [20, 20, 20, 99, 120, 120]
    assert after_stall_ns(5, 0, 0) == 5


@pytest.mark.parametrize("burst", [0.0, 5.0])
def test_losses_come_in_bursts_of_their_mean_length(burst):
    lost, bursts, before = 0, 0, False
    for draw in np.random.default_rng(3).random(200_000).tolist():
        now = is_lost(before, draw, 0.05, burst)
        lost += now
        bursts += now and not before
        before = now
    assert lost / 200_000 == pytest.approx(0.05, rel=0.1)
    assert lost / bursts == pytest.approx(max(burst, 1.0), rel=0.1)


def test_sizes_of_frames_are_those_of_rtps():
    """Ethernet 14, IPv4 20, UDP 8, RTPS 20; a sample 12 + 24 and 24; a message that IP fragments is whole."""
    kinds = (Frame.HEARTBEAT, Frame.ACKNACK, Frame.GAP)
    assert [frame_bytes(kind, 24, 0, 1) for kind in kinds] == [110, 138, 110]
    assert [frame_bytes(Frame.DATA, 21, 1, rides) for rides in (0, 1)] == [122, 154]
    whole = frame_bytes(Frame.BURST, 24, 24, 0) + frame_bytes(Frame.FRAGMENT, 24, 0, 0)
    assert whole == 78 + 24 * 60 + 34
    assert [fragments(24, samples, 0) for samples in (1, 23, 24, 256)] == [0, 0, 1, 10]


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"rate_bps": math.nan}, "rate_bps: given nan"),
        ({"queue_rule": "middle"}, "queue_rule: given 'middle', allowed: tail, head, block"),
        ({"access_point": True, "shared": False}, "access_point"),
        ({"stall_s": 0.2, "stall_every_s": 0.1}, "stall_s < stall_every_s"),
        ({"loss": 0.6, "burst_frames": 1.0}, "loss <= burst_frames"),
    ],
)
def test_a_bad_medium_is_refused_with_the_place(values, message):
    with pytest.raises(InvalidValueError, match=message):
        Medium(**values)
