"""The transmission experiment: the order of methods, the grid of Table 2, live cells and the explorer."""

from __future__ import annotations

import time
from collections import deque
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st
from made_logs import ran, reference

from sfglab.arp import hello
from sfglab.arp.cache import CacheControl
from sfglab.lab.experiments.transmission import exp, results
from sfglab.lab.experiments.transmission.experiment import grid, simulate_cell
from sfglab.lab.experiments.transmission.live import GROUPS, compare, live_cells, measure
from sfglab.lab.hosts import RadioCounters
from sfglab.lab.live_flows import Played, hosts_of, live_hosts
from sfglab.lab.workers.scenario_player import Player, _Executor, _Inlet, text_of, value_of
from sfglab.messages import deserialize
from sfglab.qos import Durability, QoSProfile
from sfglab.rtps import CYCLONE_DDS, Fate, Flow, Medium, Outcome, Scenario, run

NO_LIVE = {"live_s": 0.0, "seeds": 1, "duration_s": 0.5, "rates_hz": (1000,)}
SMALL = exp.config("smoke", depths=(1,), methods=("none", "OPT+LC"), **NO_LIVE)
CALM = Medium(rate_bps=1e8, loss=0.0, overhead_s=50e-6)


@pytest.mark.parametrize(
    ("best", "small", "deep", "wins", "worst"),
    [(0.1, 0.9, 0.8, True, True), (0.3, 0.9, 0.8, False, True), (0.1, 0.8, 0.9, True, False)],
)
def test_the_order_is_judged_by_winner_and_by_loser(best, small, deep, wins, worst):
    medians = [
        *(("opt", "OPT+LC", best), ("1", "none", small), ("1000", "none", deep)),
        *(("opt", "OPT", 0.2), ("10", "LC", 0.4)),
        ("1", "OPT", 0.0),  # not the depth that OPT chooses: no rival
    ]
    table = pd.DataFrame(medians, columns=["depth", "method", "median"])
    judged = results.order_of(table)
    assert (bool(judged["wins"]), bool(judged["small_is_worst"])) == (wins, worst)
    assert not results.order_of(table[table["method"] == "none"])["wins"]


RIGHT = {"rate_max_hz": 100, "depth": "10", "method": "none", "rate_hz": 100.0}
RIGHT |= {"history_depth": 10, "published": 100}
OPTIMUM = {**RIGHT, "method": "OPT", "depth": "opt", "rate_hz": 100 / 6 - 1}
OPTIMUM |= {"history_depth": 782, "published": 16}


@pytest.mark.parametrize("row", [RIGHT, OPTIMUM])
def test_a_cell_counts_with_the_rate_the_depth_and_the_messages_of_table_2_alone(row):
    wrong = [{"rate_hz": 100.1}, {"history_depth": 11}, {"published": 98}]
    table = pd.DataFrame([row, *({**row, **change} for change in wrong)])
    assert results.as_in_table_2(table, 1.0).tolist() == [True, False, False, False]


@pytest.mark.parametrize("change", [{"durability": Durability.TRANSIENT_LOCAL}, {"depth": 11}])
def test_a_cell_whose_flow_has_other_policies_than_table_2s_is_found(monkeypatch, change):
    assert results.other_policies(SMALL) == []

    def changed(cell):
        scenario = hello.scenario_of(cell)
        first, *others = scenario.flows
        flow = replace(first, qos=replace(first.qos, **change))
        return replace(scenario, flows=(flow, *others))

    monkeypatch.setattr(results, "scenario_of", changed)
    assert results.other_policies(SMALL) == grid(SMALL)


def test_what_was_not_run_is_said_and_does_not_count(tmp_path):
    run = ran(exp, tmp_path / "a.mcap", depths=(1,), methods=("none", "OPT+LC"), **NO_LIVE)
    assert run.skipped("live") == run.skipped("validation") == "not asked for"
    assert exp.measure(run)["B-TAB2"].estimate.value == pytest.approx(len(grid(SMALL)) / 196)


