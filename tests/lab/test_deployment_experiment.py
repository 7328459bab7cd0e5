"""The deployment experiment: a run fills its claim, draws its figures, and a fault in the files would show."""

from __future__ import annotations

import asyncio
from dataclasses import replace

import pytest

from sfglab.deploy.preparing import load_source, prepare
from sfglab.deploy.release import SOURCE, make_release
from sfglab.lab.bundle_meanings import meaning_of
from sfglab.lab.experiments import deployment
from sfglab.lab.experiments.deployment.containers import container_checks
from sfglab.lab.experiments.deployment.run import run

ESSLINGEN = SOURCE / "data" / "fleets" / "esslingen.yaml"


def test_a_run_fills_its_claim_draws_its_figures_and_keeps_what_machines_are_given(tmp_path):
    config = replace(deployment.Config.of_profile("smoke"), agents=("steamdeck",))
    log = asyncio.run(run(config, tmp_path / "run.mcap"))
    measured = deployment.measure_claims(log)["A-DEPLOY"]
    assert measured.estimate.value == 1.0, measured.reason
    assert set(deployment.figures(log)) == {"deployment_layers", "deployment_checks"}
    results = deployment.load_results(log)
    assert [path for path in results.files["path"] if not meaning_of(path)] == []
    assert results.refused[~results.refused["refused"]].to_dict("records") == []
    assert len(results.refused) >= 10
    assert deployment.text_of(log, "steamdeck/compose.yaml").startswith("# Agent steamdeck")


@pytest.mark.live
@pytest.mark.netns
def test_agents_meet_over_their_bridges_and_routers_and_nothing_of_their_own_gets_out(tmp_path):
    source = load_source(ESSLINGEN)
    pairs = prepare(source, *make_release(SOURCE, source.text), agents=("go2", "workstation"))
    rows = asyncio.run(container_checks(pairs, tmp_path))
    assert len(rows) == 3
    assert [row for row in rows if row.held < row.checked] == []
