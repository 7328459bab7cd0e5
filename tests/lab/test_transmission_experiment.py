"""The transmission experiment: its flows are the paper's, its arithmetic is right, its runs repeat."""

from __future__ import annotations

import asyncio
import sys
from dataclasses import asdict, replace

import numpy as np
import pandas as pd
import pytest

from sfglab.arp.robots import METHODS, ROBOTS
from sfglab.lab.experiments import transmission
from sfglab.lab.experiments.profiles import ConfigError
from sfglab.lab.experiments.transmission.beyond import WAYS, own_plan, up_to_date
from sfglab.lab.experiments.transmission.cell import hello_latency_ms, hello_losses, simulate_cell
from sfglab.lab.experiments.transmission.config import Config, Point, grid
from sfglab.lab.experiments.transmission.scenario import (
    HELLO_DOWN,
    HELLO_UP,
    balance_of,
    rate_and_depth,
    scenario_of,
)
from sfglab.record import LogReader
from sfglab.rtps import Drop, Fate, Flow, FlowOutcome, Medium, run

S = 1_000_000_000
SMALL = replace(
    Config.of_profile("smoke"),
    live_s=0.0,
    seeds=2,
    duration_s=1.0,
    rates_hz=(100, 1000),
    depths=(1, 1000),
    methods=("none", "OPT", "LC", "OPT+LC"),
)


def point(**changes):
    return Point(**{"rate_max_hz": 100, "depth": "10", "method": "none", "duration_s": 2.0, **changes})


def test_the_flows_are_sixteen_sensors_and_hello_there_and_back():
    flows = scenario_of(point()).flows
    assert len(flows) == sum(map(len, ROBOTS.values())) + 2 == 18
    by_name = {flow.name: flow for flow in flows}
    assert by_name[HELLO_UP].then == HELLO_DOWN
    assert (by_name[HELLO_DOWN].source, by_name[HELLO_DOWN].target) == ("station", "robot1")
    assert all(flow.target == "station" for flow in flows if flow.name != HELLO_DOWN)


@pytest.mark.parametrize("method", METHODS)
def test_a_method_sets_rate_and_caches_and_nothing_else(method):
    flows = scenario_of(point(method=method)).flows
    sensors = [flow for flow in flows if flow.change_s]
    assert len(sensors) == 16
    assert {flow.cached for flow in sensors} == {METHODS[method].local_cache}
    assert {flow.compare_s is not None for flow in sensors} == {METHODS[method].cache_control}
    assert not any(flow.cached for flow in flows if not flow.change_s), "no hello repeats another"
    rate_hz = balance_of(100).rate_hz if METHODS[method].optimised else 100
    assert {flow.rate_hz for flow in flows if flow.name != HELLO_DOWN} == {rate_hz}


def test_the_depth_opt_is_eq_6_for_the_topics_that_there_are():
    # Topics of the agents: 6 sensors, hello and its answer; 5; 5. T_avg = 6, Rmin = Dmin = 1.
    rate_hz, depth = rate_and_depth(point(method="OPT", depth="opt", rate_max_hz=500))
    assert rate_hz == pytest.approx(500 / 6 - 1)
    assert depth == int(5000 * (500 / 6 - 1) / 500 - 1)


def test_on_a_quiet_air_hello_takes_two_ways_and_two_services():
    scenario = scenario_of(point(depth="1000"), medium=Medium(loss=0.0, rate_bps=1e12, overhead_s=1e-6))
    latency = hello_latency_ms(run(scenario, seed=0))
    assert len(latency) == 200
    services_ms = 0.18 + 0.06
    assert np.quantile(latency, 0.1) == pytest.approx(services_ms, abs=0.02)


def fates(name, *pairs):
    fate, dropped = (np.array(column, np.int8) for column in zip(*pairs, strict=True))
    zeros = np.zeros(len(pairs), np.int64)
    return FlowOutcome(
        name=name,
        published_ns=zeros,
        received_ns=zeros,
        value=zeros.astype(np.int32),
        fate=fate,
        dropped=dropped,
    )


def test_every_lost_hello_is_counted_where_it_was_lost():
    up = fates(
        HELLO_UP,
        (Fate.DELIVERED, Drop.MEDIUM),
        (Fate.OVERWRITTEN, Drop.MEDIUM),
        (Fate.OVERWRITTEN, Drop.QUEUE),
        (Fate.OVERWRITTEN, Drop.QUEUE),
        (Fate.LATE, Drop.NOT),
        (Fate.UNDERWAY, Drop.MEDIUM),
    )
    down = fates(HELLO_DOWN, (Fate.OVERWRITTEN, Drop.MEDIUM))
    outcome = replace(run(scenario_of(point(duration_s=0.1)), seed=0), flows={HELLO_UP: up, HELLO_DOWN: down})
    assert hello_losses(outcome) == {"lost_medium": 2, "lost_queue": 2, "lost_late": 1, "lost_underway": 1}


