"""Trajectories for property tests: moderate numbers, waits, turns on the spot, dense and far apart times."""

import numpy as np
from hypothesis import strategies as st

from sfglab.spatial import Pose
from sfglab.spatial.trajectory.path import Interpolation, Trajectory

seeds = st.integers(0, 2**32)
both = st.sampled_from(Interpolation)


def random_pose(rng):
    """Return a pose at whole metres or anywhere, with a turn about z or any orientation."""
    position = rng.integers(-5, 6, 3) if rng.random() < 0.5 else rng.uniform(-20, 20, 3)
    turned = Pose.from_yaw(position, rng.choice([0.0, 0.5, -1.0, 2.0, 3.0]))
    return turned if rng.random() < 0.5 else Pose.at(position, rng.normal(size=4))


def random_trajectory(seed, count, interpolation):
    rng = np.random.default_rng(seed)
    steps_ns = rng.choice([1_000_000, 500_000_000, 10**9, 10**10], count)
    steps_ns = np.where(rng.random(count) < 0.5, steps_ns, rng.integers(10**6, 10**10, count))
    found = []
    for time_ns in np.cumsum(steps_ns).tolist():
        pose = random_pose(rng)
        if found and rng.random() < 0.3:  # a wait, with or without a turn
            before = found[-1][1]
            quat = rng.choice([before.quat_xyzw, pose.quat_xyzw])
            pose = Pose.at(before.position_m, quat)
        found.append((time_ns, pose))
    return Trajectory.of(found, interpolation)


poses = seeds.map(lambda seed: random_pose(np.random.default_rng(seed)))


def trajectories(least=2, most=6, interpolation=both):
    return st.builds(random_trajectory, seeds, st.integers(least, most), interpolation)
