"""The stepwise run: it is the same model, and somebody outside gives values, hears deliveries and answers."""

from dataclasses import replace

import numpy as np
import pytest

from sfglab.errors import InvalidValueError
from sfglab.qos import QoSProfile
from sfglab.rtps import Flow, Medium, Scenario, Session, run

MS = 1_000_000
S = 1_000_000_000
ROBOTS = ("robot1", "robot2", "robot3")


def beams(**changes):
    flow = Flow(
        name="", source="", target="station", rate_hz=200, qos=QoSProfile(depth=10), **changes
    )
    return tuple(
        replace(flow, name=f"{robot}/{i}", source=robot, executor=robot, phase_s=i * 1e-4)
        for robot in ROBOTS
        for i in range(4)
    )


def drive(session, until_ns, step_ns=50 * MS):
    heard = []
    while session.now_ns < until_ns:
        delivery = session.advance(min(session.now_ns // step_ns * step_ns + step_ns, until_ns))
        if delivery is not None:
            heard.append(delivery)
    return heard


def test_in_steps_it_is_the_same_run_as_at_once():
    scenario = Scenario(flows=beams(), medium=Medium(loss=0.05), duration_s=3)
    session = Session(scenario, seed=7)
    heard = drive(session, 13 * S)
    at_once, stepwise = run(scenario, seed=7), session.outcome()
    assert at_once.counts == stepwise.counts
    for name, flow in at_once.flows.items():
        assert np.array_equal(flow.received_ns, stepwise.flows[name].received_ns)
        assert [d.now_ns for d in heard if d.flow == name] == flow.received_ns[
            flow.delivered
        ].tolist()


def test_values_set_from_outside_are_what_arrives_and_what_the_cache_compares():
    scenario = Scenario(flows=beams(cached=True), medium=Medium(loss=0.0), duration_s=2)
    session = Session(scenario, seed=0)
    heard = []
    for value in range(4):
        for flow in scenario.flows:
            session.set_value(flow.name, value)
        heard += drive(session, (value + 1) * S // 2, step_ns=S)
    heard += drive(session, 3 * S)
    for flow in scenario.flows:
        assert [d.value for d in heard if d.flow == flow.name] == [0, 1, 2, 3]


def test_an_answer_is_published_now_and_arrives():
    up = Flow(name="up", source="robot1", target="station", rate_hz=10)
    down = Flow(name="down", source="station", target="robot1")
    session = Session(Scenario(flows=(up, down), medium=Medium(loss=0.0), duration_s=2), seed=0)
    answered, heard = [], []
    while session.now_ns < 3 * S:
        delivery = session.advance(3 * S)
        if delivery is None:
            break
        if delivery.flow == "up":
            assert session.publish("down", len(answered))
            answered.append(delivery.now_ns)
        else:
            heard.append(delivery)
    assert len(answered) == 20
    assert [d.value for d in heard] == list(range(20))
    assert [d.published_ns for d in heard] == answered


def test_cache_control_says_what_it_discarded():
    scenario = Scenario(
        flows=beams(compare_s=1e-5, service_s=1e-4), medium=Medium(loss=0.0), duration_s=1
    )
    session = Session(scenario, seed=0)
    for flow in scenario.flows:
        session.set_value(flow.name, 5)
    heard = drive(session, 2 * S)
    assert sum(not d.repeated for d in heard) == len(scenario.flows)
    assert len(heard) == 200 * len(scenario.flows)
    news = Session(scenario, seed=0, news_only=True)
    for flow in scenario.flows:
        news.set_value(flow.name, 5)
    assert drive(news, 2 * S) == [d for d in heard if not d.repeated]


def test_bad_calls_are_refused_with_the_place():
    session = Session(Scenario(flows=beams(), duration_s=1), seed=0)
    session.advance(10 * MS)
    with pytest.raises(InvalidValueError, match="until_ns"):
        session.advance(0)
    with pytest.raises(InvalidValueError, match="given 'x'"):
        session.set_value("x", 1)
    with pytest.raises(InvalidValueError, match="given 'x'"):
        Session(Scenario(flows=beams(), duration_s=1), seed=0, watched=("x",))
