"""Tables of components and pipelines: what paths lead to, and when something is tried again."""

import pytest

from sfglab.fleet.agent import supervision
from sfglab.fleet.decoder import streams as pipelines
from sfglab.machine import ProcessTiming

WAITS = {"start_ns": 100, "stop_ns": 50, "backoff_ns": 4, "backoff_max_ns": 20, "stable_ns": 1000}
INPUTS = {"component": supervision.Input, "pipeline": pipelines.Input}
NEW = {
    "component": lambda: supervision.Supervision("router", ProcessTiming(**WAITS)),
    "pipeline": lambda: pipelines.Lifecycle(pipelines.Timing(**WAITS, linger_ns=10)),
}
ENDS = {*supervision.REST, pipelines.State.GONE}
LINGERED = "START CANCEL_TIMER LINGER"


def walk(name, inputs, machine=None, now_ns=0):
    """Return a machine, by default a new one, after inputs that are given by name, and its actions."""
    machine = machine or NEW[name]()
    actions = [machine.feed(INPUTS[name][each], now_ns=now_ns) for each in inputs.split()]
    return machine, [action.name for action in actions if action]


@pytest.mark.parametrize(
    ("name", "inputs", "actions", "state"),
    [
        (
            "component",
            "BEGIN READY TOLD_TO_STOP ENDED",
            "START CANCEL_TIMER TERMINATE CANCEL_TIMER",
            "STOPPED",
        ),
        (
            "component",
            "BEGIN TIMER TIMER ENDED TIMER",
            "START TERMINATE KILL BACK_OFF START",
            "STARTING",
        ),
        (
            "component",
            "BEGIN READY TOLD_TO_STOP TIMER",
            "START CANCEL_TIMER TERMINATE KILL",
            "STOPPING",
        ),
        (
            "component",
            "BEGIN READY TOLD_TO_STOP TOLD_TO_STOP",
            "START CANCEL_TIMER TERMINATE KILL",
            "STOPPING",
        ),
        (
            "pipeline",
            "WANTED STARTED UNWANTED TIMER ENDED",
            f"{LINGERED} STOP CANCEL_TIMER",
            "IDLE",
        ),
        ("pipeline", "WANTED STARTED UNWANTED WANTED", f"{LINGERED} CANCEL_TIMER", "RUNNING"),
        ("pipeline", "WANTED TIMER ENDED", "START STOP START", "STARTING"),
        ("pipeline", "WANTED UNWANTED WANTED ENDED", "START STOP START", "STARTING"),
        ("pipeline", "WANTED UNWANTED TIMER ENDED", "START STOP KILL CANCEL_TIMER", "IDLE"),
    ],
)
def test_a_path_acts_as_wanted(name, inputs, actions, state):
    machine, done = walk(name, inputs)
    assert (done, machine.state.name) == (actions.split(), state)
    if state in ("STOPPED", "IDLE", "RUNNING"):
        assert machine.deadline_ns is None


@pytest.mark.parametrize(
    ("name", "prefix", "life"),
    [("component", "BEGIN", "READY ENDED"), ("pipeline", "WANTED", "ENDED")],
)
def test_crashes_are_tried_again_with_doubling_waits_up_to_the_limit(name, prefix, life):
    machine, _ = walk(name, prefix)
    waits = []
    for _ in range(5):
        walk(name, life, machine)
        waits.append(machine.deadline_ns)
        walk(name, "TIMER", machine)
    assert waits == [4, 8, 16, 20, 20]
    assert machine.crashes == 5


@pytest.mark.parametrize(
    ("name", "begin", "ready"), [("component", "BEGIN", "READY"), ("pipeline", "WANTED", "STARTED")]
)
def test_one_that_served_long_enough_starts_over_with_the_short_wait_and_that_counts_once(
    name, begin, ready
):
    machine, _ = walk(name, f"{begin} ENDED TIMER ENDED TIMER")
    walk(name, ready, machine, 10)
    waits = []
    for now_ns in (1010, 2010):  # the second one never served, however long ago the first one did
        walk(name, "ENDED", machine, now_ns)
        waits.append(machine.deadline_ns - now_ns)
        walk(name, "TIMER", machine, now_ns)
    assert waits == [4, 8]


@pytest.mark.parametrize(
    ("inputs", "action"), [("BEGIN", "GIVE_UP"), ("BEGIN READY ENDED TIMER", "BACK_OFF")]
)
def test_a_component_that_exits_before_it_ever_served_is_given_up_else_tried_again(inputs, action):
    life, _ = walk("component", inputs)
    assert life.feed(life.end(willingly=True), now_ns=0).name == action
    assert (life.state is supervision.State.FAILED) == (action == "GIVE_UP")


@pytest.mark.parametrize(
    ("name", "prefix"),
    [
        *(("component", f"BEGIN {then}") for then in ("", "READY", "TIMER", "ENDED", "REFUSED")),
        *(("pipeline", f"WANTED {then}") for then in ("", "STARTED")),
    ],
)
def test_told_to_end_one_does_wherever_it_stands(name, prefix):
    told = {"component": "TOLD_TO_STOP", "pipeline": "WITHDRAWN"}[name]
    machine, _ = walk(name, f"{prefix} {told}")
    if machine.state.name in ("STOPPING", "LEAVING"):
        walk(name, "ENDED", machine)
    assert machine.state in ENDS
    assert machine.deadline_ns is None


def test_told_to_stop_while_it_is_replaced_a_component_keeps_the_deadline_of_its_end():
    machine, _ = walk("component", "BEGIN TIMER TOLD_TO_STOP")
    assert (machine.state.name, machine.deadline_ns) == ("STOPPING", WAITS["stop_ns"])
