"""The memory model against paper C, section 4: its numbers, its other statements, and the fit."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import least_squares

from sfglab.lab.paper import paper
from sfglab.soc.memory import FITTED, STORED, Costs
from sfglab.soc.paper_values import (
    MESSAGE_BYTES,
    STATED,
    SUBSCRIBERS,
    Panel,
    speed_ups,
    stated_by_model,
)

PAPER = np.array([paper(stated.claim, stated.number) for stated in STATED])


class CutThrough(Costs):
    """Costs of a gateway core that passes words on without storing a chunk."""

    @property
    def memory_to_stream_cycles(self):
        return self.read_cycles

    @property
    def stream_to_memory_cycles(self):
        return self.write_cycles


CUT_THROUGH = CutThrough(
    write_latency_cycles=51.554,
    publish_s_per_byte=3.6766e-9,
    deliver_s=63.289e-6,
    deliver_s_per_byte=0.0477e-9,
    endpoint_s=445.43e-6,
    cancel_s=391.71e-6,
)


def worst(costs):
    """Return the largest relative difference to the paper's numbers."""
    return np.abs(stated_by_model(costs) / PAPER - 1).max()


def fitted_values(costs):
    return np.array([getattr(costs, name) for name in FITTED])


def refit(costs, factors=1.0):
    """Fit the constants of `FITTED` to the paper's numbers, from other starts by factors."""

    def costs_of(logs):
        return replace(costs, **dict(zip(FITTED, np.exp(logs).tolist(), strict=True)))

    def errors(logs):
        return np.log(stated_by_model(costs_of(logs)) / PAPER)

    start = np.log(fitted_values(costs) * factors)
    return costs_of(least_squares(errors, start, x_scale="jac", xtol=1e-12).x)


@pytest.mark.parametrize(("costs", "farthest"), [(STORED, 0.03), (CUT_THROUGH, 0.10)])
def test_the_model_has_the_numbers_of_the_paper(costs, farthest):
    assert worst(costs) < farthest


@pytest.mark.parametrize("costs", [STORED, CUT_THROUGH])
def test_a_fit_from_other_starts_ends_at_the_committed_constants(costs):
    rng = np.random.default_rng(0)
    shifts = []
    for _ in range(3):
        again = refit(costs, np.exp(rng.uniform(-np.log(2.5), np.log(2.5), len(FITTED))))
        shifts.append(np.abs(fitted_values(again) / fitted_values(costs) - 1).max())
    assert min(shifts) < 0.001


@pytest.mark.parametrize("factor", [0.5, 2.0])
def test_of_the_assumed_constants_only_a_short_read_latency_cannot_be_fitted(factor):
    latency = replace(STORED, read_latency_cycles=30 * factor)
    assert (worst(refit(latency)) > 0.10) == (factor < 1)
    for name in ("delegate_s", "publish_s"):
        other = replace(STORED, **{name: factor * getattr(STORED, name)})
        assert worst(refit(other)) < 0.03


@pytest.mark.parametrize(("costs", "slower_with_8"), [(STORED, True), (CUT_THROUGH, False)])
def test_statements_without_a_number_hold_though_they_were_not_fitted(costs, slower_with_8):
    shape = len(Panel), len(SUBSCRIBERS), len(MESSAGE_BYTES)
    ratios = np.array([bar.ratio for bar in speed_ups(costs)]).reshape(shape)
    to_hardware, to_software, from_software, between_software = ratios
    assert to_hardware.min() > 1, "speed-ups with more than one hardware subscriber"
    for rising in (to_hardware, to_software):
        assert (np.diff(rising, axis=0) >= 0).all(), "more speed-up with more subscribers"
        assert (np.diff(rising, axis=1) >= 0).all(), "more speed-up with larger messages"
    below = from_software[:, 0] < 1
    assert below.tolist() == [True, True, slower_with_8], "below 1 for small messages"
    assert between_software.min() > 1, "speed-ups for all sizes and numbers"
