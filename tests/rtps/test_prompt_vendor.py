"""A vendor whose readers answer at once and whose repairs travel together: the model of Cyclone DDS."""

from __future__ import annotations

import numpy as np

from sfglab.qos import QoSProfile
from sfglab.rtps import CYCLONE_DDS, Fate, Flow, Medium, Outcome, Scenario, run

S = 1_000_000_000
MS = 1_000_000
QUIET = Medium(loss=0.0, overhead_s=0.0, rate_bps=8e6, contention=0.0, shared=False)


def played(
    medium: Medium, *, rate_hz: float, depth: int = 10, seed: int = 1, duration_s: float = 2.0
) -> Outcome:
    flow = Flow(name="f", source="a", target="b", rate_hz=rate_hz, qos=QoSProfile(depth=depth))
    return run(Scenario(flows=(flow,), medium=medium, vendor=CYCLONE_DDS, duration_s=duration_s), seed=seed)


def test_while_samples_follow_each_other_nothing_is_acknowledged():
    counts = played(QUIET, rate_hz=100).counts
    assert (counts["data"], counts["heartbeat"], counts["acknack"]) == (200, 1, 2), "the first and the last"


def test_a_sample_after_a_pause_is_acknowledged_at_once():
    counts = played(QUIET, rate_hz=5).counts
    assert (counts["data"], counts["heartbeat"], counts["acknack"]) == (10, 0, 10)


def test_what_is_new_is_asked_for_at_once_and_the_same_again_after_the_delay():
    medium = Medium(loss=0.1, overhead_s=0.0, rate_bps=8e6, contention=0.0, shared=False)
    flow = played(medium, rate_hz=100, depth=100, duration_s=20).flows["f"]
    assert flow.loss == 0
    late_ns = flow.latency_ns[flow.latency_ns > 5 * MS]
    # A loss shows with the next sample, 10 ms later; a lost repair or request costs 100 ms more.
    assert 10 * MS < np.median(late_ns) < 80 * MS
    assert ((late_ns > 10 * MS) & (late_ns < 12 * MS)).sum() > 20


def test_repairs_travel_together():
    outcome = played(Medium(rate_bps=1e6, queue_frames=50), rate_hz=1000, depth=1000)
    repairs = outcome.counts["repeated"]
    frames = outcome.counts["data"] - len(outcome.flows["f"].fate)
    assert repairs > 100
    assert repairs > 10 * frames
    assert set(outcome.flows["f"].fate.tolist()) <= {Fate.DELIVERED, Fate.OVERWRITTEN, Fate.UNDERWAY, Fate.LATE}
