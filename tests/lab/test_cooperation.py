"""The simulated cooperation: what couples control to communication is what is delivered, and nothing else."""

from dataclasses import replace

import pandas as pd
import pytest
from made_logs import reference

from sfglab.arp.hallway import BEAMS_DEG, SCAN_HZ, simulation
from sfglab.arp.hallway.simulation import LapSettings
from sfglab.arp.robots import METHODS, RATES_HZ
from sfglab.lab.experiments import cooperation
from sfglab.lab.experiments.cooperation import exp, experiment
from sfglab.lab.experiments.cooperation.figures import frames_of
from sfglab.lab.experiments.cooperation.replay import Replay
from sfglab.lab.workers.hallway import COMMAND
from sfglab.messages import default_message, serialized_size
from sfglab.rtps import Medium

REFERENCE = reference(exp)
PERFECT = Medium(rate_bps=1e13, loss=0.0, shared=False, overhead_s=0.0, contention=0.0)
DEAD = Medium(loss=1 - 1e-12)


def of(method, **changes):
    depth = simulation.OPTIMUM if METHODS[method].optimised else 10
    return replace(LapSettings(method=method, rate_max_hz=100, depth=depth), **changes)


@pytest.mark.parametrize("method", METHODS)
def test_over_a_perfect_link_every_method_comes_home(method):
    row = experiment.run_point(of(method, medium=PERFECT), 0)
    assert (row.end, row.robot) == ("success", "")
    assert row.wound > 0.98


def test_the_scenario_as_printed_goes_by_robot_3_and_comes_home_with_the_sizes_and_times_asked():
    printed = of(
        "OPT",
        medium=PERFECT,
        relay_via_robot3=True,
        topics=(8, 5, 5),
        beam_bytes=8,
        compute_scale=4.0,
    )
    flows, before = (
        {f.name: f for f in simulation.scenario_of(p, seed=0).flows} for p in (printed, of("OPT"))
    )
    ways = {
        name: (f.source, f.target, f.then) for name, f in flows.items() if f.target != "station"
    }
    assert ways["robot1/release"] == ("station", "robot3", "robot1/command")
    assert ways["robot1/command"] == ("robot3", "robot1", None)
    assert ways["robot3/command"][:2] == ("station", "robot3")
    beam, old = flows["robot1/lidar/0"], before["robot1/lidar/0"]
    assert (beam.size_bytes, old.size_bytes, beam.service_s / old.service_s) == (8, 24, 4)
    fewer, more = (simulation.rate_and_depth(point)[0] for point in (printed, of("OPT")))
    assert fewer > more, "fewer topics, each more often"
    row = experiment.run_point(printed, 0)
    assert (row.end, row.command_p50_ms < 1) == ("success", True)


@pytest.mark.parametrize("method", ["none", "OPT+LC"])
def test_over_a_dead_link_nobody_moves(method):
    lap = simulation.SimulatedLap(of(method, medium=DEAD), 0, record=True)
    assert lap.run(limit_s=5.0).end is simulation.End.TIMEOUT
    assert len({turn.poses.tobytes() for turn in lap.snapshots}) == 1


def test_the_same_seed_is_the_same_run_to_the_bit_and_another_one_is_not():
    failing = LapSettings(method="none", rate_max_hz=100, depth=1)
    first, second, other = (repr(experiment.run_point(failing, seed)) for seed in (3, 3, 4))
    assert first == second
    assert first != other


def test_methods_differ_in_what_they_say_they_do():
    laps = {name: simulation.SimulatedLap(of(name), 0).run(limit_s=5.0) for name in METHODS}
    short = {name: experiment.course_row(of(name), 0, lap) for name, lap in laps.items()}
    for name, method in METHODS.items():
        row = short[name]
        assert (row.held > 0) == method.local_cache
        assert (row.rate_hz < 100) == method.optimised
        assert (row.compared > 0) == (method.cache_control and not method.local_cache)
    assert short["OPT"].airtime < short["LC"].airtime < short["none"].airtime


