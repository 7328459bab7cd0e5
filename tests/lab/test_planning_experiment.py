"""The experiment on planning: it fills its claim, its checks can fail, and its log says what was driven."""

from __future__ import annotations

import asyncio
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from sfglab.lab.claims import How
from sfglab.lab.experiments import planning
from sfglab.lab.experiments.planning import cases, editing, geometry
from sfglab.record import LogReader
from sfglab.spatial.trajectory import Interpolation, stretched

ROOT = Path(__file__).parents[2]
SMOKE = replace(planning.Config.of_profile("smoke"), cases=3, edit_cases=2)


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("SFGLAB_ROOT", str(ROOT))
        yield asyncio.run(planning.run(SMOKE, tmp_path_factory.mktemp("planning") / "a.mcap"))


def test_a_run_fills_its_claim_and_draws_its_figures(log):
    measured = planning.measure_claims(log)["A-PLAN"]
    assert (measured.estimate.value, measured.how, measured.reason) == (1.0, How.SIMULATED, "")
    assert (
        measured.details["execution checks"].split(" of ")[0]
        == measured.details["execution checks"].split()[-1]
    )
    assert set(planning.figures(log)) == {"planning_scene", "planning_interpolation"}


def test_every_way_in_which_a_goal_can_end_was_seen(log):
    results = planning.load_results(log)
    assert set(results.goals["outcome"]) == {
        "succeeded",
        "canceled",
        "overtaken",
        "busy",
        "unknown agent",
        "unknown frame",
        "start too far",
        "limits exceeded",
        "invalid trajectory",
        "server gone",
    }
    assert len(planning.checks(results)) > 30


def test_the_log_holds_plans_and_poses_as_messages(log):
    assert log.stat().st_size < 300_000
    with LogReader(log) as reader:
        kinds = {name: info.type_name for name, info in reader.topics.items() if name.startswith("/global")}
        assert kinds == {
            f"/global/{agent}/{what}": type_
            for agent in ("go2", "drone")
            for what, type_ in (("path", "nav_msgs/msg/Path"), ("pose", "geometry_msgs/msg/PoseStamped"))
        }
        poses = sum(1 for entry in reader.messages("/global/go2/pose"))
        tracks = reader.table("track")
        assert poses == (tracks["agent"] == "go2").sum() > 100


def test_one_goal_that_ends_otherwise_fails_the_claim(log):
    results = planning.load_results(log)
    goals = results.goals.copy()
    goals.loc[goals["case"] == "too fast", "outcome"] = "succeeded"
    table = planning.checks(replace(results, goals=goals))
    wrong = table[table["held"] < table["checked"]]
    assert "too fast: succeeded" in set(wrong["example"])
    assert set(wrong["group"]) == {"execution"}


def test_agents_that_come_too_close_fail_their_check(log):
    results = planning.load_results(log)
    tracks = results.tracks.copy()
    drone = tracks["agent"] == "drone"
    tracks.loc[drone, ["x_m", "y_m", "z_m"]] = [0.0, 1.2, 0.8]
    table = planning.checks(replace(results, tracks=tracks)).set_index("check")
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
    monkeypatch.setattr(geometry, attribute, broken)
    trial = next((check, trial) for check, trial in geometry.GEOMETRY if check.startswith(name))
    [row] = cases.checked([trial], 10, seed=1)
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
    monkeypatch.setattr("sfglab.spatial.scene.editor.load_scene", lambda *_: editing.read_scene(editing._GOOD))
    rows = list(editing.fault_rows())
    assert not any(row.one_line or row.names_the_line or row.scene_kept for row in rows)


def test_an_undo_that_forgets_fails_its_check(monkeypatch):
    monkeypatch.setattr("sfglab.spatial.scene.commands.History.undo", lambda *_: None)
    [row] = cases.checked([editing.EDITING[0]], 3, seed=1)
    assert row.held == 0
    assert row.example.startswith("undoing")


def test_evenly_spaced_knots_make_loops_and_the_check_sees_them():
    points = np.array([[5.3, 7.2], [0.47, 0.14], [-0.05, 0.24], [-5.3, 6.5]])
    assert any(map(geometry.loops, geometry.uniform_curve(points)))
    assert not any(map(geometry.loops, geometry.planar_curve(points)))