@pytest.mark.parametrize("cell", grid(SMALL)[::5], ids=str)
def test_no_hello_is_counted_twice_or_forgotten(cell):
    row = simulate_cell(cell, 1)
    lost = row.lost_medium + row.lost_queue + row.lost_late + row.lost_underway
    assert row.arrived + lost == row.published
    assert row.sensor_published + row.sensor_held == row.sensor_values


def test_up_to_date_is_what_is_expected_of_a_perfect_and_of_a_dead_link():
    flow = Flow(name="a", source="r", target="s", rate_hz=10, phase_s=0.0, change_s=2.0)
    times = np.arange(0, 10, 0.1)
    perfect = FlowOutcome(
        name="a",
        published_ns=np.rint(times * S).astype(np.int64),
        received_ns=np.rint(times * S).astype(np.int64) + 1,
        value=np.ones(100, np.int32),
        fate=np.full(100, Fate.DELIVERED, np.int8),
        dropped=np.zeros(100, np.int8),
    )
    # Between readings a value lives on with probability exp(-t / 2 s).
    expected = 2.0 / 0.1 * (1 - np.exp(-0.1 / 2.0))
    assert up_to_date(flow, perfect, duration_s=10) == pytest.approx(expected, rel=1e-3)
    dead = replace(perfect, fate=np.full(100, Fate.OVERWRITTEN, np.int8))
    assert up_to_date(flow, dead, duration_s=10) == 0


def test_our_plan_fits_the_air_and_depends_on_what_changes():
    chosen = own_plan(1000)
    assert chosen.utilisation < 0.91
    assert chosen["robot1/lidar"].rate_hz > 3 * chosen["robot1/flame"].rate_hz
    assert max(part.depth for part in chosen.topics) < 20


def cell_table(medians):
    keys = ["rate_max_hz", "depth", "method"]
    rows = [dict(zip(keys, key, strict=True), loss=value) for key, value in medians.items()]
    table = pd.DataFrame(rows)
    return transmission.analysis.Results(
        cells=table, lossless=table, beyond=pd.DataFrame(), live=pd.DataFrame(), hindrance="", config={}
    )


@pytest.mark.parametrize(
    ("best", "small", "deep", "wins", "worst"),
    [(0.1, 0.9, 0.8, True, True), (0.3, 0.9, 0.8, False, True), (0.1, 0.8, 0.9, True, False)],
)
def test_the_order_is_judged_by_winner_and_by_loser(best, small, deep, wins, worst):
    medians = {
        (100, "opt", "OPT+LC"): best,
        (100, "1", "none"): small,
        (100, "1000", "none"): deep,
        (100, "opt", "OPT"): 0.2,
        (100, "10", "LC"): 0.2,
        (100, "1", "OPT"): 0.0,  # not the depth that OPT chooses: no rival
    }
    line = transmission.order(cell_table(medians), "loss").iloc[0]
    assert (bool(line["wins"]), bool(line["small_is_worst"])) == (wins, worst)


def test_a_run_repeats_to_the_byte_and_goes_on_from_its_journal(tmp_path):
    logs = [asyncio.run(transmission.run(SMALL, tmp_path / name / "a.mcap")) for name in ("one", "two")]
    tables = []
    for log in logs:
        with LogReader(log) as reader:
            tables.append([reader.table(name) for name in ("cell", "beyond")])
    for first, second in zip(*tables, strict=True):
        assert first.equals(second)
    assert len(tables[0][0]) == len(grid(SMALL)) * SMALL.seeds
    assert len(tables[0][1]) == 2 * len(WAYS) * SMALL.seeds
    measured = transmission.measure_claims(logs[0])
    assert set(measured) == {"B-TAB2", "B-LAT", "B-LOSS"}
    assert measured["B-TAB2"].estimate.value == pytest.approx(len(grid(SMALL)) / 196)
    assert {f.split("_")[0] for f in transmission.figures(logs[0])} == {"transmission"}


def test_an_interrupted_run_goes_on_in_another_log_and_leaves_no_journal(tmp_path, monkeypatch):
    def interrupt(*_):
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        # The package's `run` is the function, not the module.
        patch.setattr(sys.modules[transmission.run.__module__], "_run_live", interrupt)
        with pytest.raises(KeyboardInterrupt):
            asyncio.run(transmission.run(SMALL, tmp_path / "20260101-smoke.mcap"))
    assert len(list(tmp_path.glob("*.journal"))) == 3
    # Whoever has nothing left to do asks for no workers.
    monkeypatch.setattr("sfglab.lab.sweep.run.connected", interrupt)
    log = asyncio.run(transmission.run(SMALL, tmp_path / "20260102-smoke.mcap"))
    assert len(transmission.load_results(log).cells) == len(grid(SMALL)) * SMALL.seeds
    assert [path.name for path in tmp_path.iterdir()] == [log.name]


def test_bad_points_are_refused_with_the_place():
    with pytest.raises(ConfigError, match="method: given 'best'"):
        point(method="best")
    with pytest.raises(ConfigError, match="depth: given '0'"):
        point(depth="0")
    with pytest.raises(ConfigError, match="profile: given 'long'"):
        Config.of_profile("long")
    assert asdict(Config.of_profile("paper"))["seeds"] == 30
