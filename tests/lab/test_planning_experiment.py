"""The experiment on planning: it fills its claim, its checks can fail, and its log says what was driven."""

import numpy as np
import pytest
from made_logs import DATA, reference

from sfglab.lab.checks import editing, trajectories
from sfglab.lab.experiments.planning import SceneCell, checks, exp
from sfglab.lab.experiments.planning.analysis import allowed_m
from sfglab.lab.experiments.planning.experiment import example_rows
from sfglab.record import LogReader


@pytest.fixture
def run():
    return reference(exp)


def test_every_way_in_which_a_goal_can_end_was_seen(run):
    ended = {"succeeded", "canceled", "overtaken", "server gone"}
    refused = {"busy", "unknown agent", "unknown frame", "start too far", "limits exceeded"}
    assert set(run["goal"]["outcome"]) == ended | refused | {"invalid trajectory"}


def test_the_log_holds_plans_and_poses_as_messages(run):
    with LogReader(run.log) as reader:
        kinds = {
            name: info.type_name
            for name, info in reader.topics.items()
            if name.startswith("/global")
        }
        assert kinds == {
            f"/global/{agent}/{what}": type_
            for agent in ("go2", "drone")
            for what, type_ in (
                ("path", "nav_msgs/msg/Path"),
                ("pose", "geometry_msgs/msg/PoseStamped"),
            )
        }
        poses = sum(1 for entry in reader.messages("/global/go2/pose"))
    assert poses == (run["track"]["agent"] == "go2").sum() > 100


NEAR = {"x_m": 0.0, "y_m": 1.2, "z_m": 0.8}


@pytest.mark.parametrize(
    ("check", "table", "where", "changes", "held", "said"),
    [
        (
            "a goal ends",
            "goal",
            "case == 'too fast'",
            {"outcome": "succeeded"},
            15,
            "too fast: succeeded",
        ),
        (
            "an agent is never further",
            "track",
            "agent == 'drone'",
            {"error_m": 0.31},
            1,
            "0.310 of 0.300 m",
        ),
        ("driven, agents stay", "track", "agent == 'drone'", NEAR, 0, "drone and go2: "),
    ],
)
def test_what_went_otherwise_fails_its_check_and_the_claim(
    run, check, table, where, changes, held, said
):
    rows = run.table(table)
    rows.loc[rows.eval(where), list(changes)] = list(changes.values())
    wrong = checks(run).query("held < checked")
    assert set(wrong["group"]) == {"execution"}
    [row] = wrong[wrong["check"].str.startswith(check)].to_dict("records")
    assert (row["held"], said in row["example"]) == (held, True)
    assert exp.measure(run)["A-PLAN"].estimate.value < 1
    assert allowed_m(run) == pytest.approx({"go2": 0.532, "drone": 0.300}, abs=2e-3)


def test_a_reader_that_lets_faults_pass_fails_the_check(monkeypatch):
    monkeypatch.setattr(
        "sfglab.spatial.scene.editor.load_scene", lambda *_: editing.read_scene(editing.GOOD)
    )
    assert not any(
        f["one_line"] or f["names_the_line"] or f["scene_kept"] for f in editing.faults()
    )


def test_evenly_spaced_knots_make_loops_and_the_check_sees_them():
    points = np.array([[5.3, 7.2], [0.47, 0.14], [-0.05, 0.24], [-5.3, 6.5]])
    assert any(map(trajectories.loops, trajectories.uniform_curve(points)))
    assert not any(map(trajectories.loops, trajectories.planar_curve(points)))


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


def test_the_example_is_retimed_to_the_limits_that_are_asked():
    rows = list(example_rows(exp.config(speed_m_s=0.5, segment_s=2.0)))
    assert max(row["speed_m_s"] for row in rows if row["retimed"]) == pytest.approx(0.5, rel=1e-3)
    assert max(row["t_s"] for row in rows if not row["retimed"]) == 10.0
