"""The transmission experiment: its flows are the paper's, its arithmetic is right, its runs repeat."""

from __future__ import annotations

import asyncio
import math
import time
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sfglab.arp import hello
from sfglab.arp.robots import METHODS, ROBOTS
from sfglab.errors import InvalidValueError
from sfglab.lab.experiments.transmission import exp, experiment, grid
from sfglab.lab.experiments.transmission.analysis import order_of
from sfglab.lab.experiments.transmission.stage import GROUPS, compare, measure
from sfglab.lab.hosts import RadioCounters
from sfglab.lab.live_flows import Played, hosts_of, live_hosts
from sfglab.lab.workers.flowplay import Player, _Executor, text_of, value_of
from sfglab.messages import deserialize
from sfglab.qos import QoSProfile
from sfglab.rtps import CYCLONE_DDS, Drop, Fate, Flow, FlowOutcome, Medium, Outcome, Scenario, run
from sfglab.units import NS_PER_S

CHANGES = {"live_s": 0.0, "seeds": 2, "duration_s": 1.0}
CHANGES |= {
    "rates_hz": (100, 1000),
    "depths": (1, 1000),
    "methods": ("none", "OPT", "LC", "OPT+LC"),
}
SMALL = exp.config("smoke", **CHANGES)
CELLS = len(grid(SMALL)) * SMALL.seeds


def point(**changes):
    usual = {"rate_max_hz": 100, "depth": "10", "method": "none", "duration_s": 2.0}
    return hello.GridCell(**usual | changes)


def test_the_flows_are_sixteen_sensors_and_hello_there_and_back():
    flows = hello.scenario_of(point()).flows
    assert len(flows) == sum(map(len, ROBOTS.values())) + 2 == 18
    by_name = {flow.name: flow for flow in flows}
    assert by_name[hello.HELLO_UP].then == hello.HELLO_DOWN
    down = by_name[hello.HELLO_DOWN]
    assert (down.source, down.target) == ("station", "robot1")
    assert all(flow.target == "station" for flow in flows if flow.name != hello.HELLO_DOWN)


@pytest.mark.parametrize("method", METHODS)
def test_a_method_sets_rate_and_caches_and_nothing_else(method):
    flows = hello.scenario_of(point(method=method)).flows
    sensors = [flow for flow in flows if flow.change_s]
    assert len(sensors) == 16
    assert {flow.cached for flow in sensors} == {METHODS[method].local_cache}
    assert {flow.compare_s is not None for flow in sensors} == {METHODS[method].cache_control}
    assert not any(flow.cached for flow in flows if not flow.change_s), "no hello repeats another"
    rate_hz = hello.balance_of(100).rate_hz if METHODS[method].optimised else 100
    assert {flow.rate_hz for flow in flows if flow.name != hello.HELLO_DOWN} == {rate_hz}


def test_the_depth_opt_is_eq_6_for_the_topics_that_there_are():
    # Topics of the agents: 6 sensors, hello and its answer; 5; 5. T_avg = 6, Rmin = Dmin = 1.
    rate_hz, depth = hello.rate_and_depth(point(method="OPT", depth="opt", rate_max_hz=500))
    assert rate_hz == pytest.approx(500 / 6 - 1)
    assert depth == int(5000 * (500 / 6 - 1) / 500 - 1)


def test_on_a_quiet_air_hello_takes_two_ways_and_two_services():
    quiet = Medium(loss=0.0, rate_bps=1e12, overhead_s=1e-6)
    scenario = hello.scenario_of(point(depth="1000"), medium=quiet)
    latency = hello.hello_latency_ms(run(scenario, seed=0))
    assert len(latency) == 200
    services_ms = 0.18 + 0.06
    assert np.quantile(latency, 0.1) == pytest.approx(services_ms, abs=0.02)


def outcome(fate, *, name="a", dropped=0, times_ns=0):
    """Return what became of a flow's samples; what is one number is the same for all of them."""
    columns = np.broadcast_arrays(
        np.array(fate, np.int8), np.array(dropped, np.int8), np.array(times_ns)
    )
    fate, dropped, times_ns = (column.copy() for column in columns)
    value = np.ones(len(fate), np.int32)
    return FlowOutcome(
        name=name,
        published_ns=times_ns,
        received_ns=times_ns + 1,
        value=value,
        fate=fate,
        dropped=dropped,
    )


