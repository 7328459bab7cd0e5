"""Predictions of paper C's numbers: a number does not predict itself."""

import pytest

from sfglab.lab.paper import paper
from sfglab.soc.paper_values import STATED
from sfglab.soc.prediction import predictions

NUMBERS = [paper(stated.claim, stated.number) for stated in STATED]


def test_a_number_does_not_change_its_own_prediction_but_those_of_others():
    before = predictions(NUMBERS)
    after = predictions([NUMBERS[0], 70.0, *NUMBERS[2:]])
    assert after[1].value == pytest.approx(before[1].value, rel=0.02)
    assert after[0].value != pytest.approx(before[0].value, rel=0.02)


def test_each_interval_has_the_number():
    for number, found in zip(NUMBERS, predictions(NUMBERS), strict=True):
        assert found.low < number < found.high
        assert found.low < found.value < found.high
