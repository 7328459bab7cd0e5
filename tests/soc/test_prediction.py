"""Numbers of paper C out of sample: what is left out is not used, and a measurement narrows."""

import pytest

from sfglab.soc import prediction
from sfglab.soc.paper_values import PAPER_VALUES


def test_a_number_that_is_left_out_does_not_change_its_own_prediction(monkeypatch):
    before = prediction.predictions()
    changed = list(PAPER_VALUES)
    changed[1] = type(changed[1])(changed[1].panel, 70.0, changed[1].pick, changed[1].text)
    monkeypatch.setattr(prediction, "PAPER_VALUES", tuple(changed))
    after = prediction.predictions.__wrapped__()
    assert after[1].value == pytest.approx(before[1].value, rel=0.02)
    assert not after[1].covers
    assert after[0].value != pytest.approx(before[0].value, rel=0.02)


def test_each_prediction_names_what_would_narrow_it():
    for one in prediction.predictions():
        assert one.low < one.narrowed[0] < one.value < one.narrowed[1] < one.high
        assert one.decider in prediction.PRIORS or one.decider.startswith("time from")
        assert one.covers
