"""The driving experiment: rows are what the laps were, figures and film come from the log alone."""

import asyncio

import numpy as np
import pandas as pd
import pytest

from sfglab.lab.bench import Options
from sfglab.lab.experiments.driving import analysis
from sfglab.lab.experiments.driving.analysis import chain_ms, parts_ms, pictures, saved_ms
from sfglab.lab.experiments.driving.experiment import PAPER_MS, ChainPoint, LapPoint, exp
from sfglab.lab.experiments.driving.figures import film, frames_of
from sfglab.lab.experiments.driving.lap import PICTURE_SIZE, Recorder
from sfglab.lab.sweep import Workers
from sfglab.soc.driving import CHAIN, Camera, Rules, Stack, make_town, run_lap
from sfglab.view.app import ViewOptions, view_log

HERE = Options(workers=Workers(count=1, threads=True))
SMALL = {"laps": 2, "lap": LapPoint(limit_s=1.5), "chain": ChainPoint(limit_s=0.4), "live_s": 0.0}


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    path = tmp_path_factory.mktemp("driving") / "small.mcap"
    return asyncio.run(exp.run("smoke", path=path, options=HERE, **SMALL))


def test_a_lap_s_row_is_the_lap(run):
    row = run["lap"].iloc[1]
    lap = run_lap(1, rules=Rules(timeout_s=1.5))
    assert row["seed"] == 1
    assert row["largest_lateral_m"] == lap.verdict.largest_lateral_m
    assert row["odometry_error_m"] == lap.odometry_error_m
    assert (row["frames"], row["passed"]) == (lap.frames, False)
    assert row["compensation_s"] > 0


def test_the_chain_is_the_sum_of_its_nodes_and_topics_in_order(run):
    parts = parts_ms(run, "software", "software")
    chain = (
        "compensation /A gaussian_blur /blurred lane_planner /lane_mask polyfit /lane lane_control"
    )
    assert " ".join(parts) == chain
    first = run["chain"].iloc[0]
    assert parts["polyfit"][0] == pytest.approx(first["polyfit_ns"] / 1e6)
    assert parts["/A"][0] == pytest.approx(first["smt_s"] * 1e3)
    assert chain_ms(run, "software")["software"] == pytest.approx(sum(parts.values()))
    parts = parts_ms(run, "hardware", "gateway")
    assert set(parts["compensation"]) == {3.5}, "what the graph assumes of hardware"
    assert parts["lane_control"] == pytest.approx(run["chain"]["lane_control_ns"] / 1e6)


def test_the_claims_are_what_is_saved_at_several_sizes_and_the_deviations(run):
    found = exp.measure(run)
    claim = found["C-DRIVE"]
    assert claim.estimate.value == pytest.approx(saved_ms(run))
    assert claim.estimate.low <= claim.estimate.value <= claim.estimate.high
    assert claim.details["laps passed"].startswith("0 of 2")
    saved = [estimate.value for estimate in claim.under.values()]
    assert saved == sorted(saved)
    assert saved[0] < claim.estimate.value < saved[-1]
    times = chain_ms(run)
    deviations = times["software"].std(ddof=1) / times["gateway"].std(ddof=1)
    assert 10 ** found["C-DRIVE-DEV"].estimate.value == pytest.approx(deviations)


def test_through_a_gateway_only_the_software_node_varies_and_both_readings_of_its_saving_agree(run):
    spread = chain_ms(run, "hardware")["gateway"] - run["chain"]["lane_control_ns"] / 1e6
    assert np.ptp(spread) < 1e-9
    assert set(analysis.node_table(run).index) == set(CHAIN)
    table = analysis.chain_table(run)
    assert table["saved (ms)"].iloc[:2].tolist() == pytest.approx([saved_ms(run)] * 2)
    assert table["times as fast"].iloc[-1] == PAPER_MS["software"][0] / PAPER_MS["gateway"][0]


