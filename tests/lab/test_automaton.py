"""A clickable automaton follows its table and shows refused transitions; recorded runs are stepped."""

import pytest
from made_logs import reference
from matplotlib.figure import Figure

from sfglab.fleet.decoder.streams import TRANSITIONS as PIPELINE
from sfglab.fleet.decoder.streams import State as PipelineState
from sfglab.fleet.discovery.lifecycle import TRANSITIONS, Input, State
from sfglab.fleet.policy import TABLE_1
from sfglab.lab.experiments import lifecycle, naming
from sfglab.lab.explore import Automaton, transition_part
from sfglab.lab.explore.timeline import Timeline
from sfglab.lab.figures import drawn

pytest.importorskip("anywidget")
TABLES = [
    (TRANSITIONS, State.UNKNOWN),
    (PIPELINE, PipelineState.IDLE),
]


@pytest.mark.parametrize(("table", "start"), TABLES, ids=["life cycle", "pipeline"])
def test_every_press_does_what_the_table_says_in_the_present_state_or_is_refused(table, start):
    machine = Automaton("machine", table, start, lambda *_: {}, size=(3, 2))
    inputs = dict.fromkeys(given for _, given in table)
    states = dict.fromkeys(state for state, _ in table)
    edge_of = {given: transition_part(source, given) for source, given in table}
    for state in states:
        for given in inputs:
            machine.press(state.name)
            assert machine.moment.state is state
            machine.press(edge_of[given])
            after, _ = table.get((state, given), (state, ()))
            assert machine.moment.state is after
            refused = (state, given) not in table
            assert ("allowed: " in machine.said) is refused
            assert machine.moment.taken == (None if refused else (state, given))


def test_every_transition_and_state_of_the_life_cycle_is_drawn_and_says_what_it_does():
    machine = lifecycle.press_lifecycle()
    parts = [transition_part(*key) for key in TRANSITIONS] + [state.name for state in State]
    assert all(f'id="press:{part}"' in machine._figure.svg for part in parts)
    assert set(machine._figure.titles) == set(parts)
    assert machine._figure.titles["LOST/HEARD"] == "HEARD in LOST leads to ACTIVE: RETURNED"
    assert "#00528a" in machine._figure.svg, "transitions that are possible now"
    before = machine._figure.svg.count("#d55e00")
    machine.press("UNKNOWN/HEARD")
    assert machine._figure.svg.count("#d55e00") > before, "the transition is highlighted"


def test_a_recorded_run_is_stepped_left_by_hand_and_undone():
    run = reference(lifecycle.exp)
    machine = lifecycle.press_states(run)
    machine.choice.value = "walker"
    moves = run["move"].query("agent == 'walker'").sort_values("t_ns")
    for at, after in enumerate(moves["after"], start=1):
        machine.at.value = at
        assert machine.moment.state.name == after
    assert machine.at.max == at
    machine.press(transition_part(State.UNKNOWN, Input.HEARD))
    assert machine.moment.state is State.QUERYING
    machine.at.value -= 1
    assert machine.moment.state.name == after
    assert machine.at.max == at + 1, "the click can be repeated"
    machine.at.value = 0
    machine.press(State.LOST.name)
    assert (machine.moment.state, machine.at.value, machine.at.max) == (State.LOST, 1, 1)
    machine.choice.value = "by hand"
    assert machine.moment.state is State.UNKNOWN
    assert machine.at.max == 0


NAMES = {
    "/global/go2/get_metadata": "service {} is a name of the schema.",
    "/local/go2/agent_discovery_event": "topic {} is a name of the schema.",
    "/tf": "topic {} is no name of the schema: scope: given 'tf', allowed: local or global.",
    "/global/go2/arm/grasp": "topic {} is a name of the schema.",
}


@pytest.mark.parametrize("name", NAMES)
def test_a_typed_name_shows_its_segments_and_the_rules_that_decide(name):
    picture = naming.NamePicture()
    picture.field.value = name
    figure = drawn(picture._size, picture.draw)
    title = " ".join(figure.get_suptitle().split())
    assert title == f"The {NAMES[name].format(name)}"
    texts = {text.get_text().replace("\n", "") for text in figure.axes[0].texts}
    assert {text for _, text in (picture.fqn.segments if picture.fqn else ())} <= texts
    for line in figure.get_supxlabel().splitlines():
        dds, _, pattern = line.partition(": forwarded by the rule ")
        matching = [
            rule.pattern for rule in TABLE_1 if rule.matches(dds.removesuffix(": not forwarded"))
        ]
        assert matching == ([pattern] if pattern else [])


def test_a_text_that_is_no_name_is_refused_and_the_last_name_stays():
    picture = naming.NamePicture("/global/go2/get_metadata")
    picture.field.value = "/global//go2"
    assert "absolute name" in picture.said
    assert picture.name == "/global/go2/get_metadata"


@pytest.mark.parametrize("preset", ["fast_dds", "cyclone_dds"])
def test_every_frame_of_the_engine_and_every_samples_number_is_drawn(preset):
    line = Timeline()
    for name, value in {"preset": preset, "depth": 50, "loss_percent": 30, "samples": 40}.items():
        line.form.controls[name].value = value
    for press in ("a/DATA/7", "a/ACKNACK/1", "a/DATA/7", "a/HEARTBEAT/1"):
        if press in {frame.name for frame in line.frames}:
            line.press(press)
        lost = {frame.name: frame.lost for frame in line.frames}
        assert len(lost) == len(line.frames)
        assert lost.items() >= {(name, to) for name, to in line.lost.items() if name in lost}
        figure = Figure()
        line.draw(figure)
        marks = {artist.get_gid() for artist in figure.axes[0].lines} - {None}
        assert marks == {f"press:{name}" for name in lost}
        numbers = [text.get_text() for text in figure.axes[0].texts]
        assert sum(text.isdecimal() for text in numbers) >= len(line.outcome.fate)
        taken = {text.get_text() for text in figure.axes[0].texts if text.get_position()[1] < 0}
        times_ns = line.outcome.received_ns[line.outcome.delivered]
        assert len(taken) == len(set(times_ns)), "each time has its own numbers"


def test_a_frame_that_the_seed_loses_is_made_to_pass_and_the_rest_of_the_losses_stay():
    line = Timeline()
    line.lost.clear()
    line.form.controls["loss_percent"].value = 30
    line.form.controls["samples"].value = 40
    lost = [frame.name for frame in line.frames if frame.lost]
    line.press(lost[0])
    assert lost[0] not in {frame.name for frame in line.frames if frame.lost}
    line.form.controls["depth"].value = 1
    assert line.lost == {lost[0]: False}, "what was pressed stays when something else is set"
