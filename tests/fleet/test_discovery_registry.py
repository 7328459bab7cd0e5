"""The registry of remote agents: meaning of heartbeats, deadlines, what is not believed, limits."""

import math
from dataclasses import replace
from types import SimpleNamespace

import pytest

from sfglab.fleet.discovery import validation
from sfglab.fleet.discovery.config import Timing
from sfglab.fleet.discovery.lifecycle import Action
from sfglab.fleet.discovery.published import PublishedDescriptions
from sfglab.fleet.discovery.registry import Registry
from sfglab.fleet.discovery.validation import Refusal
from sfglab.fleet.status.description import AgentDescription
from sfglab.fleet.status.heartbeat import Heartbeat
from sfglab.messages import serialize

S = 1_000_000_000
TIMING = Timing(
    missed=3, slack_ns=S // 2, backoff_ns=S // 4, backoff_max_ns=2 * S, forget_ns=100 * S
)
BEAT = Heartbeat(agent="go2", incarnation=7, revision=0, phase=0, period_s=1.0, version="1")
GID = b"g" * 16


class World:
    """A registry and its caller, who checks all orders; times in seconds."""

    def __init__(self, **limits):
        self.registry = Registry("station", timing=TIMING, **limits)
        self.asked, self.outstanding = [], {}  # all queries; agents by outstanding query
        self.events = {}  # last event by agent

    def hear(self, at_s, gid=GID, **fields):
        return self.call("heard", at_s, replace(BEAT, **fields), gid)

    def answer(self, at_s, number=0, **fields):
        ask = self.asked[-1 - number % len(self.asked)]
        metadata = SimpleNamespace(**{"agent": ask.agent, "incarnation": 7, "revision": 0} | fields)
        self.outstanding.pop(ask.query, None)
        return self.call("answered", at_s, ask.agent, ask.query, metadata)

    def fail(self, at_s, number=0):
        ask = self.asked[-1 - number % len(self.asked)]
        self.outstanding.pop(ask.query, None)
        return self.call("failed", at_s, ask.agent, ask.query)

    def call(self, method, at_s, *values):
        """Call the registry and return the names of the ordered actions."""
        orders = getattr(self.registry, method)(*values, now_ns=round(at_s * S))
        for order in orders:
            if order.action is Action.QUERY:
                assert order.agent not in self.outstanding.values()
                self.outstanding[order.query] = order.agent
                self.asked.append(order)
            elif order.action is Action.ABANDON:
                assert self.outstanding.pop(order.query) == order.agent
            else:
                before = self.events.get(order.agent)
                self.events[order.agent] = order
                present = before is not None and before.event != "LOST"
                if order.event != "RESTARTED":
                    assert present is (order.event in ("UPDATED", "LOST"))
                    assert order.event == "DISCOVERED" or order.incarnation == before.incarnation
        return [order.action.name for order in orders]

    @property
    def names(self):
        return list(self.registry.states)

    @property
    def deadline_s(self):
        return self.registry.deadline_ns / S


def discovered():
    """A world in which go2 is known since the beginning."""
    world = World()
    assert (world.hear(0), world.answer(0)) == (["QUERY"], ["DISCOVERED"])
    return world


def test_a_failed_query_is_repeated_with_doubling_waits_and_an_answer_starts_over():
    world, at_s, waits = World(), 0.0, []
    world.hear(0)
    for _ in range(6):
        world.hear(at_s)
        assert world.fail(at_s) == []
        waits.append(world.deadline_s - at_s)
        at_s = world.deadline_s
        assert world.call("due", at_s) == ["QUERY"]
    assert waits == [0.25, 0.5, 1, 2, 2, 2]
    assert world.asked[-1].failures == 6
    world.answer(at_s)
    world.hear(at_s, revision=1)
    world.fail(at_s)
    assert world.deadline_s - at_s == 0.25


def test_a_new_revision_or_incarnation_is_queried_and_an_older_one_once_the_newer_is_lost():
    world = discovered()
    assert (world.hear(1, revision=1), world.hear(1.5, revision=2)) == (["QUERY"], [])
    assert world.asked[-1].wanted == (7, 1)
    assert world.answer(2, revision=3) == ["UPDATED"]
    assert (world.hear(2, revision=2), world.hear(2, revision=3)) == ([], [])
    assert world.hear(3, incarnation=8) == ["QUERY"]
    assert world.hear(3.5, incarnation=9) == ["ABANDON", "QUERY"]
    assert (world.answer(4, 1, incarnation=8), world.registry.counts["ignored_answers"]) == ([], 1)
    assert world.answer(4, incarnation=9) == ["RESTARTED"]
    deadline_s = world.deadline_s
    assert (world.hear(5, incarnation=6), world.deadline_s) == ([], deadline_s)
    assert (world.registry.counts["dropped_stale"], world.call("due", 8)) == (1, ["LOST"])
    assert world.hear(9, incarnation=10) == ["QUERY"]
    assert (world.call("due", 20), world.hear(21, incarnation=9)) == (["ABANDON"], ["RETURNED"])
    world.call("due", 30)
    assert (world.hear(31, incarnation=6), world.answer(31, incarnation=6)) == (
        ["QUERY"],
        ["RESTARTED"],
    )