@pytest.mark.live
def test_the_chain_runs_across_processes_and_its_deviation_is_judged_beside_the_simulated_one(
    run, tmp_path
):
    assert run.skipped("live") == "live: no time was asked for (live_s)"
    assert analysis.live_ms(run) == {}
    assert not exp.measure(run)["C-DRIVE-DEV"].ends
    only = Options(only=frozenset({"live"}))
    live = asyncio.run(exp.run("smoke", path=tmp_path / "live.mcap", options=only, live_s=2.0))[
        "live"
    ]
    assert set(live["mapping"]) == {"software", "gateway"}
    assert live["started_s"].is_monotonic_increasing
    assert (live["chain_s"].dropna() > 0).all()
    assert live["chain_s"].notna().mean() > 0.5
    ms = {"software": np.array([20.0, 40.0, 30.0]), "gateway": np.array([29.0, 31.0, 30.0])}
    assert analysis.orders_less(list(ms.values())) == pytest.approx(1.0)


def test_the_drawn_lap_is_in_the_log_as_messages_that_say_the_same(run):
    tracks = run["track"]
    commands = [entry.message for entry in run.messages("/cmd_vel")]
    assert [c.linear.x for c in commands] == tracks["command_mps"].tolist()
    moves = [entry.message.transforms for entry in run.messages("/tf")]
    assert [move[0].transform.translation.x for move in moves] == tracks["x_m"].tolist()
    assert [move[1].child_frame_id for move in moves if len(move) > 1] == ["odom"]
    paths = [entry.message for entry in run.messages("/lane/path")]
    assert len(paths) == tracks["pictured"].sum()
    assert {len(path.poses) for path in paths} == {7}
    lights = [entry.message for entry in run.messages("/lights")]
    assert {len(markers.markers) for markers in lights} == {5}


def test_pictures_come_back_at_the_moments_that_have_one(run):
    tracks = run["track"]
    found = pictures(run)
    assert [one.t_s for one in found] == pytest.approx(tracks["t_s"][tracks["pictured"]].tolist())
    assert {one.bgr.shape for one in found} == {(*PICTURE_SIZE[::-1], 3)}
    assert all(set(np.unique(one.mask)) == {0, 128, 255} for one in found)


def test_a_standing_car_is_pictured_seldom_and_a_stop_is_a_second_of_standing_after_the_start(run):
    stack = Stack(Camera(width=64, height=48))
    stack.control.hear_red()
    recorder = Recorder(make_town(np.random.default_rng(0)), stack)
    run_lap(0, stack=stack, rules=Rules(timeout_s=4.0), watch=recorder.watch)
    assert {moment.row.speed_mps for moment in recorder.moments} == {0.0}
    assert [round(m.row.t_s, 3) for m in recorder.moments if m.image_jpeg] == [0.0, 2.0, 4.0]
    speeds = [0.0] * 8 + [0.5] * 7 + [0.0] * 10 + [0.5] * 5 + [0.0] * 3 + [0.5] * 2
    moments = pd.DataFrame(
        {"t_s": np.arange(len(speeds)) / 5, "speed_mps": speeds, "x_m": 1.0, "y_m": 2.0}
    )
    [stop] = analysis.stops.__wrapped__({"track": moments})
    assert (stop.t_s, stop.lasted_s) == pytest.approx((3.0, 1.8))
    assert (stop.x_m, stop.y_m) == (1.0, 2.0)


def test_figures_and_film_come_from_the_log(run):
    drawn = exp.figures(run)
    assert drawn["driving_laps"][1]["laps"] == 2
    assert drawn["driving_chain"][1]["saved_ms"] == saved_ms(run)
    first, *_, last = frames_of(run)
    assert first.shape == last.shape == (384, 1184, 3)
    assert (first != last).any()
    first_time = film(run)
    assert first_time == film(run)
    assert first_time[4:8] == b"ftyp"


def test_rerun_opens_the_log_and_the_viewer_s_bridge_shows_all_of_it(run, tmp_path):
    rerun = pytest.importorskip("rerun", reason="rerun-sdk is not installed")
    with rerun.RecordingStream("sfglab_test") as recording:
        recording.save(tmp_path / "log.rrd")
        recording.log_file_from_path(run.log)
    opened = (tmp_path / "log.rrd").read_bytes()
    assert all(
        name in opened for name in (b"EncodedImage", b"Transform3D", b"/image/compressed", b"/tf")
    )
    view_log(run.log, ViewOptions(to=(str(tmp_path / "lap.rrd"),)))
    shown = (tmp_path / "lap.rrd").read_bytes()
    assert all(name in shown for name in (b"LineStrips3D", b"/town", b"/lights", b"/lane/path"))
