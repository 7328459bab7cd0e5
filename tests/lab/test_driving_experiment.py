"""The driving experiment: rows are what the laps were, figures and film come from the log alone."""

from __future__ import annotations

from dataclasses import replace
from importlib import import_module

import numpy as np
import pytest

from sfglab.lab.experiments import driving
from sfglab.lab.experiments.driving.analysis import chain_ms, load_pictures, parts_ms, ratio, saved_ms
from sfglab.lab.experiments.driving.animation import frames_of
from sfglab.lab.experiments.driving.config import MAPPINGS, PAPER_MS, ChainPoint, Config, LapPoint
from sfglab.lab.experiments.driving.recorder import PICTURE_SIZE, Recorder
from sfglab.lab.sweep import Workers
from sfglab.record import LogReader
from sfglab.soc.driving import CHAIN, Camera, Rules, Stack, make_town, run_lap

tasks = import_module("sfglab.lab.experiments.driving.chain")
runner = import_module("sfglab.lab.experiments.driving.run")
HERE = Workers(count=1, threads=True)
SMALL = Config(profile="small", laps=2, lap=LapPoint(limit_s=1.5), chain=ChainPoint(limit_s=0.4))
TINY = replace(SMALL, lap=LapPoint(limit_s=0.3), chain=ChainPoint(limit_s=0.2, width=64, height=48))


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    return driving.run(SMALL, tmp_path_factory.mktemp("driving") / "small.mcap", workers=HERE)


def test_a_lap_s_row_is_the_lap(log):
    row = driving.load_results(log).laps.iloc[1]
    lap = run_lap(1, rules=Rules(timeout_s=1.5))
    assert row["seed"] == 1
    assert row["largest_lateral_m"] == lap.verdict.largest_lateral_m
    assert row["odometry_error_m"] == lap.odometry_error_m
    assert (row["frames"], row["passed"]) == (lap.frames, False)
    assert row["compensation_s"] > 0


def test_the_chain_is_the_sum_of_its_nodes_and_topics_in_order(log):
    results = driving.load_results(log)
    parts = parts_ms(results, "software", "software")
    assert list(parts) == [
        "compensation",
        "/A",
        "gaussian_blur",
        "/blurred",
        "lane_planner",
        "/lane_mask",
        "polyfit",
        "/lane",
        "lane_control",
    ]
    first = results.chain.iloc[0]
    assert parts["polyfit"][0] == pytest.approx(first["polyfit_ns"] / 1e6)
    assert parts["/A"][0] == pytest.approx(first["smt_s"] * 1e3)
    assert chain_ms(results, "software")["software"] == pytest.approx(sum(parts.values()))


def test_in_hardware_a_node_takes_what_the_graph_assumes_and_software_what_was_measured(log):
    results = driving.load_results(log)
    parts = parts_ms(results, "hardware", "gateway")
    assert set(parts["compensation"]) == {3.5}
    assert parts["lane_control"] == pytest.approx(results.chain["lane_control_ns"] / 1e6)


def test_what_a_gateway_saves_is_the_same_by_both_readings(log):
    results = driving.load_results(log)
    for reading in ("hardware", "software"):
        times = chain_ms(results, reading)
        saved = float((times["software"] - times["gateway"]).mean())
        assert saved == pytest.approx(saved_ms(results))
    table = driving.chain_table(results)
    assert table["saved (ms)"].iloc[:2].tolist() == pytest.approx([saved_ms(results)] * 2)
    assert table["times as fast"].iloc[-1] == PAPER_MS["software"][0] / PAPER_MS["gateway"][0]


def test_the_claim_is_the_ratio_of_means_with_hardware_times(log):
    results = driving.load_results(log)
    claim = driving.measure_claims(log)["C-DRIVE"]
    means = [chain_ms(results, "hardware")[mapping].mean() for mapping in MAPPINGS]
    assert claim.estimate.value == pytest.approx(means[0] / means[1])
    assert claim.estimate.low <= claim.estimate.value <= claim.estimate.high
    assert claim.details["laps passed"].startswith("0 of 2")
    assert ratio(results, "software").value != claim.estimate.value


def test_through_a_gateway_only_the_software_node_varies(log):
    results = driving.load_results(log)
    spread = chain_ms(results, "hardware")["gateway"] - results.chain["lane_control_ns"] / 1e6
    assert np.ptp(spread) < 1e-9
    assert set(driving.node_table(results).index) == set(CHAIN)


