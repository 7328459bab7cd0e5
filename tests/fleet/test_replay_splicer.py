"""A stream is joined from its replay and then live, with packets in any order."""

from itertools import pairwise

import pytest
from foreign_video import CLOCKS
from hypothesis import given, settings
from hypothesis import strategies as st

from sfglab.fleet.decoder.splicer import MOST_AHEAD, Phase, Source, Splicer

LIVE, REPLAY = Source.LIVE, Source.REPLAY
GOP = 5


class Joining:
    """A splicer whose packets are their numbers; a key frame every `gop`."""

    def __init__(self, *, replay=True, after=-1, gop=GOP):
        self.splicer = Splicer(replay=replay, after=after)
        self.gop = gop
        self.decoded = []
        self.shown = []

    def take(self, source, *numbers, shown=True):
        for number in numbers:
            self.splicer.take(
                number, source, pts=number, is_key=number % self.gop == 0, shown=shown
            )
        return self

    def decode(self, most=10**6):
        while most and (step := self.splicer.next()) is not None:
            self.decoded.append(step.packet)
            self.shown += [step.packet] if step.show else []
            most -= 1
        return self

    def hear(self, arrivals):
        """Take numbers of the replay (r: not to be shown) or live; with + nothing is decoded in between.

        At an exclamation mark, the replay is given up.
        """
        for arrival in arrivals.split():
            source, *digits = arrival.lstrip("+")
            if source == "!":
                self.splicer.give_up()
            numbers = [int(digit, 36) for digit in digits]
            self.take(LIVE if source == "L" else REPLAY, *numbers, shown=source != "r")
            if not arrival.startswith("+"):
                self.decode()
        return self.decode()


@pytest.mark.parametrize(
    ("arrivals", "decoded", "shown", "phase"),
    [
        pytest.param(
            "R567 L8 R8 L9 LA", "56789A", "789A", "FOLLOWING", id="the replay, then the stream"
        ),
        pytest.param(
            "R56 R7 R8 L9 LA", "56789A", "69A", "FOLLOWING", id="another's replay is shown once"
        ),
        pytest.param(
            "L9 R56 R7 R8 LA", "56789A", "9A", "FOLLOWING", id="another's replay beside the stream"
        ),
        pytest.param("+R5678", "5678", "8", "JOINING", id="of a burst only the newest picture"),
        pytest.param("r5 r6 r7 R8", "5678", "8", "JOINING", id="a burst that trickles"),
        pytest.param("L78 r56", "5678", "8", "CONNECTED", id="live packets that came before wait"),
        pytest.param("R5678 L7 L89", "56789", "89", "FOLLOWING", id="one that lags catches up"),
        pytest.param("+R56 +L4", "56", "6", "JOINING", id="an older live packet connects nothing"),
        pytest.param("+L89A", "A", "A", "CONNECTED", id="a live key frame ends the waiting"),
        pytest.param("R56 RAB", "56AB", "6", "JOINING", id="a new group supersedes an old one"),
        pytest.param("+R89AB", "AB", "B", "JOINING", id="of which what is left is passed over"),
        pytest.param(
            "! +L89 +LAB", "AB", "B", "FOLLOWING", id="without a keeper a key frame begins"
        ),
        pytest.param("+R568 +L789", "56789", "9", "FOLLOWING", id="a gap is closed by the stream"),
        pytest.param("R568 L9 ! +LAB", "56AB", "6AB", "FOLLOWING", id="or not at all"),
        pytest.param(
            "+R5 +L689", "5689", "9", "FOLLOWING", id="a loss after the joining is the decoder's"
        ),
        pytest.param(
            "+RFGH +LH +L01", "FGH01", "1", "FOLLOWING", id="a sender that starts anew is followed"
        ),
        pytest.param(
            "R5566 R66 L7", "567", "67", "CONNECTED", id="what comes twice is decoded once"
        ),
    ],
)
def test_what_is_decoded_and_shown(arrivals, decoded, shown, phase):
    joining = Joining().hear(arrivals)
    assert [joining.decoded, joining.shown] == [
        [int(digit, 36) for digit in text] for text in (decoded, shown)
    ]
    assert joining.splicer.phase.name == phase


