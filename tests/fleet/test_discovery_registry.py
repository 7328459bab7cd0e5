"""The registry of remote agents: what a heartbeat means, what time brings, what is not believed, its bounds."""

import math
from dataclasses import replace
from functools import partial
from types import SimpleNamespace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sfglab.errors import InvalidValueError
from sfglab.fleet.discovery.lifecycle import ANNOUNCEMENTS, Action, State
from sfglab.fleet.discovery.node import DiscoverySettings, History
from sfglab.fleet.discovery.offers import Offers
from sfglab.fleet.discovery.registry import Order, Registry, Timing
from sfglab.fleet.discovery.screening import Limits, Refusal
from sfglab.fleet.status.heartbeat import Heartbeat

S = 1_000_000_000
TIMING = Timing(
    missed=3, slack_ns=S // 2, backoff_ns=S // 4, backoff_max_ns=2 * S, forget_ns=100 * S
)
BEAT = Heartbeat(agent="go2", incarnation=7, revision=0, phase=0, period_s=1.0, version="1")
GID = b"g" * 16


class World:
    """A registry, and a short way to talk to it; times in seconds."""

    def __init__(self, **limits) -> None:
        self.moves = []
        self.registry = Registry(
            "station", timing=TIMING, limits=Limits(**limits), on_move=self.moves.append
        )

    def hear(self, at_s=0.0, gid=GID, **fields):
        return self.registry.heard(replace(BEAT, **fields), gid, now_ns=round(at_s * S))

    def answer(self, ask: Order, at_s=0.0, **fields):
        values = {
            "agent": ask.agent,
            "incarnation": 7,
            "revision": 0,
            "says": "what it is",
        } | fields
        metadata = SimpleNamespace(**values)
        return self.registry.answered(ask.agent, ask.query, metadata, now_ns=round(at_s * S))

    def fail(self, ask: Order, at_s=0.0):
        return self.registry.failed(ask.agent, ask.query, now_ns=round(at_s * S))

    def due(self, at_s):
        return self.registry.due(round(at_s * S))

    def discover(self, at_s=0.0, **fields):
        (ask,) = self.hear(at_s, **fields)
        (news,) = self.answer(ask, at_s)
        assert news.event == "DISCOVERED"

    @property
    def state(self) -> State:
        return self.registry.agents()[0].state

    @property
    def deadline_s(self) -> float | None:
        deadline_ns = self.registry.deadline_ns
        return None if deadline_ns is None else deadline_ns / S


def discovered():
    """A world in which go2 is known since the beginning."""
    world = World()
    world.discover()
    return world


def events(orders):
    return [order.event for order in orders if order.action in ANNOUNCEMENTS]


def test_the_first_heartbeat_asks_the_answer_is_announced_and_silence_is_of_the_announced_period():
    world = World()
    (ask,) = world.hear()
    assert world.hear(0.5) == []
    (news,) = world.answer(ask, 0.6)
    told = (news.agent, news.event, news.incarnation, news.metadata.says)
    assert told == ("go2", "DISCOVERED", 7, "what it is")
    assert world.deadline_s == 4.0, (
        "three periods of 1 s and the slack after the heartbeat at 0.5 s"
    )
    world = discovered()
    world.hear(1.0, period_s=5.0, phase=1)
    assert world.deadline_s == 16.5
    assert world.due(16.4) == []
    assert events(world.due(16.5)) == ["LOST"]
    assert world.deadline_s == 116.5, "then it is remembered for a while"
    assert world.due(116.5) == []
    assert world.registry.agents() == ()


def test_a_lost_agent_that_beats_again_returns_and_another_start_is_restarted():
    world = discovered()
    world.due(10)
    (news,) = world.hear(11)
    assert (news.event, news.metadata.says, world.state) == ("RETURNED", "what it is", State.ACTIVE)
    world = discovered()
    (ask,) = world.hear(1, incarnation=8)
    (news,) = world.answer(ask, 2, incarnation=8, says="new")
    assert (news.event, news.incarnation, news.metadata.says) == ("RESTARTED", 8, "new")


