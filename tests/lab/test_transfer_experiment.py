"""The transfer experiment: its rows are the model's, its claims stand, and parts that are missing are said."""

import asyncio
import math
import os
import signal
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import psutil
import pytest
from made_logs import CLAIMS

from sfglab.lab.checks.placement import cost_s, greedy_placement, platform_for, random_graph
from sfglab.lab.experiments.transfer import exp, stage
from sfglab.lab.experiments.transfer.analysis import (
    bars,
    bars_of,
    live_speed_up,
    rtl_residual,
    stated,
)
from sfglab.lab.experiments.transfer.experiment import CrossingRow
from sfglab.lab.experiments.transfer.live import Crossing, cells_of, crossings
from sfglab.lab.experiments.transfer.stage import IN, MODELS, OUT, READS, WRITE, bars_with_cycles
from sfglab.lab.workers.crossing import Round, message_of, random_bytes
from sfglab.processes import ProcessFailedError
from sfglab.soc import TopicMapping, place_nodes
from sfglab.soc.memory import STORED, constants
from sfglab.soc.paper_values import (
    MESSAGE_BYTES,
    SUBSCRIBERS,
    Panel,
    residuals,
    speed_ups,
    tendencies,
)


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """One whole run, live part and all."""
    return asyncio.run(exp.run("smoke", path=tmp_path_factory.mktemp("transfer") / "a.mcap"))


def test_figures_are_in_their_claims_units_beside_what_was_fitted_and_measured_live(run):
    measured = exp.measure(run)
    assert all(CLAIMS[name].unit == found.estimate.unit for name, found in measured.items())
    details = measured["C-HWSW"].details
    assert details["fit"].startswith("6 constants to 7 stated numbers")
    assert "2 readers, 10000 B" in details["live"]


@pytest.mark.parametrize("model", MODELS)
def test_bars_residuals_and_tendencies_are_the_model_s(run, model):
    costs = MODELS[model]
    found = bars(run)[bars(run)["model"] == model]
    assert list(found["ratio"]) == [bar.ratio for bar in speed_ups(costs)]
    numbers = stated(run)[stated(run)["model"] == model]
    assert list(numbers["residual"]) == [item.relative for item in residuals(costs)]
    told = run["tendency"][run["tendency"]["model"] == model]
    assert list(told["holds"]) == [holds for _, holds in tendencies(costs)]
    table = run["constant"][run["constant"]["model"] == model]
    assert list(table["value"]) == [item.value for item in constants(costs)]


def test_curves_are_those_of_the_run_s_own_constants(run):
    own = stage.costs_of(run.config)
    assert [c.value for c in constants(own)] == pytest.approx([c.value for c in constants(STORED)])
    turned = replace(run.config, endpoint_us=1.0, read_latency_cycles=60.0)
    assert stage.costs_of(turned).endpoint_s == pytest.approx(1e-6)
    assert stage.costs_of(turned).memory.read_latency_cycles == 60.0
    at = run["curve"][run["curve"]["message_bytes"] == run.config.message_bytes]
    assert set(at["subscribers"]) == {run.config.subscribers}
    expected = speed_ups(
        subscribers=[run.config.subscribers], sizes_bytes=[run.config.message_bytes]
    )
    assert at["smt_s"].tolist() == pytest.approx([one.smt_s for one in expected])


def test_the_committed_constants_are_what_the_run_s_own_fits_find(run):
    assert (run["refit"]["farthest"] > 1.5).all()
    assert (run["refit"].groupby("model")["shift"].min() < 0.001).all()
    fitted = run["constant"]
    assert np.allclose(fitted["refitted"], fitted["value"], rtol=0.001)


def test_the_simulated_hardware_takes_the_model_s_cycles(run):
    pytest.importorskip("amaranth", reason="the extra rtl is not installed")
    assert set(run["cycles"]["path"]) == {OUT, IN, READS, WRITE}
    ran = run["cycles"][run["cycles"]["simulated"]]
    assert (ran["law_cycles"] / ran["rtl_cycles"] - 1).abs().max() < 0.002
    assert rtl_residual(run) < 0.05
    both = [bars_of(run, Panel.HARDWARE_TO_HARDWARE, model=name) for name in ("rtl", "stored")]
    rtl, model = (bars.query("subscribers == 2") for bars in both)
    assert np.allclose(rtl["ratio"], model["ratio"], rtol=0.05)