def test_a_cell_of_the_log_is_simulated_again_from_its_row():
    rows = reference(exp)["cell"].query("rate_max_hz == 100 and method == 'OPT+LC'")
    row = next(rows.itertuples())
    cell = hello.GridCell(rate_max_hz=100, depth=row.depth, method=row.method, duration_s=60.0)
    again = simulate_cell(cell, row.seed)
    assert {name: getattr(row, name) for name in again} == pytest.approx(again, nan_ok=True)


# --- Live cells beside the model --------------------------------------------------------------


def outcome_of_losses(lost_up: int, lost_down: int) -> Outcome:
    """Return a run of the model with known losses: of ten "Hello"s, and of ten samples of a sensor."""
    up = {"source": "robot1", "target": "station", "rate_hz": 10}
    flows = (
        Flow(name="robot1/lidar", **up),
        Flow(name=hello.HELLO_UP, then=hello.HELLO_DOWN, **up),
        Flow(name=hello.HELLO_DOWN, source="station", target="robot1"),
    )
    scenario = Scenario(flows=flows, medium=replace(CALM, latency_s=1e-3), duration_s=1.0)
    outcome = run(scenario, seed=1)
    outcome.flows[hello.HELLO_UP].fate[:lost_up] = Fate.UNDERWAY
    outcome.flows[hello.HELLO_DOWN].fate[: lost_up + lost_down] = Fate.UNDERWAY
    return outcome


def test_losses_and_latencies_are_those_of_their_group():
    measured = [measure(outcome_of_losses(1, 2), group) for group in GROUPS]
    losses, (_, up_ms, round_ms) = zip(*measured, strict=True)
    assert losses == pytest.approx([0.0, 0.1, 0.3])
    assert 1.0 < up_ms < 1.3
    assert round_ms == pytest.approx(2 * up_ms, rel=0.1)


@pytest.mark.parametrize(
    ("live", "model", "agrees"),
    [
        ((0.03, 10.0), (0.0, 7.0), [True, True]),
        ((0.031, 10.0), (0.0, 6.9), [False, False]),
        ((0.0, np.nan), (0.0, 10.0), [True, False]),
    ],
)
def test_three_points_and_thirty_percent_agree_and_nothing_agrees_with_no_latency(
    live, model, agrees
):
    columns = ["loss_live", "p50_live_ms", "loss_model", "p50_model_ms"]
    table = results.agreeing(pd.DataFrame([[*live, *model]], columns=columns))
    assert table[["loss_agrees", "latency_agrees"]].iloc[0].tolist() == agrees


@pytest.mark.parametrize(
    ("late", "late_p95_s", "kept_up"), [(0, 0.0, True), (2, 0.0, False), (0, 3e-3, False)]
)
def test_a_cell_that_did_not_keep_its_schedule_is_marked(late, late_p95_s, kept_up):
    scenario, radio = hello.scenario_of(grid(SMALL)[0]), RadioCounters(delivered=100, late=late)
    outcome = outcome_of_losses(0, 1)
    played = Played(scenario=scenario, outcome=outcome, radio=radio, late_p95_s=late_p95_s)
    row = compare(played, [outcome_of_losses(0, 2)], "hello")
    assert row["kept_up"] is kept_up
    assert (row["loss_live"], row["loss_model"]) == pytest.approx((0.1, 0.2))


def test_live_cells_agree_in_latency_and_but_for_a_saturated_one_in_loss():
    table = results.agreeing(reference(exp)["live"])
    assert table["latency_agrees"].all()
    differing = table[~table["loss_agrees"]][["method", "rate_max_hz", "depth"]].drop_duplicates()
    assert differing.to_numpy().tolist() == [["none", 200, "1000"]]
    figure, _ = exp.draw("transmission_live", reference(exp))
    assert "14 of 14 trials" in figure.get_supxlabel()


def test_optimised_methods_have_the_depth_of_eq_6_live_as_well():
    cells = live_cells(exp.config("quick"))
    assert {cell.method for cell in cells if cell.depth == "opt"} == {"OPT+LC"}
    assert len({cell.depth for cell in cells}) > 1
    assert live_cells(SMALL) == []