@pytest.mark.parametrize(
    "wrong", [{"incarnation": 6}, {"incarnation": 8}, {"agent": "other"}, {"revision": 0}], ids=str
)
def test_an_answer_to_something_else_than_was_asked_counts_as_none(wrong):
    world = World()
    world.hear(0, revision=1)
    assert world.answer(0.1, **{"revision": 1, **wrong}) == []
    counts = {"heard": 1, "asked": 1, "mismatched": 1, "failed": 1}
    assert world.registry.counts == counts


def test_a_pause_of_the_discoverer_is_no_silence_of_an_agent():
    world = discovered()  # silent at 3.5
    world.hear(0.5, agent="husky", gid=b"h" * 16)  # silent at 4
    world.registry.compensate_pause(1 * S, 60 * S)
    assert (world.call("due", 60), world.call("due", 62.5), world.deadline_s) == (
        [],
        ["LOST"],
        63.0,
    )
    world.hear(62.6, agent="husky", gid=b"h" * 16)
    world.registry.compensate_pause(62 * S, 63 * S)
    assert world.deadline_s == 66.5


@pytest.mark.parametrize(
    "fields",
    [
        *({"agent": name} for name in ("", "../x", "camera", "a" * 240)),
        *({"period_s": period_s} for period_s in (math.nan, 0.0, 1e9)),
        {"phase": 2},
        {"version": "v" * 129},
    ],
    ids=lambda fields: str(fields)[:30],
)
def test_a_malformed_heartbeat_is_dropped_and_counted(fields):
    world = World()
    assert (world.hear(0, **fields), world.names) == ([], [])
    assert world.registry.counts == {"dropped_malformed": 1}


def test_a_flood_is_cut_and_other_publishers_are_heard(monkeypatch):
    limits = {"BEATS_PER_S": 5, "BURST": 10, "TOTAL_PER_S": 100, "TOTAL_BURST": 50}
    for name, limit in limits.items():
        monkeypatch.setattr(validation, name, limit)
    world = World()
    for number in range(1000):
        world.hear(number / 1000, gid=b"flood")
    assert world.registry.counts["heard"] in (14, 15), "10 at once and 5 in the second"
    for number in range(500):
        world.hear(1.0, gid=number.to_bytes(16, "big"), agent=f"x{number}y")
    assert 50 <= len(world.names) <= 51
    assert world.registry.counts.total() - world.registry.counts["asked"] == 1500


def test_the_table_is_bounded_and_useless_agents_make_room():
    world = World(max_agents=3)
    for number, name in enumerate(("a1x", "b1x", "c1x")):
        world.hear(number / 10, agent=name)
        world.answer(number / 10)
    assert (world.hear(0.5, agent="d1x"), world.registry.counts["dropped_full"]) == ([], 1)
    assert (world.call("due", 3.5), world.hear(3.5, agent="d1x")) == (["LOST"], ["QUERY"])
    assert world.names == ["b1x", "c1x", "d1x"], "the lost one was replaced"
    world.fail(3.5)
    world.hear(3.5, agent="b1x"), world.hear(3.5, agent="c1x")
    assert world.hear(3.6, agent="e1x") == ["QUERY"]
    assert world.names == ["b1x", "c1x", "e1x"], "so was the one that never answered"


def test_a_published_description_counts_from_the_wanted_version_on_and_from_one_publisher_alone(
    monkeypatch,
):
    monkeypatch.setattr(validation, "BURST", 4)
    found = PublishedDescriptions(2)

    def receive(gid, incarnation, revision=0):
        version = {"incarnation": incarnation, "revision": revision}
        message = AgentDescription().to_message("go2", **version, stamp_ns=0)
        return found.receive(serialize(message), gid, now_ns=0)

    def version(wanted=(1, 0), there=b"abc"):
        metadata = found.find("go2", wanted, lambda gid: gid in there)
        return metadata and (metadata.incarnation, metadata.revision)

    assert receive(b"a", 1, 1) is None
    wanted = [(0, 9), (1, 1), (1, 2), (2, 0)]
    assert [version(each) for each in wanted] == [(1, 1), (1, 1), None, None]
    receive(b"b", 2)
    assert [version(there=there) for there in (b"ab", b"a", b"")] == [None, (1, 1), None]
    receive(b"c", 3)
    assert version(there=b"a") is None, "only two publishers are remembered"
    dropped = [found.receive(bytes(size), b"c", now_ns=0) for size in (3, 65_537, 65_537, 3)]
    assert dropped == [Refusal.MALFORMED] * 3 + [Refusal.FLOOD]
