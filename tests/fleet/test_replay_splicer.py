"""Joining a stream under way: from its replay, then live, whatever comes in whatever order."""

from __future__ import annotations

from itertools import pairwise

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sfglab.fleet.decoder.splicer import MOST_AHEAD, Phase, Source, Splicer

LIVE, REPLAY = Source.LIVE, Source.REPLAY
GOP = 5


class Joining:
    """A splicer whose packets are their numbers; a key frame every `gop`."""

    def __init__(self, *, replay: bool = True, gop: int = GOP) -> None:
        self.splicer: Splicer[int] = Splicer(replay=replay)
        self.gop = gop
        self.decoded: list[int] = []
        self.shown: list[int] = []

    def take(self, source: Source, *numbers: int, shown: bool = True) -> Joining:
        for number in numbers:
            self.splicer.take(number, source, pts=number, is_key=number % self.gop == 0, shown=shown)
        return self

    def decode(self, most: int = 10**6) -> Joining:
        while most and (step := self.splicer.next()) is not None:
            self.decoded.append(step.packet)
            self.shown += [step.packet] if step.show else []
            most -= 1
        return self


def test_the_replay_and_then_the_live_stream_are_decoded_without_gap_or_repetition():
    joining = Joining().take(REPLAY, 5, 6, 7).decode()
    assert joining.splicer.needs_replay
    joining.take(LIVE, 8).decode()
    assert not joining.splicer.needs_replay
    joining.take(REPLAY, 8).take(LIVE, 9, 10).decode()
    assert joining.decoded == [5, 6, 7, 8, 9, 10]
    assert joining.shown == [7, 8, 9, 10]


def test_of_a_burst_only_the_newest_picture_is_shown():
    joining = Joining().take(REPLAY, 5, 6, 7, 8).decode()
    assert joining.shown == [8]


def test_a_burst_that_trickles_shows_nothing_before_its_newest_picture():
    joining = Joining()
    for number in (5, 6, 7):
        joining.take(REPLAY, number, shown=False).decode()
    assert joining.shown == []
    assert joining.take(REPLAY, 8).decode().shown == [8]


def test_live_packets_that_came_before_the_replay_wait_for_it():
    joining = Joining().take(LIVE, 7, 8).decode()
    assert joining.decoded == []
    joining.take(REPLAY, 5, 6, shown=False).decode()
    assert joining.decoded == [5, 6, 7, 8]
    assert joining.shown == [8]
    assert joining.splicer.phase is Phase.CONNECTED


def test_a_live_stream_that_lags_behind_the_replay_is_dropped_until_it_has_caught_up():
    joining = Joining().take(REPLAY, 5, 6, 7, 8).decode().take(LIVE, 7).decode()
    assert not joining.splicer.needs_replay
    joining.take(LIVE, 8, 9).decode()
    assert joining.decoded == [5, 6, 7, 8, 9]
    assert joining.splicer.phase is Phase.FOLLOWING


def test_a_live_packet_older_than_the_replay_connects_nothing():
    joining = Joining().take(REPLAY, 5, 6).take(LIVE, 4).decode()
    assert joining.splicer.needs_replay
    assert joining.decoded == [5, 6]


def test_the_last_picture_of_a_connected_chain_is_shown_whatever_the_replay_says_of_it():
    joining = Joining().take(REPLAY, 5, 6, 7, shown=False).take(LIVE, 7).decode()
    assert joining.shown == [7]


def test_a_live_key_frame_ends_the_waiting_at_once():
    joining = Joining().take(LIVE, 8, 9, 10).decode()
    assert joining.decoded == joining.shown == [10]
    assert not joining.splicer.needs_replay


def test_without_a_keeper_the_first_live_key_frame_is_where_it_begins():
    joining = Joining()
    joining.splicer.give_up()
    assert joining.take(LIVE, 8, 9).decode().decoded == []
    assert joining.take(LIVE, 10, 11).decode().decoded == [10, 11]


def test_a_new_group_in_the_replay_supersedes_what_was_not_decoded_yet():
    joining = Joining().take(REPLAY, 5, 6).decode(1).take(REPLAY, 10, 11).decode()
    assert joining.decoded == [5, 10, 11]


def test_what_is_left_of_an_older_group_in_the_replay_is_passed_over():
    joining = Joining().take(REPLAY, 8, 9, 10, 11).decode()
    assert joining.decoded == [10, 11]