def test_a_failed_query_is_repeated_with_doubling_waits_up_to_the_limit_and_one_success_starts_over():
    world = World()
    (ask,) = world.hear()
    at_s, waits = 0.0, []
    for _ in range(6):
        world.hear(at_s)
        assert world.fail(ask, at_s) == []
        waits.append(world.deadline_s - at_s)
        at_s = world.deadline_s
        (ask,) = world.due(at_s)
    assert waits == [0.25, 0.5, 1, 2, 2, 2]
    assert world.registry.agents()[0].failures == 6
    world.answer(ask, at_s)
    (ask,) = world.hear(at_s, revision=1)
    world.fail(ask, at_s)
    assert world.deadline_s - at_s == 0.25


def test_another_revision_is_asked_for_and_another_start_gives_up_the_query_before():
    world = discovered()
    (ask,) = world.hear(1, revision=1)
    assert world.hear(1.5, revision=2) == []
    assert events(world.answer(ask, 2, revision=3)) == ["UPDATED"]
    assert world.hear(2.5, revision=2) == []
    assert world.hear(2.5, revision=3) == []
    assert world.state is State.ACTIVE
    world = World()
    (first,) = world.hear()
    abandoned, second = world.hear(0.1, incarnation=8)
    assert abandoned == Order(action=Action.ABANDON, agent="go2", query=first.query)
    assert world.answer(first, 0.2) == []
    assert world.registry.counts["ignored_answers"] == 1
    assert events(world.answer(second, 0.3, incarnation=8)) == ["DISCOVERED"]


@pytest.mark.parametrize(
    "fields", [{"incarnation": 6}, {"incarnation": 8}, {"agent": "other"}, {"revision": 0}], ids=str
)
def test_an_answer_to_something_else_than_was_asked_counts_as_none(fields):
    world = World()
    (ask,) = world.hear(revision=1)
    assert world.answer(ask, 0.1, **{"revision": 1, **fields}) == []
    assert world.state is State.BACKING_OFF
    assert (world.registry.counts["mismatched"], world.registry.counts["failed"]) == (1, 1)


def test_an_older_start_is_stale_until_the_newer_is_lost_and_what_a_lost_one_said_does_not_count():
    world = discovered()
    assert world.hear(1, incarnation=6) == []
    assert world.registry.counts["dropped_stale"] == 1
    assert world.deadline_s == 3.5, "it is no sign of life either"
    world.due(4)
    (ask,) = world.hear(5, incarnation=6)
    assert events(world.answer(ask, 5, incarnation=6)) == ["RESTARTED"]
    world = discovered()
    world.due(10)
    world.hear(11, incarnation=8)
    (abandoned,) = world.due(20)
    assert abandoned.action is Action.ABANDON
    (news,) = world.hear(21, incarnation=7)
    assert news.event == "RETURNED"


def test_time_that_the_discoverer_itself_stood_still_is_nobody_elses_silence():
    world = World()
    world.discover()  # silent at 3.5
    world.hear(0.5, agent="husky", gid=b"h" * 16)  # silent at 4
    world.registry.overslept(1 * S, 60 * S)
    assert world.due(60) == []
    assert events(world.due(62.5)) == ["LOST"]
    assert world.deadline_s == 63.0
    world.hear(62.6)
    world.registry.overslept(62 * S, 63 * S)
    assert world.registry.agents()[0].heard_ns == 62.6 * S


@pytest.mark.parametrize(
    "fields",
    [
        *(
            {"agent": name}
            for name in ("", "Go 2", "../x", "camera", "torq", "a" * 240, "\N{GRINNING FACE}")
        ),
        {"phase": 2},
        *({"period_s": period_s} for period_s in (math.nan, math.inf, 0.0, -1.0, 1e9)),
        {"version": "v" * 129},
    ],
    ids=lambda f: str(f)[:40],
)
def test_a_heartbeat_that_cannot_be_one_is_dropped_and_counted(fields):
    world = World()
    assert world.hear(**fields) == []
    assert world.registry.counts == {"dropped_malformed": 1}
    assert world.registry.agents() == ()