@pytest.mark.parametrize(
    ("after", "arrivals", "shown"),
    [
        pytest.param(99, "R56 R7 R8 L9 LA", [9, 10], id="another's replay"),
        pytest.param(99, "r567 R8 L8 L9", [9], id="its own"),
        pytest.param(99, "L8 r567 R8 L9", [8, 9], id="the stream first"),
        pytest.param(99, "R567 R89AB", [], id="nothing but a replay"),
        pytest.param(7, "R567 R89", [9], id="one that is newer than what was seen"),
    ],
)
def test_nothing_of_the_replay_is_shown_again_nor_from_before_what_was_seen(after, arrivals, shown):
    assert Joining(after=after).hear(arrivals).shown == shown


def test_without_a_replay_all_passes_and_what_waits_in_vain_for_one_is_bounded():
    joining = Joining(replay=False).hear("L3 L46")
    assert (joining.decoded, joining.shown) == ([3, 4, 6], [3, 4, 6])
    joining = Joining(gop=10**9).take(REPLAY, 0).take(LIVE, *range(2, MOST_AHEAD + 3))
    assert not joining.splicer.needs_replay
    assert joining.take(LIVE, MOST_AHEAD + 3).decode().decoded == [0]


@pytest.mark.parametrize("clock", CLOCKS)
@pytest.mark.parametrize("replayed", [0, 3])
def test_a_stream_without_numbers_is_joined_at_a_live_key_frame_and_then_shown_whole(
    clock, replayed
):
    splicer = Splicer(replay=True)
    decoded = []
    for number in range(3 - replayed, 40):
        source = REPLAY if number < 3 else LIVE
        is_key = number % 10 == 0
        splicer.take(number, source, pts=CLOCKS[clock](number), is_key=is_key, shown=source is LIVE)
        while source is LIVE and (step := splicer.next()) is not None:
            decoded.append(step.packet)
    assert splicer.done
    assert [number for number in decoded if number >= 3] == list(range(10, 40))


@st.composite
def arrivals(draw):
    """Packets of both sources as they might arrive: each source in its order, the two interleaved at will."""
    lossy = draw(st.booleans())
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
    patience = draw(st.integers(0, 60)) if lossy else None
    packets = [(s, *next(sources[s]), d) for s, d in zip(order, decodes, strict=True)]
    return gop, joined, patience, packets


@settings(max_examples=200)
@given(case=arrivals())
def test_in_any_order_the_stream_is_decoded_from_a_key_frame_on_and_under_loss_until_joined(case):
    (gop, joined, patience, packets), joining = case, Joining(gop=case[0])
    newest, early = max((n for s, n, *_ in packets if s is LIVE), default=0), False
    for position, (source, number, shown, decodes) in enumerate(packets):
        # Of the replay alone it might be the past that another asked for: the one that follows it is shown.
        early |= source is LIVE and number == newest and newest in joining.decoded
        if position == patience:
            joining.splicer.give_up()
        joining.take(source, number, shown=shown).decode(decodes)
        if joining.splicer.phase is not Phase.FOLLOWING:
            assert all(b == a + 1 or b % gop == 0 for a, b in pairwise(joining.decoded))
            assert joining.decoded == sorted(set(joining.decoded))
    decoded = joining.decode().decoded
    assert not decoded or decoded[0] % gop == 0
    if patience is None:
        assert not joining.splicer.needs_replay, "a live stream with a key frame always connects"
        breaks = [b for a, b in pairwise(decoded) if b != a + 1]
        assert all(b % gop == 0 and b > joined for b in breaks), "only a newer group is jumped to"
        assert (decoded, decoded[-1]) == (sorted(set(decoded)), newest)
        assert early or joining.shown[-1] == newest
        assert set(joining.shown) <= set(decoded)
