"""Every notebook runs through headless, on the smoke profile, in a checkout of its own."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from sfglab.lab.experiments import EXPERIMENTS
from sfglab.lab.notebooks import find_notebooks, run_notebooks
from sfglab.lab.paths import Project

ROOT = Path(__file__).parents[2]
INDEX = "00_index"
# What the notebooks draw. The first kind concludes nothing from what other work on the machine disturbs.
QUIET = {
    "01_naming": {"naming_schema"},
    "02_depth_codecs": {"depth_codecs"},
    "08_caches_and_qos": {"balancing_caches", "balancing_qos", "balancing_stale"},
    "09_transmission": {
        "transmission_beyond",
        "transmission_fates",
        "transmission_latency",
        "transmission_live",
        "transmission_loss",
    },
    "10_cooperation": {"cooperation", "cooperation_staleness", "cooperation_tracks"},
    "11_gateways": {"gateway_core", "graph_mapping"},
    "12_transfer": {
        "node_mapping",
        "transfer",
        "transfer_break_even",
        "transfer_live",
        "transfer_residuals",
    },
    "13_driving": {"driving_chain", "driving_lap", "driving_laps"},
    "15_planning": {"planning_interpolation", "planning_scene"},
    "17_deployment": {"deployment_checks", "deployment_layers"},
}
LIVE = {
    "03_decode_once": {"decode_once_h264"},
    "04_routing": {"routing_border"},
    "05_lifecycle": {"heartbeats", "discovery_states"},
    "06_discovery": {"discovery_fleet", "discovery_scale"},
    "07_latency": {"latency"},
    "14_mocap": {"mocap_error", "mocap_offset", "mocap_trees"},
    "16_visualisation": {"visualisation_latency", "visualisation_points"},
}


@pytest.fixture
def project(tmp_path, monkeypatch):
    """Return a checkout of its own, without logs."""
    shutil.copytree(ROOT / "notebooks", tmp_path / "notebooks", ignore=shutil.ignore_patterns(".*"))
    shutil.copytree(ROOT / "data", tmp_path / "data", ignore=shutil.ignore_patterns("reference"))
    monkeypatch.setenv("SFGLAB_ROOT", str(tmp_path))
    return Project(root=tmp_path)


def run_through(project, kind, *more):
    """Run notebooks; all must end well, with one log each and the figures that they name."""
    notebooks = find_notebooks(project, [*sorted(kind), *more])
    outcomes = run_notebooks(notebooks, project=project, parameters={"profile": "smoke"}, say=lambda _: None)
    assert {o.name: o.error for o in outcomes} == {p.stem: "" for p in notebooks}
    logs = sorted(p.parent.name for p in project.runs.glob("logs/*/*.mcap"))
    assert len(logs) == len(kind)
    assert set(logs) <= set(EXPERIMENTS)
    assert not project.figures.exists(), "a smoke test replaces no figure"
    drawn = {p.stem for p in (project.runs / "figures").glob("*.svg")}
    assert drawn == set().union(*kind.values())


def test_every_notebook_is_of_one_kind_and_the_index_reports_on_all():
    names = [path.stem for path in find_notebooks(Project(root=ROOT))]
    assert names == [*sorted([*QUIET, *LIVE]), INDEX]
    assert len(QUIET) + len(LIVE) == len(EXPERIMENTS)


@pytest.mark.slow
@pytest.mark.timeout(240)
@pytest.mark.parametrize("name", QUIET)
def test_a_notebook_without_live_parts_runs_through_and_leaves_a_log_and_figures(project, name):
    run_through(project, {name: QUIET[name]})


@pytest.mark.live
@pytest.mark.netns
@pytest.mark.slow
@pytest.mark.timeout(480)
def test_notebooks_with_live_parts_run_through_and_leave_logs_and_figures(project):
    run_through(project, LIVE, INDEX)
