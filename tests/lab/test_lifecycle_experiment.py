"""The life-cycle experiment: what is wrong in a log is found, and the reference run took every transition."""

from pathlib import Path

import pytest
from made_logs import made_run

from sfglab.fleet.discovery.lifecycle import TRANSITIONS, Action, Input, State
from sfglab.fleet.status.heartbeat import Schedule
from sfglab.lab.experiments import lifecycle
from sfglab.lab.experiments.lifecycle import exp
from sfglab.lab.experiments.lifecycle.analysis import events, heard

REFERENCE = Path(__file__).parents[2] / "data" / "reference" / "lifecycle.mcap"
S = 1_000_000_000
START_NS = 1_000 * S
INSTANTS = (0, 1, 2, 3, 4, 5, 10, 15, 20)


def move(before, given, after, actions, at_s):
    """Return a transition that the discoverer took."""
    row = {"before": before, "given": given, "after": after, "actions": actions}
    return {"discoverer": "station", "agent": "go2", **row, "t_ns": START_NS + round(at_s * S)}


class Story:
    """A log as a run writes it: one agent, all of whose heartbeats are as they should be, and one move."""

    def __init__(self, path) -> None:
        self.path = path
        self.config = exp.config("quick")
        self.gap_scale = 1.0
        self.topic = "/global/agent_heartbeat"
        self.late_s = 12.1
        self.moves = [move("UNKNOWN", "HEARD", "QUERYING", "QUERY", 1.0)]
        self.queries = []

    def run(self):
        """Write the log and load it."""
        return made_run(exp, self.path, self.tables(), config=self.config)

    def tables(self):
        service = {"service": "/global/go2/get_metadata", "answered": True, "incarnation": 7}
        offered = {"reliability": "reliable", "durability": "transient_local"}
        return {
            "beat": [*(self.beat("first", s, s) for s in INSTANTS), self.beat("late", 10, self.late_s)],
            "join": [{"listener": n, "t_ns": START_NS + t * S} for n, t in (("first", 0), ("late", 12))],
            "endpoint": [{"topic": self.topic, "type": "sfglab_interfaces/msg/AgentHeartbeat", **offered}],
            "answer": [{"agent": "go2", **service}],
            "move": self.moves,
            "query": [{"agent": "go2", "t_ns": START_NS + round(t * S)} for t in self.queries],
        }

    def beat(self, listener, sent_s, received_s):
        steady = sent_s >= 5
        return {
            "listener": listener,
            "agent": "go2",
            "incarnation": 7,
            "phase": int(steady),
            "period_s": (5.0 if steady else 1.0) * self.gap_scale,
            "sent_ns": START_NS + round(sent_s * self.gap_scale * S),
            "received_ns": START_NS + round(received_s * (1 if listener == "late" else self.gap_scale) * S),
        }


def failed(run):
    return [check.what for check in lifecycle.heartbeat_checks(run) if not check.held]


@pytest.fixture
def story(tmp_path):
    return Story(tmp_path / "made.mcap")


def test_heartbeats_as_the_paper_states_them_hold_in_every_check(story):
    run = story.run()
    assert failed(run) == []
    claim = exp.measure(run)["A-HEARTBEAT"]
    assert claim.estimate.value == 1.0
    assert claim.details["checks"] == "7 of 7"
    assert lifecycle.intervals(run)["gap_s"].tolist() == [1, 1, 1, 1, 1, 5, 5, 5]


def test_periods_that_are_a_tenth_off_are_found(story):
    story.gap_scale = 1.1
    run = story.run()
    wanted = {f"median {phase} period" for phase in ("startup", "steady")}
    assert {what.split(" within")[0] for what in failed(run)} == wanted
    claim = exp.measure(run)["A-HEARTBEAT"]
    assert claim.estimate.value == pytest.approx(5 / 7)
    assert "median steady period" in claim.reason


def test_a_late_listener_that_had_to_wait_and_another_topic_are_found(story):
    story.late_s, story.topic = 15.0, "/global/heartbeat"
    assert failed(story.run()) == [
        "one publisher per agent on the paper's topic, latched",
        "heard at once by who joins late",
    ]


def test_heartbeats_at_other_periods_say_nothing_about_the_papers(story):
    story.config = exp.config("smoke")
    assert set(exp.measure(story.run())) == {"A-DFA"}


def test_transitions_are_counted_and_those_that_are_not_the_tables_are_found(story):
    story.moves += [
        move("QUERYING", "ANSWERED", "ACTIVE", "DISCOVERED", 1.5),
        move("ACTIVE", "SILENT", "LOST", "", 2.0),
    ]
    run = story.run()
    found = lifecycle.transitions(run)
    assert found.taken[State.UNKNOWN, Input.HEARD] == 1
    assert found.taken[State.ACTIVE, Input.SILENT] == 0
    assert (found.strange, found.announced) == (1, {"DISCOVERED": 1})
    assert found.reached == pytest.approx(2 / len(TRANSITIONS))
    assert exp.measure(run)["A-DFA"].estimate.value == 0.0, "it does not follow the rules"


@pytest.mark.parametrize(
    ("wrong", "why"),
    [
        (("QUERYING", "HEARD", "QUERYING", "QUERY"), "moves against the rules"),
        (("ACTIVE", "HEARD", "ACTIVE", ""), "moves against the rules"),  # it is in QUERYING
        (("QUERYING", "ANSWERED", "ACTIVE", "DISCOVERED"), "not on the wire"),
    ],
)
def test_the_discoverers_own_table_vouches_for_nothing(story, monkeypatch, wrong, why):
    before, given, after, action = wrong
    row = State[after], tuple(Action[name] for name in action.split(";") if name)
    monkeypatch.setitem(TRANSITIONS, (State[before], Input[given]), row)
    story.moves.append(move(*wrong, 1.5))
    found = exp.measure(story.run())["A-DFA"]
    assert (found.estimate.value, why in found.reason) == (0.0, True)


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
        move("QUERYING", "FAILED", "BACKING_OFF", "BACK_OFF", 2.0),
        move("BACKING_OFF", "RETRY", "QUERYING", "QUERY", 3.0),
    ]
    story.queries = arrivals
    assert lifecycle.transitions(story.run()).doubled == doubled


def test_profiles_keep_the_papers_periods_except_the_shortest():
    assert [exp.config(p).at_paper_periods for p in ("smoke", "quick", "paper")] == [False, True, True]
    assert exp.config("paper").schedule == Schedule(), "with the full start-up phase"


def test_the_reference_run_took_every_transition_and_dropped_what_is_no_agent():
    run = exp.load(REFERENCE)
    found = lifecycle.transitions(run)
    assert [key for key, count in found.taken.items() if not count] == []
    assert (found.doubled, found.strange) == (0, 0)
    assert sum(events(run).values()) == sum(found.announced.values()), "every event was on the wire"
    assert failed(run) == []
    assert set(heard(run)["listener"]) == {"first", "late"}
    counts = run["count"]
    gate = counts[counts["discoverer"] == "gate"].set_index("name")["count"]
    assert (gate[["dropped_malformed", "dropped_spoofed", "dropped_own", "evicted"]] > 0).all()
    assert gate["dropped_flood"] > 100
    assert "walker" in {entry.message.agent for entry in run.messages("/local/station/agent_discovery_event")}
