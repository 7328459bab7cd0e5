"""Offered descriptions: one speaker is believed, of what was asked for; others are not, and all are bounded."""

from types import SimpleNamespace

from sfglab.fleet.discovery.offers import Offers
from sfglab.fleet.discovery.screening import Limits, Refusal

A, B, C = b"a", b"b", b"c"


def said(agent, incarnation=1, revision=0):
    return SimpleNamespace(agent=agent, incarnation=incarnation, revision=revision)


def of(offers, wanted=(1, 0), there=(A, B, C)):
    return offers.of("go2", wanted, lambda publisher: publisher in there)


def test_the_only_speaker_is_believed_from_the_wanted_revision_on():
    offers = Offers(Limits())
    assert of(offers) is None
    offers.take(said("other"), B)
    for revision in (0, 1):
        offers.take(said("go2", revision=revision), A)
    assert [of(offers, wanted) is not None for wanted in ((0, 9), (1, 0), (1, 1), (1, 2), (2, 0))] == [
        1,
        1,
        1,
        0,
        0,
    ]


def test_of_two_speakers_neither_is_believed_until_one_has_gone():
    offers = Offers(Limits())
    offers.take(said("go2", 2), A)
    offers.take(said("go2"), B)
    assert of(offers) is None
    assert of(offers, there=(B,)).incarnation == 1
    assert of(offers, there=()) is None


def test_floods_large_ones_and_many_speakers_are_bounded():
    offers = Offers(Limits(max_agents=2, burst=3, beats_per_s=1, max_metadata_bytes=100))
    given = [offers.heard(size, A, now_ns=0) for size in (100, 101, 1, 1)]
    assert given == [None, Refusal.MALFORMED, None, Refusal.FLOOD]
    assert offers.heard(1, A, now_ns=10**9) is None
    for publisher in (A, B, C):
        offers.take(said("go2", revision=ord(publisher)), publisher)
    assert of(offers, there=(A,)) is None, "the first one was forgotten"
    assert of(offers, there=(C,)).revision == ord(C)