def test_every_lost_hello_is_counted_where_it_was_lost():
    fates = (Fate.DELIVERED, *(Fate.OVERWRITTEN,) * 3, Fate.LATE, Fate.UNDERWAY)
    dropped = (Drop.MEDIUM, Drop.MEDIUM, Drop.QUEUE, Drop.QUEUE, Drop.NOT, Drop.MEDIUM)
    up = outcome(fates, dropped=dropped)
    down = outcome((Fate.OVERWRITTEN,), dropped=Drop.MEDIUM)
    whole = run(hello.scenario_of(point(duration_s=0.1)), seed=0)
    both = replace(whole, flows={hello.HELLO_UP: up, hello.HELLO_DOWN: down})
    lost = {"lost_medium": 2, "lost_queue": 2, "lost_late": 1, "lost_underway": 1}
    assert experiment.hello_losses(both) == lost


@pytest.mark.parametrize("cell", grid(SMALL)[::5], ids=str)
def test_no_hello_is_counted_twice_or_forgotten(cell):
    row = experiment.simulate_cell(cell, 1)
    lost = row["lost_medium"] + row["lost_queue"] + row["lost_late"] + row["lost_underway"]
    assert row["arrived"] + lost == row["published"]
    assert row["sensor_published"] + row["sensor_held"] == row["sensor_values"]


def test_up_to_date_is_what_is_expected_of_a_perfect_and_of_a_dead_link():
    flow = Flow(name="a", source="r", target="s", rate_hz=10, phase_s=0.0, change_s=2.0)
    times_ns = np.rint(np.arange(0, 10, 0.1) * NS_PER_S).astype(np.int64)
    perfect, dead = (
        outcome(fate, times_ns=times_ns) for fate in (Fate.DELIVERED, Fate.OVERWRITTEN)
    )
    # Between readings a value lives on with probability exp(-t / 2 s).
    expected = 2.0 / 0.1 * (1 - np.exp(-0.1 / 2.0))
    assert experiment.up_to_date(flow, perfect, duration_s=10) == pytest.approx(expected, rel=1e-3)
    assert experiment.up_to_date(flow, dead, duration_s=10) == 0


def test_our_plan_fits_the_air_and_depends_on_what_changes():
    chosen = experiment.own_plan(point(rate_max_hz=1000, duration_s=1.0))
    assert chosen.utilisation < 0.91
    assert chosen["robot1/lidar"].rate_hz > 3 * chosen["robot1/flame"].rate_hz
    assert max(part.depth for part in chosen.topics) < 20


@pytest.mark.parametrize(
    ("best", "small", "deep", "wins", "worst"),
    [(0.1, 0.9, 0.8, True, True), (0.3, 0.9, 0.8, False, True), (0.1, 0.8, 0.9, True, False)],
)
def test_the_order_is_judged_by_winner_and_by_loser(best, small, deep, wins, worst):
    medians = [
        *(("opt", "OPT+LC", best), ("1", "none", small), ("1000", "none", deep)),
        *(("opt", "OPT", 0.2), ("10", "LC", 0.2)),
        ("1", "OPT", 0.0),  # not the depth that OPT chooses: no rival
    ]
    judged = order_of(pd.DataFrame(medians, columns=["depth", "method", "median"]))
    assert (bool(judged["wins"]), bool(judged["small_is_worst"])) == (wins, worst)


@pytest.mark.slow
def test_a_run_repeats_to_the_byte_and_fills_its_claims(tmp_path):
    paths = [tmp_path / name / "a.mcap" for name in ("one", "two")]
    one, two = (asyncio.run(exp.run("smoke", path=path, **CHANGES)) for path in paths)
    assert all(one.table(name).equals(two.table(name)) for name in ("cell", "lossless", "beyond"))
    assert len(one["cell"]) == CELLS
    assert len(one["beyond"]) == 2 * len(experiment.WAYS) * SMALL.seeds
    assert one.skipped("live") == "not asked for"
    measured = exp.measure(one)
    assert set(measured) == {"B-TAB2", "B-LAT", "B-LOSS"}
    assert measured["B-TAB2"].estimate.value == pytest.approx(len(grid(SMALL)) / 196)
    assert len(exp.figures(one)) == 6


