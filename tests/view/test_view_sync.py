"""Synchronisation: what belongs together, once, in order, and within bounds."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from sfglab.errors import InvalidValueError
from sfglab.view import Approximate, Exact, Independent
from sfglab.view.sync import PATIENCE, Synchronizer

TOPICS = ("a", "b", "c")


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


def run(policy, items, topics=TOPICS):
    sync = Synchronizer(policy, topics)
    sets, waiting = [], []
    for number, (topic, stamp) in enumerate(items):
        sets += sync.offer(topic, stamp, number)
        waiting.append(sync.waiting)
    return sync, sets, waiting


@given(arrivals(), st.integers(0, 40), st.integers(1, 5))
def test_an_approximate_set_lies_within_the_slop_and_no_item_comes_out_twice(items, slop, depth):
    sync, sets, waiting = run(Approximate(slop_ns=slop, depth=depth), items)
    used = [number for s in sets for _, number in s.items.values()]
    assert len(used) == len(set(used))
    for s in sets:
        stamps = [stamp for stamp, _ in s.items.values()]
        assert set(s.items) == set(TOPICS)
        assert max(stamps) - min(stamps) <= slop
    assert max(waiting, default=0) <= depth * len(TOPICS)
    assert len(items) == len(used) + sync.unmatched + sync.waiting


@given(arrivals(("a", "b")), st.integers(0, 40))
def test_two_topics_pair_nearest_to_nearest_while_nothing_is_pushed_out(items, slop):
    """Of each pair one item is the pivot, and no item that was left of the other topic is nearer to it."""
    _, sets, _ = run(Approximate(slop_ns=slop, depth=1000), items, ("a", "b"))
    stamps = {topic: [s for t, s in items if t == topic] for topic in ("a", "b")}
    before = {"a": -1, "b": -1}
    for s in sets:
        a, b = s.items["a"][0], s.items["b"][0]
        left = {topic: [x for x in stamps[topic] if x > before[topic]] for topic in stamps}
        nearest = abs(a - b) <= min(abs(x - max(a, b)) for x in left["a" if a < b else "b"])
        pivoted = abs(a - b) <= min(abs(x - min(a, b)) for x in left["b" if a < b else "a"])
        assert nearest or pivoted
        before = {"a": a, "b": b}


@given(arrivals(), st.integers(1, 4))
def test_exact_time_is_bounded_and_accounts_for_every_item(items, depth):
    sync, sets, waiting = run(Exact(depth=depth), items)
    assert max(waiting, default=0) <= depth * len(TOPICS)
    assert len(items) == 3 * len(sets) + sync.unmatched + sync.waiting


def test_equal_stamps_come_out_at_once_and_a_nearer_partner_that_comes_later_is_waited_for():
    sync = Synchronizer(Approximate(slop_ns=10), ("depth", "info"))
    assert sync.offer("depth", 100, "d") == []
    (found,) = sync.offer("info", 100, "i")
    assert found.items == {"depth": (100, "d"), "info": (100, "i")}
    assert found.stamp_ns == 100
    sync = Synchronizer(Approximate(slop_ns=50), ("a", "b"))
    sync.offer("a", 0, "far")
    assert sync.offer("b", 40, "pivot") == []
    (found,) = sync.offer("a", 45, "near")
    assert found.items["a"] == (45, "near")
    assert sync.unmatched == 1


def test_a_full_queue_decides_and_a_stamp_that_does_not_rise_is_dropped():
    sync = Synchronizer(Approximate(slop_ns=50, depth=2), ("a", "b"))
    sync.offer("a", 0, "far")
    found = [s for stamp in (40, 80, 120) for s in sync.offer("b", stamp, stamp)]
    assert [s.items["b"][1] for s in found] == [40]
    sync = Synchronizer(Exact(), ("a", "b"))
    sync.offer("a", 5, "x")
    sync.offer("a", 5, "again")
    sync.offer("a", 3, "older")
    assert (sync.disordered, sync.waiting) == (2, 1)


@pytest.mark.parametrize("policy", [Independent(), Exact(), Approximate()])
def test_one_topic_alone_needs_no_partner(policy):
    sync = Synchronizer(policy, ("a",))
    sets = sync.offer("a", 1, "x") + sync.offer("a", 1, "y")
    assert [s.items for s in sets] == [{"a": (1, "x")}, {"a": (1, "y")}]


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
    shown = [tuple(item for _, item in matched.items.values()) for matched in found]
    expected = [
        (stamp, "once", stamp) for stamp in range(100 * (PATIENCE + 2), 2100, 100) if stamp != 1900
    ]
    assert shown == expected
    assert {matched.items["info"] for matched in found} == {(3, "once")}


def test_a_calibration_that_comes_with_every_picture_is_never_taken_for_another_s():
    sync = Synchronizer(Exact(), ("depth", "info"), steady=("info",))
    sync.offer("info", 1, "first")
    found = [m for stamp in range(2, 20) for m in sync.offer("depth", stamp, stamp)]
    assert [m.items["info"][1] for m in found] == ["first"] * (18 - PATIENCE)
    assert sync.offer("info", 30, "second") == []
    assert [m for stamp in range(31, 60) for m in sync.offer("depth", stamp, stamp)] == []
    sync.offer("info", 60, "third")
    (matched,) = sync.offer("depth", 60, 60)
    assert matched.items == {"depth": (60, 60), "info": (60, "third")}
    assert sync.waiting == 0
    assert sync.unmatched + 2 * 1 + (18 - PATIENCE) == 18 + 29 + 3 + 1


def test_a_depth_or_slop_that_makes_no_sense_is_refused():
    with pytest.raises(InvalidValueError, match="depth: given 0"):
        Exact(depth=0)
    with pytest.raises(InvalidValueError, match="slop_ns: given -1"):
        Approximate(slop_ns=-1)
