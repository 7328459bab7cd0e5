"""The life-cycle experiment: what is wrong in a log is found, and a short live run takes every transition."""

from __future__ import annotations

import asyncio
from dataclasses import asdict, replace

import psutil
import pytest

from sfglab.fleet.discovery.lifecycle import TRANSITIONS, Input, State
from sfglab.fleet.status.heartbeat import Schedule
from sfglab.lab.experiments import lifecycle
from sfglab.lab.experiments.lifecycle.config import Config
from sfglab.lab.experiments.lifecycle.rows import (
    AnswerRow,
    BeatRow,
    CountRow,
    FaultRow,
    JoinRow,
    MoveRow,
    QueryRow,
    WireEndpointRow,
)
from sfglab.lab.experiments.profiles import ConfigError
from sfglab.record import LogReader, LogWriter

S = 1_000_000_000
START_NS = 1_000 * S
INSTANTS = (0, 1, 2, 3, 4, 5, 10, 15, 20)


class Story:
    """A log as a run writes it: one agent, all of whose heartbeats are as they should be, and one move."""

    def __init__(self, path) -> None:
        self.path = path
        self.config = Config.of_profile("quick")
        self.gap_scale = 1.0
        self.topic = "/global/agent_heartbeat"
        self.late_s = 12.1
        self.moves = [self.move("UNKNOWN", "HEARD", "QUERYING", "QUERY", 1.0)]
        self.queries = []

    def move(self, before, given, after, actions, at_s, agent="go2"):
        return MoveRow(
            discoverer="station",
            agent=agent,
            before=before,
            given=given,
            after=after,
            actions=actions,
            t_ns=START_NS + round(at_s * S),
        )

    def written(self):
        with LogWriter(self.path) as log:
            log.write_metadata("config", {"experiment": "lifecycle", **asdict(self.config)})
            log.write_metadata("hosts", {"description": "made", "separate": True})
            rows = {
                "beat": [*self.beats(), self.beat("late", 10, self.late_s)],
                "join": [JoinRow(listener=n, t_ns=START_NS + t * S) for n, t in (("first", 0), ("late", 12))],
                "endpoint": [
                    WireEndpointRow(
                        topic=self.topic,
                        type="sfglab_interfaces/msg/AgentHeartbeat",
                        reliability="reliable",
                        durability="transient_local",
                        gid="0",
                    )
                ],
                "answer": [
                    AnswerRow(
                        agent="go2",
                        service="/global/go2/get_metadata",
                        answered=True,
                        incarnation=7,
                        took_s=0.1,
                    )
                ],
                "move": self.moves,
                "query": [QueryRow(agent="go2", t_ns=START_NS + round(t * S)) for t in self.queries]
                or [QueryRow(agent="nobody", t_ns=0)][: not self.queries],
                "fault": [FaultRow(agent="go2", what="nothing", t_ns=START_NS)],
                "count": [CountRow(discoverer="station", name="asked", count=1)],
            }
            for table, entries in rows.items():
                for row in entries:
                    log.write_row(table, row, log_time_ns=START_NS)
        return self.path

    def beats(self):
        return [self.beat("first", at_s, at_s) for at_s in INSTANTS]

    def beat(self, listener, sent_s, received_s):
        steady = sent_s >= 5
        return BeatRow(
            listener=listener,
            agent="go2",
            incarnation=7,
            revision=0,
            phase=int(steady),
            period_s=(5.0 if steady else 1.0) * self.gap_scale,
            sent_ns=START_NS + round(sent_s * self.gap_scale * S),
            received_ns=START_NS + round(received_s * (1 if listener == "late" else self.gap_scale) * S),
            gid="0",
        )

    def failed(self):
        checks = lifecycle.heartbeat_checks(lifecycle.load_results(self.written()))
        return [check.what for check in checks if not check.held]

    def transitions(self):
        return lifecycle.transitions(lifecycle.load_results(self.written()))


@pytest.fixture
def story(tmp_path):
    return Story(tmp_path / "made.mcap")


def test_heartbeats_as_the_paper_states_them_hold_in_every_check(story):
    assert story.failed() == []
    claim = lifecycle.measure_claims(story.path)["A-HEARTBEAT"]
    assert claim.estimate.value == 1.0
    assert claim.details["checks"] == "7 of 7"
    gaps = lifecycle.intervals(lifecycle.load_results(story.path))
    assert gaps["gap_s"].tolist() == [1, 1, 1, 1, 1, 5, 5, 5]


def test_periods_that_are_a_tenth_off_are_found(story):
    story.gap_scale = 1.1
    assert {what.split(" within")[0] for what in story.failed()} == {
        "median startup period",
        "median steady period",
    }
    claim = lifecycle.measure_claims(story.path)["A-HEARTBEAT"]
    assert claim.estimate.value == pytest.approx(5 / 7)
    assert "median steady period" in claim.reason


