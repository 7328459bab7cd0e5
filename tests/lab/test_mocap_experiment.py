"""The mocap experiment: each fault of a tree breaks its check, and a short live run proves itself."""

from __future__ import annotations

import asyncio
from dataclasses import replace

import numpy as np
import pytest

from sfglab.lab.checks import CheckRow
from sfglab.lab.experiments import mocap
from sfglab.lab.experiments.mocap import faults
from sfglab.lab.experiments.mocap.calibration import CASES, offset_rows
from sfglab.lab.experiments.mocap.config import WAYS, Config
from sfglab.lab.experiments.mocap.live import live_rows
from sfglab.lab.experiments.mocap.robot import motions, world_from_camera
from sfglab.lab.experiments.mocap.rows import ConfusionRow, OffsetRow
from sfglab.lab.experiments.mocap.trees import RULE, edge_rows, figure_6, tree_checks
from sfglab.lab.experiments.profiles import ConfigError
from sfglab.record import LogReader, LogWriter
from sfglab.spatial import Pose
from sfglab.spatial.frames import FrameBuffer, fill_from_log, lint_frames
from sfglab.spatial.mocap import Capture, mocap_trees

TINY = replace(Config.of_profile("smoke"), trees=3, live_s=0.8, fault_s=10.0, fault_recordings=1, recordings=1)
SEEN = Capture(number=0, capture_ns=10_000_000, receipt_ns=10_000_000, sights={"agent_x/markers": Pose()})


def reports(**changed):
    """What a perfect live round reports, with the robot of Fig. 6."""
    rows = list(edge_rows("x", mocap_trees(*figure_6(), [SEEN])))
    fields = ("way", "child", "parent", "static", "authority", "count", "first_ns", "last_ns")
    edges = [{name: getattr(row, name) for name in (*fields, "backwards", "back_ns")} for row in rows]
    listener = {
        "looks": [[0.5, 15.0, 1.0, 2.0, 12.0, 14.0, 15.0]] * 4,
        "tries": {"proxy": {"found": 4}, "direct": {"E": 4}, "renamed": {"E": 4}},
        "heard": [(10_000_000, 17_000_000, 18_000_000)],
        "edges": edges,
    }
    return {"listener": listener | changed, "bridge": {"receipts": [(10_000_000, 16_000_000)]}, "robot": {}}


def made(path, *, fault=1, **changed):
    """A log as a run writes it."""
    offset = dict.fromkeys(OffsetRow.__dataclass_fields__, 1.0)
    tables = [
        *(("edge", row) for row in edge_rows("figure 6", mocap_trees(*figure_6(), [SEEN]))),
        ("check", CheckRow(check="proxy: exact", checked=9, held=9, example="")),
        ("check", CheckRow(check="faults: some", checked=1, held=fault, example="")),
        ("confusion", ConfusionRow(truth="flipped", verdict="flipped", count=3)),
        *(
            ("offset", OffsetRow(**offset | {"drifts": d, "modelled": m, "covered": 6, "pairs": 9}))
            for d, m in CASES
        ),
        *live_rows("faulty", TINY, 0, reports(**changed)),
    ]
    with LogWriter(path) as log:
        log.write_metadata("config", {"experiment": "mocap", "rounds": ["faulty"]})
        log.write_metadata("hosts", {"description": "made", "separate": True})
        for table, row in tables:
            log.write_row(table, row, log_time_ns=1)
    return path


def broken(path):
    table = mocap.checks(mocap.load_results(path))
    return set(table[table["held"] < table["checked"]]["check"])


def test_a_perfect_run_holds_everywhere_and_the_claim_is_one(tmp_path):
    path = made(tmp_path / "m.mcap")
    assert broken(path) == set()
    claim = mocap.measure_claims(path)["A-VICON"]
    assert (claim.estimate.value, claim.how.value, claim.reason) == (1.0, "live", "")


def edges(change):
    kept = (change(dict(edge)) for edge in reports()["listener"]["edges"])
    return [edge for edge in kept if edge]


def of(edge, way, child):
    return (edge["way"], edge["child"]) == (way, child)


