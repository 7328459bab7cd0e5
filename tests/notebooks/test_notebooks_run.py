"""Every notebook runs through headless, on the smoke profile, in a checkout of its own."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from sfglab.lab.notebooks import find_notebooks, run_notebooks
from sfglab.lab.paths import Project

ROOT = Path(__file__).parents[2]


@pytest.mark.live
@pytest.mark.netns
@pytest.mark.slow
@pytest.mark.timeout(480)
def test_all_notebooks_run_through_and_leave_logs_and_figures(tmp_path, monkeypatch):
    shutil.copytree(ROOT / "notebooks", tmp_path / "notebooks", ignore=shutil.ignore_patterns(".*"))
    (tmp_path / "data").mkdir()
    shutil.copy(ROOT / "data" / "claims.yaml", tmp_path / "data" / "claims.yaml")
    for folder in ("fleets", "graphs", "qos"):
        shutil.copytree(ROOT / "data" / folder, tmp_path / "data" / folder)
    monkeypatch.setenv("SFGLAB_ROOT", str(tmp_path))
    project = Project(root=tmp_path)
    notebooks = find_notebooks(project)
    assert notebooks[-1].stem == "00_index", "the index reports on the others"
    outcomes = run_notebooks(notebooks, project=project, parameters={"profile": "smoke"}, say=lambda _: None)
    assert {o.name: o.error for o in outcomes} == {p.stem: "" for p in notebooks}
    assert {p.parent.name for p in project.runs.glob("logs/*/*.mcap")} == {
        "naming",
        "depth_codecs",
        "decode_once",
        "routing",
        "lifecycle",
        "discovery",
        "latency",
        "balancing",
        "transmission",
        "cooperation",
        "gateways",
        "driving",
        "transfer",
    }
    assert not project.figures.exists(), "a smoke test replaces no figure"
    assert {p.stem for p in (project.runs / "figures").glob("*.svg")} == {
        "naming_schema",
        "depth_codecs",
        "decode_once_h264",
        "routing_border",
        "heartbeats",
        "discovery_states",
        "discovery_fleet",
        "discovery_scale",
        "latency",
        "balancing_caches",
        "balancing_qos",
        "balancing_stale",
        "cooperation",
        "cooperation_staleness",
        "cooperation_tracks",
        "driving_chain",
        "driving_lap",
        "driving_laps",
        "gateway_core",
        "graph_mapping",
        "node_mapping",
        "transfer",
        "transfer_break_even",
        "transfer_live",
        "transfer_residuals",
        "transmission_beyond",
        "transmission_fates",
        "transmission_latency",
        "transmission_live",
        "transmission_loss",
    }
