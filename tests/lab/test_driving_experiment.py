"""The driving experiment: rows are what the laps were, and claims come from the log."""

import cv2
import pandas as pd
import pytest
from made_logs import ran

from sfglab.lab.bench import Options
from sfglab.lab.experiments.driving import exp, part_table
from sfglab.lab.experiments.driving.experiment import (
    IMAGE_TOPIC,
    DrivePoint,
    drive_lap,
    time_chain,
)
from sfglab.lab.experiments.driving.results import (
    ASSUMED,
    MEASURED,
    chain_ms,
    parts_ms,
    stopped,
)
from sfglab.lab.workers.driving import GATEWAY, SOFTWARE
from sfglab.soc.driving import run_lap
from sfglab.view.app import ViewOptions, view_log

LAP = DrivePoint(limit_s=1.5)
SMALL = {"laps": 2, "lap": LAP, "chain": DrivePoint(limit_s=0.4), "live_s": 0.0}
CHAIN = "compensation /A gaussian_blur /blurred lane_planner /lane_mask polyfit /lane lane_control"


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    path = tmp_path_factory.mktemp("driving") / "small.mcap"
    return ran(exp, path, **SMALL)


def test_a_row_is_its_lap(run):
    row = run["lap"].iloc[1]
    lap = run_lap(1, timeout_s=1.5)
    assert (row["seed"], row["passed"]) == (1, False)
    assert row["odometry_error_m"] == lap.odometry_error_m


@pytest.mark.parametrize("part", [drive_lap, time_chain])
def test_a_lap_leaves_the_number_of_threads_of_opencv_as_it_was(part):
    before = cv2.getNumThreads()
    cv2.setNumThreads(2)
    try:
        part(DrivePoint(limit_s=0.2), 1)
        assert cv2.getNumThreads() == 2
    finally:
        cv2.setNumThreads(before)


def test_the_chain_is_the_sum_of_its_nodes_and_topics_in_order(run):
    parts = parts_ms(run, MEASURED, SOFTWARE)
    assert [*parts] == [*part_table(run).index] == CHAIN.split()
    frames = run["chain"]
    assert parts["polyfit"].tolist() == pytest.approx((frames["polyfit_ns"] / 1e6).tolist())
    assert parts["/A"].tolist() == pytest.approx((frames["smt_s"] * 1e3).tolist())
    assert chain_ms(run, MEASURED)[SOFTWARE] == pytest.approx(parts.sum(axis=1).to_numpy())
    assumed = parts_ms(run, ASSUMED, GATEWAY)
    assert set(assumed["compensation"]) == {3.5}
    assert assumed["lane_control"].equals(parts["lane_control"]), "in software"


def test_claims_are_the_time_saved_also_by_image_size_and_the_ratio_of_deviations(run):
    found = exp.measure(run)
    claim = found["C-DRIVE"]
    times = chain_ms(run)
    saved_ms = times[SOFTWARE].mean() - times[GATEWAY].mean()
    assert claim.estimate.value == pytest.approx(saved_ms)
    small, large = (estimate.value for estimate in claim.under.values())
    assert small < saved_ms < large
    ratio = times[SOFTWARE].std(ddof=1) / times[GATEWAY].std(ddof=1)
    assert 10 ** found["C-DRIVE-DEV"].estimate.value == pytest.approx(ratio)
    assert not found["C-DRIVE-DEV"].ends, "without the live part"


@pytest.mark.live
def test_the_chain_runs_across_processes_with_both_mappings(run, tmp_path):
    assert run.skipped("live") == "live: no time was asked for (live_s)"
    only = Options(only=frozenset({"live"}))
    rows = ran(exp, tmp_path / "live.mcap", options=only, live_s=2.0)["live"]
    assert set(rows["mapping"]) == {SOFTWARE, GATEWAY}
    assert (rows["chain_s"].dropna() > 0).all()
    assert rows["chain_s"].notna().mean() > 0.5


def test_the_logged_lap_is_in_the_log_as_messages_with_the_same_positions(run):
    track = run["track"]
    moves = [entry.message.transforms for entry in run.messages("/tf")]
    assert [move[0].transform.translation.x for move in moves] == track["x_m"].tolist()
    assert len(list(run.messages("/pose"))) == len(track)
    times_ns = set()
    for topic in (IMAGE_TOPIC, "/lane_mask/compressed", "/lane/path"):
        times_ns.add(tuple(entry.log_time_ns for entry in run.messages(topic)))
    assert len(times_ns) == 1


def test_a_stop_is_where_the_car_stands_after_its_start():
    track = pd.DataFrame({"t_s": [0.5, 2.0, 3.0], "speed_mps": [0.0, 0.5, 0.0]})
    assert stopped.__wrapped__({"track": track})["t_s"].tolist() == [3.0]


def test_rerun_shows_the_lap(run, tmp_path):
    pytest.importorskip("rerun", reason="rerun-sdk is not installed")
    view_log(run.log, ViewOptions(to=(str(tmp_path / "lap.rrd"),)))
    shown = (tmp_path / "lap.rrd").read_bytes()
    for name in (b"EncodedImage", b"Transform3D", b"LineStrips3D", b"/lane/path", b"/pose"):
        assert name in shown