def test_cycles_that_are_the_model_s_give_the_model_s_bars():
    memory = STORED.memory
    chunk = {
        OUT: memory.read_cycles + memory.data_cycles,
        IN: memory.write_cycles + memory.data_cycles,
        READS: 4 * memory.read_cycles,
        WRITE: memory.write_cycles,
    }
    wanted = [bar for bar in speed_ups() if bar.subscribers == 4]
    found = bars_with_cycles(4, chunk)
    assert [bar["smt_s"] for bar in found] == pytest.approx([bar.smt_s for bar in wanted])
    assert [bar["gateway_s"] for bar in found] == pytest.approx([bar.gateway_s for bar in wanted])


def test_without_amaranth_the_log_says_why_and_the_rest_stands(tmp_path, monkeypatch):
    monkeypatch.setattr(stage, "find_spec", lambda _name: None)
    run = asyncio.run(exp.run("smoke", path=tmp_path / "a.mcap", live_rounds=0))
    assert set(run.metadata("missing")) == {"rtl", "synthesis"}
    measured = exp.measure(run)
    assert measured["C-HWHW"].details["RTL"].startswith("left out: amaranth is not installed")
    assert measured["C-HWHW"].details["live"] == "this bar was not measured"
    assert "transfer_live" not in exp.figures(run)


def test_a_rule_that_knows_sizes_is_never_predicted_slower_than_another(run):
    times = run["sized_mapping"].pivot_table(
        index="message_bytes", columns="rule", values="predicted_s"
    )
    assert (times["size-aware"] <= times[["paper", "none"]].min(axis=1) + 1e-12).all()
    assert (times["size-aware"] < times["paper"] - 1e-6).any()


def test_placements_are_the_best_of_all_and_not_worse_than_simpler_ones(run):
    placed = run["placed"]
    small = placed[placed["kind"] == "small"]
    assert np.allclose(small["placed"], small["brute_force"], rtol=1e-6)
    for name in ("greedy", "greedy_with_gateways", "same_without_gateways", "software"):
        assert (placed[name] >= placed["placed"] * (1 - 1e-6)).all()


def test_a_greedy_placement_fits_and_a_placed_graph_costs_what_the_programme_says():
    graph = random_graph(np.random.default_rng(3), 30)
    platform = platform_for(graph)
    chosen = greedy_placement(graph, platform)
    assert chosen
    assert chosen == greedy_placement(replace(graph, topics=()), platform)
    assert math.isfinite(cost_s(graph, chosen, (), platform))
    graph = random_graph(np.random.default_rng(1), 12)
    platform = platform_for(graph)
    found = place_nodes(graph, platform)
    gateways = tuple(found.graph.mapped_to(TopicMapping.GATEWAY))
    assert cost_s(graph, found.graph.in_hardware, gateways, platform) == pytest.approx(
        found.load.total_s
    )


def test_the_same_seed_gives_the_same_simulated_rows(tmp_path, monkeypatch):
    monkeypatch.setattr(
        stage, "what_is_missing", lambda: {"rtl": "not asked here", "synthesis": "neither"}
    )
    few = {"refits": 1, "most_subscribers": 1, "sizes": 2, "large_graphs": 0, "live_rounds": 0}
    first, again, other = (
        asyncio.run(exp.run("smoke", path=tmp_path / f"{n}.mcap", seed=seed, **few))
        for n, seed in enumerate((1, 1, 2))
    )
    assert all(first[table].equals(again[table]) for table in exp.tables if table != "placed")
    assert not first["refit"].equals(other["refit"])
    costs = [
        run["placed"].drop(columns="seconds").astype(str).to_csv() for run in (first, again, other)
    ]
    assert costs[0] == costs[1] != costs[2]


def test_known_live_times_are_found_again(run):
    cell = {"publisher": "hardware", "message_bytes": 1000, "subscribers": 4, "place": 0}
    cell |= {"software_ns": 1000, "load": 1.0}
    rows = [
        CrossingRow(**cell, repeat=repeat, transport=transport, hardware_ns=time_ns + repeat)
        for repeat in range(11)
        for transport, time_ns in (("gateway", 2000), ("smt", 6000))
    ]
    made = {"crossing": pd.DataFrame(rows)}
    found = live_speed_up(made, Panel.HARDWARE_TO_HARDWARE, 4, 1000)
    assert found.value == pytest.approx(6005 / 2005)
    assert found.low < found.value < found.high
    assert live_speed_up(made, Panel.HARDWARE_TO_SOFTWARE, 4, 1000).value == 1
    assert live_speed_up(made, Panel.SOFTWARE_TO_HARDWARE, 4, 1000) is None


@pytest.mark.parametrize("profile", ["quick", "paper"])
def test_profiles_cover_the_paper_s_twelve_configurations(profile):
    config = exp.config(profile)
    assert (config.live_bytes, config.live_subscribers) == (MESSAGE_BYTES, SUBSCRIBERS)
    assert config.rtl_subscribers == SUBSCRIBERS


