"""The offset from markers to base, estimated from a recorded motion, with an uncertainty that holds."""

from __future__ import annotations

import numpy as np
import pytest

from sfglab.spatial import Pose, StampedTransform
from sfglab.spatial.frames import FrameBuffer
from sfglab.spatial.mocap import (
    SyntheticConfig,
    SyntheticMotion,
    estimate_offset,
    pose_pairs,
    synthetic_captures,
)
from sfglab.spatial.mocap.offset import PosePair
from sfglab.spatial.mocap.tracking import MocapError

X = Pose.at((0.03, -0.01, -0.12), (0.1, -0.05, 0.3, 1))
Z = Pose.at((3.0, -1.0, 0.2), (0, 0, 0.4, 1))
FLAT = {"sway_rad": 0.0, "radii_m": (2.0, 1.0, 0.0)}


def noise(rng, sigma_m, sigma_rad):
    return Pose.at(rng.normal(size=3) * sigma_m, (*(rng.normal(size=3) * sigma_rad / 2), 1))


def recording(rng, count=30, factor=1.0, offset=X, **motion):
    way = SyntheticMotion(**motion)
    seen = [way.pose_at(10.0 * i / count) for i in range(count)]
    return [
        PosePair(
            world_from_object=a @ noise(rng, 0.0005 * factor, 0.002 * factor),
            odom_from_base=Z.inverse() @ a @ offset @ noise(rng, 0.003 * factor, 0.004 * factor),
        )
        for a in seen
    ]


def test_without_noise_the_offset_is_exact():
    found = estimate_offset(recording(np.random.default_rng(0), factor=0.0))
    assert found.object_from_base.same_as(X, within_m=1e-9, within_rad=1e-7)
    assert found.world_from_odom.same_as(Z, within_m=1e-9, within_rad=1e-7)
    assert max(found.sigma_m) < 1e-6


def test_the_stated_uncertainty_is_that_of_repeated_recordings():
    rng = np.random.default_rng(7)
    hits, distances = [], []
    for _ in range(50):
        found = estimate_offset(recording(rng))
        turn = (X.rotation.inv() * found.object_from_base.rotation).as_rotvec()
        error = np.concatenate([turn, np.subtract(found.object_from_base.position_m, X.position_m)])
        hits.append(np.abs(error) <= 1.96 * np.array([*found.sigma_rad, *found.sigma_m]))
        distances.append(error @ np.linalg.solve(np.array(found.covariance), error))
    assert 0.90 <= np.mean(hits) <= 0.99  # 95 %, of 50 recordings with 6 numbers each
    assert np.mean(distances) == pytest.approx(6.0, abs=1.5)  # chi square with 6 degrees of freedom


def test_residuals_are_the_noise_of_both():
    found = estimate_offset(recording(np.random.default_rng(1), count=200))
    assert found.residual_rad == pytest.approx(np.hypot(0.002, 0.004), rel=0.1)
    assert found.residual_m == pytest.approx(np.sqrt(0.0005**2 + 0.003**2), rel=0.1)
    assert found.pairs == 200


def test_a_motion_about_one_axis_leaves_the_height_open_and_says_so():
    flat = recording(np.random.default_rng(2), factor=0.0, **FLAT)
    with pytest.raises(MocapError, match=r"leaves z of the base .* give height_m"):
        estimate_offset(flat)


def test_with_the_height_by_hand_a_motion_about_one_axis_is_enough():
    upright = Pose.from_yaw((0.03, -0.01, -0.12), 2.5)
    flat = recording(np.random.default_rng(2), offset=upright, **FLAT)
    found = estimate_offset(flat, height_m=-0.12)
    assert found.object_from_base.same_as(upright, within_m=0.005, within_rad=0.01)
    assert found.sigma_m[2] < 1e-4


def test_too_few_moments_are_refused():
    with pytest.raises(MocapError, match="given 5 moments, allowed are 6"):
        estimate_offset(recording(np.random.default_rng(0), count=5))


def test_pairs_come_from_captures_and_the_robots_transforms_of_the_same_time():
    motion, buffer = SyntheticMotion(), FrameBuffer()
    rng = np.random.default_rng(3)
    config = SyntheticConfig(rate_hz=20.0, occlusions_hz=0.5)
    made = list(synthetic_captures({"o": motion}, config, rng, duration_s=9.0))
    for i in range(600):
        pose = Z.inverse() @ motion.pose_at(i * 0.01) @ X
        buffer.insert(StampedTransform(parent="odom", child="base", stamp_ns=i * 10_000_000, pose=pose))
    pairs = pose_pairs((m.capture for m in made), "o", buffer, odom="odom", base="base")
    assert 60 < len(pairs) < 120  # neither the hidden ones nor those after the robot's last transform
    found = estimate_offset(pairs)
    assert found.object_from_base.same_as(X, within_m=0.005, within_rad=0.002)


def drifting(rng, rate_rad_s, walk_m_s, seconds=10.0, **options):
    """A recording whose odometry turns and walks away in the world, with times."""
    still = recording(rng, count=200, **options)
    moments = [(i * seconds / len(still), pair) for i, pair in enumerate(still)]
    return [
        PosePair(
            world_from_object=pair.world_from_object,
            odom_from_base=Z.inverse()
            @ Pose.from_yaw((walk_m_s * t, 0, 0), rate_rad_s * t)
            @ (Z @ pair.odom_from_base),
            time_ns=round(t * 1e9),
        )
        for t, pair in moments
    ]


def test_odometry_that_drifts_is_seen_and_does_not_spoil_the_offset():
    pairs = drifting(np.random.default_rng(5), 0.01, 0.02)
    found, blind = (estimate_offset(pairs, drift=drift) for drift in (True, False))
    assert found.object_from_base.same_as(X, within_m=0.006, within_rad=0.004)
    assert found.drift_rad_s == pytest.approx(0.01, rel=0.1)
    assert not blind.object_from_base.same_as(X, within_m=0.02, within_rad=0.004)
    assert (blind.drift_m_s, blind.drift_rad_s) == (0.0, 0.0)


def test_where_nothing_drifts_none_is_found():
    found = estimate_offset(drifting(np.random.default_rng(6), 0.0, 0.0, factor=0.0))
    assert found.object_from_base.same_as(X, within_m=1e-7, within_rad=1e-7)
    assert max(found.drift_m_s, found.drift_rad_s) < 1e-7
