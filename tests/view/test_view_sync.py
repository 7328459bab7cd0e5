"""Synchronisation: what belongs together, once, in order, and within bounds."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from sfglab.errors import InvalidValueError
from sfglab.qos import Durability
from sfglab.view import Approximate, Exact
from sfglab.view.slot import Slot
from sfglab.view.sync import PATIENCE, Synchronizer
from sfglab.view.visualizers.clouds import DepthCloud

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
    before = {"a": -1, "b": -1}
    for matched in [found for item in items for found in sync.offer(*item, None)]:
        pair = {topic: stamp for topic, (stamp, _) in matched.items()}
        left = [(topic, stamp) for topic, stamp in items if stamp > before[topic]]
        assert any(
            all(abs(pair["a"] - pair["b"]) <= abs(s - pair[pivot]) for t, s in left if t != pivot)
            for pivot in pair
        )
        before = pair


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
def test_a_calibration_that_was_published_once_holds_until_a_second_one_comes(policy):
    """Live, a late joiner is sent it again, as it asks for the past."""
    kind = type("Cloud", (DepthCloud,), {"sync": policy})
    assert kind.inputs[1].qos.durability is Durability.TRANSIENT_LOCAL
    slot = Slot(kind({"depth": "/depth", "info": "/info", "color": "/color"}), None)

    def shown(stamp, *, late=0):
        slot.offer("color", stamp + late, stamp, now_ns=0)
        slot.offer("depth", stamp, stamp, now_ns=0)
        taken = slot.take()
        return taken and [*taken.items.values()]

    slot.offer("info", 3, "once", now_ns=0)
    found = [shown(stamp) for stamp in range(100, 1000, 100)]
    held = [[stamp, "once", stamp] for stamp in range(100 * (PATIENCE + 2), 1000, 100)]
    assert found == [None] * (PATIENCE + 1) + held
    assert shown(1000, late=50) is None  # pictures still match by their stamps
    slot.offer("info", 1100, "second", now_ns=0)
    assert shown(1100) == [1100, "second", 1100]
    assert shown(1200) is None
    assert (slot.waiting, slot.dropped) == (2, 1 + 2 * (PATIENCE + 1) + 2)


def test_a_depth_or_slop_that_makes_no_sense_is_refused():
    with pytest.raises(InvalidValueError, match="depth: given 0"):
        Exact(depth=0)
    with pytest.raises(InvalidValueError, match="slop_ns: given -1"):
        Approximate(slop_ns=-1)
