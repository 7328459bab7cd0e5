"""Poses that are published, and simulated captures."""

import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sfglab.spatial import Pose
from sfglab.spatial.mocap.synthetic import SyntheticConfig, SyntheticMotion, synthetic_captures
from sfglab.spatial.mocap.tracking import Lapse, Limits, Track, TrackState, Verdict

MS = 1_000_000
LIMITS = Limits(speed_m_s=5.0, turn_rad_s=10.0, believe_after_s=0.1)
NEAR, NEARER, BESIDE = (Pose.at((x_m, 0, 0)) for x_m in (0.15, 0.1, 0.05))
HERE, AWAY, THERE = Pose(), Pose.at((3.0, 0, 0)), Pose.at((-9.0, 0, 0))
FLIPPED = Pose.from_yaw((0, 0, 0), math.pi)
HIDDEN = Lapse.OCCLUDED


@pytest.mark.parametrize(
    ("sights", "verdicts", "state"),
    [
        ([HIDDEN], ["occluded"], "absent"),
        ([HERE, Lapse.INVALID], ["sound", "invalid"], "hidden"),
        # A place that is held for 0.1 s is published, and then it is the one to compare with.
        ([HERE, *[FLIPPED] * 12], ["sound", *["flipped"] * 10, "confirmed", "sound"], "tracked"),
        # A near place too, although the object could have gone there slowly meanwhile.
        ([HERE, *[NEAR] * 11], ["sound", *["jumped"] * 10, "confirmed"], "tracked"),
        ([HERE, NEAR, NEARER, BESIDE], ["sound", "jumped", "jumped", "sound"], "tracked"),
        ([HERE, *[AWAY, THERE] * 20], ["sound", *["jumped"] * 40], "suspect"),
        # An occlusion ends the time for which a place is held.
        ([HERE, *[AWAY] * 9, HIDDEN, AWAY], ["sound", *["jumped"] * 9, "occluded", "jumped"], "suspect"),
        ([HERE, *[HIDDEN] * 70, AWAY], ["sound", *["occluded"] * 70, "sound"], "tracked"),
        # A half turn is doubted however long the object was hidden.
        ([HERE, *[HIDDEN] * 70, FLIPPED], ["sound", *["occluded"] * 70, "flipped"], "suspect"),
    ],
)  # fmt: skip
def test_poses_out_of_reach_are_not_published_until_they_are_held(sights, verdicts, state):
    track = Track(LIMITS)
    found = [track.judge(sight, i * 10 * MS).value for i, sight in enumerate(sights)]
    assert (found, track.state.value) == (verdicts, state)


def test_captures_that_are_not_newer_change_nothing():
    track = Track(LIMITS)
    steps = [(HERE, 100), (AWAY, 100), (AWAY, 99), (HERE, 101)]
    verdicts = [track.judge(*step).value for step in steps]
    assert verdicts == ["sound", "stale", "stale", "sound"]


sights = st.sampled_from([HERE, AWAY, FLIPPED, HIDDEN, Lapse.INVALID])


@given(st.lists(st.tuples(sights, st.integers(1, 80 * MS)), max_size=40))
def test_what_is_published_is_within_reach_or_was_held(steps):
    track, now_ns, published = Track(LIMITS), 0, []
    for sight, step_ns in steps:
        now_ns += step_ns
        verdict = track.judge(sight, now_ns)
        assert (track.state is TrackState.TRACKED) == verdict.is_published
        if verdict.is_published:
            published.append((now_ns, sight, verdict))
    for (t0, a, _), (t1, b, verdict) in pairwise(published):
        if LIMITS.verdict(a, b, t1 - t0) is not Verdict.SOUND:
            assert verdict is Verdict.CONFIRMED
            assert t1 - t0 >= LIMITS.believe_after_s * 1e9


PATH = SyntheticMotion()


def captured(seed=3, duration_s=8.0, **faults):
    config, rng = SyntheticConfig(**faults), np.random.default_rng(seed)
    return list(synthetic_captures({"a": PATH}, config, rng, duration_s=duration_s))


def test_captures_are_the_same_for_the_same_seed_and_near_the_path():
    first = captured()
    assert first == captured() != captured(seed=4)
    pairs = [(one.sights["a"], PATH.pose_at(one.capture_ns / 1e9)) for one in first]
    for measure, sigma in ((Pose.distance_m, 0.0005), (Pose.angle_rad, 0.002)):
        squares = [measure(*pair) ** 2 for pair in pairs]
        assert math.sqrt(np.mean(squares) / 3) == pytest.approx(sigma, rel=0.07)


def test_occlusions_and_losses_are_as_frequent_and_long_as_asked():
    faults = {"occlusions_hz": 0.5, "occlusion_s": 0.2, "dropped": 0.05}
    made = captured(duration_s=1200.0, rate_hz=20.0, **faults)
    assert len(made) == pytest.approx(24_000 * 0.95, rel=0.02)
    hidden = np.array([one.sights["a"] is HIDDEN for one in made])
    assert np.mean(hidden) == pytest.approx(0.2 / 2.2, rel=0.25)  # 2 s visible, 0.2 s hidden
    assert np.sum(hidden[1:] & ~hidden[:-1]) == pytest.approx(1200 / 2.2, rel=0.15)
    latency_ns = np.mean([one.receipt_ns - one.capture_ns for one in made])
    assert latency_ns == pytest.approx(6.5e6, rel=0.02)