def test_bad_points_are_refused_with_the_place():
    with pytest.raises(InvalidValueError, match="method: given 'best'"):
        point(method="best")
    with pytest.raises(InvalidValueError, match="depth: given '0'"):
        point(depth="0")


CALM = Medium(rate_bps=1e8, loss=0.0, overhead_s=50e-6)


@given(
    size_bytes=st.integers(min_value=14, max_value=200),
    value=st.integers(min_value=0, max_value=64**5 - 1),
)
def test_a_sample_has_its_size_and_carries_its_value(size_bytes, value):
    cdr = text_of(value, size_bytes)
    assert len(cdr) == size_bytes
    assert value_of(cdr) == value
    assert len(deserialize(cdr, "std_msgs/msg/String").data) == size_bytes - 9


def outcome_of_losses(lost_up: int, lost_down: int) -> Outcome:
    """Return a run of the model with known losses: of ten "Hello"s, and of ten samples of a sensor."""
    up = {"source": "robot1", "target": "station", "rate_hz": 10}
    flows = (
        Flow(name="robot1/lidar", **up),
        Flow(name=hello.HELLO_UP, then=hello.HELLO_DOWN, **up),
        Flow(name=hello.HELLO_DOWN, source="station", target="robot1"),
    )
    outcome = run(
        Scenario(flows=flows, medium=replace(CALM, latency_s=1e-3), duration_s=1.0), seed=1
    )
    outcome.flows[hello.HELLO_UP].fate[:lost_up] = Fate.UNDERWAY
    outcome.flows[hello.HELLO_DOWN].fate[: lost_up + lost_down] = Fate.UNDERWAY
    return outcome


POINT = point(duration_s=1.0)


def played(outcome: Outcome, **changes) -> Played:
    """Return what was played without delay, refusal and lateness, but for changes."""
    usual = {
        "delay_s": 0.0,
        "radio": RadioCounters(delivered=100, late_after_s=2e-3),
        "late_p95_s": 0.0,
    }
    return Played(scenario=hello.scenario_of(POINT), outcome=outcome, refused=0, **usual | changes)


def test_losses_and_latencies_are_those_of_their_group():
    outcome = outcome_of_losses(1, 2)
    assert [measure(outcome, group)["loss"] for group in GROUPS] == pytest.approx([0.0, 0.1, 0.3])
    up_ms, round_ms = (measure(outcome, group)["p50_ms"] for group in ("hello_up", "hello"))
    assert 1.0 < up_ms < 1.3
    assert round_ms == pytest.approx(2 * up_ms, rel=0.1)


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


def test_a_sample_that_was_sent_while_its_reader_had_no_cpu_is_received_after_it_was_sent():
    samples = [(time.time_ns(), 1), None]
    inlet = SimpleNamespace(
        flow=Flow(name="a", source="r", target="s"), since_ns=1, sent_ns=[], done_ns=[]
    )
    inlet.take, inlet.cost_ns = lambda: samples.pop(0), lambda _value, _now_ns: 0
    Player._serve(SimpleNamespace(), _Executor([inlet]), now_ns=2)
    assert inlet.done_ns[0] > inlet.sent_ns[0]


# --- Live -----------------------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.netns
async def test_flows_caches_and_chains_run_live_as_in_the_model():
    # Depth for all samples: a process that gets no CPU for a tenth of a second sends more than ten at once.
    flow = {"source": "robot", "target": "station", "rate_hz": 100.0, "qos": QoSProfile(depth=100)}
    scenario = Scenario(
        flows=(
            Flow(name="plain", **flow),
            Flow(name="cached", change_s=0.1, cached=True, phase_s=1e-3, **flow),
            Flow(
                name="compared", change_s=0.1, compare_s=1e-5, service_s=1e-4, phase_s=2e-3, **flow
            ),
            Flow(name="hello", size_bytes=14, then="move", phase_s=3e-3, **flow),
            Flow(name="move", size_bytes=14, source="station", target="robot", qos=flow["qos"]),
        ),
        medium=CALM,
        vendor=CYCLONE_DDS,
        duration_s=1.0,
        drain_s=3.0,
    )
    lossy = replace(scenario, medium=replace(CALM, loss=0.3), flows=scenario.flows[:1])
    async with live_hosts(*hosts_of(scenario)) as hosts:
        live, worse = [await hosts.play(one, seed=3) for one in (scenario, lossy)]
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