BYTES = 10_000
TINY = exp.config("smoke", live_bytes=(BYTES,), live_subscribers=(2,), live_rounds=2)
ORDER = ("reader0", "subscriber", "reader1")
SMT = Round(
    publisher="software", gateway=False, message_bytes=BYTES, offset=0, order=ORDER, woken=()
)


def descriptors():
    return len(os.listdir("/proc/self/fd"))  # noqa: PTH208 - what the kernel lists, counted


@pytest.fixture
def nothing_left():
    """No process of ours lives on, and no descriptor or named memory is left."""
    before, children = descriptors(), set(psutil.Process().children())
    yield
    assert set(psutil.Process().children()) <= children
    assert not list(Path("/dev/shm").glob("*sfglab*"))
    assert descriptors() <= before


@pytest.mark.live
@pytest.mark.usefixtures("nothing_left")
async def test_every_cell_is_measured_both_ways_in_every_repetition():
    rows = [row async for row in crossings(TINY)]
    seen = [(row["repeat"], row["publisher"], row["transport"]) for row in rows]
    wanted = {
        (r, p, t) for r in range(2) for p in ("software", "hardware") for t in ("smt", "gateway")
    }
    assert set(seen) == wanted
    assert len(seen) == len(wanted) == 2 * 2 * len(cells_of(TINY))
    assert all(row["hardware_ns"] > 0 and row["software_ns"] > 0 for row in rows)


@pytest.mark.live
@pytest.mark.usefixtures("nothing_left")
async def test_a_message_that_is_not_the_published_one_is_noticed():
    said = "reader0, reader1, subscriber did not get what was published"
    with pytest.raises(ProcessFailedError, match=said):  # noqa: PT012 - it is raised by the second
        async with Crossing(2, BYTES, seed=0) as crossing:
            await crossing.carry(SMT)
            crossing._data = random_bytes(BYTES, seed=1)
            await crossing.carry(replace(SMT, offset=8))


@pytest.mark.live
def test_two_rounds_carry_different_words_everywhere():
    data = random_bytes(BYTES, seed=0)
    one, other = (message_of(data, replace(SMT, offset=offset)) for offset in (0, 8))
    words = [view.cast("Q") for view in (one, other)]
    assert all(a != b for a, b in zip(*words, strict=True))


_PARENT = """
import asyncio, dataclasses, sys
from sfglab.lab.experiments.transfer.live import Crossing

async def main():
    async with Crossing(2, 10_000, seed=0) as crossing:
        crossing["reader0"].order(do="round", publisher="software", gateway=False, message_bytes=8,
                                         offset=0, order=["reader0"], woken=[])
        await crossing["reader0"].expect("armed", timeout_s=60)
        print(*(crossing[name].pid for name in crossing), flush=True)
        await asyncio.sleep(60)

asyncio.run(main())
"""


@pytest.mark.live
def test_processes_end_when_their_parent_is_killed_in_the_middle_of_a_message():
    with subprocess.Popen(
        [sys.executable, "-c", _PARENT], stdout=subprocess.PIPE, cwd=Path.cwd()
    ) as parent:
        assert parent.stdout
        pids = [int(pid) for pid in parent.stdout.readline().split()]
        workers = [psutil.Process(pid) for pid in pids]
        parent.kill()
    assert len(workers) == 6
    gone, alive = psutil.wait_procs(workers, timeout=60)
    assert not alive
    assert len(gone) == len(workers)


@pytest.mark.usefixtures("nothing_left")
@pytest.mark.parametrize("victim", ["software", "gateway"])
async def test_a_killed_process_is_named_and_nothing_is_left(victim):
    order = {"order": ("subscriber",), "woken": ("reader0", "reader1", "gateway")}
    with pytest.raises(ProcessFailedError, match=f"{victim} killed by a signal"):  # noqa: PT012 - by what follows
        async with Crossing(2, BYTES, seed=0) as crossing:
            crossing[victim].signal(signal.SIGKILL)
            await crossing.carry(replace(SMT, publisher="hardware", gateway=True, **order))


@pytest.mark.usefixtures("nothing_left")
async def test_an_interrupted_run_leaves_nothing():
    rows = crossings(replace(TINY, live_rounds=1000))
    await anext(rows)
    task = asyncio.ensure_future(anext(rows))
    await asyncio.sleep(0)
    task.cancel()
    with pytest.raises(asyncio.CancelledError):
        await task
    await rows.aclose()