def test_a_late_listener_that_had_to_wait_and_another_topic_are_found(story):
    story.late_s, story.topic = 15.0, "/global/heartbeat"
    assert story.failed() == [
        "one publisher per agent on the paper's topic, latched",
        "heard at once by who joins late",
    ]


def test_heartbeats_at_other_periods_say_nothing_about_the_papers(story):
    story.config = Config.of_profile("smoke")
    assert set(lifecycle.measure_claims(story.written())) == {"A-DFA"}


def test_transitions_are_counted_and_those_that_are_not_the_tables_are_found(story):
    story.moves += [
        story.move("QUERYING", "ANSWERED", "ACTIVE", "DISCOVERED", 1.5),
        story.move("ACTIVE", "SILENT", "LOST", "", 2.0),
    ]
    found = story.transitions()
    assert found.taken[State.UNKNOWN, Input.HEARD] == 1
    assert found.taken[State.ACTIVE, Input.SILENT] == 0
    assert (found.strange, found.announced) == (1, {"DISCOVERED": 1})
    assert found.reached == pytest.approx(2 / len(TRANSITIONS))
    assert lifecycle.measure_claims(story.path)["A-DFA"].estimate.value == 0.0, "it does not follow its table"


@pytest.mark.parametrize(
    ("arrivals", "doubled"),
    [
        ((1.1,), 0),
        ((1.1, 1.2), 1),  # a second one while the first is outstanding
        ((1.1, 3.1), 0),  # one for each
        ((2.1, 3.1), 0),  # the first arrived just after it was given up
        ((0.5,), 1),  # before anything was asked
        ((1.1, 2.9, 3.1), 1),  # between the two
    ],
)
def test_a_query_beyond_the_outstanding_one_is_found(story, arrivals, doubled):
    story.moves += [
        story.move("QUERYING", "FAILED", "BACKING_OFF", "BACK_OFF", 2.0),
        story.move("BACKING_OFF", "RETRY", "QUERYING", "QUERY", 3.0),
    ]
    story.queries = arrivals
    assert story.transitions().doubled == doubled


def test_the_figures_draw_from_the_log_alone(story):
    figures = lifecycle.figures(story.written())
    assert set(figures) == {"heartbeats", "discovery_states"}
    figure, shown = figures["discovery_states"]
    assert shown["reached"] == 1
    texts = [text.get_text() for text in figure.axes[0].texts]
    for key in TRANSITIONS:
        assert any(key[1].name.lower().replace("_", " ") in text for text in texts)
    assert {state.name.replace("_", " ").lower() for state in State} <= set(texts)
    assert figures["heartbeats"][1]["median_gap_s"] == {"start-up": 1.0, "steady state": 5.0}


def test_profiles_keep_the_papers_periods_except_the_shortest():
    with pytest.raises(ConfigError, match="allowed are smoke, quick, paper"):
        Config.of_profile("fast")
    assert [Config.of_profile(p).at_paper_periods for p in ("smoke", "quick", "paper")] == [False, True, True]
    assert Config.of_profile("paper").schedule == Schedule(), "with the full start-up phase"


@pytest.mark.live
@pytest.mark.slow
def test_a_short_live_run_takes_every_transition_and_leaves_nothing(tmp_path):
    before = {p.pid for p in psutil.Process().children(recursive=True)}
    smoke = Config.of_profile("smoke")
    log = asyncio.run(lifecycle.run(replace(smoke, agents=1), tmp_path / "run.mcap"))
    results = lifecycle.load_results(log)
    found = lifecycle.transitions(results)
    assert [key for key, count in found.taken.items() if not count] == []
    assert (found.doubled, found.strange) == (0, 0)
    assert sum(results.events.values()) == sum(found.announced.values()), "every event was on the wire"
    kinds = ("publisher", "start-up", "service")
    asked = [c for c in lifecycle.heartbeat_checks(results) if any(k in c.what for k in kinds)]
    assert [c for c in asked if not c.held] == []
    assert set(results.beats["listener"]) == {"first", "late"}
    gate = results.counts[results.counts["discoverer"] == "gate"].set_index("name")["count"]
    assert (gate[["dropped_malformed", "dropped_spoofed", "dropped_own", "evicted"]] > 0).all()
    assert gate["dropped_flood"] > 100
    with LogReader(log) as reader:
        events = {entry.message.agent for entry in reader.decoded("/local/station/agent_discovery_event")}
    assert "walker" in events
    assert {p.pid for p in psutil.Process().children(recursive=True)} <= before
