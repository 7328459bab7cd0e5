"""The stepwise run: it is the same model, and values come from outside; a trace, and frames that are lost."""

from dataclasses import replace

import numpy as np
import pytest

from sfglab.errors import InvalidValueError
from sfglab.qos import QoSProfile
from sfglab.rtps import Fate, Flow, Medium, Scenario, Session, run, trace
from sfglab.rtps.session import age_ms

MS = 1_000_000
S = 1_000_000_000
LOSSLESS = Medium(loss=0.0)
UP = Flow(name="up", source="robot", target="station", rate_hz=200, qos=QoSProfile(depth=10))
BEAMS = tuple(
    replace(UP, name=name, executor="robot", phase_s=i * 1e-4) for i, name in enumerate("abcd")
)


def session_of(*flows, medium=LOSSLESS):
    return Session(Scenario(flows=flows, medium=medium, duration_s=2), seed=7)


def drive(session, until_ns):
    received = []
    for step_ns in range(session.now_ns, until_ns, 50 * MS):
        while (delivery := session.advance(step_ns + 50 * MS)) is not None:
            received.append((session.now_ns, delivery))
    return received


def test_in_steps_it_is_the_same_run_as_at_once():
    medium = Medium(loss=0.05)
    session = session_of(*BEAMS, medium=medium)
    drive(session, 12 * S)
    in_steps = session.outcome()
    at_once = run(Scenario(flows=BEAMS, medium=medium, duration_s=2), seed=7)
    assert at_once.counts == in_steps.counts
    for name, flow in at_once.flows.items():
        assert np.array_equal(flow.received_ns, in_steps.flows[name].received_ns)


def test_values_from_outside_are_delivered_once_as_both_caches_hold_their_repetitions():
    flows = replace(UP, cached=True), replace(UP, name="cc", compare_s=1e-5, service_s=1e-4)
    session = session_of(*flows)
    received = []
    for value in range(4):
        for flow in flows:
            session.set_value(flow.name, value)
        received += drive(session, (value + 1) * S // 2)
    outcome = session.outcome()
    for name, flow in outcome.flows.items():
        found = [(d.value, now_ns) for now_ns, d in received if d.flow == name]
        values, first = np.unique(flow.value, return_index=True)
        assert found == list(zip(values, flow.received_ns[first], strict=True))
    assert outcome.counts["held"] == outcome.counts["compared"] == 4 * 99


def test_the_age_of_information_grows_until_the_next_sample_arrives():
    """At 10 Hz and without delay it grows from 0 to 100 ms, again and again."""
    flow = run(
        Scenario(flows=(replace(UP, rate_hz=10),), medium=LOSSLESS, duration_s=2), seed=0
    ).flows["up"]
    assert age_ms(flow, duration_s=2.0) == pytest.approx(50, abs=1)
    flow.fate[:] = Fate.UNDERWAY
    assert age_ms(flow, duration_s=2.0) == pytest.approx(1000, abs=1)


@pytest.mark.parametrize("name", ["down/DATA/5", "up/DATUM/5", "up"])
def test_no_frame_of_another_flow_or_kind_is_lost(name):
    with pytest.raises(InvalidValueError, match=f"lost: given '{name}'"):
        trace(Scenario(flows=(UP,)), seed=1, lost={name: True})
