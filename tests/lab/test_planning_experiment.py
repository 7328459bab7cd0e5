"""The experiment on planning: it fills its claim, its checks can fail, and its log says what was driven."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from sfglab.lab.checks import editing, trajectories
from sfglab.lab.experiments.planning import SceneCell, checks, exp
from sfglab.lab.experiments.planning.analysis import allowed_m
from sfglab.lab.experiments.planning.experiment import example_rows
from sfglab.record import LogReader
from sfglab.spatial.trajectory.path import Interpolation, stretched

REFERENCE = Path(__file__).parents[2] / "data" / "reference" / "planning.mcap"


@pytest.fixture
def run():
    return exp.load(REFERENCE)


def test_the_reference_run_fills_its_claim(run):
    measured = exp.measure(run)["A-PLAN"]
    assert (measured.estimate.value, measured.reason) == (1.0, "")
    held, _, checked = measured.details["execution checks"].split()
    assert held == checked
    assert len(checks(run)) > 30


def test_every_way_in_which_a_goal_can_end_was_seen(run):
    ended = {"succeeded", "canceled", "overtaken", "server gone"}
    refused = {"busy", "unknown agent", "unknown frame", "start too far", "limits exceeded"}
    assert set(run["goal"]["outcome"]) == ended | refused | {"invalid trajectory"}


def test_the_log_holds_plans_and_poses_as_messages(run):
    with LogReader(run.log) as reader:
        kinds = {name: info.type_name for name, info in reader.topics.items() if name.startswith("/global")}
        assert kinds == {
            f"/global/{agent}/{what}": type_
            for agent in ("go2", "drone")
            for what, type_ in (("path", "nav_msgs/msg/Path"), ("pose", "geometry_msgs/msg/PoseStamped"))
        }
        poses = sum(1 for entry in reader.messages("/global/go2/pose"))
    assert poses == (run["track"]["agent"] == "go2").sum() > 100


def test_one_goal_that_ends_otherwise_fails_the_claim(run):
    goals = run["goal"]
    goals.loc[goals["case"] == "too fast", "outcome"] = "succeeded"
    run.table("goal")["outcome"] = goals["outcome"]
    table = checks(run)
    wrong = table[table["held"] < table["checked"]]
    assert "too fast: succeeded" in set(wrong["example"])
    assert set(wrong["group"]) == {"execution"}


def test_an_agent_further_from_its_plan_than_its_dynamics_explain_fails_its_check(run):
    tracks, check = run.table("track"), "an agent is never further from its plan than its dynamics explain"
    assert allowed_m(run) == pytest.approx({"go2": 0.532, "drone": 0.300}, abs=2e-3)
    tracks.loc[tracks["agent"] == "drone", "error_m"] = 0.31
    assert checks(run).set_index("check").loc[check, "held"] == 1


def test_agents_that_come_too_close_fail_their_check(run):
    tracks = run.table("track")
    tracks.loc[tracks["agent"] == "drone", ["x_m", "y_m", "z_m"]] = [0.0, 1.2, 0.8]
    table = checks(run).set_index("check")
    assert table.loc["driven, agents stay as far apart as the scene demands", "held"] == 0


@pytest.mark.parametrize(
    ("name", "attribute", "broken"),
    [
        ("re-timed, no sample exceeds a limit", "retimed", lambda path, *_: path),
        ("stretched in time, the path stays", "stretched", lambda p, *_: replace(p, interpolation=_other(p))),
        ("no sample of two agents is closer", "closest_approach", lambda *_: _Approach),
        ("aligned to the next waypoint", "align_waypoint", lambda path, *_: path),
        ("a spline within limits, resampled", "retimed", lambda path, *_: stretched(path, 0.1)),
    ],
)
def test_a_broken_library_fails_its_check(monkeypatch, name, attribute, broken):
    monkeypatch.setattr(trajectories, attribute, broken)
    check = next(check for check in trajectories.checks.names if check.startswith(name))
    row = trajectories.checks.row(check, count=10, seed=1)
    assert row.held < row.checked
    assert row.example != "all of them"


def _other(path):
    kinds = list(Interpolation)
    return kinds[1 - kinds.index(path.interpolation)]


class _Approach:
    time_s = 0.0
    distance_m = 1e3
    tolerance_m = 0.0


def test_a_reader_that_lets_faults_pass_fails_the_check(monkeypatch):
    monkeypatch.setattr("sfglab.spatial.scene.editor.load_scene", lambda *_: editing.read_scene(editing.GOOD))
    assert not any(f["one_line"] or f["names_the_line"] or f["scene_kept"] for f in editing.faults())


def test_an_undo_that_forgets_fails_its_check(monkeypatch):
    monkeypatch.setattr("sfglab.spatial.scene.commands.History.undo", lambda *_: None)
    row = editing.checks.row(editing.checks.names[0], count=3, seed=1)
    assert row.held == 0
    assert row.example.startswith("undoing")


def test_evenly_spaced_knots_make_loops_and_the_check_sees_them():
    points = np.array([[5.3, 7.2], [0.47, 0.14], [-0.05, 0.24], [-5.3, 6.5]])
    assert any(map(trajectories.loops, trajectories.uniform_curve(points)))
    assert not any(map(trajectories.loops, trajectories.planar_curve(points)))


def test_the_editor_in_a_cell_edits_a_copy_and_has_a_still(tmp_path, monkeypatch):
    pytest.importorskip("viser")
    (tmp_path / "data").symlink_to(REFERENCE.parents[1])
    monkeypatch.setenv("SFGLAB_ROOT", str(tmp_path))
    cell = SceneCell()
    try:
        shown, _ = cell._repr_mimebundle_()
        assert {"image/png", "application/vnd.jupyter.widget-view+json"} <= set(shown)
        assert "text/html" not in shown  # a page of a server that is gone would be committed
        assert "<iframe" in cell.widget.value
        assert cell.planner.call(lambda editor: editor.file) == tmp_path / "runs/scenes/hall.yaml"
    finally:
        cell.planner.close()


def test_the_example_is_retimed_to_the_limits_that_are_asked():
    rows = list(example_rows(exp.config(speed_m_s=0.5, segment_s=2.0)))
    assert max(row["speed_m_s"] for row in rows if row["retimed"]) == pytest.approx(0.5, rel=1e-3)
    assert max(row["t_s"] for row in rows if not row["retimed"]) == 10.0