FAULTS = {
    "proxy: every look is answered": {"looks": [[0.5, float("nan"), 1.0, 2.0, 12.0, 14.0, 15.0]]},
    "proxy: the camera is within 20 mm of the truth": {"looks": [[0.5, 15.0, 200.0, 2.0, 12.0, 14.0, 15.0]]},
    "proxy: the tree as heard is whole": {
        "edges": edges(lambda e: e | {"parent": "map2"} if of(e, "proxy", "agent_x/base") else e)
    },
    "proxy: the robot's own edges are as without": {
        "edges": edges(lambda e: None if of(e, "proxy", "agent_x/camera") else e)
    },
    "direct: what is published is no frame of the robot": {
        "edges": edges(lambda e: e | {"child": "agent_x/seen"} if of(e, "direct", "agent_x_markers") else e)
    },
    "renamed: the markers have two parents": {
        "edges": edges(lambda e: None if of(e, "renamed", "agent_x/markers") and e["static"] else e)
    },
    "direct: no look from the world to the camera is answered": {
        "tries": {"proxy": {"found": 4}, "direct": {"E": 3, "found": 1}, "renamed": {"E": 4}}
    },
}


@pytest.mark.parametrize("check", FAULTS)
def test_each_fault_breaks_its_check_and_the_claim(tmp_path, check):
    path = made(tmp_path / "m.mcap", **FAULTS[check])
    assert f"live, faulty, {check}" in broken(path)
    assert mocap.measure_claims(path)["A-VICON"].estimate.value < 1


def test_many_exact_checks_do_not_hide_a_fault(tmp_path):
    assert mocap.measure_claims(made(tmp_path / "m.mcap", fault=0))["A-VICON"].estimate.value == 0


def test_a_round_in_which_nothing_was_heard_has_not_shown_anything(tmp_path):
    silent = {"looks": [], "tries": {way: {} for way in WAYS}, "heard": [], "edges": []}
    path = made(tmp_path / "m.mcap", **silent)
    wrong = broken(path)
    assert len([check for check in wrong if check.startswith("live")]) == 8  # nothing is as nothing was


def test_what_the_paper_says_of_both_trees_holds_for_robots_of_any_shape():
    rows = tree_checks(30, np.random.default_rng(5))
    assert all(row.held == row.checked for row in rows)
    assert {row.check.split(":")[0] for row in rows} >= {"direct", "renamed", "proxy"}


def test_a_bridge_that_believes_everything_fails_its_checks(monkeypatch):
    robot, mapping = figure_6()
    lax = replace(mapping.limits, slack_rad=4.0)
    monkeypatch.setattr(faults, "figure_6", lambda: (robot, replace(mapping, limits=lax)))
    monkeypatch.setattr(faults, "_TURNED_RAD", 4.0 + faults._TURNED_RAD)
    rows, checks = faults.fault_rows(TINY)
    assert any(row.truth == "flipped" and row.verdict == "sound" for row in rows)
    assert checks[-1].held < checks[-1].checked


def test_the_chain_of_the_robot_s_frames_is_where_the_camera_really_is():
    (odom_from_base, _), later = motions(0, 0), world_from_camera(0, 10_000_000_000)
    assert odom_from_base.child == "agent_x/base"
    assert later.same_as(world_from_camera(0, 0), within_m=1.0, within_rad=2.0)


def test_offsets_hold_unless_drift_is_not_allowed_for():
    config = replace(TINY, lengths_s=(10.0,), recordings=2)
    rows = list(offset_rows(config))
    good = [row for row in rows if row.modelled]
    assert sum(row.covered for row in good) >= 20
    assert max(row.after_mm for row in good) < 6 < min(row.after_mm for row in rows if not row.modelled)
    assert min(row.before_mm for row in rows) > 100


def test_profiles_grow_and_an_unknown_one_is_refused():
    smoke, quick, paper = (Config.of_profile(p) for p in ("smoke", "quick", "paper"))
    assert smoke.live_s < quick.live_s < paper.live_s
    with pytest.raises(ConfigError, match="smoke, quick, paper"):
        Config.of_profile("long")


@pytest.mark.live
def test_live_the_bridge_keeps_the_tree_whole_and_the_direct_receiver_does_not(tmp_path):
    path = asyncio.run(mocap.run(TINY, tmp_path / "run.mcap"))
    assert broken(path) == set()
    assert set(mocap.figures(path)) == {"mocap_trees", "mocap_error", "mocap_offset"}
    heard = mocap.load_results(path).heard
    assert (heard["heard_ms"] >= heard["receipt_ms"]).all()
    assert path.stat().st_size < 100_000
    buffer = FrameBuffer(history_s=None)
    with LogReader(path) as reader:
        fill_from_log(reader, buffer)
    assert lint_frames(buffer.edges, rule=RULE, root="map") == ()
