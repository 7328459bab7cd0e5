"""The experiment on planning: its facts can fail, and its log has what was planned and driven."""

from dataclasses import replace

import numpy as np
import pytest
from made_logs import DATA, ran, reference

from sfglab.lab.experiments.planning import SceneCell, exp, facts_of
from sfglab.lab.experiments.planning.facts import FACTS
from sfglab.lab.experiments.planning.results import CARRIED_OUT, track_of
from sfglab.spatial.trajectory.motion import motion_of
from sfglab.spatial.trajectory.path import Interpolation

LINE = Interpolation.POLYLINE


def test_a_fact_without_a_case_and_a_goal_that_is_not_carried_out_fail_the_claim():
    run = reference(exp)
    goals, checks = run.table("goal"), run.table("check")
    goals.loc[goals["agent"] == "drone", "outcome"] = "path left"
    checks.loc[checks["check"].str.contains("aligned|polyline|spline"), "check"] = "another"
    held = facts_of(run).set_index("check")["held"]
    assert held[CARRIED_OUT] == 1
    assert (held == 0).sum() == 4
    measured = exp.measure(run)["A-PLAN"]
    assert (measured.estimate.value, measured.details["facts"]) == (0.0, "2 of 7")
    assert "1 of 2: drone: path left" in measured.reason


@pytest.mark.parametrize(
    ("place", "broken", "name"),
    [
        ("facts.aligned_quat", lambda *_: (0.0, 0.0, 0.0, 1.0), "aligned to the next"),
        ("facts.aligned_quat", lambda *_: (0.0, 0.0, 0.0, 1.0), "aligned to the previous"),
        ("facts.pose_at", lambda path, _: path.waypoints[0].pose, "a polyline is linear"),
        ("facts.motion_of", lambda path: motion_of(replace(path, interpolation=LINE)), "a spline"),
        ("facts.Editor.undo", lambda _: None, "any edits, undone"),
        ("facts.load_scene", lambda _: None, "a saved scene"),
    ],
)
def test_a_broken_library_fails_its_fact(monkeypatch, place, broken, name):
    monkeypatch.setattr(f"sfglab.lab.experiments.planning.{place}", broken)
    [problem_of] = [problem_of for fact, problem_of in FACTS.items() if fact.startswith(name)]
    rng = np.random.default_rng(0)
    assert all(problem_of(rng) for _ in range(3))


@pytest.mark.slow
@pytest.mark.live
def test_a_smoke_run_has_all_facts_and_the_poses_of_the_agents_as_messages(tmp_path):
    run = ran(exp, tmp_path / "smoke.mcap", cases=2)
    found = facts_of(run)
    assert set(found["check"]) == {*FACTS, CARRIED_OUT}
    assert (found["held"] == found["checked"]).all()
    for agent, end_s in (("drone", 6.0), ("go2", 12.8)):
        track = track_of(run, agent)
        assert 0 <= track["t_s"].min() < 0.2
        assert track["t_s"].max() > end_s
        assert 0.2 < track["error_m"].max() < 0.6


def test_the_tracking_error_is_the_distance_from_the_plan_that_the_log_states():
    run = reference(exp)
    # The action server states the distance that is left at the end of a goal.
    stated = dict(zip(run["goal"]["agent"], run["goal"]["left_m"], strict=True))
    errors = {name: track_of(run, name)["error_m"].iloc[-1] for name in stated}
    assert errors == pytest.approx(stated)


def test_the_editor_in_a_cell_edits_a_copy_and_has_a_still(tmp_path, monkeypatch):
    pytest.importorskip("viser")
    (tmp_path / "data").symlink_to(DATA)
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
