"""Scenarios on live DDS over the radio: the samples, their values and what is compared with the model."""

from __future__ import annotations

import asyncio
import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sfglab.lab.experiments.transmission.experiment import HELLO_DOWN, HELLO_UP, Point, scenario_of
from sfglab.lab.experiments.transmission.stage import GROUPS, Played, compare, hosts_of, live_hosts, measure
from sfglab.lab.hosts import RadioCounters
from sfglab.lab.workers.flowplay import text_of, value_of
from sfglab.messages import deserialize
from sfglab.qos import QoSProfile
from sfglab.rtps import CYCLONE_DDS, Fate, Flow, Medium, Outcome, Scenario, run

CALM = Medium(rate_bps=1e8, loss=0.0, overhead_s=50e-6)


@given(size_bytes=st.integers(min_value=14, max_value=200), value=st.integers(min_value=0, max_value=64**5 - 1))
def test_a_sample_has_its_size_and_carries_its_value(size_bytes, value):
    cdr = text_of(value, size_bytes)
    assert len(cdr) == size_bytes
    assert value_of(cdr) == value
    assert len(deserialize(cdr, "std_msgs/msg/String").data) == size_bytes - 9


def outcome_of_losses(lost_up: int, lost_down: int) -> Outcome:
    """Return a run of the model with known losses: of ten "Hello"s, and of ten samples of a sensor."""
    scenario = Scenario(
        flows=(
            Flow(name="robot1/lidar", source="robot1", target="station", rate_hz=10),
            Flow(name=HELLO_UP, source="robot1", target="station", rate_hz=10, then=HELLO_DOWN),
            Flow(name=HELLO_DOWN, source="station", target="robot1"),
        ),
        medium=replace(CALM, latency_s=1e-3),
        duration_s=1.0,
    )
    outcome = run(scenario, seed=1)
    outcome.flows[HELLO_UP].fate[:lost_up] = Fate.UNDERWAY
    outcome.flows[HELLO_DOWN].fate[: lost_up + lost_down] = Fate.UNDERWAY
    return outcome


def played(outcome: Outcome, *, radio: RadioCounters | None = None, late_p95_s: float = 0.0) -> Played:
    return Played(
        scenario=scenario_of(POINT),
        delay_s=0.0,
        outcome=outcome,
        radio=radio or RadioCounters(delivered=100, late_after_s=2e-3),
        late_p95_s=late_p95_s,
        refused=0,
    )


POINT = Point(rate_max_hz=100, depth="10", method="none", duration_s=1.0)


def test_losses_and_latencies_are_those_of_their_group():
    outcome = outcome_of_losses(1, 2)
    assert [measure([outcome], group)["loss"] for group in GROUPS] == pytest.approx([0.0, 0.1, 0.3])
    up_ms, round_ms = (measure([outcome], group)["p50_ms"] for group in ("hello_up", "hello"))
    assert 1.0 < up_ms < 1.3
    assert round_ms == pytest.approx(2 * up_ms, rel=0.1)
    assert measure([outcome, outcome], "hello")["published"] == 20


def test_three_points_and_thirty_percent_agree_and_more_does_not():
    rows = compare(POINT, played(outcome_of_losses(0, 0)), [outcome_of_losses(0, 1)])
    agrees = {row.group: row for row in rows}
    assert agrees["sensors"].loss_agrees
    assert agrees["sensors"].latency_agrees
    assert not agrees["hello"].loss_agrees
    nothing = compare(POINT, played(outcome_of_losses(10, 0)), [outcome_of_losses(0, 0)])[-1]
    assert math.isnan(nothing.p50_live_ms)
    assert not nothing.latency_agrees


def test_a_run_that_did_not_keep_its_schedule_says_so():
    outcome = outcome_of_losses(0, 0)
    slow = RadioCounters(delivered=100, late=2, late_after_s=2e-3)
    assert played(outcome).kept_up
    assert not played(outcome, radio=slow).kept_up
    assert not played(outcome, late_p95_s=3e-3).kept_up


# --- Live -----------------------------------------------------------------------------------------------------


def play(*scenarios: Scenario) -> list[Played]:
    async def all_of_them() -> list[Played]:
        async with live_hosts(*hosts_of(scenarios[0])) as hosts:
            return [await hosts.play(scenario, seed=3) for scenario in scenarios]

    return asyncio.run(all_of_them())


@pytest.mark.slow
@pytest.mark.netns
def test_flows_caches_and_chains_run_live_as_in_the_model():
    # Depth for all samples: a process that gets no CPU for a tenth of a second sends more than ten at once.
    flow = {"source": "robot", "target": "station", "rate_hz": 100.0, "qos": QoSProfile(depth=100)}
    scenario = Scenario(
        flows=(
            Flow(name="plain", **flow),
            Flow(name="cached", change_s=0.1, cached=True, phase_s=1e-3, **flow),
            Flow(name="compared", change_s=0.1, compare_s=1e-5, service_s=1e-4, phase_s=2e-3, **flow),
            Flow(name="hello", size_bytes=14, then="move", phase_s=3e-3, **flow),
            Flow(name="move", size_bytes=14, source="station", target="robot"),
        ),
        medium=CALM,
        vendor=CYCLONE_DDS,
        duration_s=1.0,
        drain_s=3.0,
    )
    lossy = replace(scenario, medium=replace(CALM, loss=0.3), flows=scenario.flows[:1])
    live, worse = play(scenario, lossy)
    flows = live.outcome.flows
    assert {name: f.loss for name, f in flows.items()} == dict.fromkeys(flows, 0.0)
    assert [len(flows[name].fate) for name in ("plain", "compared", "hello", "move")] == [100] * 4
    assert len(flows["cached"].fate) + live.outcome.counts["held"] == 100
    assert len(flows["cached"].fate) == len(np.unique(flows["cached"].value))
    assert live.outcome.counts["compared"] == 100 - len(np.unique(flows["compared"].value))
    assert (flows["move"].value == flows["hello"].value).all()
    assert (flows["move"].published_ns >= flows["hello"].received_ns).all()
    assert (flows["plain"].latency_ns > 0).all()
    assert live.refused == 0
    assert live.delay_s > 0
    assert live.scenario.medium.latency_s == live.delay_s
    assert worse.radio.lost > 10