def test_the_drawn_lap_is_in_the_log_as_messages_that_say_the_same(log):
    tracks = driving.load_results(log).tracks
    with LogReader(log) as reader:
        commands = [entry.message for entry in reader.decoded("/cmd_vel")]
        assert [c.linear.x for c in commands] == tracks["command_mps"].tolist()
        moves = [entry.message.transforms for entry in reader.decoded("/tf")]
        assert [move[0].transform.translation.x for move in moves] == tracks["x_m"].tolist()
        assert [move[1].child_frame_id for move in moves if len(move) > 1] == ["odom"]
        paths = [entry.message for entry in reader.decoded("/lane/path")]
        assert len(paths) == tracks["pictured"].sum()
        assert {len(path.poses) for path in paths} == {7}
        lights = [entry.message for entry in reader.decoded("/lights")]
        assert {len(markers.markers) for markers in lights} == {5}


def test_pictures_come_back_at_the_moments_that_have_one(log):
    tracks = driving.load_results(log).tracks
    pictures = load_pictures(log)
    assert [one.t_s for one in pictures] == pytest.approx(tracks["t_s"][tracks["pictured"]].tolist())
    assert {one.bgr.shape for one in pictures} == {(*PICTURE_SIZE[::-1], 3)}
    assert all(set(np.unique(one.mask)) == {0, 128, 255} for one in pictures)


def test_a_standing_car_is_pictured_seldom():
    stack = Stack(Camera(width=64, height=48))
    stack.control.hear_red()
    recorder = Recorder(make_town(np.random.default_rng(0)), stack)
    run_lap(0, stack=stack, rules=Rules(timeout_s=4.0), watch=recorder.watch)
    assert {moment.row.speed_mps for moment in recorder.moments} == {0.0}
    assert [round(m.row.t_s, 3) for m in recorder.moments if m.image_jpeg] == [0.0, 2.0, 4.0]


def test_a_stop_is_a_second_or_more_of_standing_after_the_start(log):
    import pandas as pd

    speeds = [0.0] * 8 + [0.5] * 7 + [0.0] * 10 + [0.5] * 5 + [0.0] * 3 + [0.5] * 2
    moments = pd.DataFrame({"t_s": np.arange(len(speeds)) / 5, "speed_mps": speeds, "x_m": 1.0, "y_m": 2.0})
    [stop] = driving.stops(replace(driving.load_results(log), tracks=moments))
    assert (stop.t_s, stop.lasted_s) == pytest.approx((3.0, 1.8))
    assert (stop.x_m, stop.y_m) == (1.0, 2.0)


def test_figures_and_film_come_from_the_log(log):
    drawn = driving.figures(log)
    assert set(drawn) == {"driving_chain", "driving_lap", "driving_laps"}
    assert drawn["driving_laps"][1]["laps"] == 2
    assert drawn["driving_chain"][1]["saved_ms"] == saved_ms(driving.load_results(log))
    first, *_, last = frames_of(log)
    assert first.shape == last.shape == (384, 1184, 3)
    assert (first != last).any()
    film = driving.film(log)
    assert film == driving.film(log)
    assert film[4:8] == b"ftyp"


def test_rerun_opens_the_log_and_gets_a_recording(log, tmp_path):
    rerun = pytest.importorskip("rerun", reason="rerun-sdk is not installed")
    with rerun.RecordingStream("sfglab_test") as recording:
        recording.save(tmp_path / "log.rrd")
        recording.log_file_from_path(log)
    opened = (tmp_path / "log.rrd").read_bytes()
    assert all(name in opened for name in (b"EncodedImage", b"Transform3D", b"/image/compressed", b"/tf"))
    assert driving.write_rerun(log, tmp_path / "lap.rrd").stat().st_size > 10_000


def test_an_interrupted_run_goes_on_from_its_journals_and_leaves_only_its_log(tmp_path, monkeypatch):
    def interrupted(*_):
        raise KeyboardInterrupt

    def driven_again(*_, **__):
        raise AssertionError("what stands in the journals is not driven again")

    with monkeypatch.context() as patch:
        patch.setattr(runner, "record_lap", interrupted)
        with pytest.raises(KeyboardInterrupt):
            driving.run(TINY, tmp_path / "first.mcap", workers=HERE)
    assert {path.suffix for path in tmp_path.iterdir()} == {".journal"}
    monkeypatch.setattr(tasks, "run_lap", driven_again)
    path = driving.run(TINY, tmp_path / "second.mcap", workers=HERE)
    assert list(tmp_path.iterdir()) == [path]
    assert len(driving.load_results(path).laps) == 2
