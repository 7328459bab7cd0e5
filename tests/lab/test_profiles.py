"""Every experiment's profiles: one way to ask for them, one error where there is none."""

import json
from pathlib import Path

import pytest

from sfglab.fields import to_json
from sfglab.lab.claims import load_claims
from sfglab.lab.experiments import EXPERIMENTS, experiment

ROOT = Path(__file__).parents[2]


def config_of(name):
    return experiment(name).config


@pytest.mark.parametrize("name", EXPERIMENTS)
def test_every_experiment_has_the_three_profiles_with_the_seed_that_is_asked_for(name):
    config = config_of(name)
    shortest, *longer = (config(profile, seed=7) for profile in ("smoke", "quick", "paper"))
    assert shortest.seed == 7
    assert all(other.seed == 7 and other != shortest for other in longer)


@pytest.mark.parametrize("name", EXPERIMENTS)
def test_every_experiment_refuses_an_unknown_profile_and_names_those_there_are(name):
    with pytest.raises(ValueError, match=r"profile: given 'long', allowed.* smoke, quick, paper"):
        config_of(name)("long")


def test_every_claim_is_answered_by_the_experiment_that_the_ledger_names():
    ledger = load_claims(ROOT / "data" / "claims.yaml")
    claims = {(c.id, c.experiment) for c in ledger if c.experiment}
    claims |= {(c.id, c.criterion.experiment) for c in ledger if c.criterion}
    assert {(claim, name) for name in EXPERIMENTS for claim in experiment(name).claims} == claims


def test_every_committed_figure_of_an_experiment_is_declared_by_it():
    twins = [json.loads(path.read_text()) | {"stem": path.stem} for path in (ROOT / "figures").glob("*.json")]
    committed = {(twin["experiment"], twin["stem"]) for twin in twins if twin["stem"] != "summary"}
    declared = {(name, drawing) for name in EXPERIMENTS for drawing in experiment(name).drawings}
    assert committed == declared


@pytest.mark.parametrize("name", EXPERIMENTS)
def test_every_reference_log_reads_back_as_the_configuration_that_was_run(name):
    run = experiment(name).load(ROOT / "data" / "reference" / f"{name}.mcap")
    written = run.metadata("config")
    read = {"experiment": name, **to_json(run.config)}
    assert {key: read[key] for key in written} == written
