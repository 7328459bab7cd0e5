"""Synchronisation: what belongs together, once, in order, and within bounds."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from sfglab.errors import InvalidValueError
from sfglab.view import Approximate, Exact
from sfglab.view.sync import PATIENCE, Synchronizer

TOPICS = ("a", "b", "c")
POLICIES = st.one_of(
    st.builds(Exact, depth=st.integers(1, 4)),
    st.builds(Approximate, slop_ns=st.integers(0, 40), depth=st.integers(1, 5)),
)


def arrivals(topics=TOPICS):
    """Items of several topics whose stamps rise within each, in any interleaving."""
    steps = st.lists(st.tuples(st.sampled_from(topics), st.integers(1, 30)), max_size=40)

    def stamped(pairs):
        now = dict.fromkeys(topics, 0)
        found = []
        for topic, step in pairs:
            now[topic] += step
            found.append((topic, now[topic]))
        return found

    return steps.map(stamped)


@given(arrivals(), POLICIES)
def test_a_set_lies_within_the_slop_and_every_item_is_accounted_for_once(items, policy):
    sync = Synchronizer(policy, TOPICS)
    used = []
    for number, (topic, stamp) in enumerate(items):
        for matched in sync.offer(topic, stamp, number):
            stamps = [stamp for stamp, _ in matched.values()]
            assert tuple(matched) == TOPICS
            assert max(stamps) - min(stamps) <= policy.slop_ns
            used += [item for _, item in matched.values()]
        assert sync.waiting <= policy.depth * len(TOPICS)
    assert len(used) == len(set(used))
    assert len(items) == len(used) + sync.unmatched + sync.waiting


@given(arrivals(("a", "b")), st.integers(0, 40))
def test_two_topics_pair_nearest_to_nearest_while_nothing_is_pushed_out(items, slop):
    """Of each pair one item is the pivot, and no item that was left of the other topic is nearer to it."""
    sync = Synchronizer(Approximate(slop_ns=slop, depth=1000), ("a", "b"))
    stamps = {topic: [s for t, s in items if t == topic] for topic in ("a", "b")}
    before = {"a": -1, "b": -1}
    for matched in [found for item in items for found in sync.offer(*item, None)]:
        a, b = matched["a"][0], matched["b"][0]
        left = {topic: [x for x in stamps[topic] if x > before[topic]] for topic in stamps}
        nearest = abs(a - b) <= min(abs(x - max(a, b)) for x in left["a" if a < b else "b"])
        pivoted = abs(a - b) <= min(abs(x - min(a, b)) for x in left["b" if a < b else "a"])
        assert nearest or pivoted
        before = {"a": a, "b": b}


@pytest.mark.parametrize(
    ("policy", "items", "found"),
    [
        (Approximate(slop_ns=10), "a100 b100", ["a100 b100"]),  # equal stamps: at once
        (Approximate(slop_ns=50), "a0 b40", []),  # a nearer one may come
        (Approximate(slop_ns=50), "a0 b40 a45", ["a45 b40"]),
        (Approximate(slop_ns=50, depth=2), "a0 b40 b80 b120", ["a0 b40"]),  # a full queue decides
        (Exact(), "a5 a5 a3 b3 b5", ["a5 b5"]),  # stamps that do not rise are dropped
        # The nearest to the pivot, b100, lie too far apart: the last ones not after it.
        (Approximate(slop_ns=10), "a95 c92 b100 a104 c112", ["a95 b100 c92"]),
    ],
)
def test_a_set_is_complete_when_no_better_one_can_come(policy, items, found):
    sync = Synchronizer(policy, ("a", "b", "c") if "c" in items else ("a", "b"))
    sets = []
    for item in items.split():
        sets += sync.offer(item[0], int(item[1:]), item)
    assert [" ".join(item for _, item in matched.values()) for matched in sets] == found


@pytest.mark.parametrize("policy", [Exact(), Approximate(slop_ns=10)])
def test_a_calibration_that_was_published_once_holds_and_pictures_still_match_by_their_stamps(
    policy,
):
    sync = Synchronizer(policy, ("depth", "info", "color"), steady=("info",))
    sync.offer("info", 3, "once")
    found = []
    for stamp in range(100, 2100, 100):
        found += sync.offer("color", stamp + 50 * (stamp == 1900), stamp)
        found += sync.offer("depth", stamp, stamp)
    shown = [tuple(item for _, item in matched.values()) for matched in found]
    stamps = [stamp for stamp in range(100 * (PATIENCE + 2), 2100, 100) if stamp != 1900]
    assert shown == [(stamp, "once", stamp) for stamp in stamps]


def test_a_calibration_that_comes_with_every_picture_is_never_taken_for_another_s():
    sync = Synchronizer(Exact(), ("depth", "info"), steady=("info",))
    sync.offer("info", 1, "first")
    found = [m for stamp in range(2, 20) for m in sync.offer("depth", stamp, stamp)]
    assert [m["info"][1] for m in found] == ["first"] * (18 - PATIENCE)
    assert sync.offer("info", 30, "second") == []
    assert [m for stamp in range(31, 60) for m in sync.offer("depth", stamp, stamp)] == []
    sync.offer("info", 60, "third")
    assert sync.offer("depth", 60, 60) == [{"depth": (60, 60), "info": (60, "third")}]
    assert sync.waiting == 0
    assert sync.unmatched + 2 + (18 - PATIENCE) == 18 + 29 + 3 + 1


def test_a_depth_or_slop_that_makes_no_sense_is_refused():
    with pytest.raises(InvalidValueError, match="depth: given 0"):
        Exact(depth=0)
    with pytest.raises(InvalidValueError, match="slop_ns: given -1"):
        Approximate(slop_ns=-1)
