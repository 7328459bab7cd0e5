"""The simulated cooperation: what couples control to communication is what is delivered, and nothing else."""

from __future__ import annotations

import asyncio
from dataclasses import replace
from importlib import import_module

import numpy as np
import pytest

from sfglab.arp import LocalCache
from sfglab.arp.hallway import BEAMS_DEG, Command
from sfglab.arp.robots import METHODS, RATES_HZ
from sfglab.lab.experiments import cooperation
from sfglab.lab.experiments.cooperation.analysis import wilson
from sfglab.lab.experiments.cooperation.animation import frames_of
from sfglab.lab.experiments.cooperation.config import (
    DEPTHS,
    OPTIMUM,
    Config,
    Point,
    points_of,
    setting_of,
)
from sfglab.lab.experiments.cooperation.simulated import (
    COMMAND_BYTES,
    ROBOTS,
    SimulatedRun,
    run_point,
    scenario_of,
)
from sfglab.lab.experiments.profiles import ConfigError
from sfglab.lab.workers.hallway import COMMAND
from sfglab.messages import default_message, serialized_size
from sfglab.qos import QoSProfile
from sfglab.record import LogReader
from sfglab.rtps import Flow, Medium, Scenario, Session

runner = import_module("sfglab.lab.experiments.cooperation.run")
PERFECT = Medium(rate_bps=1e13, loss=0.0, shared=False, overhead_s=0.0, contention=0.0)
DEAD = Medium(loss=1 - 1e-12)
FAILING = Point(method="none", rate_max_hz=100, depth=1)
MS = 1_000_000


def of(method, **changes):
    depth = OPTIMUM if METHODS[method].optimised else 10
    return replace(Point(method=method, rate_max_hz=100, depth=depth), **changes)


@pytest.mark.parametrize("method", METHODS)
def test_over_a_perfect_link_every_method_comes_home(method):
    row = run_point(of(method, medium=PERFECT), 0)
    assert (row.end, row.robot) == ("success", "")
    assert row.wound > 0.98


@pytest.mark.parametrize("method", ["none", "OPT+LC"])
def test_over_a_dead_link_nobody_moves(method):
    run = SimulatedRun(of(method, medium=DEAD), 0, tracked="dead")
    row = run.run(limit_s=5.0)
    assert row.end == "timeout"
    for robot in ROBOTS:
        places = {(t.x_m, t.y_m, t.heading_rad) for t in run.tracks if t.robot == robot}
        assert len(places) == 1


def test_the_same_seed_is_the_same_run_to_the_bit_and_another_one_is_not():
    first, second, other = (repr(run_point(FAILING, seed)) for seed in (3, 3, 4))
    assert first == second
    assert first != other


def test_methods_differ_in_what_they_say_they_do():
    short = {name: SimulatedRun(of(name), 0).run(limit_s=5.0) for name in METHODS}
    for name, method in METHODS.items():
        row = short[name]
        assert (row.held > 0) == method.local_cache
        assert (row.rate_hz < 100) == method.optimised
        assert (row.compared > 0) == (method.cache_control and not method.local_cache)
    assert short["OPT"].airtime < short["LC"].airtime < short["none"].airtime


def test_optimised_settings_are_those_of_equation_6():
    for rate in RATES_HZ:
        setting = setting_of(Point(method="OPT", rate_max_hz=rate, depth=OPTIMUM))
        assert setting.rate_hz == pytest.approx(rate / 9 - 1, abs=1e-4)
        assert setting.depth == int(5000 * (rate / 9 - 1) / rate - 1)
    assert setting_of(Point(method="OPT", rate_max_hz=100, depth=10)).depth == 10
    assert setting_of(Point(method="none", rate_max_hz=100, depth=10)).rate_hz == 100


def test_a_scenario_has_eight_beams_up_and_one_command_down_for_each_robot():
    scenario = scenario_of(of("none"), seed=0)
    up = [flow for flow in scenario.flows if flow.target == "station"]
    down = [flow for flow in scenario.flows if flow.source == "station"]
    assert len(up) == len(BEAMS_DEG) * len(ROBOTS)
    assert [flow.target for flow in down] == list(ROBOTS)
    assert {flow.size_bytes for flow in down} == {serialized_size(default_message(COMMAND))} == {COMMAND_BYTES}


def test_the_compiled_local_cache_passes_what_the_robots_local_cache_passes():
    """The simulated shell has the rule in the engine, the live one has `LocalCache`: the same values pass."""
    flow = Flow(name="beam", source="a", target="b", rate_hz=100, cached=True, qos=QoSProfile(depth=100))
    session = Session(Scenario(flows=(flow,), medium=PERFECT, duration_s=3.0), seed=0)
    rng, cache = np.random.default_rng(1), LocalCache()
    passed, heard, values = [], [], {}
    for now_ns in range(0, 3000 * MS, 10 * MS):
        value = int(rng.integers(0, 2)) if now_ns % (20 * MS) == 0 else values.get(now_ns - 10 * MS)
        values[now_ns] = value
        session.set_value("beam", value)
        if cache.offer("beam", value, now_ns=now_ns).passes:
            passed.append((now_ns, value))
        while (delivery := session.advance(now_ns + 9 * MS)) is not None:
            heard.append((delivery.published_ns, delivery.value))
    assert heard == passed
    assert 50 < len(passed) < 200


