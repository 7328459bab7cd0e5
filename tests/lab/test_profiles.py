"""Every experiment's profiles: one way to ask for them, one error where there is none."""

from __future__ import annotations

import pytest

from sfglab.lab.experiments import EXPERIMENTS, experiment


def config_of(name):
    one = experiment(name)
    return one.config if hasattr(one, "measure") else one.Config.of_profile


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
