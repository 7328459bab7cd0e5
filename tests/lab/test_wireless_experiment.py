"""The experiment on a radio that loses frames: known ages and outages are found again. Its live run is its notebook's."""

import numpy as np
import pytest
from made_logs import CLAIMS, made_run

from sfglab.lab.claims import entry_for
from sfglab.lab.experiments.wireless import exp, overview
from sfglab.lab.experiments.wireless.experiment import (
    AWAY,
    BEFORE_S,
    BURSTS,
    CALM,
    CHANNELS,
    FALLING,
    INDEPENDENT,
    OUTAGE,
    WAYS,
    Cell,
    sample_cells,
    video_cells,
)
from sfglab.lab.experiments.wireless.live import Span

MS, S = 10**6, 10**9
BASE_NS = 1_800_000_000 * S
PERIOD_NS = 20 * MS


def span(samples, *, marks_s=(0, 1, 2, 4), pictures=(), events=(), latched_s=(), whole=True):
    """A span whose times are in seconds since its begin; a sample has the times of sending and of arrival."""
    report = {
        "samples": [(BASE_NS + round(a * S), BASE_NS + round(b * S)) for a, b in samples],
        "pictures": [(BASE_NS + round(t * S) - 5 * MS, BASE_NS + round(t * S)) for t in pictures],
        "events": [(kind, agent, BASE_NS + round(t * S)) for kind, agent, t in events],
        "latched_ns": [BASE_NS + round(t * S) for t in latched_s],
        "whole": whole,
    }
    marks_ns = tuple(BASE_NS + round(t * S) for t in marks_s)
    return Span(marks_ns=marks_ns, kept_up=True, report=report)


def flow(begin_s, end_s, latency_s=0.001):
    return [(t, t + latency_s) for t in np.arange(begin_s, end_s, 0.02)]


def test_the_age_grows_during_an_outage_and_ends_with_the_first_fresh_sample():
    late = [(1.5, 2.3)]  # sent during the outage, so it ends no outage
    made = span([*flow(-0.02, 1), *late, *flow(2.5, 4)])
    found = made.columns()
    assert found["flows_s"] == pytest.approx(0.501)
    assert found["latency_p99_ms"] == pytest.approx(1, abs=1)
    trace = {round(row["t_s"] + BEFORE_S, 1): row["age_s"] for row in made.trace()}
    assert trace[2.2] == pytest.approx(2.2 - 0.98, abs=0.01)
    assert trace[2.4] == pytest.approx(2.4 - 1.5, abs=0.01)
    assert trace[3.0] < 0.03


def test_samples_that_overtake_each_other_do_not_make_the_newest_older():
    made = span([(-0.02, -0.019), (0.5, 0.6), (0.1, 0.7), *flow(1, 4)])
    at_ns, ages_ns = made.ages_ns()
    place = np.searchsorted(at_ns, BASE_NS + 750 * MS)
    assert ages_ns[place] == pytest.approx(0.25 * S, abs=MS)


def test_without_recovery_times_are_missing():
    found = span(flow(-0.02, 1), whole=False).columns()
    assert np.isnan([found[name] for name in ("flows_s", "latched_s", "whole_s", "frozen")]).all()


def test_losses_of_agents_are_counted_and_end_with_the_return_of_the_last_one():
    events = [("LOST", "startup", 1.9), ("LOST", "steady", 2.1)]
    returns = [("RETURNED", "startup", 2.5), ("RETURNED", "steady", 3.25)]
    found = span(flow(-0.02, 4), events=[*events, *returns], latched_s=[2.75]).columns()
    assert (found["false_losses"], found["whole_s"]) == (2, pytest.approx(1.25))
    assert found["latched_s"] == pytest.approx(0.75)
    assert span(flow(-0.02, 4)).columns()["whole_s"] == 0


def test_a_picture_is_frozen_from_a_tenth_of_a_second_on():
    pictures = [-0.01, *np.arange(0, 1, 1 / 30), *np.arange(3, 4, 1 / 30)]
    found = span(flow(-0.02, 4), pictures=pictures).columns()
    assert found["frozen"] == pytest.approx((2 + 1 / 30 - 0.1) / 4, abs=0.01)


def test_every_way_gets_the_same_cells_and_bursts_lose_a_fifth_of_the_time():
    config = exp.config("quick")
    for cells in (sample_cells(config), video_cells(config)):
        of_way = {way: [] for way in WAYS}
        for cell, repeats in cells.items():
            rest = (cell.channel, cell.outage_s, cell.requests, repeats)
            of_way[cell.way].append(rest)
        assert len({str(rest) for rest in of_way.values()}) == 1
    steps = Cell(way="zenoh_tcp", channel=BURSTS).steps(config)
    away_s = sum(duration_s for medium, duration_s in steps if medium is AWAY)
    assert away_s == pytest.approx(0.2 * config.channel_s)
    outage = Cell(way="zenoh_tcp", channel=OUTAGE, outage_s=10.0).steps(config)
    assert outage == [(CALM, BEFORE_S), (AWAY, 10.0), (CALM, config.after_s)]


FACTORS = {INDEPENDENT: 4.0, BURSTS: 3.0, FALLING: 2.5}


def made(path, factors):
    """A log in which RELIABLE has these multiples of BEST_EFFORT's values, by channel."""
    rows = []
    for channel in CHANNELS:
        for repeat in range(4):
            base = {"channel": channel, "repeat": repeat}
            for way in WAYS:
                factor = factors.get(channel, 1.0) if way == "dds_reliable" else 1.0
                value = (30.0 + repeat) * factor
                of_way = {"way": way, "age_p95_ms": value, "latency_p99_ms": value}
                rows.append({**base, **of_way})
    return made_run(exp, path, {"samples": rows})


@pytest.mark.parametrize(
    ("factors", "verdict"),
    [
        (FACTORS, "reproduced"),
        ({**FACTORS, FALLING: 1.0}, "undecided"),
        (dict.fromkeys(FACTORS, 1.5), "deviates"),
    ],
)
def test_claims_are_judged_at_independent_loss_and_under_two_other_channels(
    tmp_path, factors, verdict
):
    measured = exp.measure(made(tmp_path / "made.mcap", factors))
    for name in ("A-BE-STALE", "A-BE-SPIKES"):
        finding = measured[name]
        assert finding.estimate.value == pytest.approx(factors[INDEPENDENT])
        assert {key: one.value for key, one in finding.under.items()} == {
            key: pytest.approx(factors[key]) for key in (BURSTS, FALLING)
        }
        assert entry_for(CLAIMS[name], finding).verdict.value == verdict


def test_a_recovery_that_was_not_observed_counts_as_the_time_that_is_observed(tmp_path):
    rows = []
    for repeat, flows_s in enumerate([float("nan"), float("nan"), 1.0]):
        cell = {"way": "zenoh_tcp", "channel": OUTAGE, "outage_s": 10.0}
        rows.append({**cell, "repeat": repeat, "flows_s": flows_s})
    run = made_run(exp, tmp_path / "made.mcap", {"samples": rows})
    assert overview(run, "samples", "flows_s")["Zenoh, TCP"].tolist() == ["8 [1, 8]"]