def test_own_heartbeats_are_ignored_and_another_publisher_of_the_own_name_is_a_spoof():
    world = World()
    for at_s, gid, incarnation in (
        (0, b"own", 5),
        (1, b"own", 5),
        (1, b"spoof", 5),
        (2, b"spoof", 4),
    ):
        assert world.hear(at_s, gid=gid, agent="station", incarnation=incarnation) == []
    assert world.registry.counts == {"dropped_own": 2, "dropped_spoofed": 2}
    world.hear(3, gid=b"own restarted", agent="station", incarnation=6)
    assert world.registry.counts["dropped_own"] == 3
    assert world.registry.agents() == ()


def test_a_flood_is_cut_whether_of_one_publisher_or_many_and_the_others_are_heard():
    world = World(beats_per_s=5, burst=10, total_per_s=100, total_burst=100)
    for n in range(1000):
        world.hear(n / 1000, gid=b"flooder", agent="flooder")
    assert world.registry.counts["heard"] in (14, 15), "10 at once and 5 in the second"
    world.discover(1.0)
    counts = world.registry.counts
    assert counts["heard"] + counts["dropped_flood"] == 1001
    world = World(total_per_s=100, total_burst=50)
    for n in range(500):
        world.hear(0.0, gid=n.to_bytes(16, "big"), agent=f"x{n}y")
    assert len(world.registry.agents()) == 50
    assert world.registry.counts["dropped_flood"] == 450


def test_the_table_is_bounded_and_those_that_are_no_use_make_room():
    world = World(max_agents=3)
    for n, name in enumerate("abc"):
        (ask,) = world.hear(n / 10, agent=f"{name}1x")
        world.answer(ask, n / 10)
    assert world.hear(0.5, agent="d1x") == []
    assert world.registry.counts["dropped_full"] == 1
    world.due(3.5)
    (ask,) = world.hear(3.5, agent="d1x")
    assert [a.agent for a in world.registry.agents()] == ["b1x", "c1x", "d1x"], (
        "the lost one gave way"
    )
    world.fail(ask, 3.5)
    world.hear(3.5, agent="b1x"), world.hear(3.5, agent="c1x")
    world.hear(3.6, agent="e1x")
    assert [a.agent for a in world.registry.agents()] == ["b1x", "c1x", "e1x"], (
        "one that never answered too"
    )
    assert world.registry.counts["evicted"] == 2


STATION = partial(DiscoverySettings, agent="station")


@pytest.mark.parametrize(
    ("make", "values"),
    [
        *((Limits, {"max_agents": count}) for count in (0, 901)),
        (Limits, {"burst": 0}),
        (Limits, {"beats_per_s": math.nan}),
        (Timing, {"backoff_ns": 0}),
        (STATION, {"query_timeout_s": 0}),
        (STATION, {"max_queries": 0}),
        (STATION, {"find_timeout_s": 61}),
    ],
)
def test_bounds_and_waits_that_make_no_sense_are_refused(make, values):
    with pytest.raises(InvalidValueError, match=f"{next(iter(values))}: given .*, allowed: "):
        make(**values)


AGENTS = st.sampled_from(["go2", "husky", "drone", "arm_robot", "station", "camera", ""])
BEATS = st.builds(
    Heartbeat,
    agent=AGENTS,
    incarnation=st.integers(1, 3),
    revision=st.integers(0, 2),
    phase=st.integers(0, 2),
    period_s=st.sampled_from([0.1, 1.0, 5.0, math.nan, -1.0]),
    version=st.just("1"),
)
STEPS = st.one_of(
    st.tuples(st.just("hear"), BEATS, st.binary(min_size=1, max_size=1)),
    st.tuples(st.just("answer"), st.integers(0, 9), st.integers(1, 3), st.integers(0, 2)),
    st.tuples(st.just("fail"), st.integers(0, 9)),
    st.tuples(st.just("sleep"), st.sampled_from([10**6, 10**8, S, 7 * S, 200 * S])),
    st.tuples(st.just("late"), st.sampled_from([10**8, 60 * S])),
)