def test_a_gap_in_the_replay_is_closed_by_the_live_stream_or_not_at_all():
    assert Joining().take(REPLAY, 5, 6, 8).take(LIVE, 7, 8, 9).decode().decoded == [5, 6, 7, 8, 9]
    stuck = Joining().take(REPLAY, 5, 6, 8).take(LIVE, 9).decode()
    assert stuck.splicer.needs_replay
    stuck.splicer.give_up()
    assert stuck.take(LIVE, 10, 11).decode().decoded == [5, 6, 10, 11], "no packet without its references"


def test_a_loss_after_the_joining_is_left_to_the_decoder():
    joining = Joining().take(REPLAY, 5).take(LIVE, 6, 8, 9).decode()
    assert joining.decoded == [5, 6, 8, 9]


def test_a_sender_that_starts_anew_is_followed():
    joining = Joining().take(REPLAY, 15, 16, 17).take(LIVE, 17).take(LIVE, 0, 1).decode()
    assert joining.decoded[-2:] == [0, 1]


def test_packets_that_wait_for_one_that_never_comes_are_bounded():
    joining = Joining(gop=10**9).take(REPLAY, 0).take(LIVE, *range(2, MOST_AHEAD + 3))
    assert not joining.splicer.needs_replay
    assert joining.take(LIVE, MOST_AHEAD + 3).decode().decoded == [0]


def test_without_a_replay_everything_passes_as_it_comes():
    joining = Joining(replay=False).take(LIVE, 3).decode().take(LIVE, 4, 6).decode()
    assert joining.decoded == [3, 4, 6]
    assert joining.shown[0] == 3


@st.composite
def arrivals(draw, *, lossy: bool):
    """Packets of both sources as they might arrive: each source in its order, the two interleaved at will."""
    gop = draw(st.integers(1, 9))
    joined = draw(st.integers(0, 30))
    last = joined + draw(st.integers(gop + 1, 40))
    live = list(range(joined, last))
    replay = [(n, n >= joined - 1) for n in range(joined - joined % gop, last)]
    if lossy:
        live = [n for n in live if draw(st.integers(0, 9))]
        replay = [p for p in replay if draw(st.integers(0, 9))]
    order = draw(st.permutations([LIVE] * len(live) + [REPLAY] * len(replay)))
    sources = {LIVE: iter((n, True) for n in live), REPLAY: iter(replay)}
    decodes = draw(st.lists(st.integers(0, 3), min_size=len(order), max_size=len(order)))
    return gop, joined, [(s, *next(sources[s]), d) for s, d in zip(order, decodes, strict=True)]


@settings(max_examples=300)
@given(case=arrivals(lossy=False))
def test_in_any_order_what_is_decoded_is_the_stream_itself_from_a_key_frame_on(case):
    gop, joined, packets = case
    joining = Joining(gop=gop)
    for source, number, shown, decodes in packets:
        joining.take(source, number, shown=shown).decode(decodes)
    joining.decode()
    decoded, newest = joining.decoded, max(n for s, n, *_ in packets if s is LIVE)
    assert not joining.splicer.needs_replay, "a live stream with a key frame always connects"
    breaks = [b for a, b in pairwise(decoded) if b != a + 1]
    assert decoded[0] % gop == 0
    assert all(b % gop == 0 and b > joined for b in breaks), "only a newer key frame may be jumped to"
    assert decoded == sorted(set(decoded))
    assert decoded[-1] == newest
    assert joining.shown[-1] == newest
    assert set(joining.shown) <= set(decoded)


@settings(max_examples=300)
@given(case=arrivals(lossy=True), patience=st.integers(0, 60))
def test_under_any_loss_nothing_is_decoded_without_what_it_refers_to_until_the_stream_is_joined(case, patience):
    gop, _, packets = case
    joining = Joining(gop=gop)
    for position, (source, number, shown, decodes) in enumerate(packets):
        if position == patience:
            joining.splicer.give_up()
        joining.take(source, number, shown=shown).decode(decodes)
        if joining.splicer.phase is not Phase.FOLLOWING:
            assert all(b == a + 1 or b % gop == 0 for a, b in pairwise(joining.decoded))
            assert joining.decoded == sorted(set(joining.decoded))
    joining.decode()
    assert not joining.decoded or joining.decoded[0] % gop == 0


@pytest.mark.parametrize("source", list(Source))
def test_a_packet_that_comes_twice_is_decoded_once(source):
    joining = Joining().take(REPLAY, 5, 5, 6, 6).take(source, 6, 6).take(LIVE, 7).decode()
    assert joining.decoded == [5, 6, 7]
