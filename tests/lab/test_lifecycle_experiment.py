"""The life-cycle experiment: what is wrong in a log is found, and the reference run took every transition."""

import pytest
from made_logs import made_run, ran

from sfglab.fleet.discovery.lifecycle import TRANSITIONS, Action, Input, State
from sfglab.fleet.status.heartbeat import Schedule
from sfglab.lab.experiments import lifecycle
from sfglab.lab.experiments.lifecycle import exp

S = 1_000_000_000
START_NS = 1_000 * S
INSTANTS = (0, 1, 2, 3, 4, 5, 10, 15, 20)


def move(before, given, after, actions, at_s):
    """Return a transition that the discoverer took."""
    row = {"before": before, "given": given, "after": after, "actions": actions}
    return {"agent": "go2", **row, "t_ns": START_NS + round(at_s * S)}


def beat(listener, sent_s, received_s, scale=1.0):
    """Return a heartbeat of the start-up, or of the steady state from 5 s on."""
    phase, period_s = (0, 1.0) if sent_s < 5 else (1, 5.0)
    kind = {"listener": listener, "agent": "go2", "incarnation": 7, "phase": phase}
    sent_ns, received_ns = (START_NS + round(scale * s * S) for s in (sent_s, received_s))
    times = {"sent_ns": sent_ns, "received_ns": received_ns, "period_s": period_s * scale}
    return kind | times


@pytest.fixture
def told(tmp_path):
    """Give a function that returns a run as its log would: an agent whose heartbeats are as they should be."""

    def make(
        *moves,
        queries=(),
        scale=1.0,
        topic="/global/agent_heartbeat",
        late_s=12.1,
        instants=INSTANTS,
        **changes,
    ):
        endpoint = {"topic": topic, "type": "sfglab_interfaces/msg/AgentHeartbeat"}
        endpoint |= {"reliability": "reliable", "durability": "transient_local"}
        answer = {"agent": "go2", "service": "/global/go2/get_metadata", "answered": True}
        tables = {
            "beat": [*(beat("first", s, s, scale) for s in instants), beat("late", 10, late_s)],
            "join": [
                {"listener": "first", "t_ns": START_NS},
                {"listener": "late", "t_ns": START_NS + 12 * S},
            ],
            "endpoint": [endpoint],
            "answer": [answer | {"incarnation": 7}],
            "move": [move("UNKNOWN", "HEARD", "QUERYING", "QUERY", 1.0), *moves],
            "query": [{"agent": "go2", "t_ns": START_NS + round(t * S)} for t in queries],
        }
        return made_run(exp, tmp_path / "made.mcap", tables, config=exp.config(**changes))

    return make


@pytest.mark.parametrize(
    ("changes", "wrong"),
    [
        ({}, []),
        ({"instants": INSTANTS[1:]}, ["5 heartbeats of the start-up phase, then the steady state"]),
        ({"scale": 1.1}, ["median startup period", "median steady period"]),
        (
            {"late_s": 15.0, "topic": "/global/heartbeat"},
            [
                "one publisher per agent on the paper's topic, transient local",
                "a late joiner receives the last heartbeat",
            ],
        ),
    ],
)
def test_what_is_not_as_the_paper_states_it_is_found(told, changes, wrong):
    run = told(**changes)
    checks = lifecycle.heartbeat_checks(run)
    failed = checks.loc[~checks["holds"], "check"]
    assert [what.split(" within")[0] for what in failed] == wrong
    claim = exp.measure(run)["A-HEARTBEAT"]
    assert claim.estimate.value == pytest.approx(1 - len(wrong) / 7)
    assert all(what in claim.reason for what in wrong)


@pytest.mark.parametrize(
    "changes",
    [{"schedule": Schedule(steady_period_s=4.0)}, {"instants": (0, 1, 2)}, {"profile": "smoke"}],
)
def test_other_periods_and_a_phase_without_an_interval_answer_no_claim(told, changes):
    assert "A-HEARTBEAT" not in exp.measure(told(**changes))


def test_intervals_are_those_of_receipt(told):
    assert lifecycle.intervals(told())["gap_s"].tolist() == [1, 1, 1, 1, 1, 5, 5, 5]


def test_transitions_are_counted_and_those_that_are_not_the_tables_are_found(told):
    discovered = move("QUERYING", "ANSWERED", "ACTIVE", "DISCOVERED", 1.5)
    found = lifecycle.transitions(told(discovered, move("ACTIVE", "SILENT", "LOST", "", 2.0)))
    taken = {key for key, count in found.taken.items() if count == 1}
    assert taken == {(State.UNKNOWN, Input.HEARD), (State.QUERYING, Input.ANSWERED)}
    assert (found.strange, found.announced) == (1, {"DISCOVERED": 1})


@pytest.mark.parametrize(
    ("wrong", "why"),
    [
        (("QUERYING", "HEARD", "QUERYING", "QUERY"), "moves against the rules"),
        (("ACTIVE", "HEARD", "ACTIVE", ""), "moves against the rules"),  # it is in QUERYING
        (("QUERYING", "ANSWERED", "ACTIVE", "DISCOVERED"), "not received as often as announced"),
    ],
)
def test_the_discoverers_own_table_vouches_for_nothing(told, monkeypatch, wrong, why):
    before, given, after, action = wrong
    row = State[after], (Action[action],) if action else ()
    monkeypatch.setitem(TRANSITIONS, (State[before], Input[given]), row)
    found = exp.measure(told(move(*wrong, 1.5)))["A-DFA"]
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
def test_a_query_beyond_those_sent_is_found(told, arrivals, doubled):
    given_up = move("QUERYING", "FAILED", "BACKING_OFF", "BACK_OFF", 2.0)
    run = told(given_up, move("BACKING_OFF", "RETRY", "QUERYING", "QUERY", 3.0), queries=arrivals)
    assert lifecycle.transitions(run).doubled == doubled


def test_profiles_keep_the_papers_periods_except_the_shortest():
    assert exp.config("paper").schedule == Schedule(), "with the full start-up phase"
    quick, smoke = exp.config("quick").schedule, exp.config("smoke").schedule
    periods_s = [Schedule().startup_period_s, Schedule().steady_period_s]
    assert [quick.startup_period_s, quick.steady_period_s] == periods_s
    assert smoke.steady_period_s < quick.steady_period_s


@pytest.mark.live
def test_a_run_takes_every_transition(tmp_path):
    run = ran(exp, tmp_path / "run.mcap")
    found = lifecycle.transitions(run)
    assert [key for key, count in found.taken.items() if not count] == []
    assert (found.doubled, found.strange) == (0, 0)
    assert exp.measure(run)["A-DFA"].estimate.value == 1