class Checker:
    """Carries orders out as the node does, and checks what local consumers and agents see of it."""

    def __init__(self) -> None:
        self.registry = Registry("station", timing=TIMING, limits=Limits(max_agents=3))
        self.now_ns = 0
        self.outstanding: dict[str, int] = {}
        self.asked: list[Order] = []
        self.told: dict[str, str] = {}
        self.incarnations: dict[str, int] = {}

    def take(self, orders) -> None:
        for order in orders:
            if order.action is Action.QUERY:
                assert order.agent not in self.outstanding, "two queries outstanding"
                self.outstanding[order.agent] = order.query
                self.asked.append(order)
            elif order.action is Action.ABANDON:
                assert self.outstanding.pop(order.agent) == order.query
            else:
                self.announce(order)

    def announce(self, news: Order) -> None:
        before, known = self.told.get(news.agent), self.incarnations.get(news.agent)
        present = before not in (None, "LOST")
        if news.event == "DISCOVERED":
            assert not present
        else:
            assert before is not None, f"{news.event} before anything"
            assert present == (news.event in ("UPDATED", "LOST")) or news.event == "RESTARTED"
            assert (news.incarnation == known) == (news.event != "RESTARTED")
        self.told[news.agent] = news.event
        self.incarnations[news.agent] = news.incarnation

    def step(self, step) -> None:
        kind, *rest = step
        if kind == "hear":
            self.take(self.registry.heard(rest[0], rest[1], now_ns=self.now_ns))
        elif kind == "sleep":
            self.now_ns += rest[0]
            self.take(self.registry.due(self.now_ns))
        elif kind == "late":
            self.registry.overslept(self.now_ns, self.now_ns + rest[0])
            self.now_ns += rest[0]
        elif self.asked:
            ask = self.asked[-1 - rest[0] % len(self.asked)]
            if self.outstanding.get(ask.agent) == ask.query:
                del self.outstanding[ask.agent]
            self.take(self.end(ask, kind, *rest[1:]))

    def end(self, ask: Order, kind: str, incarnation: int = 0, revision: int = 0):
        if kind == "fail":
            return self.registry.failed(ask.agent, ask.query, now_ns=self.now_ns)
        answer = SimpleNamespace(agent=ask.agent, incarnation=incarnation, revision=revision)
        return self.registry.answered(ask.agent, ask.query, answer, now_ns=self.now_ns)


@settings(max_examples=300)
@given(st.lists(STEPS, max_size=60))
def test_whatever_happens_queries_never_double_events_make_sense_and_memory_is_bounded(steps):
    checker = Checker()
    for step in steps:
        checker.step(step)
        statuses = checker.registry.agents()
        assert len(statuses) <= 3
        waiting = [a for a in statuses if a.state.name.endswith("ING")]
        assert {a.agent for a in waiting if a.state is not State.BACKING_OFF} == set(
            checker.outstanding
        )
        assert all(a.agent not in ("station", "camera", "") for a in statuses)
        known_ns = checker.registry.deadline_ns
        for remote in checker.registry._remotes.values():
            remote.due = None
        assert checker.registry.deadline_ns == known_ns


@given(
    depth=st.integers(6, 12),
    steps=st.lists(st.tuples(st.sampled_from("abcde"), st.booleans()), max_size=80),
)
def test_whoever_hears_only_the_last_events_knows_all_agents_that_are_there(depth, steps):
    history, published, present = History(depth), [], {}
    for agent, there in steps:
        present[agent] = there
        news = agent
        while news is not None:
            published.append((news, present[news]))
            news = history.published(news)
            news = news if news is not None and present[news] else None
    heard = dict(published[-depth:])
    assert {a for a, there in heard.items() if there} == {
        a for a, there in present.items() if there
    }


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
    asked = [(0, 9), (1, 0), (1, 1), (1, 2), (2, 0)]
    assert [wanted for wanted in asked if of(offers, wanted)] == asked[:3]


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