def test_profiles_and_points():
    points = points_of(Config.of_profile("paper"))
    assert len(points) == len(RATES_HZ) * (3 * len(DEPTHS) + 4)
    assert len(set(points)) == len(points)
    assert Config.of_profile("quick", seed=7).seed == 7
    with pytest.raises(ConfigError, match="smoke, quick, paper"):
        Config.of_profile("long")


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    """A small experiment: two methods whose runs are short or long."""
    path = tmp_path_factory.mktemp("cooperation") / "small.mcap"
    config = Config(profile="small", rates_hz=(100,), seeds=2, contrast_seeds=0)
    points = [FAILING, of("OPT+LC", vendor="cyclone_dds")]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(runner, "points_of", lambda _: points)
        patch.setattr(
            runner, "sweep", lambda task, points, seeds, **_: [task(p, s) for p in points for s in seeds]
        )
        return asyncio.run(cooperation.run(config, path, separate=False))


def test_the_log_says_how_every_run_ended(log):
    results = cooperation.load_results(log)
    table = cooperation.rates(results.courses, "method")
    assert dict(zip(table["method"], table["runs"], strict=True)) == {"none": 2, "OPT+LC": 2}
    counts = cooperation.failures(results.courses)
    assert counts.sum(axis=1).to_dict() == {"none": 2, "OPT+LC": 2}
    assert (table["low"] <= table["rate"]).all()
    assert (table["rate"] <= table["high"]).all()


def test_the_drawn_runs_are_in_the_log_as_messages_that_say_the_same(log):
    results = cooperation.load_results(log)
    assert set(results.examples) == {"success", "failure"}
    with LogReader(log) as reader:
        for name in results.examples:
            for robot in ROBOTS:
                tracks = results.tracks
                mine = tracks[(tracks["run"] == name) & (tracks["robot"] == robot)]
                poses = [entry.message for entry in reader.decoded(f"/{name}/{robot}/pose")]
                assert [p.pose.position.y for p in poses] == mine["y_m"].tolist()
                scans = [entry.message for entry in reader.decoded(f"/{name}/{robot}/scan")]
                assert {len(scan.ranges) for scan in scans} == {len(BEAMS_DEG)}


def test_a_tracked_run_ends_where_its_row_says(log):
    results = cooperation.load_results(log)
    for name, example in results.examples.items():
        last = results.tracks[results.tracks["run"] == name]["t_s"].max()
        assert last == pytest.approx(example["ended_s"])


def test_figures_and_film_show_it(log):
    results = cooperation.load_results(log)
    drawn = cooperation.figures(log)
    assert set(drawn) == {"cooperation", "cooperation_tracks", "cooperation_staleness"}
    assert drawn["cooperation"][1]["rates"]["none, Rmax 100, depth 1"]["runs"] == 2
    first, *_, last = frames_of(results, "failure")
    assert first.shape == last.shape == (320, 960, 3)
    assert (first != last).any()
    film = cooperation.film(results, "failure")
    assert film == cooperation.film(results, "failure")
    assert len(film) < 1_000_000


def test_rerun_gets_a_recording(log, tmp_path):
    pytest.importorskip("rerun", reason="rerun-sdk is not installed")
    tracks = cooperation.load_results(log).tracks
    path = cooperation.write_rerun(tracks[tracks["run"] == "failure"], tmp_path / "failure.rrd")
    assert path.stat().st_size > 1000


def test_the_difference_is_the_mean_over_rates():
    import pandas as pd

    rows = [("none", 100, False)] * 4 + [("none", 200, True), ("none", 200, False)]
    rows += [("OPT+LC", 100, True)] * 3 + [("OPT+LC", 200, True)] * 2
    courses = pd.DataFrame(rows, columns=["method", "rate_max_hz", "success"])
    estimate = cooperation.difference(courses)
    assert estimate.value == pytest.approx(1.0 - (0.0 + 0.5) / 2)
    assert estimate.low <= estimate.value <= estimate.high


def test_an_interval_of_a_share_is_wilsons():
    """The values of R. G. Newcombe, Statistics in Medicine 17 (1998), table I: 81 of 263, and 0 of 20."""
    assert wilson(81, 263) == pytest.approx((0.2553, 0.3662), abs=1e-4)
    assert wilson(0, 20) == pytest.approx((0.0, 0.1611), abs=1e-4)


def test_a_command_travels_as_a_twist_without_loss():
    for turn in (-440, -1, 0, 3, 440):
        command = Command(moving=True, turn_mrad_s=turn)
        assert Command.from_velocities(command.speed_m_s, command.turn_rad_s) == command