def test_optimised_settings_are_those_of_equation_6():
    for rate in RATES_HZ:
        found = simulation.rate_and_depth(of("OPT", rate_max_hz=rate))
        assert found == (
            pytest.approx(rate / 9 - 1, abs=1e-4),
            int(5000 * (rate / 9 - 1) / rate - 1),
        )
    assert simulation.rate_and_depth(of("OPT", depth=10))[1] == 10
    assert simulation.rate_and_depth(of("none")) == (100, 10)


def test_a_scenario_has_eight_beams_up_and_one_command_down_for_each_robot():
    scenario = simulation.scenario_of(of("none"), seed=0)
    up = [flow for flow in scenario.flows if flow.target == "station"]
    down = [flow for flow in scenario.flows if flow.source == "station"]
    assert len(up) == len(BEAMS_DEG) * len(simulation.ROBOTS)
    assert [flow.target for flow in down] == list(simulation.ROBOTS)
    sizes = {flow.size_bytes for flow in down}
    assert sizes == {serialized_size(default_message(COMMAND))} == {simulation.COMMAND_BYTES}


def test_the_paper_s_profile_has_every_point_once():
    points = experiment.points_of(exp.config("paper"))
    assert len(points) == len(RATES_HZ) * (3 * len(simulation.LAP_DEPTHS) + 4)
    assert len(set(points)) == len(points)


# --- The reference run ----------------------------------------------------------------------------------------


def test_the_log_says_how_every_run_ended():
    rows = cooperation.courses(REFERENCE)
    table = cooperation.rates(rows, "method").set_index("method")
    runs = rows["method"].value_counts().to_dict()
    assert table["runs"].to_dict() == cooperation.failures(rows).sum(axis=1).to_dict() == runs
    assert (table["low"] <= table["rate"]).all()
    assert (table["rate"] <= table["high"]).all()


@pytest.mark.parametrize("name", ["success", "failure"])
def test_a_drawn_run_is_in_the_log_as_tracks_and_messages_that_say_the_same(name):
    mine = REFERENCE["track"][REFERENCE["track"]["run"] == name]
    assert mine["t_s"].max() == pytest.approx(REFERENCE.metadata("examples")[name]["ended_s"])
    for robot in simulation.ROBOTS:
        poses = [entry.message.pose for entry in REFERENCE.messages(f"/{name}/{robot}/pose")]
        assert [pose.position.y for pose in poses] == mine[mine["robot"] == robot]["y_m"].tolist()
        lengths = {
            len(entry.message.ranges) for entry in REFERENCE.messages(f"/{name}/{robot}/scan")
        }
        assert lengths == {len(BEAMS_DEG)}


def test_the_film_moves_and_the_same_log_gives_the_same_file():
    first, *_, last = frames_of(REFERENCE, "failure")
    assert first.shape == last.shape == (320, 960, 3)
    assert (first != last).any()
    film = cooperation.film(REFERENCE, "failure")
    assert film == cooperation.film(REFERENCE, "failure")
    assert len(film) < 1_000_000


# --- Estimates ------------------------------------------------------------------------------------------------


def test_the_difference_is_the_mean_over_rates():
    rows = [("none", 100, False)] * 4 + [("none", 200, True), ("none", 200, False)]
    rows += [("OPT+LC", 100, True)] * 3 + [("OPT+LC", 200, True)] * 2
    estimate = cooperation.difference(
        pd.DataFrame(rows, columns=["method", "rate_max_hz", "success"])
    )
    assert estimate.value == pytest.approx(1.0 - (0.0 + 0.5) / 2)
    assert estimate.low <= estimate.value <= estimate.high


def test_a_replay_shows_the_run_again_and_how_long_the_station_was_wrong():
    replay = Replay(REFERENCE, "OPT+LC")
    row = replay.row
    assert row.end != "success"
    last = replay.run.snapshots[-1]
    shape = (len(simulation.ROBOTS), len(BEAMS_DEG))
    assert last.measured_m.shape == last.believed_m.shape == shape
    assert len(replay.late_s) == len(replay.run.snapshots)
    # What is wrong for longest was sent and not heard for no longer than the engine says.
    assert 1 < replay.late_s.max() <= row.stale_s + 2 / SCAN_HZ
    replay.press("robot2")
    assert replay.turn.value == replay.late_s[:, 1].argmax()