@given(size_bytes=st.integers(14, 200), value=st.integers(0, 64**5 - 1))
def test_a_sample_has_its_size_and_carries_its_value(size_bytes, value):
    cdr = text_of(value, size_bytes)
    assert len(cdr) == size_bytes
    assert value_of(cdr) == value % 10 ** (size_bytes - 9)
    assert len(deserialize(cdr, "std_msgs/msg/String").data) == size_bytes - 9


def test_a_sample_that_was_sent_while_its_reader_had_no_cpu_is_received_after_it_was_sent():
    samples = [(time.time_ns(), 1), None]
    flow = Flow(name="a", source="r", target="s")
    inlet = SimpleNamespace(flow=flow, since_ns=1, sent_ns=[], done_ns=[])
    inlet.take, inlet.cost_ns = lambda: samples.pop(0), lambda _value, _now_ns: 0
    Player._serve(SimpleNamespace(), _Executor(deque([inlet])), now_ns=2)
    assert inlet.done_ns[0] > inlet.sent_ns[0]


def test_cache_control_compares_repeated_values_instead_of_serving_them():
    flow = Flow(name="a", source="r", target="s", compare_s=1e-5, service_s=1e-4)
    inlet = SimpleNamespace(flow=flow, _cache=CacheControl())
    costs_ns = [_Inlet.cost_ns(inlet, value, now_ns) for now_ns, value in enumerate((1, 1, 2))]
    assert costs_ns == [100_000, 10_000, 100_000]


@pytest.mark.slow
@pytest.mark.netns
async def test_flows_caches_and_chains_run_live_as_in_the_model():
    # A process that gets no CPU for a tenth of a second sends more than ten samples at once.
    flow = {"source": "robot", "target": "station", "rate_hz": 100.0, "qos": QoSProfile(depth=100)}
    compared = {"change_s": 0.1, "compare_s": 1e-5, "service_s": 1e-4}
    flows = (
        Flow(name="plain", **flow),
        Flow(name="cached", change_s=0.1, cached=True, phase_s=1e-3, **flow),
        Flow(name="compared", phase_s=2e-3, **compared, **flow),
        Flow(name="hello", size_bytes=14, then="move", phase_s=3e-3, **flow),
        Flow(name="move", size_bytes=14, source="station", target="robot", qos=flow["qos"]),
    )
    scenario = Scenario(flows=flows, medium=CALM, vendor=CYCLONE_DDS, duration_s=1.0, drain_s=3.0)
    async with live_hosts(*hosts_of(scenario)) as hosts:
        live = await hosts.play(scenario, seed=3)
    found = live.outcome.flows
    assert [outcome.loss for outcome in found.values()] == [0.0] * len(flows)
    assert [len(found[name].fate) for name in ("plain", "compared", "hello", "move")] == [100] * 4
    assert 1 < len(found["cached"].fate) == len(np.unique(found["cached"].value)) < 40
    assert (found["move"].value == found["hello"].value).all()
    assert (found["move"].published_ns >= found["hello"].received_ns).all()


# --- Explorer ---------------------------------------------------------------------------------


def test_an_explorer_that_is_left_begins_no_further_cell(monkeypatch):
    begun = []

    def simulate(cell, seed):
        begun.append(cell)
        time.sleep(0.1)

    monkeypatch.setattr(results, "simulate_cell", simulate)
    cells = results.hello_over_depth(rate_max_hz=50)
    next(cells)
    cells.close()
    assert len(begun) < 14, "of 28 cells"


def test_the_explorer_can_be_left_and_shows_a_coarse_picture_and_then_the_whole_one():
    # Between cells it yields nothing.
    began, *others = results.hello_over_depth(rate_max_hz=50)
    assert began is None
    coarse, whole = [picture for picture in others if picture]
    assert "simulated for 1 s" in coarse.said
    assert "simulated for 20 s" in whole.said
    used = whole.at("channel utilisation", 10).set_index("series")["y"]
    assert used["both (OPT+LC)"] < used["balanced QoS (OPT)"] < used["no method"]
