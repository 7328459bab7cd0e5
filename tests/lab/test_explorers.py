"""Explorers of all experiments: each parameter has its words, and axes hold every setting of the form."""

from itertools import product
from typing import get_args, get_type_hints

import pytest

from sfglab.lab.experiments import EXPERIMENTS, experiment
from sfglab.lab.experiments.balancing import cache_curves
from sfglab.lab.experiments.transfer import transfer_curves
from sfglab.lab.explore.form import argument_texts, default_values

EXPLORERS = {}
for name in EXPERIMENTS:
    EXPLORERS |= experiment(name).explorers


@pytest.mark.parametrize("name", EXPLORERS)
def test_each_parameter_has_its_words(name):
    function = EXPLORERS[name]
    assert argument_texts(function).keys() == default_values(function).keys()


@pytest.mark.parametrize("function", [transfer_curves, cache_curves])
def test_axes_hold_every_setting_of_the_form(function):
    hints = get_type_hints(function, include_extras=True)
    bounds = {name: get_args(hints[name])[1] for name in default_values(function)}
    assert len(bounds) > 1
    for values in product(*((one.low, one.high) for one in bounds.values())):
        picture = function(**dict(zip(bounds, values, strict=True)))
        for row in picture.values():
            axis = picture.panels[row["place"]].y
            assert axis.low <= row["y"] <= axis.high
