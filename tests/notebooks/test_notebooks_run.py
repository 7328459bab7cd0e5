"""Every notebook runs through headless, on the smoke profile, in a checkout of its own."""

from __future__ import annotations

import contextlib
import os
import shutil
from pathlib import Path

import psutil
import pytest

from sfglab.lab.experiments import EXPERIMENTS
from sfglab.lab.notebooks import find_notebooks, run_notebooks
from sfglab.lab.paths import Project

ROOT = Path(__file__).parents[2]
INDEX = "00_index"
# What the notebooks draw in a smoke test.
FIGURES_ANYWHERE = {
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
# The same for those that mean little without hosts of their own.
FIGURES_OF_HOSTS = {
    "03_decode_once": {"decode_once_h264"},
    "04_routing": {"routing_border"},
    "05_lifecycle": {"heartbeats", "discovery_states"},
    "06_discovery": {"discovery_fleet", "discovery_scale"},
    "07_latency": {"latency"},
    "14_mocap": {"mocap_error", "mocap_offset", "mocap_trees"},
    "16_visualisation": {"visualisation_latency", "visualisation_points"},
}
FIGURES = FIGURES_ANYWHERE | FIGURES_OF_HOSTS
LIVE = [pytest.mark.live, pytest.mark.netns]
NAMES = [*FIGURES_ANYWHERE, *(pytest.param(name, marks=LIVE) for name in FIGURES_OF_HOSTS)]


@pytest.fixture
def project(tmp_path, monkeypatch):
    """A checkout of its own, without logs; what runs for it is gone at the end."""
    shutil.copytree(ROOT / "notebooks", tmp_path / "notebooks", ignore=shutil.ignore_patterns(".*"))
    shutil.copytree(ROOT / "data", tmp_path / "data", ignore=shutil.ignore_patterns("reference"))
    monkeypatch.setenv("SFGLAB_ROOT", str(tmp_path))
    yield Project(root=tmp_path)
    _, alive = psutil.wait_procs(processes_of(tmp_path), timeout=60)
    assert [process.cmdline() for process in alive] == []


def processes_of(folder):
    """Processes that were started for a checkout, whoever their parent is by now."""
    found = []
    for process in psutil.process_iter():
        with contextlib.suppress(psutil.Error):
            if process.pid != os.getpid() and process.environ().get("SFGLAB_ROOT") == str(folder):
                found.append(process)
    return found


def run_through(project, name):
    """Run one notebook, which must end well."""
    found = find_notebooks(project, [name])
    outcomes = run_notebooks(found, project=project, parameters={"profile": "smoke"}, say=lambda _: None)
    assert [(o.name, o.error) for o in outcomes] == [(name, "")]


def test_every_notebook_is_known_and_the_index_reports_on_all():
    names = [path.stem for path in find_notebooks(Project(root=ROOT))]
    assert names == [*sorted(FIGURES), INDEX]
    assert len(FIGURES) == len(EXPERIMENTS)


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_a_notebook_runs_through_and_leaves_a_log_its_figures_and_nothing_else(project, name):
    run_through(project, name)
    (log,) = project.runs.glob("logs/*/*.mcap")
    assert log.parent.name in EXPERIMENTS
    assert not project.figures.exists(), "a smoke test replaces no figure"
    assert {p.stem for p in (project.runs / "figures").glob("*.svg")} == FIGURES[name]


@pytest.mark.slow
def test_the_index_runs_through_on_the_reference_logs(project):
    shutil.copytree(ROOT / "data" / "reference", project.reference_logs)
    run_through(project, INDEX)
    assert not project.runs.joinpath("logs").exists()
