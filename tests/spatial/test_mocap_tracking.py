"""Sights that are believed, and synthetic captures."""

import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sfglab.errors import InvalidValueError
from sfglab.spatial import Pose
from sfglab.spatial.mocap import tracking
from sfglab.spatial.mocap.synthetic import SyntheticConfig, SyntheticMotion, synthetic_captures

MS = 1_000_000
LIMITS = tracking.Limits(
    speed_m_s=5.0, turn_rad_s=10.0, slack_m=0.02, slack_rad=0.2, believe_after_s=0.1
)
HERE, AWAY = Pose(), Pose.at((3.0, 0, 0))
FLIPPED = Pose.from_yaw((0, 0, 0), math.pi)


def verdicts(*sights, step_ns=10 * MS):
    track, told = tracking.Track(), []
    for i, sight in enumerate(sights):
        track, verdict = tracking.judge(track, sight, i * step_ns, LIMITS)
        told.append(verdict.value)
    return told, track


def test_a_jump_and_a_flip_are_left_out_until_the_place_is_held_for_a_while():
    told, track = verdicts(HERE, AWAY, HERE, FLIPPED, FLIPPED, HERE)
    assert told == ["sound", "jumped", "sound", "flipped", "flipped", "sound"]
    assert track.state is tracking.TrackState.TRACKED
    told, track = verdicts(HERE, *[FLIPPED] * 12)
    assert told == ["sound", *["flipped"] * 10, "confirmed", "sound"]
    assert track.pose == FLIPPED


def test_doubtful_places_that_change_are_never_believed_and_hiding_forgets_a_doubt():
    told, _ = verdicts(HERE, *(Pose.at((9.0 * (-1) ** i, 0, 0)) for i in range(60)))
    assert set(told[1:]) == {"jumped"}
    told, track = verdicts(HERE, *[AWAY] * 9, tracking.Lapse.OCCLUDED, AWAY, AWAY)
    assert told[-2:] == ["jumped", "jumped"]
    assert track.state is tracking.TrackState.SUSPECT


def test_an_object_may_move_far_while_it_is_hidden_and_captures_not_newer_are_left_out():
    told, track = verdicts(HERE, *[tracking.Lapse.OCCLUDED] * 70, AWAY)
    assert told == ["sound", *["occluded"] * 70, "sound"]
    assert verdicts(HERE, *[tracking.Lapse.OCCLUDED] * 3, AWAY)[0][-1] == "jumped"
    assert track.state is tracking.TrackState.TRACKED
    track, _ = tracking.judge(tracking.Track(), HERE, 100, LIMITS)
    for capture_ns in (100, 99):
        same, verdict = tracking.judge(track, AWAY, capture_ns, LIMITS)
        assert (same, verdict) == (track, tracking.Verdict.STALE)


sights = st.sampled_from([HERE, AWAY, FLIPPED, tracking.Lapse.OCCLUDED, tracking.Lapse.INVALID])


@given(st.lists(st.tuples(sights, st.integers(-5 * MS, 80 * MS)), max_size=40))
def test_every_step_is_one_of_the_table_and_what_is_believed_is_within_reach_or_was_held(steps):
    track, now_ns, accepted = tracking.Track(), 0, []
    for sight, step_ns in steps:
        now_ns += step_ns
        after, verdict = tracking.judge(track, sight, now_ns, LIMITS)
        if verdict is not tracking.Verdict.STALE:
            assert tracking.TRANSITIONS[track.state, verdict] is after.state
        if verdict.believed:
            accepted.append((now_ns, sight, verdict))
            assert after.pose == sight
        else:
            assert after.pose == track.pose
        assert (after.doubt is not None) == (after.state is tracking.TrackState.SUSPECT)
        track = after
    for (t0, a, _), (t1, b, verdict) in pairwise(accepted):
        elapsed_s = (t1 - t0) / 1e9
        reachable = (
            a.distance_m(b) <= 5.0 * elapsed_s + 0.02 and a.angle_rad(b) <= 10.0 * elapsed_s + 0.2
        )
        assert reachable or (verdict is tracking.Verdict.CONFIRMED and elapsed_s >= 0.1)


def test_every_transition_of_the_table_is_reached():
    seen = set()
    rng = np.random.default_rng(5)
    choices = [
        HERE,
        HERE,
        AWAY,
        AWAY,
        AWAY,
        FLIPPED,
        tracking.Lapse.OCCLUDED,
        tracking.Lapse.INVALID,
    ]
    for _ in range(300):
        track, now_ns = tracking.Track(), 0
        sight = choices[0]
        for _ in range(20):
            sight = choices[rng.integers(len(choices))] if rng.random() < 0.6 else sight
            now_ns += int(rng.choice([0, 10, 20, 60])) * MS
            after, verdict = tracking.judge(track, sight, now_ns, LIMITS)
            seen.add((track.state, verdict, after.state))
            track = after
    assert seen == {(state, verdict, to) for (state, verdict), to in tracking.TRANSITIONS.items()}


def synthetic(seed=3, duration_s=8.0, **faults):
    objects = {"a": SyntheticMotion(), "b": SyntheticMotion(centre_m=(5, 0, 1), period_s=6)}
    config = SyntheticConfig(**faults)
    return list(
        synthetic_captures(objects, config, np.random.default_rng(seed), duration_s=duration_s)
    )


def test_synthetic_captures_are_the_same_for_the_same_seed_and_near_the_truth():
    first, again, other = synthetic(), synthetic(), synthetic(seed=4)
    assert first == again
    assert first != other
    errors = [
        made.capture.sights[id_].distance_m(pose)
        for made in first
        for id_, pose in made.truth.items()
    ]
    assert np.sqrt(np.mean(np.square(errors))) == pytest.approx(0.0005 * math.sqrt(3), rel=0.05)
    turns = [
        made.capture.sights[id_].angle_rad(pose)
        for made in first
        for id_, pose in made.truth.items()
    ]
    assert np.sqrt(np.mean(np.square(turns))) == pytest.approx(0.002 * math.sqrt(3), rel=0.05)


def test_synthetic_faults_come_as_often_and_last_as_long_as_asked():
    faults = {
        "occlusions_hz": 0.5,
        "occlusion_s": 0.2,
        "flips_hz": 0.5,
        "flip_s": 0.2,
        "dropped": 0.05,
    }
    made = synthetic(duration_s=300.0, rate_hz=20.0, **faults)
    assert len(made) == pytest.approx(6000 * 0.95, rel=0.02)
    hidden = np.mean(
        [m.capture.sights[id_] is tracking.Lapse.OCCLUDED for m in made for id_ in "ab"]
    )
    assert hidden == pytest.approx(0.2 / 2.2, rel=0.25)  # a renewal process: 2 s seen, 0.2 s hidden
    flipped = np.mean([id_ in m.flipped for m in made for id_ in "ab"])
    assert flipped == pytest.approx(0.2 / 2.2, rel=0.3)
    latency_s = np.mean([m.capture.receipt_ns - m.capture.capture_ns for m in made]) / 1e9
    assert latency_s == pytest.approx(0.0065, rel=0.02)


def test_short_flips_of_a_moving_object_are_all_found_and_nothing_sound_is_lost():
    limits = tracking.Limits(believe_after_s=5.0)
    track, wrong, lost, flips = tracking.Track(), 0, 0, 0
    for made in synthetic(
        duration_s=40.0, flips_hz=0.8, flip_s=0.05, occlusions_hz=0.2, occlusion_s=0.05
    ):
        track, verdict = tracking.judge(
            track, made.capture.sights["a"], made.capture.capture_ns, limits
        )
        flips += "a" in made.flipped
        wrong += verdict.believed and "a" in made.flipped
        lost += (
            verdict in {tracking.Verdict.JUMPED, tracking.Verdict.FLIPPED}
            and "a" not in made.flipped
        )
    assert flips > 50
    assert (wrong, lost) == (0, 0)


@pytest.mark.parametrize(
    "fault", [{"rate_hz": 0}, {"dropped": 1.0}, {"noise_m": -1}, {"flip_s": float("nan")}]
)
def test_impossible_capture_systems_are_refused(fault):
    with pytest.raises(InvalidValueError, match="allowed"):
        SyntheticConfig(**fault)
